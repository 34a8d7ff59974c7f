"""What the stick detector sees of several contacts: slopes, normal forces, which are closed."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..._systems.contacts_model import ContactsModel
from ..._systems.inner_states import InnerStates
from ..._systems.switched_model import State
from ..._types import BoolArray, FloatArray
from .stick_detector import NormalForces

Model = ContactsModel | InnerStates


def with_slope(what: Any, forcing: object, tau: FloatArray, y: State, rates: State) -> tuple[FloatArray, FloatArray]:
    """A function of forcing, time and state and its slope, where the state changes with `rates`."""
    return jax.jvp(lambda tau, y: what(forcing, tau, y), (tau, y), (jnp.ones_like(tau), rates))


def normal_forces(
    model: Model, forcing: object, h: FloatArray, before: State, rates: State, after: State, end_rates: State
) -> NormalForces | None:
    """The normal forces and their slopes at both ends of a step, 1 where they do not vary; None if none varies."""
    if not model.varying:
        return None
    where, contacts = np.array(model.varying), model.contacts

    def at(tau: FloatArray, y: State, rates: State) -> tuple[FloatArray, FloatArray]:
        value, slope = with_slope(model.varying_normal_forces, forcing, tau, y, rates)
        ones = jnp.ones(contacts, value.dtype)
        return ones.at[where].set(value), (0 * ones).at[where].set(slope)

    return NormalForces(*at(jnp.zeros_like(h), before, rates), *at(h, after, end_rates))


def velocities_and_closed(model: Model, forcing: object, tau: FloatArray, y: State) -> tuple[FloatArray, BoolArray]:
    """The relative velocities, and whether the contacts are closed."""
    velocity = model.relative_velocity(forcing, tau, y)
    closed = jnp.ones(velocity.shape, bool)
    if model.varying:
        closed = closed.at[np.array(model.varying)].set(model.varying_normal_forces(forcing, tau, y) > 0)
    return velocity, closed
