"""How long a first call takes beyond a second: compiled in a new process, and in the next process, which loads it."""

import tempfile
from typing import Any

import numpy as np

from ..compiled import CASES, YARDSTICK
from ..workers import Bench, Worker

MOST = 2  # compilations of each; they vary little


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each case: the medians of its first calls."""
    if bench.tiny:  # one process compiles all of them once
        found = [(name, bench.worker().prepare(f"compiled: {name}")) for name in CASES]
        return [{"label": name, "compile_s": seconds, "load_s": seconds} for name, seconds in found]
    rows = []
    for name in CASES:
        times = []
        for _ in range(min(MOST, bench.rounds)):
            with tempfile.TemporaryDirectory() as folder:
                both = []
                for _ in ("compiled", "loaded"):
                    own = Worker(programs=f"{folder}/programs")
                    both.append(own.prepare(f"compiled: {name}"))
                    own.close()
                times.append(both)
        compiled, loaded = np.median(times, axis=0)
        rows.append({"label": name, "compile_s": float(compiled), "load_s": float(loaded)})
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """In seconds, and in multiples of diffrax's call."""
    unit = next((row["compile_s"] for row in rows if row["label"] == YARDSTICK), None) or np.nan
    return [
        "| what | first process, s | next process, s | first, diffrax = 1 | next, diffrax = 1 |",
        "|---|---:|---:|---:|---:|",
        *(
            f"| {row['label']} | {max(row['compile_s'], 0):.1f} | {max(row['load_s'], 0):.2f} "
            f"| {max(row['compile_s'], 0) / unit:.2f} | {max(row['load_s'], 0) / unit:.2f} |"
            for row in rows
        ),
    ]
