"""What the switched engine refuses, and what it reports: one clear sentence each."""

import dataclasses
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

pytestmark = pytest.mark.usefixtures("annotations_unchecked")
FRICTION = ss.Coulomb(0.4)
SYSTEM = ss.MassSpring(1.0, 1.0, 1.0, FRICTION, damping=0.1)
HARMONIC = ss.Harmonic(1.0, 2.0)
ROOM = 192  # steps, what 10 s are given


class Motion:
    """A motion of the user's that does not tell its shortest period."""

    def velocity(self, t):
        return jnp.cos(t)

    def acceleration(self, t):
        return -jnp.sin(t)


def run(system=SYSTEM, base=HARMONIC, t1=10.0, **options):
    return ss.simulate(system, base, t1=t1, **options)


def spring(**changed):
    return ss.MassSpring(**({"mass": 1.0, "stiffness": 1.0, "normal_force": 1.0, "friction": FRICTION} | changed))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: run(base=ss.Recorded([0.0, 5.0], [0.0, 1.0])), r"base must last until t1 = 10 s, but it ends at 5 s"),
        (
            lambda: run(spring(force=ss.Recorded([0.0, 5.0], [0.0, 1.0]))),
            r"force must last until t1 = 10 s, but it ends at 5 s",
        ),
        (
            lambda: run(base=ss.GroundAcceleration([0.0, 5.0], [0.0, 1.0])),
            r"base must last until t1 = 10 s, but it ends at 5 s",
        ),
        (
            lambda: ss.Recorded([0.0, 2.0, 1.0], [0.0, 1.0, 2.0]),
            r"times must increase, but times\[2\] = 1.0 follows",
        ),
        (lambda: ss.Recorded([1.0, 2.0], [0.0, 1.0]), r"times must begin with 0, but its first entry is 1.0"),
        (lambda: ss.Recorded([0.0, 2.0], [0.0, np.nan]), r"values must be finite"),
        (lambda: ss.Recorded([0.0], [0.0]), r"times and values must have the same length of at least 2"),
        (
            lambda: run(method=ss.Exact(step=0.6)),
            r"step must be at most 0.3142 s, .*period of the base motion",
        ),
        (
            lambda: run(base=ss.Harmonic(1.0, 0.1), method=ss.Exact(step=2.0)),
            r"step must be at most .* natural period",
        ),
        (
            lambda: run(spring(force=ss.Harmonic(1.0, 50.0)), method=ss.Exact(step=0.1)),
            r"step must be at most .* the shortest period of the force",
        ),
        (lambda: run(base=Motion()), r"method must give the step, .*but the shortest period of the base motion is not"),
        (lambda: run(y0=(1.0, 0.0, 0.0)), r"y0 must be two numbers \(position in m, velocity in m/s\), but"),
        (lambda: run(y0=(1.0, np.inf)), r"y0\[1\] must be finite, but inf was given"),
        (lambda: run(y0=(ss.Uniform(0.0, 1.0), 0.0)), r"y0\[0\] must be one number here, .*simulate_ensemble"),
        (lambda: run(base=ss.RandomPhase(HARMONIC)), r"base must be a realisation, but the random law RandomPhase was"),
        (lambda: run(base=ss.KanaiTajimi(1.0)), r"base must be a realisation, but the random law KanaiTajimi was"),
        (lambda: run(base=ss.SourceVoltage()), r"base of a MassSpring must be a base motion, but a SourceVoltage was"),
        (lambda: run(base="3.0"), r"base must be a base motion such as Harmonic"),
        (lambda: run(method="exact"), r"method must be Exact\(...\) or Regularized\(width\), but 'exact' was given"),
        (lambda: run(t1=1e12), r"t1 must be shorter: 1e\+12 s hold more than"),
        (
            lambda: run(spring(force=ss.Harmonic(1.0, 1.0))),
            r"force must not have the natural angular frequency of 1 rad",
        ),
        (lambda: spring(damping=-1.0), r"damping must be zero or positive \(in N s/m\), but -1.0 was given"),
        (
            lambda: spring(force=ss.Constant(1.0)),
            r"force must be a number \(in N\), a Signal such as Harmonic, a Recorded or",
        ),
        (lambda: spring(friction=0.3), r"friction must be a friction law such as Coulomb"),
        (lambda: ss.Coulomb(0.4, 0.3), r"mu_static must be at least mu = 0.4, but 0.3 was given"),
        (lambda: ss.VelocityWeakening(0.4, -1.0), r"weakening must be zero or positive \(in s/m\), but -1.0 was given"),
        (lambda: ss.Stribeck(0.3, 0.5, 0.0), r"stribeck_speed must be positive \(in m/s\), but 0.0 was given"),
        (lambda: ss.Stribeck(0.3, 0.5, 0.1, exponent=0.5), r"exponent must be at least 1, but 0.5 was given"),
        (lambda: ss.FrictionCurve(0.3), r"curve must be a function of the relative speed, but 0.3 was given"),
        (lambda: ss.FrictionCurve(lambda s: 0.5 + s, 0.1), r"mu_static must be at least curve\(0\) = 0.5"),
        (lambda: ss.Harmonic(1.0, 0.0), r"angular_frequency must be positive \(in rad/s\), but 0.0 was given"),
        (
            lambda: ss.SumOfHarmonics([1.0, 2.0], [1.0]),
            r"amplitudes and angular_frequencies must have the",
        ),
        (lambda: ss.SumOfHarmonics([1.0], [-1.0]), r"angular_frequencies must be positive"),
        (lambda: ss.WithJumps(HARMONIC, HARMONIC), r"jumps must be a law such as PoissonSwitching"),
        (lambda: ss.WithJumps(ss.Constant(1.0), ss.Constant(1.0)), r"motion must be a continuous base velocity"),
        (lambda: ss.Exact(step=-1.0), r"step must be positive \(in s\), but -1.0 was given"),
        (lambda: ss.Exact(max_steps=0), r"max_steps must be a whole number of at least 1, but 0 was given"),
        (lambda: ss.Exact(solver="Tsit5"), r"solver must be an explicit Runge-Kutta solver"),
        (
            lambda: jax.jit(lambda t1: run(t1=t1, method=ss.Exact(step=0.1)).stick_time)(10.0),
            r"method must give max_steps, Exact\(max_steps=...\), when t1",
        ),
    ],
)
def test_refused(call, message):
    with pytest.raises(ValueError, match=rf"\AArguments? {message}") as caught:
        call()
    assert str(caught.value).endswith(".")


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [ss.Exact(max_steps=1), ss.Exact(max_steps=ROOM), ss.Regularized(1e-3, step=0.02, max_steps=ROOM)],
)
def test_out_of_steps_is_reported_with_a_number_that_is_enough(method):
    """The room of 10 s with `Exact`, for which another test compiles the same function."""
    one = run(t1=100.0, method=method)
    assert int(one.status) == ss.Status.OUT_OF_STEPS
    (enough,) = re.findall(rf"NOT FINISHED: .* method=ss.{type(method).__name__}\(..., max_steps=(\d+)\)", repr(one))
    assert run(t1=100.0, method=dataclasses.replace(method, max_steps=int(enough))).status == ss.Status.FINISHED


@pytest.mark.slow
def test_no_number_of_steps_is_proposed_that_cannot_be():
    one = run(t1=1e9, method=ss.Exact(max_steps=ROOM))
    assert "NOT FINISHED" in repr(one)
    assert "max_steps=" not in repr(one)


@pytest.mark.slow
def test_ensembles_out_of_steps_are_reported():
    many = ss.simulate_ensemble(SYSTEM, HARMONIC, t1=10.0, samples=5, method=ss.Exact(max_steps=10))
    assert many.status_counts[ss.Status.OUT_OF_STEPS] == 5
    assert many.finished == 0


@pytest.mark.slow
def test_a_base_that_runs_out_is_reported():
    base = ss.PoissonSwitching(1.0, 1.0).sample(jax.random.key(0), 10.0, capacity=3)
    one = run(base=base, t1=100.0)
    assert int(one.status) == ss.Status.BASE_TOO_SHORT
    assert float(one.time_reached) == pytest.approx(float(base.durations.sum()))


@pytest.mark.slow
def test_a_state_that_overflows_is_reported():
    assert int(run(y0=(1e200, 1e200), base=ss.Harmonic(1.0, 2.0)).status) in (ss.Status.FINISHED, ss.Status.NOT_FINITE)
    one = jax.jit(lambda p: run(y0=(0.0, p), method=ss.Exact(step=0.1)))(jnp.nan)
    assert int(one.status) == ss.Status.NOT_FINITE
