"""The joint distribution of two quantities, and all statistics as labelled arrays."""

import dataclasses
import math
from collections.abc import Hashable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from .._foundation import checks
from .._foundation.extras import Entries, labeled_dataset, variable
from .._numerics.sums import DyadicCounts, PowerSums
from .distribution import DEFAULT_BINS, Atoms, Clusters, Distribution, atoms_of, bin_of, entropy_of, joined
from .estimate import Estimate
from .quantities import DISTRIBUTIONS, FIRST_TWO, SLIP_QUANTITIES, STICK_QUANTITIES, STREAMED_PAIRS

if TYPE_CHECKING:
    import xarray


# The joint distribution of two quantities: histogram, correlations, mutual information, conditional means.


_MOST_BINS = 128
_MOST_INFORMATIVE = 20  # bins of each quantity for the mutual information
_PAIRS_IN_A_CELL = 10  # there, on average


@dataclasses.dataclass(frozen=True, eq=False)
class JointHistogram:
    """Counts of `number` pairs in cells, and the probability density per unit of x and of y.

    `x_edges` (x bins + 1,), `y_edges` (y bins + 1,); `counts`, `density` and its standard `error` (x bins, y bins).
    `names`, `units`: of x and y.
    """

    x_edges: Float[np.ndarray, " x_edges"]
    y_edges: Float[np.ndarray, " y_edges"]
    counts: Int[np.ndarray, "x_bins y_bins"]
    density: Float[np.ndarray, "x_bins y_bins"]
    error: Float[np.ndarray, "x_bins y_bins"]
    number: int
    names: tuple[str, str]
    units: tuple[str, str]


@dataclasses.dataclass(frozen=True, eq=False)
class ConditionalMeans:
    """The mean of y given that x lies in a bin, for every bin of x.

    - `edges`: of the bins of x, (bins + 1,).
    - `mean`: NaN in empty bins. `error`: its standard error, NaN below two pairs. `counts`: of pairs. (bins,)
    - `names`, `units`: of x and y.
    """

    edges: Float[np.ndarray, " edges"]
    mean: Float[np.ndarray, " bins"]
    error: Float[np.ndarray, " bins"]
    counts: Int[np.ndarray, " bins"]
    names: tuple[str, str]
    units: tuple[str, str]


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class JointDistribution:
    """The joint distribution of two quantities x and y.

    Histogram, Pearson's correlation and mutual information come from all pairs where these were summed while they
    streamed by, else from the retained ones; rank correlation and conditional means from the retained ones. What the
    pairs do not determine is NaN. Standard errors treat samples as independent, not the pairs of one sample.

    - `names`: of x and y, in text. `labels`: on axes of figures. `units`: of x and y.
    - `x`, `y`: the retained pairs. `bins`: counts of all pairs and `streamed_correlation`: Pearson's, of all pairs;
      None where the pairs were not summed.
    - `round_off`: values of x, and of y, that differ by no more than this may be equal.
    - `origin`: of the random numbers; see `Estimate`.
    """

    names: tuple[str, str]
    labels: tuple[str, str]
    units: tuple[str, str]
    x: Clusters
    y: Clusters
    bins: DyadicCounts | None
    streamed_correlation: float | None
    round_off: tuple[float, float] = (0.0, 0.0)
    origin: Hashable = dataclasses.field(default_factory=object)

    @property
    def number(self) -> int:
        """Number of pairs in the histogram."""
        return int(self._fine.counts.sum())

    @property
    def retained(self) -> int:
        """Number of retained pairs."""
        return len(self.x.values)

    @cached_property
    def atoms(self) -> Atoms:
        """The points that have a probability of their own, each with its share of the retained pairs.

        They come from what is certain in many samples, such as one fixed start (`Distribution.repeated_share`). Points
        with less than 0.1 % of the pairs are left out.
        """
        return atoms_of(self.x.values, self.y.values, self.round_off)

    def share_of_atoms(self, bins: int) -> Float[np.ndarray, "x_bins y_bins"]:
        """The share of the retained pairs of each cell of ``histogram(bins)`` that are atoms."""
        _, counts, cell, inside = self._binned(bins)
        every, atoms = (
            np.bincount(cell[chosen], minlength=counts.size) for chosen in (inside, inside & self.atoms.of_pair)
        )
        return (atoms / np.maximum(every, 1)).reshape(counts.shape)

    @cached_property
    def _fine(self) -> DyadicCounts:
        if self.bins is not None:
            return self.bins
        if self.retained == 0:
            return DyadicCounts.none(2, _MOST_BINS)
        return DyadicCounts.of_columns((self.x.values, self.y.values), _MOST_BINS)

    def histogram(self, bins: int = 40) -> JointHistogram:
        """The histogram of all pairs, in at most `bins` bins of equal width along each axis.

        Raises:
            ValueError: Unless `bins` is a whole number from 1 to 128.
        """
        (x_edges, y_edges), counts, cell, _ = self._binned(bins)
        errors = self.x.errors_of_shares(cell, counts.size).reshape(counts.shape)
        area = np.diff(x_edges)[:, None] * np.diff(y_edges)
        density = counts / max(counts.sum(), 1) / area
        return JointHistogram(
            x_edges, y_edges, counts, density, errors / area, int(counts.sum()), self.names, self.units
        )

    @property
    def correlation(self) -> Estimate:
        """Pearson's correlation coefficient."""
        value = self.streamed_correlation
        if value is None:
            value = float(PowerSums.of(self.x.values, self.y.values).correlation[0, 1])
        if math.isnan(value) or self.retained < 2:
            return self._estimate("Pearson correlation", value, math.nan)
        x, y = (_standardized(column.values) for column in (self.x, self.y))
        return self._estimate("Pearson correlation", value, self.x.error(x * y - value / 2 * (x**2 + y**2)))

    @property
    def rank_correlation(self) -> Estimate:
        """Spearman's rank correlation coefficient of the retained pairs."""
        from scipy import stats  # noqa: PLC0415 - slow to load

        name = "Spearman rank correlation"
        x, y = self.x.values, self.y.values
        if len(x) < 2 or x.min() == x.max() or y.min() == y.max():
            return self._estimate(name, math.nan, math.nan)
        number = len(x)
        ranks = [(stats.rankdata(column) - 0.5) / number for column in (x, y)]
        value = float(np.corrcoef(*ranks)[0, 1])
        # The influence of a pair: the product of its own ranks, plus its effect on the ranks of all other pairs.
        influence = ranks[0] * ranks[1] + _mean_above(x, ranks[1]) + _mean_above(y, ranks[0])
        return self._estimate(name, value, 12 * self.x.error(influence - influence.mean()))

    def mutual_information(self, bins: int | None = None) -> Estimate:
        """Mutual information of the histogram in at most `bins` x `bins` cells, nats.

        ``sum p_ij log(p_ij / (p_i p_j))`` over the cells, without the bias of few pairs, as `Distribution.entropy`:
        of independent quantities it is 0 on average, and may be negative. By default there are up to 20 bins, so that
        each cell has 10 pairs on average; with fewer than 5 a part of the bias stays, and the name says so.

        Raises:
            ValueError: As `histogram`.
        """
        if bins is None:
            bins = min(_MOST_INFORMATIVE, max(2, math.isqrt(self.number // _PAIRS_IN_A_CELL)))
        _, counts, cell, inside = self._binned(bins)
        name = f"mutual information in {counts.shape[0]} x {counts.shape[1]} bins"
        number = counts.sum()
        if number == 0:
            return self._estimate(name, math.nan, math.nan, "nat")
        if counts.size > 1 and number < 5 * counts.size:
            name += " (few pairs: too large)"
        rows, columns = counts.sum(axis=1), counts.sum(axis=0)
        value = entropy_of(rows) + entropy_of(columns) - entropy_of(counts.ravel())
        share = counts / number
        product = rows[:, None] * columns / number**2
        gain = np.log(np.where(share > 0, share, 1.0) / np.where(share > 0, product, 1.0))
        deviation = gain - (share * gain).sum()
        return self._estimate(name, value, self.x.error(np.where(inside, deviation.reshape(-1)[cell], 0)), "nat")

    def conditional_mean(self, bins: int = 20) -> ConditionalMeans:
        """The mean of y given x, for x in `bins` bins of equal width, over the retained pairs.

        Raises:
            ValueError: Unless `bins` is a whole number of at least 1.
        """
        checks.whole_number("bins", bins)
        x, y = self.x.values, self.y.values
        span = (x.min(), x.max()) if len(x) else (0.0, 1.0)
        edges = np.linspace(span[0], span[1] if span[1] > span[0] else span[0] + 1, bins + 1)
        place = np.clip(bin_of(x, edges), 0, bins - 1)
        counts = np.bincount(place, minlength=bins)
        filled = counts > 0
        mean = np.full(bins, np.nan)
        mean[filled] = np.bincount(place, weights=y, minlength=bins)[filled] / counts[filled]
        error = np.full(bins, np.nan)
        for index in np.flatnonzero(counts > 1):
            here = place == index
            # The influence of a pair on the mean over one bin, divided by the share of pairs in that bin.
            error[index] = self.x.error(np.where(here, y - mean[index], 0) * (len(x) / counts[index]))
        return ConditionalMeans(edges, mean, error, counts, self.names, self.units)

    def cells_of_retained(self, bins: int) -> tuple[np.ndarray, int]:
        """The cell of each retained pair in a histogram of at most `bins` x `bins` cells, and the number of cells.

        Raises:
            ValueError: As `histogram`.
        """
        _, counts, cell, _ = self._binned(bins)
        return cell, counts.size

    def _binned(self, bins: int) -> tuple[list[np.ndarray], np.ndarray, np.ndarray, np.ndarray]:
        """At most `bins` bins along x and y: their edges, the counts of the cells, the cell of each retained pair (0 if
        it lies in none), and whether it lies in one.
        """
        bins = checks.whole_number("bins", bins, maximum=_MOST_BINS)
        if self._fine.counts.size == 0:
            edges, counts = [np.array([0.0, 1.0])] * 2, np.zeros((1, 1), np.int64)
        else:
            edges, counts = joined(self._fine, bins)
        x, y = (bin_of(own.values, ends) for own, ends in zip((self.x, self.y), edges, strict=True))
        inside = (x >= 0) & (x < counts.shape[0]) & (y >= 0) & (y < counts.shape[1])
        return edges, counts, np.where(inside, x * counts.shape[1] + y, 0), inside

    def _estimate(self, name: str, value: float, error: float, unit: str = "1") -> Estimate:
        samples = self.x.of_all
        return Estimate(f"{name} of {self.names[0]} and {self.names[1]}", value, error, unit, samples, self.origin)

    def __repr__(self) -> str:
        if self.number == 0:
            return f"{self.names[0]} and {self.names[1]}: no pairs"
        lines = [f"{self.names[0]} and {self.names[1]}: {self.number:,} pairs"]
        shown = (self.correlation, self.rank_correlation, self.mutual_information())
        return "\n".join([*lines, *(f"  {one.name.partition(' of ')[0]}: {one.without_name()}" for one in shown)])


def _standardized(values: np.ndarray) -> np.ndarray:
    spread = values.std()
    return (values - values.mean()) / spread if spread > 0 else np.zeros_like(values)


def _mean_above(values: np.ndarray, others: np.ndarray) -> np.ndarray:
    """For each value, the sum of `others` over the pairs with a value at least as large, divided by all pairs."""
    order = np.argsort(values, kind="stable")
    ranked = values[order]
    tail = np.concatenate([np.cumsum(others[order][::-1])[::-1], [0.0]])
    return tail[np.searchsorted(ranked, values, side="left")] / len(values)


# The statistics of an ensemble as labelled arrays.


_SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)


def dataset_of_statistics(statistics: Any, bins: int | None) -> "xarray.Dataset":
    """An `EnsembleStatistics` as an ``xarray.Dataset``; see `EnsembleStatistics.to_xarray`."""
    variables: Entries = {}
    coordinates: Entries = {"quantile": variable("quantile", list(_SHARES), "share of values", "1")}

    def add_estimates(name: str, dimension: str, estimates: Sequence[Estimate], long_name: str, unit: str) -> None:
        values, errors = ([getattr(one, what) for one in estimates] for what in ("value", "standard_error"))
        variables[name] = variable(dimension, values, long_name, unit)
        variables[f"{name}_error"] = variable(dimension, errors, "standard error", unit)

    def add_bins(name: str, edges: np.ndarray, long_name: str, unit: str) -> None:
        """Centres of bins, and their bounds as CF conventions have them."""
        centers, bounds = (edges[1:] + edges[:-1]) / 2, f"{name}_bounds"
        coordinates[name] = variable(name, centers, long_name, unit, bounds=bounds)
        variables[bounds] = ((name, "bounds"), np.stack([edges[:-1], edges[1:]], axis=1))

    for quantity in statistics.known(DISTRIBUTIONS):
        name = quantity.name
        of: Distribution = getattr(statistics, name)
        for moment in ("mean", "standard_deviation", "skewness"):
            one, label = getattr(of, moment), f"{name}_{moment}"
            variables[label] = variable((), one.value, one.name, one.unit, standard_error=one.standard_error)
        quantiles = [of.quantile(share) for share in _SHARES]
        add_estimates(f"{name}_quantile", "quantile", quantiles, f"quantile of {of.name}", of.unit)
        histogram, bin_name = of.histogram(bins), f"{name}_bin"
        per = "1" if of.unit == "1" else f"{of.unit}-1"
        add_bins(bin_name, histogram.edges, of.name, of.unit)
        counted = f"number of values of {of.name}"
        variables[f"{name}_count_in_bin"] = variable(bin_name, histogram.counts, counted, "1")
        variables[f"{name}_density"] = variable(bin_name, histogram.density, f"density of {of.name}", per)
        variables[f"{name}_density_error"] = variable(bin_name, histogram.error, "standard error", per)

    for pair in (*STREAMED_PAIRS, FIRST_TWO):
        if set(pair) & statistics.missing:
            continue
        joint = statistics.joint(*pair)
        # In names of variables ``duration``, or ``duration_1`` for that of the first stick.
        name = "_and_".join(one if isinstance(one, str) else f"{one[0]}_{one[1]}" for one in pair)
        histogram = joint.histogram(DEFAULT_BINS if bins is None else min(bins, _MOST_BINS))
        dimensions = (f"{name}_x_bin", f"{name}_y_bin")
        edges = (histogram.x_edges, histogram.y_edges)
        for dimension, edge, quantity, unit in zip(dimensions, edges, joint.names, joint.units, strict=True):
            add_bins(dimension, edge, quantity, unit)
        counted = f"number of pairs of {joint.names[0]} and {joint.names[1]}"
        variables[f"{name}_count_in_bin"] = variable(dimensions, histogram.counts, counted, "1")

    # The share of samples and the means of the 1st, 2nd, ... stick, and slip.
    numbers = list(range(1, statistics.orders + 1))
    coordinates["order"] = variable("order", numbers, "number of the stick or slip", "1")
    sticks, slips = ([of.order(number) for number in numbers] for of in (statistics, statistics.slips))
    shares = [one.share for one in sticks]
    add_estimates("share_by_order", "order", shares, "share of samples that have the stick", "1")
    by_order = [(sticks, one, f"{one.short_label} of the stick") for one in statistics.known(STICK_QUANTITIES)]
    by_order += [(slips, one, one.label) for one in SLIP_QUANTITIES]
    for orders, quantity, label in by_order:
        means, unit = [one.distributions[quantity.name].mean for one in orders], statistics.unit_of(quantity)
        add_estimates(f"{quantity.name}_by_order", "order", means, f"mean {label}", unit)

    endings = statistics.endings
    add_estimates("ending_share", "ending", list(endings.values()), "share of sticks by ending", "1")
    names = [ending.name for ending in endings]
    coordinates["ending"] = ("ending", names, {"long_name": "how the stick ended"})
    return labeled_dataset(variables, coordinates, {"samples": statistics.samples, "duration_s": float(statistics.t1)})
