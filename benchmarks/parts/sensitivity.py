"""Time and error of the corrected derivative, beside the plain value and finite differences."""

from typing import Any

from ..cases import SENSITIVITY, VALUE
from ..rounds import Rounds
from ..workers import Bench

MOST = 5  # rounds


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each program; `cost` is the time to a relative error of 1 %, where there is one."""
    worker = bench.worker(alone="sensitivity")
    programs = [worker.program(f"sensitivity: {name}", name) for name in SENSITIVITY]
    rounds = Rounds(programs, min(MOST, bench.rounds))
    rows = []
    for program in programs:
        seconds, error = rounds.seconds(program.label), rounds.error(program.label)
        motion, colon, _ = program.label.rpartition(": ")
        row = {
            "label": program.label,
            "seconds": seconds,
            "times_value": rounds.ratio(program.label, f"{motion}{colon}{VALUE}"),
        }
        if error is not None:
            row |= {"relative_error": error, "cost": seconds * (error / 0.01) ** 2}
        rows.append(row)
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """What derivatives cost."""
    lines = [
        "| program | time, s | times the value | relative standard error | time to an error of 1 %, s |",
        "|---|---:|---:|---:|---:|",
    ]
    for row in rows:
        error = f"{100 * row['relative_error']:.2f} % | {row['cost']:.2g}" if "cost" in row else " | "
        lines.append(f"| {row['label']} | {row['seconds']:.2f} | {row['times_value']:.1f} | {error} |")
    return lines
