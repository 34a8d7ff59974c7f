"""A system under its excitation as the engines of regularised dynamics ask it."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..._foundation.types import AnyArray, FloatArray, Scalar
from ..._systems.contacts import ContactsModel, solved
from ..._systems.memory_models import InnerStates
from ..._systems.switched_model import NOISE_ULPS, OneContactModel, State
from .implicit_step import FrictionAt, Switch, contacts_step, implicit_step
from .sticks import AtContact, NormalForces, SeenStep

# What the engines and the stick detectors ask of a system whose friction is regularised, or smooth by itself.


_TIME_ULPS = 4  # the round-off of the time, in units in the last place
_MOST_NEEDED = 1e6  # times the largest friction


class AnyField(eqx.Module):
    """A system under its excitation whose friction has no jump; what belongs to contacts is as in its `model`."""

    model: eqx.AbstractVar[Any]

    @abc.abstractmethod
    def rates(self, forcing: Any, tau: FloatArray, y: State) -> State:
        """The time derivative of the state."""

    def need(self, forcing: Any, tau: FloatArray, y: State, velocity: FloatArray) -> FloatArray:
        """Friction that keeps the relative velocity constant, over the largest friction; infinite without friction.

        It is asked only of steps that do not resolve a stick. `velocity`: the relative one in this state.
        """
        return jnp.zeros_like(velocity)

    def elastic_slip(self, velocity: FloatArray, y: State) -> FloatArray:
        """How far each contact can slip while bristles only bend."""
        return jnp.zeros_like(velocity)

    def velocity_and_slope(
        self, forcing: Any, tau: FloatArray, y: State, rates: State
    ) -> tuple[FloatArray, FloatArray]:
        """The relative velocity, m/s, and its time derivative where the state changes with `rates`."""
        return _with_slope(self.model.relative_velocity, forcing, tau, y, rates)

    def seen(
        self, forcing: Any, t: FloatArray, h: FloatArray, before: State, after: State
    ) -> tuple[SeenStep, State, State]:
        """The step from `t` to ``t + h`` as the stick detectors read it, and the rates at both ends."""

        def at(tau: FloatArray, y: State) -> tuple[State, tuple[FloatArray, ...], FloatArray, Any]:
            rates = self.rates(forcing, tau, y)
            velocity = self.velocity_and_slope(forcing, tau, y, rates)
            position = jax.jvp(self.model.stick_position, (y,), (rates,))
            normal = None
            if _varying(self.model):
                # The normal forces and their slopes, 1 where they do not vary.
                where, ones = np.array(self.model.varying), jnp.ones(self.model.contacts, tau.dtype)
                value, slope = _with_slope(self.model.varying_normal_forces, forcing, tau, y, rates)
                normal = ones.at[where].set(value), (0 * ones).at[where].set(slope)
            return rates, (*velocity, *position), self.need(forcing, tau, y, velocity[0]), normal

        (rates, first, need, normal), (end_rates, last, end_need, end_normal) = at(0 * h, before), at(h, after)
        (r0, slope0, x0, v0), (r1, slope1, x1, v1) = first, last
        normal = None if normal is None else NormalForces(*normal, *end_normal)
        step = SeenStep(t, h, r0, slope0, r1, slope1, x0, v0, x1, v1, need, end_need, normal)
        return step, rates, end_rates

    def at_contact(self, forcing: Any, t: FloatArray, y: State) -> AtContact:
        """What sticks are found by, at the time `t` of the `forcing`."""
        zero = jnp.zeros_like(t)
        velocity = self.model.relative_velocity(forcing, zero, y)
        closed = jnp.ones(velocity.shape, bool)
        if _varying(self.model):
            closed = closed.at[np.array(self.model.varying)].set(self.model.varying_normal_forces(forcing, zero, y) > 0)
        return AtContact(velocity, closed, self.elastic_slip(velocity, y))


def _varying(model: Any) -> tuple[int, ...]:
    """The contacts whose normal forces vary."""
    return () if isinstance(model, OneContactModel) else model.varying


def _with_slope(what: Any, forcing: Any, tau: FloatArray, y: State, rates: State) -> tuple[FloatArray, FloatArray]:
    """A function of forcing, time and state and its slope, where the state changes with `rates`."""
    return jax.jvp(lambda tau, y: what(forcing, tau, y), (tau, y), (jnp.ones_like(tau), rates))


class Field(AnyField):
    """A system with one contact, with friction regularised by `switch`."""

    model: OneContactModel
    switch: Switch

    def rates(self, forcing: Any, tau: FloatArray, y: State) -> State:
        speed = self.model.relative_velocity(forcing, tau, y)
        return self.model.rates_under(forcing, tau, y, self.switch.coefficient(self.model.friction_at(y), speed))

    def need(self, forcing: Any, tau: FloatArray, y: State, velocity: FloatArray) -> FloatArray:
        free, held = self._accelerations(forcing, tau, y)
        return jnp.where(held > 0, jnp.abs(free) / jnp.where(held > 0, held, 1), jnp.inf)

    def velocity_and_slope(
        self, forcing: Any, tau: FloatArray, y: State, rates: State
    ) -> tuple[FloatArray, FloatArray]:
        velocity = self.model.relative_velocity(forcing, tau, y)
        return velocity, self.model.relative_acceleration(forcing, tau, y, rates)

    def band(self, forcing: Any, t: FloatArray, y: State) -> FloatArray | None:
        """The relative speed (m/s) below which static friction can hold the mass: the width, and what is round-off.

        None where static friction does not exceed kinetic friction.
        """
        if not self.model.friction.static_exceeds_kinetic:
            return None
        _, held = self._accelerations(forcing, jnp.zeros_like(t), y)
        scale = NOISE_ULPS * self.model.guard_scale(forcing, y, jnp.ones_like(t)) + _TIME_ULPS * t * held
        return self.switch.width + lax.stop_gradient(jnp.finfo(t.dtype).eps * scale)

    def _accelerations(self, forcing: Any, tau: FloatArray, y: State) -> tuple[FloatArray, FloatArray]:
        """The relative acceleration without friction, and the largest one that friction causes, m/s^2."""
        free, gain = self.model.effect_of_friction(forcing, tau, y)
        return free, jnp.abs(gain) * self.model.friction_at(y).stick_limit(free)

    @property
    def may_be_short(self) -> bool:
        """Whether fixed steps may have to be shortened."""
        return self.model.friction.static_exceeds_kinetic or not self.model.time_scales_are_known

    def step(self, forcing: Any, y: State, h: FloatArray, band: FloatArray | None) -> tuple[State, FloatArray | None]:
        """The state after a step of length `h` (s) and its error; see `implicit_step`."""
        return implicit_step(self.model, self.switch, forcing, y, h, band)


class ContactsField(AnyField):
    """A system with several contacts, with friction regularised by `switch`.

    `threshold`: of a stick, m/s, one number or (contacts,).
    """

    model: ContactsModel
    switch: Switch
    threshold: AnyArray | Scalar
    static_exceeds_kinetic: bool = eqx.field(static=True)

    def rates(self, forcing: Any, tau: FloatArray, y: State) -> State:
        now = self.model.instant(forcing, tau, y)
        force = self._friction(forcing, tau, y)(now.velocity)
        return tuple(a + b for a, b in zip(now.rates, self.model.effect(forcing, tau, y, force), strict=True))

    def need(self, forcing: Any, tau: FloatArray, y: State, velocity: FloatArray) -> FloatArray:
        now, slow = self.model.instant(forcing, tau, y), jnp.abs(velocity) <= self.threshold
        force = solved(now.gain, now.drift, self._friction(forcing, tau, y)(now.velocity), slow)
        share = jnp.abs(self.model.limits(forcing, tau, y, now.velocity).share(force))
        return jnp.minimum(share, _MOST_NEEDED)  # infinite where a contact is open

    def _friction(self, forcing: Any, tau: FloatArray, y: State) -> FrictionAt:
        return FrictionAt(self.model, self.switch, self.static_exceeds_kinetic, forcing, tau, y)

    @property
    def may_be_short(self) -> bool:
        """Whether fixed steps may have to be shortened."""
        return not self.model.time_scales_are_known

    def band(self, forcing: Any, t: FloatArray, y: State) -> None:
        """None: fixed steps take no static friction above kinetic friction."""

    def step(self, forcing: Any, y: State, h: FloatArray, band: FloatArray | None) -> tuple[State, FloatArray | None]:
        """The state after a step of length `h` (s) and its error; see `contacts_step`."""
        return contacts_step(self.model, self.switch, forcing, y, h)


class InnerField(AnyField):
    """A system whose friction has inner states and is smooth by itself."""

    model: InnerStates

    def rates(self, forcing: Any, tau: FloatArray, y: State) -> State:
        return self.model.rates(forcing, tau, y)

    def elastic_slip(self, velocity: FloatArray, y: State) -> FloatArray:
        slips = jnp.stack([jnp.asarray(law.elastic_slip, velocity.dtype) for law in self.model.laws])
        return slips if self.model.contacts else slips[0] / self.model.slip_of_law(y)
