"""A parameter sweep beside the loop that one would write by hand, and its cost against points and samples.

Every run is a process of its own, so that the compilation counts.
"""

import json
import subprocess
import sys
from typing import Any

import numpy as np

from ..workers import Bench

MOST = 5
"""Rounds: each takes a minute."""
KEEP = ("totals", "statistics")
GROWTH = ((16, 2_500), (64, 2_500), (256, 2_500), (1_024, 2_500), (16, 10_000), (16, 40_000), (16, 160_000))
"""Points and samples of the rows that show how the cost grows."""


def _run(program: str, keep: str, points: int, samples: int) -> dict[str, float]:
    command = [sys.executable, "-W", "ignore", "-m", "benchmarks.sweep_program", program, keep]
    done = subprocess.run([*command, str(points), str(samples)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed: {done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def measure(bench: Bench) -> list[dict[str, Any]]:
    """Rows for loop and sweep by what is kept, interleaved; then rows for the growth, once each round."""
    rounds, share = min(bench.rounds, MOST), 25 if bench.tiny else 1
    cases = [
        (program, keep, 64 if share == 1 else 4, 10_000 // share) for keep in KEEP for program in ("loop", "sweep")
    ]
    cases += [("sweep", "totals", points if share == 1 else 4, samples // share) for points, samples in GROWTH]
    cases = list(dict.fromkeys(cases))
    runs: dict[tuple[Any, ...], list[dict[str, float]]] = {case: [] for case in cases}
    for _ in range(rounds):
        for case in cases:
            runs[case].append(_run(*case))
    rows = []
    for case in cases:
        seconds = [run["seconds"] for run in runs[case]]
        beside = runs.get(("loop", *case[1:]), runs[case])
        ratios = [run["seconds"] / other["seconds"] for run, other in zip(runs[case], beside, strict=True)]
        rows.append(
            {
                "program": case[0],
                "keep": case[1],
                "points": case[2],
                "samples": case[3],
                "seconds": float(np.median(seconds)),
                "ratio": float(np.median(ratios)),
                "memory": max(run["memory"] for run in runs[case]),
            }
        )
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Time, its ratio to the loop, and memory."""
    lines = [
        "| program | keep | points | samples of each | time with compilation, s | loop = 1 | memory, GB |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    looped = {tuple(row[name] for name in ("keep", "points", "samples")) for row in rows if row["program"] == "loop"}
    for row in rows:
        beside = tuple(row[name] for name in ("keep", "points", "samples")) in looped
        ratio = f"{row['ratio']:.2f}" if beside else ""
        lines.append(
            f"| {row['program']} | {row['keep']} | {row['points']} | {row['samples']:,} | {row['seconds']:.1f} | "
            f"{ratio} | {row['memory'] / 1e9:.2f} |"
        )
    return lines
