"""Friction force and energies along a trajectory."""

import math
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import stickslip_jax as ss

FREE = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.4))
BELT = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.3))
RECORD = ss.Recorded(3.0 * np.arange(11), np.array([0.0, 1.0, -0.5, 0.3, 2.0, -1.0, 0.2, 0.0, 0.5, -0.4, 0.0]))


def free(mu, method=ss.Exact()):  # noqa: B008 - nothing in it changes
    """From 3 m on a base at rest: turns at n pi, each time 2 mu nearer, and rests at ``3 - 8 mu`` from 4 pi on."""
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu))
    return ss.simulate(system, ss.Constant(0.0), t1=20.0, y0=(3.0, 0.0), method=method)


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", [ss.Exact(), pytest.param(ss.Exact(step=0.1), marks=pytest.mark.slow)], ids=["intervals", "steps"]
)
def test_free_vibration(method):
    """Friction takes ``mu n`` times the length of the way; in between it points against the velocity."""
    one = free(0.4, method)
    turns = np.pi * np.arange(5)
    found = one.energies(turns)
    ways = np.array([0, 5.2, 5.2 + 3.6, 5.2 + 3.6 + 2.0, 5.2 + 3.6 + 2.0 + 0.4])
    assert_allclose(found.dissipated["friction"], 0.4 * ways, rtol=0, atol=1e-13)
    assert_allclose(found.stored["elastic"], 0.5 * np.array([3, -2.2, 1.4, -0.6, -0.2]) ** 2, rtol=0, atol=1e-13)
    assert_allclose(found.stored["kinetic"], 0, atol=1e-25)
    assert_allclose(one.friction_force(turns[:4] + 0.1), [0.4, -0.4, 0.4, -0.4], rtol=0, atol=0)
    assert_allclose(one.friction_force(np.array([13.0, 20.0])), -0.2, rtol=0, atol=1e-14)  # the spring's force
    assert np.isnan(one.friction_force(20.1))
    assert np.isnan(one.energies(-0.1).stored["kinetic"])


@pytest.mark.slow
def test_belt_of_constant_speed():
    """A stick to ``mu n / k``, then full circles: the belt does ``mu n v`` per second, and all of it becomes heat.

    In a stick the mass moves with the belt and friction balances the spring: the belt loads the spring, without loss.
    """
    speed, release = 0.5, 0.3 / 4 / 0.5
    one = ss.simulate(BELT, ss.Constant(speed), t1=20.0, y0=(0.0, speed))
    times = np.array([0.0, 0.1, release])
    found = one.energies(times)
    assert_allclose(one.friction_force(times), 4 * speed * times, rtol=0, atol=1e-14)
    assert_allclose(found.supplied["base"], 0.5 * 4 * (speed * times) ** 2, rtol=0, atol=1e-15)
    assert_allclose(found.dissipated["friction"], 0, atol=1e-15)
    round_trips = release + math.pi * np.array([1.0, 3.0])
    later = one.energies(round_trips)
    assert_allclose(
        later.supplied["base"], found.supplied["base"][2] + 0.3 * speed * (round_trips - release), atol=1e-13
    )
    assert_allclose(later.dissipated["friction"], 0.3 * speed * (round_trips - release), rtol=0, atol=1e-13)


@pytest.mark.slow
def test_friction_feeds_energy_in_where_the_mass_is_slower_than_the_belt_and_moves_its_way():
    """Lima and Sampaio 2015, section 2: elsewhere in a slip friction takes energy from the mass."""
    one = ss.simulate(BELT, ss.Constant(0.5), t1=8.0, y0=(0.4, -1.0))
    times = np.linspace(0.003, 7.9, 400)
    _, velocity = one.evaluate(times)
    fed = one.friction_force(times) * velocity > 0
    np.testing.assert_array_equal(fed, (velocity > 0) & (velocity <= 0.5 + 1e-12))
    assert 50 < fed.sum() < 350


CASES = {
    "random belt": (BELT, ss.PoissonSwitching(1.0, 2.0).sample(jax.random.key(3), 30.0), ss.Exact()),
    "all at once": (
        ss.MassSpring(1.3, 2.0, 1.5, ss.Coulomb(0.4, 0.5), 0.3, ss.Harmonic(1.0, 0.7, 0.2, offset=0.1)),
        ss.WithJumps(ss.Harmonic(1.0, 1.1, 0.3), ss.SquareWave(0.5, 7.0)),
        ss.Exact(),
    ),
    "record": (ss.MassSpring(1.0, 2.0, 1.0, ss.Coulomb(0.4), force=RECORD), RECORD, ss.Exact()),
    "ground": (BELT, ss.KanaiTajimi(rms=1.5).sample(jax.random.key(0), 30.0), ss.Exact()),
    "weakening": (ss.MassSpring(1.0, 1.0, 1.0, ss.VelocityWeakening(1.0, 3.0)), ss.Constant(0.2), ss.Exact()),
    "overdamped": (
        ss.MassSpring(1.0, 4.0, 300.0, ss.Coulomb(0.3, 0.4), 64.0),
        ss.WithJumps(ss.Harmonic(3.0, 1.1, 0.3), ss.SquareWave(2.0, 7.0)),
        ss.Exact(),
    ),
    "motor": (ss.MotorCart(mu=0.5), ss.SourceVoltage(), ss.Exact(step=2e-4)),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [case if case in ("random belt", "all at once") else pytest.param(case, marks=pytest.mark.slow) for case in CASES],
)
def test_balance_closes_to_round_off(case):
    """What the integrals of the powers say, and what the states say."""
    system, base, method = CASES[case]
    t1 = 1.0 if case == "motor" else 30.0
    start = (0.3 + math.pi, 0.0, 0.0) if case == "motor" else (1.0, 0.0)  # on the half with sin(alpha) < 0
    one = ss.simulate(system, base, t1=t1, y0=start, method=method)
    assert one.status == ss.Status.FINISHED
    assert one.sticks.count >= 2
    found = one.energies(np.linspace(0, t1, 241))
    scale = max(float(np.max(np.abs(values))) for part in found[:3] for values in part.values())
    assert_allclose(found.imbalance, 0, atol=2e-13 * scale)
    lost = np.stack(list(found.dissipated.values()))
    assert np.diff(lost, axis=1).min() >= -1e-13 * scale  # heat never comes back
    sticks = np.flatnonzero(np.asarray(one.sticks.mask))
    ends = one.energies(np.stack([one.sticks.start[sticks], one.sticks.end[sticks]]))
    held = ends.dissipated["friction"]
    assert_allclose(held[0], held[1], rtol=0, atol=2e-13 * scale)  # nor does it arise in sticks


@pytest.mark.slow
def test_force_of_a_stick_is_what_it_needs():
    """``m v' + c v + k x - F`` (Lima and Sampaio 2017, eq. 3), at most ``mu_static n``; ``mu n`` in slips."""
    system, base, method = CASES["all at once"]
    one = ss.simulate(system, base.motion, t1=30.0, y0=(1.0, 0.0), method=method)
    times = np.linspace(0.01, 29.9, 500)
    x, velocity = (np.asarray(values) for values in one.evaluate(times))
    mask = np.asarray(one.sticks.mask)
    start, end = (np.asarray(values)[mask] for values in (one.sticks.start, one.sticks.end))
    sticks = ((start <= times[:, None]) & (times[:, None] < end)).any(axis=1)
    acceleration = -1.1 * np.sin(1.1 * times + 0.3)
    load = 0.1 + np.cos(0.7 * times + 0.2)
    needed = 1.3 * acceleration + 0.3 * velocity + 2.0 * x - load
    slips = 1.5 * 0.4 * np.sign(np.cos(1.1 * times + 0.3) - velocity)
    assert 20 < sticks.sum() < 480
    assert_allclose(one.friction_force(times), np.where(sticks, needed, slips), rtol=0, atol=1e-12)
    assert np.abs(needed[sticks]).max() <= 1.5 * 0.5 + 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.3, 0.3 + math.pi, -0.3], ids=["first half", "second half", "before"])
def test_motor(start):
    """``k_e c = f_r d sin(alpha)`` in sticks (Lima and Sampaio 2022, eq. 4), ``mu m g`` against the cart in slips."""
    system = ss.MotorCart(mu=0.5)
    one = ss.simulate(system, ss.SourceVoltage(), t1=1.0, y0=(start, 0.0, 0.0))
    times = np.linspace(1e-3, 0.999, 700)
    angle, speed, current = (np.asarray(values) for values in one.evaluate(times))
    force = np.asarray(one.friction_force(times))
    sticks = speed == 0
    assert 20 < sticks.sum() < 680
    assert_allclose(force[sticks] * 0.01 * np.sin(angle[sticks]), 0.0533 * current[sticks], rtol=0, atol=1e-13)
    cart = -0.01 * np.sin(angle) * speed
    assert_allclose(force[~sticks], -0.5 * 5 * 9.81 * np.sign(cart[~sticks]), rtol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.7, 0.7 + math.pi])
def test_heat_of_a_cart_that_goes_round(start):
    """``mu m g`` times its way; 1.3254 J within 2 s from rest."""
    one = ss.simulate(ss.MotorCart(), ss.SourceVoltage(), t1=2.0, y0=(start, 0.0, 0.0))
    times = np.linspace(0, 2, 4001)
    angle, speed, _ = (np.asarray(values) for values in one.evaluate(times))
    way = np.trapezoid(np.abs(0.01 * np.sin(angle) * speed), times)
    found = one.energies(np.array([2.0]))
    assert float(found.dissipated["friction"][0]) == pytest.approx(0.2 * 5 * 9.81 * way, rel=2e-5)
    assert 0.2 * 5 * 9.81 * way == pytest.approx(1.3254, abs=1e-4)
    assert abs(float(found.imbalance[0])) < 1e-6


@pytest.mark.slow
def test_regularised_force_comes_near():
    """At most ``mu n``, and where neither is about to change the mode, near the exact one."""
    exact = ss.simulate(FREE, ss.Constant(0.0), t1=10.0, y0=(3.0, 0.0))
    smooth = ss.simulate(FREE, ss.Constant(0.0), t1=10.0, y0=(3.0, 0.0), method=ss.Regularized(1e-3))
    times = np.array([1.0, 2.0, 4.0, 5.0, 7.0, 8.0])
    assert_allclose(smooth.friction_force(times), exact.friction_force(times), rtol=0, atol=1e-6)
    assert np.abs(smooth.friction_force(np.linspace(0, 10, 500))).max() <= 0.4


@pytest.mark.slow
def test_transformations():
    """Under jit, vmap and derivatives: friction takes ``4.5 - (3 - 8 mu)^2 / 2`` until the mass rests."""

    def taken(mu):
        return free(mu, ss.Exact(max_steps=2048, step=0.1)).energies(jnp.asarray(20.0)).dissipated["friction"]

    many, slopes = jax.jit(jax.vmap(jax.value_and_grad(taken)))(jnp.array([0.38, 0.4]))
    assert_allclose(many, [4.5 - (3 - 8 * mu) ** 2 / 2 for mu in (0.38, 0.4)], rtol=1e-13)
    assert_allclose(slopes, [8 * (3 - 8 * mu) for mu in (0.38, 0.4)], rtol=1e-10)


@pytest.mark.slow
def test_forward_derivatives():
    def taken(mu):
        return free(mu, ss.Exact(max_steps=2048, step=0.1)).energies(jnp.asarray(20.0)).dissipated["friction"]

    assert_allclose(jax.jvp(taken, (0.4,), (1.0,))[1], 8 * (3 - 8 * 0.4), rtol=1e-10)
    slope = jax.grad(lambda mu: free(mu).friction_force(jnp.asarray(15.0)))(0.4)
    assert slope == pytest.approx(-8, rel=1e-12)  # k x where it rests


class Own(ss.SwitchedSystem):
    mu: Annotated[float, ss.Quantity(at_least=0)]
    state_names = ("position in m", "velocity in m/s")
    shortest_time = 6.0

    def rates(self, t, y, base, friction):
        return y[1], -y[0] - self.mu * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity


@pytest.mark.slow
def test_what_is_not_known_is_refused():
    one = free(0.4)  # its system is not asked for anything else
    own = eqx.tree_at(lambda one: one.system, one, Own(0.4))
    for call in (own.friction_force, own.energies):
        with pytest.raises(ValueError, match=r"needs a MassSpring, a MotorCart or a LinearStructure, but .*Own"):
            call(1.0)
    with pytest.raises(ValueError, match=r"energies needs a simulation with method=Exact\(\), but .*Regularized"):
        eqx.tree_at(lambda one: one.method, one, ss.Regularized(1e-2)).energies(1.0)
    printed = ss.simulate(ss.MotorCart(equation="printed"), ss.SourceVoltage(), t1=0.1)
    with pytest.raises(ValueError, match='energies needs a MotorCart with equation="physical"'):
        printed.energies(0.05)
    batch = jax.vmap(free)(jnp.array([0.3, 0.4]))
    for call in (batch.friction_force, batch.energies):
        with pytest.raises(ValueError, match="This is a batch"):
            call(1.0)
