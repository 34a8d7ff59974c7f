"""The stick band: the positions of a mass, or the currents of a motor, at which friction can hold a stick."""

import jax
import jax.numpy as jnp

from .._excitation.ground import GroundMotion
from .._simulation.result import Simulation


def stick_band(
    one: Simulation, times: jax.Array, state: tuple[jax.Array, ...], velocity: jax.Array, acceleration: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The lowest and the highest value at which friction can hold a stick, at `times` (s); arrays (points,).

    `velocity` and `acceleration` are the base's, m/s and m/s^2. NaN for a system without a `stick_band`, and for a
    ground motion without an `acceleration`.
    """
    return one.system.stick_band(times, state, velocity, acceleration, _ground_acceleration(one.base, times))


def _ground_acceleration(base: object, times: jax.Array) -> jax.Array | float:
    """The acceleration of the ground to which the coordinates are relative, m/s^2; 0 if there is none."""
    if not isinstance(base, GroundMotion):
        return 0.0
    acceleration = getattr(base, "acceleration", None)
    return jnp.nan if acceleration is None else acceleration(times)
