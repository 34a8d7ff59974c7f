"""Where the time of a base interval goes, on one core: random numbers, motion, sticks; and what threads wait for."""

from typing import Any

from ..cases import KEPT, WITHOUT
from ..rounds import Rounds
from ..workers import Bench

TOTALS = "part: totals"


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each program: seconds per interval, as a share of those of totals; or the share under the lock."""
    worker = bench.worker("--one-core")
    programs = [worker.program(f"part: {name}") for name in WITHOUT]
    programs += [worker.program(f"{name}, 1 thread") for _, name in KEPT[1:]]
    rounds = Rounds(programs, bench.rounds)
    rows = [
        {
            "label": program.label.removeprefix("part: "),
            "interval_s": rounds.each(program.label),
            "times_totals": rounds.ratio(program.label, TOTALS),
        }
        for program in programs
    ]
    watched = bench.worker(alone="locked")
    locked = Rounds([watched.program(f"locked: {name}") for _, name in KEPT], bench.rounds)
    for _, name in KEPT:
        own = name if name == "totals" else f"{name}, 1 thread"
        next(row for row in rows if row["label"] == own)["locked"] = locked.error(f"locked: {name}")
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """In units of the time of totals."""
    lines = ["| program | ns per base interval | totals = 1 | under Python's lock |", "|---|---:|---:|---:|"]
    for row in rows:
        locked = f"{100 * row['locked']:.1f} %" if "locked" in row else ""
        lines.append(f"| {row['label']} | {1e9 * row['interval_s']:.1f} | {row['times_totals']:.2f} | {locked} |")
    return lines
