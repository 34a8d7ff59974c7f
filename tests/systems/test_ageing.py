"""Static friction that grows while a stick lasts, and friction that differs between directions, for every system."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from support import memory

import stickslip_jax as ss
from stickslip_jax import nonlinear

EXPONENTIAL, LOGARITHMIC = ss.ExponentialGrowth(0.5, time=2.0), ss.LogarithmicGrowth(0.05, time=0.01)
BELT = ss.Constant(0.1)
START = (0.5, 1.2)


def listed(sticks):
    mask = np.asarray(sticks.mask)
    return [np.asarray(column)[mask] for column in (sticks.start, sticks.end, sticks.position)]


def on_belt(growth, law=None):
    return ss.MassSpring(1.0, 1.0, 1.0, ss.Ageing(ss.Coulomb(0.3, 0.4) if law is None else law, growth))


def both_ways(growth=EXPONENTIAL):
    return ss.Directional(ss.Ageing(ss.Coulomb(0.5, 0.6), growth), ss.Coulomb(0.8))


@pytest.mark.slow
@pytest.mark.parametrize("growth", [EXPONENTIAL, LOGARITHMIC, lambda age: 0.2 * jnp.tanh(age / 3)])
def test_sticks_on_a_belt_end_where_the_spring_wins(growth):
    """The root of ``k (x + v tau) = n (mu_static + growth(tau))``; the reference for slips is a circle."""
    system = on_belt(growth)
    one = ss.simulate(system, BELT, t1=80.0)
    starts, ends, positions = listed(one.sticks)
    assert len(starts) > 4
    for start, end, position in zip(starts, ends, positions, strict=True):
        if end < 80:

            def lacking(age, position=position):
                return position + 0.1 * age - 0.4 - float(growth(jnp.asarray(age)))

            age = brentq(lacking, 1e-9, 60, xtol=1e-15, rtol=1e-14)
            assert end - start == pytest.approx(age, rel=0, abs=2e-13)
    # A slip is an arc about mu n / k: it ends where it began, mirrored.
    released = positions + 0.1 * (ends - starts)
    np.testing.assert_allclose(positions[1:], 2 * 0.3 - released[:-1], rtol=0, atol=1e-12)
    assert int(one.near_grazing_count) == 0


def reference():
    def limit(sign, age):
        return 0.6 + 0.5 * -math.expm1(-age / 2) if sign > 0 else 0.8

    return memory.sticks_of(lambda sign: 0.5 if sign > 0 else 0.8, limit, 40.0, np.array(START))


def moving(kind):
    """The system of the reference, as each kind of system that there is."""
    law = both_ways()
    if kind == "mass and spring":
        return ss.MassSpring(1.0, 4.0, 1.0, law, damping=0.1)
    if kind == "structure":
        contacts = (ss.Contact.of_mass(0, 1, 1.0, law),)
        return ss.LinearStructure([1.0], [4.0], [0.1], contacts).of_contact(0)
    return Own() if kind == "equations of one's own" else Owns().of_contact(0)


class Own(ss.SwitchedSystem):
    mu: float = 0.5

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        return y[1], -0.1 * y[1] - 4 * y[0] - self.mu * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    def static_ratio_after(self, age):
        return 1.2 - jnp.expm1(-age / 2)

    @property
    def static_ratio(self):
        return 1.2

    @property
    def shortest_time(self):
        return math.pi


class Owns(Own):
    contacts = 1

    def rates(self, t, y, base, friction):
        return y[1], -0.1 * y[1] - 4 * y[0] - self.mu * friction[0]

    def relative_velocity(self, t, y, base):
        return (y[1] - base.velocity,)

    def static_ratio_after(self, age):
        return 1.2 - jnp.expm1(-age / 2)


@pytest.fixture(scope="module")
def expected():
    return reference()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mass and spring", "structure"])
def test_either_direction_against_scipy(kind, expected):
    one = ss.simulate(moving(kind), ss.Harmonic(1.0, 0.9), t1=40.0, y0=START)
    starts, ends, _ = listed(one.sticks)
    np.testing.assert_allclose(starts, expected[0][:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(ends, expected[0][:, 1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.final_state[:2], expected[1], rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["equations of one's own", pytest.param("several of them", marks=pytest.mark.slow)])
def test_equations_of_ones_own_against_scipy(kind):
    def limit(sign, age):
        return 0.6 + 0.5 * -math.expm1(-age / 2)

    sticks, state = memory.sticks_of(lambda sign: 0.5, limit, 20.0, np.array(START))
    one = ss.simulate(moving(kind), ss.Harmonic(1.0, 0.9), t1=20.0, y0=START)
    starts, ends, _ = listed(one.sticks)
    np.testing.assert_allclose(starts, sticks[:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(ends, sticks[:, 1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.final_state[:2], state, rtol=0, atol=1e-9)


def two_blocks(growth):
    """Two blocks in a row that rub on the base, of which the sticks of one grow stronger."""
    laws = (ss.Ageing(ss.Coulomb(0.6, 0.7), growth), ss.Coulomb(0.8))
    contacts = tuple(ss.Contact.of_mass(i, 2, 1.0, law) for i, law in enumerate(laws))
    return ss.LinearStructure(np.ones(2), np.array([[2.2, -1.2], [-1.2, 2.2]]), None, contacts)


@pytest.mark.slow
def test_without_growth_nothing_changes():
    """A growth of nothing has the sticks of the law itself, with the ages as further numbers of the state."""
    none = ss.ExponentialGrowth(0.0, time=1.0)
    plain = ss.Coulomb(0.6, 0.7), ss.Coulomb(0.8)
    contacts = tuple(ss.Contact.of_mass(i, 2, 1.0, law) for i, law in enumerate(plain))
    other = ss.LinearStructure(np.ones(2), np.array([[2.2, -1.2], [-1.2, 2.2]]), None, contacts)
    one, other = (ss.simulate(system, ss.Harmonic(1.0, 0.4), t1=30.0) for system in (two_blocks(none), other))
    mask = np.asarray(one.sticks.mask)
    np.testing.assert_allclose(one.sticks.end[mask], other.sticks.end[other.sticks.mask], rtol=0, atol=1e-12)
    np.testing.assert_allclose(one.final_state[:4], other.final_state, rtol=0, atol=1e-12)
    assert [one.meaning for one in two_blocks(none).coordinates[4:]] == ["age of stick 0 in s", "age of stick 1 in s"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "time"), [("mass and spring", 17.0), pytest.param("structure", 18.5, marks=pytest.mark.slow)]
)
def test_a_motion_goes_on_from_any_state(how, time):
    """The ages of sticks are in the state: a motion that goes on in the middle of a stick is as one without a break."""
    system, drive = (on_belt(LOGARITHMIC), 0.1) if how == "mass and spring" else (two_blocks(EXPONENTIAL), 0.2)
    whole, first = (ss.simulate(system, ss.Constant(drive), t1=t1) for t1 in (40.0, time))
    assert float(first.final_state[-len(system.memory.ages)]) > 1
    rest = ss.simulate(system, ss.Constant(drive), t1=40.0 - time, y0=first.final_state)
    np.testing.assert_allclose(rest.final_state, whole.final_state, rtol=0, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["one contact", pytest.param("two contacts", marks=pytest.mark.slow)])
def test_ensembles_are_single_runs(how):
    law, key = ss.PoissonSwitching(0.5, rate=0.7), jax.random.key(3)
    system = ss.MassSpring(1.0, 4.0, 1.0, both_ways(LOGARITHMIC))
    if how == "two contacts":
        system = two_blocks(EXPONENTIAL).of_contact(0)
    y0 = (0.5, 1.2) if how == "one contact" else (0.5, 0.1, 1.2, 0.0)
    many = ss.simulate_ensemble(system, law, t1=40.0, samples=6, key=key, y0=y0, keep="totals", progress=False)

    @jax.jit
    @jax.vmap
    def single(sample):
        base = law.sample(jax.random.fold_in(key, sample), 40.0)
        return ss.simulate(system, base, t1=40.0, y0=y0, method=ss.Exact(max_steps=4000)).totals.stick_time

    np.testing.assert_allclose(many.totals.stick_time, single(np.arange(6)), rtol=0, atol=1e-9)
    assert "all samples" in str(many)


def last_state(numbers):
    """Time in sticks and last position of a mass on a belt, its law given in numbers."""
    amount, time, mu, velocity = numbers
    law = ss.Directional(ss.Coulomb(0.8), ss.Ageing(ss.Coulomb(mu, mu + 0.1), ss.LogarithmicGrowth(amount, time)))
    one = ss.simulate(
        ss.MassSpring(1.0, 1.0, 1.0, law), ss.Constant(velocity), t1=33.0, method=ss.Exact(max_steps=2000)
    )  # fmt: skip
    return jnp.stack([one.totals.stick_time, one.final_state[0]])


NUMBERS, FEW = np.array([0.05, 0.5, 0.3, 0.1]), 1e-4


def differences(function):
    low, high = (jax.jit(jax.vmap(function))(NUMBERS + sign * FEW * np.eye(4)) for sign in (-1, 1))
    return np.moveaxis(high - low, 0, -1) / (2 * FEW)


@pytest.mark.slow
def test_derivatives():
    forward = jax.jit(jax.jacfwd(last_state))(NUMBERS)
    assert np.all(np.abs(forward) > 1e-2)
    np.testing.assert_allclose(forward, differences(last_state), rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_derivatives_backward_and_of_second_order():
    forward = jax.jacfwd(last_state)
    np.testing.assert_allclose(jax.jacrev(last_state)(NUMBERS), jax.jit(forward)(NUMBERS), rtol=1e-10, atol=1e-12)
    second = jax.jit(jax.jacfwd(forward))(NUMBERS)
    np.testing.assert_allclose(second, differences(forward), rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_sensitivity_of_an_ensemble():
    """Sticks appear and vanish: the corrected derivative against differences with common random numbers."""
    law = ss.PoissonSwitching(0.5, rate=0.7)
    settings = {"t1": 60.0, "samples": 4000, "key": jax.random.key(1), "y0": (0.2, 0.3), "wrt": "amount"}
    system = on_belt(LOGARITHMIC)
    corrected = ss.sensitivity("mean_total_stick_time", system, law, **settings)
    other = ss.sensitivity("mean_total_stick_time", system, law, estimator="finite-difference", **settings)
    assert corrected.value > 5 * corrected.standard_error
    assert abs(corrected.value - other.value) < 4 * math.hypot(corrected.standard_error, other.standard_error)


@pytest.mark.slow
def test_limit_cycle_on_a_belt():
    """A slip mirrors the release at mu n / k, and a release depends on the position of the stick by its age tau.

    With ``x + v tau = mu_static + growth(tau)`` the second multiplier is ``growth' / (v - growth')``: not zero, as it
    is where static friction does not grow.
    """
    growth = ss.ExponentialGrowth(0.2, time=4.0)
    orbit = nonlinear.periodic_orbit(on_belt(growth), BELT, y0=(0.3, 0.1))
    assert bool(orbit.converged)
    # The cycle: tau with (2 mu - limit) + v tau = limit.
    tau = brentq(lambda age: 0.6 + 0.1 * age - 2 * (0.4 - 0.2 * math.expm1(-age / 4)), 1.0, 30.0, xtol=1e-15)
    slope = 0.05 * math.exp(-tau / 4)
    multipliers = sorted(np.abs(np.asarray(orbit.multipliers)))
    np.testing.assert_allclose(multipliers, [0.0, abs(slope / (0.1 - slope)), 1.0], rtol=0, atol=1e-9)
    released = 0.4 - 0.2 * math.expm1(-tau / 4)
    slip = 2 * math.pi - 2 * math.atan2(released - 0.3, 0.1)
    assert float(orbit.period) == pytest.approx(tau + slip, rel=0, abs=1e-9)


@pytest.mark.slow
def test_starts_of_sections_may_leave_out_the_ages():
    system, drive = ss.MassSpring(1.0, 1.0, 1.0, ss.Ageing(ss.Coulomb(0.3, 0.4), LOGARITHMIC)), ss.Harmonic(0.5, 0.3)
    starts = np.array([[0.1, 0.0], [0.5, 0.2]])
    short, whole = (
        nonlinear.stroboscopic_section(system, drive, y0=rows, transient=1, kept=1, progress=False)
        for rows in (starts, np.column_stack([starts, np.zeros(2)]))
    )
    np.testing.assert_array_equal(short.position, whole.position)


@pytest.mark.slow
def test_float32():
    system = on_belt(EXPONENTIAL)
    wanted = listed(ss.simulate(system, BELT, t1=40.0).sticks)
    with jax.enable_x64(False), pytest.warns(UserWarning, match="float32"):
        found = listed(ss.simulate(system, BELT, t1=40.0).sticks)
    assert found[0].dtype == np.float32
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-4)


def test_the_band_grows_with_the_age():
    """Figures show what friction can hold at the age that the stick has, in either direction."""
    system = ss.MassSpring(1.0, 4.0, 1.0, both_ways())
    times = jnp.array([0.0, 1.0])
    low, high = system.look.stick_band(times, (0 * times, 0 * times, jnp.array([0.0, 2.0])), 0 * times, 0 * times, 0.0)
    np.testing.assert_allclose(high, [0.2, 0.2], rtol=1e-14)
    np.testing.assert_allclose(low, [-0.15, -(0.6 - 0.5 * math.expm1(-1)) / 4], rtol=1e-14)
    assert system.look.slip_center is None


def test_what_does_not_fit_is_told(annotations_unchecked):
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Ageing(ss.Coulomb(0.3), LOGARITHMIC))
    with pytest.raises(ValueError, match=r"Argument method must be Exact\(...\) for friction that grows"):
        ss.simulate(system, BELT, t1=1.0, method=ss.Regularized(1e-3))
    with pytest.raises(ValueError, match=r"three numbers \(position in m, velocity in m/s, age of the stick in s\)"):
        ss.simulate(system, BELT, t1=1.0, y0=(1.0,))
    for make, message in (
        (lambda: ss.Ageing(0.3, LOGARITHMIC), "Argument law must be a friction law"),
        (lambda: ss.Directional(ss.Coulomb(0.3), 0.2), "Argument backward must be a friction law"),
        (
            lambda: ss.Directional(ss.Dahl(0.3, 1e3), ss.Coulomb(0.2)),
            "Argument forward must be a friction law without an",
        ),
        (lambda: ss.Ageing(ss.Dahl(0.3, 1e3), LOGARITHMIC), "Argument law must be a friction law without an inner"),
        (lambda: ss.Ageing(ss.Coulomb(0.3), 0.1), "Argument growth must be a LogarithmicGrowth, or a function"),
        (lambda: ss.Ageing(ss.Coulomb(0.3), lambda age: 0.1 + age), r"Argument growth\(0\) must"),
        (lambda: ss.Ageing(ss.Coulomb(0.3), lambda age: -age), r"Argument growth\(1e-09\) must be zero or positive"),
        (lambda: ss.LogarithmicGrowth(0.1, 0.0), "Argument time must be positive"),
    ):
        with pytest.raises(ValueError, match=message):
            make()


class Falling(Own):
    def static_ratio_after(self, age):
        return 1.2 - 0.1 * age


class Unseen(Own):
    @property
    def coordinates(self):
        return ss.Coordinate("position", "m"), ss.Coordinate("velocity", "m/s")


@pytest.mark.parametrize(
    ("system", "message"), [(Falling(), "do not fall with the age"), (Unseen(), "add \\*self.memory.coordinates")]
)
def test_equations_of_ones_own_that_do_not_fit(system, message):
    with pytest.raises(ValueError, match=message):
        ss.simulate(system, ss.Constant(0.0), t1=1.0, y0=(1.0, 0.0))
