"""A mass on a spring, rubbing on a moving base."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from .. import _checks
from .._types import Scalar
from ..base_motion.recorded import Recorded
from ..base_motion.smooth import Signal
from .friction import FrictionLaw


class MassSpring(eqx.Module):
    """A mass held to the ground by a spring and pressed on a base that moves with velocity ``v(t)``.

    While slipping, ``mass x'' + damping x' + stiffness x = force(t) + mu normal_force sign(v - x')``; while sticking,
    ``x' = v``, which lasts as long as ``|mass v' + damping v + stiffness x - force| <= mu_static normal_force``
    (Lima and Sampaio 2017, "Construction of a statistical model", eq. 1, where damping and force are zero).

    - `mass` in kg, `stiffness` in N/m, `normal_force` in N: positive numbers.
    - `friction`: the friction law, such as `Coulomb(mu)`.
    - `damping` in N s/m, zero or positive: of a viscous damper to the ground. None is zero.
    - `force`: external force on the mass, N: a `Signal` such as `Harmonic`, or a `Recorded`. None is zero.

    Raises ValueError if a number is out of its range or not finite, or `friction` or `force` is of another kind.
    """

    mass: Scalar
    stiffness: Scalar
    normal_force: Scalar
    friction: FrictionLaw
    # None rather than zero, so that what needs neither is told apart by its structure when numbers are traced.
    damping: Scalar | None = eqx.field(default=None, converter=lambda v: None if _is_zero(v) else v)
    force: Signal | Recorded | None = None

    def __check_init__(self):
        _checks.positive("mass", self.mass, "kg")
        _checks.positive("stiffness", self.stiffness, "N/m")
        _checks.positive("normal_force", self.normal_force, "N")
        if not isinstance(self.friction, FrictionLaw):
            raise ValueError(
                f"Argument friction must be a friction law such as Coulomb(mu=0.3), but {self.friction!r} was given."
            )
        if self.damping is not None:
            _checks.non_negative("damping", self.damping, "N s/m")
        if self.force is not None and not isinstance(self.force, (Signal, Recorded)):
            raise ValueError(
                "Argument force must be a signal such as Harmonic(amplitude, angular_frequency) or Recorded(times, "
                f"values), but {_checks.show(self.force)} was given."
            )

    @property
    def angular_frequency(self) -> Scalar:
        """Natural angular frequency ``omega = sqrt(stiffness / mass)``, rad/s."""
        return jnp.sqrt(self.stiffness / self.mass)

    @property
    def stick_half_width(self) -> Scalar:
        """Largest displacement at which the mass can stick on a base of constant velocity, without force and damping.

        ``a = mu_static * normal_force / stiffness``, m.
        """
        return self.friction.static * self.normal_force / self.stiffness


def _is_zero(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and value == 0
