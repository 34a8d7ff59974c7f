"""Time per base interval of the engine and of the yardsticks; w = 2, rate/omega = 0.5, omega t1 = 400.

Every round times each program once: the C programs on one and two threads, the other yardsticks, the engine.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from ..baselines import c_yardstick, diffrax_events, numba_scalar, scipy_events
from ..rounds import Program, Rounds, here
from ..workers import Bench

CASE: dict[str, Any] = {"w": 2.0, "rate": 0.5, "t1": 400.0, "y0": (0.0, 1.0)}
EVENTS, INTERVALS = "C, a step per event, lanes refilled", "C, a step per interval, lanes refilled"
ONE, TWO = ", 1 thread", ", 2 threads"
SHORT = 40.0  # omega t1 of the one trajectory that the general-purpose solvers do
FEW = 3  # and in so many rounds

ENGINE = (
    "totals, 1 thread",
    "totals, 2 threads",
    "totals, uncertain, 1 thread",
    "totals, uncertain, 2 threads",
    "full statistics, 1 thread",
    "full statistics, 2 threads",
    "every stick, 1 thread",
    "every stick, 2 threads",
    "every stick, handed on, 1 thread",
)


def _c(program: str, chain: int, threads: int, samples: int) -> Callable[[int], float]:
    def run(number: int) -> float:
        found = c_yardstick.simulate(program, **CASE, samples=samples, seed=number, chain=chain, threads=threads)
        return found.intervals

    return run


def _one_trajectory(simulate: Callable[..., Any]) -> Callable[[int], float]:
    def run(number: int) -> float:
        gaps = np.random.default_rng(number).exponential(1 / CASE["rate"], 200)
        velocities = CASE["w"] * np.where(np.arange(201) % 2, -1.0, 1.0)
        return simulate(gaps=gaps, velocities=velocities, t1=SHORT, y0=CASE["y0"]).intervals

    return run


def _yardsticks(tiny: bool) -> list[Program]:
    samples = 200 if tiny else 20_000
    found = {
        EVENTS: _c("events", 0, 1, samples),
        EVENTS + TWO: _c("events", 0, 2, samples),
        "C, a step per event, lock step": _c("events", 1, 1, samples),
        INTERVALS: _c("intervals", 0, 1, samples),
        INTERVALS + TWO: _c("intervals", 0, 2, samples),
        "C, a step per interval, lock step": _c("intervals", 1, 1, samples),
        "numba, scalar": lambda number: (
            numba_scalar.simulate(**CASE, samples=10 if tiny else 1_000, seed=number).intervals
        ),
        "scipy solve_ivp, restarted at events": _one_trajectory(scipy_events.simulate),
        "diffrax, restarted at events": _one_trajectory(diffrax_events.simulate),
    }
    slow = ("scipy", "diffrax")
    for run in found.values():
        run(0)
    return [Program(label, here(run), calls=FEW if label.startswith(slow) else None) for label, run in found.items()]


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each program: seconds per interval, and how many times those of others."""
    jax.config.update("jax_enable_x64", True)  # for the yardstick by diffrax
    worker, single = bench.worker(), bench.worker("--float32")
    engine = [worker.program(case, f"stickslip_jax, {case}") for case in ENGINE]
    engine.append(single.program("totals, 1 thread", "stickslip_jax, totals, 1 thread, float32"))
    rounds = Rounds([*_yardsticks(bench.tiny), *engine], bench.rounds)
    rows = []
    for program in rounds.programs:
        label, two = program.label, TWO if program.label.endswith(TWO) else ""
        row = {
            "label": label,
            "interval_s": rounds.each(label),
            "times_events": rounds.ratio(label, EVENTS + two),
            "times_intervals": rounds.ratio(label, INTERVALS + two),
            "compile_s": program.compile_seconds,
        }
        alone = label.removesuffix(TWO)
        if program in engine:
            alone += ONE
            row["times_totals"] = rounds.ratio(label, f"stickslip_jax, totals{two or ONE}")
        if two:
            row["times_one_thread"] = rounds.ratio(label, alone)
        rows.append(row)
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Times C and times totals: with the same number of threads."""
    lines = [
        "| program | ns per base interval | times C by events | times C by intervals | times totals "
        "| two threads are faster by | compile, s |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        cells = [row["label"], f"{1e9 * row['interval_s']:,.1f}"]
        cells += [f"{row['times_events']:,.2f}", f"{row['times_intervals']:,.2f}"]
        cells += [f"{row['times_totals']:.2f}" if "times_totals" in row else ""]
        cells += [f"{1 / row['times_one_thread']:.2f}" if "times_one_thread" in row else ""]
        cells += [f"{row['compile_s']:.1f}" if row["compile_s"] > 0.05 else ""]
        lines.append(f"| {' | '.join(cells)} |")
    return lines
