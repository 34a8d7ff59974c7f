"""The quantities whose distributions are estimated, and their values sample by sample."""

import dataclasses
import math
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from .._dynamics.sticks import FlatSticks
from .._foundation import checks
from .._foundation.types import Ending
from .estimate import EnsembleLike, StickSource, require_ensemble

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


# Values of a quantity in order of time within each sample, without the bias from the end of the simulation.
#
# The simulation ends at t1 and cuts the stick or slip that is under way. One that begins shortly before t1 is complete
# only if it is short. So the complete ones alone are too short on average, more so the later they come in order, and a
# long one leaves less time for the next. Tests would take both for a drift of the distribution, or for dependence. All
# sticks, or slips, that begin before ``t1 - (the longest)`` are complete, and whether one begins before a given instant
# depends on what happened earlier, not on its own duration.


class Sequences(NamedTuple):
    """The values of one quantity, sample after sample, those of a sample in order of time.

    - `values`: (values,). `first`, `count`: index of each sample's first value, and its number of values, (samples,).
    - `remark`: a sentence that says how many values were used and left out.
    """

    values: Float[np.ndarray, " values"]
    first: Int[np.ndarray, " samples"]
    count: Int[np.ndarray, " samples"]  # pyright: ignore[reportIncompatibleMethodOverride] - the name in CF conventions
    remark: str


def sequences_of(source: StickSource, quantity: str, starts_before: float | None) -> Sequences:
    """The values of `quantity` that begin before `starts_before` (s; None: ``t1 - longest``, as explained above).

    Arguments, and errors raised, as in `identically_distributed`.
    """
    checks.chosen("quantity", quantity, TESTED)
    if not (isinstance(starts_before, float) and starts_before == math.inf) and starts_before is not None:
        checks.numeric("starts_before", starts_before)
    given: object = source
    if not isinstance(source, FlatSticks) and hasattr(source, "numbered_sticks"):
        given = source.numbered_sticks()
    if not isinstance(given, FlatSticks):
        raise ValueError(
            "Argument source must be the result of simulate_ensemble or its flat_sticks, "
            f"but {type(source).__name__} was given."
        )
    shapes = [np.shape(column) for column in (*given.numbers, given.ending)]
    if any(shape != (given.count.sum(),) for shape in shapes):
        raise ValueError(
            f"Argument source must have as many sticks as its counts add up to, {given.count.sum()}, "
            f"but arrays of shapes {', '.join(map(str, shapes))} were given."
        )
    if not (np.all(np.isfinite(given.start)) and np.all(np.isfinite(given.end))):
        raise ValueError("Argument source must have finite starts and ends, but some are NaN or infinite.")
    sticks = given._replace(count=given.count.astype(np.int64), numbers=given.numbers.astype(np.float64))
    horizon, has = float(np.max(sticks.end, initial=0.0)), sticks.count > 0
    # The slip after each stick. That after the last one of a sample is cut; there is none if that stick itself was cut.
    is_cut, is_last = sticks.ending == Ending.HORIZON, np.zeros(len(sticks.start), bool)
    is_last[(sticks.first + sticks.count - 1)[has]] = True
    slips = ~(is_last & is_cut)
    slip = np.where(slips, np.where(is_last, horizon, np.append(sticks.start[1:], 0.0)) - sticks.end, 0.0)
    # Each value is known from a stick or slip: when that `begin`s, the `length` of all such ones up to the end of the
    # simulation, in any order, whether there `exists` such a value, and whether the simulation did not cut it.
    duration, everything = sticks.duration, np.ones(len(sticks.start), bool)
    match quantity:
        case "duration":  # from the stick itself
            values, begin, length, exists, complete = duration, sticks.start, duration, everything, ~is_cut
        case "slip_start":  # from the stick before the slip
            values, begin, length, exists, complete = sticks.end, sticks.start, duration, ~is_cut, ~is_cut
        case "slip_duration":  # from the slip itself
            values, begin, length, exists, complete = slip, sticks.end, slip, slips, ~is_last
        case _:  # known when the stick starts: from the slip before, which may be cut
            values, length, exists, complete = getattr(sticks, quantity), slip, everything, everything
            begin = np.roll(sticks.end, 1)
            begin[sticks.first[has]] = 0.0
    longest = np.max(length, initial=0.0)
    before = horizon - longest if starts_before is None else float(starts_before)
    used = complete & (begin < before)
    values = values[used]
    if not np.all(np.isfinite(values)):
        raise ValueError(f"Argument source must have finite {plural(quantity)}, but some are NaN or infinite.")
    # Rounded to multiples of a power of two that is at least 256 times the round-off: in periodic motion all sticks are
    # equally long up to that, and tests by rank would find a pattern in it.
    is_time = quantity in ("duration", "slip_start", "slip_duration")
    scale = horizon if is_time else np.max(np.abs(values), initial=0.0)
    if error := scale * float(np.finfo(given.numbers.dtype).eps):
        grid = math.ldexp(1.0, math.frexp(256 * error)[1])
        values = grid * np.round(values / grid)
    count = np.bincount(sticks.sample[used], minlength=len(sticks.count))
    remark = f"Used {len(values)} {plural(quantity)}"
    if left := int(exists.sum()) - len(values):
        late = "" if before == math.inf else f"begin at {max(before, 0):.4g} s or later, or "
        remark += f"; left out {left}, which {late}are cut by the end of the simulation"
    return Sequences(values, np.cumsum(count) - count, count, remark + ".")


def plural(quantity: str) -> str:
    """A tested quantity in sentences: "stick durations"."""
    label = TESTED[quantity].label
    return f"values of the {label}" if label.endswith("the stick") else f"{label}s"


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

    def fill(values, padding):
        filled = np.full(len(mask), padding, values.dtype)
        filled[mask] = values[at]
        return filled

    start, duration, position = (fill(values, np.nan) for values in (sticks.start, sticks.duration, sticks.position))
    return FirstSticks(start, duration, position, fill(sticks.ending, -1), mask)
