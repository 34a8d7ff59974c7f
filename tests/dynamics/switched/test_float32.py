"""Slips in float32 whose relative velocity is never more than round-off: they end, and the motion goes on."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

HARMONIC = ss.RandomPhase(ss.Harmonic(amplitude=1.0, angular_frequency=1.0))
VOLTAGE = ss.RandomPhase(ss.SourceVoltage())


class HardeningSpring(ss.SwitchedSystem):
    """An oscillator with a little damping, on a spring that hardens."""

    friction_force: float

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        x, v = y
        return v, -4.0 * x - 0.5 * x**3 - 0.1 * v - friction * self.friction_force

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return math.pi


def hardening(phase, start):
    base = ss.Harmonic(amplitude=1.0, angular_frequency=1.0, phase=phase)
    return ss.simulate(HardeningSpring(1.0), base, t1=50.0, y0=start)


def cart(phase, start):
    return ss.simulate(ss.MotorCart(mu=0.2), ss.SourceVoltage(phase=phase), t1=2.0, y0=start)


def hardening_drawn(key):
    return HARMONIC.sample(key, 50.0).phase, (0.0, 1.0)


def cart_drawn(key):
    phase, angle = jax.random.split(key)
    return VOLTAGE.sample(phase).phase, (jax.random.uniform(angle, maxval=2 * math.pi), 0.0, 0.0)


# Of the first 1500 and 5000 keys, those whose motion ran out of steps while a slip of round-off was looked at in ever
# shorter steps, from t = 0.96, 2.73, 2.76, 2.76 and 1.06 s on, and from 0.007, 0.001, 1.66 and 0.003 s on.
CASES = {
    "a user's system": (hardening, hardening_drawn, [(1500, 92), (1500, 157), (1500, 911), (1500, 1080), (5000, 3850)]),
    "motor and cart": (cart, cart_drawn, [(1500, 354), (1500, 728), (5000, 1816), (5000, 3112)]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param("a user's system", marks=pytest.mark.slow), "motor and cart"])
def test_a_slip_of_round_off_ends(name):
    simulate, drawn, chosen = CASES[name]

    @jax.jit
    @jax.vmap
    def found(phase, start):
        one = simulate(phase, start)
        return one.status, one.totals.stick_time

    with jax.enable_x64(False):
        keys = jnp.stack([jax.random.split(jax.random.key(0), number)[index] for number, index in chosen])
        phases, starts = jax.vmap(drawn)(keys)
        with pytest.warns(UserWarning, match="float32"):
            status, stick_time = found(phases, starts)
    _, expected = found(*jax.tree.map(lambda number: np.asarray(number, np.float64), (phases, starts)))
    assert status.tolist() == [ss.Status.FINISHED] * len(keys)
    assert np.all(np.abs(stick_time - expected) < 2e-3 * expected + 1e-4)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
@pytest.mark.parametrize("method", [ss.Exact(step=1e-2), ss.Regularized(0.1, step=1e-3)])
def test_many_steps_lose_no_digits_of_the_time(method):
    """A slip of 20 s under a force is a closed form; each of 2,000 steps or 20,000 moves on by the time that it takes.

    The time is rounded by up to 1e-6 s in each; one after another, mostly to the same side, that added up to 4e-4 and
    more. What is left are the digits of as many additions to the state, eps sqrt(20,000) = 1.7e-5.
    """
    force = ss.Harmonic(1.0, 1.0)
    with jax.enable_x64(False):
        one = ss.simulate(
            ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.3), force=force), ss.Constant(5.0), t1=20.0, method=method
        )
    # x'' = -4 x + cos t + 0.3 from rest: x = cos(t) / 3 + 0.075 + a cos(2 t) with a = -1/3 - 0.075.
    a = -1 / 3 - 0.075
    position, velocity = math.cos(20) / 3 + 0.075 + a * math.cos(40), -math.sin(20) / 3 - 2 * a * math.sin(40)
    assert float(one.final_state[0]) == pytest.approx(position, abs=2e-5)
    assert float(one.final_state[1]) == pytest.approx(velocity, abs=4e-5)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
def test_carts_that_turn_do_not_stick_at_dead_centre():
    """There the cart rests for an instant, at full speed of its motor: friction has no lever, and nothing to hold.

    Of these 200 carts 5 stuck there where friction at its limit was let hold a cart that is not at rest.
    """
    source, number = np.random.default_rng(0), 200
    drawn = [source.uniform(*ends, number) for ends in ((0.05, 3.0), (-300.0, -20.0), (0.01, 0.5), (0.0, 6.0))]

    @jax.jit
    @jax.vmap
    def followed(angle, speed, mu, phase):
        voltage = ss.SourceVoltage(3.0, 2.0, 20.0, phase)
        one = ss.simulate(ss.MotorCart(mu), voltage, t1=0.1, y0=(angle, speed, 0.0), method=ss.Exact(max_steps=1024))
        return one.status, one.sticks.position, one.sticks.mask

    with jax.enable_x64(False):
        status, angle, mask = map(np.asarray, followed(*(one.astype(np.float32) for one in drawn)))
    assert np.mean(status == ss.Status.FINISHED) > 0.99
    assert np.all(np.abs(np.sin(angle[mask])) > 1e-3)
    assert np.sum(mask) > 0
