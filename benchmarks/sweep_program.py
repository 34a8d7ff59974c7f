"""One run of a parameter sweep, or of the loop that one would write by hand, in a fresh process.

``python -m benchmarks.sweep_program loop totals 64 10000``: the points are those of a square grid of (mu, rate). Prints
seconds (from after the imports, so with all compilations) and the largest memory, as JSON.
"""

import json
import sys
import tempfile
import time
from typing import Any

import h5netcdf  # noqa: F401 - what is imported is not timed
import jax
import numpy as np
import xarray as xr

import stickslip_jax as ss
from stickslip_jax import papers

from .memory import largest_memory

T1 = 200.0
STATISTICS = (ss.stick_fraction, ss.mean_stick_count, ss.mean_slip_count, ss.mean_stick_duration, ss.mean_slip_duration)


def grid(points: int) -> tuple[np.ndarray, np.ndarray]:
    """Values of mu and rate, whose combinations are that many points, a square number."""
    side = round(points**0.5)
    return np.linspace(0.5, 2.0, side), np.geomspace(0.2, 5.0, side)


def loop(keep: Any, points: int, samples: int) -> None:
    """The loop: nothing is stored until the end, and nothing can be resumed."""
    mus, rates = grid(points)
    found = []
    for mu in mus:
        for rate in rates:
            system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu))
            law = ss.PoissonSwitching(papers.BELT_SPEED, rate)
            many = ss.simulate_ensemble(system, law, t1=T1, samples=samples, key=jax.random.key(0), keep=keep)
            values = {one.name: one(many).value for one in STATISTICS}
            values |= {f"{one.name}_error": one(many).standard_error for one in STATISTICS}
            point = xr.Dataset(values) if keep == "totals" else many.statistics.to_xarray().assign(values)
            found.append(point.assign_coords(mu=mu, rate=rate))
    for name in ("mu", "rate"):  # histograms have bins of their own at each point: kept, not combined
        assert len({float(point[name]) for point in found}) == len(mus)


def sweep(keep: Any, points: int, samples: int) -> None:
    """The same as a sweep, stored batch by batch."""
    mus, rates = grid(points)
    with tempfile.TemporaryDirectory() as folder:
        ss.Sweep(
            papers.belt_oscillator(), ss.PoissonSwitching(papers.BELT_SPEED, 1.0), over={"mu": mus, "rate": rates},
            t1=T1, samples=samples, key=jax.random.key(0), keep=keep,
        ).run(folder, progress=False)  # fmt: skip


def main() -> None:
    """Run what the arguments name."""
    program, keep, points, samples = sys.argv[1:]
    jax.config.update("jax_enable_x64", True)
    jax.numpy.zeros(1).block_until_ready()  # starts JAX
    started = time.perf_counter()
    {"loop": loop, "sweep": sweep}[program](keep, int(points), int(samples))
    seconds = time.perf_counter() - started
    print(json.dumps({"seconds": seconds, "memory": largest_memory()}))


if __name__ == "__main__":
    main()
