"""The quantities whose distributions are estimated; sums and histograms of them, updated while sticks stream in."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from .._dynamics.sticks import NUMBERS, DeviceSticks, FlatSticks, StickStream
from .._foundation import checks
from .._numerics.sums import CommonBins, DyadicCounts, PowerSums
from .distribution import BINS, BINS_OF_PAIRS
from .estimate import EnsembleLike, require_ensemble

# The quantities whose distributions are estimated: numbers of each stick, of each slip or of each sample.
#
# Each is defined here, once, and every other module reads it from here.


@dataclasses.dataclass(frozen=True)
class SampledQuantity:
    """A number that each stick, each slip or each sample has.

    - `name`: in code and in files. `label`: in tables and figures, in the singular; that of a stick's quantity says
      "stick" once.
    - `unit`: "1" for a number without one; None for a position, whose unit the system gives (m, of a motor rad).
    - `is_whole`: whether the values are whole numbers.
    """

    name: str
    label: str
    unit: str | None
    is_whole: bool = False

    @property
    def short_label(self) -> str:
        """The name as words: "duration"."""
        return self.name.replace("_", " ")

    def label_of_order(self, number: int | None) -> str:
        """The label where it is the `number`-th stick's: "1st stick duration"; or slip's; None: of any one's."""
        if number is None:
            return self.label
        word = "stick" if "stick" in self.label else "slip"
        return self.label.replace(word, f"{ordinal(number)} {word}")

    def axis_label(self, number: int | None) -> str:
        """The label on an axis: "stick duration"; with the `number` of the stick: "duration of stick 1"."""
        if number is None:
            return self.label
        if self.label.endswith(" the stick"):
            return self.label.replace("the stick", f"stick {number}")
        return f"{self.label.removeprefix('stick ')} of stick {number}"


def ordinal(number: int) -> str:
    """1st, 2nd, 3rd, 4th, ..."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"


START = SampledQuantity("start", "stick start", "s")
DURATION = SampledQuantity("duration", "stick duration", "s")
POSITION = SampledQuantity("position", "stick position", None)
SLIP_BEFORE = SampledQuantity("slip_before", "slip before the stick", "s")
SLIP_AFTER = SampledQuantity("slip_duration", "slip after the stick", "s")
SLIP_AFTER_START = SampledQuantity("slip_start", "start of the slip after the stick", "s")
SLIP_START = SampledQuantity("slip_start", "slip start", "s")
SLIP_DURATION = SampledQuantity("slip_duration", "slip duration", "s")
STICK_COUNT = SampledQuantity("stick_count", "number of sticks", "1", is_whole=True)
SLIP_COUNT = SampledQuantity("slip_count", "number of slips", "1", is_whole=True)
STICK_FRACTION = SampledQuantity("stick_fraction", "stick fraction", "1")
OWN_MEAN_DURATION = SampledQuantity("own_mean_duration", "mean stick duration of a sample", "s")

STICK_QUANTITIES = (START, DURATION, POSITION)
"""Quantities of each stick that are summed over all sticks, and by order, while the sticks stream by.

A new one goes to the end, and has the name of one of the `QUANTITIES` of a stick (`_dynamics/sticks.py`).
"""

StickQuantity: TypeAlias = Literal["start", "duration", "position", "slip_before", "slip_start", "slip_duration"]
"""The names of a stick's quantities: the `STICK_QUANTITIES`, the duration of the slip before the stick, and when the
slip after it begins and how long it lasts."""

StickValue: TypeAlias = StickQuantity | tuple[StickQuantity, int]
"""A quantity of any stick, "duration", or of the i-th stick of each sample, ("duration", 1)."""

BY_NAME = {quantity.name: quantity for quantity in (*STICK_QUANTITIES, SLIP_BEFORE, SLIP_AFTER_START, SLIP_AFTER)}
"""The quantities of a stick by their names, as in `StickQuantity`."""

SAMPLE_QUANTITIES = (STICK_COUNT, SLIP_COUNT, STICK_FRACTION)
"""Quantities of each sample, with the columns that `StickAccumulator.samples` has."""

DISTRIBUTIONS = (
    *SAMPLE_QUANTITIES, DURATION, OWN_MEAN_DURATION, SLIP_DURATION, START, POSITION, *STICK_QUANTITIES[3:],
)  # fmt: skip
"""All quantities whose distributions are estimated from all samples, in the order of tables."""

SLIP_QUANTITIES = (SLIP_START, SLIP_DURATION)
"""Quantities of each slip, of the retained samples. Without "slip_", they are the fields of `FlatSlips`."""

TestedQuantity: TypeAlias = Literal["start", "duration", "position", "slip_start", "slip_duration"]
"""The names of the quantities that tests of independence and of identical distribution take."""

TESTED = {quantity.name: quantity for quantity in (*STICK_QUANTITIES, *SLIP_QUANTITIES)}
"""The same quantities by their names."""

IN_A_CYCLE: tuple[TestedQuantity, ...] = ("start", "position", "duration", "slip_start", "slip_duration")
"""In which order the quantities of a stick and the slip after it come to be known."""

STREAMED_PAIRS: tuple[tuple[StickQuantity, StickQuantity], ...] = (("duration", "position"), ("start", "duration"))
"""Pairs of quantities of the same stick whose joint histograms are summed over all sticks."""

FIRST_TWO: tuple[StickValue, StickValue] = (("duration", 1), ("duration", 2))
"""The pair of two sticks of a sample whose joint histogram is summed over all samples."""


# The first stick of every sample.


@dataclasses.dataclass(frozen=True, eq=False)
class FirstSticks:
    """The first stick of every sample; arrays (samples,), NaN (ending: -1) where `mask` is False: no stick.

    - `start`, `duration`: s. `position`: of the mass, m; of a motor its angle, rad.
    - `ending`: an `Ending` code. HORIZON marks a duration cut short by the end of the simulation.
    - `mask`: whether the sample has a stick.
    """

    start: Float[np.ndarray, " samples"]
    duration: Float[np.ndarray, " samples"]
    position: Float[np.ndarray, " samples"]
    ending: Int[np.ndarray, " samples"]
    mask: Bool[np.ndarray, " samples"]

    @property
    def count(self) -> int:
        """Number of samples that have a first stick."""
        return int(self.mask.sum())

    def __repr__(self) -> str:
        return f"FirstSticks({self.count} in {len(self.mask)} samples)"


def first_stick(ensemble: EnsembleLike, *, count_initial_rest: bool = False) -> FirstSticks:
    """The first stick of every sample.

    Args:
        ensemble: An `Ensemble` with ``keep="sticks"``.
        count_initial_rest: Whether a stick that begins at t = 0, because the mass starts at rest, counts as the first.
            By default it does not, and the next one is the first. Lima and Sampaio (2022) count it, since they call any
            interval without motion a stick.

    Raises:
        ValueError: For an ensemble that kept no sticks, and if `count_initial_rest` is not True or False.
    """
    checks.truth("count_initial_rest", count_initial_rest)
    sticks = require_ensemble(ensemble).require_sticks()
    if not count_initial_rest:
        sticks = sticks.without_initial_rest()
    mask = sticks.count > 0
    at = sticks.first[mask]
    first = FlatSticks(mask.astype(int), sticks.numbers[:, at], sticks.ending[at]).padded()
    columns = (first.start, first.duration, first.position, first.ending)
    start, duration, position, ending = (np.asarray(column)[:, 0] for column in columns)
    return FirstSticks(start, duration, position, ending, mask)


# Sums and histograms of sticks and of the slips between them, by compiled loops over the sticks of a part.


BINS_BY_ORDER = 1024

_NAMES = tuple(quantity.name for quantity in STICK_QUANTITIES)
_SLIP = len(_NAMES)  # the column of slips, after those of the sticks
_OTHERS = np.array([NUMBERS.index(name) for name in _NAMES[3:]], int)  # rows of `StickStream.numbers`
_X, _Y = ([_NAMES.index(pair[axis]) for pair in STREAMED_PAIRS] for axis in (0, 1))


def sums_of_sticks(
    sticks: StickStream | DeviceSticks, skipped: Int[np.ndarray, " samples"], t1: float
) -> dict[str, Any]:
    """Sums and histograms of the numbered sticks of finished samples, simulated up to `t1`, s, and of all slips.

    By their names in the `StickAccumulator`. `skipped`: how many sticks of each sample come before its first numbered
    one, 0 or 1.

    Raises:
        ValueError: Where a number of a stick is NaN: the loops check no bounds, and it would have no bin.
    """
    d, compiled = _SLIP + 1, sticks.loops()
    skip_rest = bool(np.any(skipped))
    # A sample that begins with a stick has no slip there.
    all_slips = skip_rest or not np.any(sticks.begins_at_zero)
    columns = (
        sticks.start, sticks.end, sticks.position, sticks.slip, sticks.numbers[_OTHERS], skip_rest, all_slips
    )  # fmt: skip
    number, low, high, total = np.zeros(d, np.int64), np.full(d, np.inf), np.full(d, -np.inf), np.zeros(d)
    compiled.survey(*columns, number, low, high, total)
    if np.any(np.isnan(total)):
        raise ValueError("Sticks must have finite starts, ends and positions, but some are NaN.")
    fine = [_bins_within(*ends, BINS) for ends in zip(low, high, strict=True)]
    coarse = [_bins_within(*ends, BINS_OF_PAIRS) for ends in zip(low[:_SLIP], high[:_SLIP], strict=True)]
    axes = [*((one,) for one in fine), *((coarse[x], coarse[y]) for x, y in zip(_X, _Y, strict=True))]
    shapes = [tuple(axis.number for axis in own) for own in axes]
    counts, begin = _buffer(shapes)
    mean, scatter, third = total / np.maximum(number, 1), np.zeros((d, d)), np.zeros(d)
    bin_of = begin[:d] - [one.first for one in fine]
    shift = np.array([wide.exponent - one.exponent for wide, one in zip(coarse, fine, strict=False)] + [0])
    pair_bin_of = np.array([one.first for one in coarse] + [0])
    pairs = np.array([_X, _Y, [coarse[y].number for y in _Y], begin[d:-1]]).T
    compiled.count(*columns, mean, _scales(fine), bin_of, shift, pair_bin_of, pairs, counts, scatter, third)
    scatter += np.tril(scatter, -1).T
    of_sticks, of_slips = (
        PowerSums(np.array(number[at][0]), mean[at], scatter[at, at], third[at], low[at], high[at])
        for at in (slice(_SLIP), slice(_SLIP, d))
    )
    found = zip(axes, shapes, np.split(counts, begin[1:-1]), [*number, *(number[0] for _ in _X)], strict=True)
    bins = []
    for own, shape, part, values in found:
        most = BINS if len(own) == 1 else BINS_OF_PAIRS
        one = DyadicCounts.with_counts(own, part.reshape(shape), most) if values else DyadicCounts.none(len(own), most)
        bins.append(one)
    after = sticks.slip_after(t1).astype(np.float64)
    after = after[after > 0]
    return {
        "sticks": of_sticks,
        "stick_bins": tuple(bins[:_SLIP]),
        "slips": of_slips.merge(PowerSums.of(after)),
        "slip_bins": bins[_SLIP].merge(DyadicCounts.of(after, BINS)),
        "pair_bins": tuple(bins[d:]),
    }


def sums_of_orders(
    sticks: StickStream | DeviceSticks, skipped: Int[np.ndarray, " samples"], orders: int
) -> dict[str, Any]:
    """Sums and histograms of the 1st to the `orders`-th numbered stick, by their names in the `StickAccumulator`.

    `skipped`: how many sticks of each sample come before its first numbered one.
    """
    # No more orders than there are sticks, but the first two in any case.
    most = max(2, min(orders, int(sticks.count.max(initial=0))))
    d, compiled = _SLIP, sticks.loops()
    of_sticks = (sticks.start, sticks.end, sticks.position, sticks.numbers[_OTHERS], sticks.owner, sticks.order)
    columns, found, first_two = compiled.by_order(of_sticks, skipped, most)
    present = found[:orders]
    pair_bins = DyadicCounts.of_columns(tuple(first_two), BINS_OF_PAIRS)
    of_pairs = {"first_two": PowerSums.of(*first_two), "first_two_bins": pair_bins}
    if not np.any(present):
        no_bins = DyadicCounts.none(1, BINS_BY_ORDER, groups=orders)
        return {"by_order": PowerSums.stacked([PowerSums.none(d)] * orders), "order_bins": (no_bins,) * d, **of_pairs}
    number = np.zeros(orders, np.int64)
    number[: len(present)] = present
    low, high, total = (np.full((orders, d), value) for value in (np.inf, -np.inf, 0.0))
    compiled.survey_orders(columns, present, low, high, total)
    axes = [_bins_within(*ends, BINS_BY_ORDER) for ends in zip(low.min(axis=0), high.max(axis=0), strict=True)]
    shapes = [(orders, axis.number) for axis in axes]
    counts, begin = _buffer(shapes)
    mean, scatter, third = total / np.maximum(number, 1)[:, None], np.zeros((orders, d, d)), np.zeros((orders, d))
    bin_of, bins = begin[:-1] - [axis.first for axis in axes], np.array([axis.number for axis in axes])
    compiled.count_orders(columns, present, mean, _scales(axes), bin_of, bins, counts, scatter, third)
    scatter += np.tril(scatter, -1).swapaxes(1, 2)
    parts = zip(axes, np.split(counts, begin[1:-1]), shapes, strict=True)
    return {
        "by_order": PowerSums(number, mean, scatter, third, low, high),
        "order_bins": tuple(
            DyadicCounts.with_counts((axis,), one.reshape(shape), BINS_BY_ORDER) for axis, one, shape in parts
        ),
        **of_pairs,
    }


def _bins_within(low: float, high: float, bins: int) -> CommonBins:
    """The bins for numbers from `low` to `high`; any bins if there are none (then ``low > high``)."""
    ends = (float(low), float(high)) if low <= high else (0.0, 0.0)
    return CommonBins.within(*ends, bins)


def _scales(axes: Sequence[CommonBins]) -> Float[np.ndarray, " axes"]:
    """Bins per unit of each quantity."""
    return np.array([math.ldexp(1.0, -axis.exponent) for axis in axes])


def _buffer(shapes: Sequence[tuple[int, ...]]) -> tuple[Int[np.ndarray, " counts"], Int[np.ndarray, " ends"]]:
    """One array of zeros for the counts of several histograms, and where each of them begins and the last one ends."""
    begin = np.cumsum([0, *(math.prod(shape) for shape in shapes)])
    return np.zeros(begin[-1], np.int64), begin


# The accumulator of an ensemble: sums and histograms of its sticks, updated while they stream by.
#
# Accumulators of parts of an ensemble are merged exactly: sums of deviations by the formulas of Chan, Golub and LeVeque
# (1983) and Pebay (2008), histograms by adding. Apart from round-off the result does not depend on how the samples were
# cut into parts.


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
        checks.truth("count_initial_rest", count_initial_rest)
        return cls(checks.whole_number("orders", orders, maximum=MOST_ORDERS), bool(count_initial_rest))

    def order_of(self, sticks: FlatSticks) -> Int[np.ndarray, " sticks"]:
        """The number of each stick in its sample, from 1; 0 for one that is not numbered."""
        before = sticks.first + self.rest(sticks)[1]
        return np.arange(len(sticks.start)) - np.repeat(before, sticks.count) + 1

    def rest(
        self, sticks: FlatSticks | StickStream | DeviceSticks
    ) -> tuple[Float[np.ndarray, " samples"], Int[np.ndarray, " samples"]]:
        """Duration (s) and number (0 or 1) of the sticks of each sample that are not numbered."""
        times = np.zeros(len(sticks.count)) if self.count_initial_rest else sticks.rest_times()
        return times, (times > 0).astype(int)


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
        cls,
        sticks: StickStream | DeviceSticks,
        stick_time: np.ndarray,
        slips: np.ndarray,
        t1: float,
        numbering: Numbering,
    ) -> "StickAccumulator":
        """The accumulator of finished samples, simulated up to `t1` (s).

        `stick_time`: the total of each sample, s. `slips`: the number of each sample. (samples,)
        """
        fraction = np.asarray(stick_time, np.float64) / t1
        rest, skipped = numbering.rest(sticks)
        numbered = sticks.count - skipped
        has = numbered > 0
        own_mean = (fraction[has] * t1 - rest[has]) / numbered[has]
        counts = (sticks.count, np.asarray(slips, np.int64))
        return cls(
            **sums_of_sticks(sticks, skipped, t1),
            **sums_of_orders(sticks, skipped, numbering.orders),
            samples=PowerSums.of(*counts, fraction),
            sample_bins=(*(DyadicCounts.of(one, BINS, finest=0) for one in counts), DyadicCounts.of(fraction, BINS)),
            own_mean=PowerSums.of(own_mean),
            own_mean_bins=DyadicCounts.of(own_mean, BINS),
            endings=sticks.endings(bool(np.any(skipped))),
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
