"""Friction laws of users whose coefficients cannot be: a sentence where the law or the system is made."""

import equinox as eqx
import jax.numpy as jnp
import pytest

import stickslip_jax as ss

HOLDS = r"The static friction coefficient of Law must be at least kinetic\(0\)"
SIGN = r"The friction coefficient kinetic\(0\) of Law must be finite, zero or positive"


class Law(ss.FrictionLaw):
    held: float
    slid: float

    @property
    def static(self):
        return self.held

    def kinetic(self, speed):
        return self.slid * jnp.exp(-speed)


class Sided(ss.FrictionLaw):
    """Another law in either direction, of its own class: `forward` and `backward` slips."""

    forward: float
    backward: float
    share: float = eqx.field(static=True, default=1.0)
    larger: bool = eqx.field(static=True, default=True)

    @property
    def static(self):
        larger, smaller = jnp.maximum(self.forward, self.backward), jnp.minimum(self.forward, self.backward)
        return larger if self.larger else smaller

    def kinetic(self, speed):
        return jnp.minimum(self.forward, self.backward) + 0 * speed

    def in_direction(self, velocity):
        coefficient = jnp.where(velocity < 0, self.backward, self.forward)
        return Law(self.share * coefficient, coefficient) if self.share < 1 else Sided(coefficient, coefficient)


def system(law):
    return ss.MassSpring(1.0, 4.0, 1.0, law)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Law(0.2, 0.5),
            HOLDS + r" = 0\.5, but 0\.2",
        ),
        (
            lambda: Law(0.5, -0.1),
            SIGN + ", but -0",
        ),
        (lambda: Law(0.5, float("nan")), r"Argument slid must be finite"),
        (lambda: Law(-0.1, -0.2), SIGN),
        (lambda: system(Sided(0.2, 0.5, 0.5)), HOLDS),
        (
            lambda: system(Sided(0.2, 0.5, 1.0, False)),
            "The property static of Sided must be at least that of",
        ),
    ],
)
def test_refused(make, message):
    with pytest.raises(ValueError, match=rf"\A{message}.* was given.*\.\Z"):
        make()


@pytest.mark.slow
def test_a_law_of_two_directions():
    """It rides up to what friction holds against a slip backward, 0.5 / 4 m, at 0.3 m/s."""
    one = ss.simulate(system(Sided(0.2, 0.5)), ss.Constant(0.3), t1=1.0, y0=(0.0, 0.3), method=ss.Exact(step=0.05))
    assert one.sticks.end[0] == pytest.approx(0.5 / 4 / 0.3, rel=1e-9)
