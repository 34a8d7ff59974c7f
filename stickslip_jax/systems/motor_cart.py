"""A cart on a rail with dry friction, driven by a DC motor through a scotch yoke."""

import math

import equinox as eqx
import jax.numpy as jnp

from .. import _checks
from .._types import AnyArray, FloatArray, Scalar
from ..base_motion.voltage import SourceVoltage


class MotorCart(eqx.Module):
    """The motor-driven cart of Lima and Sampaio 2022; the defaults are its Table 1.

    State: motor angle ``alpha`` (rad), angular velocity ``alpha'`` (rad/s), current ``c`` (A). With
    ``m = cart_mass`` and ``d = eccentricity``,

    ``alpha'' (motor_inertia + m d^2 sin^2) + motor_damping alpha' + m d^2 sin cos alpha'^2 - motor_constant c
    = -mu m gravity d |sin| sign(alpha')``, ``inductance c' + resistance c + motor_constant alpha' = voltage``.

    The mass sticks while ``alpha' = 0`` and ``|motor_constant c| <= mu m gravity d |sin alpha|``; at ``sin alpha = 0``
    (dead centre) friction has no leverage and nothing sticks.

    - `mu`: friction coefficient of cart and rail, zero or positive.
    - `cart_mass` kg, `eccentricity` m, `gravity` m/s^2, `motor_inertia` kg m^2, `motor_constant` V s/rad (also N m/A),
      `resistance` ohm, `inductance` H: positive. `motor_damping` N m s/rad: zero or positive.
    - `equation`: "physical" as above (the default), or "printed": as printed in the paper (eq. 2), whose term
      ``m d^2 sin cos`` multiplies ``alpha'`` and not its square, so that its units do not match.

    Raises ValueError for numbers out of range and for another `equation`.
    """

    mu: Scalar = 0.2
    cart_mass: Scalar = 5.0
    eccentricity: Scalar = 0.01
    gravity: Scalar = 9.81
    motor_inertia: Scalar = 1.21e-4
    motor_damping: Scalar = 1.545e-4
    motor_constant: Scalar = 5.33e-2
    resistance: Scalar = 0.307
    inductance: Scalar = 1.88e-4
    equation: str = eqx.field(static=True, default="physical")

    def __check_init__(self):
        _checks.non_negative("mu", self.mu)
        units = {"cart_mass": "kg", "eccentricity": "m", "gravity": "m/s^2", "motor_inertia": "kg m^2",
                 "motor_constant": "V s/rad", "resistance": "ohm", "inductance": "H"}  # fmt: skip
        for name, unit in units.items():
            _checks.positive(name, getattr(self, name), unit)
        _checks.non_negative("motor_damping", self.motor_damping, "N m s/rad")
        if self.equation not in ("physical", "printed"):
            raise ValueError(f"Argument equation must be 'physical' or 'printed', but {self.equation!r} was given.")

    @property
    def largest_friction_torque(self) -> Scalar:
        """``mu m gravity d``, N m: what friction can hold at ``|sin alpha| = 1``."""
        return self.mu * self.cart_mass * self.gravity * self.eccentricity

    @property
    def shortest_time(self) -> Scalar:
        """The mechanical time constant at dead centre, ``motor_inertia resistance / motor_constant^2``, s."""
        return self.motor_inertia * self.resistance / self.motor_constant**2


def stick_duration_bound(system: MotorCart, voltage: SourceVoltage, angle: AnyArray | float) -> FloatArray:
    """The longest that the cart can stick at motor angles `angle` (rad, any shape), s; infinity where for ever.

    It is how long the steady current stays below what friction can hold in one period of the voltage,
    ``(pi + 2 asin s) / angular_frequency`` with ``s = (mu m g d |sin angle| / motor_constant - mean / resistance) / A``
    and ``A`` the amplitude of the steady current; 0 where ``s <= -1`` (Lima and Sampaio 2022, section 4, whose eqs 7
    and 8 lack the angular frequency in some places). The current that a stick begins with decays in the time
    ``inductance / resistance``; it can prolong a stick by about that much.

    A constant voltage (amplitude 0) gives 0 or infinity. Raises ValueError for arguments of another kind.
    """
    if not isinstance(system, MotorCart) or not isinstance(voltage, SourceVoltage):
        raise ValueError(
            "Arguments system and voltage must be a MotorCart and a SourceVoltage, but "
            f"{_checks.show(system)} and {_checks.show(voltage)} were given."
        )
    _checks.numeric("angle", angle, ndim=None)
    held = system.largest_friction_torque * jnp.abs(jnp.sin(jnp.asarray(angle, float))) / system.motor_constant
    reactance = system.inductance * voltage.angular_frequency
    amplitude = jnp.abs(voltage.amplitude) / jnp.sqrt(system.resistance**2 + reactance**2)
    spare = held - voltage.mean / system.resistance
    some = (amplitude > 0) & (jnp.abs(spare) < amplitude)
    s = jnp.where(some, spare, 0) / jnp.where(some, amplitude, 1)
    bound = (math.pi + 2 * jnp.arcsin(s)) / voltage.angular_frequency
    return jnp.where(some, bound, jnp.where(spare >= amplitude, jnp.inf, 0.0))
