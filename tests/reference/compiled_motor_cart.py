"""Reference for the motor and cart, one scalar loop compiled by Numba: steps of DOP853 to nearly the last digit.

Each arc ends where the motor stops or at dead centre, where ``|sin|`` has its kink; both are found by bisection, with
each try a step of its own from where the step began. In a stick the current is known in closed form; its end is looked
for between samples, 16 in an electrical time constant and 2000 in a period.

`event_driven.py` is slower and shares nothing with this file; `tests/systems/test_fast_motors.py` compares them.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.integrate import DOP853

A, B, C, ERROR = (np.array(part, float) for part in (DOP853.A, DOP853.B, DOP853.C, DOP853.E5))
STOP, DEAD_CENTER = 1, 2
HALVINGS = 70


class Numbers(NamedTuple):
    """A set-up, in SI units; `power`: of the angular velocity in the term with sin cos, 2 (physical) or 1 (printed)."""

    mu: float
    m: float
    d: float
    j_m: float
    b_m: float
    k_e: float
    r: float
    l: float  # noqa: E741
    nu0: float
    nu1: float
    omega_v: float
    theta: float
    power: int = 2
    g: float = 9.81


@njit
def _rates(p, load, t, y, out):
    sine, cosine = math.sin(y[0]), math.cos(y[0])
    inertia = p.m * p.d * p.d
    out[0] = y[1]
    push = p.k_e * y[2] - p.b_m * y[1] - load * sine - inertia * sine * cosine * y[1] ** p.power
    out[1] = push / (p.j_m + inertia * sine * sine)
    out[2] = (p.nu0 + p.nu1 * math.sin(p.omega_v * t + p.theta) - p.r * y[2] - p.k_e * y[1]) / p.l


@njit
def _step(p, load, t, y, h, slopes, reached):
    """The state `reached` in a step, by its `slopes`; returns the largest error, relative to state and unit."""
    inner = np.empty(3)
    for i in range(len(B)):
        for k in range(3):
            inner[k] = y[k] + h * np.sum(A[i, :i] * slopes[:i, k])
        _rates(p, load, t + C[i] * h, inner, slopes[i])
    worst = 0.0
    for k in range(3):
        reached[k] = y[k] + h * np.sum(B * slopes[:, k])
        wrong = abs(h * np.sum(ERROR[: len(B)] * slopes[:, k]))
        worst = max(worst, wrong / (1 + abs(y[k]) + abs(reached[k])))
    return worst


@njit
def _steady(p, t):
    """The steady current of a motor at rest."""
    lag, phase = p.l * p.omega_v, p.omega_v * t + p.theta
    return p.nu0 / p.r + p.nu1 * (p.r * math.sin(phase) - lag * math.cos(phase)) / (p.r * p.r + lag * lag)


@njit
def _held(p, since, current, t):
    """The current in a stick that began with this `current`."""
    return _steady(p, t) + (current - _steady(p, since)) * math.exp((since - t) * p.r / p.l)


@njit
def _released(p, band, since, current, t1):
    """When a stick ends, at most `t1`."""
    decay, most = p.l / p.r, math.pi / (1000 * p.omega_v)
    t = since
    while t < t1:
        ahead = min(t + (min(decay / 16, most) if t - since < 40 * decay else most), t1)
        if p.k_e * abs(_held(p, since, current, ahead)) > band:
            for _ in range(HALVINGS):
                middle = 0.5 * (t + ahead)
                if p.k_e * abs(_held(p, since, current, middle)) > band:
                    ahead = middle
                else:
                    t = middle
            return ahead
        t = ahead
    return t1


@njit
def _first_event(p, load, t, y, h, slopes, reached, side, kink):
    """Where in a step of length `h` to `reached` the motor stops or comes to dead centre, and which; infinity, 0."""
    first, which = math.inf, 0
    for event in (STOP, DEAD_CENTER):
        if side * (reached[1] if event == STOP else kink - reached[0]) > 0:
            continue
        low, high, inner = 0.0, h, np.empty(3)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            _step(p, load, t, y, middle, slopes, inner)
            if side * (inner[1] if event == STOP else kink - inner[0]) > 0:
                low = middle
            else:
                high = middle
        if high < first:
            first, which = high, event
    return first, which


@njit
def follow(p, y0, t1, tolerance):
    """The state at `t1`, and the number of sticks. `tolerance`: of a step."""
    t, y, reached, slopes, sticks, h = 0.0, y0.copy(), np.empty(3), np.empty((len(B), 3)), 0, 1e-6
    rub, side, turn = p.mu * p.m * p.d * p.g, int(np.sign(y0[1])), math.floor(y0[0] / math.pi)
    while t < t1:
        if side == 0:  # at rest
            band = rub * abs(math.sin(y[0]))
            if rub > 0 and abs(p.k_e * y[2]) <= band:
                end = _released(p, band, t, y[2], t1)
                y[2], t, sticks = _held(p, t, y[2], end), end, sticks + 1
            push = p.k_e * y[2] if y[2] != 0 else p.nu0 + p.nu1 * math.sin(p.omega_v * t + p.theta)
            side, h = 1 if push > 0 else -1, 1e-7
            continue
        kink = math.pi * (turn + (side > 0))
        load = rub * side * (1 - 2 * (turn % 2))
        h = min(h, t1 - t)
        error = _step(p, load, t, y, h, slopes, reached)
        if error > tolerance:
            h *= max(0.2, 0.9 * (tolerance / error) ** 0.125)
            continue
        first, which = _first_event(p, load, t, y, h, slopes, reached, side, kink)
        if which:
            _step(p, load, t, y, first, slopes, reached)
        t = t + first if which else (t1 if h == t1 - t else t + h)
        y[:] = reached
        if which == STOP:
            y[1], side = 0.0, 0
        elif which == DEAD_CENTER:
            y[0], turn = kink, turn + side
        h = max(first, 1e-8) if which else h * min(5.0, 0.9 * (tolerance / max(error, 1e-30)) ** 0.125)
    return y, sticks
