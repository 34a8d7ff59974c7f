"""What a user's own process does: no option of XLA or JAX set by anybody, and derivatives of vmapped simulations.

Every program here needs the package and JAX only, so that it can run on any versions of them.
"""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def python(code: str) -> str:
    """What `code` prints in a process of its own."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


# Version 0.10.2 of JAX aborts the process over the value and gradient if XLA fuses loops over several outputs.
VALUE_AND_GRADIENT = """
import jax
import jax.numpy as jnp
import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)
law = ss.PoissonSwitching(speed=1.0, rate=1.0)
keys = jax.random.split(jax.random.key(0), 8)


def sums(mu):
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu))

    def one(key):
        sticks = ss.simulate(system, law.sample(key, t1=50.0), t1=50.0, y0=(0.0, 1.0)).sticks
        return jnp.where(sticks.mask, sticks.duration, 0.0).sum(), sticks.count

    time, count = jax.vmap(one)(keys)
    return time.sum() / count.sum(), count


mu, step = 0.9, 1e-6
value, slope = jax.jit(jax.value_and_grad(lambda mu: sums(mu)[0]))(mu)
(above, counts_above), (below, counts_below) = (jax.jit(sums)(mu + h) for h in (step, -step))
at_mu, counts = jax.jit(sums)(mu)
assert (counts == counts_above).all() and (counts == counts_below).all() and counts.sum() > 80, counts
assert abs(value - at_mu) <= 1e-12 * at_mu, (value, at_mu)
difference = (above - below) / (2 * step)
assert abs(slope - difference) <= 1e-6 * abs(difference), (slope, difference)
"""


def test_value_and_gradient_of_the_mean_stick_duration_equal_the_central_difference():
    """Of vmapped samples, in one compiled call: along the same paths, where no stick appears or vanishes."""
    python(VALUE_AND_GRADIENT)


SIMULATES = """
import os
import jax
before, settings = dict(os.environ), dict(jax.config.values)
import stickslip_jax as ss

system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
law = ss.PoissonSwitching(speed=1.0, rate=1.0)
options = {"t1": 10.0, "samples": 20, "key": jax.random.key(0), "y0": (0.0, 1.0)}
ss.simulate(system, ss.Harmonic(amplitude=1.0, angular_frequency=1.0), t1=5.0, y0=(0.0, 1.0))
for keep in ("totals", "sticks"):
    ss.simulate_ensemble(system, law, keep=keep, **options)
ss.sensitivity(ss.stick_fraction, system, law, wrt="mu", **options)
print(dict(os.environ) == before, dict(jax.config.values) == settings, "XLA_FLAGS" in os.environ)
"""


def test_simulating_sets_no_option_of_the_process():
    """Nothing of the environment, nothing of JAX's configuration, whatever is simulated."""
    assert python(SIMULATES).split() == ["True", "True", "False"]


OLD_NAME = """
import os, warnings
import jax, stickslip_jax
before, settings = dict(os.environ), dict(jax.config.values)
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    for _ in range(2):
        assert stickslip_jax.enable_fast_cpu() is None
assert [(warning.category, warning.filename) for warning in told] == [(DeprecationWarning, "<string>")], told
assert (dict(os.environ), dict(jax.config.values)) == (before, settings)
jax.config.update("jax_num_cpu_devices", 2)  # raises RuntimeError if JAX has started
"""


def test_the_old_name_for_process_wide_options_does_nothing_and_says_so_once():
    python(OLD_NAME)


FOLDERS = ("stickslip_jax", "docs", "notebooks", "benchmarks")
ADVICE = ("XLA_FLAGS", "LIBTPU_INIT_ARGS", "os.environ[", "os.environ.update", "os.environ.setdefault", "os.putenv")
WRITTEN = sorted(path for name in FOLDERS for end in ("py", "md") for path in (ROOT / name).rglob(f"*.{end}"))


@pytest.mark.parametrize("path", [ROOT / "README.md", *WRITTEN], ids=lambda path: str(path.relative_to(ROOT)))
def test_nothing_sets_process_wide_options(path):
    """Nor tells anybody to."""
    text = path.read_text(encoding="utf-8")
    assert [name for name in ADVICE if name in text] == []
    if ROOT / "stickslip_jax" not in path.parents:  # which defines the old name
        assert "enable_fast_cpu" not in text
