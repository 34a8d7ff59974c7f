"""How long a first call takes beyond a second: tracing and compiling, each time in a new process."""

from typing import Any

import numpy as np

from ..compiled import CASES
from ..workers import Bench, Worker

MOST = 2  # compilations of each; they vary little


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each case: the median of its compilations."""
    if bench.tiny:  # one process compiles all of them once
        return [{"label": name, "compile_s": bench.worker().prepare(f"compiled: {name}")} for name in CASES]
    rows = []
    for name in CASES:
        times = []
        for _ in range(min(MOST, bench.rounds)):
            own = Worker()
            times.append(own.prepare(f"compiled: {name}"))
            own.close()
        rows.append({"label": name, "compile_s": float(np.median(times))})
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """In seconds."""
    return [
        "| what | compile, s |",
        "|---|---:|",
        *(f"| {row['label']} | {max(row['compile_s'], 0):.1f} |" for row in rows),
    ]
