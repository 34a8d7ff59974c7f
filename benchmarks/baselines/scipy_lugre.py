"""General-purpose yardstick: a mass on a belt that rubs on LuGre's bristles, by scipy's implicit solvers.

``x'' = -STIFFNESS x - LuGre(x' - BELT)`` with unit mass and normal force; an inner state z of the bristles.

- `simulate(x, v, *, t1, method, tolerance) -> np.ndarray`: position and velocity at t1, of one trajectory.
- `STARTS`, (few, 2): of these `exact(t1)` holds the same, to ten digits; `error(states, t1)` is how far others are off.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

STIFFNESS, BELT = 4.0, 0.1
MU, MU_STATIC, STRIBECK_SPEED, BRISTLES, DAMPING = 0.3, 0.4, 0.01, 1e4, 100.0
SCALES = np.array([0.1, 0.1, MU / BRISTLES])  # of the state: absolute tolerances are these parts of the relative one
STARTS = np.random.default_rng(0).uniform(-0.2, 0.2, (4, 2))


def _rates(t: float, y: np.ndarray) -> tuple[float, float, float]:
    x, v, z = y
    slip = v - BELT
    limit = MU + (MU_STATIC - MU) * math.exp(-((slip / STRIBECK_SPEED) ** 2))
    rate = slip - BRISTLES * abs(slip) * z / limit
    return v, -STIFFNESS * x - BRISTLES * z - DAMPING * rate, rate


def simulate(x: float, v: float, *, t1: float, method: str, tolerance: float) -> np.ndarray:
    """One trajectory from position `x` (m) and velocity `v` (m/s), its bristles not bent."""
    run = solve_ivp(_rates, (0.0, t1), (x, v, 0.0), method=method, rtol=tolerance, atol=tolerance * SCALES)
    return run.y[:2, -1]


@cache
def exact(t1: float) -> np.ndarray:
    """The last states from `STARTS`, (few, 2)."""
    return np.array([simulate(*start, t1=t1, method="Radau", tolerance=1e-10) for start in STARTS])


def error(states: np.ndarray, t1: float) -> float:
    """The median, over `STARTS`, of the larger error of position (m) and velocity (m/s) of these last states."""
    return float(np.median(np.max(np.abs(states - exact(t1)), axis=1)))
