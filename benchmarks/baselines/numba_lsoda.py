"""Compiled yardstick: the mass on LuGre's bristles of `scipy_lugre` by LSODA (ODEPACK), the equations in numba.

numbalsoda is in no list of requirements: `pip install numbalsoda` builds it, by gfortran and cmake. Where it is not
installed, its rows are left out.

- `IS_HERE`: whether it is. `simulate(x, v, *, t1, tolerance) -> np.ndarray`: last positions and velocities from those
  at first, arrays, (samples, 2), one trajectory after the other on one thread.
"""

from __future__ import annotations

import math
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from .scipy_lugre import BELT, BRISTLES, DAMPING, MU, MU_STATIC, STIFFNESS, STRIBECK_SPEED

IS_HERE = find_spec("numbalsoda") is not None


@cache
def _compiled() -> Any:
    import numba  # noqa: PLC0415

    numbalsoda = import_module("numbalsoda")  # it may not be there
    lsoda = numbalsoda.lsoda

    @numba.cfunc(numbalsoda.lsoda_sig)
    def rates(t, y, found, _):
        slip = y[1] - BELT
        limit = MU + (MU_STATIC - MU) * math.exp(-((slip / STRIBECK_SPEED) ** 2))
        rate = slip - BRISTLES * abs(slip) * y[2] / limit
        found[0], found[1], found[2] = y[1], -STIFFNESS * y[0] - BRISTLES * y[2] - DAMPING * rate, rate

    @numba.njit
    def run(address, x, v, times, tolerance):
        last = np.full((len(x), 2), np.nan)
        for i in range(len(x)):
            start = np.array([x[i], v[i], 0.0])
            # One absolute tolerance for all: of the smallest number, the bristles' deflection, as for the package.
            states, success = lsoda(address, start, times, rtol=tolerance, atol=1e-3 * tolerance, mxstep=100_000)
            if success:
                last[i] = states[-1, :2]
        return last

    return rates, run


def simulate(x: np.ndarray, v: np.ndarray, *, t1: float, tolerance: float) -> np.ndarray:
    """All trajectories from positions `x` (m) and velocities `v` (m/s), the bristles not bent."""
    rates, run = _compiled()
    return run(rates.address, x, v, np.array([0.0, t1]), tolerance)
