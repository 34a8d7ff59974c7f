"""How much of a long trajectory is drawn, so that its oscillations can be distinguished."""

import math

import numpy as np

from .._simulation.result import Simulation
from ._trajectory import Phase, check_window, phases_of, values_of
from ._types import Window

_MOST_TURNS = 80  # of a line across the axes: more make it a black band
_FIRST_TURNS = 40  # are drawn of such a line
_LARGE = 0.25  # of the range of the line: the least way back that counts


def phases_in(one: Simulation, window: Window | None) -> tuple[list[Phase], Window]:
    """The phases to draw, and the window that they are in (s), which is the one given.

    Without one it is all of ``[0, t1]``, or of a motion that turns more than 80 times its beginning.

    Raises:
        ValueError: For a window that is none.
    """
    whole = check_window(window, float(one.t1))
    phases = phases_of(one, whole)
    if window is not None:
        return phases, whole
    times = np.concatenate([phase.times for phase in phases])
    end = whole[1]
    for number in range(len(phases[0].state)):
        values = np.concatenate([values_of(phase, number) for phase in phases])
        turns = times[turns_of(values, _LARGE * float(np.ptp(values)))]
        if len(turns) > _MOST_TURNS:
            end = min(end, _round_down(float(turns[_FIRST_TURNS])))
    return (phases, whole) if end == whole[1] else (phases_of(one, (0.0, end)), (0.0, end))


def turns_of(values: np.ndarray, least: float) -> np.ndarray:
    """The numbers of the values (points,) at which a line turns and then goes back by more than `least`."""
    rising = np.sign(np.diff(values))
    moving = np.flatnonzero(rising != 0)
    extremes = moving[1:][rising[moving[1:]] != rising[moving[:-1]]]
    found: list[int] = []
    best, way = 0, 0  # the farthest point since the last turn, and which way the line went
    for place in [*extremes.tolist(), len(values) - 1]:
        change = values[place] - values[best]
        if way * change >= 0 and (way or abs(change) > least):
            best, way = place, way or int(np.sign(change))
        elif way and abs(change) > least:
            found.append(best)
            best, way = place, -way
    return np.array(found, int)


def _round_down(time: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not after `time`."""
    power = 10.0 ** math.floor(math.log10(time))
    return next(factor * power for factor in (5.0, 2.0, 1.0) if factor * power <= time * (1 + 1e-12))
