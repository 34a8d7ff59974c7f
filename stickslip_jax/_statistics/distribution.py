"""The distribution of one quantity: moments, quantiles, histogram, entropy, each with its standard error; tables of
them.
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
from .estimate import Estimate, RatioOfMeans, format_with_error

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


# Statistics as tables to read, in text and in HTML.


Table = tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...]]
_FIRST = 6  # columns of the first part in text: up to the quantiles
WIDEST = 100
"""Characters of a line of text: what the pages of the documentation hold, and most windows."""
_HEAD = ("", "mean", "std. dev.", "5 %", "median", "95 %", "skewness", "entropy (nat)", "values")


@dataclasses.dataclass(frozen=True, repr=False)
class Summary:
    """The statistics of an ensemble in tables: print it, or show it in a notebook.

    `tables`: each a caption, the heads of the columns, and rows of text. `notes`: sentences below the tables.
    """

    title: str
    tables: tuple[Table, ...]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        parts = [self.title]
        for caption, head, rows in self.tables:
            columns = range(len(head))
            widths = [max(len(row[column]) for row in (head, *rows)) for column in columns]
            # One that has too many columns for a line in two parts, with the names of its rows again.
            groups = [columns] if tuple(head) != _HEAD else [columns[:_FIRST], (0, *columns[_FIRST:])]
            lines = [
                "  ".join(f"{row[column]:{'>' if column else '<'}{widths[column]}}" for column in group).rstrip()
                for group in groups
                for row in (head, *rows)
            ]
            parts.append("\n".join([caption, "-" * max(map(len, lines)), *lines]))
        notes = [wrapped(note) for note in self.notes]
        return "\n\n".join([*parts, "\n".join(notes)] if notes else parts)

    def _repr_html_(self) -> str:
        parts = [html.table(rows, head, caption) for caption, head, rows in self.tables]
        return "".join([html.titled(self.title), *parts, *map(html.escaped, self.notes)])


def table_of(caption: str, distributions: Sequence[Distribution]) -> Table:
    """A table with a row for each of some distributions."""
    rows = []
    for of in distributions:
        unit = "" if of.unit == "1" else f" ({of.unit})"
        others = (of.standard_deviation, of.quantile(0.05), of.median, of.quantile(0.95), of.skewness, of.entropy())
        cells = ("-" if math.isnan(one.value) else f"{one.value:.4g}" for one in others)
        rows.append((f"{of.name}{unit}", shown(of.mean), *cells, f"{of.number:,}"))
    return caption, _HEAD, tuple(rows)


def summary_of_distributions(title: str, distributions: Sequence[Distribution]) -> Summary:
    """One table, a row for each of some distributions."""
    return Summary(title, (table_of("Mean +- standard error", distributions),), ())


def shown(estimate: Estimate) -> str:
    """Value and standard error of an estimate, as far as they are known."""
    if math.isnan(estimate.value):
        return "-"
    if math.isnan(estimate.standard_error):
        return f"{estimate.value:.6g}"
    return format_with_error(estimate.value, estimate.standard_error)


def shown_share(share: Estimate) -> str:
    """A share of the samples in percent with its standard error; or in a word, where all of them are meant."""
    if share.value == 1:
        return "all"
    percent = dataclasses.replace(share, value=100 * share.value, standard_error=100 * share.standard_error)
    return f"{shown(percent)} %"


def wrapped(text: str, indent: str = "", after: str = "") -> str:
    """A sentence in lines of at most `WIDEST` characters, indented; numbers stay beside their names and errors."""
    for sign in ("+-", "=", "<", "%"):
        text = text.replace(f" {sign}", f"\u00a0{sign}")
        text = text if sign == "%" else text.replace(f"{sign} ", f"{sign}\u00a0")
    lines = textwrap.wrap(text, WIDEST, initial_indent=indent, subsequent_indent=after, break_long_words=False)
    return "\n".join(lines).replace("\u00a0", " ")
