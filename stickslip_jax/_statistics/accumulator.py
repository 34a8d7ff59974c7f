"""The accumulator of an ensemble: sums and histograms of its sticks, updated while they stream by.

Accumulators of parts of an ensemble are merged exactly: sums of deviations by the formulas of Chan, Golub and LeVeque
(1983) and Pebay (2008), histograms by adding. Apart from round-off the result does not depend on how the samples were
cut into parts.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .. import _checks
from .._events.stick_stream import StickStream
from .._events.sticks import FlatSticks
from .._numerics.dyadic import DyadicCounts
from .._numerics.power_sums import PowerSums
from .._status import Ending
from .distribution import BINS
from .stick_sums import sums_of_orders, sums_of_sticks

MOST_ORDERS = 1000  # each has histograms of its own, of 24 kB


class Numbering(NamedTuple):
    """Numbering of the sticks of a sample; there are statistics of the 1st to the `orders`-th.

    `count_initial_rest`: whether a stick that begins at t = 0 is the first; else the next one is.
    """

    orders: int
    count_initial_rest: bool

    @classmethod
    def checked(cls, orders: int, count_initial_rest: bool) -> "Numbering":
        """The numbering with these options of `simulate_ensemble`. Raises ValueError for options out of bounds."""
        _checks.truth("count_initial_rest", count_initial_rest)
        return cls(_checks.whole_number("orders", orders, maximum=MOST_ORDERS), bool(count_initial_rest))

    def order_of(self, sticks: FlatSticks) -> Int[np.ndarray, " sticks"]:
        """The number of each stick in its sample, from 1; 0 for one that is not numbered."""
        before = sticks.first + self.skipped(sticks)
        return np.arange(len(sticks.start)) - np.repeat(before, sticks.count) + 1

    def rest(
        self, sticks: FlatSticks | StickStream
    ) -> tuple[Float[np.ndarray, " samples"], Int[np.ndarray, " samples"]]:
        """Duration (s) and number (0 or 1) of the sticks of each sample that are not numbered."""
        skipped = self.skipped(sticks)
        time = np.zeros(len(skipped))
        if np.any(skipped):
            at_zero = np.flatnonzero(sticks.start == 0)
            owner = sticks.owner if isinstance(sticks, StickStream) else sticks.sample
            time[owner[at_zero]] = sticks.end[at_zero]
        return time, skipped

    def skipped(self, sticks: FlatSticks | StickStream) -> Int[np.ndarray, " samples"]:
        """How many sticks of each sample come before its first numbered one: 0 or 1."""
        begins = sticks.begins_at_zero
        return np.zeros_like(begins, int) if self.count_initial_rest else begins.astype(int)


class StickAccumulator(NamedTuple):
    """Sums and histograms of the sticks and slips of finished samples. Times in s. Quantities as in `quantities.py`.

    A stick that begins at t = 0 is left out of all but the numbers and the stick fractions of samples, unless it is
    numbered (see `Numbering`).

    - `sticks`, `stick_bins`: of all sticks, by `STICK_QUANTITIES`. `slips`, `slip_bins`: of the durations of all slips.
    - `samples`, `sample_bins`: of all samples, by `SAMPLE_QUANTITIES`. `own_mean`, `own_mean_bins`: of the mean stick
      duration of each sample that has sticks.
    - `by_order`, `order_bins`: of the 1st, 2nd, ... stick of each sample that has it, with one entry for each order.
    - `pair_bins`: of `STREAMED_PAIRS`. `first_two`, `first_two_bins`: of the durations of the first and second stick.
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
        """The accumulator of finished samples, simulated up to `t1` (s).

        `stick_time`: the total of each sample, s. `slips`: the number of each sample. (samples,)
        """
        fraction = np.asarray(stick_time, np.float64) / t1
        rest, skipped = numbering.rest(sticks)
        numbered = sticks.count - skipped
        has = numbered > 0
        own_mean = (fraction[has] * t1 - rest[has]) / numbered[has]
        at_zero = np.flatnonzero(sticks.start == 0)[: int(np.sum(skipped))]
        endings = [np.count_nonzero(sticks.ending == code) - np.sum(sticks.ending[at_zero] == code) for code in Ending]
        counts = (sticks.count, np.asarray(slips, np.int64))
        return cls(
            **sums_of_sticks(sticks, skipped, t1)._asdict(),
            **sums_of_orders(sticks, skipped, numbering.orders)._asdict(),
            samples=PowerSums.of(*counts, fraction),
            sample_bins=(*(DyadicCounts.of(one, BINS, finest=0) for one in counts), DyadicCounts.of(fraction, BINS)),
            own_mean=PowerSums.of(own_mean),
            own_mean_bins=DyadicCounts.of(own_mean, BINS),
            endings=np.array(endings),
        )

    def merge(self, other: "StickAccumulator") -> "StickAccumulator":
        """The accumulator of both parts together. Raises ValueError for one that a version with other sums stored."""
        if len(self.stick_bins) != len(other.stick_bins):
            raise ValueError(
                f"Ensembles must have sums of the same quantities, but {len(self.stick_bins)} and "
                f"{len(other.stick_bins)} quantities of sticks were summed; simulate the older one again."
            )
        return StickAccumulator(*(_merged(*pair) for pair in zip(self, other, strict=True)))


def _merged(one: Any, other: Any) -> Any:
    if hasattr(one, "merge"):
        return one.merge(other)
    if isinstance(one, tuple):
        return tuple(_merged(*pair) for pair in zip(one, other, strict=True))
    return one + other
