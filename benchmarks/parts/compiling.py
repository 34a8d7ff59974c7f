"""How long a first call takes beyond a second, compiled in a new process, and in the next process, which loads it; and
how many programs of how many operations it compiles.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..compiled import CASES, YARDSTICK
from ..workers import Bench, Worker

MOST = 2  # compilations of each; they vary little


def _operations(name: str, *options: str) -> list[int]:
    """Of each program that the case compiles, operations before XLA makes them fewer (of its StableHLO)."""
    with tempfile.TemporaryDirectory() as folder:
        own = Worker(*options, JAX_DUMP_IR_TO=folder, STICKSLIP_PROGRAMS="off")
        own.prepare(f"compiled: {name}")
        own.close()
        return [file.read_text().count(" = ") for file in Path(folder).glob("*.mlir")]


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each case: the medians of its first calls, and the operations of its programs."""
    if bench.tiny:  # one process compiles all of them once
        found, operations = (
            [(name, bench.worker().prepare(f"compiled: {name}")) for name in CASES],
            _operations(YARDSTICK, "--tiny"),
        )
        return [
            {"label": name, "compile_s": seconds, "load_s": seconds, "operations": operations}
            for name, seconds in found
        ]
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
        rows.append(
            {"label": name, "compile_s": float(compiled), "load_s": float(loaded), "operations": _operations(name)}
        )
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """In seconds, and in multiples of diffrax's call; small programs, as of one sum, are counted too."""
    unit = next((row["compile_s"] for row in rows if row["label"] == YARDSTICK), None) or np.nan
    return [
        "| what | first process, s | next process, s | first, diffrax = 1 | next, diffrax = 1 | programs | operations "
        "| of the largest |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
        *(
            f"| {row['label']} | {max(row['compile_s'], 0):.1f} | {max(row['load_s'], 0):.2f} "
            f"| {max(row['compile_s'], 0) / unit:.2f} | {max(row['load_s'], 0) / unit:.2f} "
            f"| {len(row['operations'])} | {sum(row['operations']):,} | {max(row['operations'], default=0):,} |"
            for row in rows
        ),
    ]
