"""A system with several contacts under its excitation: the `SwitchedModel` that follows from its friction forces."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.tree_util import Partial

from .._numerics.primal import without_derivatives
from .._numerics.runge_kutta import relative_error, runge_kutta_step
from .._types import BoolArray, ExplicitSolver, FloatArray, FloatScalar, State
from .contact_forces import Limits, acceleration, settled, solved
from .switched_model import NOISE_ULPS, Decision, F, Guard, Question, SwitchedModel, with_change

_NEWTON_STEPS = 2  # to relative velocity zero; where it is linear in the state, one is exact
_CLOCK_ULPS = 4  # the round-off of times, in units in the last place


class Instant(NamedTuple):
    """The contacts at one instant, without friction in them.

    Attributes:
        rates: Of the state.
        velocity: Relative velocities, (contacts,).
        drift: Their rates, (contacts,).
        gain: What friction against the relative velocities takes from their rates (`contact_forces`).
    """

    rates: State
    velocity: FloatArray
    drift: FloatArray
    gain: FloatArray


class ContactsModel(SwitchedModel[F]):
    """A system with several contacts: its rates without friction, and what friction in each contact adds.

    Slips and sticks are integrated by `solver`, whose error estimate shortens its steps. `fastest`: the highest angular
    frequency or decay rate of the system, rad/s.
    """

    solver: ExplicitSolver
    fastest: eqx.AbstractVar[FloatScalar]

    @abc.abstractmethod
    def instant(self, forcing: F, tau: FloatScalar, y: State) -> Instant:
        """The contacts, without friction."""

    @abc.abstractmethod
    def effect(self, forcing: F, tau: FloatScalar, y: State, force: FloatArray) -> State:
        """What friction forces (contacts,) against the relative velocities add to the rates of the state."""

    @abc.abstractmethod
    def limits(self, forcing: F, tau: FloatScalar, y: State, velocity: FloatArray) -> Limits:
        """The forces that friction can exert at these relative velocities, (contacts,).

        Those of slips are continued smoothly to beyond the end of a slip: the last Runge-Kutta step may have stages
        there, and a kink would cost its order.
        """

    @abc.abstractmethod
    def velocity_scale(self, forcing: F, y: State) -> FloatArray:
        """The size of the terms that cancel in the relative velocities, (contacts,)."""

    @abc.abstractmethod
    def gross_changes(self, forcing: F, y: State, h: FloatScalar, friction: FloatArray) -> State:
        """The changes of the state in the time `h` by each term of its rates alone, for `relative_error`.

        `friction`: the largest friction forces, (contacts,).
        """

    def friction_forces(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> FloatArray:
        """The friction forces against the relative velocities in the mode `sign`, (contacts,)."""
        now = self.instant(forcing, tau, y)
        return solved(now.gain, now.drift, self.limits(forcing, tau, y, now.velocity).slip(sign), sign == 0)

    def rates(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        now = self.instant(forcing, tau, y)
        slip = self.limits(forcing, tau, y, now.velocity).slip(sign)
        added = self.effect(forcing, tau, y, solved(now.gain, now.drift, slip, sign == 0))
        return tuple(a + b for a, b in zip(now.rates, added, strict=True))

    def flow_and_error(
        self, forcing: F, y: State, h: FloatScalar, sign: FloatArray
    ) -> tuple[State, FloatScalar | None]:
        reached, error = runge_kutta_step(Partial(type(self).rates, self, forcing, sign=sign), y, h, solver=self.solver)
        gross = self._gross_changes(forcing, y, h)
        return self._held(forcing, h, reached, sign == 0), _worst(relative_error(error, y, reached, gross))

    def relative_velocity(self, forcing: F, tau: FloatScalar, y: State) -> FloatArray:
        return self.instant(forcing, tau, y).velocity

    def guard(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> Guard:
        rates = self.rates(forcing, tau, y, sign)

        def at(tau, y):
            now = self.instant(forcing, tau, y)
            limits = self.limits(forcing, tau, y, now.velocity)
            force = solved(now.gain, now.drift, limits.slip(sign), sign == 0)
            share = limits.share(force)
            possible = jnp.abs(share) < jnp.inf
            share = jnp.where(possible, share, 0)
            return jnp.where(sign == 0, jnp.where(possible, 1 - share * share, -1), sign * now.velocity)

        return jax.jvp(at, (tau, y), (jnp.ones_like(tau), rates))

    def guard_scale(self, forcing: F, y: State, sign: FloatArray) -> FloatArray:
        none = jnp.zeros((), y[0].dtype)
        now = self.instant(forcing, none, y)
        limits = self.limits(forcing, none, y, now.velocity)
        friction = jnp.maximum(limits.static_forward, limits.static_backward)
        rate = jnp.abs(now.drift) + jnp.abs(acceleration(now.gain, 0 * now.drift, friction))
        size = with_change(self.velocity_scale(forcing, y), rate, self.fastest, self.time(forcing))
        return jnp.where(sign == 0, 2.0, size)

    def at_base_velocity(self, forcing: F, y: State, resting: BoolArray) -> State:
        return self._held(forcing, jnp.zeros((), y[0].dtype), y, resting)

    def decided(self, forcing: F, y: State, question: Question) -> Decision:
        none = jnp.zeros((), y[0].dtype)
        y = self.at_base_velocity(forcing, y, question.asked)
        now = self.instant(forcing, none, y)
        limits = self.limits(forcing, none, y, jnp.where(question.asked, 0, now.velocity))
        together = jnp.where(question.asked, 0, question.sign)
        _, rate = self.guard(forcing, none, y, together)
        eps = jnp.finfo(y[0].dtype).eps
        slack = eps * (NOISE_ULPS + _CLOCK_ULPS * self.time(forcing) * jnp.abs(rate))
        found = settled(now.gain, now.drift, limits, question, _finite(slack))
        guard = jnp.where(jnp.abs(found.share) < jnp.inf, 1 - found.share**2, -1)
        direction = jnp.where(found.sign != 0, found.sign, jnp.where(found.share > 0, 1, -1))
        return Decision(found.sign == 0, direction.astype(guard.dtype), guard, rate)

    @abc.abstractmethod
    def time(self, forcing: F) -> FloatScalar:
        """The time at `tau` 0, s."""

    def _held(self, forcing: F, tau: FloatScalar, y: State, resting: BoolArray) -> State:
        """`y`, moved in the directions in which friction acts until what is `resting` has no relative velocity."""
        for _ in range(_NEWTON_STEPS):
            now = self.instant(forcing, tau, y)
            impulse = solved(now.gain, now.velocity, jnp.zeros_like(now.velocity), resting)
            y = tuple(a + b for a, b in zip(y, self.effect(forcing, tau, y, impulse), strict=True))
        return y

    def _gross_changes(self, forcing: F, y: State, h: FloatScalar) -> State:
        """The sum of the changes of each number of the state in the time `h` by each term of its rate alone."""
        model, forcing, y, h = without_derivatives((self, forcing, y, h))
        none = jnp.zeros_like(h)
        now = model.instant(forcing, none, y)
        limits = model.limits(forcing, none, y, now.velocity)
        return model.gross_changes(forcing, y, h, jnp.maximum(limits.static_forward, limits.static_backward))


def _finite(values: FloatArray) -> FloatArray:
    """`values`, 0 where they are not finite."""
    return jnp.where(jnp.isfinite(values), values, 0)


def _worst(errors: FloatArray) -> FloatScalar:
    return errors if errors.ndim == 0 else jnp.max(errors)
