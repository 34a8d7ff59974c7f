"""A system with several contacts under its excitation, its friction regularised, as the engines ask it.

With one contact: `field.py`.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..._events.sticks import StickRecord
from ..._systems.contact_forces import solved
from ..._systems.contacts_model import ContactsModel
from ..._systems.switched_model import State
from ..._types import AnyArray, BoolArray, FloatArray, Scalar
from .contacts_detector import detect_contacts, start_contacts
from .contacts_seen import normal_forces, velocities_and_closed, with_slope
from .contacts_step import FrictionAt, contacts_step
from .joined_sticks import AtContact
from .stick_detector import Criterion, Step, StickDetector
from .switch import Switch

_MOST_NEEDED = 1e6  # times the largest friction


class ContactsField(eqx.Module):
    """A system with several contacts, with friction regularised by `switch`.

    `threshold`: of a stick, m/s, one number or (contacts,).
    """

    model: ContactsModel
    switch: Switch
    threshold: AnyArray | Scalar
    static_exceeds_kinetic: bool = eqx.field(static=True)

    @property
    def may_be_short(self) -> bool:
        """Whether fixed steps may have to be shortened."""
        return not self.model.time_scales_are_known

    def band(self, forcing: object, t: FloatArray, y: State) -> None:
        """None: fixed steps take no static friction above kinetic friction."""

    def step(
        self, forcing: object, y: State, h: FloatArray, band: FloatArray | None
    ) -> tuple[State, FloatArray | None]:
        """The state after a step of length `h` (s) and its error; see `contacts_step`."""
        return contacts_step(self.model, self.switch, forcing, y, h)

    def rates(self, forcing: object, tau: FloatArray, y: State) -> State:
        """The time derivative of the state."""
        now = self.model.instant(forcing, tau, y)
        force = self._friction(forcing, tau, y)(now.velocity)
        return tuple(a + b for a, b in zip(now.rates, self.model.effect(forcing, tau, y, force), strict=True))

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
        slow = jnp.abs(r0) <= self.threshold
        need, end_need = self._need(forcing, zero, before, slow), self._need(forcing, h, after, slow)
        normal = normal_forces(self.model, forcing, h, before, rates, after, end_rates)
        step = Step(t, h, r0, slope0, r1, slope1, x0, v0, x1, v1, need, end_need, normal)
        return step, rates, end_rates

    def contact(self, forcing: object, t: FloatArray, y: State) -> tuple[FloatArray, BoolArray]:
        """What the stick detector asks about the contacts at the time `t` of the `forcing`: the relative velocities,
        and whether they are closed.
        """
        return velocities_and_closed(self.model, forcing, jnp.zeros_like(t), y)

    def at_contact(self, forcing: object, t: FloatArray, y: State) -> AtContact:
        """What sticks are found by in adaptive steps, at the time `t` of the `forcing`."""
        velocity, closed = self.contact(forcing, t, y)
        return AtContact(velocity, closed, jnp.zeros_like(velocity))

    def start_detector(
        self, criterion: Criterion, forcing: object, y: State, quantities: tuple[str, ...]
    ) -> StickDetector:
        """The stick detector at the beginning of a trajectory; `quantities` of each stick: those that are asked for."""
        velocity, closed = self.contact(forcing, jnp.zeros((), y[0].dtype), y)
        return start_contacts(criterion, velocity, closed, self.model.stick_position(y), quantities)

    def detect(
        self,
        criterion: Criterion,
        detector: StickDetector,
        seen: Step,
        *,
        jumped: BoolArray,
        after: Any,
        last: BoolArray,
    ) -> tuple[StickDetector, StickRecord]:
        """See `detect_contacts`; `after`: what `contact` returned where the step ends."""
        return detect_contacts(criterion, detector, seen, jumped=jumped, after=after, last=last)

    def _friction(self, forcing: object, tau: FloatArray, y: State) -> FrictionAt:
        return FrictionAt(self.model, self.switch, self.static_exceeds_kinetic, forcing, tau, y)

    def _need(self, forcing: object, tau: FloatArray, y: State, slow: BoolArray) -> FloatArray:
        """Friction that keeps the relative velocities of the `slow` contacts constant, over the largest friction."""
        now = self.model.instant(forcing, tau, y)
        force = solved(now.gain, now.drift, self._friction(forcing, tau, y)(now.velocity), slow)
        share = jnp.abs(self.model.limits(forcing, tau, y, now.velocity).share(force))
        return jnp.minimum(share, _MOST_NEEDED)  # infinite where a contact is open
