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
