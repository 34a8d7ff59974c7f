"""Outputs of a user's own: six storeys on a sliding bearing under a record, with none, one and seven; their memory.

Seven: the last position, the peak, five drifts between storeys; found in the pass itself, or from a grid of times, for
which every sample is simulated once more and recorded.
"""

from typing import Any

from ..cases import OUTPUTS
from ..rounds import Rounds
from ..workers import Bench

NONE = next(iter(OUTPUTS))
MOST = 5  # rounds


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each number of outputs, each in a process of its own."""
    workers = {name: bench.worker(alone=name) for name in OUTPUTS}
    programs = [worker.program(f"outputs: {name}", name) for name, worker in workers.items()]
    rounds = Rounds(programs, min(MOST, bench.rounds))
    return [
        {
            "label": program.label,
            "seconds": rounds.seconds(program.label),
            "each": rounds.each(program.label),
            "times": rounds.ratio(program.label, NONE),
            "memory": workers[program.label].memory,
            "compile_s": program.compile_seconds,
        }
        for program in programs
    ]


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Time of all samples on one thread, and the most memory of the process."""
    lines = [
        "| outputs | time, s | of a sample, ms | times none | largest memory, GB | compile, s |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        times = [f"{row['seconds']:.2f}", f"{1e3 * row['each']:.2f}", f"{row['times']:.2g}"]
        cells = [row["label"], *times, f"{row['memory'] / 1e9:.2f}", f"{row['compile_s']:.1f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return lines
