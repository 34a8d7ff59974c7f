"""Values of a quantity in order of time within each sample, without the bias from the end of the simulation.

The simulation ends at t1 and cuts the stick or slip that is under way. One that begins shortly before t1 is complete
only if it is short. So the complete ones alone are too short on average, more so the later they come in order, and a
long one leaves less time for the next. Tests would take both for a drift of the distribution, or for dependence. All
sticks, or slips, that begin before ``t1 - (the longest)`` are complete, and whether one begins before a given instant
depends on what happened earlier, not on its own duration.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .. import _checks
from .._events.sticks import FlatSticks
from .._status import Ending
from .quantities import DURATION, SLIP_DURATION, SLIP_START, TESTED
from .source import StickSource, WithNumberedSticks


class Sequences(NamedTuple):
    """The values of one quantity, sample after sample, those of a sample in order of time.

    - `values`: (values,). `first`, `count`: index of each sample's first value, and its number of values, (samples,).
    - `remark`: a sentence that says how many values were used and left out.
    """

    values: Float[np.ndarray, " values"]
    first: Int[np.ndarray, " samples"]
    count: Int[np.ndarray, " samples"]  # pyright: ignore[reportIncompatibleMethodOverride] - the name in CF conventions
    remark: str

    @property
    def order(self) -> np.ndarray:
        """The order of each value within its sample, from 1; (values,)."""
        return np.arange(len(self.values)) - np.repeat(self.first, self.count) + 1


class _Intervals(NamedTuple):
    """The stick or slip from which each stick's value is known, arrays (all sticks,).

    - `begin`: when that stick or slip begins, s.
    - `length`: durations of all such sticks or slips, up to the end of the simulation, s, in any order.
    - `exists`: whether there is such a value. `complete`: whether the simulation did not cut it. `values`: the value.
    """

    begin: Float[np.ndarray, " sticks"]
    length: Float[np.ndarray, " intervals"]
    exists: Bool[np.ndarray, " sticks"]
    complete: Bool[np.ndarray, " sticks"]
    values: Float[np.ndarray, " sticks"]


def sequences_of(source: StickSource, quantity: str, starts_before: float | None) -> Sequences:
    """The values of `quantity` that begin before `starts_before` (s; None: ``t1 - longest``, as explained above).

    Arguments, and errors raised, as in `identically_distributed`.
    """
    if not (isinstance(quantity, str) and quantity in TESTED):
        raise ValueError(
            f"Argument quantity must be one of {', '.join(map(repr, TESTED))}, but {_checks.show(quantity)} was given."
        )
    if not (isinstance(starts_before, float) and starts_before == math.inf) and starts_before is not None:
        _checks.numeric("starts_before", starts_before)
    given = _sticks_of(source)
    sticks = given._replace(count=given.count.astype(np.int64), numbers=given.numbers.astype(np.float64))
    interval = _INTERVALS[quantity](sticks) if quantity in _INTERVALS else _at_start(sticks, quantity)
    longest, horizon = np.max(interval.length, initial=0.0), _horizon(sticks)
    before = horizon - longest if starts_before is None else float(starts_before)
    used = interval.complete & (interval.begin < before)
    values = interval.values[used]
    if not np.all(np.isfinite(values)):
        raise ValueError(f"Argument source must have finite {plural(quantity)}, but some are NaN or infinite.")
    scale = horizon if quantity in _INTERVALS else np.max(np.abs(values), initial=0.0)
    values = _rounded(values, scale * float(np.finfo(given.numbers.dtype).eps))
    count = np.bincount(sticks.sample[used], minlength=len(sticks.count))
    remark = f"Used {len(values)} {plural(quantity)}"
    if left := int(interval.exists.sum()) - len(values):
        late = "" if before == math.inf else f"begin at {max(before, 0):.4g} s or later, or "
        remark += f"; left out {left}, which {late}are cut by the end of the simulation"
    return Sequences(values, np.cumsum(count) - count, count, remark + ".")


def plural(quantity: str) -> str:
    """A tested quantity in sentences: "stick durations"."""
    label = TESTED[quantity].label
    return f"values of the {label}" if label.endswith("the stick") else f"{label}s"


def _sticks_of(source: StickSource) -> FlatSticks:
    """The numbered sticks of an ensemble's finished samples, or `source` itself if it is `FlatSticks`."""
    sticks = source.numbered_sticks() if isinstance(source, WithNumberedSticks) else source
    if not isinstance(sticks, FlatSticks):
        raise ValueError(
            "Argument source must be the result of simulate_ensemble or its flat_sticks, "
            f"but {type(source).__name__} was given."
        )
    shapes = [np.shape(column) for column in (*sticks.numbers, sticks.ending)]
    if any(shape != (sticks.count.sum(),) for shape in shapes):
        raise ValueError(
            f"Argument source must have as many sticks as its counts add up to, {sticks.count.sum()}, "
            f"but arrays of shapes {', '.join(map(str, shapes))} were given."
        )
    if not (np.all(np.isfinite(sticks.start)) and np.all(np.isfinite(sticks.end))):
        raise ValueError("Argument source must have finite starts and ends, but some are NaN or infinite.")
    return sticks


def _horizon(sticks: FlatSticks) -> float:
    """The end of the last stick of all, s."""
    return float(np.max(sticks.end, initial=0.0))


def _rounded(values: np.ndarray, error: float) -> np.ndarray:
    """The values rounded to multiples of a power of two that is at least 256 times the rounding `error`.

    In periodic motion all sticks are equally long up to round-off, in which tests by rank would find a pattern.
    """
    if error == 0:
        return values
    grid = math.ldexp(1.0, math.frexp(256 * error)[1])
    return grid * np.round(values / grid)


def _durations(sticks: FlatSticks) -> _Intervals:
    """The duration of each stick, known from that stick."""
    length = sticks.duration
    everything = np.ones(len(length), bool)
    return _Intervals(sticks.start, length, everything, sticks.ending != Ending.HORIZON, length)


def _slips(sticks: FlatSticks) -> _Intervals:
    """The duration of the slip after each stick, known from that slip.

    The slip after the last stick of a sample is cut; there is none if that stick itself was cut.
    """
    is_last = np.zeros(len(sticks.start), bool)
    is_last[(sticks.first + sticks.count - 1)[sticks.count > 0]] = True
    stop = np.where(is_last, _horizon(sticks), np.append(sticks.start[1:], 0.0))
    exists = ~(is_last & (sticks.ending == Ending.HORIZON))
    length = np.where(exists, stop - sticks.end, 0.0)
    return _Intervals(sticks.end, length, exists, ~is_last, length)


def _slip_starts(sticks: FlatSticks) -> _Intervals:
    """The instant at which the slip after each stick begins, known from that stick."""
    known = _durations(sticks)
    return known._replace(exists=known.complete, values=sticks.end)


def _at_start(sticks: FlatSticks, quantity: str) -> _Intervals:
    """A quantity such as the position, known when the stick starts: from the slip before, which may be cut."""
    is_first = np.zeros(len(sticks.start), bool)
    is_first[sticks.first[sticks.count > 0]] = True
    begin = np.where(is_first, 0.0, np.append(0.0, sticks.end[:-1]))
    everything = np.ones(len(begin), bool)
    return _Intervals(begin, _slips(sticks).length, everything, everything, getattr(sticks, quantity))


_INTERVALS = {DURATION.name: _durations, SLIP_START.name: _slip_starts, SLIP_DURATION.name: _slips}
"""Quantities that are times; all others are known when the stick starts."""
