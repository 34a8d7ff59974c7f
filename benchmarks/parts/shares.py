"""Where the time of a base interval goes, on one core: random numbers, motion, sticks; and what threads wait for."""

from functools import partial
from typing import Any

from ..baselines import c_yardstick
from ..cases import KEPT, WITHOUT
from ..rounds import Program, Rounds, here
from ..workers import Bench
from .intervals import CASE, INTERVALS

TOTALS = "part: totals"
MANY = 16  # threads


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each program: seconds per interval, as a share of those of totals; or the share under the lock."""
    worker = bench.worker("--one-core")
    programs = [worker.program(f"part: {name}") for name in WITHOUT]
    programs += [worker.program(f"{name}, 1 thread") for _, name in KEPT[1:]]
    programs.append(Program(INTERVALS, here(partial(_c, 200 if bench.tiny else 20_000))))
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


def _c(samples: int, number: int) -> float:
    return c_yardstick.simulate("intervals", **CASE, samples=samples, seed=number, threads=1).intervals


def table(rows: list[dict[str, Any]]) -> list[str]:
    """In units of the time of totals; and what that says."""
    lines = ["| program | ns per base interval | totals = 1 | under Python's lock |", "|---|---:|---:|---:|"]
    for row in rows:
        locked = f"{100 * row['locked']:.1f} %" if "locked" in row else ""
        lines.append(f"| {row['label']} | {1e9 * row['interval_s']:.1f} | {row['times_totals']:.2f} | {locked} |")
    of = {row["label"]: row for row in rows}
    bits, motion = (of[f"totals, without {what}"]["times_totals"] for what in ("Threefry", "random numbers"))
    least, (statistics, sticks) = of[INTERVALS]["times_totals"], (of[f"{name}, 1 thread"] for _, name in KEPT[1:])
    most = MANY / (1 + (MANY - 1) * statistics["locked"])
    return [
        *lines,
        "",
        f"So {100 * (1 - bits):.0f} % of totals are Threefry's bits, {100 * (bits - motion):.0f} % their logarithms, "
        f"and {100 * motion:.0f} % the motion, where C needs {100 * least:.0f} % for all three. Statistics add "
        f"{statistics['times_totals'] - 1:.2f} times totals, the sticks themselves "
        f"{sticks['times_totals'] - statistics['times_totals']:.2f} more. The lock alone would let {MANY} threads be "
        f"at most {most:.1f} times as fast as one with statistics.",
    ]
