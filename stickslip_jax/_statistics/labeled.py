"""The statistics of an ensemble as labelled arrays."""

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .conventions import labeled_dataset, variable
from .distribution import DEFAULT_BINS, Distribution
from .estimate import Estimate
from .joint import JointDistribution
from .quantities import DISTRIBUTIONS, FIRST_TWO, SLIP_QUANTITIES, STICK_QUANTITIES, STREAMED_PAIRS, StickValue

if TYPE_CHECKING:
    import xarray

_SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)
_Entries = dict[Hashable, Any]  # variables or coordinates by name, as xarray takes them


def dataset_of_statistics(statistics: Any, bins: int | None) -> "xarray.Dataset":
    """An `EnsembleStatistics` as an ``xarray.Dataset``; see `EnsembleStatistics.to_xarray`."""
    variables: _Entries = {}
    coordinates: _Entries = {"quantile": variable("quantile", list(_SHARES), "share of values", "1")}
    for quantity in statistics.known(DISTRIBUTIONS):
        _add_distribution(quantity.name, getattr(statistics, quantity.name), bins, variables, coordinates)
    for x, y in (*STREAMED_PAIRS, FIRST_TWO):
        if {x, y} & statistics.missing:
            continue
        _add_joint(f"{_key(x)}_and_{_key(y)}", statistics.joint(x, y), bins, variables, coordinates)
    _add_orders(statistics, variables, coordinates)
    shares = list(statistics.endings.values())
    _add_estimates("ending_share", "ending", shares, "share of sticks by ending", "1", variables)
    coordinates["ending"] = (
        "ending", [ending.name for ending in statistics.endings], {"long_name": "how the stick ended"},
    )  # fmt: skip
    return labeled_dataset(variables, coordinates, {"samples": statistics.samples, "duration_s": float(statistics.t1)})


def _add_estimates(
    name: str, dimension: str, estimates: Sequence[Estimate], long_name: str, unit: str, variables: _Entries
) -> None:
    variables[name] = variable(dimension, [one.value for one in estimates], long_name, unit)
    errors = [one.standard_error for one in estimates]
    variables[f"{name}_error"] = variable(dimension, errors, "standard error", unit)


def _add_distribution(
    name: str, of: Distribution, bins: int | None, variables: _Entries, coordinates: _Entries
) -> None:
    for label, one in (("mean", of.mean), ("standard_deviation", of.standard_deviation), ("skewness", of.skewness)):
        variables[f"{name}_{label}"] = variable((), one.value, one.name, one.unit, standard_error=one.standard_error)
    quantiles = [of.quantile(share) for share in _SHARES]
    _add_estimates(f"{name}_quantile", "quantile", quantiles, f"quantile of {of.name}", of.unit, variables)
    histogram, bin_name = of.histogram(bins), f"{name}_bin"
    per = "1" if of.unit == "1" else f"{of.unit}-1"
    _add_bins(bin_name, histogram.edges, of.name, of.unit, variables, coordinates)
    variables[f"{name}_count_in_bin"] = variable(bin_name, histogram.counts, f"number of values of {of.name}", "1")
    variables[f"{name}_density"] = variable(bin_name, histogram.density, f"density of {of.name}", per)
    variables[f"{name}_density_error"] = variable(bin_name, histogram.error, "standard error", per)


def _key(value: StickValue) -> str:
    """A quantity in the names of variables: ``duration``, or ``duration_1`` for that of the first stick."""
    return value if isinstance(value, str) else f"{value[0]}_{value[1]}"


def _add_joint(
    name: str, joint: JointDistribution, bins: int | None, variables: _Entries, coordinates: _Entries
) -> None:
    histogram = joint.histogram(DEFAULT_BINS if bins is None else min(bins, 128))
    edges, dimensions = (histogram.x_edges, histogram.y_edges), (f"{name}_x_bin", f"{name}_y_bin")
    for dimension, edge, quantity, unit in zip(dimensions, edges, joint.names, joint.units, strict=True):
        _add_bins(dimension, edge, quantity, unit, variables, coordinates)
    long_name = f"number of pairs of {joint.names[0]} and {joint.names[1]}"
    variables[f"{name}_count_in_bin"] = variable(dimensions, histogram.counts, long_name, "1")


def _add_bins(
    name: str, edges: np.ndarray, long_name: str, unit: str, variables: _Entries, coordinates: _Entries
) -> None:
    """Centres of bins, and their bounds as CF conventions have them."""
    coordinates[name] = variable(name, (edges[1:] + edges[:-1]) / 2, long_name, unit, bounds=f"{name}_bounds")
    variables[f"{name}_bounds"] = ((name, "bounds"), np.stack([edges[:-1], edges[1:]], axis=1))


def _add_orders(statistics: Any, variables: _Entries, coordinates: _Entries) -> None:
    """Means of the 1st, 2nd, ... stick, and slip."""
    orders = [statistics.order(number) for number in range(1, statistics.orders + 1)]
    coordinates["order"] = variable("order", [one.number for one in orders], "number of the stick or slip", "1")
    shares = [one.share for one in orders]
    _add_estimates("share_by_order", "order", shares, "share of samples that have the stick", "1", variables)
    for quantity in statistics.known(STICK_QUANTITIES):
        means = [getattr(one, quantity.name).mean for one in orders]
        long_name, unit = f"mean {quantity.short_label} of the stick", statistics.unit_of(quantity)
        _add_estimates(f"{quantity.name}_by_order", "order", means, long_name, unit, variables)
    slips = [statistics.slips.order(one.number) for one in orders]
    for quantity in SLIP_QUANTITIES:
        means = [one.distributions[quantity.name].mean for one in slips]
        long_name = f"mean {quantity.label}"
        _add_estimates(f"{quantity.name}_by_order", "order", means, long_name, "s", variables)
