"""What a film shows in each frame: the state, how far the base has run, and which contacts stick."""

import math
from typing import NamedTuple

import jax
import numpy as np

from .. import _checks
from .._events.sticks import Sticks
from .._simulation.result import Simulation
from .._status import Ending
from ._trajectory import padded
from ._types import Window

_MOST_FRAMES = 3000
_USUAL_LENGTH = 10.0  # s, of a film whose speed is not given
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


class Stuck(NamedTuple):
    """When one contact sticks; arrays (sticks,). `to_horizon`: whether the end of the simulation cut the stick."""

    start: np.ndarray
    end: np.ndarray
    to_horizon: np.ndarray

    @classmethod
    def of(cls, sticks: Sticks) -> "Stuck":
        """Those of one contact."""
        mask = np.asarray(sticks.mask)
        start, end, ending = (np.asarray(values)[mask] for values in (sticks.start, sticks.end, sticks.ending))
        return cls(start, end, ending == Ending.HORIZON)

    def lasts_at(self, times: np.ndarray) -> np.ndarray:
        """Whether there is a stick at these times (s), from its start until just before its end."""
        at = np.searchsorted(self.start, times, side="right") - 1
        found = np.maximum(at, 0)
        if not len(self.start):
            return np.zeros(times.shape, bool)
        return (at >= 0) & ((times < self.end[found]) | (self.to_horizon[found] & (times <= self.end[found])))


def sticks_of(one: Simulation) -> dict[int, Stuck]:
    """The sticks of each contact of which they are known, by its number.

    Raises:
        ValueError: Where it is not known which contact they are of.
    """
    system = one.system
    if system.contact_count is None:
        return {0: Stuck.of(one.sticks)}
    if one.sticks.contact is not None:
        return {number: Stuck.of(one.of_contact(number).sticks) for number in range(system.contact_count)}
    if system.counted_track is None:
        raise ValueError(
            "Argument result must hold the sticks of all contacts, but one of of_contact or of_all_contacts was given; "
            "animate the simulation that it was taken from."
        )
    counted = range(system.contact_count) if system.counted_track < 0 else [system.counted_track]
    return dict.fromkeys(counted, Stuck.of(one.sticks))


def frame_times(window: Window, speed: float | None, fps: float, dtype: np.dtype) -> tuple[np.ndarray, float]:
    """The times of the frames (s), from the window's begin in equal steps as far as it reaches; and the speed.

    Raises:
        ValueError: For fewer than two frames, and for more than 3,000.
    """
    length = window[1] - window[0]
    speed = length / _USUAL_LENGTH if speed is None else speed
    # The last frame is at the window's end where that is a whole number of steps away, up to round-off.
    frames = math.floor(length / speed * fps * (1 + 1e-9)) + 1
    if not 2 <= frames <= _MOST_FRAMES:
        raise ValueError(
            f"Arguments window, speed and fps must make 2 to {_MOST_FRAMES:,} frames, but {length:g} s at "
            f"{speed:g} s of motion per second of film with {fps:g} frames per second are {frames:,}; choose "
            f"{'a lower' if frames < 2 else 'a higher'} speed{' or a shorter window' if frames > 2 else ''}."
        )
    times = window[0] + speed / fps * np.arange(frames)
    return np.minimum(times, window[1]).astype(dtype), speed


def base_displacement(one: Simulation, times: np.ndarray) -> np.ndarray:
    """How far the base has run since the first of `times` (s), at each of them: the integral of its velocity.

    By Gauss's rule between all beginnings of time steps, at which the velocity may jump: exact where it is a polynomial
    of degree 7 between them.
    """
    steps = np.asarray(one.step_starts)
    knots = np.unique(np.concatenate([times, steps[(steps > times[0]) & (steps < times[-1])]])).astype(float)
    half, middle = np.diff(knots) / 2, (knots[1:] + knots[:-1]) / 2
    nodes = middle[:, None] + half[:, None] * _NODES
    velocities = velocity_at(one, nodes.ravel()).reshape(nodes.shape)
    run = np.concatenate([[0.0], np.cumsum(half * (velocities @ _WEIGHTS))])
    return run[np.searchsorted(knots, times.astype(float))]


def state_at(one: Simulation, times: np.ndarray) -> tuple[np.ndarray, ...]:
    """The state at `times` (s), (times,) each, in double precision whatever that of the simulation."""
    return tuple(np.asarray(values, float)[: len(times)] for values in one.evaluate(padded(one, times)))


def velocity_at(one: Simulation, times: np.ndarray) -> np.ndarray:
    """The base velocity at `times` (s), likewise."""
    return np.asarray(_velocity(one, padded(one, times)), float)[: len(times)]


@jax.jit
def _velocity(one: Simulation, times: jax.Array) -> jax.Array:
    return one.base_velocity(times)


def checked_speed(speed: float | int | None, fps: float | int) -> None:
    """Raises ValueError for a speed that is not positive, or a number of frames per second that no GIF can show."""
    if speed is not None:
        _checks.positive("speed", speed, "s of motion per s of film")
    _checks.positive("fps", fps, "frames per second")
    if fps > 50:
        raise _checks.refused("fps", "be at most 50 (frames per second), the most that players of GIFs show", fps)
