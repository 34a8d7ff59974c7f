"""The statistics of the sticks and slips of an ensemble, by quantity and by order."""

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np

from .. import _checks
from .._events.stick_stream import StickStream
from .._events.sticks import FlatSticks
from .._numerics.dyadic import DyadicCounts
from .._numerics.power_sums import PowerSums
from .._status import Ending
from .accumulator import SAMPLE_QUANTITIES, Numbering, StickAccumulator
from .clusters import Clusters
from .distribution import DEFAULT_BINS, Distribution
from .estimate import Estimate
from .joint import JointDistribution, pearson_of
from .labelled import dataset_of_statistics
from .source import FEATURES, require_ensemble
from .stick_sums import PAIRS, QUANTITIES

_NAMES = {
    "start": ("stick start", "s"),
    "duration": ("stick duration", "s"),
    "position": ("stick position", "m"),
    "slip_before": ("duration of the slip before the stick", "s"),
    "stick_count": ("number of sticks", "1"),
    "slip_count": ("number of slips", "1"),
    "stick_fraction": ("stick fraction", "1"),
}
_OF_A_STICK = (*QUANTITIES, "slip_before")


def statistics_of_ensemble(ensemble: Any) -> "EnsembleStatistics":
    """All statistics of an ensemble that was simulated with ``keep="statistics"`` or ``"sticks"``.

    Raises ValueError for any other argument.
    """
    ensemble = require_ensemble(ensemble)
    sticks = ensemble.finished_sticks()  # refuses an ensemble that has none
    position = ensemble.system.stick_position.unit
    return EnsembleStatistics(
        ensemble.accumulator, sticks, ensemble.retained.features, ensemble.t1, position, ensemble.numbering
    )


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class EnsembleStatistics:
    """Statistics of the sticks and slips of the samples that finished.

    Sticks cut by the horizon count with the part seen (`endings` tells how many they are), and so do slips. A sample
    without sticks enters what is told of samples, and no distribution of sticks.
    """

    accumulator: StickAccumulator
    sticks: FlatSticks
    features: np.ndarray
    t1: float
    position_unit: str
    numbering: Numbering

    @property
    def samples(self) -> int:
        """Number of samples that finished."""
        return int(self.accumulator.samples.number)

    @property
    def orders(self) -> int:
        """The statistics tell of the 1st, 2nd, ..., up to so many-th stick."""
        return self.numbering.orders

    @cached_property
    def start(self) -> Distribution:
        """Start instants of all sticks, s."""
        return self._of_sticks("start")

    @cached_property
    def duration(self) -> Distribution:
        """Durations of all sticks, s."""
        return self._of_sticks("duration")

    @cached_property
    def position(self) -> Distribution:
        """Positions at the start of all sticks, m (of a motor its angle, rad)."""
        return self._of_sticks("position")

    @cached_property
    def slip_duration(self) -> Distribution:
        """Durations of all slips, s."""
        sticks = StickStream.of(self.sticks)
        before, after = sticks.slip, sticks.slip_after(self.t1)
        owner = np.concatenate([self.sticks.sample, np.arange(len(after))])
        values = np.concatenate([before, after])
        slips = values > 0
        clusters = self._clusters(values[slips], owner[slips])
        return self._distribution("slip duration", "s", self.accumulator.slips, 0, self.accumulator.slip_bins, clusters)

    @cached_property
    def stick_count(self) -> Distribution:
        """Number of sticks of each sample."""
        return self._of_samples("stick_count")

    @cached_property
    def slip_count(self) -> Distribution:
        """Number of slips of each sample."""
        return self._of_samples("slip_count")

    @cached_property
    def stick_fraction(self) -> Distribution:
        """Share of ``[0, t1]`` that each sample spends sticking."""
        return self._of_samples("stick_fraction")

    @cached_property
    def own_mean_duration(self) -> Distribution:
        """The mean stick duration of each sample that has sticks, s. Its mean is the mean of realisation means."""
        time, count = (self.features[:, FEATURES.index(name)] for name in ("stick_time", "stick_count"))
        has = count > 0
        clusters = self._clusters(time[has] / count[has], np.flatnonzero(has))
        name = "mean stick duration of a sample"
        return self._distribution(name, "s", self.accumulator.own_mean, 0, self.accumulator.own_mean_bins, clusters)

    @property
    def endings(self) -> dict[Ending, Estimate]:
        """Share of all sticks that ended in each way."""
        counts, total = self.accumulator.endings, self.accumulator.endings.sum()
        clusters = self._clusters(self.sticks.ending, self.sticks.sample)
        errors = clusters.errors_of_shares(self.sticks.ending.astype(np.int64), len(counts))
        return {
            ending: Estimate(
                f"share of sticks {ending.name}",
                float(counts[ending] / total) if total else np.nan,
                float(errors[ending]),
                "1",
                self.samples,
            )
            for ending in Ending
        }

    def order(self, number: int) -> "OrderStatistics":
        """Statistics of the `number`-th stick of each sample that has so many.

        Raises ValueError unless ``1 <= number <= orders``.
        """
        if _checks.whole_number("number", number) > self.orders:
            raise ValueError(
                f"Argument number must be at most {self.orders}, but {number} was given; "
                f"call simulate_ensemble(..., orders={number})."
            )
        skipped = self.numbering.skipped(self.sticks)
        has = self.sticks.count - skipped >= number
        at = (self.sticks.first + skipped + number - 1)[has]
        sums = self.accumulator.by_order.one(number - 1)

        def distribution(name: str) -> Distribution:
            index = QUANTITIES.index(name)
            clusters = self._clusters(self._column(name)[at], np.flatnonzero(has))
            bins = _one_of(self.accumulator.order_bins[index], number - 1)
            label = f"{_ordinal(number)} {_NAMES[name][0]}"
            return self._distribution(label, self._unit(name), sums, index, bins, clusters)

        share = int(sums.number) / self.samples if self.samples else np.nan
        error = np.sqrt(share * (1 - share) / (self.samples - 1)) if self.samples > 1 else np.nan
        label = f"share of samples that have a {_ordinal(number)} stick"
        return OrderStatistics(
            number, Estimate(label, share, float(error), "1", self.samples), *map(distribution, QUANTITIES)
        )

    def joint(self, x: str, y: str) -> JointDistribution:
        """The joint distribution of two quantities of a stick.

        - `x`, `y`: "start", "duration", "position" or "slip_before" (duration of the slip before it) of the same stick;
          or, of two sticks of one sample, with their numbers: "duration 1" and "duration 2" are the durations of the
          first and of the second.

        ("duration", "position"), ("start", "duration") and ("duration 1", "duration 2") were summed over all samples;
        any other pair rests on the samples retained. Raises ValueError for other names.
        """
        (name_x, order_x), (name_y, order_y) = _parsed("x", x), _parsed("y", y)
        if (order_x is None) != (order_y is None):
            raise ValueError(
                "Arguments x and y must both tell the number of the stick, such as 'duration 1', or none of them, but "
                f"{x!r} and {y!r} were given."
            )
        if order_x is None or order_y is None:
            values, owner = (self._column(name_x), self._column(name_y)), self.sticks.sample
        else:
            skipped = self.numbering.skipped(self.sticks)
            has = self.sticks.count - skipped >= max(order_x, order_y)
            first, owner = (self.sticks.first + skipped)[has] - 1, np.flatnonzero(has)
            values = (self._column(name_x)[first + order_x], self._column(name_y)[first + order_y])
        bins, correlation, of_all = self._streamed(x, y)
        columns = [self._clusters(column, owner, of_all=of_all) for column in values]
        units = (self._unit(name_x), self._unit(name_y))
        return JointDistribution((x, y), units, columns[0], columns[1], bins, correlation)

    def to_xarray(self, bins: int = DEFAULT_BINS) -> Any:
        """Moments, quantiles, histograms, joint histograms and means by order as an ``xarray.Dataset`` with units.

        - `bins`: at most, of each histogram. Needs the extra ``study`` (else ImportError).
        """
        return dataset_of_statistics(self, bins)

    def _streamed(self, x: str, y: str) -> tuple[DyadicCounts | None, float | None, bool]:
        """Histogram and correlation of a pair, if they were summed over all samples."""
        if (x, y) == ("duration 1", "duration 2"):
            return self.accumulator.first_two_bins, pearson_of(self.accumulator.first_two, 0, 1), True
        if (x, y) in PAIRS:
            places = (QUANTITIES.index(x), QUANTITIES.index(y))
            return self.accumulator.pair_bins[PAIRS.index((x, y))], pearson_of(self.accumulator.sticks, *places), True
        return None, None, False

    def _of_sticks(self, name: str) -> Distribution:
        index = QUANTITIES.index(name)
        clusters = self._clusters(self._column(name), self.sticks.sample)
        label = _NAMES[name][0]
        bins = self.accumulator.stick_bins[index]
        return self._distribution(label, self._unit(name), self.accumulator.sticks, index, bins, clusters)

    def _of_samples(self, name: str) -> Distribution:
        index = SAMPLE_QUANTITIES.index(name)
        if name == "stick_fraction":
            values = self.features[:, FEATURES.index("stick_time")] / self.t1
        else:
            values = self.features[:, FEATURES.index(name)]
        clusters = self._clusters(values, np.arange(len(values)))
        label, unit = _NAMES[name]
        bins, whole = self.accumulator.sample_bins[index], name != "stick_fraction"
        return self._distribution(label, unit, self.accumulator.samples, index, bins, clusters, whole)

    def _distribution(
        self, name: str, unit: str, sums: PowerSums, index: int, bins: DyadicCounts, clusters: Clusters,
        is_whole: bool = False,
    ) -> Distribution:  # fmt: skip
        one = slice(index, index + 1)
        own = PowerSums(
            sums.number, sums.mean[one], sums.scatter[one, one], sums.third[one], sums.smallest[one], sums.largest[one]
        )
        number = int(sums.number)
        ends = (float(own.smallest[0]), float(own.largest[0])) if number else (np.nan, np.nan)
        largest = max(self.t1, np.abs(ends).max()) if number else self.t1
        round_off = 4 * float(np.finfo(self.sticks.start.dtype).eps) * float(largest)
        return Distribution(name, unit, number, self.samples, *ends, own, bins, clusters, round_off, is_whole)

    def _clusters(self, values: np.ndarray, owner: np.ndarray, of_all: bool = True) -> Clusters:
        retained = len(self.features)
        return Clusters(values, owner, retained, self.samples if of_all else retained)

    def _column(self, name: str) -> np.ndarray:
        if name == "slip_before":
            return np.asarray(StickStream.of(self.sticks).slip, np.float64)
        return np.asarray(getattr(self.sticks, name), np.float64)

    def _unit(self, name: str) -> str:
        return self.position_unit if name == "position" else _NAMES[name][1]


@dataclasses.dataclass(frozen=True, eq=False)
class OrderStatistics:
    """Statistics of the `number`-th stick, over the samples that have it; `share`: how many these are."""

    number: int
    share: Estimate
    start: Distribution
    duration: Distribution
    position: Distribution


def _one_of(bins: DyadicCounts, index: int) -> DyadicCounts:
    return bins._replace(counts=bins.counts[index])


def _ordinal(number: int) -> str:
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"


def _parsed(argument: str, text: Any) -> tuple[str, int | None]:
    """A quantity of a stick, and the number of the stick if there is one."""
    name, _, number = text.partition(" ") if isinstance(text, str) else ("", "", "")
    if name not in _OF_A_STICK or (number and not (number.isdecimal() and int(number) > 0)):
        raise ValueError(
            f"Argument {argument} must be one of {', '.join(map(repr, _OF_A_STICK))}, or of these with the number of "
            f"the stick such as 'duration 1', but {_checks.show(text)} was given."
        )
    return name, int(number) if number else None
