"""Plain scalar yardstick, compiled by numba: one trajectory at a time, a branch per event, libm functions.

The motion is followed in the frame in which the base moves with `+w`: at each switch `(z, u)` becomes `(-z,
-u)`. Slip below (`u < w`) is a clockwise circle about `(+1, 0)`, slip above a clockwise circle about `(-1,
0)`, and a stick moves along `u = w` until `z = 1`. See `c_yardstick` for the definitions of the statistics.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit

from ._common import GivenResult, Totals, check_case, given_arrays, split_samples

SLIP, RELEASED, STUCK = 0, 1, 2


@njit(cache=False, fastmath=False, nogil=True)
def _arrival(z, u, w):
    """Landing place on `u = w` of the arc from `(z, u)`, and the time to get there (infinite if never)."""
    if u == w:
        if abs(z) <= 1.0:
            # Has arrived already. At z = 1 the arc only touches u = w.
            return z, (0.0 if z < 1.0 else math.inf)
        below = z > 0.0
    else:
        below = u < w
    center = 1.0 if below else -1.0
    d = z - center
    excess = d * d + (u * u - w * w)
    if excess <= 0.0:
        return z, math.inf
    offset = -center * math.sqrt(excess)
    angle = math.atan2(u * offset - d * w, d * offset + u * w)
    if angle <= 0.0:
        angle += 2.0 * math.pi
    return center + offset, angle


@njit(cache=False, fastmath=False, nogil=True)
def _interval(z, u, w, duration):
    """One base interval. Returns the final `z, u`, the number of sticks (0 or 1) and their time."""
    mode, sticks, stick_time = SLIP, 0, 0.0
    while True:
        if mode == STUCK:
            stay = (1.0 - z) / w
            if stay >= duration:
                return z + w * duration, w, sticks, stick_time + duration
            stick_time += stay
            duration -= stay
            z, u, mode = 1.0, w, RELEASED
            continue
        if mode == SLIP:
            landing, time = _arrival(z, u, w)
            if time < duration:
                duration -= time
                z, u = landing, w
                if -1.0 <= landing < 1.0:
                    sticks += 1
                    mode = STUCK
                elif landing == 1.0:
                    mode = RELEASED
                continue
        center = 1.0 if (u < w or mode == RELEASED or (u == w and z > 0.0)) else -1.0
        s, c, d = math.sin(duration), math.cos(duration), z - center
        return center + d * c + u * s, u * c - d * s, sticks, stick_time


@njit(cache=False, fastmath=False, nogil=True)
def _trajectory(z, u, w, t1, gaps, rate, generator):
    """One trajectory in the frame of the base; `gaps` are read first, then drawn if `rate > 0`.

    With `rate <= 0` the base keeps its velocity after the last gap.
    """
    left, intervals, sticks, stick_time = t1, 0, 0, 0.0
    while left > 0.0:
        if intervals < gaps.size:
            gap = gaps[intervals]
        elif rate > 0.0:
            gap = generator.exponential(1.0 / rate)
        else:
            gap = math.inf
        duration = min(gap, left)
        z, u, more, time = _interval(z, u, w, duration)
        z, u = -z, -u
        intervals += 1
        sticks += more
        stick_time += time
        left -= duration
    return z, u, intervals, sticks, stick_time


@njit(cache=False, fastmath=False, nogil=True)
def _ensemble(w, rate, t1, samples, z0, u0, initial_sign, generator):
    none = np.empty(0)
    sums = np.zeros(5)
    for _ in range(samples):
        sign = float(initial_sign)
        if initial_sign == 0:
            sign = 1.0 if generator.random() < 0.5 else -1.0
        _, _, intervals, sticks, stick_time = _trajectory(sign * z0, sign * u0, w, t1, none, rate, generator)
        sums[0] += intervals
        sums[1] += sticks
        sums[2] += stick_time
        sums[3] += sticks * sticks
        sums[4] += stick_time * stick_time
    return sums


def simulate(*, w, rate, t1, samples, y0=(0.0, 0.0), seed=0, initial_sign=0, threads=1) -> Totals:
    """Statistics of `samples` trajectories on a Poisson-switching base; as `c_yardstick.simulate`."""
    check_case(w, t1, rate, initial_sign)
    parts = split_samples(samples, threads)
    generators = np.random.default_rng(seed).spawn(len(parts))
    case = (float(w), float(rate), float(t1))
    start = (float(y0[0]), float(y0[1]))
    with ThreadPoolExecutor(threads) as pool:
        work = [
            pool.submit(_ensemble, *case, part, *start, int(initial_sign), generator)
            for part, generator in zip(parts, generators, strict=True)
        ]
        sums = np.sum([item.result() for item in work], axis=0)
    return Totals(samples, int(sums[0]), int(sums[1]), *(float(value) for value in sums[2:]))


def given_gaps(*, w, t1, gaps, y0=(0.0, 0.0), initial_sign=1) -> GivenResult:
    """The same motion on given gaps, one row per trajectory; same arguments as `c_yardstick.given_gaps`."""
    check_case(w, t1)
    gaps, z0, u0, sign = given_arrays(gaps, y0, initial_sign)
    unused = np.random.default_rng(0)
    rows = []
    for row, z_start, u_start, s in zip(gaps, z0, u0, sign, strict=True):
        start = (s * z_start, s * u_start)
        z, u, intervals, sticks, stick_time = _trajectory(*start, float(w), float(t1), row, 0.0, unused)
        back = s if intervals % 2 == 0 else -s
        rows.append((intervals, sticks, stick_time, back * z, back * u))
    columns = np.array(rows).T
    return GivenResult(columns[0].astype(int), columns[1].astype(int), *columns[2:])
