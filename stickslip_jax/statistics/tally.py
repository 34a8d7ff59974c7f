"""All that the statistics of an ensemble need of its sticks, summed while they stream by.

Tallies of parts of an ensemble are merged exactly: sums of deviations by the rules of Chan and Pebay, histograms by
adding. What they come to does not depend, but for round-off, on how the samples were cut into parts.
"""

from typing import Any, NamedTuple

import numpy as np

from .._status import Ending
from ..numerics.dyadic import DyadicCounts
from ..numerics.power_sums import PowerSums
from ..stick_runs import StickRuns

BINS = 8192  # at most, of each quantity: fine enough to read quantiles off
BINS_BY_ORDER = 1024
BINS_OF_PAIRS = 128  # at most, along each axis

QUANTITIES = ("start", "duration", "position")
"""What is told of each stick."""
SAMPLE_QUANTITIES = ("stick_count", "slip_count", "stick_fraction")
"""What is told of each sample."""
PAIRS = (("duration", "position"), ("start", "duration"))
"""Whose joint histograms are streamed; and that of the durations of the first two sticks."""


class Numbering(NamedTuple):
    """Which stick of a sample is the 1st, 2nd, ...; statistics are told up to the `orders`-th.

    `count_initial_rest`: whether one that begins at t = 0 is the first; else the next one is.
    """

    orders: int
    count_initial_rest: bool

    def skipped(self, sticks: Any) -> np.ndarray:
        """How many sticks of each sample are not numbered, (samples,); of `FlatSticks` or `StickRuns`."""
        begins = sticks.begins_at_zero
        return np.zeros_like(begins, int) if self.count_initial_rest else begins.astype(int)


class StickTally(NamedTuple):
    """Sums and histograms of the sticks and slips of finished samples. Times in s.

    - `sticks`, `stick_bins`: of all sticks, by `QUANTITIES`. `slips`, `slip_bins`: of the durations of all slips.
    - `samples`, `sample_bins`: of all samples, by `SAMPLE_QUANTITIES`. `own_mean`, `own_mean_bins`: of the mean stick
      duration of each sample that has sticks.
    - `by_order`, `order_bins`: of the 1st, 2nd, ... stick of each sample that has it, one entry an order.
    - `pair_bins`: of `PAIRS`. `first_two`, `first_two_bins`: of the durations of the first and the second stick.
    - `endings`: number of sticks by `Ending`.
    """

    sticks: PowerSums
    stick_bins: tuple[DyadicCounts, ...]
    slips: PowerSums
    slip_bins: DyadicCounts
    samples: PowerSums
    sample_bins: tuple[DyadicCounts, ...]
    own_mean: PowerSums
    own_mean_bins: DyadicCounts
    by_order: PowerSums
    order_bins: tuple[DyadicCounts, ...]
    pair_bins: tuple[DyadicCounts, ...]
    first_two: PowerSums
    first_two_bins: DyadicCounts
    endings: np.ndarray

    @classmethod
    def of(
        cls, sticks: StickRuns, stick_time: np.ndarray, slips: np.ndarray, t1: float, numbering: Numbering
    ) -> "StickTally":
        """Of finished samples: their sticks, total stick time (s) and number of slips, (samples,) each."""
        columns = _columns(sticks)
        stick_bins, pair_bins = _stick_bins(columns)
        slip = _slip_durations(sticks, t1)
        fraction = np.asarray(stick_time, np.float64) / t1
        has = sticks.count > 0
        own_mean = fraction[has] * t1 / sticks.count[has]
        counts = (sticks.count, np.asarray(slips, np.int64))
        skipped = numbering.skipped(sticks)
        at = [sticks.at_order(order, skipped) for order in range(max(numbering.orders, 2))]
        by_order, order_bins = _of_orders(columns, at[: numbering.orders])
        has_first = sticks.count > skipped
        first_two = tuple(columns[1][found] for found in (at[0][(sticks.count - skipped)[has_first] > 1], at[1]))
        return cls(
            sticks=PowerSums.of(*columns),
            stick_bins=stick_bins,
            slips=PowerSums.of(slip),
            slip_bins=DyadicCounts.of(slip, BINS),
            samples=PowerSums.of(*counts, fraction),
            sample_bins=(*(DyadicCounts.of(one, BINS, finest=0) for one in counts), DyadicCounts.of(fraction, BINS)),
            own_mean=PowerSums.of(own_mean),
            own_mean_bins=DyadicCounts.of(own_mean, BINS),
            by_order=by_order,
            order_bins=order_bins,
            pair_bins=pair_bins,
            first_two=PowerSums.of(*first_two),
            first_two_bins=DyadicCounts.of_columns(first_two, BINS_OF_PAIRS),
            endings=np.bincount(sticks.ending, minlength=len(Ending)),
        )

    def merge(self, other: "StickTally") -> "StickTally":
        """The tally of both parts together."""
        return StickTally(*(_merged(*pair) for pair in zip(self, other, strict=True)))


def _merged(one: Any, other: Any) -> Any:
    if hasattr(one, "merge"):
        return one.merge(other)
    if isinstance(one, tuple):
        return tuple(_merged(*pair) for pair in zip(one, other, strict=True))
    return one + other


def _slip_durations(sticks: StickRuns, t1: float) -> np.ndarray:
    """How long each slip lasts, s, in any order."""
    before, after = (np.asarray(durations, np.float64) for durations in sticks.slips(t1))
    if np.any(sticks.begins_at_zero):
        before = before[before > 0]
    return np.concatenate([before, after[after > 0]])


def _columns(sticks: StickRuns) -> tuple[np.ndarray, ...]:
    """Start, duration and position of every stick, as `QUANTITIES`."""
    start, end = (np.asarray(column, np.float64) for column in (sticks.start, sticks.end))
    return start, end - start, np.asarray(sticks.position, np.float64)


def _stick_bins(columns: tuple[np.ndarray, ...]) -> tuple[tuple[DyadicCounts, ...], tuple[DyadicCounts, ...]]:
    """The histograms of each quantity and of the pairs."""
    if len(columns[0]) == 0:
        one, two = DyadicCounts.none(1, BINS), DyadicCounts.none(2, BINS_OF_PAIRS)
        return (one,) * len(columns), (two,) * len(PAIRS)
    return DyadicCounts.of_pairs(dict(zip(QUANTITIES, columns, strict=True)), PAIRS, BINS, BINS_OF_PAIRS)


def _of_orders(columns: tuple[np.ndarray, ...], at: list[np.ndarray]) -> tuple[PowerSums, tuple[DyadicCounts, ...]]:
    """Sums and histograms of the 1st, 2nd, ... stick of each sample; `at`: where those of each order stand."""
    orders = len(at)
    sums = PowerSums.stacked([PowerSums.of(*(column[found] for column in columns)) for found in at])
    group, every = np.repeat(np.arange(orders), [len(found) for found in at]), np.concatenate(at)
    bins = tuple(DyadicCounts.of_groups(column[every], group, orders, BINS_BY_ORDER) for column in columns)
    return sums, bins
