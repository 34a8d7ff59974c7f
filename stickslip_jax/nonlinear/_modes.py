"""The sequence of modes of a trajectory: which contacts stick, and which slip in which direction."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .._dynamics.common.method import Exact
from .._dynamics.common.validation import working_dtype
from .._dynamics.switched.path import StepPath, follow_steps
from .._excitation.excitation import motion_of
from .._systems.system import System


class Mode(NamedTuple):
    """A part of an orbit in which no contact changes between slip and stick.

    `signs`: of the relative velocity of each contact, 0 in a stick. `start`, `end`: s, from the beginning of the orbit.
    """

    signs: tuple[int, ...]
    start: float
    end: float


def modes_of(system: System, base: Any, method: Exact, duration: Any, state: Any) -> tuple[Mode, ...]:
    """The modes of one trajectory in order of time."""
    y0 = tuple(float(value) for value in np.asarray(state))
    t1 = float(duration)
    motion = motion_of(base).realized_until(t1)
    run = follow_steps(system, motion, method, t1, y0, working_dtype(stacklevel=5))
    assert isinstance(run.path, StepPath)
    begun = run.path.beginnings
    return modes_between(np.asarray(begun.t), np.asarray(begun.sign), t1)


def modes_between(times: np.ndarray, signs: np.ndarray, t1: float) -> tuple[Mode, ...]:
    """The modes up to `t1` (s), by the signs that hold from the beginnings of loop steps on, (steps,) or (steps,
    contacts).
    """
    signs = signs.reshape(len(times), -1).astype(int)
    # Of loop steps that begin at one instant the last holds; the idle ones after the end begin where it is.
    last = np.append(times[1:] > times[:-1], False) & (times < t1)
    times, signs = times[last], signs[last]
    new = np.append(True, np.any(signs[1:] != signs[:-1], axis=1))
    starts, ends = times[new], np.append(times[new][1:], t1)
    return tuple(
        Mode(tuple(map(int, sign)), float(start), float(end))
        for sign, start, end in zip(signs[new], starts, ends, strict=True)
    )


def sequence(modes: tuple[Mode, ...]) -> tuple[tuple[int, ...], ...]:
    """The order of modes on a closed orbit, wherever it begins."""
    signs = [mode.signs for mode in modes]
    if len(signs) > 1 and signs[0] == signs[-1]:
        signs = signs[:-1]
    turns = [tuple(signs[number:] + signs[:number]) for number in range(len(signs))]
    return min(turns)


def stick_count(modes: tuple[Mode, ...]) -> int:
    """The number of sticks of all contacts on a closed orbit; one that lasts for all of it counts."""
    return _count(modes, lambda sign: sign == 0)


def slip_count(modes: tuple[Mode, ...]) -> int:
    """The number of slips in one direction of all contacts on a closed orbit; one that lasts for all of it counts."""
    return _count(modes, lambda sign: sign > 0) + _count(modes, lambda sign: sign < 0)


def _count(modes: tuple[Mode, ...], is_one: Callable[[int], bool]) -> int:
    order = sequence(modes)
    found = np.array([[is_one(sign) for sign in signs] for signs in order])
    begun = found & ~np.roll(found, 1, axis=0)
    return int(np.sum(begun) + np.sum(np.all(found, axis=0)))
