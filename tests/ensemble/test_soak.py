"""Ensembles in threads for a long time: the same numbers each time, and memory that does not grow.

An hour of it: ``STICKSLIP_SOAK_MINUTES=60 pytest -m slow -s tests/ensemble/test_soak.py``.
"""

import gc
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np
import pytest

import stickslip_jax as ss

MINUTES = float(os.environ.get("STICKSLIP_SOAK_MINUTES", "1"))
GROWTH = (
    2**25
)  # bytes between the middle and the last third of the time; a leak of one ensemble a round is ten times it

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=0.8))
HARMONIC = ss.RandomPhase(ss.Harmonic(amplitude=1.0, angular_frequency=1.3))
CART = ss.MotorCart(mu=0.4)
CASES = {
    "closed form": (SYSTEM, ss.PoissonSwitching(1.0, 1.0), {"t1": 40.0, "y0": (0.0, 1.0), "samples": 2000}),
    "steps": (SYSTEM, HARMONIC, {"t1": 10.0, "y0": (0.0, 0.0), "samples": 600}),
    "regularized": (
        SYSTEM, HARMONIC, {"t1": 3.0, "y0": (0.0, 0.0), "samples": 200, "method": ss.Regularized(0.01, step=0.002)},
    ),
    "cart": (CART, ss.SourceVoltage(), {"t1": 1.0, "y0": (ss.Uniform(0.0, 6.0), 0.0, 0.0), "samples": 300}),
}  # fmt: skip


def resident() -> int:
    """Bytes of this process in memory."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def one_round(name: str, folder: Path) -> tuple[float, ...]:
    """Simulate, sum up, store and load one ensemble; the sum of its stick times, and of the starts."""
    system, law, options = CASES[name]
    many = ss.simulate_ensemble(
        system, law, **options, key=jax.random.key(5), keep="sticks", threads=2, chunk=128, progress=False
    )
    assert str(many.summary())
    back = ss.load(many.save(folder / f"{name}.nc", overwrite=True))
    return float(np.sum(back.totals.stick_time)), float(np.sum(back.flat_sticks.start))


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the memory of the process from /proc")
def test_memory_stays_flat(tmp_path):
    folders = [tmp_path / str(number) for number in range(3)]
    for folder in folders:
        folder.mkdir()
    expected = {name: one_round(name, folders[0]) for name in CASES}
    sizes, begun, rounds = [], time.monotonic(), 0
    with ThreadPoolExecutor(3) as pool:
        while time.monotonic() - begun < 60 * MINUTES or rounds < 12:
            # Three threads at once, each with another kind: all pairs of kinds meet.
            names = [list(CASES)[(rounds * (at + 1) + at) % len(CASES)] for at in range(3)]
            for name, found in zip(names, pool.map(one_round, names, folders), strict=True):
                assert found == expected[name], name
            rounds += 1
            sizes.append(resident())
    third = len(sizes) // 3
    middle, last = np.median(sizes[third : 2 * third]), np.median(sizes[2 * third :])
    print(
        f"{3 * rounds} ensembles; memory at the thirds in MB:",
        *(round(sizes[at] / 1e6) for at in (0, third, -third, -1)),
    )
    assert last - middle < GROWTH
