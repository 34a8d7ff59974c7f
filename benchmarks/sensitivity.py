"""Sensitivity of the default study beside its plain value and finite differences: ``python -m benchmarks.sensitivity``.

A process of its own, because XLA's flags are settled once. Prints one JSON line: for each program the median seconds of
100,000 trajectories, and the relative standard error of d(pooled mean stick duration)/d mu.
"""

import argparse
import json
import sys
import time

import jax
import numpy as np

import stickslip_jax as ss
from stickslip_jax import papers

LAW = ss.PoissonSwitching(speed=1.0, rate=1.0)
SAMPLES = 100_000


def programs() -> dict:
    """What to time: functions of the round's number."""

    def options(number: int) -> dict:
        return {"t1": 200.0, "samples": SAMPLES, "key": jax.random.key(number), "y0": (0.0, 1.0)}

    def plain(number):
        return ss.simulate_ensemble(papers.belt_oscillator(), LAW, progress=False, keep="totals", **options(number))

    def derivative(number, **more):
        return ss.sensitivity(
            ss.mean_stick_duration, papers.belt_oscillator(), LAW, wrt="mu", **more, **options(number)
        )

    return {
        "value alone": plain,
        "corrected derivative": derivative,
        "finite difference, step 1 %": lambda number: derivative(number, method="finite-difference", step=0.01),
        "finite difference, step 0.2 %": lambda number: derivative(number, method="finite-difference", step=0.002),
    }


def main() -> None:
    """Time all programs in turn, round by round."""
    options = argparse.ArgumentParser()
    options.add_argument("--rounds", type=int, default=5)
    rounds = options.parse_args().rounds
    jax.config.update("jax_enable_x64", True)
    found = {name: {"seconds": [], "relative_error": []} for name in programs()}
    for number in range(rounds + 1):
        for name, program in programs().items():
            started = time.perf_counter()
            result = program(number)
            if number == 0:
                continue  # compiles
            found[name]["seconds"].append(time.perf_counter() - started)
            if isinstance(result, ss.Sensitivity):
                found[name]["relative_error"].append(result.standard_error / abs(result.derivative))
    medians = {
        name: {key: float(np.median(values)) for key, values in entry.items() if values}
        for name, entry in found.items()
    }
    json.dump(medians, sys.stdout)


if __name__ == "__main__":
    main()
