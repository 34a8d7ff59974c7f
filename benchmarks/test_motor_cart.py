"""The motor and cart: Lima and Sampaio's 20,000 runs of 2 s, beside a scalar Runge-Kutta program in numba.

Half of the runs have mu = 0.2, half 0.5. Each round times numba at the paper's step of 1e-4 s first and the case after
it, so that the ratios are taken under the same load; the medians over the rounds go into `extra_info`.
"""

import time

import numpy as np
import pytest

from .baselines import numba_motor_cart

ROUNDS = 9
T1 = 2.0
ENGINE = (
    "motor and cart, totals, 1 thread",
    "motor and cart, every stick, 1 thread",
    "motor and cart, every stick, 2 threads",
)


def _numba(step: float, threads: int, samples: int = 400):
    def run(number: int) -> float:
        for mu in (0.2, 0.5):
            numba_motor_cart.simulate(mu=mu, t1=T1, samples=samples, seed=number, step=step, threads=threads)
        return 2 * samples * T1

    return run


BESIDE = _numba(1e-4, 1)
YARDSTICKS = {
    "numba, Runge-Kutta, step 1e-4 s": BESIDE,
    "numba, Runge-Kutta, step 1e-4 s, 2 threads": _numba(1e-4, 2),
    "numba, Runge-Kutta, step 1e-3 s": _numba(1e-3, 1, 4000),
}


def _timed(run):
    def timed(number: int) -> tuple[float, float]:
        started = time.perf_counter()
        work = run(number)
        return time.perf_counter() - started, work

    return timed


def _compare(benchmark, label: str, timed) -> None:
    """Benchmark `timed(round) -> (seconds, simulated seconds)`, numba at the paper's step before each round."""
    mine, beside = [], []

    def prepare():
        seconds, work = _timed(BESIDE)(len(mine))
        beside.append(seconds / work)

    def run():
        seconds, work = timed(len(mine))
        mine.append(seconds / work)

    benchmark.pedantic(run, setup=prepare, rounds=ROUNDS, warmup_rounds=0)
    benchmark.extra_info |= {
        "label": label,
        "us_per_second": 1e6 * float(np.median(mine)),
        "all_runs_s": 20_000 * T1 * float(np.median(mine)),
        "speed": float(np.median(np.array(beside) / np.array(mine))),
    }


@pytest.mark.parametrize("label", YARDSTICKS)
def test_yardstick(benchmark, label):
    """The scalar program."""
    YARDSTICKS[label](0)
    _compare(benchmark, label, _timed(YARDSTICKS[label]))


@pytest.mark.parametrize("case", ENGINE)
def test_engine(benchmark, workers, case):
    """The switched engine, in a process of its own for each case, so that memory is told apart."""
    worker = workers("--name", case)
    compile_seconds = worker.ask(case, 0)["compile_seconds"]
    answers = []

    def timed(number):
        answers.append(worker.ask(case, 1))
        return answers[-1]["timed"][0]

    _compare(benchmark, f"stickslip_jax, {case.removeprefix('motor and cart, ')}", timed)
    benchmark.extra_info |= {"compile_seconds": compile_seconds, "memory_gb": answers[-1]["memory"] / 1e9}
