"""A system with several contacts under its excitation: the `SwitchedModel` that follows from its friction forces."""

import abc
import math
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.tree_util import Partial

from .._numerics.primal import without_derivatives
from .._numerics.runge_kutta import relative_error, runge_kutta_step
from .._numerics.small_matrices import linear_solve
from .._types import Array, BoolArray, ExplicitSolver, FloatArray, FloatScalar, State
from .contact_forces import Gain, Limits, acceleration, settled, solved
from .switched_model import NOISE_ULPS, Decision, F, Guard, Question, SwitchedModel, with_change

_NEWTON_STEPS = 2  # to relative velocity zero; where it is linear in the state, one is exact
_MOMENT_ULPS = 16  # the moment after which a contact that closes has a normal force
_CLOCK_ULPS = 4  # the round-off of times, in units in the last place
_TOUCH_ULPS = 8  # of a normal force: one that only touches zero neither opens nor closes its contact


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
    gain: Gain


class InMode(NamedTuple):
    """What the guards of a mode are made of.

    Attributes:
        velocity: Relative velocities, (contacts,).
        force: Friction forces against them, of sticks from the middle of their `stick_band` on, (contacts,).
        limit: What sticks can hold in the direction of these, (contacts,).
        normal: The normal forces that vary, in the order of `ContactsModel.varying`; None where none does.
    """

    velocity: FloatArray
    force: FloatArray
    limit: FloatArray
    normal: FloatArray | None


class ContactsModel(SwitchedModel[F]):
    """A system with several contacts: its rates without friction, and what friction in each contact adds.

    Slips and sticks are integrated by `solver`, whose error estimate shortens its steps. `fastest`: the highest angular
    frequency or decay rate of the system, rad/s.

    Where normal forces vary, the sign of each of them follows the modes of the contacts, as if it were the mode of one
    more contact that never sticks: +1 closed, -1 open. Its guard is the normal force, with this sign, and its round-off
    more. An open contact has no friction and nothing that ends its mode but its closing; the sign of its own mode means
    nothing.
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

    @property
    def time_scales_are_known(self) -> bool:
        """Whether all time scales are known, whatever the state: a step that suits them is short enough everywhere."""
        return False

    def jacobian(self, forcing: F, tau: FloatScalar, y: State) -> FloatArray:
        """The derivative of the rates without friction by the state, (numbers, numbers)."""
        flat, state = ravel_pytree(y)
        return jax.jacfwd(lambda values: ravel_pytree(self.instant(forcing, tau, state(values)).rates)[0])(flat)

    def implicit_changes(self, forcing: F, tau: FloatScalar, y: State, weight: FloatScalar, sides: State) -> State:
        """The changes x of the state with ``x - weight J x = side`` for each of the `sides`, arrays (..., sides).

        J: the `jacobian`.
        """
        jacobian, number = self.jacobian(forcing, tau, y), sides[0].shape[-1]
        matrix = jnp.eye(len(jacobian), dtype=jacobian.dtype) - weight * jacobian
        found = linear_solve(matrix, jnp.concatenate([side.reshape(-1, number) for side in sides]))
        ends = np.cumsum([side.size // number for side in sides])[:-1]
        return tuple(part.reshape(side.shape) for part, side in zip(jnp.split(found, ends), sides, strict=True))

    @property
    def varying(self) -> tuple[int, ...]:
        """The contacts whose normal forces vary."""
        return ()

    def varying_normal_forces(self, forcing: F, tau: FloatScalar, y: State) -> FloatArray:
        """The normal forces that vary, N; asked only where some do."""
        raise NotImplementedError("of models in which none does")

    def normal_forces_at(self, forcing: F, tau: FloatScalar, y: State) -> FloatArray:
        """The normal forces of all contacts, N; asked only where friction laws have inner states."""
        raise NotImplementedError("of models of friction laws with inner states")

    def normal_scale(self, forcing: F, y: State) -> FloatArray:
        """The sizes of the terms that add up to `varying_normal_forces`; asked only where some do."""
        raise NotImplementedError("of models in which none does")

    def _touch(self, forcing: F, y: State) -> FloatArray:
        """The round-off of the normal forces that vary, and 0 for the others, N, (contacts,)."""
        size = self.normal_scale(forcing, y)
        none, numbers = jnp.zeros(self.contacts or 0, size.dtype), jnp.finfo(size.dtype)
        # Far from a pulse that is a power of e there are no smaller numbers: it would close the contact by a jump.
        least = math.sqrt(float(numbers.tiny))
        return none.at[np.array(self.varying)].set(least + _TOUCH_ULPS * numbers.eps * size)

    def _own(self, of_modes: Array) -> Array:
        """Of the modes, those of the contacts."""
        return of_modes[: len(of_modes) - len(self.varying)]

    def _with_normal(self, of_contacts: Array, of_normal: Array | int | float) -> Array:
        """Modes, from those of the contacts and of the normal forces that vary."""
        if not self.varying:
            return of_contacts
        of_normal = jnp.broadcast_to(jnp.asarray(of_normal, of_contacts.dtype), (len(self.varying),))
        return jnp.concatenate([of_contacts, of_normal])

    def _is_open(self, sign: FloatArray) -> BoolArray:
        """Which contacts are open, (contacts,)."""
        own = jnp.zeros(self._own(sign).shape, bool)
        return own.at[np.array(self.varying)].set(sign[len(own) :] < 0) if self.varying else own

    def stuck(self, sign: FloatArray) -> BoolArray:
        is_open = self._is_open(sign)
        sticks = (self._own(sign) == 0) & ~is_open
        return jnp.append(sticks, jnp.all(sticks | is_open) & jnp.any(sticks))

    def _limits(self, forcing: F, tau: FloatScalar, y: State, velocity: FloatArray, sign: FloatArray) -> Limits:
        """The `limits`, zero in open contacts."""
        return self._closed(self.limits(forcing, tau, y, velocity), sign)

    def _closed(self, limits: Limits, sign: FloatArray) -> Limits:
        if not self.varying:
            return limits
        is_open = self._is_open(sign)
        return Limits(*(jnp.where(is_open, 0, force) for force in limits))

    def friction_forces(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> FloatArray:
        """The friction forces against the relative velocities in the mode `sign`, (contacts,)."""
        now, own = self.instant(forcing, tau, y), self._own(sign)
        return solved(now.gain, now.drift, self._limits(forcing, tau, y, now.velocity, sign).slip(own), own == 0)

    def rates(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        now, own = self.instant(forcing, tau, y), self._own(sign)
        slip = self._limits(forcing, tau, y, now.velocity, sign).slip(own)
        added = self.effect(forcing, tau, y, solved(now.gain, now.drift, slip, own == 0))
        return tuple(a + b for a, b in zip(now.rates, added, strict=True))

    def flow_and_error(
        self, forcing: F, y: State, h: FloatScalar, sign: FloatArray
    ) -> tuple[State, FloatScalar | None]:
        reached, error = runge_kutta_step(Partial(type(self).rates, self, forcing, sign=sign), y, h, solver=self.solver)
        gross = self._gross_changes(forcing, y, h)
        return self._held(forcing, h, reached, self._own(sign) == 0), _worst(relative_error(error, y, reached, gross))

    def relative_velocity(self, forcing: F, tau: FloatScalar, y: State) -> FloatArray:
        return self.instant(forcing, tau, y).velocity

    def guard(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> Guard:
        now, change = self.in_mode(forcing, tau, y, sign)
        own = self._own(sign)

        def of(now: InMode) -> FloatArray:
            if now.normal is not None:
                touch = self._touch(forcing, y)
                slips = jnp.where(self._is_open(sign), 1, own * now.velocity)
                contacts = jnp.where(own == 0, _bounded_guard(now.limit + touch, now.force), slips)
                return jnp.concatenate([contacts, sign[len(own) :] * now.normal + touch[np.array(self.varying)]])
            can = now.limit > 0
            share = jnp.where(can, now.force / jnp.where(can, now.limit, 1), 0)
            return jnp.where(own == 0, jnp.where(can, 1 - share * share, -1), own * now.velocity)

        guard, rate = jax.jvp(of, (now,), (change,))
        if now.normal is None or change.normal is None:
            return guard, rate
        # A normal force that is and stays zero: the contact stays open.
        stays = self._with_normal(jnp.zeros(len(own), bool), (now.normal == 0) & (change.normal == 0))
        return jnp.where(stays, 1, guard), rate

    def in_mode(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> tuple[InMode, InMode]:
        """What the guards of the mode `sign` are made of, and its time derivative."""

        def at(tau, y):
            now, own = self.instant(forcing, tau, y), self._own(sign)
            limits = self._limits(forcing, tau, y, now.velocity, sign)
            force = solved(now.gain, now.drift, limits.slip(own), own == 0)
            normal = self.varying_normal_forces(forcing, tau, y) if self.varying else None
            middle, limit = limits.band(force)
            return InMode(now.velocity, force - middle, limit, normal)

        return jax.jvp(at, (tau, y), (jnp.ones_like(tau), self.rates(forcing, tau, y, sign)))

    def guard_scale(self, forcing: F, y: State, sign: FloatArray) -> FloatArray:
        none, own = jnp.zeros((), y[0].dtype), self._own(sign)
        now = self.instant(forcing, none, y)
        friction = self.limits(forcing, none, y, now.velocity).largest
        rate = jnp.abs(now.drift) + jnp.abs(acceleration(now.gain, 0 * now.drift, friction))
        size = with_change(self.velocity_scale(forcing, y), rate, self.fastest, self.time(forcing))
        scale = jnp.where(own == 0, 2.0, size)
        return self._with_normal(scale, self.normal_scale(forcing, y)) if self.varying else scale

    def at_rest(self, forcing: F, y: State, times: float = 1.0) -> BoolArray:
        velocity = self.relative_velocity(forcing, jnp.zeros((), y[0].dtype), y)
        noise = self.noise(forcing, y, self._with_normal(jnp.ones_like(velocity), 1))
        return self._with_normal(jnp.abs(velocity) <= times * self._own(noise), 0)

    def slip_sign(self, forcing: F, y: State) -> FloatArray:
        slips = super().slip_sign(forcing, y)
        return self._with_normal(slips, self._normal_sign(forcing, y)) if self.varying else slips

    def _normal_sign(self, forcing: F, y: State) -> FloatArray:
        """The sign of each varying normal force right after `tau` 0; -1 where it stays zero."""
        none = jnp.zeros((), y[0].dtype)

        def moving(tau: FloatScalar, y: State) -> tuple[FloatScalar, State]:
            # Relative velocities may jump here, and the rates of the state with them: they are those of the base alone.
            return jnp.ones_like(tau), self.instant(forcing, tau, y).rates

        def with_rate(tau: FloatScalar, y: State) -> tuple[FloatArray, FloatArray]:
            return jax.jvp(partial(self.varying_normal_forces, forcing), (tau, y), moving(tau, y))

        (value, rate), (_, bend) = jax.jvp(with_rate, (none, y), moving(none, y))
        eps = jnp.finfo(y[0].dtype).eps
        noise = eps * (NOISE_ULPS * self.normal_scale(forcing, y) + _CLOCK_ULPS * self.time(forcing) * jnp.abs(rate))
        # Within this of its least value, a force with the curvature `bend` has at most the rate sqrt(4 noise bend).
        touches = rate * rate <= 4 * noise * jnp.abs(bend)
        decides = jnp.where(jnp.abs(value) > noise, value, jnp.where(touches, bend, rate))
        return jnp.where(decides > 0, 1, -1).astype(y[0].dtype)

    def after(
        self, forcing: F, y: State, sign: FloatArray, landed: BoolArray, ended: BoolArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        if not self.varying:
            return sign, landed, jnp.zeros_like(landed)
        own, before = self._own(sign), sign[len(self._own(sign)) :]
        of_normal = landed[len(own) :]
        now = jnp.where(ended, self._normal_sign(forcing, y), jnp.where(of_normal, -before, before))
        # What ends an open contact's mode is its closing alone; then all is asked anew.
        changed = jnp.zeros(own.shape, bool).at[np.array(self.varying)].set(now != before)
        contacts = self._own(landed) & ~changed
        return self._with_normal(own, now), self._with_normal(contacts, False), self._with_normal(changed, False)

    def at_base_velocity(self, forcing: F, y: State, resting: BoolArray) -> State:
        return self._held(forcing, jnp.zeros((), y[0].dtype), y, self._own(resting))

    def decided(self, forcing: F, y: State, question: Question) -> Decision:
        none = jnp.zeros((), y[0].dtype)
        y, modes = self.at_base_velocity(forcing, y, question.asked), question.sign
        question = Question(*map(self._own, question))
        now = self.instant(forcing, none, y)
        together = jnp.where(question.asked, 0, question.sign)
        _, rate = self.guard(forcing, none, y, self._with_normal(together, modes[len(together) :]))
        rate, eps = self._own(rate), jnp.finfo(y[0].dtype).eps
        moment, later = none, y
        if self.varying:  # a contact that closes has no normal force yet: what it can hold is seen a moment later
            moment = _MOMENT_ULPS * eps * (self.time(forcing) + jnp.minimum(1 / self.fastest, 1))
            later = tuple(value + moment * change for value, change in zip(y, now.rates, strict=True))
        limits = self._limits(forcing, moment, later, jnp.where(question.asked, 0, now.velocity), modes)
        if self.varying:  # nor does one whose normal force only touches zero let go of a stick that needs no friction
            touches = question.goes_on & ~self._is_open(modes) & (limits.largest == 0)
            limits = Limits(*(jnp.where(touches, self._touch(forcing, y), force) for force in limits))
        slack = eps * (NOISE_ULPS + _CLOCK_ULPS * self.time(forcing) * jnp.abs(rate))
        found = settled(now.gain, now.drift, limits, question, _finite(slack))
        guard = jnp.where(jnp.abs(found.share) < jnp.inf, 1 - found.share**2, -1)
        direction = jnp.where(found.sign != 0, found.sign, jnp.where(found.share > 0, 1, -1)).astype(guard.dtype)
        return Decision(
            self._with_normal(found.sign == 0, False),
            self._with_normal(direction, modes[len(together) :]),
            self._with_normal(guard, jnp.inf),
            self._with_normal(rate, 0),
        )

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
        return model.gross_changes(forcing, y, h, model.limits(forcing, none, y, now.velocity).largest)


def _bounded_guard(limit: FloatArray, force: FloatArray) -> FloatArray:
    """Positive while the `limit` exceeds the `force` of a stick, with the same zeros as ``1 - (force / limit)^2``.

    It stays between -1 and 1 where the limit becomes zero, and without a force it stays 1: the contact opens then.
    """
    total = limit * limit + force * force
    some = total > 0
    return jnp.where(some, (limit * limit - force * force) / jnp.where(some, total, 1), 1)


def _finite(values: FloatArray) -> FloatArray:
    """`values`, 0 where they are not finite."""
    return jnp.where(jnp.isfinite(values), values, 0)


def _worst(errors: FloatArray) -> FloatScalar:
    return errors if errors.ndim == 0 else jnp.max(errors)
