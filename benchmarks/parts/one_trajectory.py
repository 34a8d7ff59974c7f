"""One trajectory of a user's system on a square wave: under `jax.jit`, its gradient, and as it is called."""

from typing import Any

from ..rounds import Rounds
from ..setups import ONE_TRAJECTORY
from ..workers import Bench


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each way of calling."""
    worker = bench.worker("--one-core", alone="one trajectory")
    rounds = Rounds([worker.program(f"one trajectory: {name}", name) for name in ONE_TRAJECTORY], bench.rounds)
    return [
        {
            "label": program.label,
            "seconds": rounds.seconds(program.label),
            "times_jitted": rounds.ratio(program.label, ONE_TRAJECTORY[0]),
            "compile_s": program.compile_seconds,
        }
        for program in rounds.programs
    ]


def table(rows: list[dict[str, Any]]) -> list[str]:
    """In milliseconds."""
    lines = ["| `simulate` | ms | times the first | compile, s |", "|---|---:|---:|---:|"]
    for row in rows:
        cells = f"{1e3 * row['seconds']:.2f} | {row['times_jitted']:.2f} | {max(row['compile_s'], 0):.1f}"
        lines.append(f"| {row['label']} | {cells} |")
    return lines
