"""Bifurcation diagrams and basins, beside one trajectory by scipy."""

from typing import Any

from ..baselines import scipy_harmonic
from ..rounds import Program, Rounds, here
from ..setups import basin_name, diagram_name
from ..sizes import FULL, TINY
from ..workers import Bench

SCIPY = "scipy solve_ivp, restarted at events"
CALLS = 3  # rounds in which it takes part


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each program."""
    sizes, worker = TINY if bench.tiny else FULL, bench.worker()

    def one(number: int) -> float:
        scipy_harmonic.simulate(0.3 + 0.01 * number, periods=sizes.scipy_periods)
        return sizes.scipy_periods

    diagrams = [diagram_name(values) for values in sizes.diagrams]
    names = [*diagrams, *map(basin_name, sizes.basins)]
    programs = [Program(SCIPY, here(one), calls=CALLS), *map(worker.program, names)]
    rounds = Rounds(programs, bench.rounds)
    compiled = {program.label: program.compile_seconds for program in programs}
    rows = [{"label": SCIPY, "each": rounds.each(SCIPY)}]
    for name in names:
        row = {
            "label": name,
            "each": rounds.each(name),
            "seconds": rounds.seconds(name),
            "times_scipy": rounds.ratio(name, SCIPY),
            "compile_s": compiled[name],
        }
        rows.append(row)
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """In seconds, and microseconds for each period of a motion."""
    lines = [
        "| program | seconds | us per period | times as fast as scipy | compile, s |",
        "|---|---:|---:|---:|---:|",
    ]
    for row in rows:
        cells = ["", f"{1e6 * row['each']:,.1f}", "", ""]
        if "seconds" in row:
            cells[0], cells[2] = f"{row['seconds']:.2f}", f"{1 / row['times_scipy']:,.0f}"
            cells[3] = f"{max(row['compile_s'], 0):.1f}"
        lines.append(f"| {row['label']} | {' | '.join(cells)} |")
    return lines
