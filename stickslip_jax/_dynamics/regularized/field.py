"""A system under its excitation as the engines of regularised dynamics ask it."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..._foundation.types import AnyArray, BoolArray, FloatArray, Scalar
from ..._systems.contacts import ContactsModel, solved
from ..._systems.memory_models import InnerStates
from ..._systems.switched_model import NOISE_ULPS, OneContactModel, State
from ..sticks import StickRecord
from .implicit_step import FrictionAt, Switch, contacts_step, implicit_step
from .sticks import (
    AtContact,
    Criterion,
    SeenStep,
    StickDetector,
    detect,
    detect_contacts,
    normal_forces,
    start_contacts,
    start_detector,
    velocities_and_closed,
    with_slope,
)

# A system with one contact under its excitation, its friction regularised, as the engines ask it.


_TIME_ULPS = 4  # the round-off of the time, in units in the last place


class Field(NamedTuple):
    """A system under its excitation, with friction regularised by `switch`."""

    model: OneContactModel
    switch: Switch

    def rates(self, forcing: object, tau: FloatArray, y: State) -> State:
        """The time derivative of the state."""
        speed = self.model.relative_velocity(forcing, tau, y)
        return self.model.rates_under(forcing, tau, y, self.switch.coefficient(self.model.friction_at(y), speed))

    def need(self, forcing: object, tau: FloatArray, y: State) -> FloatArray:
        """Friction that keeps the relative velocity constant, over the largest friction; infinite without friction."""
        free, held = self._accelerations(forcing, tau, y)
        return jnp.where(held > 0, jnp.abs(free) / jnp.where(held > 0, held, 1), jnp.inf)

    def band(self, forcing: object, t: FloatArray, y: State) -> FloatArray | None:
        """The relative speed (m/s) below which static friction can hold the mass: the width, and what is round-off.

        None where static friction does not exceed kinetic friction.
        """
        if not self.model.friction.static_exceeds_kinetic:
            return None
        _, held = self._accelerations(forcing, jnp.zeros_like(t), y)
        scale = NOISE_ULPS * self.model.guard_scale(forcing, y, jnp.ones_like(t)) + _TIME_ULPS * t * held
        return self.switch.width + lax.stop_gradient(jnp.finfo(t.dtype).eps * scale)

    def _accelerations(self, forcing: object, tau: FloatArray, y: State) -> tuple[FloatArray, FloatArray]:
        """The relative acceleration without friction, and the largest one that friction causes, m/s^2."""
        free, gain = self.model.effect_of_friction(forcing, tau, y)
        return free, jnp.abs(gain) * self.model.friction_at(y).stick_limit(free)

    def seen(
        self, forcing: object, t: FloatArray, h: FloatArray, before: State, after: State
    ) -> tuple[SeenStep, State, State]:
        """The step from `t` to ``t + h`` as the stick detector reads it, and the rates at both ends."""
        zero = jnp.zeros_like(h)
        rates, end_rates = self.rates(forcing, zero, before), self.rates(forcing, h, after)
        first = (
            self.model.relative_velocity(forcing, zero, before),
            self.model.relative_acceleration(forcing, zero, before, rates),
        )
        last = (
            self.model.relative_velocity(forcing, h, after),
            self.model.relative_acceleration(forcing, h, after, end_rates),
        )
        needs = self.need(forcing, zero, before), self.need(forcing, h, after)
        return SeenStep(t, h, *first, *last, before[0], rates[0], after[0], end_rates[0], *needs), rates, end_rates

    @property
    def may_be_short(self) -> bool:
        """Whether fixed steps may have to be shortened."""
        return self.model.friction.static_exceeds_kinetic or not self.model.time_scales_are_known

    def step(
        self, forcing: object, y: State, h: FloatArray, band: FloatArray | None
    ) -> tuple[State, FloatArray | None]:
        """The state after a step of length `h` (s) and its error; see `implicit_step`."""
        return implicit_step(self.model, self.switch, forcing, y, h, band)

    def contact(self, forcing: object, t: FloatArray, y: State) -> FloatArray:
        """What the stick detector asks about the contact at the time `t` of the `forcing`: the relative velocity."""
        return self.model.relative_velocity(forcing, jnp.zeros_like(t), y)

    def at_contact(self, forcing: object, t: FloatArray, y: State) -> AtContact:
        """What sticks are found by in adaptive steps, at the time `t` of the `forcing`."""
        velocity = self.contact(forcing, t, y)
        return AtContact(velocity, jnp.ones_like(velocity, bool), jnp.zeros_like(velocity))

    def start_detector(
        self, criterion: Criterion, forcing: object, y: State, quantities: tuple[str, ...]
    ) -> StickDetector:
        """The stick detector at the beginning of a trajectory; `quantities` of each stick: those that are asked for."""
        return start_detector(criterion, self.contact(forcing, jnp.zeros_like(y[0]), y), y[0], quantities)

    def detect(
        self,
        criterion: Criterion,
        detector: StickDetector,
        seen: SeenStep,
        *,
        jumped: BoolArray,
        after: Any,
        last: BoolArray,
    ) -> tuple[StickDetector, StickRecord]:
        """See `detect`; `after`: what `contact` returned where the step ends."""
        return detect(criterion, detector, seen, jumped=jumped, after=after, last=last)


# A system with several contacts under its excitation, its friction regularised, as the engines ask it.


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
    ) -> tuple[SeenStep, State, State]:
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
        step = SeenStep(t, h, r0, slope0, r1, slope1, x0, v0, x1, v1, need, end_need, normal)
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
        seen: SeenStep,
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


# A system whose friction has inner states, as the adaptive engine asks it.


class InnerField(NamedTuple):
    """A system under its excitation whose friction is smooth by itself."""

    model: InnerStates

    def rates(self, forcing: object, tau: FloatArray, y: State) -> State:
        """The time derivative of the state."""
        return self.model.rates(forcing, tau, y)

    def seen(
        self, forcing: object, t: FloatArray, h: FloatArray, before: State, after: State
    ) -> tuple[SeenStep, State, State]:
        """The step from `t` to ``t + h`` as the stick detector reads it, and the rates at both ends."""
        zero = jnp.zeros_like(h)
        rates, end_rates = self.rates(forcing, zero, before), self.rates(forcing, h, after)
        r0, slope0 = with_slope(self.model.relative_velocity, forcing, zero, before, rates)
        r1, slope1 = with_slope(self.model.relative_velocity, forcing, h, after, end_rates)
        x0, v0 = jax.jvp(self.model.stick_position, (before,), (rates,))
        x1, v1 = jax.jvp(self.model.stick_position, (after,), (end_rates,))
        normal = normal_forces(self.model, forcing, h, before, rates, after, end_rates)
        # What friction is needed in a stick is asked only of steps that do not resolve it.
        step = SeenStep(t, h, r0, slope0, r1, slope1, x0, v0, x1, v1, jnp.zeros_like(r0), jnp.zeros_like(r1), normal)
        return step, rates, end_rates

    def at_contact(self, forcing: object, t: FloatArray, y: State) -> AtContact:
        """What sticks are found by at the time `t` of the `forcing`."""
        slips = jnp.stack([jnp.asarray(law.elastic_slip, t.dtype) for law in self.model.laws])
        slips = slips if self.model.contacts else slips[0] / self.model.slip_of_law(y)
        return AtContact(*velocities_and_closed(self.model, forcing, jnp.zeros_like(t), y), slips)
