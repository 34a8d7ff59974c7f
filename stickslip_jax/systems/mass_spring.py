"""A mass on a spring, rubbing on a moving base."""

import equinox as eqx
import jax.numpy as jnp

from .. import _checks
from .._types import Scalar
from .friction import Coulomb


class MassSpring(eqx.Module):
    """A mass held to the ground by a spring and pressed on a base that moves with velocity ``v(t)``.

    While slipping, ``mass * x'' + stiffness * x = mu * normal_force * sign(v - x')``; while sticking, ``x' = v``,
    which lasts as long as ``|stiffness * x| <= mu * normal_force``
    (Lima and Sampaio 2017, "Construction of a statistical model", eq. 1).

    - `mass` in kg, `stiffness` in N/m, `normal_force` in N: positive numbers.
    - `friction`: the friction law, `Coulomb(mu)`.

    Raises ValueError if a number is not positive and finite, or `friction` is not a friction law.
    """

    mass: Scalar
    stiffness: Scalar
    normal_force: Scalar
    friction: Coulomb

    def __check_init__(self):
        _checks.positive("mass", self.mass, "kg")
        _checks.positive("stiffness", self.stiffness, "N/m")
        _checks.positive("normal_force", self.normal_force, "N")
        if not isinstance(self.friction, Coulomb):
            raise ValueError(
                f"Argument friction must be a friction law such as Coulomb(mu=0.3), but {self.friction!r} was given."
            )

    @property
    def angular_frequency(self) -> Scalar:
        """Natural angular frequency ``omega = sqrt(stiffness / mass)``, rad/s."""
        return jnp.sqrt(self.stiffness / self.mass)

    @property
    def stick_half_width(self) -> Scalar:
        """Largest displacement at which the mass can stick, ``a = mu * normal_force / stiffness``, m."""
        return self.friction.mu * self.normal_force / self.stiffness
