"""A quantity of the sticks of many samples in order of time, free of what the end of the simulation does to it.

The simulation ends at t1 and cuts the stick or slip that goes on then. One that begins shortly before t1 is complete
only if it is short. So complete ones alone are too short, the later in order the more, and a long one leaves less room
for the next: both look like what the tests look for. Sticks, or slips, that begin before ``t1 - (the longest)`` are all
complete, and whether one begins before a given instant depends on what was earlier, not on how long it lasts.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from .. import _checks
from .._status import Ending

QUANTITIES = {"duration": "stick durations", "position": "stick positions", "slip_duration": "slip durations"}
"""What can be asked for, and its name in sentences."""


class Sequences(NamedTuple):
    """The values of one quantity, one sample after the other in order of time.

    `values` (all used,); `first` and `count` (samples,): where each sample's values begin, and how many it has.
    """

    values: np.ndarray
    first: np.ndarray
    count: np.ndarray
    remark: str

    @property
    def order(self) -> np.ndarray:
        """The order of each value within its sample, from 1; (all used,)."""
        return np.arange(len(self.values)) - np.repeat(self.first, self.count) + 1


class _Intervals(NamedTuple):
    """Arrays (all sticks,), of the value that belongs to each stick.

    - `begin`: when its time begins, s. `length`: all times of the kind as far as seen, s, in any order.
    - `exists`: whether there is such a value. `complete`: whether all of it was seen. `values`: the value.
    """

    begin: np.ndarray
    length: np.ndarray
    exists: np.ndarray
    complete: np.ndarray
    values: np.ndarray


def sequences_of(source: Any, quantity: Any, starts_before: Any) -> Sequences:
    """The values of `quantity` that begin before `starts_before` (s; None: ``t1 - longest``, as said at the top).

    Raises ValueError as the public functions say.
    """
    if not (isinstance(quantity, str) and quantity in QUANTITIES):
        raise ValueError(
            f"Argument quantity must be one of {', '.join(map(repr, QUANTITIES))}, "
            f"but {_checks.show(quantity)} was given."
        )
    if not (isinstance(starts_before, float) and starts_before == math.inf) and starts_before is not None:
        _checks.numeric("starts_before", starts_before)
    sticks = _sticks_of(source)
    interval = _INTERVALS[quantity](sticks)
    longest = np.max(interval.length, initial=0.0)
    before = sticks.horizon - longest if starts_before is None else float(starts_before)
    used = interval.complete & (interval.begin < before)
    values = interval.values[used]
    if not np.all(np.isfinite(values)):
        raise ValueError(f"Argument source must have finite {QUANTITIES[quantity]}, but some are NaN or infinite.")
    scale = np.max(np.abs(values), initial=0.0) if quantity == "position" else sticks.horizon
    values = _rounded(values, scale * sticks.epsilon)
    samples = len(sticks.count)
    count = np.bincount(np.repeat(np.arange(samples), sticks.count)[used], minlength=samples)
    remark = f"Used {len(values)} {QUANTITIES[quantity]}"
    if left := int(interval.exists.sum()) - len(values):
        late = "" if before == math.inf else f"begin at {max(before, 0):.4g} s or later, or "
        remark += f"; left out {left}, which {late}are cut by the end of the simulation"
    return Sequences(values, np.cumsum(count) - count, count, remark + ".")


class _Sticks(NamedTuple):
    """The sticks of all samples as float64, the latest instant seen (s), and the relative rounding error of times."""

    count: np.ndarray
    start: np.ndarray
    end: np.ndarray
    position: np.ndarray
    ending: np.ndarray
    horizon: float
    epsilon: float


def _sticks_of(source: Any) -> _Sticks:
    """The sticks of an ensemble's finished samples, or `source` itself if it is such sticks."""
    flat = source.numbered_sticks() if hasattr(source, "numbered_sticks") else source
    names = ("start", "end", "position", "ending")
    if not all(hasattr(flat, name) for name in ("count", *names)):
        raise ValueError(
            "Argument source must be the result of simulate_ensemble or its flat_sticks, "
            f"but {type(source).__name__} was given."
        )
    count = np.asarray(flat.count).astype(np.int64)
    start, end, position, ending = (np.asarray(getattr(flat, name)) for name in names)
    shapes = [np.shape(values) for values in (start, end, position, ending)]
    if any(shape != (count.sum(),) for shape in shapes):
        raise ValueError(
            f"Argument source must have as many sticks as its counts add up to, {count.sum()}, "
            f"but arrays of shapes {', '.join(map(str, shapes))} were given."
        )
    epsilon = float(np.finfo(np.result_type(start, np.float32)).eps)
    start, end = start.astype(np.float64), end.astype(np.float64)
    if not (np.all(np.isfinite(start)) and np.all(np.isfinite(end))):
        raise ValueError("Argument source must have finite starts and ends, but some are NaN or infinite.")
    return _Sticks(count, start, end, position, ending, float(np.max(end, initial=0.0)), epsilon)


def _rounded(values: np.ndarray, error: float) -> np.ndarray:
    """To multiples of a power of two, of 256 rounding errors at least, so that equal values differ by chance no more.

    In steady motion all sticks last equally long but for the last digits, in which tests by rank would find a pattern.
    """
    if error == 0:
        return values
    grid = math.ldexp(1.0, math.frexp(256 * error)[1])
    return grid * np.round(values / grid)


def _durations(sticks: _Sticks) -> _Intervals:
    length = sticks.end - sticks.start
    everything = np.ones(len(length), bool)
    return _Intervals(sticks.start, length, everything, sticks.ending != Ending.HORIZON, length)


def _slips(sticks: _Sticks) -> _Intervals:
    """The slip after each stick. That after the last one is cut; there is none if the stick is what was cut."""
    is_last = np.zeros(len(sticks.start), bool)
    is_last[(np.cumsum(sticks.count) - 1)[sticks.count > 0]] = True
    stop = np.where(is_last, sticks.horizon, np.append(sticks.start[1:], 0.0))
    exists = ~(is_last & (sticks.ending == Ending.HORIZON))
    length = np.where(exists, stop - sticks.end, 0.0)
    return _Intervals(sticks.end, length, exists, ~is_last, length)


def _positions(sticks: _Sticks) -> _Intervals:
    """A position is known as soon as the slip before it ends, so that slip is what the end of the simulation cuts."""
    is_first = np.zeros(len(sticks.start), bool)
    is_first[(np.cumsum(sticks.count) - sticks.count)[sticks.count > 0]] = True
    begin = np.where(is_first, 0.0, np.append(0.0, sticks.end[:-1]))
    everything = np.ones(len(begin), bool)
    return _Intervals(begin, _slips(sticks).length, everything, everything, sticks.position.astype(np.float64))


_INTERVALS = {"duration": _durations, "slip_duration": _slips, "position": _positions}
