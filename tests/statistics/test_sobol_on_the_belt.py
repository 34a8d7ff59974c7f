"""Sobol' indices of a stick-slip output, against brute force on a grid and against SALib."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from SALib.analyze import sobol as salib

import stickslip_jax as ss

LAW = ss.Constant(speed=1.0)
MU, STIFFNESS = ss.Uniform(0.3, 0.9), ss.Uniform(50.0, 150.0)


def stick_time(samples, mu=MU, stiffness=STIFFNESS):
    system = ss.MassSpring(mass=1.0, stiffness=stiffness, normal_force=20.0, friction=ss.Coulomb(mu, mu_static=1.0))
    many = ss.simulate_ensemble(system, LAW, t1=5.0, samples=samples, key=jax.random.key(0), keep="sticks")
    return many.totals.stick_time


@pytest.mark.slow
def test_indices_on_a_belt():
    design = ss.design.saltelli(1024, ["mu", "stiffness"], second_order=True, seed=1)
    output = stick_time(design)
    found = ss.sobol_indices(output, design)
    by_salib = salib.analyze({"num_vars": 2, "names": ["mu", "stiffness"]}, output, seed=1)
    np.testing.assert_allclose(found.first, by_salib["S1"], rtol=1e-10)
    np.testing.assert_allclose(found.total, by_salib["ST"], rtol=1e-10)

    # Brute force: midpoints of 200 x 200 cells, so that variances of means are sums.
    middle = (jnp.arange(200) + 0.5) / 200
    mu, stiffness = (np.asarray(one.icdf(middle)) for one in (MU, STIFFNESS))
    grid = stick_time(40_000, np.repeat(mu, 200), np.tile(stiffness, 200)).reshape(200, 200)
    first = np.array([grid.mean(axis=1).var(), grid.mean(axis=0).var()]) / grid.var()
    total = 1 - first[::-1]
    assert np.all(np.abs(found.first - first) < 4 * found.first_error)
    assert np.all(np.abs(found.total - total) < 4 * found.total_error)
