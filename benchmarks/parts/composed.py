"""`simulate` under `jax.vmap`, sampling included, beside `simulate_ensemble`: on one core and on two."""

from typing import Any

from ..rounds import Rounds
from ..workers import Bench

TOTALS, VALUE, HARMONIC = "totals", "vmapped: mean stick duration", "vmapped: harmonic base"
STEPPED = "harmonic base of random phase"
POISSON = (
    "vmapped: stick time alone",
    "vmapped: every stick, in order",
    VALUE,
    "vmapped: mean stick duration, value_and_grad",
    "vmapped: mean stick duration, jvp",
)
BESIDE = {TOTALS: 'keep="totals"', STEPPED: 'keep="totals", harmonic base'}
CORES = {"1 thread": "--one-core", "2 threads": ""}


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each case: on one core, and on all with as many threads of `simulate_ensemble`."""
    found: dict[str, dict[str, Any]] = {}
    for threads, option in CORES.items():
        worker = bench.worker(*filter(None, [option]), alone="composed")
        cases = {**{case: f"{case}, {threads}" for case in BESIDE}, **{case: case for case in (*POISSON, HARMONIC)}}
        rounds = Rounds([worker.program(case, label) for label, case in cases.items()], bench.rounds)
        for program in rounds.programs:
            label = program.label
            row = found.setdefault(label, {"label": BESIDE.get(label, label), "compile_s": program.compile_seconds})
            row[threads] = {
                "seconds": rounds.seconds(label),
                "times_totals": rounds.ratio(label, STEPPED if label in (STEPPED, HARMONIC) else TOTALS),
                "times_value": rounds.ratio(label, VALUE) if label.startswith(f"{VALUE}, ") else None,
            }
    return list(found.values())


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Seconds of a call, and times the work of `keep="totals"` in the same time."""
    lines = [
        "| program | 1 core, s | times totals | times the value | 2 cores, s | times totals | times the value "
        "| compile, s |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        cells = [row["label"]]
        for threads in CORES:
            told = row[threads]
            cells += [f"{told['seconds']:.3f}", f"{told['times_totals']:.2f}"]
            cells += [f"{told['times_value']:.2f}" if told["times_value"] else ""]
        lines.append(f"| {' | '.join(cells)} | {max(row['compile_s'], 0):.1f} |")
    return lines
