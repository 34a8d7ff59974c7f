"""A cart whose friction differs between directions, grows while it sticks or falls with the speed: against scipy."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support import cart_memory
from support.cart_memory import AMPLITUDE, FREQUENCY, MEAN

import stickslip_jax as ss

VOLTAGE = ss.SourceVoltage(MEAN, AMPLITUDE, FREQUENCY)
GROWTH = ss.ExponentialGrowth(0.2, time=0.1)
START = (0.4, 0.0, 0.0)


def grown(age):
    return -0.2 * math.expm1(-age / 0.1)


def ways(forward, backward):
    """A function of the direction, and of what else these two take."""
    return lambda direction, number: (forward if direction > 0 else backward)(number)


def stribeck(speed):
    return 0.2 + 0.2 * math.exp(-speed / 0.02) + 0.1 * speed


# The law, its kinetic coefficient by direction and speed, and the limit of sticks by direction and age.
LAWS = {
    "static above kinetic": (ss.Coulomb(0.3, 0.5), lambda *_: 0.3, lambda *_: 0.5),
    "directions": (
        ss.Directional(ss.Coulomb(0.2, 0.25), ss.Coulomb(0.5)),
        ways(lambda _: 0.2, lambda _: 0.5),
        ways(lambda _: 0.25, lambda _: 0.5),
    ),
    "one direction without friction": (
        ss.Directional(ss.Coulomb(0.0), ss.Coulomb(0.5)),
        ways(lambda _: 0.0, lambda _: 0.5),
        ways(lambda _: 0.0, lambda _: 0.5),
    ),
    "ages": (ss.Ageing(ss.Coulomb(0.3), GROWTH), lambda *_: 0.3, lambda _, age: 0.3 + grown(age)),
    "both": (
        ss.Directional(ss.Ageing(ss.Coulomb(0.2, 0.25), GROWTH), ss.Coulomb(0.5)),
        ways(lambda _: 0.2, lambda _: 0.5),
        ways(lambda age: 0.25 + grown(age), lambda _: 0.5),
    ),
    "speeds": (
        ss.Directional(ss.Stribeck(0.2, 0.4, 0.02, viscous=0.1), ss.Coulomb(0.3)),
        ways(stribeck, lambda _: 0.3),
        ways(lambda _: 0.4, lambda _: 0.3),
    ),
}
QUICK = ("both",)
BOTH = LAWS["both"][0]


def cart(law):
    return ss.MotorCart(friction=law)


def listed(sticks):
    mask = np.asarray(sticks.mask)
    return np.stack([np.asarray(column)[mask] for column in (sticks.start, sticks.end, sticks.position)], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in LAWS]
)
def test_sticks_against_scipy(name):
    """Starts, ends and angles; the motor turns both ways, past dead centre too."""
    law, kinetic, limit = LAWS[name]
    for y0 in (START, (2.0, 5.0, 0.0)):
        one = ss.simulate(cart(law), VOLTAGE, t1=2.0, y0=y0)
        sticks, state = cart_memory.sticks_of(kinetic, limit, 2.0, np.array(y0))
        assert len(sticks) >= 4
        np.testing.assert_allclose(listed(one.sticks), sticks, rtol=0, atol=5e-9)
        # The current has a fast transient, which the steps damp (docs/limits.md).
        np.testing.assert_allclose(one.final_state[:3], state, rtol=0, atol=2e-6)
    assert int(one.near_grazing_count) == 0


def last_of(numbers):
    """Two events and the last angle, by the kinetic coefficient forward and the growth."""
    mu, amount = numbers
    aged = ss.Ageing(ss.Coulomb(mu, 1.2 * mu), ss.ExponentialGrowth(amount, 0.1))
    one = ss.simulate(cart(ss.Directional(aged, ss.Coulomb(0.5))), VOLTAGE, t1=1.0, y0=START)
    return jnp.stack([one.sticks.end[1], one.sticks.start[2], one.final_state[0]])


def last_of_reference(numbers):
    mu, amount = numbers
    limit = ways(lambda age: 1.2 * mu - amount * math.expm1(-age / 0.1), lambda _: 0.5)
    sticks, state = cart_memory.sticks_of(ways(lambda _: mu, lambda _: 0.5), limit, 1.0, np.array(START))
    return np.array([sticks[1, 1], sticks[2, 0], state[0]])


NUMBERS, FEW = np.array([0.2, 0.2]), 1e-6


def differences(direction):
    low, high = (last_of_reference(NUMBERS + sign * FEW * direction) for sign in (-1, 1))
    return (high - low) / (2 * FEW)


@pytest.mark.slow
def test_derivative_along_a_direction():
    direction = np.array([1.0, -0.5])
    _, slope = jax.jvp(last_of, (NUMBERS,), (direction,))
    np.testing.assert_allclose(slope, differences(direction), rtol=0, atol=2e-7)


@pytest.mark.slow
def test_derivatives_backward():
    expected = np.stack([differences(direction) for direction in np.eye(2)], axis=1)
    np.testing.assert_allclose(jax.jacrev(last_of)(NUMBERS), expected, rtol=0, atol=2e-7)


@pytest.mark.slow
def test_batches_are_single_runs():
    rows = np.array([[0.2, 0.2], [0.25, 0.1]])
    batch = jax.jit(jax.vmap(last_of))(rows)
    np.testing.assert_allclose(batch, [last_of(row) for row in rows], rtol=0, atol=1e-11)


@pytest.mark.slow
def test_ensembles_and_their_sensitivity():
    law, settings = ss.RandomPhase(VOLTAGE), {"t1": 0.3, "key": jax.random.key(0), "y0": START}
    many = ss.simulate_ensemble(cart(BOTH), law, samples=4, keep="totals", progress=False, **settings)
    _, voltage, y0 = many.realization(3)
    one = ss.simulate(cart(BOTH), voltage, t1=0.3, y0=y0)
    assert float(many.totals.stick_time[3]) == pytest.approx(float(one.stick_time), rel=0, abs=1e-10)
    by_mu, default = (
        ss.sensitivity("mean_total_stick_time", system, law, samples=16, wrt="mu", **settings)
        for system in (cart(ss.Coulomb(0.3)), ss.MotorCart(mu=0.3))
    )
    assert by_mu.value == pytest.approx(default.value, rel=1e-9)


@pytest.mark.slow
def test_mu_is_the_default():
    given, default = cart(ss.Coulomb(0.35)), ss.MotorCart(mu=0.35)
    bounds = [ss.stick_duration_bound(system, VOLTAGE, np.linspace(0, 6, 13)) for system in (given, default)]
    np.testing.assert_allclose(*bounds, rtol=1e-12)
    assert ss.MotorCart().mu == 0.2
    assert dataclasses.replace(default, mu=None, friction=ss.Coulomb(0.3)).mu is None


@pytest.mark.slow
def test_coulombs_law_is_the_default():
    """In events, forces and energies."""
    given, default, times = cart(ss.Coulomb(0.35)), ss.MotorCart(mu=0.35), np.linspace(0, 0.9, 40)
    one, other = (ss.simulate(system, VOLTAGE, t1=1.0, y0=START) for system in (given, default))
    np.testing.assert_allclose(listed(one.sticks), listed(other.sticks), rtol=0, atol=1e-12)
    np.testing.assert_allclose(one.friction_force(times), other.friction_force(times), rtol=0, atol=1e-8)
    for found, wanted in zip(*(jax.tree.leaves(run.energies(times)) for run in (one, other)), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_motion_goes_on_from_its_last_state():
    """In a stick, whose age is in the state."""
    middle, room = 0.65, ss.Exact(max_steps=8192)
    whole, first = (ss.simulate(cart(BOTH), VOLTAGE, t1=t1, y0=START, method=room) for t1 in (1.0, middle))
    assert len(first.final_state) == 4
    assert float(first.final_state[3]) > 0.01
    later = dataclasses.replace(VOLTAGE, phase=FREQUENCY * middle)
    rest = ss.simulate(cart(BOTH), later, t1=1.0 - middle, y0=first.final_state, method=room)
    np.testing.assert_allclose(rest.final_state, whole.final_state, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["directions", "speeds"])
@pytest.mark.parametrize("step", [None, 1e-4])
def test_smoothed_friction_comes_to_it(name, step):
    """Proportionally to the width, in adaptive and in fixed steps."""
    system = cart(LAWS[name][0])
    exact, errors = ss.simulate(system, VOLTAGE, t1=0.5, y0=START).final_state[0], []
    for width in (1e-3, 1e-4):
        one = ss.simulate(system, VOLTAGE, t1=0.5, y0=START, method=ss.Regularized(width, step=step))
        errors.append(abs(float(one.final_state[0] - exact)))
        assert len(listed(one.sticks)) == 2
    assert errors[1] < 0.4 * errors[0] < 0.4 * 0.05


@pytest.mark.slow
def test_float32():
    wanted = listed(ss.simulate(cart(BOTH), VOLTAGE, t1=1.0, y0=START).sticks)
    voltage, start = ss.SourceVoltage(*map(jnp.float32, (MEAN, AMPLITUDE, FREQUENCY))), tuple(map(jnp.float32, START))
    beside = listed(ss.simulate(cart(BOTH), voltage, t1=jnp.float32(1.0), y0=start).sticks)
    with jax.enable_x64(False), pytest.warns(UserWarning, match="float32"):
        alone = listed(ss.simulate(cart(BOTH), VOLTAGE, t1=1.0, y0=START).sticks)
    for found in (beside, alone):
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-4)


def test_what_a_stick_holds_in_each_direction_and_age():
    """The cart would move forward where the motor turns backward on the first half."""
    system, torque, each = cart(BOTH), 5 * 0.01 * 9.81 / 5.33e-2, jnp.zeros(2)
    states = jnp.array([math.pi / 2, -math.pi / 2]), each, each, jnp.array([0.0, 0.3])
    low, high = system.look.stick_band(each, states, each, each, 0.0)
    np.testing.assert_allclose(low, [-0.25 * torque, -0.5 * torque], rtol=1e-13)
    np.testing.assert_allclose(high, [0.5 * torque, (0.25 + grown(0.3)) * torque], rtol=1e-13)
    assert [number.meaning for number in system.coordinates][-1] == "age of the stick in s"


@pytest.mark.slow
def test_bound_of_sticks_with_a_memory():
    """In the end static friction is that of its limit."""
    angles = np.linspace(0.1, 6.2, 50)
    slow = ss.SourceVoltage(1.0, 0.5, 10.0)
    bound = ss.stick_duration_bound(cart(ss.Ageing(ss.Coulomb(0.2), GROWTH)), slow, angles)
    np.testing.assert_allclose(bound, ss.stick_duration_bound(ss.MotorCart(mu=0.4), slow, angles), rtol=1e-12)
    endless = ss.Ageing(ss.Coulomb(0.2), lambda age: age)
    assert np.all(np.isinf(ss.stick_duration_bound(cart(endless), slow, angles)))
    for law in (endless, ss.Ageing(ss.Coulomb(0.2), lambda age: age**11)):  # infinite at the end
        assert ss.stick_duration_bound(cart(law), slow, 0.0) == 0
    lopsided = cart(ss.Directional(ss.Coulomb(0.2), ss.Coulomb(0.5)))
    found = ss.stick_duration_bound(lopsided, slow, angles)
    # The torque of this voltage is forward throughout: the cart goes backward on the first half.
    for half, mu in ((angles < math.pi, 0.5), (angles > math.pi, 0.2)):
        wanted = ss.stick_duration_bound(ss.MotorCart(mu=mu), slow, angles[half])
        np.testing.assert_allclose(found[half], wanted, rtol=1e-12)


@pytest.mark.slow
def test_no_stick_is_longer():
    """But for the transient of its current."""
    slow, lopsided = ss.SourceVoltage(1.0, 0.5, 10.0), cart(ss.Directional(ss.Coulomb(0.2), ss.Coulomb(0.5)))
    for y0 in (START, (2.0, 5.0, 0.0)):
        start, end, angle = listed(ss.simulate(lopsided, slow, t1=1.0, y0=y0).sticks).T
        longest = np.asarray(ss.stick_duration_bound(lopsided, slow, angle))
        assert np.all(end - start <= longest + 10 * 1.88e-4 / 0.307)


def test_what_does_not_fit_is_told(annotations_unchecked):
    for make, message in (
        (lambda: ss.MotorCart(mu=0.2, friction=ss.Coulomb(0.3)), "Argument mu must be None where a law gives the"),
        (lambda: ss.MotorCart(friction=0.3), "Argument friction must be a friction law such as Coulomb"),
        (lambda: ss.MotorCart(friction=ss.Coulomb(-0.3)), "Argument mu must be zero or positive"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
    with pytest.raises(ValueError, match=r"Argument method must be Exact\(...\) for friction that grows"):
        ss.simulate(cart(BOTH), VOLTAGE, t1=0.1, y0=START, method=ss.Regularized(1e-3))
