"""A system whose friction has inner states, as the adaptive engine asks it."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..._events.sticks import StickRecord
from ..._systems.inner_states import InnerStates
from ..._systems.switched_model import State
from ..._types import BoolArray, FloatArray
from .contacts_detector import detect_contacts, start_contacts
from .contacts_seen import normal_forces, velocities_and_closed, with_slope
from .stick_detector import Criterion, Step, StickDetector, detect, start_detector


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

    def contact(self, forcing: object, t: FloatArray, y: State) -> Any:
        """What the stick detector asks about the contacts at the time `t` of the `forcing`."""
        zero = jnp.zeros_like(t)
        if self.model.contacts is None:
            return self.model.relative_velocity(forcing, zero, y)
        return velocities_and_closed(self.model, forcing, zero, y)

    def start_detector(
        self, criterion: Criterion, forcing: object, y: State, quantities: tuple[str, ...]
    ) -> StickDetector:
        """The stick detector at the beginning of a trajectory; `quantities` of each stick: those that are asked for."""
        seen, position = self.contact(forcing, jnp.zeros((), y[0].dtype), y), self.model.stick_position(y)
        if self.model.contacts is None:
            return start_detector(criterion, seen, position, quantities)
        velocity, closed = seen
        return start_contacts(criterion, velocity, closed, position, quantities)

    def detect(
        self,
        criterion: Criterion,
        detector: StickDetector,
        seen: Step,
        *,
        jumped: BoolArray,
        after: Any,
        last: BoolArray,
        resolved: bool,
    ) -> tuple[StickDetector, StickRecord]:
        """See `detect` and `detect_contacts`; `after`: what `contact` returned where the step ends."""
        update: Any = detect if self.model.contacts is None else detect_contacts
        return update(criterion, detector, seen, jumped=jumped, after=after, last=last, resolved=resolved)
