"""Plain scalar yardstick of regularised dynamics, compiled by numba: one trajectory and one step at a time.

The same linearly implicit step of the same method as `Regularized(width, "linear", step=...)`, written for this
oscillator alone (unit mass, stiffness and friction force): it needs no derivatives and no iterations, and it does not
look for the instants inside a step at which sticks begin and end, but counts whole steps below the threshold.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

_GAMMA = 1 - 1 / math.sqrt(2)


class Followed(NamedTuple):
    """One trajectory: its number of steps, the time below the threshold, and the state at `t1`."""

    steps: int
    slow_time: float
    z: float
    u: float


@njit(cache=False, fastmath=False, nogil=True)
def _stage(z, u, weight, base, width):
    """The stage ``Y = (z, u) + weight f(Y)``, and ``f(Y)``."""
    scale = 1.0 / (1.0 + weight * weight)
    free, stiffness = (u - weight * z) * scale - base, weight * scale
    grip = free / (width + stiffness)
    grip = max(-1.0, min(1.0, grip))
    speed = free - stiffness * grip + base
    place = z + weight * speed
    return place, speed, -place - grip


@njit(cache=False, fastmath=False, nogil=True)
def _trajectory(z, u, speed, t1, gaps, width, step, shortest):
    base, index, t, steps, since, slow_time = speed, 0, 0.0, 0, 0.0, 0.0
    until = min(gaps[0], t1)
    inside = abs(u - base) <= width
    while t < t1:
        left = until - t
        last = step * (1 + 1e-6) >= left
        h = left if last else step
        weight = _GAMMA * h
        _, rate_z, rate_u = _stage(z, u, weight, base, width)
        z, u, _ = _stage(z + (1 - _GAMMA) * h * rate_z, u + (1 - _GAMMA) * h * rate_u, weight, base, width)
        t = until if last else t + h
        steps += 1
        now = abs(u - base) <= width
        if now and not inside:
            since = t
        if inside and (not now or last):
            slow_time += t - since if t - since >= shortest else 0.0
        inside = now
        if last:
            index += 1
            until = min(until + gaps[index], t1) if index < gaps.size else t1
            base = -base
            inside, since = abs(u - base) <= width, t
    return steps, slow_time, z, u


def follow(*, w, t1, gaps, width, step, y0=(0.0, 0.0), initial_sign=1) -> Followed:
    """The motion on one row of given gaps, on a base of velocity `w` or `-w`."""
    gaps = np.ascontiguousarray(gaps, float)
    numbers = (float(y0[0]), float(y0[1]), initial_sign * float(w), float(t1))
    return Followed(*_trajectory(*numbers, gaps, float(width), float(step), max(10 * width, 2 * step)))
