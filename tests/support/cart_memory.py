"""A motor that drives a cart whose friction has a memory or a direction, event by event by scipy."""

import math

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

MASS, ARM, INERTIA, DAMPING, CONSTANT, RESISTANCE, INDUCTANCE = 5.0, 0.01, 1.21e-4, 1.545e-4, 5.33e-2, 0.307, 1.88e-4
TORQUE = MASS * 9.81 * ARM
MEAN, AMPLITUDE, FREQUENCY = 0.3, 1.5, 10.0
_BEGINNING = 1e-6  # s, of a slip, in which its event is not looked for


def voltage(t):
    return MEAN + AMPLITUDE * np.sin(FREQUENCY * t)


def sticks_of(kinetic, limit, t1, y):
    """Starts, ends and angles of the sticks until `t1` from the state `y`, and the last state.

    `kinetic`: coefficient by the direction of the cart and its speed; `limit`: of a stick that would break into that
    direction, by it and the age.
    """
    t, found = 0.0, []
    way = math.copysign(1, y[1]) if y[1] else _way_at_rest(limit, y)
    while t < t1:
        if way:
            t, y = _slipped(kinetic, t, t1, y, way)
            way = 0.0 if t == t1 else _way_at_rest(limit, y)
            continue
        start, first = t, y

        def spare(now, start=start, first=first):
            current = _current(now, start, first[2])
            held = limit(_direction(first[0], current), now - start) * TORQUE * abs(math.sin(first[0]))
            return held - CONSTANT * abs(current)

        times = np.linspace(t, t1, max(int((t1 - t) / 2e-4), 2))
        over = np.flatnonzero(np.array([spare(now) for now in times[1:]]) < 0)
        t = brentq(spare, *times[over[0] : over[0] + 2], xtol=1e-16, rtol=1e-15) if len(over) else t1
        y = np.array([first[0], 0.0, _current(t, start, first[2])])
        found.append((start, t, first[0]))
        way = math.copysign(1, y[2])
    return np.array(found), y


def _direction(angle, way):
    """The direction in which the cart moves if the motor turns this way."""
    return -math.copysign(1, math.sin(angle) * way)


def _way_at_rest(limit, y):
    """Which way the motor turns from rest; 0 where friction holds it."""
    held = limit(_direction(y[0], y[2]), 0.0) * TORQUE * abs(math.sin(y[0]))
    return 0.0 if CONSTANT * abs(y[2]) <= held else math.copysign(1, y[2])


def _steady(t):
    reactance = INDUCTANCE * FREQUENCY
    size, lag = AMPLITUDE / math.hypot(RESISTANCE, reactance), math.atan2(reactance, RESISTANCE)
    return MEAN / RESISTANCE + size * math.sin(FREQUENCY * t - lag)


def _current(t, start, current):
    """The current of a motor that stands still since `start`."""
    return _steady(t) + (current - _steady(start)) * math.exp(-RESISTANCE / INDUCTANCE * (t - start))


def _slipped(kinetic, t, t1, y, way):
    """Time and state where the motor that turns this way stops."""
    turn = math.floor(y[0] / math.pi)
    while t < t1:
        kink, sign = math.pi * (turn + (way > 0)), _direction(math.pi * (turn + 0.5), way)

        def rates(now, state, sign=sign):
            angle, speed, current = state
            sine, cosine = math.sin(angle), math.cos(angle)
            # The force on the cart, at ``ARM cos(angle)``, acts against its motion.
            force = -sign * kinetic(sign, abs(ARM * sine * speed)) * MASS * 9.81
            torque = (
                CONSTANT * current - DAMPING * speed - MASS * ARM**2 * sine * cosine * speed**2 - force * ARM * sine
            )
            across = voltage(now) - RESISTANCE * current - CONSTANT * speed
            return [speed, torque / (INERTIA + MASS * ARM**2 * sine**2), across / INDUCTANCE]

        def stops(now, state):
            return way * state[1]

        def turns(now, state, kink=kink):
            return way * (kink - state[0])

        stops.terminal = turns.terminal = True
        stops.direction = turns.direction = -1
        accurate = {"rtol": 1e-13, "atol": 1e-14, "method": "DOP853", "max_step": 2e-3}
        first = solve_ivp(rates, (t, min(t + _BEGINNING, t1)), y, **accurate)
        run = solve_ivp(rates, (first.t[-1], t1), first.y[:, -1], events=(stops, turns), **accurate)
        t, y = run.t[-1], run.y[:, -1]
        if run.status != 1:
            return t1, y
        if len(run.t_events[0]):
            return t, np.array([y[0], 0.0, y[2]])
        y[0], turn = kink, turn + int(way)
    return t, y
