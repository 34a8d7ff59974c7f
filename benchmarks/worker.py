"""A process that times JAX cases on request, because XLA's flags and float64 are settled once per process.

It reads one line ``case rounds`` at a time and answers with one JSON line: compile seconds, the most memory used so far
(bytes), and for each round the seconds and the work done: base intervals, seconds of the motor and cart, or
trajectories; of regularised dynamics, the relative error of the mean stick fraction too.
"""

import argparse
import json
import os
import resource
import sys
import time

import diffrax
import jax
import numpy as np

import stickslip_jax as ss
from stickslip_jax import ensemble
from stickslip_jax.dynamics import lanes
from stickslip_jax.dynamics.interval_lanes import IntervalEngine
from stickslip_jax.dynamics.method import EXACT

OMEGA, SPEED, T1, RATE = 2.0, 1.0, 200.0, 1.0  # w = 2, rate/omega = 0.5, omega t1 = 400
INTERVALS = RATE * T1 + 1  # per sample, on average
LAW = ss.PoissonSwitching(speed=SPEED, rate=RATE)
ENGINE_SAMPLES = 40_000
START = (0.0, 1.0)


def system(mu=1.0):
    """The oscillator of the study: omega = 2, stick half-width 0.5 m at mu = 1."""
    return ss.MassSpring(mass=1.0, stiffness=OMEGA**2, normal_force=SPEED * OMEGA / 2, friction=ss.Coulomb(mu))


def _ensemble(keep: str, threads: int):
    def run(round_number: int) -> float:
        many = ss.simulate_ensemble(
            system(), LAW, t1=T1, samples=ENGINE_SAMPLES, key=jax.random.key(round_number), y0=START,
            keep=keep, threads=threads, progress=False,
        )  # fmt: skip
        assert many.finished == ENGINE_SAMPLES
        return ENGINE_SAMPLES * INTERVALS

    return run


def _recording_handed_on():
    """Every stick recorded chunk by chunk, each chunk dropped after use: memory does not grow."""

    def run(round_number: int) -> float:
        key = jax.random.key(round_number)
        job = ensemble._Run.checked(system(), LAW, T1, ENGINE_SAMPLES, key, START, EXACT, "sticks")
        plan = ensemble._Plan.of(ENGINE_SAMPLES, 1, None)
        simulate = ensemble._recorder(job, plan)
        for first in range(0, ENGINE_SAMPLES, plan.samples_per_task):
            part = simulate(first, min(plan.samples_per_task, ENGINE_SAMPLES - first))
            assert np.all(part.results.status == 0)
        return ENGINE_SAMPLES * INTERVALS

    return run


def _kernel(differentiate: bool):
    """The compiled chunk alone, total stick time of each sample, with and without its derivative by mu."""
    width, rows = 256, 16

    def stick_time(mu, words):
        engine = IntervalEngine(system(mu), LAW, T1, START)
        job = lanes.Job(engine, words, np.uint32(0), np.int32(rows))
        return lanes.summarise(job, lanes=width, rows=rows, dtype=jax.numpy.result_type(float)).stick_time

    def with_derivative(mu, words):
        return jax.jvp(lambda m: stick_time(m, words), (mu,), (1.0,))

    compiled = jax.jit(
        with_derivative if differentiate else stick_time, compiler_options={"xla_cpu_prefer_vector_width": 512}
    )

    def run(round_number: int) -> float:
        for part in range(4):
            words = jax.random.key_data(jax.random.fold_in(jax.random.key(round_number), part))
            jax.block_until_ready(compiled(1.0, words))
        return 4 * width * rows * INTERVALS

    return run


def _motor_cart(keep: str, threads: int):
    """The paper's 20,000 runs: 10,000 at mu = 0.2 and at mu = 0.5, every one followed for 2 s."""

    def run(round_number: int) -> float:
        for mu in (0.2, 0.5):
            setup = ss.papers.motor_cart(mu)
            many = ss.simulate_ensemble(
                setup.system, setup.law, t1=setup.t1, y0=setup.y0, samples=10_000,
                key=jax.random.key(round_number), keep=keep, threads=threads, progress=False,
            )  # fmt: skip
            assert many.finished == many.samples
        return 20_000 * setup.t1

    return run


# How many trajectories to time, and the settings, from coarse to fine: (width, step, tolerance, solver).
REGULARIZED = {
    "fixed steps": [
        (f"{shape}, width {width:g}, step {step:g}", 2048, {"width": width, "shape": shape, "step": step})
        for shape, width, step in (
            ("linear", 1e-3, 3e-2), ("linear", 1e-3, 1e-2), ("linear", 1e-4, 3e-2), ("linear", 1e-4, 1e-2),
            ("tanh", 1e-3, 1e-2), ("tanh", 1e-4, 1e-2), ("tanh", 1e-5, 1e-2),
        )
    ],
    "adaptive, Tsit5": [
        (f"{shape}, width {width:g}, rtol {rtol:g}", 256,
         {"width": width, "shape": shape, "rtol": rtol, "solver": diffrax.Tsit5(), "max_steps": 2**16})
        for shape, width, rtol in (
            ("linear", 1e-2, 1e-5), ("linear", 1e-3, 1e-5), ("linear", 1e-3, 1e-6), ("tanh", 1e-3, 1e-6),
        )
    ],
    "adaptive, Kvaerno3": [
        (f"{shape}, width {width:g}, rtol {rtol:g}", 128,
         {"width": width, "shape": shape, "rtol": rtol, "max_steps": 2**16})
        for shape, width, rtol in (("linear", 1e-3, 1e-4), ("linear", 1e-4, 1e-5), ("tanh", 1e-4, 1e-4))
    ],
}  # fmt: skip


def _regularized(samples: int, settings: dict | None):
    """Trajectories of the study by regularised dynamics (None: exact), and how far their stick fraction is off."""
    method = EXACT if settings is None else ss.Regularized(**settings)

    def simulate(number: int, method=method):
        return ss.simulate_ensemble(
            system(), LAW, t1=T1, samples=samples, key=jax.random.key(number), y0=START, threads=1, progress=False,
            method=method, keep="totals",
        )  # fmt: skip

    def run(round_number: int) -> float:
        many = simulate(round_number)
        assert many.finished == samples
        return samples

    exact, got = (ss.stick_fraction(simulate(0, chosen)).value for chosen in (EXACT, method))
    run.error = got / exact - 1
    return run


CASES = {
    "exact": lambda: _regularized(40_000, None),
    **{
        f"{kind}; {label}": lambda samples=samples, settings=settings: _regularized(samples, settings)
        for kind, entries in REGULARIZED.items()
        for label, samples, settings in entries
    },
    "motor and cart, totals, 1 thread": lambda: _motor_cart("totals", 1),
    "motor and cart, every stick, 1 thread": lambda: _motor_cart("sticks", 1),
    "motor and cart, every stick, 2 threads": lambda: _motor_cart("sticks", 2),
    "totals, 1 thread": lambda: _ensemble("totals", 1),
    "totals, 2 threads": lambda: _ensemble("totals", 2),
    "full statistics, 1 thread": lambda: _ensemble("statistics", 1),
    "full statistics, 2 threads": lambda: _ensemble("statistics", 2),
    "every stick, handed on": _recording_handed_on,
    "every stick, all kept": lambda: _ensemble("sticks", 1),
    "value alone": lambda: _kernel(False),
    "value and derivative": lambda: _kernel(True),
}


def main() -> None:
    """Answer requests until the input ends."""
    options = argparse.ArgumentParser()
    options.add_argument("--plain", action="store_true", help="leave XLA's flags alone")
    options.add_argument("--float32", action="store_true")
    options.add_argument("--pinned", action="store_true", help="stay on one core, XLA's own threads included")
    options.add_argument("--name", help="of no effect: lets a case have a process of its own")
    chosen = options.parse_args()
    if chosen.pinned:
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    if not chosen.plain:
        ss.enable_fast_cpu()
    jax.config.update("jax_enable_x64", not chosen.float32)
    ready, answers = {}, sys.stdout
    sys.stdout = sys.stderr
    for line in sys.stdin:
        name, rounds = line.rsplit(maxsplit=1)
        compile_seconds = 0.0
        if name not in ready:
            ready[name] = CASES[name]()
            started = time.perf_counter()
            ready[name](0)
            first = time.perf_counter() - started
            started = time.perf_counter()
            ready[name](0)
            compile_seconds = first - (time.perf_counter() - started)
        timed = []
        for number in range(int(rounds)):
            started = time.perf_counter()
            intervals = ready[name](number + 1)
            timed.append((time.perf_counter() - started, intervals))
        memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        answer = {"compile_seconds": compile_seconds, "timed": timed, "memory": memory}
        answer["error"] = getattr(ready[name], "error", None)
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
