"""Contacts without friction: nothing sticks, and derivatives by the friction coefficient begin at the right side."""

import math
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

TIMES = np.array([0.0, 1.0, 2.0, 3.0, 12.0])
LAWS = {
    "Coulomb": ss.Coulomb(0.0),
    "weakening": ss.VelocityWeakening(0.0, 0.3),
    "Stribeck": ss.Stribeck(0.0, 0.0, 0.3),
}
METHOD = ss.Exact(max_steps=1024)
METHODS = [ss.Exact(), ss.Exact(step=0.1), ss.Regularized(width=1e-3), ss.Regularized(width=1e-3, step=0.01)]


class Own(ss.SwitchedSystem):
    """A mass on a spring, as a user writes it."""

    mu: float

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        return y[1], -4 * y[0] - self.mu * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return 2.0


def system_of(law=LAWS["Coulomb"]):
    return ss.MassSpring(1.0, 1.0, 1.0, law)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Coulomb", "weakening", pytest.param("Stribeck", marks=pytest.mark.slow)])
def test_a_mass_that_starts_with_the_base_does_not_stick(name):
    """Its free vibration is ``0.5 sin t``; at first no force is needed to stay on the base."""
    one = ss.simulate(system_of(LAWS[name]), ss.Harmonic(0.5, 0.25), t1=20.0, y0=(0.0, 0.5), method=METHOD)
    assert (one.status, int(one.sticks.count)) == (ss.Status.FINISHED, 0)
    right = [0.5 * math.sin(20.0), 0.5 * math.cos(20.0)]
    np.testing.assert_allclose(one.final_state, right, rtol=0, atol=1e-12 if name == "Coulomb" else 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("values", [(0, 1, 0, -1, 0), (0, 0, -1, 1, 0.5)])
def test_a_ground_record_that_begins_at_zero(values):
    values = np.array(values, float)
    base = ss.GroundAcceleration(TIMES, values)
    one = ss.simulate(system_of(), base, t1=12.0, method=METHOD)
    assert (one.status, int(one.sticks.count)) == (ss.Status.FINISHED, 0)
    y = np.zeros(2)
    for begin, end in pairwise(TIMES):
        leg = solve_ivp(
            lambda t, y: [y[1], -y[0] - np.interp(t, TIMES, values)], (begin, end), y, rtol=1e-12, atol=1e-13
        )
        y = leg.y[:, -1]
    np.testing.assert_allclose(one.final_state, y, rtol=0, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("mean", [1.0, -1.0])
def test_a_cart_without_friction_starts_either_way(mean):
    cart, voltage = ss.MotorCart(mu=0.0), ss.SourceVoltage(mean, 0.5, 7.0)
    one = ss.simulate(cart, voltage, t1=0.2, y0=(0.7, 0.0, 0.0))
    assert (one.status, int(one.sticks.count)) == (ss.Status.FINISHED, 0)
    inertia = cart.cart_mass * cart.eccentricity**2

    def rates(t, y):
        angle, speed, current = y
        torque = cart.motor_constant * current - cart.motor_damping * speed
        torque -= inertia * math.sin(angle) * math.cos(angle) * speed**2
        drop = cart.resistance * current + cart.motor_constant * speed
        rise = (mean + 0.5 * math.sin(7.0 * t) - drop) / cart.inductance
        return [speed, torque / (cart.motor_inertia + inertia * math.sin(angle) ** 2), rise]

    right = solve_ivp(rates, (0, 0.2), (0.7, 0.0, 0.0), "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(one.final_state, right, rtol=2e-6)  # of the cart's default step


@pytest.mark.slow
def test_the_derivative_by_friction_at_none_is_that_from_above():
    def position(mu):
        system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu))
        return ss.simulate(system, ss.Harmonic(0.5, 0.25), t1=20.0, y0=(0.0, 0.5), method=METHOD).final_state[0]

    small = 1e-7
    assert jax.grad(position)(0.0) == pytest.approx(float(position(small) - position(0.0)) / small, rel=1e-5)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
@pytest.mark.parametrize("x64", [True, pytest.param(False, marks=pytest.mark.slow)])
@pytest.mark.parametrize("law", [ss.Coulomb, lambda mu: ss.Stribeck(mu, mu, 0.3)])
@pytest.mark.parametrize("method", [METHODS[0], METHODS[1], METHODS[3]])  # not adaptive: see docs/limits.md
def test_derivatives_of_a_mass_that_stays_at_rest(method, law, x64):
    """The smallest friction holds it, either way. By all else it oscillates freely, and the base does not drive it."""

    def position(mu, x, v, base):
        system = ss.MassSpring(1.0, 4.0, 1.0, law(mu))
        return ss.simulate(system, ss.Constant(base), t1=5.0, y0=(x, v), method=method).final_state[0]

    free = [0.0, math.cos(10.0), math.sin(10.0) / 2, 0.0]
    close = 2e-4 if isinstance(method, ss.Regularized) or not x64 else 1e-8
    with jax.enable_x64(x64):
        derivatives = jax.grad(position, argnums=(0, 1, 2, 3))(0.0, 0.0, 0.0, 0.0)
        np.testing.assert_allclose(derivatives, free, rtol=0, atol=close)
        assert abs(float(derivatives[0])) < 1e-30
        assert float(jax.grad(position)(0.1, 0.0, 0.0, 0.0)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["structure", "own", "cart"])
def test_friction_has_no_effect_on_what_stays_at_rest(kind):
    def final(mu):
        if kind == "structure":
            contacts = [ss.Contact.of_mass(i, 2, 1.0, ss.Coulomb(number)) for i, number in enumerate([mu, 0.3])]
            system = ss.LinearStructure(np.eye(2), [[2.0, -1.0], [-1.0, 2.0]], contacts=contacts)
        system = system if kind == "structure" else Own(mu) if kind == "own" else ss.MotorCart(mu=mu)
        base = ss.SourceVoltage(0.0, 0.0, 7.0) if kind == "cart" else ss.Harmonic(0.0, 1.0)
        y0 = {"structure": [0.0] * 4, "own": [0.0] * 2, "cart": (0.7, 0.0, 0.0)}[kind]
        return jnp.stack(ss.simulate(system, base, t1=0.5, y0=y0, method=ss.Exact(step=0.002)).final_state)

    np.testing.assert_allclose(jax.jacfwd(final)(0.0), 0, rtol=0, atol=1e-30)


@pytest.mark.slow
def test_ensembles_and_intervals_do_not_stick():
    law, run = ss.PoissonSwitching(0.5, 1.0), {"t1": 20.0, "y0": (0.0, 0.5)}
    for method in (ss.Exact(), ss.Exact(step=0.1)):
        many = ss.simulate_ensemble(system_of(), law, samples=16, key=jax.random.key(0), method=method, **run)
        assert (many.finished, float(many.statistics.stick_count.mean)) == (16, 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Coulomb", pytest.param("Stribeck", marks=pytest.mark.slow)])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("base", [ss.Constant(0.0), ss.Harmonic(0.0, 1.0)])
def test_a_mass_that_stays_at_rest_does_not_stick(name, method, base):
    """At its equilibrium on a base at rest, in every method; nothing else could be decided by the last digits."""
    run = {"t1": 5.0, "method": method, "y0": (0.0, 0.0)}
    one = ss.simulate(system_of(LAWS[name]), base, **run)
    assert (one.status, int(one.sticks.count), int(one.near_grazing_count)) == (ss.Status.FINISHED, 0, 0)
    np.testing.assert_array_equal(one.final_state, [0.0, 0.0])
    many = ss.simulate_ensemble(system_of(LAWS[name]), base, samples=2, key=jax.random.key(0), **run)
    assert (many.finished, float(many.statistics.stick_count.mean), many.near_grazing_samples) == (2, 0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("method", [METHODS[0], *METHODS[2:]])
def test_of_two_contacts_at_rest_only_the_one_with_friction_sticks(method):
    contacts = [ss.Contact.of_mass(i, 2, 1.0, ss.Coulomb(mu)) for i, mu in enumerate([0.0, 0.3])]
    pair = ss.LinearStructure(np.eye(2), [[2.0, -1.0], [-1.0, 2.0]], contacts=contacts)
    one = ss.simulate(pair, ss.Harmonic(0.0, 1.0), t1=5.0, method=method)
    assert one.status == ss.Status.FINISHED
    assert [int(one.of_contact(i).sticks.count) for i in range(2)] == [0, 1]
