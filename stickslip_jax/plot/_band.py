"""Where a system can stick: the positions of a mass, the currents of a motor, that friction can hold."""

from typing import Any

import jax
import jax.numpy as jnp

from .._excitation.ground import GroundMotion
from .._simulation.result import Simulation


def stick_band(
    one: Simulation, times: jax.Array, state: tuple[jax.Array, ...], velocity: jax.Array, acceleration: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The lowest and the highest value that friction can hold, at `times` (s, (points,)).

    NaN where the system does not know it, and where the ground moves in a way that does not give its acceleration.
    """
    return one.system.stick_band(times, state, velocity, acceleration, _ground_acceleration(one.base, times))


def _ground_acceleration(base: Any, times: jax.Array) -> Any:
    """The acceleration of the ground that carries the coordinates, m/s^2."""
    if not isinstance(base, GroundMotion):
        return 0.0
    acceleration = getattr(base, "acceleration", None)
    return jnp.nan if acceleration is None else acceleration(times)
