"""General-purpose yardstick: a chain of blocks on a belt by scipy's `solve_ivp`, restarted after every event.

``x_i'' + k (2 x_i - x_i-1 - x_i+1) + p x_i = -sgn(x_i' - BELT) FORCE`` with unit masses, springs `k` between
neighbours and `p` to the ground, and the same friction limit in sticks as in slips.

- `simulate(x, *, t1, tolerance=1e-8) -> Sticks`: one trajectory of blocks that begin at `x` without velocity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

BETWEEN, TO_GROUND, FORCE, BELT = 1.0, 0.2, 0.3, 0.2


class Sticks(NamedTuple):
    """Of each block: number of sticks and total stick time; and the state at t1."""

    count: np.ndarray  # pyright: ignore[reportIncompatibleMethodOverride] - of sticks
    time: np.ndarray
    state: np.ndarray


def stiffness(blocks: int) -> np.ndarray:
    """Of the chain, N/m."""
    matrix = TO_GROUND * np.eye(blocks)
    for i in range(blocks - 1):
        matrix[i : i + 2, i : i + 2] += BETWEEN * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return matrix


def _events(signs: np.ndarray, springs: np.ndarray, begun: float):
    """Of each block: the end of its slip, or of its stick on either side."""
    n, found = len(signs), []
    for i in range(n):
        if signs[i] != 0:
            # At the start of a slip from rest the event is zero: then its sign on the side to which it goes.
            def event(t, y, i=i):
                return signs[i] if t == begun and y[n + i] == BELT else y[n + i] - BELT

            vars(event).update(terminal=True, direction=-signs[i])
            found.append((event, i))
            continue
        for side in (-1.0, 1.0):

            def limit(t, y, i=i, side=side):
                return FORCE - side * (springs[i] @ y[:n])

            vars(limit).update(terminal=True, direction=-1.0)
            found.append((limit, i))
    return found


def simulate(x: np.ndarray, *, t1: float, tolerance: float = 1e-8) -> Sticks:
    """One trajectory of blocks that begin at `x` (m) without velocity."""
    n, springs = len(x), stiffness(len(x))
    y, signs, t = np.concatenate([x, np.zeros(n)]), np.full(n, -1.0), 0.0  # slower than the belt
    count, time = np.zeros(n, int), np.zeros(n)
    while t < t1:
        stuck = signs == 0

        def rates(t, y, stuck=stuck):
            return np.concatenate([y[n:], np.where(stuck, 0.0, -springs @ y[:n] - signs * FORCE)])

        events = _events(signs, springs, t)
        solution = solve_ivp(rates, (t, t1), y, rtol=tolerance, atol=tolerance, events=[event for event, _ in events])
        time[stuck] += solution.t[-1] - t
        t, y = float(solution.t[-1]), solution.y[:, -1].copy()
        for (_, i), times in zip(events, solution.t_events, strict=True):
            if len(times):
                y[n + i], needed = BELT, springs[i] @ y[:n]
                holds = not stuck[i] and abs(needed) <= FORCE
                count[i] += holds
                signs[i] = 0.0 if holds else -np.sign(needed)
    return Sticks(count, time, y)
