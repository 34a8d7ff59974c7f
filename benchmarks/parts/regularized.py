"""What regularised dynamics costs and how wrong it is: the conference paper's study (200 s), on one thread.

The error is that of the mean stick fraction, against the exact engine on the same realisations. The last row is what
the papers did: an explicit Runge-Kutta pair of order 4 and 5 whose steps are at most 1e-4 s.
"""

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from ..baselines import numba_regularized
from ..rounds import Program, Rounds, here
from ..setups import INTERVALS, OMEGA, REGULARIZED, SPEED, START, T1, system
from ..workers import Bench

EXACT = "exact"
MOST = 3  # rounds; adaptive steps take their time
SHORT = 0.25  # s of motion that scipy is given; the rest of the 200 s is extrapolated


def _small_steps(number: int) -> float:
    """RK45 of scipy with a largest step of 1e-4 s, as MATLAB's ode45 in the papers; returns the share of 200 s."""
    mover, width = system(), 1e-3

    def field(t: float, y: np.ndarray) -> tuple[float, float]:
        rub = np.tanh((y[1] - SPEED) / width) * mover.normal_force
        return y[1], -mover.stiffness * y[0] - rub

    solve_ivp(field, (0.0, SHORT), START, method="RK45", max_step=1e-4, rtol=1e-6, atol=1e-9)
    return SHORT / T1


SCALAR = [(width, step) for width in (1e-3, 1e-4) for step in (3e-2, 1e-2)]


def _scalar(width: float, step: float, number: int) -> float:
    """The scalar loop on random switching bases; returns the trajectories."""
    generator = np.random.default_rng(number)
    most = 32
    for _ in range(most):
        gaps = generator.exponential(OMEGA * T1 / (INTERVALS - 1), 400)
        numba_regularized.follow(
            w=2.0, t1=OMEGA * T1, gaps=gaps, width=2 * width, step=OMEGA * step, y0=(0.0, 2.0),
            initial_sign=generator.choice((-1, 1)),
        )  # fmt: skip
    return most


def _scalar_program(width: float, step: float) -> Program:
    _scalar(width, step, 0)  # compiled
    label = f"fixed steps in a scalar loop, Numba; linear, width {width:g}, step {step:g}"
    return Program(label, here(lambda number: _scalar(width, step, number)))


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each setting."""
    worker = bench.worker()
    exact = worker.program(EXACT)
    small = Program(f"scipy RK45, steps of at most 1e-4 s; extrapolated from {SHORT:g} s", here(_small_steps))
    kinds = {
        EXACT: [],
        **{
            kind: [worker.program(f"{kind}; {label}") for label, _, _ in entries[: 1 if bench.tiny else None]]
            for kind, entries in REGULARIZED.items()
        },
        "numba": [_scalar_program(width, step) for width, step in SCALAR],
        "scipy": [small],
    }
    rows = []
    for kind, programs in kinds.items():
        rounds = Rounds([exact, *programs], min(MOST, bench.rounds))
        rows += [
            {
                "label": program.label,
                "kind": kind,
                "error": rounds.error(program.label),
                "trajectory_s": rounds.each(program.label),
                "times": rounds.ratio(program.label, EXACT),
                "step_s": rounds.each(program.label) / _steps(program.label) if "step 0" in program.label else None,
            }
            for program in programs or [exact]
        ]
    return rows


def _steps(label: str) -> float:
    """Fixed steps of a trajectory, on average: in each base interval one is cut short."""
    return T1 / float(label.rpartition("step ")[2]) + INTERVALS / 2


def table(rows: list[dict[str, Any]]) -> list[str]:
    """The table, in which the cheapest setting of each kind within 1 % is bold."""
    lines = [
        "| method | error of the stick fraction | time of one trajectory | of a fixed step | times the exact engine |",
        "|---|---:|---:|---:|---:|",
    ]
    for row in rows:
        good = [
            other["trajectory_s"]
            for other in rows
            if other["kind"] == row["kind"] and other["error"] is not None and abs(other["error"]) <= 0.01
        ]
        bold = "**" if row["trajectory_s"] == min(good, default=None) else ""
        error = "" if row["error"] is None else f"{100 * row['error']:+.2f} %"
        step = "" if row["step_s"] is None else f"{1e9 * row['step_s']:.0f} ns"
        cells = f"{error} | {_time(row['trajectory_s'])} | {step} | {row['times']:,.0f}"
        lines.append(f"| {bold}{row['label']}{bold} | {cells} |")
    return lines


def _time(seconds: float) -> str:
    if seconds < 1e-3:
        return f"{1e6 * seconds:,.1f} us"
    return f"{1e3 * seconds:,.1f} ms" if seconds < 1 else f"{seconds:,.0f} s"
