"""A small sweep that tests run in different places, and the comparison of its results."""

import jax
import numpy as np

import stickslip_jax as ss

SAMPLES, BATCH = 3000, 1024
POINTS = {"mu": [0.5, 1.0], "rate": [0.5, 1.0]}


def small_sweep(**changed) -> ss.Sweep:
    """Four points of a random belt, three batches each."""
    arguments = {"over": POINTS, "t1": 20.0, "samples": SAMPLES, "batch": BATCH, "key": jax.random.key(1), **changed}
    return ss.Sweep(
        ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0)), ss.PoissonSwitching(2.0, 0.5), **arguments
    )  # fmt: skip


def assert_same(found, wanted):
    """The data sets are equal to the last bit, but for the time spent."""
    assert set(found.variables) == set(wanted.variables)
    for name in set(wanted.variables) - {"run_seconds"}:
        np.testing.assert_array_equal(found[name].values, wanted[name].values, err_msg=name, strict=True)
