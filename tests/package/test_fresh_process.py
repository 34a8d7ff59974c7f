"""What a user's own process does: no option of XLA or JAX set by anybody, and derivatives of vmapped simulations.

Every program here needs the package and JAX only, so that it can run on any versions of them.
"""

import json
import subprocess
import sys
from pathlib import Path

import diffrax
import pytest

import stickslip_jax as ss
from stickslip_jax._ensemble.encoding import Encoder

ROOT = Path(__file__).parents[2]


def python(code: str, text: str = "") -> str:
    """What `code` prints in a process of its own that is given `text`."""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, input=text, capture_output=True, text=True, timeout=300, check=False)
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


@pytest.mark.slow
def test_value_and_gradient_of_the_mean_stick_duration_equal_the_central_difference():
    """Of vmapped samples, in one compiled call: along the same paths, where no stick appears or vanishes."""
    python(VALUE_AND_GRADIENT)


# Each would take as long to import as JAX, or longer.
HEAVY = (
    *("dask", "distributed", "zarr", "xarray", "pandas", "scipy.stats", "matplotlib", "pydantic", "numba"),
    *("diffrax", "optimistix", "lineax"),
)
LOADED = f"""
import sys

def loaded():
    return [name for name in {HEAVY} if name in sys.modules]
"""


@pytest.mark.slow
def test_importing_the_package_imports_nothing_heavy():
    assert python(f"{LOADED}\nimport stickslip_jax\nprint(loaded())").strip() == "[]"


CLOSED_FORMS = """
import os
import jax
before, settings = dict(os.environ), dict(jax.config.values)
import stickslip_jax as ss

system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
law = ss.PoissonSwitching(speed=1.0, rate=1.0)
options = {"t1": 10.0, "samples": 20, "key": jax.random.key(0), "y0": (0.0, 1.0)}
ss.simulate(system, law.sample(jax.random.key(0), t1=10.0), t1=10.0, y0=(0.0, 1.0))
ss.simulate(system, ss.Harmonic(amplitude=1.0, angular_frequency=1.0), t1=5.0, y0=(0.0, 1.0))
ss.simulate_ensemble(system, law, keep="totals", **options)
print(loaded())
{more}
print([name for name in loaded() if name != "numba"])
print(dict(os.environ) == before, dict(jax.config.values) == settings)
"""
STATISTICS = """
str(ss.simulate_ensemble(system, law, **options))
ss.sensitivity(ss.stick_fraction, system, law, wrt="mu", **options)
"""


@pytest.mark.slow
@pytest.mark.parametrize("more", ["", STATISTICS], ids=["simulations", "statistics"])
def test_closed_forms_need_no_solver_and_set_no_option_of_the_process(more):
    """Nor anything else that is heavy, but for Numba, which counts the sticks of full statistics.

    Options: nothing of the environment, nothing of JAX's configuration.
    """
    assert python(LOADED + CLOSED_FORMS.replace("{more}", more)).splitlines() == ["[]", "[]", "True True"]


# What a module makes when it is imported inside a compiled function must not belong to the function's trace.
FIRST_SOLVER = """
import jax
import jax.numpy as jnp
import stickslip_jax as ss

jax.config.update("jax_enable_x64", True)
print(loaded())


def stick_time(force, method):
    friction = ss.Stribeck(mu=0.6, mu_static=0.9, stribeck_speed=0.5)
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=force, friction=friction)
    base = ss.Harmonic(amplitude=1.0, angular_frequency=1.0)
    sticks = ss.simulate(system, base, t1=5.0, y0=(0.0, 1.0), method=method).sticks
    return jnp.where(sticks.mask, sticks.duration, 0.0).sum()


exact, regularized = ss.Exact(step=0.02, max_steps=2000), ss.Regularized(0.01)
for _ in range(rounds):  # a second compilation would meet what the first one left behind
    print(*jax.jit(lambda force: jax.jvp(lambda force: stick_time(force, exact), (force,), (1.0,)))(1.0))
    print(jax.jit(lambda force: stick_time(force, regularized))(1.0))
print(loaded())
"""
SOLVERS = ["diffrax", "optimistix", "lineax"]


@pytest.mark.slow
def test_a_solver_may_be_loaded_inside_a_compiled_function():
    """Values and derivatives are those of a process that has imported diffrax before anything else."""
    late, early = (
        python(f"{first}\nrounds = {rounds}\n{LOADED}{FIRST_SOLVER}").splitlines()
        for first, rounds in (("", 2), ("import diffrax", 1))
    )
    assert (late[0], early[0]) == ("[]", str(SOLVERS))
    assert late[1:] == [*early[1:-1], *early[1:]]
    assert late[-1] == str(SOLVERS)
    assert "nan" not in " ".join(late)
    assert all(float(number) != 0 for line in late[1:-1] for number in line.split())


READ_AGAIN = """
import json
import numpy as np
import sys
from stickslip_jax._ensemble.encoding import Decoder

print(loaded())
decoder = Decoder(np.zeros(0), np.zeros(0, int))
print(*(decoder.decoded(json.loads(line)) for line in sys.stdin), sep="\\n")
"""


@pytest.mark.slow
def test_stored_classes_are_found_though_nobody_has_asked_for_them():
    """Those of the package that are loaded when asked for, and solvers of diffrax."""
    stored = [
        ss.MotorCart(mu=0.3),
        ss.KanaiTajimi(rms=1.5),
        ss.Uniform(0.0, 1.0),
        ss.Exact(solver=diffrax.Tsit5()),
    ]
    encoder = Encoder()
    lines = "\n".join(json.dumps(encoder.encoded(value)) for value in stored)
    assert python(LOADED + READ_AGAIN, lines).splitlines() == ["[]", *map(repr, stored)]


FOLDERS = ("stickslip_jax", "docs", "notebooks", "benchmarks")
ADVICE = ("XLA_FLAGS", "LIBTPU_INIT_ARGS", "os.environ[", "os.environ.update", "os.environ.setdefault", "os.putenv")
WRITTEN = sorted(path for name in FOLDERS for end in ("py", "md") for path in (ROOT / name).rglob(f"*.{end}"))


@pytest.mark.parametrize("path", [ROOT / "README.md", *WRITTEN], ids=lambda path: str(path.relative_to(ROOT)))
def test_nothing_sets_process_wide_options(path):
    """Nor tells anybody to."""
    text = path.read_text(encoding="utf-8")
    assert [name for name in ADVICE if name in text] == []
