"""A system with one contact under its excitation: the `SwitchedModel` that follows from its slips and its sticks."""

import abc

import jax.numpy as jnp

from .._types import BoolArray, BoolScalar, FloatArray, FloatScalar, State
from .friction import FrictionLaw
from .switched_model import Decision, F, FloatPair, Question, SwitchedModel, chosen_state


class OneContactModel(SwitchedModel[F]):
    """A system with one contact under its excitation.

    Exact dynamics uses its slips, sticks and guards; regularised dynamics its rates under any friction force and the
    relative velocity.
    """

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

    def flow_and_error(
        self, forcing: F, y: State, h: FloatScalar, sign: FloatArray
    ) -> tuple[State, FloatScalar | None]:
        """The result of `flow`, and its relative error; None where the step is known to be short enough."""
        sticking = sign == 0
        # Both modes are computed, one is chosen. A slip over a stick's long step may overflow: it gets no length.
        slid, error = self.slip_and_error(forcing, y, jnp.where(sticking, 0, h), sign)
        held, error_held = self.stick_and_error(forcing, y, h)
        return chosen_state(sticking, held, slid), _chosen(sticking, error_held, error)

    @abc.abstractmethod
    def on_base(self, forcing: F, y: State) -> State:
        """The state at `tau` 0 with the relative velocity made exactly zero."""

    @abc.abstractmethod
    def can_stick(self, forcing: F, y: State) -> BoolScalar:
        """Whether friction can hold a stick at `tau` 0, the relative velocity being zero."""

    @abc.abstractmethod
    def release_sign(self, forcing: F, y: State) -> FloatScalar:
        """The sign of the relative velocity after a release at `tau` 0."""

    def at_base_velocity(self, forcing: F, y: State, resting: BoolArray) -> State:
        """The state at `tau` 0 with the relative velocity made exactly zero where contacts are `resting`."""
        return chosen_state(resting, self.on_base(forcing, y), y)

    def decided(self, forcing: F, y: State, question: Question) -> Decision:
        """What friction does at `tau` 0 with the contact, which asks nobody else."""
        on_base = self.on_base(forcing, y)
        none = jnp.zeros_like(on_base[0])
        guard, rate = self.guard(forcing, none, on_base, none)
        return Decision(self.can_stick(forcing, on_base), self.release_sign(forcing, on_base), guard, rate)

    @property
    def time_scales_are_known(self) -> bool:
        """Whether all time scales are known, whatever the state: a step that suits them is short enough everywhere."""
        return False

    @property
    @abc.abstractmethod
    def friction(self) -> FrictionLaw:
        """The friction law of the contact."""

    def friction_at(self, y: State) -> FrictionLaw:
        """The friction law by the `relative_velocity` in the state `y`, of which it may depend on the position."""
        return self.friction

    def to_inner_law(self, y: State) -> FloatPair | tuple[float, float]:
        """What a law with an inner state, of this contact, takes and gives, by what the engines do.

        Returns:
            Its velocity over the `relative_velocity`, and the coefficient of `rates_under` over its coefficient.
        """
        return 1.0, 1.0

    @abc.abstractmethod
    def rates_under(self, forcing: F, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        """The time derivative of the state under this signed friction coefficient; affine in it."""

    def slip_direction(self, y: State, sign: FloatScalar) -> FloatScalar:
        """The sign that the friction coefficient of `rates_under` has in a slip of this `sign`."""
        return sign

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


def _chosen(first: BoolArray, one: FloatArray | None, other: FloatArray | None) -> FloatArray | None:
    """One of two error estimates; None stands for 0, and both None give None."""
    if one is None and other is None:
        return None
    return jnp.where(first, 0 if one is None else one, 0 if other is None else other)
