"""General-purpose yardstick: a mass on a harmonic base by scipy's `solve_ivp`, restarted after every event.

``x'' + DAMPING x' + x = -mu sgn(x' - v)`` with ``v = AMPLITUDE cos(FREQUENCY t)``: unit mass, spring and normal force.

- `simulate(mu, *, periods, tolerance=1e-8) -> np.ndarray`: the states at the ends of the periods of the base, (periods,
  2), from (0, 0).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

AMPLITUDE, FREQUENCY, DAMPING = 0.8, 1.3, 0.05
PERIOD = 2 * math.pi / FREQUENCY


def _base(t: float) -> tuple[float, float]:
    """Velocity and acceleration of the base."""
    return AMPLITUDE * math.cos(FREQUENCY * t), -AMPLITUDE * FREQUENCY * math.sin(FREQUENCY * t)


def _needed(t: float, x: float) -> float:
    """The friction force that a stick needs, N."""
    velocity, acceleration = _base(t)
    return acceleration + DAMPING * velocity + x


def _arc(t: float, y: np.ndarray, sign: float, mu: float, end: float, tolerance: float):
    """The motion from `t` on until its mode ends, or until `end`."""
    begun = t

    def rates(t, y):
        if sign == 0:
            return _base(t)
        return y[1], -y[0] - DAMPING * y[1] - sign * mu

    def slips(t, y):
        # At the start of a slip from rest the event is zero: then its sign on the side to which it goes.
        return sign if t == begun else y[1] - _base(t)[0]

    def holds(t, y):
        return mu - abs(_needed(t, y[0]))

    event = holds if sign == 0 else slips
    vars(event).update(terminal=True, direction=-1.0 if sign == 0 else -sign)
    return solve_ivp(rates, (t, end), y, rtol=tolerance, atol=tolerance, events=event)


def _mode(t: float, y: np.ndarray, mu: float) -> float:
    """The sign of the relative velocity from here on; `y` has none."""
    needed = _needed(t, y[0])
    return 0.0 if abs(needed) < mu else -math.copysign(1.0, needed)


def simulate(mu: float, *, periods: int, tolerance: float = 1e-8) -> np.ndarray:
    """The states at the ends of the periods."""
    y, states = np.zeros(2), []
    sign = math.copysign(1.0, -AMPLITUDE)
    for _ in range(periods):
        t = 0.0
        while t < PERIOD:
            done = _arc(t, y, sign, mu, PERIOD, tolerance)
            t, y = done.t[-1], done.y[:, -1]
            if done.status == 1:
                y[1] = _base(t)[0]
                sign = -math.copysign(1.0, _needed(t, y[0])) if sign == 0 else _mode(t, y, mu)
        states.append(y.copy())
    return np.array(states)
