"""Slips that begin at the base's velocity: derivatives by what starts them are those of the side to which they go."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

PHASE = 0.4
BASE = ss.Harmonic(0.5, 1.3, PHASE)
SPEED = float(BASE.value(jnp.zeros((), float)))
EXACT = ss.Exact(step=0.1, max_steps=512)


class Hung(ss.SwitchedSystem):
    """A mass on a spring that hardens, on the base."""

    cubic: float = 0.3

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        return y[1], -4 * y[0] - self.cubic * y[0] ** 3 - 0.5 * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return 2.0


class Pair(Hung):
    """Two such masses, each with a contact, joined by a spring."""

    contacts = 2

    @property
    def state_names(self):
        return "position in m", "velocity in m/s", "other position in m", "other velocity in m/s"

    def rates(self, t, y, base, friction):
        pull = y[2] - y[0]
        return (
            y[1],
            pull - 4 * y[0] - 0.5 * friction[0],
            y[3],
            -pull - 4 * y[2] - self.cubic * y[2] ** 3 - 4 * friction[1],
        )

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity, y[3] - base.velocity


def spring(law):
    return ss.MassSpring(1.0, 4.0, 1.0, law)


def structure():
    contacts = [ss.Contact.of_mass(i, 2, 1.0, ss.Coulomb(mu)) for i, mu in enumerate([0.5, 4.0])]
    return ss.LinearStructure(np.eye(2), [[5.0, -1.0], [-1.0, 5.0]], contacts=contacts)


# The system and its initial positions; that of the first mass pulls it back, beyond what friction can hold.
SYSTEMS = {
    "Coulomb": (spring(ss.Coulomb(0.5)), (1.0,)),
    "static": (spring(ss.Coulomb(0.5, 0.7)), (1.0,)),
    "Stribeck": (spring(ss.Stribeck(0.5, 0.7, 0.3)), (1.0,)),
    "Directional": (spring(ss.Directional(ss.Coulomb(0.5), ss.Coulomb(0.8))), (1.0,)),
    "Ageing": (spring(ss.Ageing(ss.Coulomb(0.5), ss.ExponentialGrowth(0.5, time=2.0))), (1.0,)),
    "own": (Hung(), (1.0,)),
    "structure": (structure(), (1.0, 0.1)),
    "own pair": (Pair(), (1.0, 0.01)),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "own pair" else name for name in SYSTEMS]
)
def test_derivatives_of_the_side_to_which_it_slips(name):
    system, positions = SYSTEMS[name]

    def final(velocity, phase):
        one = positions[0], SPEED + velocity, *(n for x in positions[1:] for n in (x, SPEED))
        if name == "structure":  # its positions come before its velocities
            one = *positions, SPEED + velocity, *[SPEED] * (len(positions) - 1)
        if name == "Ageing":
            one = *one, 0.0
        base = ss.Harmonic(0.5, 1.3, PHASE + phase)
        return jnp.stack(ss.simulate(system, base, t1=1.5, y0=one, method=EXACT).final_state)

    run, small = jax.jit(final), 1e-5
    for tangent in (-1.0, 0.0), (0.0, -1.0):  # the mass falls behind the base
        derivative = jax.jit(lambda d: jax.jvp(final, (0.0, 0.0), d)[1])(tangent)
        at = [run(*(k * small * part for part in tangent)) for k in range(3)]
        np.testing.assert_allclose(derivative, (4 * at[1] - 3 * at[0] - at[2]) / (2 * small), rtol=0, atol=1e-7)


@pytest.mark.slow
def test_a_motor_that_starts():
    cart, voltage = ss.MotorCart(mu=0.2), ss.SourceVoltage(5.0, 5.0, 7.0)

    def final(speed):
        return jnp.stack(
            ss.simulate(cart, voltage, t1=0.3, y0=(0.7, speed, 20.0), method=ss.Exact(step=0.002)).final_state
        )

    small = 1e-4
    at = [final(k * small) for k in range(3)]
    assert float(at[0][1]) > 0
    derivative = jax.jvp(final, (0.0,), (1.0,))[1]
    np.testing.assert_allclose(derivative, (4 * at[1] - 3 * at[0] - at[2]) / (2 * small), rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_time_steps_and_closed_form_agree():
    def final(velocity, base, method):
        system = spring(ss.Coulomb(0.5))
        return ss.simulate(system, ss.Constant(base), t1=1.0, y0=(1.0, velocity), method=method).final_state[0]

    steps, closed = (jax.grad(final, argnums=(0, 1))(0.3, 0.3, method) for method in (EXACT, ss.Exact()))
    np.testing.assert_allclose(steps, closed, rtol=0, atol=1e-12)
