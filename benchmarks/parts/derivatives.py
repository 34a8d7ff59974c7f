"""The mean stick duration of 5,000 vmapped samples, and it with its derivative by mu, through every engine.

Each program has a process of its own, so that its memory can be told.
"""

from typing import Any

from ..derivatives import ENGINES, MODES, SLOW
from ..rounds import Program, Rounds
from ..workers import Bench, Worker

MOST = 3  # rounds; slow engines have one
PRECISIONS = {"float64": (), "float32": ("--float32",)}


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each engine and precision."""
    rows = []
    for engine in list(ENGINES)[:: 3 if bench.tiny else 1]:
        calls = 1 if engine in SLOW else None
        for precision, options in list(PRECISIONS.items())[: 1 if bench.tiny else None]:
            workers: dict[str, Worker] = {}
            programs: list[Program] = []
            for mode in MODES:
                workers[mode] = bench.worker(*options, alone=f"{engine}, {mode}")
                programs.append(workers[mode].program(f"derivatives: {engine}, {mode}", mode, calls))
            rounds = Rounds(programs, min(MOST, bench.rounds))
            rows.append(
                {
                    "label": f"{engine}, {precision}",
                    "seconds": {mode: rounds.seconds(mode) for mode in MODES},
                    "times_value": {mode: rounds.ratio(mode, "value") for mode in MODES},
                    "memory": {mode: worker.memory for mode, worker in workers.items()},
                    "compile_s": {program.label: program.compile_seconds for program in programs},
                }
            )
            if not bench.tiny:
                bench.close()
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Seconds of the value; times the value; the largest memory of the process, gigabytes."""
    lines = [
        "| engine | value, s | reverse, times the value | forward, times the value | memory, GB: value | reverse "
        "| forward | compile, s: value | reverse | forward |",
        "|---|" + "---:|" * 9,
    ]
    for row in rows:
        cells = [f"{row['seconds']['value']:.2f}", *(f"{row['times_value'][mode]:.2f}" for mode in MODES[1:])]
        cells += [f"{row['memory'][mode] / 1e9:.2f}" for mode in MODES]
        cells += [f"{max(row['compile_s'][mode], 0):.1f}" for mode in MODES]
        lines.append(f"| {row['label']} | {' | '.join(cells)} |")
    return lines
