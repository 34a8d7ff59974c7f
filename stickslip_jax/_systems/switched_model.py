"""A system under its excitation, as the engines integrate it: how it slips and sticks, and when each ends.

Exact dynamics uses the slips, the sticks and the guards; regularised dynamics the rates under any friction force and
the relative velocity.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from .._excitation.segments import Segment
from .._types import BoolArray, FloatArray, State
from .friction import FrictionLaw

NOISE_ULPS = 64  # the round-off of the guard, in units in the last place of its scale


class Segments(NamedTuple):
    """The present segments of the piecewise-linear parts of base velocity, ground acceleration and force."""

    base: tuple[Segment, ...]
    ground: tuple[Segment, ...]
    force: tuple[Segment, ...]


class Base(NamedTuple):
    """The base at one instant: velocity in m/s (or rad/s) and acceleration; zeros for a base at rest."""

    velocity: FloatArray
    acceleration: FloatArray


class SwitchedModel(eqx.Module):
    """A system under its excitation. `inputs` is what `inputs(t, segments)` returned, `tau` (s) the time since that t.

    `steps_may_be_long`: whether `slip` and `stick` are as exact over a long time as over a short step.
    """

    steps_may_be_long: ClassVar[bool] = False

    @abc.abstractmethod
    def inputs(self, t: FloatArray, segments: Segments) -> Any:
        """The excitation from time t (s) on, until a segment ends."""

    @abc.abstractmethod
    def slip(self, inputs: Any, y: State, h: FloatArray, sign: FloatArray) -> State:
        """The state after a slip of duration `h` (s) with relative velocity of this `sign`."""

    def slip_and_error(self, inputs: Any, y: State, h: FloatArray, sign: FloatArray) -> tuple[State, FloatArray | None]:
        """The result of `slip`, and its relative error; None where the step is known to be short enough."""
        return self.slip(inputs, y, h, sign), None

    @abc.abstractmethod
    def stick(self, inputs: Any, y: State, h: FloatArray) -> State:
        """The state after a stick of duration `h` (s)."""

    def stick_and_error(self, inputs: Any, y: State, h: FloatArray) -> tuple[State, FloatArray | None]:
        """The result of `stick`, and its relative error or None."""
        return self.stick(inputs, y, h), None

    @abc.abstractmethod
    def rates(self, inputs: Any, tau: FloatArray, y: State, sign: FloatArray) -> State:
        """The time derivative of the state; `sign` is 0 in a stick."""

    @abc.abstractmethod
    def at_rest(self, inputs: Any, y: State) -> BoolArray:
        """Whether the relative velocity is zero, but for round-off, at `tau` 0."""

    @abc.abstractmethod
    def slip_sign(self, inputs: Any, y: State) -> FloatArray:
        """The sign of the relative velocity at and right after `tau` 0, for a state that is not `at_rest`."""

    @abc.abstractmethod
    def guard(self, inputs: Any, tau: FloatArray, y: State, sign: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Guard of the mode, positive while the stick or slip lasts, and its time derivative.

        In a slip: ``sign`` times the relative velocity. In a stick (`sign` 0): ``1 - (f / f_max)^2``, where f is the
        friction force needed and f_max the largest one.
        """

    @abc.abstractmethod
    def guard_scale(self, inputs: Any, y: State, sign: FloatArray) -> FloatArray:
        """The size of the terms that cancel in the guard: the scale of its round-off."""

    @abc.abstractmethod
    def on_base(self, inputs: Any, y: State) -> State:
        """The state at `tau` 0 with the relative velocity made exactly zero."""

    @abc.abstractmethod
    def can_stick(self, inputs: Any, y: State) -> BoolArray:
        """Whether friction can hold a stick at `tau` 0, the relative velocity being zero."""

    @abc.abstractmethod
    def release_sign(self, inputs: Any, y: State) -> FloatArray:
        """The sign of the relative velocity after a release at `tau` 0."""

    def step_limit(self, age: FloatArray, step: FloatArray, y: State, sign: FloatArray) -> FloatArray:
        """The longest step to take from `y`, `age` (s) after the last event at rest.

        Transients may need shorter steps at first, and a stick may allow longer ones.
        """
        return step

    @property
    @abc.abstractmethod
    def friction(self) -> FrictionLaw:
        """The friction law of the contact."""

    @abc.abstractmethod
    def rates_under(self, inputs: Any, tau: FloatArray, y: State, grip: FloatArray) -> State:
        """The time derivative of the state under the signed friction coefficient `grip`; affine in it."""

    def grip_of(self, y: State, sign: FloatArray) -> FloatArray:
        """The sign that the friction coefficient of `rates_under` has in a slip of this `sign`."""
        return sign

    @abc.abstractmethod
    def relative_velocity(self, inputs: Any, tau: FloatArray, y: State) -> FloatArray:
        """The relative velocity, m/s."""

    def holding(self, inputs: Any, tau: FloatArray, y: State) -> FloatArray:
        """The signed friction coefficient that keeps the relative velocity constant; 0 where friction has no effect."""
        free, gripped = (
            self.relative_acceleration(inputs, tau, y, self.rates_under(inputs, tau, y, jnp.full_like(tau, grip)))
            for grip in (0.0, 1.0)
        )
        gain = gripped - free
        return jnp.where(gain != 0, -free / jnp.where(gain != 0, gain, 1), 0)

    @abc.abstractmethod
    def relative_acceleration(self, inputs: Any, tau: FloatArray, y: State, rates: State) -> FloatArray:
        """Its time derivative, where the state changes with `rates`."""
