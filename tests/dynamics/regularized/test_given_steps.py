"""Fixed steps that are too long for the motion, which nothing told: what finishes is right, against scipy's Radau."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

WIDTH = 1e-2


class Kicked(eqx.Module):
    """A base of constant velocity that says another acceleration for a while."""

    acceleration_there: float

    def velocity(self, t):
        return 0.3 + 0 * t

    def acceleration(self, t):
        return jnp.where((t > 0.1) & (t < 0.5), self.acceleration_there, 0.0)

    @property
    def shortest_period(self):
        return 10.0


class Spring(ss.SwitchedSystem):
    """It tells no time scale: a step cannot be refused by it."""

    stiffness: float
    cubic: float = 0.0
    push: float = 0.0
    tone: float = 1.0

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        force = self.push * jnp.cos(self.tone * t) - self.stiffness * y[0] - self.cubic * y[0] ** 3
        return y[1], force - 0.5 * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity


@eqx.filter_jit
def end(system, excitation, step, y0, t1):
    method = ss.Regularized(WIDTH, step=step, threshold=WIDTH, minimum_duration=0.5, max_steps=2**12)
    one = ss.simulate(system, excitation, t1=t1, y0=y0, method=method)
    return one.status, jnp.stack(one.final_state), one.time_reached


def by_radau(rates, y0, t1):
    solved = solve_ivp(rates, (0.0, t1), y0, "Radau", rtol=1e-9, atol=1e-9)
    return solved.y[:, -1], np.max(np.abs(solved.y), axis=1)


def spring_rates(k, cubic, push, tone):
    def rates(t, y):
        friction = 0.5 * np.clip((y[1] - 0.3) / WIDTH, -1, 1)
        return [y[1], push * math.cos(tone * t) - k * y[0] - cubic * y[0] ** 3 - friction]

    return rates


@pytest.mark.slow
@pytest.mark.parametrize(
    ("numbers", "step"),
    [((4.0, 0.0, 0.0, 1.0), 0.2), ((400.0, 0.0, 0.0, 1.0), 0.02), ((400.0, 0.0, 0.0, 1.0), 0.2),
     ((4.0, 100.0, 0.0, 1.0), 0.1), ((4.0, 0.0, 10.0, 100.0), 0.2), ((4.0, 0.0, 0.0, 1.0), 0.005)],
)  # fmt: skip
def test_systems_of_users(numbers, step):
    """A stiff spring, one that hardens, and a fast force: before, off by the whole amplitude and `FINISHED`."""
    system, y0 = Spring(*map(jnp.asarray, numbers)), (1.0, 0.0)
    status, found, _ = end(system, ss.Constant(0.3), jnp.asarray(step), y0, 2.0)
    expected, largest = by_radau(spring_rates(*numbers), y0, 2.0)
    assert status == ss.Status.FINISHED
    radians = 2.0 * max(largest[1] / largest[0], numbers[3])
    np.testing.assert_allclose(found / largest, expected / largest, atol=1e-3 * radians + 5e-3)


@pytest.mark.slow
def test_one_that_would_need_too_many_steps():
    """No result that is wrong: the status tells."""
    numbers, y0 = (4e4, 0.0, 0.0, 1.0), (1.0, 0.0)
    status, _, reached = end(Spring(*map(jnp.asarray, numbers)), ss.Constant(0.3), jnp.asarray(0.2), y0, 200.0)
    assert status == ss.Status.OUT_OF_STEPS
    assert reached < 200.0


def cart_rates(cart, voltage):
    inertia = cart.cart_mass * cart.eccentricity**2

    def rates(t, y):
        sine, cosine = math.sin(y[0]), math.cos(y[0])
        held = cart.mu * cart.cart_mass * cart.gravity * cart.eccentricity * abs(sine)
        friction = held * np.clip(cart.eccentricity * y[1] / WIDTH, -1, 1)
        torque = cart.motor_constant * y[2] - cart.motor_damping * y[1] - inertia * sine * cosine * y[1] ** 2 - friction
        across = voltage.mean + voltage.amplitude * math.sin(voltage.angular_frequency * t + voltage.phase)
        across = across - cart.resistance * y[2] - cart.motor_constant * y[1]
        return [y[1], torque / (cart.motor_inertia + inertia * sine**2), across / cart.inductance]

    return rates


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "current"), [(300.0, 0.0), (1000.0, 0.0), (-300.0, 0.0), (0.0, 300.0), (0.0, 0.0)])
def test_a_motor_that_starts_fast(speed, current):
    """The voltage does not tell the speed of the start. At 1000 rad/s a step of 1 ms was off by 33 rad."""
    cart, voltage, y0 = ss.MotorCart(mu=0.2), ss.SourceVoltage(1.0, 0.5, 10.0), (0.7, speed, current)
    status, found, _ = end(cart, voltage, jnp.asarray(1e-3), tuple(map(jnp.asarray, y0)), 0.3)
    expected, largest = by_radau(cart_rates(cart, voltage), y0, 0.3)
    assert status == ss.Status.FINISHED
    np.testing.assert_allclose(found / largest, expected / largest, atol=5e-3)


@pytest.mark.slow
def test_derivatives_do_not_see_how_long_steps_are():
    """Against differences of Radau, where steps are shortened."""
    base = ss.Constant(0.3)

    def final(push):
        one = end(Spring(4.0, 0.0, push, 100.0), base, jnp.asarray(0.2), (1.0, 0.0), 2.0)
        return one[1]

    slope = jax.jit(jax.jacfwd(final))(10.0)
    above, below = (by_radau(spring_rates(4.0, 0.0, push, 100.0), (1.0, 0.0), 2.0)[0] for push in (10.5, 9.5))
    np.testing.assert_allclose(slope, above - below, atol=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("options", [{}, {"step": 0.01}], ids=["adaptive", "fixed"])
def test_accelerations_that_are_no_numbers(bad, options):
    """They hide sticks, in adaptive and in fixed steps: the status tells."""
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5), damping=0.1)
    one = ss.simulate(system, Kicked(bad), t1=4.0, y0=(0.0, 0.3), method=ss.Regularized(1e-3, **options))
    calm = ss.simulate(system, Kicked(0.0), t1=4.0, y0=(0.0, 0.3), method=ss.Regularized(1e-3, **options))
    assert (one.status, calm.status) == (ss.Status.NOT_FINITE, ss.Status.FINISHED)
    assert calm.sticks.count == 1
