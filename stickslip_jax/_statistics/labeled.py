"""The statistics of an ensemble as labelled arrays."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._conventions import Entries, labeled_dataset, variable
from .distribution import DEFAULT_BINS, Distribution
from .estimate import Estimate
from .joint import JointDistribution
from .quantities import DISTRIBUTIONS, FIRST_TWO, SLIP_QUANTITIES, STICK_QUANTITIES, STREAMED_PAIRS, StickValue

if TYPE_CHECKING:
    import xarray

_SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)


def dataset_of_statistics(statistics: Any, bins: int | None) -> "xarray.Dataset":
    """An `EnsembleStatistics` as an ``xarray.Dataset``; see `EnsembleStatistics.to_xarray`."""
    found = _Entries({}, {"quantile": variable("quantile", list(_SHARES), "share of values", "1")}, bins)
    for quantity in statistics.known(DISTRIBUTIONS):
        found.add_distribution(quantity.name, getattr(statistics, quantity.name))
    for x, y in (*STREAMED_PAIRS, FIRST_TWO):
        if not {x, y} & statistics.missing:
            found.add_joint(f"{_key(x)}_and_{_key(y)}", statistics.joint(x, y))
    found.add_orders(statistics)
    endings = statistics.endings
    found.add_estimates("ending_share", "ending", list(endings.values()), "share of sticks by ending", "1")
    names = [ending.name for ending in endings]
    found.coordinates["ending"] = ("ending", names, {"long_name": "how the stick ended"})
    attributes = {"samples": statistics.samples, "duration_s": float(statistics.t1)}
    return labeled_dataset(found.variables, found.coordinates, attributes)


def _key(value: StickValue) -> str:
    """A quantity in the names of variables: ``duration``, or ``duration_1`` for that of the first stick."""
    return value if isinstance(value, str) else f"{value[0]}_{value[1]}"


class _Entries(NamedTuple):
    """The variables and coordinates so far; `bins`: at most, of each histogram."""

    variables: Entries
    coordinates: Entries
    bins: int | None

    def add_estimates(
        self, name: str, dimension: str, estimates: Sequence[Estimate], long_name: str, unit: str
    ) -> None:
        self.variables[name] = variable(dimension, [one.value for one in estimates], long_name, unit)
        errors = [one.standard_error for one in estimates]
        self.variables[f"{name}_error"] = variable(dimension, errors, "standard error", unit)

    def add_distribution(self, name: str, of: Distribution) -> None:
        for label, one in (("mean", of.mean), ("standard_deviation", of.standard_deviation), ("skewness", of.skewness)):
            error = one.standard_error
            self.variables[f"{name}_{label}"] = variable((), one.value, one.name, one.unit, standard_error=error)
        quantiles = [of.quantile(share) for share in _SHARES]
        self.add_estimates(f"{name}_quantile", "quantile", quantiles, f"quantile of {of.name}", of.unit)
        histogram, bin_name = of.histogram(self.bins), f"{name}_bin"
        per = "1" if of.unit == "1" else f"{of.unit}-1"
        self.add_bins(bin_name, histogram.edges, of.name, of.unit)
        columns = {
            "count_in_bin": variable(bin_name, histogram.counts, f"number of values of {of.name}", "1"),
            "density": variable(bin_name, histogram.density, f"density of {of.name}", per),
            "density_error": variable(bin_name, histogram.error, "standard error", per),
        }
        self.variables.update({f"{name}_{label}": column for label, column in columns.items()})

    def add_joint(self, name: str, joint: JointDistribution) -> None:
        histogram = joint.histogram(DEFAULT_BINS if self.bins is None else min(self.bins, 128))
        edges, dimensions = (histogram.x_edges, histogram.y_edges), (f"{name}_x_bin", f"{name}_y_bin")
        for dimension, edge, quantity, unit in zip(dimensions, edges, joint.names, joint.units, strict=True):
            self.add_bins(dimension, edge, quantity, unit)
        long_name = f"number of pairs of {joint.names[0]} and {joint.names[1]}"
        self.variables[f"{name}_count_in_bin"] = variable(dimensions, histogram.counts, long_name, "1")

    def add_bins(self, name: str, edges: np.ndarray, long_name: str, unit: str) -> None:
        """Centres of bins, and their bounds as CF conventions have them."""
        centers, bounds = (edges[1:] + edges[:-1]) / 2, f"{name}_bounds"
        self.coordinates[name] = variable(name, centers, long_name, unit, bounds=bounds)
        self.variables[bounds] = ((name, "bounds"), np.stack([edges[:-1], edges[1:]], axis=1))

    def add_orders(self, statistics: Any) -> None:
        """Means of the 1st, 2nd, ... stick, and slip."""
        orders = [statistics.order(number) for number in range(1, statistics.orders + 1)]
        numbers = [one.number for one in orders]
        self.coordinates["order"] = variable("order", numbers, "number of the stick or slip", "1")
        shares = [one.share for one in orders]
        self.add_estimates("share_by_order", "order", shares, "share of samples that have the stick", "1")
        slips = [statistics.slips.order(number) for number in numbers]
        for quantity in statistics.known(STICK_QUANTITIES):
            means = [one.distributions[quantity.name].mean for one in orders]
            label, unit = f"mean {quantity.short_label} of the stick", statistics.unit_of(quantity)
            self.add_estimates(f"{quantity.name}_by_order", "order", means, label, unit)
        for quantity in SLIP_QUANTITIES:
            means = [one.distributions[quantity.name].mean for one in slips]
            self.add_estimates(f"{quantity.name}_by_order", "order", means, f"mean {quantity.label}", "s")
