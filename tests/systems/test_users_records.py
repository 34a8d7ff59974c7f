"""Users' systems under recorded ground accelerations and loads: those of the built-in systems, segment by segment."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

RNG = np.random.default_rng(5)
T1 = 12.0
TIMES = np.arange(0.0, 12.2, 0.137)  # neither does the time step divide their interval, nor the other way round
NOISE = np.cumsum(RNG.normal(size=len(TIMES)))
QUAKE = 0.5 * (NOISE - NOISE[-1] * TIMES / TIMES[-1])
PULL = 1.5 * np.sin(1.3 * TIMES) + 0.3 * np.sin(5.0 * TIMES)
GROUND, LOAD = ss.GroundAcceleration(TIMES, QUAKE), ss.Recorded(TIMES, PULL)
JUMPS = ss.ForceSteps(np.arange(0.0, 12.0, 1.7), RNG.normal(size=8))
BASE = ss.SquareWave(0.5, 6.0)
NUMBERS = (1.3, 4.0, 1.0, 0.8)  # mass, stiffness, normal force, mu
START = (0.1, 0.0)
SEEN = np.linspace(0.0, T1, 101)


class Copy(ss.SwitchedSystem):
    """A `MassSpring`, as a user writes it."""

    mass: float
    stiffness: float
    normal_force: Any
    mu: float
    force: Any = None

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        load = 0.0 if self.force is None else self.force.value(t)
        pull = load - self.stiffness * y[0] - friction * self.mu * self.normal_force
        return y[1], pull / self.mass - base.ground

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return 2 * math.pi * (self.mass / self.stiffness) ** 0.5

    @property
    def speed_scale(self):
        return self.mu * self.normal_force / (self.mass * self.stiffness) ** 0.5


class CopyOfSeveral(Copy):
    """The same, its contact one of a list, its normal force a function of time."""

    contacts, speed_scale = 1, None

    def rates(self, t, y, base, friction):
        pull = self.force.value(t) - self.stiffness * y[0] - friction[0] * self.mu
        return y[1], pull / self.mass - base.ground

    def relative_velocity(self, t, y, base):
        return [y[1] - base.velocity]

    def normal_forces(self, t, y, base):
        return [self.normal_force.value(t)]


def built_in(force=None, normal_force=NUMBERS[2], mu=NUMBERS[3]) -> ss.MassSpring:
    return ss.MassSpring(*NUMBERS[:2], normal_force, ss.Coulomb(mu), force=force)


def run(system, base=BASE, **options) -> ss.Simulation:
    return ss.simulate(system, base, t1=T1, y0=START, **options)


def assert_same_motion(one: ss.Simulation, other: ss.Simulation, least: int = 2):
    assert int(one.status) == int(other.status) == ss.Status.FINISHED
    kept, of_other = (np.asarray(each.sticks.mask) for each in (one, other))
    assert np.sum(kept) == np.sum(of_other) >= least
    for name in ("start", "end", "position", "slip_displacement"):
        found, right = (np.asarray(getattr(each.sticks, name)) for each in (one, other))
        np.testing.assert_allclose(found[kept], right[of_other], rtol=0, atol=1e-11)
    for found, right in zip(one.evaluate(SEEN), other.evaluate(SEEN), strict=True):
        np.testing.assert_allclose(found, right, rtol=0, atol=1e-11)


SLOW = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    ("base", "force"), [(GROUND, LOAD), pytest.param(GROUND, None, marks=SLOW), pytest.param(BASE, LOAD, marks=SLOW)]
)
def test_as_the_built_in_system(base, force):
    """Whose slips and sticks are closed forms on every segment."""
    assert_same_motion(run(Copy(*NUMBERS, force), base), run(built_in(force), base))


@SLOW
def test_steps_are_not_those_of_the_record():
    """A long step and a short one give the same; interpolation in the stages would cost six digits."""
    right = run(built_in(LOAD), GROUND)
    for step in (0.11, 0.021):
        assert_same_motion(run(Copy(*NUMBERS, LOAD), GROUND, method=ss.Exact(step=step)), right)


@SLOW
def test_one_of_several_contacts():
    """Its normal force a record too."""
    normal = ss.Recorded([0.0, 5.0, 6.0, 13.0], [1.0, 1.2, -0.1, 1.4])
    own, right = run(CopyOfSeveral(*NUMBERS[:2], normal, 0.8, LOAD), GROUND), run(built_in(LOAD, normal), GROUND)
    assert_same_motion(own.of_contact(0), right)


@SLOW
def test_a_force_that_jumps():
    """By a harmonic sum it would be another motion: here against the simulations from jump to jump."""
    one, y = run(Copy(*NUMBERS, JUMPS), ss.Constant(0.2)), START
    for begin, end, force in zip(JUMPS.times, [*JUMPS.times[1:], T1], JUMPS.values, strict=True):
        part = ss.MassSpring(*NUMBERS[:3], ss.Coulomb(0.8), force=ss.SumOfHarmonics([0.0], [1.0], offset=float(force)))
        y = tuple(map(float, ss.simulate(part, ss.Constant(0.2), t1=float(end - begin), y0=y).final_state))
        np.testing.assert_allclose([float(x) for x in one.evaluate(float(end))], y, rtol=0, atol=1e-11)


def told(system_of, mu, values):
    """Some numbers of a motion, by the friction coefficient and by the values of a record."""
    one = run(system_of(mu, ss.Recorded(TIMES, values)), method=ss.Exact(max_steps=1024))
    return jnp.stack([one.stick_time, one.final_state[0], one.sticks.start[0]])


def own(mu, values):
    return told(lambda mu, force: Copy(*NUMBERS[:3], mu, force), mu, values)


def right(mu, values):
    return told(lambda mu, force: built_in(force, mu=mu), mu, values)


@SLOW
def test_derivatives():
    found, expected = (jax.jacrev(function)(0.8, PULL) for function in (own, right))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
    assert np.all(np.abs(expected) > 1e-3)


@SLOW
def test_derivatives_by_a_record():
    """Along a change of all its values, forward and backward, under jit."""
    along = jnp.sin(TIMES)
    found, expected = (
        jax.jit(lambda values, f=f: jax.jvp(lambda values: f(0.8, values), (values,), (along,))[1])(PULL)
        for f in (own, right)
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
    back = jax.jit(jax.grad(lambda values: own(0.8, values)[0]))(PULL)
    assert float(back @ along) == pytest.approx(float(expected[0]), abs=1e-8)


@SLOW
def test_an_ensemble():
    options = {"t1": T1, "samples": 40, "key": jax.random.key(3), "keep": "sticks"}
    law = ss.PoissonSwitching(0.5, 0.3)
    own, right = (ss.simulate_ensemble(system, law, **options) for system in (Copy(*NUMBERS, LOAD), built_in(LOAD)))
    assert float(ss.mean_stick_count(own).value) > 1.5
    np.testing.assert_array_equal(own.sticks.mask.sum(-1), right.sticks.mask.sum(-1))
    for name in ("start", "end"):
        found, expected = (
            np.asarray(getattr(many.sticks, name))[np.asarray(many.sticks.mask)] for many in (own, right)
        )
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@SLOW
def test_random_earthquakes():
    law = ss.KanaiTajimi(rms=2.0)
    options = {"t1": T1, "samples": 20, "key": jax.random.key(4)}
    own, right = (ss.simulate_ensemble(system, law, **options) for system in (Copy(*NUMBERS), built_in()))
    assert float(ss.stick_fraction(own).value) == pytest.approx(float(ss.stick_fraction(right).value), abs=1e-11)


@SLOW
@pytest.mark.parametrize("step", [0.01, None])
def test_regularised(step):
    method = ss.Regularized(1e-3, step=step, threshold=1e-2, minimum_duration=0.05)
    one, other = (run(system, GROUND, method=method) for system in (Copy(*NUMBERS, LOAD), built_in(LOAD)))
    assert int(one.sticks.count) == int(other.sticks.count) >= 2
    for found, right in zip(one.evaluate(SEEN), other.evaluate(SEEN), strict=True):
        np.testing.assert_allclose(found, right, rtol=0, atol=1e-9 if step else 1e-4)


class Belt(Copy):
    """A belt whose speed is a record, or steps."""

    def relative_velocity(self, t, y, base):
        return y[1] - self.force.value(t)

    def rates(self, t, y, base, friction):
        return y[1], (-self.stiffness * y[0] - friction * self.mu * self.normal_force) / self.mass


@SLOW
def test_a_belt():
    """In a record's own system it is the base motion."""
    speed = ss.Recorded(TIMES, 0.4 * PULL)
    assert_same_motion(run(Belt(*NUMBERS, speed), ss.Constant(0.0)), run(built_in(), speed))


@pytest.mark.slow
@pytest.mark.parametrize("by", [pytest.param("record", marks=SLOW), pytest.param("system", marks=SLOW), "duration"])
def test_the_number_of_steps_follows_from_the_length_of_a_record(by):
    """Under jit too, where its times, the spring or the duration are not known."""

    def given(record, system, t1):
        return ss.simulate(system, record, t1=t1, y0=START).stick_time

    system = Copy(*NUMBERS, LOAD)
    right = float(given(GROUND, system, T1))
    if by == "record":
        found = jax.jit(lambda times, values: given(ss.GroundAcceleration(times, values), system, T1))(TIMES, QUAKE)
    elif by == "system":
        found = jax.jit(lambda own: given(GROUND, own, T1))(system)
        slope = jax.jit(jax.grad(lambda mu: given(GROUND, Copy(*NUMBERS[:3], mu, LOAD), T1)))(0.8)
        assert float(slope) == pytest.approx(float(jax.grad(lambda mu: given(GROUND, built_in(LOAD, mu=mu), T1))(0.8)))
    else:
        found = jax.jit(lambda record: given(record, system, record.times[-1] - (TIMES[-1] - T1)))(GROUND)
    assert float(found) == pytest.approx(right, abs=1e-11)


class Deaf(Copy):
    def rates(self, t, y, base, friction):
        return y[1], -y[0] - friction


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: run(Deaf(*NUMBERS), GROUND),
            "base of a Deaf must be a base velocity, .* rates does not use base.ground",
        ),
        (lambda: run(Belt(*NUMBERS, JUMPS)), "relative_velocity of a Belt must not use a ForceSteps"),
        (
            lambda: ss.simulate(Copy(*NUMBERS, LOAD), BASE, t1=50.0),
            r"force must last until t1 = 50 s, but it ends at 12\.\d+ s",
        ),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=f"^Argument {message}") as told:
        make()
    assert "\n" not in str(told.value)
