"""Any `SwitchedSystem` as a switched model: slips and sticks are integrated, all switches follow from its rates.

With the relative velocity ``sigma(t, y, base)`` and ``rates = a + b friction``, friction changes ``sigma'`` by
``gain = grad sigma . b`` (negative). In a stick it is the share u of the kinetic force that keeps ``sigma' = 0``
(Filippov's sliding field), which lasts while ``|u| <= static_ratio``. Where friction has no effect on sigma
(``gain = 0``) nothing sticks.
"""

from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._types import BoolArray, FloatArray
from ..base_motion.pieces import added
from ..base_motion.smooth import Signal
from ..numerics.runge_kutta import runge_kutta_step
from ..systems.switched_system import Base, SwitchedSystem
from .switched_model import NOISE_ULPS, Pieces, State, SwitchedModel

_NEWTON_STEPS = 2  # to the relative velocity zero; where it is linear in the state, the first one arrives
_LEAST_GAIN = 64  # units in the last place of the terms of the gain; what is smaller has no effect


class GeneralInputs(NamedTuple):
    """From time `t` on: what of the base velocity comes in pieces, m/s, linear in time."""

    t: FloatArray
    base: FloatArray
    base_slope: FloatArray


class _Contact(NamedTuple):
    """How friction acts at one instant.

    `idle`, `push`: rates without friction, and what one unit of friction adds. `drift`: the rate of the relative
    velocity without friction. `grips`: whether friction acts on it; `per_gain`: by ``1 / gain``, 0 where it does not.
    """

    idle: State
    push: State
    drift: FloatArray
    grips: BoolArray
    gain: FloatArray
    per_gain: FloatArray

    @property
    def share(self) -> FloatArray:
        """The share of the kinetic friction that holds the relative velocity."""
        return -self.drift * self.per_gain


class GeneralModel(SwitchedModel):
    """A `SwitchedSystem` on a base that moves with ``smooth(t)`` plus what comes in pieces."""

    system: SwitchedSystem
    smooth: Signal | None
    solver: diffrax.AbstractERK

    def inputs(self, t: FloatArray, pieces: Pieces) -> GeneralInputs:
        return GeneralInputs(t, *added(t, pieces.base))

    def slip(self, inputs: GeneralInputs, y: State, h: FloatArray, sign: FloatArray) -> State:
        return self.slip_and_error(inputs, y, h, sign)[0]

    def slip_and_error(
        self, inputs: GeneralInputs, y: State, h: FloatArray, sign: FloatArray
    ) -> tuple[State, FloatArray]:
        return runge_kutta_step(_Slip(self, inputs, sign), y, h, solver=self.solver)

    def stick(self, inputs: GeneralInputs, y: State, h: FloatArray) -> State:
        return self.stick_and_error(inputs, y, h)[0]

    def stick_and_error(self, inputs: GeneralInputs, y: State, h: FloatArray) -> tuple[State, FloatArray]:
        held, error = runge_kutta_step(_Stick(self, inputs), y, h, solver=self.solver)
        return self._held(inputs, h, held), error

    def rates(self, inputs: GeneralInputs, tau: FloatArray, y: State, sign: FloatArray) -> State:
        slid, held = self.slip_rates(inputs, tau, y, sign), self.stick_rates(inputs, tau, y)
        return tuple(jnp.where(sign == 0, a, b) for a, b in zip(held, slid, strict=True))

    def slip_rates(self, inputs: GeneralInputs, tau: FloatArray, y: State, sign: FloatArray) -> State:
        """The rates of a slip of this sign, continued smoothly to where the slip is over.

        The stages of a Runge-Kutta step that ends an arc may lie slightly beyond. Friction that depends on the absolute
        relative velocity has a kink there, which would cost the order; so what lies beyond is told by the mirror image.
        """
        t, base, _ = self.base_at(inputs, tau)
        sigma, gradient = self._gradient(t, y, base)
        steep = sum(part * part for part in gradient)
        beyond = (sign * sigma < 0) & (steep > 0)
        way = jnp.where(beyond, sigma / jnp.where(beyond, steep, 1), 0)
        edge, image = (tuple(v - k * way * g for v, g in zip(y, gradient, strict=True)) for k in (1, 2))
        here, there = self._rates(t, edge, base, sign), self._rates(t, image, base, sign)
        return tuple(jnp.where(beyond, 2 * a - b, b) for a, b in zip(here, there, strict=True))

    def stick_rates(self, inputs: GeneralInputs, tau: FloatArray, y: State) -> State:
        """The sliding field: the rates under the friction that keeps the relative velocity."""
        contact = self._contact(*self.base_at(inputs, tau)[:2], y)
        return tuple(a + contact.share * b for a, b in zip(contact.idle, contact.push, strict=True))

    def at_rest(self, inputs: GeneralInputs, y: State) -> BoolArray:
        noise = NOISE_ULPS * jnp.finfo(y[0].dtype).eps * self.guard_scale(inputs, y, jnp.ones_like(y[0]))
        return jnp.abs(self._sigma_now(inputs, y)) <= noise

    def slip_sign(self, inputs: GeneralInputs, y: State) -> FloatArray:
        return jnp.sign(self._sigma_now(inputs, y))

    def guard(
        self, inputs: GeneralInputs, tau: FloatArray, y: State, sign: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        t, base, jerk = self.base_at(inputs, tau)
        base_rates = Base(base.acceleration, jerk)
        one = jnp.ones_like(t)

        slid = self.slip_rates(inputs, tau, y, sign)
        sigma, sigma_rate = jax.jvp(self._sigma, (t, y, base), (one, slid, base_rates))

        def share_of(t, y, base):
            contact = self._contact(t, base, y)
            ratio = jnp.asarray(self.system.static_ratio, t.dtype)
            return contact.share / ratio, contact.grips

        held = self.stick_rates(inputs, tau, y)
        share, share_rate, grips = jax.jvp(share_of, (t, y, base), (one, held, base_rates), has_aux=True)
        sticking = sign == 0
        stick, stick_rate = jnp.where(grips, 1 - share * share, -1), jnp.where(grips, -2 * share * share_rate, 0)
        return jnp.where(sticking, stick, sign * sigma), jnp.where(sticking, stick_rate, sign * sigma_rate)

    def guard_scale(self, inputs: GeneralInputs, y: State, sign: FloatArray) -> FloatArray:
        t, base, _ = self.base_at(inputs, jnp.zeros_like(y[0]))
        sigma, gradient = self._gradient(t, y, base)
        by_base = jax.grad(lambda v: self._sigma(t, y, Base(v, base.acceleration)))(base.velocity)
        slip = jnp.abs(sigma) + jnp.abs(by_base * base.velocity)
        slip = slip + sum(jnp.abs(part * value) for part, value in zip(gradient, y, strict=True))
        if self.system.shortest_time is not None:
            # What the forces change in the time of one radian: all of a velocity about a base at rest comes from that.
            contact = self._contact(t, base, y)
            change = sum(jnp.abs(part * rate) for part, rate in zip(gradient, contact.idle, strict=True))
            slip = slip + self.system.shortest_time / (2 * np.pi) * (change + jnp.abs(contact.gain))
        return jnp.where(sign == 0, 2.0, slip)

    def on_base(self, inputs: GeneralInputs, y: State) -> State:
        return self._held(inputs, jnp.zeros_like(y[0]), y)

    def can_stick(self, inputs: GeneralInputs, y: State) -> BoolArray:
        contact = self._contact(*self.base_at(inputs, jnp.zeros_like(y[0]))[:2], y)
        return contact.grips & (jnp.abs(contact.share) <= self.system.static_ratio)

    def release_sign(self, inputs: GeneralInputs, y: State) -> FloatArray:
        # What drives the relative velocity without friction is more than friction can hold.
        contact = self._contact(*self.base_at(inputs, jnp.zeros_like(y[0]))[:2], y)
        return jnp.where(contact.drift > 0, 1, -1).astype(y[0].dtype)

    def base_at(self, inputs: GeneralInputs, tau: FloatArray) -> tuple[FloatArray, Base, FloatArray]:
        """The time, the base and the rate of its acceleration, `tau` later."""
        t = inputs.t + tau
        velocity, acceleration = inputs.base + tau * inputs.base_slope, inputs.base_slope
        if self.smooth is None:
            return t, Base(velocity, acceleration), jnp.zeros_like(t)
        velocity, acceleration = velocity + self.smooth.value(t), acceleration + self.smooth.rate(t)
        return t, Base(velocity, acceleration), jnp.asarray(self.smooth.curvature(t), t.dtype)

    def _rates(self, t: FloatArray, y: State, base: Base, friction: FloatArray) -> State:
        return tuple(jnp.asarray(rate, t.dtype) for rate in self.system.rates(t, y, base, friction))

    def _sigma(self, t: FloatArray, y: State, base: Base) -> FloatArray:
        return jnp.asarray(self.system.relative_velocity(t, y, base), t.dtype)

    def _sigma_now(self, inputs: GeneralInputs, y: State) -> FloatArray:
        t, base, _ = self.base_at(inputs, jnp.zeros_like(y[0]))
        return self._sigma(t, y, base)

    def _gradient(self, t: FloatArray, y: State, base: Base) -> tuple[FloatArray, State]:
        """The relative velocity and its gradient with respect to the state."""
        return jax.value_and_grad(lambda y: self._sigma(t, y, base))(y)

    def _contact(self, t: FloatArray, base: Base, y: State) -> _Contact:
        # Rates are affine in friction: their derivative is what friction adds, without cancellation.
        idle, push = jax.jvp(
            lambda friction: self._rates(t, y, base, friction), (jnp.zeros_like(t),), (jnp.ones_like(t),)
        )
        _, gradient = self._gradient(t, y, base)
        # The relative velocity depends on the base's velocity only, whose rate is its acceleration.
        moving = (jnp.ones_like(t), idle, Base(base.acceleration, jnp.zeros_like(t)))
        _, drift = jax.jvp(self._sigma, (t, y, base), moving)
        terms = [part * rate for part, rate in zip(gradient, push, strict=True)]
        gain, size = sum(terms, jnp.zeros_like(t)), sum(map(jnp.abs, terms), jnp.zeros_like(t))
        grips = gain < -_LEAST_GAIN * jnp.finfo(t.dtype).eps * size
        per_gain = jnp.where(grips, 1 / jnp.where(grips, gain, -1), 0)
        return _Contact(idle, push, drift, grips, gain, per_gain)

    def _held(self, inputs: GeneralInputs, tau: FloatArray, y: State) -> State:
        """`y`, moved the way friction acts until the relative velocity is zero."""
        t, base, _ = self.base_at(inputs, tau)
        for _ in range(_NEWTON_STEPS):
            contact = self._contact(t, base, y)
            way = self._sigma(t, y, base) * contact.per_gain
            y = tuple(value - way * push for value, push in zip(y, contact.push, strict=True))
        return y


class _Slip(eqx.Module):
    """The rates of a slip, a function of the time since the step began and of the state."""

    model: GeneralModel
    inputs: GeneralInputs
    sign: FloatArray

    def __call__(self, tau: FloatArray, state: State) -> State:
        return self.model.slip_rates(self.inputs, tau, state, self.sign)


class _Stick(eqx.Module):
    """The rates of a stick, a function of the time since the step began and of the state."""

    model: GeneralModel
    inputs: GeneralInputs

    def __call__(self, tau: FloatArray, state: State) -> State:
        return self.model.stick_rates(self.inputs, tau, state)
