"""Every call of `support.bad_calls` with right arguments, and some more, each in a fork of a process in which JAX runs.

python -m support.forked_calls prints, as JSON, what each of them said: "" where it returned.
"""

import json
import os
import signal
import time
import warnings
from collections.abc import Callable, Iterator

import jax
import matplotlib as mpl
import numpy as np

import stickslip_jax as ss
from stickslip_jax import nonlinear, papers, plot
from support import bad_calls

SECONDS = 30  # after which a call is taken for one that waits for ever
WAITS = "waits for ever"


def calls() -> Iterator[tuple[str, Callable[[], object]]]:
    times, belt = np.linspace(0.0, 1.0, 11), papers.harmonic_belt(0.7)
    short = {"y0": belt.y0, "transient": 2, "kept": 2, "progress": False}
    one = ss.simulate(bad_calls.SYSTEM, ss.Harmonic(1.0, 1.0), t1=5.0)
    orbit = nonlinear.periodic_orbit(belt.system, belt.law, y0=belt.y0, iterations=2)
    yield "stroboscopic_section", lambda: nonlinear.stroboscopic_section(belt.system, belt.law, **short)
    yield "event_section", lambda: nonlinear.event_section(belt.system, belt.law, "stick_start", **short)
    yield (
        "bifurcation_diagram",
        lambda: nonlinear.bifurcation_diagram(belt.system, belt.law, {"mu": [0.5, 1.0]}, **short),
    )
    yield "basins", lambda: nonlinear.basins(belt.system, belt.law, **{**short, "y0": [[0.0, 1.0], [0.1, 0.0]]})
    yield "lyapunov_exponents", lambda: nonlinear.lyapunov_exponents(belt.system, belt.law, **short)
    yield "periodic_orbit", lambda: nonlinear.periodic_orbit(belt.system, belt.law, y0=belt.y0)
    yield "continue_orbit", lambda: nonlinear.continue_orbit(orbit, "mu", until=1.1)
    yield "multipliers", lambda: orbit.multipliers
    yield "steady_stick_share", lambda: papers.steady_stick_share(0.7, periods=10)
    yield "base_velocity", lambda: ss.base_velocity(ss.Harmonic(1.0, 1.0), times)
    yield "stick_duration_bound", lambda: ss.stick_duration_bound(ss.MotorCart(), ss.SourceVoltage(), 1.0)
    yield "slips", lambda: one.slips
    yield "stick_fraction", lambda: one.stick_fraction
    yield "print", lambda: repr(one)
    yield "print in a notebook", one._repr_html_
    for name in ("evaluate", "base_velocity", "friction_force", "energies"):
        yield name, lambda name=name: getattr(one, name)(times)
    for name in ("time_history", "phase_portrait", "energies"):
        yield f"plot.{name}", lambda name=name: getattr(plot, name)(one)
    yield "plot.stick_bounds", lambda: plot.stick_bounds(ss.MotorCart(), ss.SourceVoltage(), mu=[0.2, 0.4])
    for targets in bad_calls.TARGETS.values():
        for target in targets():
            yield bad_calls._name(target), lambda target=target: target.call(**target.usual)


def said_in_a_fork(call: Callable[[], object]) -> str:
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        said = ""
        try:
            call()
        except BaseException as error:
            said = f"{type(error).__name__}: {error}"[:2000]
        os.write(writing, said.encode())
        os._exit(0)
    os.close(writing)
    end = time.monotonic() + SECONDS
    while time.monotonic() < end and not os.waitpid(child, os.WNOHANG)[0]:
        time.sleep(0.01)
    with os.fdopen(reading) as file:
        if time.monotonic() < end:
            return file.read()
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return WAITS


if __name__ == "__main__":
    mpl.use("Agg")
    warnings.simplefilter("ignore")  # of JAX, about forks
    jax.config.update("jax_enable_x64", True)
    everything = list(calls())  # some simulate first
    print(json.dumps([[name, said_in_a_fork(call)] for name, call in everything]))
