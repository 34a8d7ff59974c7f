"""A system whose friction has inner states, as the adaptive engine asks it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..._systems.inner_states import InnerStates
from ..._systems.switched_model import State
from ..._types import FloatArray
from .contacts_seen import normal_forces, velocities_and_closed, with_slope
from .joined_sticks import AtContact
from .stick_detector import Step


class InnerField(NamedTuple):
    """A system under its excitation whose friction is smooth by itself."""

    model: InnerStates

    def rates(self, forcing: object, tau: FloatArray, y: State) -> State:
        """The time derivative of the state."""
        return self.model.rates(forcing, tau, y)

    def seen(
        self, forcing: object, t: FloatArray, h: FloatArray, before: State, after: State
    ) -> tuple[Step, State, State]:
        """The step from `t` to ``t + h`` as the stick detector reads it, and the rates at both ends."""
        zero = jnp.zeros_like(h)
        rates, end_rates = self.rates(forcing, zero, before), self.rates(forcing, h, after)
        r0, slope0 = with_slope(self.model.relative_velocity, forcing, zero, before, rates)
        r1, slope1 = with_slope(self.model.relative_velocity, forcing, h, after, end_rates)
        x0, v0 = jax.jvp(self.model.stick_position, (before,), (rates,))
        x1, v1 = jax.jvp(self.model.stick_position, (after,), (end_rates,))
        normal = normal_forces(self.model, forcing, h, before, rates, after, end_rates)
        # What friction is needed in a stick is asked only of steps that do not resolve it.
        step = Step(t, h, r0, slope0, r1, slope1, x0, v0, x1, v1, jnp.zeros_like(r0), jnp.zeros_like(r1), normal)
        return step, rates, end_rates

    def at_contact(self, forcing: object, t: FloatArray, y: State) -> AtContact:
        """What sticks are found by at the time `t` of the `forcing`."""
        slips = jnp.stack([jnp.asarray(law.elastic_slip, t.dtype) for law in self.model.laws])
        slips = slips if self.model.contacts else slips[0] / self.model.slip_of_law(y)
        return AtContact(*velocities_and_closed(self.model, forcing, jnp.zeros_like(t), y), slips)
