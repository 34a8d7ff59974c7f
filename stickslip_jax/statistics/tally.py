"""All that the statistics of an ensemble need of its sticks, summed while they stream by.

Tallies of parts of an ensemble are merged exactly: sums of deviations by the rules of Chan and Pebay, histograms by
adding. What they come to does not depend, but for round-off, on how the samples were cut into parts.
"""

from typing import Any, NamedTuple

import numpy as np

from .._status import Ending
from ..events import FlatSticks
from ..numerics.dyadic import Axis, DyadicCounts
from ..numerics.power_sums import PowerSums

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

    def of(self, sticks: FlatSticks) -> tuple[np.ndarray, np.ndarray]:
        """Where the numbered sticks of each sample begin, and how many it has, (samples,) each."""
        skipped = 0 if self.count_initial_rest else sticks.begins_at_zero
        return sticks.first + skipped, sticks.count - skipped


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
        cls, sticks: FlatSticks, stick_time: np.ndarray, slips: np.ndarray, t1: float, numbering: "Numbering"
    ) -> "StickTally":
        """Of finished samples: their sticks, total stick time (s) and number of slips, (samples,) each."""
        columns = _columns(sticks)
        stick_bins, pair_bins = _stick_bins(columns)
        slip = np.asarray(slip_durations(sticks, t1), np.float64)
        fraction = np.asarray(stick_time, np.float64) / t1
        has = sticks.count > 0
        own_mean = fraction[has] * t1 / sticks.count[has]
        counts = (sticks.count, np.asarray(slips, np.int64))
        by_order, order_bins = _of_orders(sticks, columns, numbering)
        first, number = numbering.of(sticks)
        two = first[number > 1]
        first_two = (columns[1][two], columns[1][two + 1])
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


def slip_durations(sticks: FlatSticks, t1: float) -> np.ndarray:
    """How long each slip lasts, s: those before the sticks in their order, then the last slip of each sample."""
    before, after = slips_of(sticks, t1)
    return np.concatenate([before[before > 0], after[after > 0]])


def slips_of(sticks: FlatSticks, t1: float) -> tuple[np.ndarray, np.ndarray]:
    """Duration of the slip before each stick, (sticks,), and of the one after each sample's last, (samples,); in s.

    It is 0 where a sample begins or ends with a stick: there is no slip then.
    """
    has, first = sticks.count > 0, sticks.first
    since = np.empty_like(sticks.end)
    since[1:] = sticks.end[:-1]
    since[first[has]] = 0
    last = np.zeros(len(sticks.count), sticks.end.dtype)
    last[has] = sticks.end[(first + sticks.count - 1)[has]]
    return sticks.start - since, np.maximum(last.dtype.type(t1) - last, 0)


def _columns(sticks: FlatSticks) -> tuple[np.ndarray, ...]:
    """Start, duration and position of every stick, as `QUANTITIES`."""
    start, end = (np.asarray(column, np.float64) for column in (sticks.start, sticks.end))
    return start, end - start, np.asarray(sticks.position, np.float64)


def _stick_bins(columns: tuple[np.ndarray, ...]) -> tuple[tuple[DyadicCounts, ...], tuple[DyadicCounts, ...]]:
    """The histograms of each quantity and of the pairs."""
    if len(columns[0]) == 0:
        one, two = DyadicCounts.none(1, BINS), DyadicCounts.none(2, BINS_OF_PAIRS)
        return (one,) * len(columns), (two,) * len(PAIRS)
    axes = {name: Axis.of(column, BINS) for name, column in zip(QUANTITIES, columns, strict=True)}
    coarse = {name: Axis.within(*axis[:3], BINS_OF_PAIRS) for name, axis in axes.items()}
    singles = tuple(DyadicCounts.on_axes((axes[name],), BINS) for name in QUANTITIES)
    return singles, tuple(DyadicCounts.on_axes((coarse[x], coarse[y]), BINS_OF_PAIRS) for x, y in PAIRS)


def _of_orders(
    sticks: FlatSticks, columns: tuple[np.ndarray, ...], numbering: Numbering
) -> tuple[PowerSums, tuple[DyadicCounts, ...]]:
    """Sums and histograms of the 1st, 2nd, ... stick of each sample."""
    (first, number), orders = numbering.of(sticks), numbering.orders
    at = [(first + order)[number > order] for order in range(orders)]
    sums = PowerSums.stacked([PowerSums.of(*(column[found] for column in columns)) for found in at])
    group, every = np.repeat(np.arange(orders), [len(found) for found in at]), np.concatenate(at)
    bins = tuple(DyadicCounts.of_groups(column[every], group, orders, BINS_BY_ORDER) for column in columns)
    return sums, bins
