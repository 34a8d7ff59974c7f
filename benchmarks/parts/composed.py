"""`simulate` under `jax.vmap`, sampling included, beside `simulate_ensemble`: on one core and on two, in both
precisions.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

from ..rounds import Program, Rounds
from ..setups import EVERY_STICK, MEAN, OWN_ENGINES, STICK_TIME, WIDE
from ..workers import Bench, Worker

TOTALS = 'keep="totals"'
DERIVATIVES = (f"{MEAN}, value_and_grad", f"{MEAN}, jvp")
CLOSED_FORM = OWN_ENGINES[0]
CORES = {"1 thread": "--one-core", "2 threads": ""}
PRECISIONS = {"float64": "", "float32": "--float32"}


def label(engine: str, program: str, precision: str) -> str:
    """What a row is called."""
    return f"{engine}, {precision}: {program}"


def _programs(worker: Worker, precision: str, threads: str) -> list[Program]:
    """All of one precision, compiled."""
    cases = {}
    for engine in OWN_ENGINES:
        cases[label(engine, TOTALS, precision)] = f"beside {engine}, {threads}"
        more = (WIDE, MEAN, *DERIVATIVES) if engine == CLOSED_FORM and precision == "float64" else ()
        for program in (STICK_TIME, EVERY_STICK, *more):
            cases[label(engine, program, precision)] = f"vmapped {engine}: {program}"
    return [worker.program(case, name) for name, case in cases.items()]


def measure(bench: Bench) -> list[dict[str, Any]]:
    """A row for each case: on one core, and on all with as many threads of `simulate_ensemble`."""
    found: dict[str, dict[str, Any]] = {}
    for threads, option in CORES.items():
        workers = [bench.worker(*filter(None, [option, how]), alone="composed") for how in PRECISIONS.values()]
        with ThreadPoolExecutor() as pool:  # both precisions are compiled at the same time
            compiled = list(pool.map(_programs, workers, PRECISIONS, [threads] * len(PRECISIONS)))
        for programs in compiled:
            rounds = Rounds(programs, bench.rounds)
            for program in programs:
                name = program.label
                row = found.setdefault(name, {"label": name, "compile_s": program.compile_seconds})
                beside = name.split(": ")[0]
                row[threads] = {
                    "seconds": rounds.seconds(name),
                    "times_totals": rounds.ratio(name, f"{beside}: {TOTALS}"),
                    "times_value": rounds.ratio(name, f"{beside}: {MEAN}") if name.endswith(DERIVATIVES) else None,
                }
    order = [f"{engine}, {precision}" for precision in PRECISIONS for engine in OWN_ENGINES]
    return sorted(found.values(), key=lambda row: order.index(row["label"].split(": ")[0]))


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
