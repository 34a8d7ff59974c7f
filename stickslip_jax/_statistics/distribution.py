"""The distribution of one quantity: moments, quantiles, histogram, entropy, each with its standard error; and of two
together.
"""

import dataclasses
import math
import textwrap
from collections.abc import Hashable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .._foundation import checks, html
from .._numerics.sums import CommonBins, DyadicCounts, PowerSums, joined_bins
from .estimate import Estimate, RatioOfMeans

# Values, and pairs of values, that occur again and again: the atoms of a distribution.


# Values that repeat have more than _REPEATS others within round-off, and are either _DENSER times as dense as an
# interval around them that is _WIDER times as wide (where the density is singular like the inverse of a square root,
# the ratio is only 7), or _FAR_DENSER times as dense as values spread evenly over the range.
_REPEATS = 10
_WIDER, _DENSER = 32, 10
_FAR_DENSER = 1000
_SHARE_OF_RANGE = 1e-9
_LEAST_SHARE = 1e-3  # of all pairs: what is rarer is not told apart as an atom


class Atoms(NamedTuple):
    """Points that have a probability of their own, the most frequent first.

    - `x`, `y`: where they are, (atoms,). `share` of all pairs at each, (atoms,).
    - `of_pair`: which pairs are at one of them, (pairs,).
    """

    x: Float[np.ndarray, " atoms"]
    y: Float[np.ndarray, " atoms"]
    share: Float[np.ndarray, " atoms"]
    of_pair: Bool[np.ndarray, " pairs"]


def repeated(values: np.ndarray, round_off: float, span: float) -> np.ndarray:
    """Which of `values` have more than `_REPEATS` others within round-off, (values,); `span`: from least to largest.

    They must also be far denser than their surroundings, because in float32 millions of values are close by chance; or
    so dense that no smooth density explains it, because motion that becomes periodic leaves atoms side by side.
    """
    within, ranked = _within(round_off, span), np.sort(values)

    def number_within(distance: float) -> np.ndarray:
        below = np.searchsorted(ranked, values - distance, side="left")
        return np.searchsorted(ranked, values + distance, side="right") - below

    near = number_within(within)
    around = (number_within(_WIDER * within) - near) / (_WIDER - 1)
    usual = len(values) * 2 * within / max(span, within)  # if all were spread evenly
    return (near > _REPEATS) & ((near > _DENSER * around) | (near > _FAR_DENSER * usual))


def atoms_of(x: np.ndarray, y: np.ndarray, round_off: tuple[float, float]) -> Atoms:
    """The atoms of the pairs `x`, `y` (pairs,): points with more than 10 pairs and 0.1 % of them all.

    Both values of such a pair are `repeated`. `round_off`: of x and of y.
    """
    spans = [float(np.ptp(values)) if len(values) else 0.0 for values in (x, y)]
    axes = list(zip((x, y), round_off, spans, strict=True))
    both = np.flatnonzero(np.logical_and(*(repeated(*axis) for axis in axes)))
    # The group that each value belongs to: neighbours no farther apart than `_within` share one.
    place = np.empty((2, len(both)), int)
    for group, (values, off, span) in zip(place, axes, strict=True):
        order = np.argsort(values[both], kind="stable")
        ranked = values[both[order]]
        group[order] = np.cumsum(np.diff(ranked, prepend=ranked[:1]) > _within(off, span))
    _, first, pair, counts = np.unique(place, axis=1, return_index=True, return_inverse=True, return_counts=True)
    atoms = np.flatnonzero(counts > max(_REPEATS, _LEAST_SHARE * len(x)))
    atoms = atoms[np.argsort(-counts[atoms], kind="stable")]
    of_pair = np.zeros(len(x), bool)
    of_pair[both[np.isin(pair.ravel(), atoms)]] = True
    here = both[first[atoms]]
    return Atoms(x[here], y[here], counts[atoms] / max(len(x), 1), of_pair)


def _within(round_off: float, span: float) -> float:
    return max(round_off, _SHARE_OF_RANGE * span, float(np.finfo(float).tiny))


# Standard errors of statistics of pooled sticks: realisations are independent, the sticks of one are not.
#
# A statistic is a function of averages over all sticks; to first order its error is the average of one influence value
# for each stick. The influence values of one realisation are summed, and the spread of these sums over realisations is
# the error (the linearised, "sandwich" error of a ratio of totals; Cochran, Sampling Techniques, 1977, chapter 6).


class Clusters:
    """Values of the retained realisations of an ensemble.

    - `values`: (number,). `owner`: the realisation of each value, (number,).
    - `realizations`: number of retained ones, those without any value included.
    - `of_all`: number of realisations that the statistic is from. Errors are measured on the retained ones and scaled.
    """

    def __init__(self, values: np.ndarray, owner: Int[np.ndarray, " number"], realizations: int, of_all: int):
        self.values = np.asarray(values, np.float64)
        self.owner, self.realizations, self.of_all = owner, realizations, of_all

    @property
    def scale(self) -> float:
        """Factor from the standard deviation of sums over realisations to a standard error.

        NaN for fewer than two realisations with values.
        """
        if self.realizations < 2 or len(self.values) < 2 or self.owner.min() == self.owner.max():
            return math.nan
        return self.realizations / len(self.values) / math.sqrt(self.of_all)

    def error(self, influence: Float[np.ndarray, " number"]) -> float:
        """The standard error of a statistic with these influence values."""
        if math.isnan(self.scale):
            return math.nan
        sums = np.bincount(self.owner, weights=influence, minlength=self.realizations)
        return float(sums.std(ddof=1)) * self.scale

    def of_mean(self, mean: float) -> RatioOfMeans:
        """What the interval of the `mean` needs, which is the ratio of the sum of all values to their number."""
        if math.isnan(self.scale):
            return RatioOfMeans(math.nan, math.nan)
        each, sums = (np.bincount(self.owner, weights, self.realizations) for weights in (None, self.values - mean))
        together = np.cov(each, sums) * self.scale**2
        return RatioOfMeans(float(together[0, 0]), float(together[0, 1]))

    def errors_of_shares(self, bins: Int[np.ndarray, " values"], number: int) -> Float[np.ndarray, " bins"]:
        """The standard errors of the shares of values in bins 0, 1, ..., `number` - 1.

        `bins`: the bin of each value; below 0 for none.
        """
        if math.isnan(self.scale):
            return np.full(number, math.nan)
        each = np.bincount(self.owner, minlength=self.realizations).astype(float)
        inside = bins >= 0
        cells, counts = np.unique(self.owner[inside] * number + bins[inside], return_counts=True)
        cell, owner = cells % number, cells // number
        # Sums over realisations of the count in a bin c, of c^2 and of c times the count in all bins n.
        total, square, product = (
            np.bincount(cell, weights=weights, minlength=number)
            for weights in (counts, counts.astype(float) ** 2, counts * each[owner])
        )
        share = total / len(self.values)
        spread = square - 2 * share * product + share**2 * (each @ each)  # sum of (c - share n)^2, whose mean is 0
        return np.sqrt(np.maximum(spread, 0) / (self.realizations - 1)) * self.scale


# The distribution of one quantity: moments, quantiles, histogram, entropy, each with its standard error.


DEFAULT_BINS = 50
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)  # of quantiles in data sets
BINS = 8192  # at most, of each quantity: fine enough to read quantiles off
_MOST_BINS = 2**31
_MOST_SPACINGS = 100_000  # number of values for the entropy without bins: its error is small by then


@dataclasses.dataclass(frozen=True, eq=False)
class Histogram:
    """Counts of `number` values between consecutive `edges` (bins + 1,), and the probability density they estimate.

    `counts`, `density` (1/unit) and its standard `error`, (bins,). The density times the bin width sums to 1.
    """

    edges: Float[np.ndarray, " edges"]
    counts: Int[np.ndarray, " bins"]
    density: Float[np.ndarray, " bins"]
    error: Float[np.ndarray, " bins"]
    number: int
    unit: str

    @property
    def centers(self) -> Float[np.ndarray, " bins"]:
        """The middle of each bin."""
        return (self.edges[1:] + self.edges[:-1]) / 2


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Distribution:
    """The distribution of a quantity, from `number` values of `samples` finished samples.

    Sums and histograms are those of all values, merged exactly while they streamed by. Standard errors treat samples as
    independent, not the values of one sample; they are measured on the retained samples. Numbers are NaN where there
    is no value, and errors where there is only one sample.

    - `name`, `unit`: of the quantity.
    - `sums`, `bins`: power sums (of vectors of length 1) and finest histogram of all values. `clusters`: the retained
      values.
    - `round_off`: values closer than this may be equal. `is_whole`: whether the values are whole numbers.
    - `origin`: of the random numbers; see `Estimate`.
    """

    name: str
    unit: str
    samples: int
    sums: PowerSums
    bins: DyadicCounts
    clusters: Clusters
    round_off: float = 0.0
    is_whole: bool = False
    origin: Hashable = dataclasses.field(default_factory=object)

    @property
    def number(self) -> int:
        """Number of values."""
        return int(self.sums.number)

    @property
    def smallest(self) -> float:
        """The smallest value, in `unit`."""
        return float(self.sums.smallest[0]) if self.number else math.nan

    @property
    def largest(self) -> float:
        """The largest value, in `unit`."""
        return float(self.sums.largest[0]) if self.number else math.nan

    @property
    def mean(self) -> Estimate:
        """The mean of all values."""
        value = float(self.sums.mean[0])
        error = self.clusters.error(self.clusters.values - value)
        return dataclasses.replace(self._estimate("mean", value, error), kind=self.clusters.of_mean(value))

    @property
    def variance(self) -> Estimate:
        """The variance of all values (over ``number - 1``), unit squared."""
        value, deviation = float(self.sums.variance[0]), self.clusters.values - self.sums.mean[0]
        unit = self.unit if self.unit == "1" else f"{self.unit}^2"
        return self._estimate("variance", value, self.clusters.error(deviation**2 - value), unit)

    @property
    def standard_deviation(self) -> Estimate:
        """The square root of the variance."""
        variance = self.variance
        value = math.sqrt(variance.value) if variance.value >= 0 else math.nan
        error = variance.standard_error / (2 * value) if value > 0 else math.nan
        return self._estimate("standard deviation", value, error)

    @property
    def skewness(self) -> Estimate:
        """The third central moment over the cube of the standard deviation; NaN where all values are equal.

        Its standard error holds for many values without heavy tails. With heavy tails it is too small, because the
        largest values determine skewness and error, and most runs have none of them: for 2,000 values in 400 clusters
        it is 0.87 of the spread over runs for exponential values, 0.82 where clusters differ too (log-normal factors of
        spread 0.3), and 0.37 for log-normal values (``log_std`` 1).
        """
        value = float(self.sums.skewness[0])
        if math.isnan(value):
            return self._estimate("skewness", value, value, "1")
        spread = math.sqrt(float(self.sums.scatter[0, 0]) / self.number)
        z = (self.clusters.values - self.sums.mean[0]) / spread
        influence = z**3 - value - 3 * z - 1.5 * value * (z**2 - 1)
        return self._estimate("skewness", value, self.clusters.error(influence), "1")

    def quantile(self, share: float) -> Estimate:
        """The `share`-quantile: the value that a `share` of all values does not exceed.

        Read off a histogram of up to 8192 bins (1024 for a single order), linearly within a bin, so it is accurate to
        `resolution`; for whole numbers it is exact. Its error is that of the share of values below it, converted by the
        distribution function (Woodruff 1952).

        Raises:
            ValueError: Unless ``0 <= share <= 1``.
        """
        checks.numeric("share", share)
        if not 0 <= share <= 1:
            raise ValueError(f"Argument share must lie between 0 and 1, such as 0.5, but {share} was given.")
        name = "median" if share == 0.5 else f"{share:.6g}-quantile"
        if self.number == 0:
            return self._estimate(name, math.nan, math.nan)
        value = self._value_at(share)
        error = self.clusters.error((self.clusters.values <= value) - share)  # of the share
        if math.isnan(error):
            return self._estimate(name, value, error)
        high, low = self._value_at(min(share + error, 1.0)), self._value_at(max(share - error, 0.0))
        return self._estimate(name, value, (high - low) / 2)

    @property
    def median(self) -> Estimate:
        """The 0.5-quantile; see `quantile`."""
        return self.quantile(0.5)

    @property
    def resolution(self) -> float:
        """Width of the finest bins, in `unit`; NaN without values."""
        return math.ldexp(1.0, self.bins.exponent[0]) if self.number else math.nan

    def histogram(self, bins: int | CommonBins | None = None) -> Histogram:
        """The histogram of all values, in at most `bins` bins of equal width, or in the bins of `common_bins`.

        By default 50; of whole numbers, one for each number (up to 8192: beyond, 2, 4, ... numbers share one). Each bin
        is a union of bins of the finest histogram, so that the counts are exact.

        Raises:
            ValueError: Unless `bins` is None, a whole number of at least 1, or bins that hold all values.
        """
        edges, counts = self._joined(bins)
        error = self.clusters.errors_of_shares(bin_of(self.clusters.values, edges), len(counts))
        width = np.diff(edges)
        return Histogram(edges, counts, counts / max(self.number, 1) / width, error / width, self.number, self.unit)

    def entropy(self, bins: int | CommonBins | None = None) -> Estimate:
        """Shannon entropy of the normalised histogram in at most `bins` bins, ``-sum p log p``, nats.

        Of whole numbers it is by default that of the numbers themselves, each in a bin of its own. Else it depends on
        the width of the bins: entropies in the same bins (`common_bins`) can be compared. The shares p of few values
        vary, which makes the sum too small by about (bins with values - 1) / (2 number): that is added (Miller 1955).
        The standard error is that of the entropy in these very bins, as `common_bins` fix them (of 2,000 values in 400
        clusters stated 0.027, spread of runs 0.028). A number of bins makes bins that follow the range of the values:
        in another run they may be twice as wide, and the entropy lower by up to 0.69 nats (spread 0.17 in the same
        runs).

        Raises:
            ValueError: As `histogram`.
        """
        edges, counts = self._joined(bins)
        name = f"entropy of the histogram in {len(counts)} bins"
        if self.is_whole and self.number > 0:
            width = round(edges[1] - edges[0])
            name = "entropy" if width == 1 else f"{name} of {width} numbers each"
        if self.number == 0:
            return self._estimate(name, math.nan, math.nan, "nat")
        surprise, plain = self._surprise(edges, counts)
        return self._estimate(name, entropy_of(counts), self.clusters.error(surprise - plain), "nat")

    @cached_property
    def repeated_share(self) -> Estimate:
        """Share of the retained values that equal others up to round-off: the weight of the atoms of the distribution.

        Atoms occur where something about a sample is certain: a mass that starts from one fixed state and meets its
        base before the first switch begins its first stick at the same point in every such sample.
        """
        if len(self.clusters.values) == 0:
            return self._estimate("share of repeated values", math.nan, math.nan, "1")
        repeated = self._repeated
        value = float(repeated.mean())
        return self._estimate("share of repeated values", value, self.clusters.error(repeated - value), "1")

    @cached_property
    def differential_entropy(self) -> Estimate:
        """Differential entropy of the density f, ``-integral f log f``, nats (values in `unit`); without bins.

        From the spacings of the first 100,000 retained values (Vasicek 1976; `scipy.stats.differential_entropy`).
        Values that repeat (`repeated_share`) have no density and are left out. NaN for whole numbers and for fewer than
        10 values.
        """
        from scipy import stats  # noqa: PLC0415 - slow to load

        name = "differential entropy"
        chosen = np.flatnonzero(~self._repeated)[:_MOST_SPACINGS]
        values = self.clusters.values[chosen]
        if len(values) < 10 or self.is_whole:
            return self._estimate(name, math.nan, math.nan, "nat")
        with np.errstate(divide="ignore"):
            value = float(stats.differential_entropy(values))
        surprise = self._surprise(*self._joined(DEFAULT_BINS))[0][chosen]
        own = Clusters(values, self.clusters.owner[chosen], self.clusters.realizations, self.clusters.realizations)
        return self._estimate(name, value, own.error(surprise - surprise.mean()), "nat")

    @cached_property
    def _repeated(self) -> np.ndarray:
        """Which of the retained values occur again and again, (retained,)."""
        return repeated(self.clusters.values, self.round_off, self.largest - self.smallest)

    def _surprise(self, edges: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, float]:
        """Minus the logarithm of the share of each retained value's bin, (retained,), and its mean over all values."""
        share = counts / self.number
        each = -np.log(np.where(counts > 0, share, 1.0))
        return each[bin_of(self.clusters.values, edges)], float(share @ each)

    def _joined(self, bins: int | CommonBins | None) -> tuple[np.ndarray, np.ndarray]:
        """Edges and counts of at most `bins` bins of equal width, or of the given ones, joined from the finest."""
        bins = default_bins(self.is_whole) if bins is None else bins
        if isinstance(bins, CommonBins):
            if not bins.hold(self.bins):
                raise ValueError(
                    f"Argument bins must hold all values of {self.name}, from {self.smallest:.6g} to "
                    f"{self.largest:.6g} in bins of at least {self.resolution:.3g}, but {bins} was given; make them "
                    "with common_bins of all distributions that are compared."
                )
            return bins.edges, self.bins.in_bins(bins)
        bins = checks.whole_number("bins", bins, maximum=_MOST_BINS)
        if self.number == 0:
            return np.array([0.0, 1.0]), np.zeros(1, np.int64)
        (edges,), counts = joined(self.bins, bins)
        return edges, counts

    def _value_at(self, share: float) -> float:
        counts, edges = self.bins.counts, self.bins.edges()
        below = np.concatenate([[0], np.cumsum(counts)])
        target = share * self.number
        place = min(int(np.searchsorted(below[1:], target, side="left")), len(counts) - 1)
        if self.is_whole and self.bins.exponent[0] <= 0:
            return float(edges[place])
        inside = (target - below[place]) / max(counts[place], 1)
        value = edges[place] + inside * (edges[place + 1] - edges[place])
        return float(np.clip(value, self.smallest, self.largest))

    def _estimate(self, name: str, value: float, error: float, unit: str | None = None) -> Estimate:
        """An estimate, which is not known where there is no value."""
        if self.number == 0:
            value, error = math.nan, math.nan
        unit = self.unit if unit is None else unit
        return Estimate(f"{name} of {self.name}", value, error, unit, self.samples, self.origin)

    def _told(self) -> list[tuple[str, str]]:
        """Name and number of each estimate that describes the distribution."""
        told = (self.mean, self.standard_deviation, self.median, self.skewness, self.entropy())
        if not self.is_whole:
            told = (*told, self.differential_entropy, self.repeated_share)
        return [(one.name.replace(f" of {self.name}", ""), one.without_name()) for one in told]

    def _repr_html_(self) -> str:
        head, *_ = repr(self).splitlines()
        if self.number == 0:
            return html.titled(head)
        ends = [("smallest", f"{self.smallest:.6g}"), ("largest", f"{self.largest:.6g}")]
        rows = [(name, text.replace("+-", "±")) for name, text in [*self._told(), *ends]]
        return html.titled(head) + html.table(rows) + html.small_figure(self)

    def __repr__(self) -> str:
        if self.number == 0:
            return f"{self.name}: no values in {self.samples} samples"
        lines = [f"{self.name}: {self.number:,} values in {self.samples:,} samples"]
        lines += [f"  {name}: {number}" for name, number in self._told()]
        return "\n".join([*lines, f"  from {self.smallest:.6g} to {self.largest:.6g} {self.unit}".removesuffix(" 1")])


def joined(fine: DyadicCounts, most: int) -> tuple[list[np.ndarray], np.ndarray]:
    """The edges along each axis, and the counts, of at most `most` bins of equal width along it, joined from `fine`."""
    counts, edges = fine.counts, []
    for axis, size in enumerate(fine.counts.shape):
        together = joined_bins(size, most)
        counts = np.add.reduceat(counts, np.arange(0, size, together), axis=axis)
        numbers = fine.first[axis] + together * np.arange(counts.shape[axis] + 1)
        edges.append(numbers * math.ldexp(1.0, fine.exponent[axis]))
    return edges, counts


def entropy_of(counts: np.ndarray) -> float:
    """The entropy (nat) of the shares that `counts` are of, without the bias that few counts have (Miller 1955)."""
    number, filled = counts.sum(), counts[counts > 0]
    share = filled / number
    return float(-(share @ np.log(share)) + (len(filled) - 1) / (2 * number))


def bin_of(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """The bin of each value between increasing `edges`, a value on an edge in the bin above; -1 below all bins."""
    return np.searchsorted(edges, values, side="right") - 1


def default_bins(is_whole: bool) -> int:
    """The largest number of bins where none is asked for: of whole numbers, as many as are held."""
    return BINS if is_whole else DEFAULT_BINS


def common_bins(distributions: Sequence[Distribution], bins: int | None = None) -> CommonBins:
    """At most `bins` bins of equal width that hold all values of several distributions of one quantity.

    By default 50; of whole numbers, one for each number. Histograms and entropies in the same bins can be compared.

    Args:
        distributions: A list of them, all in one unit, such as ``many.statistics.duration`` of several ensembles.
        bins: Their number, at most.

    Raises:
        ValueError: For anything but distributions in one unit, with at least one value among them.

    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> settings = {"t1": 50.0, "samples": 500, "key": jax.random.key(0)}
    >>> systems = [ss.papers.belt_oscillator(mu) for mu in (0.5, 1.0)]
    >>> ensembles = [ss.simulate_ensemble(one, law, **settings) for one in systems]
    >>> bins = ss.common_bins([one.statistics.duration for one in ensembles])
    >>> for one in ensembles:
    ...     print(one.statistics.duration.entropy(bins))
    entropy of the histogram in 32 bins of stick duration: 2.7705 +- 0.0017 nat
    entropy of the histogram in 32 bins of stick duration: 3.4213 +- 0.0034 nat
    """
    if bins is not None:
        bins = checks.whole_number("bins", bins, maximum=_MOST_BINS)
    found = list(distributions) if isinstance(distributions, (list, tuple)) else []
    if not found or not all(isinstance(one, Distribution) for one in found) or len({one.unit for one in found}) > 1:
        demand = "be a list of distributions in one unit, such as many.statistics.duration of several ensembles"
        raise checks.refused("distributions", demand, distributions)
    most = default_bins(all(one.is_whole for one in found)) if bins is None else bins
    common = CommonBins.of((one.bins for one in found), most)
    if common is None:
        raise ValueError("Argument distributions must have a value among them, but all of them are empty.")
    return common


# The joint distribution of two quantities: histogram, correlations, mutual information, conditional means.


BINS_OF_PAIRS = 128  # at most, along each axis
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
            return DyadicCounts.none(2, BINS_OF_PAIRS)
        return DyadicCounts.of_columns((self.x.values, self.y.values), BINS_OF_PAIRS)

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
        ranks = [(stats.rankdata(column) - 0.5) / len(x) for column in (x, y)]
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
        bins = checks.whole_number("bins", bins, maximum=BINS_OF_PAIRS)
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


# Sentences in lines.


WIDEST = 100
"""Characters of a line of text: what the pages of the documentation hold, and most windows."""


def wrapped(text: str, indent: str = "", after: str = "") -> str:
    """A sentence in lines of at most `WIDEST` characters, indented; numbers stay beside their names and errors."""
    for sign in ("+-", "=", "<", "%"):
        text = text.replace(f" {sign}", f"\u00a0{sign}")
        text = text if sign == "%" else text.replace(f"{sign} ", f"{sign}\u00a0")
    lines = textwrap.wrap(text, WIDEST, initial_indent=indent, subsequent_indent=after, break_long_words=False)
    return "\n".join(lines).replace("\u00a0", " ")
