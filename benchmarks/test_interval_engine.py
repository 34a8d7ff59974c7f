"""Time per base interval of the engine and of the yardsticks; w = 2, rate/omega = 0.5, omega t1 = 400.

Each round times the two C programs (a step per event, a step per interval) first and the case after them, so the
ratios are taken under the same load; the medians over the rounds go into `extra_info`.
"""

import time

import numpy as np
import pytest

from .baselines import c_yardstick, diffrax_events, numba_scalar, scipy_events

CASE = {"w": 2.0, "rate": 0.5, "t1": 400.0, "y0": (0.0, 1.0)}
ROUNDS = 15


def _c(program: str, chain: int, threads: int = 1, samples: int = 20_000):
    def run(number: int) -> int:
        return c_yardstick.simulate(
            program, **CASE, samples=samples, seed=number, chain=chain, threads=threads
        ).intervals

    return run


def _numba(number: int) -> int:
    return numba_scalar.simulate(**CASE, samples=1_000, seed=number).intervals


def _one_trajectory(simulate, t1: float):
    """The general-purpose solvers do one short trajectory."""

    def run(number: int) -> int:
        gaps = np.random.default_rng(number).exponential(1 / CASE["rate"], 200)
        velocities = CASE["w"] * np.where(np.arange(201) % 2, -1.0, 1.0)
        return simulate(gaps=gaps, velocities=velocities, t1=t1, y0=CASE["y0"]).intervals

    return run


BESIDE = {"events": _c("events", 0), "intervals": _c("intervals", 0)}  # with lanes refilled: the fastest
YARDSTICKS = {
    "C, a step per event, lanes refilled": BESIDE["events"],
    "C, a step per event, lock step": _c("events", 1),
    "C, a step per interval, lock step": _c("intervals", 1),
    "C, a step per interval, lanes refilled": BESIDE["intervals"],
    "C, a step per interval, lanes refilled, 2 threads": _c("intervals", 0, 2),
    "numba, scalar": _numba,
    "scipy solve_ivp, restarted at events": _one_trajectory(scipy_events.simulate, 40.0),
    "diffrax, restarted at events": _one_trajectory(diffrax_events.simulate, 40.0),
}
ENGINE = [
    ("totals, 1 thread", ()),
    ("totals, 2 threads", ()),
    ("full statistics, 1 thread", ()),
    ("full statistics, 2 threads", ()),
    ("every stick, handed on", ()),
    ("every stick, all kept", ()),
    ("value alone", ()),
    ("value and derivative", ()),
    ("totals, 1 thread", ("--float32",)),
    ("totals, 1 thread", ("--plain", "--pinned")),
    ("totals, 1 thread", ("--plain",)),
    ("totals, 2 threads", ("--plain",)),
]


def _compare(benchmark, label: str, timed) -> None:
    """Benchmark `timed(round) -> (seconds, intervals)`, the C programs before each round."""
    mine, beside = [], {name: [] for name in BESIDE}

    def prepare():
        for name, run_c in BESIDE.items():
            started = time.perf_counter()
            intervals = run_c(len(mine))
            beside[name].append((time.perf_counter() - started) / intervals)

    def run():
        seconds, intervals = timed(len(mine))
        mine.append(seconds / intervals)

    benchmark.pedantic(run, setup=prepare, rounds=ROUNDS, warmup_rounds=0)
    benchmark.extra_info |= {
        "label": label,
        "ns_per_interval": 1e9 * float(np.median(mine)),
    }
    for name, times in beside.items():
        benchmark.extra_info[f"times_{name}"] = float(np.median(np.array(mine) / np.array(times)))


@pytest.mark.parametrize("label", YARDSTICKS)
def test_yardstick(benchmark, label):
    """The other programs."""
    if label.startswith("diffrax"):
        import jax  # noqa: PLC0415 - only here: the other yardsticks do without

        jax.config.update("jax_enable_x64", True)
    YARDSTICKS[label](0)

    def timed(number):
        started = time.perf_counter()
        intervals = YARDSTICKS[label](number)
        return time.perf_counter() - started, intervals

    _compare(benchmark, label, timed)


@pytest.mark.parametrize(("case", "options"), ENGINE, ids="".join)
def test_engine(benchmark, workers, case, options):
    """The engine, in processes of its own."""
    worker = workers(*options)
    compile_seconds = worker.ask(case, 0)["compile_seconds"]

    def timed(number):
        return worker.ask(case, 1)["timed"][0]

    label = f"stickslip_jax, {case}"
    words = {"--float32": "float32", "--plain": "no flags set", "--pinned": "on one core"}
    label += "".join(f", {words[option]}" for option in options)
    _compare(benchmark, label, timed)
    benchmark.extra_info["compile_seconds"] = compile_seconds
