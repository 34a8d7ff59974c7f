"""Laws with inner states: an ensemble of masses on LuGre's bristles beside implicit solvers, one by one: scipy's, and
LSODA compiled with its equations.

Every round times each program once; errors are measured from the same few starts by all of them.
"""

from typing import Any

import numpy as np

from ..baselines import numba_lsoda, scipy_lugre
from ..rounds import Program, Rounds, here
from ..setups import INNER_TOLERANCES, THREADS, inner_name
from ..sizes import FULL, TINY
from ..workers import Bench

MOST = 5  # rounds
METHODS = "scipy LSODA", "scipy Radau", "numbalsoda"
LEVELS = tuple(zip(INNER_TOLERANCES, (1e-5, 1e-6, 1e-7), (5e-4, 3e-5, 1e-5), (1e-5, 1e-6, 1e-7), strict=True))
"""Relative tolerances of the package and of the other programs at which their errors are about the same."""
FEW, MANY = 4, 512  # trajectories by scipy, and by the compiled program, in a round


def _name(method: str, tolerance: float) -> str:
    return f"{method}, rtol {tolerance:g}"


def _states(method: str, tolerance: float, t1: float, starts: np.ndarray) -> np.ndarray:
    """The last states from `starts` (few, 2)."""
    if method == "numbalsoda":
        return numba_lsoda.simulate(*starts.T.copy(), t1=t1, tolerance=tolerance)
    how = {"t1": t1, "method": method.removeprefix("scipy "), "tolerance": tolerance}
    return np.array([scipy_lugre.simulate(*one, **how) for one in starts])


def _by_another(method: str, tolerance: float, t1: float) -> Program:
    number_of_starts = MANY if method == "numbalsoda" else FEW

    def run(number: int) -> float:
        _states(method, tolerance, t1, np.random.default_rng(number).uniform(-0.2, 0.2, (number_of_starts, 2)))
        return number_of_starts

    return Program(_name(method, tolerance), here(run))


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each program and tolerance."""
    t1, worker = (TINY if bench.tiny else FULL).inner_t1, bench.worker()
    levels, methods = LEVELS[: 1 if bench.tiny else None], METHODS if numba_lsoda.IS_HERE else METHODS[:2]
    others = {_name(*what): what for _, *theirs in levels for what in zip(methods, theirs, strict=False)}
    ours = {inner_name(mine, word): theirs for mine, *theirs in levels for word in THREADS}
    rows = []
    for label, what in others.items():  # which compiles those that are compiled
        error = scipy_lugre.error(_states(*what, t1, scipy_lugre.STARTS), t1)
        rows.append({"label": label, "error": error})
    programs = [*(_by_another(*what, t1) for what in others.values()), *map(worker.program, ours)]
    rounds = Rounds(programs, min(MOST, bench.rounds))
    for row in rows:
        row["each"] = rounds.each(row["label"])
    for label, theirs in ours.items():
        faster = [1 / rounds.ratio(label, _name(*what)) for what in zip(methods, theirs, strict=False)]
        rows.append({"label": label, "error": rounds.error(label), "each": rounds.each(label), "faster": faster})
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Trajectories per second, and how many times those of the others at about the same error."""
    lines = [f"| program | error | trajectories per second | {' | '.join(f'times {name}' for name in METHODS)} |"]
    lines.append("|---|---:|---:|---:|---:|---:|")
    for row in rows:
        faster = [f"{value:.1f}" for value in row.get("faster", ())]
        cells = " | ".join(faster + [""] * (len(METHODS) - len(faster)))
        lines.append(f"| {row['label']} | {row['error']:.1e} | {1 / row['each']:,.1f} | {cells} |")
    return lines
