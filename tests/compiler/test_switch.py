"""``STICKSLIP_PLAIN_JAX=1``: the same numbers by ``jax.jit`` alone, but for the order of operations."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from stickslip_jax._compiler.native import VARIABLE

BEGIN = """
import jax
import stickslip_jax as ss

law = ss.PoissonSwitching(speed=1.0, rate=1.0)
base = law.sample(jax.random.key(1), 5.0)
run = {"t1": 10.0, "key": jax.random.key(0), "y0": (0.0, 1.0), "samples": 20}


def system(mu, damping=None):
    return ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu), damping=damping)


def position(system, base):
    return ss.simulate(system, base, t1=5.0, y0=(0.0, 1.0)).final_state[0]


"""
# An ensemble, and a derivative in closed form.
FEW = """
kept = ss.simulate_ensemble(system(1.0), law, keep="sticks", **run).flat_sticks
found = {
    "sticks": [*map(float, kept.start), *map(float, kept.end), *map(float, kept.position)],
    "slope": float(jax.grad(lambda mu: position(system(mu), base))(0.9)),
}
"""
# A derivative and totals in time steps, a sensitivity, and a point of a sweep.
MORE = """
swept = ss.Sweep(system(1.0), law, over={"mu": [0.5, 1.0]}, **run).run(progress=False)
found = {
    "slope in steps": float(jax.grad(lambda mu: position(system(mu, 0.1), ss.Harmonic(1.0, 1.3)))(0.9)),
    "totals in steps": float(ss.stick_fraction(ss.simulate_ensemble(system(1.0, 0.1), law, keep="totals", **run))),
    "sensitivity": ss.sensitivity(ss.stick_fraction, system(1.0), law, wrt="mu", **run).derivative,
    "swept": swept.stick_fraction.values.tolist(),
}
"""
PROCESS = """
import json
import jax
jax.config.update("jax_enable_x64", True)
{numbers}
from stickslip_jax._compiler.native import native_loops_work
print(json.dumps([native_loops_work(), found]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("more", [FEW, pytest.param(MORE, marks=pytest.mark.slow)], ids=["few", "more"])
def test_the_numbers_are_the_same_with_plain_jax(more):
    """To round-off, which grows along the motion and in quotients of small numbers."""
    program = BEGIN + more
    command, environment = [sys.executable, "-c", PROCESS.format(numbers=program)], os.environ | {VARIABLE: "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    native, plain = json.loads(done.stdout)
    assert not native
    scope: dict = {}
    exec(program, scope)
    assert plain.keys() == scope["found"].keys()
    for name, numbers in scope["found"].items():
        assert np.all(np.isfinite(numbers)), name
        assert np.any(np.asarray(numbers) != 0), name
        np.testing.assert_allclose(plain[name], numbers, rtol=1e-9, atol=1e-11, err_msg=name)
