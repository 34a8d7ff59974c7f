"""What regularised dynamics costs and how wrong it is: trajectories of the default study (200 s), on one thread.

The error is that of the mean stick fraction, against the exact engine on the same realisations. Each round times the
exact engine first, so that the ratios are taken under the same load. The last row is what the papers did: an explicit
Runge-Kutta pair of order 4 and 5 whose steps are at most 1e-4 s.
"""

import time

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from . import worker

ROUNDS = 3
SHORT = 0.25  # s of motion that scipy is given; the rest of the 200 s is extrapolated


def _per_trajectory(answer: dict) -> np.ndarray:
    return np.array([seconds / work for seconds, work in answer["timed"]])


@pytest.mark.parametrize("kind", ["exact", *worker.REGULARIZED])
def test_regularized(benchmark, workers, kind):
    """All settings of one kind; the cheapest of those within 1 % is marked by the table."""
    labels = [f"{kind}; {label}" for label, _, _ in worker.REGULARIZED.get(kind, ())] or [kind]
    rows = []

    def run():
        for label in labels:
            first = workers().ask(label, 0)
            mine, beside = [], []
            for _ in range(ROUNDS):
                beside.append(_per_trajectory(workers().ask("exact", 1))[0])
                mine.append(_per_trajectory(workers().ask(label, 1))[0])
            rows.append({
                "label": label, "error": first["error"], "compile_seconds": first["compile_seconds"],
                "trajectory_s": float(np.median(mine)), "times": float(np.median(np.array(mine) / np.array(beside))),
            })  # fmt: skip

    benchmark.pedantic(run, rounds=1)
    benchmark.extra_info["regularized"] = rows


def test_small_steps(benchmark, workers):
    """RK45 of scipy with a largest step of 1e-4 s, as MATLAB's ode45 in the papers."""
    system, width = worker.system(), 1e-3

    def field(t, y):
        rub = np.tanh((y[1] - worker.SPEED) / width) * system.normal_force
        return y[1], -system.stiffness * y[0] - rub

    mine, beside = [], []

    def run():
        for _ in range(ROUNDS):
            beside.append(_per_trajectory(workers().ask("exact", 1))[0])
            started = time.perf_counter()
            solve_ivp(field, (0.0, SHORT), worker.START, method="RK45", max_step=1e-4, rtol=1e-6, atol=1e-9)
            mine.append((time.perf_counter() - started) * worker.T1 / SHORT)

    benchmark.pedantic(run, rounds=1)
    benchmark.extra_info["regularized"] = [{
        "label": f"scipy RK45, steps of at most 1e-4 s; extrapolated from {SHORT:g} s", "error": None,
        "trajectory_s": float(np.median(mine)), "times": float(np.median(np.array(mine) / np.array(beside))),
    }]  # fmt: skip
