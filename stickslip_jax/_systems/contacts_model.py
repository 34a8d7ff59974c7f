"""Friction forces in several contacts at once, and the model of a system that has them."""

import abc
import math
from functools import partial
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.tree_util import Partial
from jaxtyping import Array

from .._foundation.types import (
    BoolArray,
    BoolScalar,
    ExplicitSolver,
    FloatArray,
    FloatScalar,
    IntArray,
    State,
)
from .._numerics.derivatives import without_derivatives
from .._numerics.matrices import linear_solve, times
from .._numerics.steps import relative_error, runge_kutta_step
from .switched_model import NOISE_ULPS, Decision, Forcing, Guard, Question, SwitchedModel, with_change

# The friction forces in several contacts at once, and which of the contacts they can hold.
#
# With the relative velocities g (contacts,), friction forces f against them and ``g' = drift - gain f``: in a slip f is
# the kinetic force with the sign of g; in sticks f is what keeps ``g' = 0``. `gain` is a matrix (contacts, contacts),
# for a mechanical system ``W M^-1 W^T`` with the directions W of the contacts; or, where friction in one contact has no
# effect on the others, its diagonal (contacts,).
#
# Which contacts at rest are held is a linear complementarity problem with bounds on both sides. Where static and
# kinetic friction are equal and the gain is positive definite it has one solution (Stewart and Trinkle 1996; Pfeiffer
# and Glocker 1996). Where static friction is larger the rule is one after the other: what stuck holds up to its static
# limit, the stick that needs the largest share of its limit breaks first and falls to kinetic friction, and then the
# rest are asked again. What has broken and is driven back by the others is held again by at most its kinetic friction;
# that is settled among all that have broken before the rest are asked.


_PASSES = 3  # for each contact: how often one may break, or be held again


class Uncoupled(NamedTuple):
    """The gain of contacts that have no effect on each other: its `diagonal`, and the `inverse` of that, 0 where a
    contact couples nothing, (contacts,).
    """

    diagonal: FloatArray
    inverse: FloatArray

    @classmethod
    def of(cls, diagonal: FloatArray) -> "Uncoupled":
        """From the diagonal."""
        couples = diagonal > 0
        return cls(diagonal, jnp.where(couples, 1 / jnp.where(couples, diagonal, 1), 0))


Gain: TypeAlias = FloatArray | Uncoupled


def acceleration(gain: Gain, drift: FloatArray, force: FloatArray) -> FloatArray:
    """The rates of the relative velocities under these friction forces."""
    return drift - (gain.diagonal * force if isinstance(gain, Uncoupled) else times(gain, force))


def solved(gain: Gain, wanted: FloatArray, given: FloatArray, chosen: BoolArray) -> FloatArray:
    """The forces with ``gain force = wanted`` in the `chosen` contacts; `given` ones in the others.

    A gain of zero, of a contact that couples nothing, gives no force.
    """
    if isinstance(gain, Uncoupled):
        return jnp.where(chosen, wanted * gain.inverse, given)
    both = chosen[:, None] & chosen[None, :]
    matrix = jnp.where(both, gain, jnp.eye(len(chosen), dtype=gain.dtype))
    others = jnp.where(chosen, 0, given)
    target = jnp.where(chosen, wanted - times(gain, others), given)
    return linear_solve(matrix, target)


def holding(gain: Gain, sticks: BoolArray) -> FloatArray:
    """The matrix of the forces that `sticks` need for each unit of `drift`: the inverse of their gain, zero elsewhere.

    Where contacts have no effect on each other, its diagonal.
    """
    if isinstance(gain, Uncoupled):
        return jnp.where(sticks, gain.inverse, 0)
    both = sticks[:, None] & sticks[None, :]
    one = jnp.eye(len(sticks), dtype=gain.dtype)
    return jnp.where(both, linear_solve(jnp.where(both, gain, one), one), 0)


class Limits(NamedTuple):
    """The friction forces (contacts,) that are possible: in slips forward and backward, and at most in sticks that
    would break into them. All are zero or positive.
    """

    forward: FloatArray
    backward: FloatArray
    static_forward: FloatArray
    static_backward: FloatArray

    def slip(self, sign: FloatArray) -> FloatArray:
        """The force in a slip of this sign; 0 for the sign 0."""
        return jnp.where(sign > 0, sign * self.forward, jnp.where(sign < 0, sign * self.backward, 0))

    @property
    def largest(self) -> FloatArray:
        """The largest friction forces in sticks; of normal forces that are negative, as if they were positive."""
        return jnp.maximum(jnp.abs(self.static_forward), jnp.abs(self.static_backward))

    def static(self, force: FloatArray) -> FloatArray:
        """The limit of a stick that needs this `force`."""
        return jnp.where(force > 0, self.static_forward, self.static_backward)

    def band(self, force: FloatArray, broken: BoolArray | bool = False) -> tuple[FloatArray, FloatArray]:
        """The `stick_band` of sticks that need this `force`.

        `broken`: what kinetic friction must hold, its stick being over.
        """
        forward = jnp.where(broken, self.forward, self.static_forward)
        backward = jnp.where(broken, self.backward, self.static_backward)
        return stick_band(forward, backward, jnp.where(force > 0, forward, backward))

    def share(self, force: FloatArray, broken: BoolArray | bool = False) -> FloatArray:
        """The `force` that a stick needs, over the largest one in its direction; infinite where none is possible.

        Both from the middle of the `band` on.
        """
        middle, limit = self.band(force, broken)
        can = limit > 0
        return jnp.where(can, (force - middle) / jnp.where(can, limit, 1), jnp.inf)


def stick_band(forward: FloatArray, backward: FloatArray, limit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The middle of the friction forces that a stick can have, and how far they reach from there.

    `forward`, `backward`: the largest in sticks that would break into such slips. Where both have friction the middle
    is 0, and the `limit` how far they reach in the direction that is asked. Where only one has, forces end at 0, and
    from there round-off would decide into which slip a stick breaks.
    """
    is_one_sided = (forward == 0) != (backward == 0)
    middle, half_width = (forward - backward) / 2, (forward + backward) / 2
    return jnp.where(is_one_sided, middle, 0), jnp.where(is_one_sided, half_width, limit)


class Settled(NamedTuple):
    """The mode `sign` (contacts,) of every contact; of those asked, the `share` of its limit that a stick needs."""

    sign: FloatArray
    share: FloatArray


def settled(gain: Gain, drift: FloatArray, limits: Limits, question: Question, slack: FloatArray) -> Settled:
    """Which contacts that are asked friction holds.

    `slack`: by how much the share of a stick that goes on may exceed 1: round-off at the limit.
    """
    asked = question.asked

    def shares(sign: FloatArray, broken: BoolArray | bool = False) -> tuple[FloatArray, FloatArray, FloatArray]:
        """All forces, into which slips they drive sticks, and their shares of what friction can hold."""
        force = solved(gain, drift, limits.slip(sign), asked & (sign == 0))
        driven = jnp.where(force > limits.band(force, broken)[0], 1, -1).astype(drift.dtype)
        return force, driven, limits.share(force, broken)

    # What has just been released slips in the direction in which it is driven.
    start = jnp.where(asked, 0, question.sign)
    _, driven, share = shares(start)
    start = jnp.where(question.released, driven, start)
    allowed = 1 + jnp.where(question.goes_on, slack, 0)
    if isinstance(gain, Uncoupled):
        breaks = asked & ~question.released & (jnp.abs(share) > allowed)
        return Settled(jnp.where(breaks, driven, start), share)

    def again(state: tuple[FloatArray, FloatArray, BoolArray, IntArray, BoolScalar]):
        sign, decisive, broken, passes, _ = state
        force, driven, share = shares(sign, broken)
        held, slips = asked & (sign == 0), asked & (sign != 0) & ~question.released
        excess = jnp.where(held, jnp.abs(share) - allowed, -jnp.inf)
        # A contact that others drive back is held again: its friction alone would reverse it.
        back = jnp.where(slips, -sign * acceleration(gain, drift, force), -jnp.inf)
        returns = (back == jnp.max(back)) & (back > 0)
        # What has broken settles at kinetic friction before anything else is asked whether it breaks too.
        excess = jnp.where(jnp.any(broken & (excess > 0)) & ~broken, -jnp.inf, excess)
        breaks = (excess == jnp.max(excess)) & (excess > 0) & ~jnp.any(returns)
        decisive = jnp.where(held, share, decisive)
        new = jnp.where(breaks, driven, jnp.where(returns, 0, sign)).astype(sign.dtype)
        return new, decisive, broken | breaks, passes + 1, jnp.any(breaks | returns)

    most = _PASSES * len(drift) + 1
    first = (start, share, jnp.zeros_like(asked), jnp.zeros((), jnp.int32), jnp.any(asked))
    sign, share, *_ = lax.while_loop(lambda s: s[4] & (s[3] < most), again, first)
    return Settled(sign, share)


# A system with several contacts under its excitation: the `SwitchedModel` that follows from its friction forces.


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
        gain: What friction against the relative velocities takes from their rates (see above).
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


class Sliders(NamedTuple):
    """Contacts behind springs: sliders without mass, each at the end of its spring. All (contacts,).

    In a stick the spring follows the relative velocity of the contact. In a slip its force is the limit, and the slider
    moves with what the spring does not take up: none of the relative velocity where the limit is constant. So friction
    acts through the springs alone, whose forces are known from the state in every mode.

    Attributes:
        force: Of the springs, N.
        limits: The friction forces that are possible.
        way: The direction in which each slips or would slip.
        velocity: Of the sliders in a slip, m/s.
        is_at_limit: Whether the force is that of a slip this `way`, but for round-off.
    """

    force: FloatArray
    limits: Limits
    way: FloatArray
    velocity: FloatArray
    is_at_limit: BoolArray

    @property
    def moves_on(self) -> BoolArray:
        """Whether they slip from here on."""
        return self.is_at_limit & (self.way * self.velocity > 0)


class ContactsModel(SwitchedModel[Forcing]):
    """A system with several contacts: its rates without friction, and what friction in each contact adds.

    Slips and sticks are integrated by `solver`, whose error estimate shortens its steps.

    Where normal forces vary, the sign of each of them follows the modes of the contacts, as if it were the mode of one
    more contact that never sticks: +1 closed, -1 open. Its guard is the normal force, with this sign, and its round-off
    more. An open contact has no friction and nothing that ends its mode but its closing; the sign of its own mode means
    nothing.
    """

    solver: ExplicitSolver

    @property
    def elastic(self) -> np.ndarray:
        """Which contacts are `Sliders`, (contacts,)."""
        return np.zeros(self.contacts or 0, bool)

    def softness(self, y: State) -> FloatArray:
        """What an elongation is of a spring's force, (contacts,), 0 where there is none; asked only where some are."""
        raise NotImplementedError("of models that have sliders")

    def elongations(self, y: State) -> FloatArray:
        """Of the springs in front of contacts, 0 of the other contacts, (contacts,)."""
        raise NotImplementedError("of models that have sliders")

    def following(self, forcing: Forcing, tau: FloatScalar, y: State, way: FloatArray) -> FloatArray:
        """The rates of the elongations in slips `way`, in which the springs' forces are the limits, m/s."""
        raise NotImplementedError("of models that have sliders")

    @property
    def has_sliders(self) -> bool:
        return bool(np.any(self.elastic))

    def sliders(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatArray | None = None) -> "Sliders":
        """Those of the `elastic` contacts; in the modes `sign`, or right after `tau` if these are not known."""
        softness, velocity = self.softness(y), self.relative_velocity(forcing, tau, y)
        force = jnp.where(softness > 0, self.elongations(y) / jnp.where(softness > 0, softness, 1), 0)
        limits = self.limits(forcing, tau, y, velocity)
        way = self._own(sign) if sign is not None else jnp.sign(jnp.where(force == 0, velocity, force))
        reach = limits.slip(way)
        noise = NOISE_ULPS * jnp.finfo(force.dtype).eps * jnp.abs(reach)
        if self.varying:
            noise = noise + self._touch(forcing, y)
        is_at_limit = way * (force - reach) >= -noise
        return Sliders(force, limits, way, velocity - self.following(forcing, tau, y, way), is_at_limit)

    def _elongating(self, stretching: FloatArray, following: FloatArray, sign: FloatArray) -> FloatArray:
        """The rates of the elongations, of those in sticks and in slips."""
        return jnp.where(self._is_open(sign), 0, jnp.where(self._own(sign) == 0, stretching, following))

    def _at_limits(self, forcing: Forcing, y: State, sign: FloatArray) -> FloatArray:
        """The elongations at the beginnings of the modes `sign`: in slips those of the limits."""
        own, none = self._own(sign), jnp.zeros((), y[0].dtype)
        reach = self._limits(forcing, none, y, jnp.zeros_like(own), sign).slip(own) * self.softness(y)
        return jnp.where((own != 0) | self._is_open(sign), reach, self.elongations(y))

    @property
    @abc.abstractmethod
    def fastest(self) -> FloatScalar:
        """The highest angular frequency or decay rate of the system, rad/s."""

    @abc.abstractmethod
    def instant(self, forcing: Forcing, tau: FloatScalar, y: State) -> Instant:
        """The contacts, without friction."""

    @abc.abstractmethod
    def effect(self, forcing: Forcing, tau: FloatScalar, y: State, force: FloatArray) -> State:
        """What friction forces (contacts,) against the relative velocities add to the rates of the state."""

    @abc.abstractmethod
    def limits(self, forcing: Forcing, tau: FloatScalar, y: State, velocity: FloatArray) -> Limits:
        """The forces that friction can exert at these relative velocities, (contacts,).

        Those of slips are continued smoothly to beyond the end of a slip: the last Runge-Kutta step may have stages
        there, and a kink would cost its order.
        """

    @abc.abstractmethod
    def velocity_scale(self, forcing: Forcing, y: State) -> FloatArray:
        """The size of the terms that cancel in the relative velocities, (contacts,)."""

    @abc.abstractmethod
    def gross_changes(self, forcing: Forcing, y: State, h: FloatScalar, friction: FloatArray) -> State:
        """The changes of the state in the time `h` by each term of its rates alone, for `relative_error`.

        `friction`: the largest friction forces, (contacts,).
        """

    def jacobian(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        """The derivative of the rates without friction by the state, (numbers, numbers)."""
        flat, state = ravel_pytree(y)
        return jax.jacfwd(lambda values: ravel_pytree(self.instant(forcing, tau, state(values)).rates)[0])(flat)

    def implicit_changes(
        self, forcing: Forcing, tau: FloatScalar, y: State, weight: FloatScalar, sides: State
    ) -> State:
        """The changes x of the state with ``x - weight J x = side`` for each of the `sides`, arrays (..., sides).

        J: the `jacobian`.
        """
        jacobian, number = self.jacobian(forcing, tau, y), sides[0].shape[-1]
        matrix = jnp.eye(len(jacobian), dtype=jacobian.dtype) - weight * jacobian
        found = linear_solve(matrix, jnp.concatenate([side.reshape(-1, number) for side in sides]))
        ends = np.cumsum([side.size // number for side in sides])[:-1]
        return tuple(part.reshape(side.shape) for part, side in zip(jnp.split(found, ends), sides, strict=True))

    @abc.abstractmethod
    def normal_forces_at(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        """The normal forces of all contacts, N; where they are not known, the forces that slips have."""

    def varying_normal_forces(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        """The normal forces that vary, N."""
        return self.normal_forces_at(forcing, tau, y)[np.array(self.varying)]

    @abc.abstractmethod
    def normal_scale(self, forcing: Forcing, y: State) -> FloatArray:
        """The sizes of the terms that add up to `varying_normal_forces`; asked only where some do."""

    def _touch(self, forcing: Forcing, y: State) -> FloatArray:
        """The round-off of the normal forces that vary, and 0 for the others, N, (contacts,)."""
        size = self.normal_scale(forcing, y)
        numbers = jnp.finfo(size.dtype)
        # Far from a pulse that is a power of e there are no smaller numbers: it would close the contact by a jump.
        least = math.sqrt(float(numbers.tiny))
        return self.among_all(least + _TOUCH_ULPS * numbers.eps * size, 0)

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
        own = self._own(sign)
        return self.among_all(sign[len(own) :] < 0, False) if self.varying else jnp.zeros(own.shape, bool)

    def stuck(self, sign: FloatArray) -> BoolArray:
        is_open = self._is_open(sign)
        sticks = (self._own(sign) == 0) & ~is_open
        return jnp.append(sticks, jnp.all(sticks | is_open) & jnp.any(sticks))

    def slips(self, sign: FloatArray) -> FloatArray:
        return jnp.where(self._is_open(sign), 0, self._own(sign))

    def _limits(self, forcing: Forcing, tau: FloatScalar, y: State, velocity: FloatArray, sign: FloatArray) -> Limits:
        """The `limits`, zero in open contacts."""
        return self._closed(self.limits(forcing, tau, y, velocity), sign)

    def _closed(self, limits: Limits, sign: FloatArray) -> Limits:
        if not self.varying:
            return limits
        is_open = self._is_open(sign)
        return Limits(*(jnp.where(is_open, 0, force) for force in limits))

    def rates(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        now, own = self.instant(forcing, tau, y), self._own(sign)
        slip = self._limits(forcing, tau, y, now.velocity, sign).slip(own)
        added = self.effect(forcing, tau, y, solved(now.gain, now.drift, slip, self._rigid(own == 0)))
        return tuple(a + b for a, b in zip(now.rates, added, strict=True))

    def flow_and_error(
        self, forcing: Forcing, y: State, h: FloatScalar, sign: FloatArray
    ) -> tuple[State, FloatScalar | None]:
        reached, error = runge_kutta_step(Partial(type(self).rates, self, forcing, sign=sign), y, h, solver=self.solver)
        gross = self._gross_changes(forcing, y, h)
        return self._held(forcing, h, reached, self._own(sign) == 0), relative_error(error, y, reached, gross)

    def relative_velocity(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        return self.instant(forcing, tau, y).velocity

    def guard(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatArray) -> Guard:
        now, change = self.in_mode(forcing, tau, y, sign)
        own = self._own(sign)
        if self.has_sliders:
            now, change = self._with_sliders(forcing, tau, y, sign, (now, change))

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

    def in_mode(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatArray) -> tuple[InMode, InMode]:
        """What the guards of the mode `sign` are made of, and its time derivative."""

        def at(tau, y):
            now, own = self.instant(forcing, tau, y), self._own(sign)
            limits = self._limits(forcing, tau, y, now.velocity, sign)
            force = solved(now.gain, now.drift, limits.slip(own), self._rigid(own == 0))
            normal = self.varying_normal_forces(forcing, tau, y) if self.varying else None
            middle, limit = limits.band(force)
            return InMode(now.velocity, force - middle, limit, normal)

        return jax.jvp(at, (tau, y), (jnp.ones_like(tau), self.rates(forcing, tau, y, sign)))

    def _rigid(self, contacts: BoolArray) -> BoolArray:
        """Those of `contacts` whose sticks hold what they are fixed to, having no spring."""
        return contacts if not self.has_sliders else contacts & ~self.elastic

    def _with_sliders(
        self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatArray, others: tuple[InMode, InMode]
    ) -> tuple[InMode, InMode]:
        """What `in_mode` gives of `others`, with that of the sliders: their own velocities, the forces of springs."""

        def at(tau: FloatScalar, y: State) -> tuple[FloatArray, FloatArray, FloatArray]:
            of = self.sliders(forcing, tau, y, sign)
            middle, limit = self._closed(of.limits, sign).band(of.force)
            return of.velocity, of.force - middle, limit

        found = jax.jvp(at, (tau, y), (jnp.ones_like(tau), self.rates(forcing, tau, y, sign)))
        now, change = (
            other._replace(
                velocity=jnp.where(self.elastic, own[0], other.velocity),
                force=jnp.where(self.elastic, own[1], other.force),
                limit=jnp.where(self.elastic, own[2], other.limit),
            )
            for own, other in zip(found, others, strict=True)
        )
        return now, change

    def guard_scale(self, forcing: Forcing, y: State, sign: FloatArray) -> FloatArray:
        none, own = jnp.zeros((), y[0].dtype), self._own(sign)
        now = self.instant(forcing, none, y)
        friction = self.limits(forcing, none, y, now.velocity).largest
        rate = jnp.abs(now.drift) + jnp.abs(acceleration(now.gain, 0 * now.drift, friction))
        size = with_change(self.velocity_scale(forcing, y), rate, self.fastest, forcing.t)
        scale = jnp.where(own == 0, 2.0, size)
        return self._with_normal(scale, self.normal_scale(forcing, y)) if self.varying else scale

    def at_rest(self, forcing: Forcing, y: State, times: float = 1.0) -> BoolArray:
        velocity = self.relative_velocity(forcing, jnp.zeros((), y[0].dtype), y)
        noise = self._own(self.noise(forcing, y, self._with_normal(jnp.ones_like(velocity), 1)))
        resting = jnp.abs(velocity) <= times * noise
        if self.has_sliders:
            of = self.sliders(forcing, jnp.zeros((), y[0].dtype), y)
            still = jnp.abs(of.velocity) <= times * noise
            # A slider rests unless it moves on at its limit. With more round-off: what may do either.
            resting = jnp.where(self.elastic, still if times > 1 else still | ~of.moves_on, resting)
        return self._with_normal(resting, 0)

    def slip_sign(self, forcing: Forcing, y: State) -> FloatArray:
        slips = super().slip_sign(forcing, y)
        if self.has_sliders:
            slips = jnp.where(self.elastic, self.sliders(forcing, jnp.zeros((), y[0].dtype), y).way, slips)
        return self._with_normal(slips, self._normal_sign(forcing, y)) if self.varying else slips

    def _normal_sign(self, forcing: Forcing, y: State) -> FloatArray:
        """The sign of each varying normal force right after `tau` 0; -1 where it stays zero."""
        none = jnp.zeros((), y[0].dtype)

        def moving(tau: FloatScalar, y: State) -> tuple[FloatScalar, State]:
            # Relative velocities may jump here, and the rates of the state with them: they are those of the base alone.
            return jnp.ones_like(tau), self.instant(forcing, tau, y).rates

        def with_rate(tau: FloatScalar, y: State) -> tuple[FloatArray, FloatArray]:
            return jax.jvp(partial(self.varying_normal_forces, forcing), (tau, y), moving(tau, y))

        (value, rate), (_, bend) = jax.jvp(with_rate, (none, y), moving(none, y))
        eps = jnp.finfo(y[0].dtype).eps
        noise = eps * (NOISE_ULPS * self.normal_scale(forcing, y) + _CLOCK_ULPS * forcing.t * jnp.abs(rate))
        # Within this of its least value, a force with the curvature `bend` has at most the rate sqrt(4 noise bend).
        touches = rate * rate <= 4 * noise * jnp.abs(bend)
        decides = jnp.where(jnp.abs(value) > noise, value, jnp.where(touches, bend, rate))
        return jnp.where(decides > 0, 1, -1).astype(y[0].dtype)

    def after(
        self, forcing: Forcing, y: State, sign: FloatArray, landed: BoolArray, ended: BoolArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        if not self.varying:
            return sign, landed, jnp.zeros_like(landed)
        own, before = self._own(sign), sign[len(self._own(sign)) :]
        of_normal = landed[len(own) :]
        now = jnp.where(ended, self._normal_sign(forcing, y), jnp.where(of_normal, -before, before))
        # What ends an open contact's mode is its closing alone; then all is asked anew.
        changed = self.among_all(now != before, False)
        if self.has_sliders:  # a slider whose limit jumps up stops
            of = self.sliders(forcing, jnp.zeros((), y[0].dtype), y)
            changed = changed | (self.elastic & ended & (own != 0) & ~of.is_at_limit)
        contacts = self._own(landed) & ~changed
        return self._with_normal(own, now), self._with_normal(contacts, False), self._with_normal(changed, False)

    def at_base_velocity(self, forcing: Forcing, y: State, resting: BoolArray) -> State:
        return self._held(forcing, jnp.zeros((), y[0].dtype), y, self._own(resting))

    def decided(self, forcing: Forcing, y: State, question: Question) -> Decision:
        none = jnp.zeros((), y[0].dtype)
        y, modes = self.at_base_velocity(forcing, y, question.asked), question.sign
        question = Question(*map(self._own, question))
        now = self.instant(forcing, none, y)
        together = jnp.where(question.asked, 0, question.sign)
        _, rate = self.guard(forcing, none, y, self._with_normal(together, modes[len(together) :]))
        rate, eps = self._own(rate), jnp.finfo(y[0].dtype).eps
        moment, later = none, y
        if self.varying:  # a contact that closes has no normal force yet: what it can hold is seen a moment later
            moment = _MOMENT_ULPS * eps * (forcing.t + jnp.minimum(1 / self.fastest, 1))
            later = tuple(value + moment * change for value, change in zip(y, now.rates, strict=True))
        limits = self._limits(forcing, moment, later, jnp.where(question.asked, 0, now.velocity), modes)
        if self.varying:  # nor does one whose normal force only touches zero let go of a stick that needs no friction
            touches = question.goes_on & ~self._is_open(modes) & (limits.largest == 0)
            limits = Limits(*(jnp.where(touches, self._touch(forcing, y), force) for force in limits))
        slack = eps * (NOISE_ULPS + _CLOCK_ULPS * forcing.t * jnp.abs(rate))
        slack = jnp.where(jnp.isfinite(slack), slack, 0)
        of_rigid = question._replace(asked=self._rigid(question.asked))
        found = settled(now.gain, now.drift, limits, of_rigid, slack)
        if self.has_sliders:
            # Open sliders count as slipping: their modes are found anew when they close.
            of_closed = question._replace(released=question.released | self._is_open(modes))
            found = self._settled_sliders(found, forcing, moment, later, limits, of_closed, slack)
        guard = jnp.where(jnp.abs(found.share) < jnp.inf, 1 - found.share**2, -1)
        direction = jnp.where(found.sign != 0, found.sign, jnp.where(found.share > 0, 1, -1)).astype(guard.dtype)
        return Decision(
            self._with_normal(found.sign == 0, False),
            self._with_normal(direction, modes[len(together) :]),
            self._with_normal(guard, jnp.inf),
            self._with_normal(rate, 0),
        )

    def _settled_sliders(
        self,
        others: Settled,
        forcing: Forcing,
        tau: FloatScalar,
        y: State,
        limits: Limits,
        question: Question,
        slack: FloatArray,
    ) -> Settled:
        """What is `settled` of `others`, with the sliders: each by the force of its own spring."""
        force = self.sliders(forcing, tau, y).force
        share = limits.share(force)
        # What stops has the force of its limit, but for round-off; held too far beyond, it slips on at once.
        within = jnp.abs(share) <= 1 + jnp.where(question.goes_on, slack, math.sqrt(jnp.finfo(share.dtype).eps))
        holds = question.asked & within & ~question.released
        # What stops at its limit moves away from it: no last digit decides that.
        share = jnp.where(holds & ~question.goes_on, 0, jnp.where(question.released, jnp.inf, share))
        way = jnp.where(force > limits.band(force)[0], 1, -1).astype(force.dtype)
        sign = jnp.where(question.asked, jnp.where(holds, 0, way), question.sign)
        return Settled(*(jnp.where(self.elastic, *pair) for pair in zip((sign, share), others, strict=True)))

    def _held(self, forcing: Forcing, tau: FloatScalar, y: State, resting: BoolArray) -> State:
        """`y`, moved in the directions in which friction acts until what is `resting` has no relative velocity."""
        resting = self._rigid(resting)
        for _ in range(_NEWTON_STEPS):
            now = self.instant(forcing, tau, y)
            impulse = solved(now.gain, now.velocity, jnp.zeros_like(now.velocity), resting)
            y = tuple(a + b for a, b in zip(y, self.effect(forcing, tau, y, impulse), strict=True))
        return y

    def _gross_changes(self, forcing: Forcing, y: State, h: FloatScalar) -> State:
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
