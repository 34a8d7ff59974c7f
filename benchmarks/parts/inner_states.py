"""Laws with inner states: an ensemble of masses on LuGre's bristles beside scipy's implicit solvers, one by one.

Every round times each program once; errors are measured from the same few starts by all of them.
"""

from typing import Any

import numpy as np

from ..baselines import scipy_lugre
from ..rounds import Program, Rounds, here
from ..setups import INNER_TOLERANCES, THREADS, inner_name
from ..sizes import FULL, TINY
from ..workers import Bench

MOST = 5  # rounds
METHODS = "LSODA", "Radau"
LEVELS = tuple(zip(INNER_TOLERANCES, (1e-4, 1e-5, 1e-6), (1e-3, 2e-4, 3e-5), strict=True))
"""Relative tolerances of the package and of scipy's methods at which their errors are about the same."""
FEW = 4  # trajectories by scipy in a round


def _scipy_name(method: str, tolerance: float) -> str:
    return f"scipy {method}, rtol {tolerance:g}"


def _by_scipy(method: str, tolerance: float, t1: float) -> Program:
    def run(number: int) -> float:
        for start in np.random.default_rng(number).uniform(-0.2, 0.2, (FEW, 2)):
            scipy_lugre.simulate(*start, t1=t1, method=method, tolerance=tolerance)
        return FEW

    return Program(_scipy_name(method, tolerance), here(run))


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each program and tolerance."""
    t1, worker = (TINY if bench.tiny else FULL).inner_t1, bench.worker()
    levels = LEVELS[: 1 if bench.tiny else None]
    scipy = {_scipy_name(*what): what for _, *theirs in levels for what in zip(METHODS, theirs, strict=True)}
    ours = {inner_name(mine, word): theirs for mine, *theirs in levels for word in THREADS}
    programs = [*(_by_scipy(*what, t1) for what in scipy.values()), *map(worker.program, ours)]
    rounds = Rounds(programs, min(MOST, bench.rounds))
    rows = []
    for label, (method, rtol) in scipy.items():
        states = [scipy_lugre.simulate(*one, t1=t1, method=method, tolerance=rtol) for one in scipy_lugre.STARTS]
        rows.append({"label": label, "error": scipy_lugre.error(np.array(states), t1), "each": rounds.each(label)})
    for label, theirs in ours.items():
        faster = [1 / rounds.ratio(label, _scipy_name(*what)) for what in zip(METHODS, theirs, strict=True)]
        rows.append({"label": label, "error": rounds.error(label), "each": rounds.each(label), "faster": faster})
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Trajectories per second, and how many times those of scipy at about the same error."""
    lines = ["| program | error | trajectories per second | times LSODA | times Radau |", "|---|---:|---:|---:|---:|"]
    for row in rows:
        faster = [f"{value:.1f}" for value in row.get("faster", ())] or ["", ""]
        lines.append(f"| {row['label']} | {row['error']:.1e} | {1 / row['each']:,.1f} | {' | '.join(faster)} |")
    return lines
