"""A system with one contact under its excitation, its friction regularised, as the engines ask it.

With several contacts: `contacts_field.py`.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from ..._events.sticks import StickRecord
from ..._systems.one_contact import OneContactModel
from ..._systems.switched_model import NOISE_ULPS, State
from ..._types import BoolArray, FloatArray
from .implicit_step import implicit_step
from .joined_sticks import AtContact
from .stick_detector import Criterion, Step, StickDetector, detect, start_detector
from .switch import Switch

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
    ) -> tuple[Step, State, State]:
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
        return Step(t, h, *first, *last, before[0], rates[0], after[0], end_rates[0], *needs), rates, end_rates

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
        seen: Step,
        *,
        jumped: BoolArray,
        after: Any,
        last: BoolArray,
    ) -> tuple[StickDetector, StickRecord]:
        """See `detect`; `after`: what `contact` returned where the step ends."""
        return detect(criterion, detector, seen, jumped=jumped, after=after, last=last)
