"""Forks: a process that was forked after JAX had started says so, and does not wait for threads that are not there."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from stickslip_jax._foundation import checks

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")

# In its fork: the name of each entry point, and what it says or does.
PROGRAM = """
import os, sys, warnings
import jax
import stickslip_jax as ss

warnings.simplefilter("ignore")  # of JAX, about forks and about single precision
system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(0.5))
base, options = ss.Constant(0.5), {"t1": 5.0, "samples": 4, "y0": (ss.Uniform(0.0, 1.0), 0.0)}
EARLY
def key():
    return jax.random.key(0)

def tries():
    yield "simulate", lambda: ss.simulate(system, base, t1=5.0).status
    yield "simulate_ensemble", lambda: ss.simulate_ensemble(system, base, key=key(), **options).samples
    yield "sensitivity", lambda: ss.sensitivity(ss.stick_fraction, system, base, wrt="mu", key=key(), **options)
    if sweep is not None:
        yield "Sweep.run", lambda: sweep.run(threads=1, progress=False)
        yield "extended", lambda: many.extended(samples=2)
        yield "periodic_orbit", lambda: ss.nonlinear.periodic_orbit(system, base, y0=(0.0, 1.0))
        yield "lyapunov_exponents", lambda: ss.nonlinear.lyapunov_exponents(system, base, y0=(0.0, 1.0), period=1.0)
        yield "force", lambda: ss.LuGre(0.3, 0.4, 0.1, 1e3, 1.0).force([0.0, 1.0], [0.0, 1.0])
        yield "evaluate", lambda: one.evaluate([0.0, 1.0])
        yield "print", lambda: repr(one)

def told():
    for name, call in tries():
        try:
            call()
            print(name, "ran", flush=True)
        except RuntimeError as error:
            print(name, "said", error, flush=True)
        if sweep is None:
            return

for generation in range(2):  # a fork of the fork, too
    child = os.fork()
    if child:
        assert os.waitpid(child, 0)[1] == 0
        break
    told()
if not generation:
    print("first", ss.simulate(system, base, t1=5.0).status, flush=True)
os._exit(0)
"""
STARTED = """
sweep = ss.Sweep(system, base, over={"mu": [0.5, 1.0]}, key=jax.random.key(0), keep="totals", **options)
many = ss.simulate_ensemble(system, base, key=jax.random.key(0), keep="totals", **options)
one = ss.simulate(system, base, t1=5.0)
key = jax.random.key(0)
key = lambda key=key: key
"""


WAITS = "waits for ever"
MISSING = ("SweepError", "FileNotFoundError", "ValueError")
"""What calls raise anywhere whose usual argument is a file that is not there, or no result of simulations."""


def lines_of(program: str) -> list[str]:
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_a_fork_after_jax_has_started_is_told():
    program = PROGRAM.replace("EARLY", STARTED).replace("def key():\n    return jax.random.key(0)\n", "")
    *forked, first = lines_of(program)
    assert first == "first 0"  # the first process goes on
    assert len(forked) == 2 * 10
    for line in forked:
        said = line.partition(" said ")[2]
        assert re.fullmatch(
            r'JAX cannot run in a fork [^.]*; start processes by .*"spawn".*Sweep\.run\(workers=.*\.', said
        )


@pytest.mark.slow
def test_no_public_call_waits_for_ever_in_a_fork():
    """Each says so, or returns because it computes nothing with JAX, or refuses what it refuses anywhere."""
    here = Path(__file__).parents[1]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(here), str(here.parent)])}
    command = [sys.executable, "-m", "support.forked_calls"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert len(told) > 130
    assert [name for name, said in told if said == WAITS] == []
    refused = [name for name, said in told if said.startswith("RuntimeError: JAX cannot run in a fork of a process")]
    assert {"stroboscopic_section", "continue_orbit", "FrictionLaw.force", "calibrate_sticks"} <= set(refused)
    assert not {said.partition(":")[0] for _, said in told} - {"", "RuntimeError", *MISSING}


@pytest.mark.slow
def test_jax_that_only_made_a_key_has_started():
    program = PROGRAM.replace("EARLY", "sweep = None\nkey_made = jax.random.key(0)\n")
    assert [line.partition(" JAX")[0] for line in lines_of(program)] == ["simulate said"] * 2 + ["first 0"]


@pytest.mark.slow
def test_a_fork_before_jax_has_started_is_a_process_like_others():
    lines = [line.partition(" JAX")[0] for line in lines_of(PROGRAM.replace("EARLY", "sweep = None"))]
    assert lines == ["simulate ran", "simulate said", "first 0"]  # the fork of the fork came after it had run


@pytest.mark.slow
def test_the_question_changes_nothing():
    """Whether JAX has started is asked of it without a trace."""
    program = """
import jax
from stickslip_jax._foundation import checks
before = jax.config.jax_num_cpu_devices
print(checks._has_started(), jax.config.jax_num_cpu_devices == before)
jax.config.update("jax_num_cpu_devices", 3)
print(checks._has_started(), len(jax.devices("cpu")), checks._has_started(), jax.config.jax_num_cpu_devices)
"""
    assert lines_of(program) == ["False True", "False 3 True 3"]


def test_this_process_is_no_fork():
    checks.require_threads_of_jax()
