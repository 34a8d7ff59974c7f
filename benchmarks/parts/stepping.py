"""Ensembles that run in time steps: time per simulated second of one sample."""

from typing import Any

from ..rounds import Rounds
from ..setups import ENSEMBLES
from ..workers import Bench

THREADS = ("1 thread", "2 threads")


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each ensemble."""
    worker = bench.worker()
    names = [*ENSEMBLES, "motor and cart, totals"]
    programs = [worker.program(f"{name}, {threads}") for name in names for threads in THREADS]
    rounds = Rounds(programs, bench.rounds)
    compiled = {program.label: program.compile_seconds for program in programs}
    return [
        {
            "label": name,
            "compile_s": compiled[f"{name}, {THREADS[0]}"],
            **{threads: rounds.each(f"{name}, {threads}") for threads in THREADS},
        }
        for name in names
    ]


def table(rows: list[dict[str, Any]]) -> list[str]:
    """In microseconds."""
    lines = [
        "| ensemble | us per simulated second, 1 thread | 2 threads | compile, s |",
        "|---|---:|---:|---:|",
    ]
    for row in rows:
        times = " | ".join(f"{1e6 * row[threads]:.2f}" for threads in THREADS)
        lines.append(f"| {row['label']} | {times} | {max(row['compile_s'], 0):.1f} |")
    return lines
