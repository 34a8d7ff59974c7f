"""The statistics of an ensemble as labelled arrays."""

from typing import TYPE_CHECKING, Any

import numpy as np

from .distribution import Distribution
from .joint import JointDistribution

if TYPE_CHECKING:
    import xarray

DISTRIBUTIONS = (
    "stick_count", "slip_count", "stick_fraction", "duration", "own_mean_duration", "slip_duration", "start",
    "position",
)  # fmt: skip
JOINT = (("duration", "position"), ("start", "duration"), ("duration 1", "duration 2"))
_SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)


def dataset_of_statistics(told: Any, bins: int) -> "xarray.Dataset":
    """The statistics `told` as an ``xarray.Dataset``; see `EnsembleStatistics.to_xarray`."""
    try:
        import xarray as xr  # noqa: PLC0415 - an extra, loaded when asked for
    except ImportError:
        raise ImportError("Labelled results need xarray: pip install 'stickslip_jax[study]'.") from None
    variables, coordinates = (
        {},
        {"quantile": ("quantile", list(_SHARES), {"long_name": "share of values", "units": "1"})},
    )
    for name in DISTRIBUTIONS:
        _put_distribution(name, getattr(told, name), bins, variables, coordinates)
    for pair in JOINT:
        _put_joint(told.joint(*pair), bins, variables, coordinates)
    _put_orders(told, variables, coordinates)
    shares = list(told.endings.values())
    variables["ending_share"] = _along("ending", [one.value for one in shares], "share of sticks by ending", "1")
    variables["ending_share_error"] = _along("ending", [one.standard_error for one in shares], "standard error", "1")
    coordinates["ending"] = ("ending", [ending.name for ending in told.endings], {"long_name": "how the stick ended"})
    attributes = {"Conventions": "CF-1.11", "samples": told.samples, "duration_s": float(told.t1)}
    return xr.Dataset(variables, coordinates, attributes)


def _along(dimension: Any, values: Any, long_name: str, unit: str, **attributes: Any) -> tuple[Any, ...]:
    return dimension, values, {"long_name": long_name, "units": unit, **attributes}


def _put_distribution(name: str, of: Distribution, bins: int, variables: dict, coordinates: dict) -> None:
    for label, one in (("mean", of.mean), ("standard_deviation", of.standard_deviation), ("skewness", of.skewness)):
        variables[f"{name}_{label}"] = _along((), one.value, one.name, one.unit, standard_error=one.standard_error)
    quantiles = [of.quantile(share) for share in _SHARES]
    values, errors = ([getattr(one, what) for one in quantiles] for what in ("value", "standard_error"))
    variables[f"{name}_quantile"] = _along("quantile", values, f"quantile of {of.name}", of.unit)
    variables[f"{name}_quantile_error"] = _along("quantile", errors, "standard error", of.unit)
    histogram, bin_name = of.histogram(bins), f"{name}_bin"
    per = "1" if of.unit == "1" else f"{of.unit}-1"
    _put_bins(bin_name, histogram.edges, of.name, of.unit, variables, coordinates)
    variables[f"{name}_count_in_bin"] = _along(bin_name, histogram.counts, f"number of values of {of.name}", "1")
    variables[f"{name}_density"] = _along(bin_name, histogram.density, f"density of {of.name}", per)
    variables[f"{name}_density_error"] = _along(bin_name, histogram.error, "standard error", per)


def _put_joint(joint: JointDistribution, bins: int, variables: dict, coordinates: dict) -> None:
    histogram, name = joint.histogram(min(bins, 128)), "_and_".join(joint.names).replace(" ", "_")
    edges, dimensions = (histogram.x_edges, histogram.y_edges), (f"{name}_x_bin", f"{name}_y_bin")
    for dimension, edge, quantity, unit in zip(dimensions, edges, joint.names, joint.units, strict=True):
        _put_bins(dimension, edge, quantity, unit, variables, coordinates)
    long_name = f"number of pairs of {joint.names[0]} and {joint.names[1]}"
    variables[f"{name}_count_in_bin"] = _along(dimensions, histogram.counts, long_name, "1")


def _put_bins(name: str, edges: np.ndarray, long_name: str, unit: str, variables: dict, coordinates: dict) -> None:
    """Centres of bins, and their bounds as CF has them."""
    coordinates[name] = _along(name, (edges[1:] + edges[:-1]) / 2, long_name, unit, bounds=f"{name}_bounds")
    variables[f"{name}_bounds"] = ((name, "bounds"), np.stack([edges[:-1], edges[1:]], axis=1))


def _put_orders(told: Any, variables: dict, coordinates: dict) -> None:
    """Means of the 1st, 2nd, ... stick."""
    orders = [told.order(number) for number in range(1, told.orders + 1)]
    coordinates["order"] = _along("order", [one.number for one in orders], "number of the stick", "1")
    columns = {
        "share_by_order": ([one.share for one in orders], "share of samples that have the stick", "1"),
        "start_by_order": ([one.start.mean for one in orders], "mean start of the stick", "s"),
        "duration_by_order": ([one.duration.mean for one in orders], "mean duration of the stick", "s"),
        "position_by_order": ([one.position.mean for one in orders], "mean position of the stick", told.position_unit),
    }
    for name, (estimates, long_name, unit) in columns.items():
        variables[name] = _along("order", [one.value for one in estimates], long_name, unit)
        variables[f"{name}_error"] = _along("order", [one.standard_error for one in estimates], "standard error", unit)
