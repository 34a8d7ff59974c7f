"""The sequence of sticks as a process: transition kernels and forecasts, which no other program has."""

from typing import Any

from ..cases import SEQUENCE
from ..rounds import Rounds
from ..workers import Bench

MOST = 5  # rounds


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each: how long it takes, of how many transitions or forecasts."""
    worker = bench.worker(alone="sequence")
    programs = [worker.program(f"sequence: {name}", name) for name in SEQUENCE]
    rounds = Rounds(programs, min(MOST, bench.rounds))
    rows = []
    for program in programs:
        seconds, each = rounds.seconds(program.label), rounds.each(program.label)
        rows.append({"label": program.label, "seconds": seconds, "each": each, "number": round(seconds / each)})
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Time, in all and of each transition or forecast."""
    lines = ["| program | time, s | transitions or forecasts | each, us |", "|---|---:|---:|---:|"]
    for row in rows:
        lines.append(f"| {row['label']} | {row['seconds']:.2f} | {row['number']:,} | {1e6 * row['each']:.2g} |")
    return lines
