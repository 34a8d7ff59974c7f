"""The motor and cart: Lima and Sampaio's 20,000 runs of 2 s, beside a scalar Runge-Kutta program in numba.

Half of the runs have mu = 0.2, half 0.5. Every round times each program once.
"""

from collections.abc import Callable
from typing import Any

from ..baselines import numba_motor_cart
from ..rounds import Program, Rounds, here
from ..workers import Bench

T1 = 2.0
ENGINE = ("totals, 1 thread", "totals, 2 threads", "every stick, 1 thread", "every stick, 2 threads")
BESIDE = "numba, Runge-Kutta, step 1e-4 s"


def _numba(step: float, threads: int, samples: int) -> Callable[[int], float]:
    def run(number: int) -> float:
        for mu in (0.2, 0.5):
            numba_motor_cart.simulate(mu=mu, t1=T1, samples=samples, seed=number, step=step, threads=threads)
        return 2 * samples * T1

    return run


def _yardsticks(tiny: bool) -> list[Program]:
    share = 50 if tiny else 1
    found = {
        BESIDE: _numba(1e-4, 1, 400 // share),
        f"{BESIDE}, 2 threads": _numba(1e-4, 2, 400 // share),
        "numba, Runge-Kutta, step 1e-3 s": _numba(1e-3, 1, 4_000 // share),
    }
    for run in found.values():
        run(0)
    return [Program(label, here(run)) for label, run in found.items()]


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each program; the engine in a process of its own for each case, to measure its memory."""
    programs, workers = _yardsticks(bench.tiny), {}
    for case in ENGINE:
        label = f"stickslip_jax, {case}"
        workers[label] = bench.worker(alone=label)
        programs.append(workers[label].program(f"motor and cart, {case}", label))
    rounds = Rounds(programs, bench.rounds)
    return [
        {
            "label": program.label,
            "simulated_second_s": rounds.each(program.label),
            "speed": rounds.ratio(BESIDE, program.label),
            "compile_s": program.compile_seconds,
            "memory": workers[program.label].memory if program.label in workers else None,
        }
        for program in programs
    ]


def table(rows: list[dict[str, Any]]) -> list[str]:
    """The time of all runs and of one simulated second."""
    lines = [
        "| program | 20,000 runs, s | us per simulated second | speed, numba at 1e-4 s = 1 | compile, s | memory, GB |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        each = row["simulated_second_s"]
        times = f"{20_000 * T1 * each:.2f} | {1e6 * each:.1f} | {row['speed']:.1f}"
        compiled = f"{row['compile_s']:.1f}" if row["compile_s"] > 0.05 else ""
        memory = f"{row['memory'] / 1e9:.2f}" if row["memory"] else ""
        lines.append(f"| {row['label']} | {times} | {compiled} | {memory} |")
    return lines
