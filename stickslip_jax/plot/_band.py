"""Where a system can stick: the positions of a mass, the currents of a motor, that friction can hold."""

from typing import Any

import jax
import jax.numpy as jnp

from ..base_motion.ground import GroundMotion
from ..base_motion.recorded import Recorded
from ..simulate import Simulation
from ..systems.mass_spring import MassSpring
from ..systems.motor_cart import MotorCart


def stick_band(
    one: Simulation, times: jax.Array, state: tuple[jax.Array, ...], velocity: jax.Array, acceleration: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The lowest and the highest value at which friction can hold, at `times` (s, (points,)).

    Of a `MassSpring` the position x (m), from ``|mass v' + damping v + stiffness x - force| <= mu_static n``, at base
    velocity v (m/s) and acceleration v' (m/s^2); of a `MotorCart` the current (A), at the angle that `state` tells.
    NaN where the ground moves in a way that does not tell its acceleration.
    """
    if isinstance(one.system, MotorCart):
        most = one.system.largest_friction_torque / one.system.motor_constant * jnp.abs(jnp.sin(state[0]))
        return -most, most
    system = one.system
    assert isinstance(system, MassSpring)
    load = _force(system, times) - system.mass * (acceleration + _ground_acceleration(one.base, times))
    if system.damping is not None:
        load = load - system.damping * velocity
    centre = load / system.stiffness
    return centre - system.stick_half_width, centre + system.stick_half_width


def _force(system: MassSpring, times: jax.Array) -> Any:
    """The external force on the mass, N."""
    if system.force is None:
        return 0.0
    return system.force.value(times) if isinstance(system.force, Recorded) else jax.vmap(system.force.value)(times)


def _ground_acceleration(base: Any, times: jax.Array) -> Any:
    """The acceleration of the ground that carries the coordinates, m/s^2."""
    if not isinstance(base, GroundMotion):
        return 0.0
    acceleration = getattr(base, "acceleration", None)
    return jnp.nan if acceleration is None else acceleration(times)
