"""A mass on a spring whose friction grows while it sticks and differs between directions, event by event by scipy."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

MASS, STIFFNESS, DAMPING, NORMAL = 1.0, 4.0, 0.1, 1.0


def base(t):
    """Velocity, acceleration and displacement of the base."""
    return np.cos(0.9 * t), -0.9 * np.sin(0.9 * t), np.sin(0.9 * t) / 0.9


def sticks_of(kinetic, limit, t1, y):
    """Starts and ends of the sticks until `t1`, and the last state.

    `kinetic`: coefficient of a slip by its sign; `limit`: of a stick that would break into one, by sign and age.
    """
    t, sign, found = 0.0, 1.0 if y[1] > base(0.0)[0] else -1.0, []
    while t < t1:
        if sign:
            t, y, sign = _slipped(kinetic(sign), limit, t, t1, y, sign)
            continue
        start, origin = t, y[0] - base(t)[2]

        def spare(now, start=start, origin=origin):
            needed = _needed(now, origin + base(now)[2])
            return limit(-np.sign(needed), now - start) * NORMAL - abs(needed)

        times = np.linspace(t, min(t1, t + 8.0), 4001)
        over = np.flatnonzero(np.array([spare(now) for now in times]) < 0)
        t = t1 if not len(over) else brentq(spare, times[over[0] - 1], times[over[0]], xtol=1e-15, rtol=1e-14)
        y = np.array([origin + base(t)[2], base(t)[0]])
        found.append((start, t))
        sign = -np.sign(_needed(t, y[0]))
    return np.array(found), y


def _needed(t, x):
    velocity, acceleration, _ = base(t)
    return MASS * acceleration + DAMPING * velocity + STIFFNESS * x


def _slipped(coefficient, limit, t, t1, y, sign):
    """Time, state and mode after a slip."""

    def rates(now, state):
        force = sign * coefficient * NORMAL
        return [state[1], (-DAMPING * state[1] - STIFFNESS * state[0] - force) / MASS]

    def at_base(now, state):
        return sign * (state[1] - base(now)[0])

    at_base.terminal, at_base.direction = True, -1
    # The slip begins with no relative velocity: its event is looked for from a little later.
    first = solve_ivp(rates, (t, t + 1e-4), y, rtol=1e-13, atol=1e-14, method="DOP853")
    run = solve_ivp(
        rates, (t + 1e-4, t1), first.y[:, -1], events=at_base, rtol=1e-13, atol=1e-14, method="DOP853", max_step=0.1
    )
    t, y = run.t[-1], run.y[:, -1]
    if run.status != 1:
        return t1, y, sign
    needed = _needed(t, y[0])
    return t, y, 0.0 if abs(needed) <= limit(-np.sign(needed), 0.0) * NORMAL else -sign
