"""All that the statistics of an ensemble need of its sticks, summed while they stream by.

Tallies of parts of an ensemble are merged exactly: sums of deviations by the rules of Chan and Pebay, histograms by
adding. What they come to does not depend, but for round-off, on how the samples were cut into parts.
"""

from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from .._events.stick_stream import StickStream
from .._numerics import loops
from .._numerics.dyadic import DyadicCounts
from .._numerics.power_sums import PowerSums
from .._status import Ending
from . import stick_sums
from .stick_sums import BINS

MOST_ORDERS = 1000  # each has histograms of its own, of 24 kB

SAMPLE_QUANTITIES = ("stick_count", "slip_count", "stick_fraction")
"""What is told of each sample."""


class Numbering(NamedTuple):
    """Which stick of a sample is the 1st, 2nd, ...; statistics are told up to the `orders`-th.

    `count_initial_rest`: whether one that begins at t = 0 is the first; else the next one is.
    """

    orders: int
    count_initial_rest: bool

    def skipped(self, sticks: Any) -> np.ndarray:
        """How many sticks of each sample are not numbered, (samples,); of `FlatSticks` or `StickStream`."""
        begins = sticks.begins_at_zero
        return np.zeros_like(begins, int) if self.count_initial_rest else begins.astype(int)


class StickAccumulator(NamedTuple):
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
        cls, sticks: StickStream, stick_time: np.ndarray, slips: np.ndarray, t1: float, numbering: Numbering
    ) -> "StickAccumulator":
        """Of finished samples: their sticks, total stick time (s) and number of slips, (samples,) each."""
        fraction = np.asarray(stick_time, np.float64) / t1
        has = sticks.count > 0
        own_mean = fraction[has] * t1 / sticks.count[has]
        counts = (sticks.count, np.asarray(slips, np.int64))
        by = _way()
        return cls(
            **by.sums_of_sticks(sticks, t1)._asdict(),
            **by.sums_of_orders(sticks, numbering.skipped(sticks), numbering.orders)._asdict(),
            samples=PowerSums.of(*counts, fraction),
            sample_bins=(*(DyadicCounts.of(one, BINS, finest=0) for one in counts), DyadicCounts.of(fraction, BINS)),
            own_mean=PowerSums.of(own_mean),
            own_mean_bins=DyadicCounts.of(own_mean, BINS),
            endings=np.array([np.count_nonzero(sticks.ending == code) for code in Ending]),
        )

    def merge(self, other: "StickAccumulator") -> "StickAccumulator":
        """The tally of both parts together."""
        return StickAccumulator(*(_merged(*pair) for pair in zip(self, other, strict=True)))


def _way() -> ModuleType:
    """What sums the sticks: loops where they can be compiled, or else NumPy."""
    if loops.compiled() is None:
        return stick_sums
    from . import compiled_stick_sums  # noqa: PLC0415 - imports Numba

    return compiled_stick_sums


def _merged(one: Any, other: Any) -> Any:
    if hasattr(one, "merge"):
        return one.merge(other)
    if isinstance(one, tuple):
        return tuple(_merged(*pair) for pair in zip(one, other, strict=True))
    return one + other
