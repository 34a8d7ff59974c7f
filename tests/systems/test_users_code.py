"""What users write that JAX cannot trace, and systems in which two things rub: one sentence each."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._systems.switched_system import check_motion

MASS = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
TRACE = "must be written so that JAX can trace it, but it asks for the value of a number that is not known"


class Blocks(ss.SwitchedSystem):
    """Two masses in a row, of which the second rubs on the base."""

    stiffness: float = 1.0

    @property
    def state_names(self):
        return "position 1 in m", "velocity 1 in m/s", "position 2 in m", "velocity 2 in m/s"

    def forces(self, friction, y):
        return 0.0, friction

    def rates(self, t, y, base, friction):
        first, second = self.forces(friction, y)
        pull = self.stiffness * (y[2] - y[0])
        return y[1], pull - self.stiffness * y[0] - first, y[3], -pull - second

    def relative_velocity(self, t, y, base):
        return y[3] - base.velocity

    @property
    def shortest_time(self):
        return 3.8 / self.stiffness**0.5


class Indexed(Blocks):
    def forces(self, friction, y):
        return friction[0], friction[1]


class Unpacked(Blocks):
    def forces(self, friction, y):
        first, second = friction
        return first, second


class Signed(Blocks):
    def forces(self, friction, y):
        return 0.3 * jnp.sign(y[1]), friction


class BetweenThem(Blocks):
    def forces(self, friction, y):
        between = 0.3 * jnp.sign(y[1] - y[3])
        return between, friction - between


class Pair(Blocks):
    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity, y[3] - base.velocity


class Stacked(Blocks):
    def relative_velocity(self, t, y, base):
        return jnp.stack([y[1] - base.velocity, y[3] - base.velocity])


class Smoothed(Blocks):
    """What the sentence advises."""

    def forces(self, friction, y):
        return 0.3 * jnp.tanh(y[1] / 0.01), friction


class Bent(Blocks):
    """Kinks are no jumps."""

    def forces(self, friction, y):
        return 0.3 * jnp.abs(y[1]) + jnp.maximum(y[0], 0.0), friction


def run(system, **options):
    return ss.simulate(system, ss.Harmonic(0.4, 0.8), t1=2.0, y0=(0.0, 0.1, 0.2, 0.0), **options)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Indexed, Unpacked, Signed, BetweenThem, Pair, Stacked])
def test_two_contacts(kind):
    with pytest.raises(
        ValueError, match=f"of a {kind.__name__} must .* declare the number of dry-friction contacts"
    ) as told:
        run(kind())
    assert "\n" not in str(told.value)
    for start in ((0.0, 0.0, 0.0, 0.0), (1.0, 2.0, 3.0, 4.0)):
        with pytest.raises(ValueError, match="the number of dry-friction contacts"):
            ss.simulate(kind(), ss.Constant(0.3), t1=2.0, y0=start)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Blocks, Smoothed, Bent])
def test_one_contact(kind):
    check_motion(kind(), (0.0, 0.1, 0.2, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Blocks, Smoothed, Bent])
def test_one_contact_is_followed(kind):
    assert int(run(kind(), method=ss.Exact(step=0.02)).status) == ss.Status.FINISHED


class Falling(ss.FrictionLaw):
    mu: float

    @property
    def static(self):
        return self.mu

    def kinetic(self, speed):
        return self.mu * math.exp(-speed)


class Swell(ss.Signal):
    amplitude: float

    def value(self, t):
        return self.amplitude * np.sin(t)


class Plain:
    def velocity(self, t):
        return math.sin(t)

    def acceleration(self, t):
        return math.cos(t)


class SlowRates(Blocks):
    def forces(self, friction, y):
        return 0.0, friction * math.sqrt(self.stiffness)


class SlowTime(Blocks):
    @property
    def shortest_time(self):
        return 3.8 / math.sqrt(self.stiffness)


class SlowVelocity(Blocks):
    def relative_velocity(self, t, y, base):
        return y[3] - base.velocity if y[3] > -1e9 else y[3]


class SlowTimeOfTwo(SlowTime):
    contacts = 2

    def forces(self, friction, y):
        return friction[0], friction[1]

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity, y[3] - base.velocity


class SlowRatesOfTwo(SlowTimeOfTwo):
    shortest_time = None

    def forces(self, friction, y):
        return friction[0] * math.sqrt(self.stiffness), friction[1]


class Table(eqx.Module):
    high: float

    def __call__(self, speed):
        return np.interp(speed, [0.0, 1.0], [self.high, 0.3])


CODE = {
    "numpy in a curve": (lambda: ss.FrictionCurve(lambda v: 0.6 - 0.1 * np.tanh(v)), "Argument curve of FrictionCurve"),
    "a module with numpy": (lambda: ss.FrictionCurve(Table(0.5)), "Argument curve of FrictionCurve"),
    "if in a curve": (lambda: ss.FrictionCurve(lambda v: 0.6 if v < 1 else 0.5), "Argument curve of FrictionCurve"),
    "a law": (lambda: Falling(0.3), "The method kinetic of Falling"),
    "a signal": (lambda: Swell(1.0), "The method value of Swell"),
    "a motion": (lambda: ss.simulate(MASS, Plain(), t1=1.0), "The method velocity of Plain"),
    "rates": (lambda: run(SlowRates()), "The method rates of SlowRates"),
    "a time": (lambda: run(SlowTime()), "The property shortest_time of SlowTime"),
    "a time under grad": (
        lambda: jax.grad(lambda k: run(SlowTime(k)).stick_time)(1.0),
        "The property shortest_time of SlowTime",
    ),
    "a time of several contacts": (
        lambda: ss.simulate(SlowTimeOfTwo(), ss.Constant(0.3), t1=2.0),
        "The property shortest_time of SlowTimeOfTwo",
    ),
    "rates of several contacts": (
        lambda: ss.simulate(SlowRatesOfTwo(), ss.Constant(0.3), t1=2.0),
        "The method rates of SlowRatesOfTwo",
    ),
    "a relative velocity": (lambda: run(SlowVelocity()), "The method relative_velocity of SlowVelocity"),
}


@pytest.mark.parametrize("name", CODE)
def test_what_cannot_be_traced(name):
    make, where = CODE[name]
    with pytest.raises(ValueError, match=f"^{where} {TRACE}.*jax.numpy.sqrt") as told:
        make()
    assert "\n" not in str(told.value)


class Power(Blocks):
    """Its rates are affine in friction for one exponent only, and smooth for one factor only."""

    exponent: float = 1.0
    jump: float = 0.0

    def forces(self, friction, y):
        return self.jump * jnp.sign(y[1]), jnp.sign(friction) * jnp.abs(friction) ** self.exponent


def test_numbers_of_systems_like_one_that_was_tried_are_looked_at():
    """The methods of a class are tried once, its numbers always."""
    for _ in range(2):
        check_motion(Power(), (0.0, 0.1, 0.2, 0.0))
        check_motion(Power(stiffness=2.0), (0.0, 0.1, 0.2, 0.3))
        for system, message in ((Power(exponent=2.0), "must be affine in friction"), (Power(jump=0.3), "jumps from")):
            with pytest.raises(ValueError, match=f"rates of a Power .*{message}"):
                check_motion(system, (0.0, 0.1, 0.2, 0.0))
