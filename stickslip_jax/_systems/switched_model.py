"""A system under its excitation, as the engines integrate it: how it slips and sticks, and when each ends.

Exact dynamics uses the slips, the sticks and the guards; regularised dynamics the rates under any friction force and
the relative velocity. All arrays are scalars, those of one trajectory: the engines make batches with ``jax.vmap``.
"""

import abc
from typing import ClassVar, Generic, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax.numpy as jnp

from .._excitation.segments import Segment
from .._excitation.smooth import Signal
from .._types import BoolScalar, FloatScalar, State
from .friction import FrictionLaw

NOISE_ULPS = 64  # the round-off of the guard, in units in the last place of its scale

F = TypeVar("F")
"""The forcing of a model: its excitation from the time a step begins until a segment ends."""


FloatPair: TypeAlias = tuple[FloatScalar, FloatScalar]


class Segments(NamedTuple):
    """The present segments of the piecewise-linear parts of base velocity, ground acceleration and force."""

    base: tuple[Segment, ...]
    ground: tuple[Segment, ...]
    force: tuple[Segment, ...]


class Base(NamedTuple):
    """The base at one instant: velocity in m/s (or rad/s) and acceleration; zeros for a base at rest."""

    velocity: FloatScalar
    acceleration: FloatScalar


def base_motion(
    smooth: Signal | None, t: FloatScalar, velocity: FloatScalar, slope: FloatScalar, tau: FloatScalar
) -> Base:
    """The base `tau` (s) later than `t`, of velocity ``velocity + slope tau + smooth(t + tau)``."""
    velocity = velocity + tau * slope
    if smooth is None:
        return Base(velocity, slope)
    return Base(velocity + smooth.value(t + tau), slope + smooth.rate(t + tau))


class SwitchedModel(eqx.Module, Generic[F]):
    """A system under its excitation.

    In its methods `forcing` is what ``forcing(t, segments)`` returned, and `tau` (s) the time since that t.

    Attributes:
        steps_may_be_long: Whether `slip` and `stick` are as exact over a long time as over a short step.
    """

    steps_may_be_long: ClassVar[bool] = False

    @abc.abstractmethod
    def forcing(self, t: FloatScalar, segments: Segments) -> F:
        """The excitation from time t (s) on, until a segment ends."""

    @abc.abstractmethod
    def slip(self, forcing: F, y: State, h: FloatScalar, sign: FloatScalar) -> State:
        """The state after a slip of duration `h` (s) with relative velocity of this `sign`."""

    def slip_and_error(
        self, forcing: F, y: State, h: FloatScalar, sign: FloatScalar
    ) -> tuple[State, FloatScalar | None]:
        """The result of `slip`, and its relative error; None where the step is known to be short enough."""
        return self.slip(forcing, y, h, sign), None

    @abc.abstractmethod
    def stick(self, forcing: F, y: State, h: FloatScalar) -> State:
        """The state after a stick of duration `h` (s)."""

    def stick_and_error(self, forcing: F, y: State, h: FloatScalar) -> tuple[State, FloatScalar | None]:
        """The result of `stick`, and its relative error or None."""
        return self.stick(forcing, y, h), None

    @abc.abstractmethod
    def rates(self, forcing: F, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        """The time derivative of the state; `sign` is 0 in a stick."""

    def at_rest(self, forcing: F, y: State) -> BoolScalar:
        """Whether the relative velocity is zero, but for round-off, at `tau` 0."""
        return jnp.abs(self.relative_velocity(forcing, jnp.zeros_like(y[0]), y)) <= self.noise(forcing, y)

    def noise(self, forcing: F, y: State) -> FloatScalar:
        """The round-off of the guard of a slip at `tau` 0."""
        return NOISE_ULPS * jnp.finfo(y[0].dtype).eps * self.guard_scale(forcing, y, jnp.ones_like(y[0]))

    def slip_sign(self, forcing: F, y: State) -> FloatScalar:
        """The sign of the relative velocity at and right after `tau` 0, for a state that is not `at_rest`."""
        return jnp.sign(self.relative_velocity(forcing, jnp.zeros_like(y[0]), y))

    @abc.abstractmethod
    def guard(self, forcing: F, tau: FloatScalar, y: State, sign: FloatScalar) -> FloatPair:
        """Guard of the mode, positive while the stick or slip lasts, and its time derivative.

        In a slip: ``sign`` times the relative velocity. In a stick (`sign` 0): ``1 - (f / f_max)^2``, where f is the
        friction force needed and f_max the largest one.
        """

    @abc.abstractmethod
    def guard_scale(self, forcing: F, y: State, sign: FloatScalar) -> FloatScalar:
        """The size of the terms that cancel in the guard: the scale of its round-off."""

    @abc.abstractmethod
    def on_base(self, forcing: F, y: State) -> State:
        """The state at `tau` 0 with the relative velocity made exactly zero."""

    @abc.abstractmethod
    def can_stick(self, forcing: F, y: State) -> BoolScalar:
        """Whether friction can hold a stick at `tau` 0, the relative velocity being zero."""

    @abc.abstractmethod
    def release_sign(self, forcing: F, y: State) -> FloatScalar:
        """The sign of the relative velocity after a release at `tau` 0."""

    def step_limit(self, age: FloatScalar, step: FloatScalar, y: State, sign: FloatScalar) -> FloatScalar:
        """The longest step to take from `y`, `age` (s) after the last event at rest.

        Transients may need shorter steps at first, and a stick may allow longer ones.
        """
        return step

    @property
    def time_scales_are_known(self) -> bool:
        """Whether all time scales are known, whatever the state: a step that suits them is short enough everywhere."""
        return False

    @property
    @abc.abstractmethod
    def friction(self) -> FrictionLaw:
        """The friction law of the contact."""

    @abc.abstractmethod
    def rates_under(self, forcing: F, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        """The time derivative of the state under this signed friction coefficient; affine in it."""

    def slip_direction(self, y: State, sign: FloatScalar) -> FloatScalar:
        """The sign that the friction coefficient of `rates_under` has in a slip of this `sign`."""
        return sign

    @abc.abstractmethod
    def relative_velocity(self, forcing: F, tau: FloatScalar, y: State) -> FloatScalar:
        """The relative velocity, m/s."""

    @abc.abstractmethod
    def relative_acceleration(self, forcing: F, tau: FloatScalar, y: State, rates: State) -> FloatScalar:
        """The time derivative of the relative velocity, where the state changes with `rates`, m/s^2."""

    def effect_of_friction(self, forcing: F, tau: FloatScalar, y: State) -> FloatPair:
        """The relative acceleration without friction, and what a friction coefficient of 1 adds to it, m/s^2."""
        free, under_one = (
            self.relative_acceleration(forcing, tau, y, self.rates_under(forcing, tau, y, jnp.full_like(tau, number)))
            for number in (0.0, 1.0)
        )
        return free, under_one - free

    def holding_coefficient(self, forcing: F, tau: FloatScalar, y: State) -> FloatScalar:
        """The signed friction coefficient that keeps the relative velocity constant; 0 where friction has no effect."""
        free, gain = self.effect_of_friction(forcing, tau, y)
        return jnp.where(gain != 0, -free / jnp.where(gain != 0, gain, 1), 0)
