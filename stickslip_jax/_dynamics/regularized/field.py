"""A system under its excitation as the engines of regularised dynamics ask it: smooth switches in place of the sign of
the relative velocity, and implicit steps with one contact or several.
"""

import abc
import dataclasses
import math
from collections.abc import Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.flatten_util import ravel_pytree

from ..._excitation.motion import Signal
from ..._foundation.types import BoolArray, BoolScalar, FloatArray, FloatScalar, IntArray, Scalar
from ..._numerics.derivatives import root_of, with_slope, without_derivatives
from ..._numerics.matrices import eliminated, largest_of, linear_solve, times
from ..._systems.contacts_model import ContactsModel, Limits, acceleration, settled, solved
from ..._systems.friction import FrictionLaw
from ..._systems.memory_models import InnerStates
from ..._systems.switched_model import NOISE_ULPS, OneContactModel, Question, State
from ..._systems.system import System, one_contact_model
from ..common.method import Regularized, Switch
from ..common.path import Bracket
from .sticks import AtContact, Criterion, Cubic, SeenStep

# The relative velocity at which the forces of a stage of an implicit step balance, in one contact.
#
# Where static friction exceeds kinetic friction, friction falls off where a stick ends, and a step that does not
# resolve this fall has two balances: the mass sticks, or it slides. Which one holds follows from what the mass did
# before: a sliding mass slides as long as it can, and one that sticks does so as long as it can.


_LEAST_STEEP = 1e-6  # of the balance of forces, 1 without friction; not above it at the edge of a jump
_NEWTON = {"linear": 3, "tanh": 7, "rational": 7, "arctan": 7}  # iterations
_RISE, _FALL = 7, 10  # likewise, with static friction
_BALANCED = 1e-6  # of the largest friction: as good as equal


def _missing(
    switch: Switch, friction: FrictionLaw, size: FloatArray, stiffness: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """At `sigma` the friction coefficient, its slope, what is missing from the balance, and the slope of that."""
    value, slope = with_slope(partial(switch.coefficient, friction), sigma)
    return value, slope, sigma + stiffness * value - size, 1 + stiffness * slope


def _sigma_changed(*args: Any) -> FloatArray:
    *given, change = args
    *_, steep = _missing(*given)
    return -change / jnp.where(steep > _LEAST_STEEP, steep, 1)


_balance_root = root_of(
    lambda switch, friction, size, stiffness, sigma: sigma + stiffness * switch.coefficient(friction, sigma) - size,
    _sigma_changed,
)


def balance(
    switch: Switch, friction: FrictionLaw, speed: FloatArray, stiffness: FloatArray, slides: FloatArray | None
) -> tuple[FloatArray, FloatArray | None]:
    """The signed friction coefficient ``mu(sigma)`` at a root of ``sigma + stiffness mu(sigma) = speed``, and whether
    the mass slides there.

    On the magnitude, by Newton's method from below: mu is concave up to its largest value, so that no iterate
    overshoots. `slides`, and what is returned: the sign of the relative velocity of a mass that slides, 0 for one that
    sticks; None where static friction does not exceed kinetic friction.
    """
    sign = jnp.where(speed < 0, -1.0, 1.0)
    given = switch, friction.in_direction(sign), jnp.abs(speed), stiffness
    switch, friction, size, stiffness = without_derivatives(given)
    missing = partial(_missing, switch, friction, size, stiffness)
    *_, steepest = missing(jnp.full_like(size, 1e-9) * switch.width)
    if slides is None:
        most, tries = None, _NEWTON[switch.shape]
        sigma = jnp.maximum(size - stiffness * friction.static, size / steepest)
    else:
        most, tries = switch.width * (1 - 1e-7), _RISE
        sigma = jnp.minimum(size / steepest, most)
    for _ in range(tries):
        _, _, rest, gain = missing(sigma)
        sigma = jnp.clip(sigma - rest / jnp.maximum(gain, 1), 0, most)
    if slides is not None:
        sliding, balanced = _sliding(switch, friction, size, stiffness)
        least = _BALANCED * stiffness * friction.static
        breaks = size > switch.width + stiffness * friction.static + least  # what a stick can take up
        chosen = breaks | ((slides == sign) & balanced)
        sigma, slides = jnp.where(chosen, sliding, sigma), jnp.where(chosen, sign, 0)
    _, slope, rest, gain = missing(sigma)
    per = jnp.maximum(gain, 1) if slides is None else jnp.where(gain > 0, gain, 1)
    last = slope * rest / per  # one more Newton step
    (sigma,) = _balance_root(*given, sigma)
    switch, friction, *_ = given
    return sign * (switch.coefficient(friction, sigma) - last), slides


def _sliding(
    switch: Switch, friction: FrictionLaw, size: FloatArray, stiffness: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The fastest balance beyond the width, by Newton's method from above, and whether there is one."""
    missing = partial(_missing, switch, friction, size, stiffness)
    low, high, sliding = jnp.minimum(jnp.full_like(size, switch.width), size), size, size
    for _ in range(_FALL):
        _, _, rest, gain = missing(sliding)
        low, high = jnp.where(rest > 0, low, sliding), jnp.where(rest > 0, sliding, high)
        following = sliding - rest / jnp.where(gain > 0, gain, 1)
        sliding = jnp.where((gain > 0) & (following >= low) & (following <= high), following, (low + high) / 2)
    _, _, rest, gain = missing(sliding)
    least = _BALANCED * stiffness * friction.static
    return sliding, (jnp.abs(rest) <= least) & (gain > 0) & (sliding > switch.width)


# The friction forces in several contacts at which a stage of an implicit step balances, with all their derivatives.
#
# With the relative velocities ``sigma = speed - stiffness force`` that the forces (contacts,) leave of the `speed`
# without friction, the forces are those of the regularised law, ``force = law(sigma)``. Where the law rises with the
# velocity and the stiffness is positive definite there is one solution: the minimum of a convex function of gradient
# ``stiffness (force - law(sigma))``. Newton's method finds it. Where a step would overshoot the minimum, because
# contacts pass their narrow bands of small relative velocity in it, it ends at the minimum along its direction.


_MOST = 40  # iterations; three are usual
_ULPS = 64
_OVERSHOT = 0.5  # of the slope along a step: so much of the other sign at its end is allowed
_SECANTS = 3
_HALVINGS = 48


class ForceLaw(eqx.Module):
    """The regularised friction forces in several contacts at one instant."""

    @abc.abstractmethod
    def __call__(self, velocity: FloatArray) -> FloatArray:
        """The signed forces at these relative velocities; each depends on its own."""

    @property
    @abc.abstractmethod
    def width(self) -> FloatArray:
        """The relative velocity over which they change their signs."""

    @property
    @abc.abstractmethod
    def is_straight(self) -> bool:
        """Whether they are nearly straight lines between one width on either side and beyond."""


def balanced_forces(law: ForceLaw, speed: FloatArray, stiffness: FloatArray, guess: FloatArray) -> FloatArray:
    """The forces with ``force = law(speed - stiffness force)``; NaN where none are found."""
    given = law, speed, stiffness
    law, speed, stiffness, guess = without_derivatives((*given, guess))
    eps = jnp.finfo(speed.dtype).eps

    def again(state: tuple[FloatArray, FloatScalar, IntArray]) -> tuple[FloatArray, FloatScalar, IntArray]:
        force, _, tries = state
        sigma = speed - times(stiffness, force)
        value, slope = with_slope(law, sigma)
        change = linear_solve(_newton_matrix(slope, stiffness), value - force)
        moved = times(stiffness, change)  # sigma falls by this
        scale = jnp.abs(speed) + times(jnp.abs(stiffness), jnp.abs(force))
        error = jnp.max(jnp.abs(moved) / jnp.where(scale > 0, scale, 1))
        return force + _share(law, sigma, force, moved, change) * change, error, tries + 1

    def goes_on(state: tuple[FloatArray, FloatScalar, IntArray]) -> BoolScalar:
        _, error, tries = state
        return (error > _ULPS * eps) & (tries < _MOST)

    force, error, _ = lax.while_loop(goes_on, again, (guess, jnp.full((), jnp.inf, speed.dtype), jnp.int32(0)))
    (force,) = _force_root(*given, jnp.where(error <= jnp.sqrt(eps), force, jnp.nan))
    return force


def _force_changed(
    law: ForceLaw, speed: FloatArray, stiffness: FloatArray, force: FloatArray, change: FloatArray
) -> FloatArray:
    _, slope = with_slope(law, speed - times(stiffness, force))
    return linear_solve(_newton_matrix(slope, stiffness), change)


_force_root = root_of(lambda law, speed, stiffness, force: law(speed - times(stiffness, force)) - force, _force_changed)


def _share(law: ForceLaw, sigma: FloatArray, force: FloatArray, moved: FloatArray, change: FloatArray) -> FloatScalar:
    """The part of a Newton step to take: all of it, or up to the minimum along it."""

    def downhill(share: FloatScalar) -> FloatScalar:
        return jnp.sum(moved * (law(sigma - share * moved) - force - share * change))

    none, all_of_it = jnp.zeros_like(sigma[0]), jnp.ones_like(sigma[0])
    at_start, at_end = downhill(none), downhill(all_of_it)
    # Between the edges of all bands the law is smooth, for the linear shape a straight line.
    does_move = moved != 0
    edges = jnp.concatenate([(sigma - side * law.width) / jnp.where(does_move, moved, 1) for side in (1, -1)])
    inner = jnp.concatenate([does_move, does_move]) & (edges > 0) & (edges < 1)
    slopes = jax.vmap(downhill)(jnp.where(inner, edges, 0))
    before, beyond = inner & (slopes >= 0), inner & (slopes < 0)
    low, high = jnp.max(jnp.where(before, edges, 0)), jnp.min(jnp.where(beyond, edges, 1))

    bracket = Bracket(low, high, downhill(low), downhill(high))

    def narrower(bracket: Bracket, share: FloatScalar) -> Bracket:
        return bracket.narrowed(share, downhill(share))

    if not law.is_straight:  # of long tails a secant sees little
        bracket = lax.fori_loop(0, _HALVINGS, lambda _, b: narrower(b, (b.low + b.high) / 2), bracket)
    for _ in range(_SECANTS):
        bracket = narrower(bracket, bracket.by_secant)
    return jnp.where(at_end >= -_OVERSHOT * at_start, all_of_it, bracket.by_secant)


def _newton_matrix(slope: FloatArray, stiffness: FloatArray) -> FloatArray:
    return jnp.eye(len(slope), dtype=slope.dtype) + slope[:, None] * stiffness


# What the engines and the stick detectors ask of a system whose friction is regularised, or smooth by itself.


_TIME_ULPS = 4  # the round-off of the time, in units in the last place
_AT_LIMIT = 256  # of the share of static friction that a stick needs, likewise


class AnyField(eqx.Module):
    """A system under its excitation whose friction has no jump, and what counts as a stick of it; what belongs to
    contacts is as in its `model`.
    """

    model: eqx.AbstractVar[Any]
    criterion: eqx.AbstractVar[Criterion]

    @abc.abstractmethod
    def rates(self, forcing: Any, tau: FloatArray, y: State) -> State:
        """The time derivative of the state."""

    @property
    @abc.abstractmethod
    def kinks(self) -> tuple[Scalar, ...]:
        """The relative velocities (m/s) at which the rates begin to change in another way."""

    @property
    def has_corners(self) -> bool:
        """Whether their derivatives jump there."""
        return True

    def elastic_slip(self, velocity: FloatArray, y: State) -> FloatArray:
        """How far each contact can slip while bristles only bend."""
        return jnp.zeros_like(velocity)

    def velocity_and_slope(
        self, forcing: Any, tau: FloatArray, y: State, rates: State
    ) -> tuple[FloatArray, FloatArray]:
        """The relative velocity, m/s, and its time derivative where the state changes with `rates`."""
        return _with_slope(self.model.relative_velocity, forcing, tau, y, rates)

    def solved(self, forcing: Any, y: State) -> State:
        """What adaptive steps follow in place of the state `y`: its numbers."""
        return self.model.numbers(y)

    def plain(self, forcing: Any, tau: FloatArray, numbers: State) -> State:
        """The state of which `solved` made these `numbers`."""
        return self.model.start(numbers, tau.dtype)

    def solved_rates(self, forcing: Any, tau: FloatArray, numbers: State) -> State:
        """The time derivatives of what is `solved`."""
        return self.model.numbers(self.rates(forcing, tau, self.plain(forcing, tau, numbers)))

    def seen(
        self, forcing: Any, t: FloatArray, h: FloatArray, before: State, after: State, middle: State | None = None
    ) -> tuple[SeenStep, State, State]:
        """The step from `t` to ``t + h`` as the stick detectors read it, and the rates at both ends.

        `middle`: the state at ``t + h / 2``, if it is known.
        """

        def at(tau: FloatArray, y: State) -> tuple[Any, ...]:
            rates = self.rates(forcing, tau, y)
            velocity = self.velocity_and_slope(forcing, tau, y, rates)
            position = jax.jvp(self.model.stick_position, (y,), (rates,))
            normal = ()
            if self.model.varying:
                # The normal forces and their slopes, 1 where they do not vary.
                value, slope = _with_slope(self.model.varying_normal_forces, forcing, tau, y, rates)
                normal = self.model.among_all(value, 1), self.model.among_all(slope, 0)
            return rates, velocity, position, normal

        (rates, *begin), (end_rates, *end) = at(0 * h, before), at(h, after)
        cubics = [Cubic(*a, *b) for a, b in zip(begin, end, strict=True) if a]
        if middle is not None:
            values = [self.model.relative_velocity(forcing, h / 2, middle), self.model.stick_position(middle)]
            if self.model.varying:
                values.append(self.model.among_all(self.model.varying_normal_forces(forcing, h / 2, middle), 1))
            cubics = [cubic.through(h, value) for cubic, value in zip(cubics, values, strict=True)]
        return SeenStep(t, h, *cubics), rates, end_rates

    def at_contact(self, forcing: Any, t: FloatArray, y: State) -> AtContact:
        """What sticks are found by, at the time `t` of the `forcing`."""
        zero = jnp.zeros_like(t)
        velocity = self.model.relative_velocity(forcing, zero, y)
        closed = jnp.ones(velocity.shape, bool)
        if self.model.varying:
            closed = self.model.among_all(self.model.varying_normal_forces(forcing, zero, y) > 0, True)
        return AtContact(velocity, closed, self.elastic_slip(velocity, y))


def _with_slope(what: Any, forcing: Any, tau: FloatArray, y: State, rates: State) -> tuple[FloatArray, FloatArray]:
    """A function of forcing, time and state and its slope, where the state changes with `rates`."""
    return jax.jvp(lambda tau, y: what(forcing, tau, y), (tau, y), (jnp.ones_like(tau), rates))


# Steps of fixed length of regularised dynamics, stable for any width.
#
# The method is the singly diagonally implicit Runge-Kutta method of order 2 with ``gamma = 1 - 1/sqrt(2)`` (Alexander
# 1977; L-stable). In each stage everything but the friction is linearised at a predicted state. An equation for the
# relative velocity of each contact remains, ``sigma + K mu(sigma) = sigma*`` with the signed friction coefficient mu;
# with several all are solved together (see above). A step may be far longer than the time in which friction changes
# the relative velocity by one width: it then ends in the stick, as it should, where a step with linearised friction
# would overshoot it to and fro.
#
# The error of everything but the friction is estimated: the stages against the quadrature of order 3 at the same
# instants, and what is not linear in the last of them. What friction may change in a step does not count: it is no
# smooth function of time where a stick begins or ends, and no shorter step would do.


_GAMMA = 1 - 1 / math.sqrt(2)
# The weights of the quadrature of order 3 at the instants 0, gamma and 1 of a step, less those of the method.
_SECOND, _LAST = 1 / (6 * _GAMMA * (1 - _GAMMA)), (2 - 3 * _GAMMA) / (6 * (1 - _GAMMA))
_WEIGHTS = 1 - _SECOND - _LAST, _SECOND - (1 - _GAMMA), _LAST - _GAMMA
_KINK = _GAMMA * abs(_WEIGHTS[1]) + abs(_WEIGHTS[2])  # the most that friction adds to the estimate
# Allowed in a step, of what the terms of the equations of motion change in it, each alone: that of a harmonic motion in
# some 45 steps in a period, whose error is below a thousandth of the amplitude per radian.
_ERROR = 1e-4
_ROUND_OFF = 64  # units in the last place


class _Stage(NamedTuple):
    """A stage of a step: its state and rates, how friction `held` in it, and its rates without friction.

    `held`: where static friction exceeds kinetic friction the sign of the relative velocity, 0 in a stick; else None
    with one contact, the friction forces with several.
    `expected`: the state at which it is linear. `linear`: what is known there, see `terms`.
    """

    state: State
    rates: State
    held: FloatArray | None
    free: State
    expected: State
    linear: Any


class SteppedField(AnyField):
    """A field with friction regularised by `switch`, which implicit steps of fixed length can follow too."""

    switch: eqx.AbstractVar[Switch]
    static_exceeds_kinetic: eqx.AbstractVar[bool]  # of any contact

    @property
    def kinks(self) -> tuple[Scalar, ...]:
        return self.switch.width, -self.switch.width

    @property
    def has_corners(self) -> bool:
        return self.switch.shape == "linear" or self.static_exceeds_kinetic

    @property
    def may_be_short(self) -> bool:
        """Whether fixed steps may have to be shortened."""
        return self.static_exceeds_kinetic or not self.model.time_scales_are_known

    @abc.abstractmethod
    def band(self, forcing: Any, t: FloatArray, y: State) -> FloatArray | None:
        """The relative speed (m/s) below which static friction can hold the mass: the width, and what is round-off.

        None where static friction does not exceed kinetic friction.
        """

    @abc.abstractmethod
    def need(self, forcing: Any, tau: FloatArray, y: State, asked: BoolArray) -> FloatArray:
        """Friction that keeps the relative velocity of the contacts `asked` constant, over the largest friction;
        infinite without friction.

        It is asked only where there is a `band`.
        """

    @abc.abstractmethod
    def free(self, forcing: Any, tau: FloatArray, y: State) -> State:
        """The rates without friction."""

    @abc.abstractmethod
    def held(self, forcing: Any, tau: FloatArray, y: State, band: FloatArray | None) -> FloatArray | None:
        """How friction holds before a step, as in a stage."""

    @abc.abstractmethod
    def stage(
        self, forcing: Any, tau: FloatArray, base: State, expected: State, weight: FloatArray, held: FloatArray | None
    ) -> _Stage:
        """Solve the stage ``Y = base + weight f(tau, Y)``, linear at `expected` but for friction.

        `held`: how friction held before it.
        """

    @abc.abstractmethod
    def terms(self, forcing: Any, tau: FloatArray, weight: FloatArray, stage: _Stage) -> tuple[State, State]:
        """Of each rate of the last stage without friction the sum of its terms, each alone, and what friction could
        change in it, per s.
        """

    def step(self, forcing: Any, y: State, h: FloatArray, band: FloatArray | None) -> tuple[State, FloatArray | None]:
        """The state after a step of length `h` (s) from the state `y`, and its estimated error over the allowed one;
        None where the time scales, which the given step suits, are known.

        `band`: where static friction exceeds kinetic friction, the relative speed above which the mass slides (m/s).
        """
        start, weight = jnp.zeros_like(h), _GAMMA * h
        expected = moved(y, weight, self.rates(forcing, start, y))
        middle = self.stage(forcing, weight, y, expected, weight, self.held(forcing, start, y, band))
        base, expected = moved(y, (1 - _GAMMA) * h, middle.rates), moved(y, h, middle.rates)
        end = self.stage(forcing, h, base, expected, weight, middle.held)
        if self.model.time_scales_are_known:
            return end.state, None
        field, forcing, y, h, middle, last = without_derivatives((self, forcing, y, h, middle, end))
        first, after = field.free(forcing, jnp.zeros_like(h), y), field.free(forcing, h, last.state)
        free = zip(first, middle.free, last.free, after, strict=True)
        errors = map(partial(_error, h), y, free, *field.terms(forcing, h, _GAMMA * h, last))
        return end.state, reduce(jnp.maximum, map(largest_of, errors), jnp.zeros_like(h))


def moved(y: State, h: FloatArray | float, rates: State) -> State:
    """``y + h rates``."""
    return tuple(value + h * rate for value, rate in zip(y, rates, strict=True))


def _error(
    h: FloatArray, value: FloatArray, free: Sequence[FloatArray], gross: FloatArray, kink: FloatArray
) -> FloatArray:
    """The estimated error of numbers of the state in a step from `value`, over the allowed one; at most 1 is accurate
    enough.

    `free`: their rates without friction at the beginning, in both stages, and after the step. `gross`, `kink`: their
    `SteppedField.terms`.
    """
    *_, end, after = free
    stages = zip(_WEIGHTS, free[:-1], strict=True)
    error = h * (jnp.abs(sum(weight * rate for weight, rate in stages)) + _GAMMA * jnp.abs(after - end))
    error = error - _ROUND_OFF * jnp.finfo(h.dtype).eps * (jnp.abs(value) + h * gross) - _KINK * h * h * kink
    allowed = _ERROR * h * gross
    share = error / jnp.where(allowed > 0, allowed, 1)
    return jnp.where((error > 0) & (allowed > 0), share, 0)


class Field(SteppedField):
    """A system with one contact, with friction regularised by `switch`."""

    model: OneContactModel
    criterion: Criterion
    switch: Switch
    static_exceeds_kinetic: bool = eqx.field(static=True)

    def rates(self, forcing: Any, tau: FloatArray, y: State) -> State:
        speed = self.model.relative_velocity(forcing, tau, y)
        return self.model.rates_under(forcing, tau, y, self.switch.coefficient(self.model.friction_at(y), speed))

    def need(self, forcing: Any, tau: FloatArray, y: State, asked: BoolArray) -> FloatArray:
        free, held = self._accelerations(forcing, tau, y)
        return jnp.where(held > 0, jnp.abs(free) / jnp.where(held > 0, held, 1), jnp.inf)

    def velocity_and_slope(
        self, forcing: Any, tau: FloatArray, y: State, rates: State
    ) -> tuple[FloatArray, FloatArray]:
        # By the acceleration that the motion of the base states, which decides in exact dynamics too.
        velocity = self.model.relative_velocity(forcing, tau, y)
        return velocity, self.model.relative_acceleration(forcing, tau, y, rates)

    def band(self, forcing: Any, t: FloatArray, y: State) -> FloatArray | None:
        if not self.static_exceeds_kinetic:
            return None
        _, held = self._accelerations(forcing, jnp.zeros_like(t), y)
        scale = NOISE_ULPS * self.model.guard_scale(forcing, y, jnp.ones_like(t)) + _TIME_ULPS * t * held
        return self.switch.width + lax.stop_gradient(jnp.finfo(t.dtype).eps * scale)

    def _accelerations(self, forcing: Any, tau: FloatArray, y: State) -> tuple[FloatArray, FloatArray]:
        """The relative acceleration without friction, and the largest one that friction causes, m/s^2."""
        free, gain = self.model.effect_of_friction(forcing, tau, y)
        return free, jnp.abs(gain) * self.model.friction_at(y).stick_limit(free)

    def free(self, forcing: Any, tau: FloatArray, y: State) -> State:
        return self.model.rates_under(forcing, tau, y, jnp.zeros_like(tau))

    def held(self, forcing: Any, tau: FloatArray, y: State, band: FloatArray | None) -> FloatArray | None:
        speed = self.model.relative_velocity(forcing, tau, y)
        return None if band is None else jnp.where(jnp.abs(speed) > band, jnp.sign(speed), 0)

    def stage(
        self, forcing: Any, tau: FloatArray, base: State, expected: State, weight: FloatArray, held: FloatArray | None
    ) -> _Stage:
        model, free = self.model, partial(self.free, forcing, tau)
        rates = free(expected)
        by_friction = moved(model.rates_under(forcing, tau, expected, jnp.ones_like(tau)), -1.0, rates)
        jacobian, size = jax.jacfwd(free)(expected), len(base)
        matrix = [[(i == j) - weight * jacobian[i][j] for j in range(size)] for i in range(size)]
        missing = [b - e + weight * r for b, e, r in zip(base, expected, rates, strict=True)]
        without, per_unit = eliminated(matrix, [missing, [weight * value for value in by_friction]])
        reached, velocity = moved(expected, 1.0, without), partial(model.relative_velocity, forcing, tau)
        speed, gain = jax.jvp(velocity, (reached,), (per_unit,))
        coefficient, slides = balance(self.switch, model.friction_at(expected), speed, -gain, held)
        change = moved(without, coefficient, per_unit)
        _, turned = jax.jvp(free, (expected,), (change,))
        alone = moved(rates, 1.0, turned)
        end_rates = moved(alone, coefficient, by_friction)
        return _Stage(moved(expected, 1.0, change), end_rates, slides, alone, expected, (rates, jacobian, by_friction))

    def terms(self, forcing: Any, tau: FloatArray, weight: FloatArray, stage: _Stage) -> tuple[State, State]:
        rates, jacobian, by_friction = stage.linear
        terms = [[part * value for part, value in zip(row, stage.expected, strict=True)] for row in jacobian]
        gross = tuple(jnp.abs(r - sum(row)) + sum(map(jnp.abs, row)) for r, row in zip(rates, terms, strict=True))
        # Where a rate passes through zero: as large as those that it is coupled with make it in one radian.
        pairs = [row[j] * jacobian[j][i] for i, row in enumerate(jacobian) for j in range(len(row))]
        fastest = jnp.sqrt(sum(map(jnp.abs, pairs)) + jnp.finfo(tau.dtype).tiny)
        coupled = [sum(jnp.abs(j) * g for j, g in zip(row, gross, strict=True)) for row in jacobian]
        fast = fastest * weight > 1e-9
        gross = tuple(own + jnp.where(fast, of / fastest, 0) for own, of in zip(gross, coupled, strict=True))
        held = jnp.abs(self.model.friction.static)
        kink = (held * sum(jnp.abs(j * f) for j, f in zip(row, by_friction, strict=True)) for row in jacobian)
        return gross, tuple(kink)


class FrictionAt(ForceLaw):
    """The regularised friction forces at one instant and state.

    `slides`: if it is known, the sign of each contact that slides, 0 where static friction holds it: there it rises up
    to the largest, and no further. `beyond`: by what a slide exceeds kinetic friction, if that is taken as constant.
    """

    model: ContactsModel
    switch: Switch
    static_exceeds_kinetic: bool = eqx.field(static=True)
    forcing: Any
    tau: FloatScalar
    y: State
    slides: FloatArray | None = None
    beyond: FloatArray | None = None

    def __call__(self, velocity: FloatArray) -> FloatArray:
        limits = self.model.limits(self.forcing, self.tau, self.y, velocity)
        # A contact without a positive normal force is open.
        kinetic = jnp.maximum(jnp.where(velocity < 0, limits.backward, limits.forward), 0)
        static = jnp.maximum(limits.static(velocity), 0) if self.static_exceeds_kinetic else None
        friction = self.switch.friction(velocity, kinetic, static)
        if self.slides is None:
            return friction
        part = jnp.clip(velocity / self.switch.width, -1, 1)
        slipping = friction if self.beyond is None else kinetic * part + self.beyond
        return jnp.where(self.slides == 0, self.switch.friction(part * self.switch.width, kinetic, static), slipping)

    @property
    def width(self) -> FloatArray:
        return jnp.asarray(self.switch.width, self.tau.dtype)

    @property
    def is_straight(self) -> bool:
        return self.switch.shape == "linear"


# Where static friction exceeds kinetic friction the forces of a stage may balance in several ways. As with one contact,
# what slid slides as long as it can, and what static friction held is held as long as it can. With these modes given,
# and what exceeds kinetic friction beyond the width taken as constant, the friction law rises with the velocity: there
# is one balance (above). From there a contact breaks whose friction would have to be larger, or stops that comes within
# the width, and what exceeds kinetic friction is known better: begun at none, it grows towards the fastest balance.
# Where none changes any more, Newton's method finds the balance of the law itself.


_PASSES, _PER_CONTACT, _POLISH = 12, 2, 3
_MODE = 1e-6  # of the width: how exactly the modes of a balance are those of its speeds
_KNOWN = 1e-3  # of the largest force: where Newton's method takes over


def balanced_in_modes(
    law: FrictionAt, speed: FloatArray, stiffness: FloatArray, slides: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The forces as of `balanced_forces`, and the sign of each contact that slides there, 0 where it is held; `slides`:
    that before.
    """
    given = law, speed, stiffness
    law, speed, stiffness, slides = without_derivatives((*given, slides))

    def again(state: tuple[Any, ...]) -> tuple[Any, ...]:
        slides, beyond, force, passes, _ = state
        within = dataclasses.replace(law, slides=slides, beyond=beyond)
        force = balanced_forces(within, speed, stiffness, force)
        sigma = speed - times(stiffness, force)
        breaks = (slides == 0) & (jnp.abs(sigma) > law.width * (1 + 1e-9))
        stops = (slides != 0) & (slides * sigma < law.width)
        following = jnp.where(breaks, jnp.sign(sigma), jnp.where(stops, 0, slides))
        more = jnp.where((following == 0) | breaks, 0, law(sigma) - within(sigma) + beyond)
        far = jnp.any(jnp.abs(more - beyond) > _KNOWN * largest_of(jnp.abs(force)))
        return following, more, force, passes + 1, far | jnp.any(breaks | stops)

    first = slides, jnp.zeros_like(speed), jnp.zeros_like(speed), jnp.int32(0), jnp.ones((), bool)
    most = _PASSES + _PER_CONTACT * len(speed)
    slides, _, force, *_ = lax.while_loop(lambda state: state[4] & (state[3] < most), again, first)
    in_modes = dataclasses.replace(law, slides=slides)
    for _ in range(_POLISH):
        value, slope = with_slope(in_modes, speed - times(stiffness, force))
        force = force + linear_solve(_newton_matrix(slope, stiffness), value - force)
    sigma = jnp.where(slides == 0, 1, slides) * (speed - times(stiffness, force)) / law.width
    fits = jnp.where(slides == 0, jnp.abs(sigma) <= 1 + _MODE, sigma >= 1 - _MODE)
    force = jnp.where(jnp.all(fits), force, jnp.nan)  # modes without a balance: the status is NOT_FINITE then
    (force,) = _force_root(dataclasses.replace(given[0], slides=slides), *given[1:], force)
    return force, slides


class ContactsField(SteppedField):
    """A system with several contacts, with friction regularised by `switch`."""

    model: ContactsModel
    criterion: Criterion
    switch: Switch
    static_exceeds_kinetic: bool = eqx.field(static=True)

    def rates(self, forcing: Any, tau: FloatArray, y: State) -> State:
        now = self.model.instant(forcing, tau, y)
        return moved(now.rates, 1.0, self.model.effect(forcing, tau, y, self._law(forcing, tau, y)(now.velocity)))

    def _law(self, forcing: Any, tau: FloatArray, y: State) -> FrictionAt:
        return FrictionAt(self.model, self.switch, self.static_exceeds_kinetic, forcing, tau, y)

    def free(self, forcing: Any, tau: FloatArray, y: State) -> State:
        return self.model.instant(forcing, tau, y).rates

    def band(self, forcing: Any, t: FloatArray, y: State) -> FloatArray | None:
        if not self.static_exceeds_kinetic:
            return None
        now = self.model.instant(forcing, jnp.zeros_like(t), y)
        held = self.model.limits(forcing, jnp.zeros_like(t), y, now.velocity).largest
        held = jnp.abs(acceleration(now.gain, jnp.zeros_like(held), held))
        scale = NOISE_ULPS * self.model.velocity_scale(forcing, y) + _TIME_ULPS * t * held
        return self.switch.width + lax.stop_gradient(jnp.finfo(t.dtype).eps * scale)

    def need(self, forcing: Any, tau: FloatArray, y: State, asked: BoolArray) -> FloatArray:
        # One after the other, as in exact dynamics. What is at its limit but for round-off no longer holds the others.
        now = self.model.instant(forcing, tau, y)
        limits = Limits(*(jnp.maximum(one, 0) for one in self.model.limits(forcing, tau, y, now.velocity)))
        question = Question(jnp.where(asked, 0, jnp.sign(now.velocity)), asked, jnp.zeros_like(asked), asked)
        slack = jnp.full_like(now.velocity, -_AT_LIMIT * jnp.finfo(tau.dtype).eps)
        found = settled(*without_derivatives((now.gain, now.drift, limits)), question, slack)
        holds = asked & (found.sign == 0)
        force = solved(now.gain, now.drift, limits.slip(found.sign), holds)
        return jnp.where(holds, jnp.abs(limits.share(force)), jnp.maximum(jnp.abs(found.share), 1))

    def held(self, forcing: Any, tau: FloatArray, y: State, band: FloatArray | None) -> FloatArray:
        velocity = self.model.instant(forcing, tau, y).velocity
        if band is None:
            return self._law(forcing, tau, y)(velocity)
        return jnp.where(jnp.abs(velocity) > band, jnp.sign(velocity), 0)

    def stage(
        self, forcing: Any, tau: FloatArray, base: State, expected: State, weight: FloatArray, held: FloatArray | None
    ) -> _Stage:
        assert held is not None
        model, free = self.model, partial(self.free, forcing, tau)
        rates, unit = free(expected), jnp.eye(len(held), dtype=tau.dtype)
        columns = jax.vmap(partial(model.effect, forcing, tau, expected), out_axes=-1)(unit)
        missing = (b - e + weight * r for b, e, r in zip(base, expected, rates, strict=True))
        sides = tuple(
            jnp.concatenate([m[..., None], weight * each], axis=-1) for m, each in zip(missing, columns, strict=True)
        )
        changes = model.implicit_changes(forcing, tau, expected, weight, sides)
        without, per_unit = tuple(part[..., 0] for part in changes), tuple(part[..., 1:] for part in changes)
        reached, velocity = moved(expected, 1.0, without), partial(model.relative_velocity, forcing, tau)
        speed, along = jax.linearize(velocity, reached)
        stiffness = -jax.vmap(along, in_axes=-1, out_axes=-1)(per_unit)
        law = self._law(forcing, tau, expected)
        if self.static_exceeds_kinetic:
            force, held = balanced_in_modes(law, speed, stiffness, held)
        else:
            force = held = balanced_forces(law, speed, stiffness, held)
        change = moved(without, 1.0, tuple(_of_all(part, force) for part in per_unit))
        _, turned = jax.jvp(free, (expected,), (change,))
        alone = moved(rates, 1.0, turned)
        end_rates = moved(alone, 1.0, tuple(_of_all(part, force) for part in columns))
        return _Stage(moved(expected, 1.0, change), end_rates, held, alone, expected, columns)

    def terms(self, forcing: Any, tau: FloatArray, weight: FloatArray, stage: _Stage) -> tuple[State, State]:
        now = self.model.instant(forcing, tau, stage.expected)
        jacobian = self.model.jacobian(forcing, tau, stage.expected)
        rates, in_parts = ravel_pytree(now.rates)
        terms = jacobian * ravel_pytree(stage.expected)[0][None, :]
        gross = jnp.abs(rates - jnp.sum(terms, axis=1)) + jnp.sum(jnp.abs(terms), axis=1)
        # As with one contact.
        fastest = jnp.sqrt(jnp.sum(jnp.abs(jacobian * jacobian.T)) + jnp.finfo(tau.dtype).tiny)
        coupled = times(jnp.abs(jacobian), gross)
        gross = gross + jnp.where(fastest * weight > 1e-9, coupled / fastest, 0)
        held = self.model.limits(forcing, tau, stage.expected, now.velocity).largest
        by_friction = jnp.concatenate([part.reshape(-1, len(held)) for part in stage.linear])
        return in_parts(gross), in_parts(times(jnp.abs(jacobian) @ jnp.abs(by_friction), held))


def _of_all(columns: FloatArray, force: FloatArray) -> FloatArray:
    """What the forces of all contacts do together, by the last axis of `columns`."""
    return jnp.sum(columns * jnp.expand_dims(force, range(columns.ndim - 1)), axis=-1)


class InnerField(AnyField):
    """A system whose friction has inner states and is smooth by itself.

    `in_logarithms`: whether adaptive steps follow the logarithm of the relative velocity.
    """

    model: InnerStates
    criterion: Criterion
    in_logarithms: bool = eqx.field(static=True, default=False)

    def rates(self, forcing: Any, tau: FloatArray, y: State) -> State:
        return self.model.rates(forcing, tau, y)

    @property
    def kinks(self) -> tuple[Scalar, ...]:
        return () if self.in_logarithms else (0.0,)

    def solved(self, forcing: Any, y: State) -> State:
        return super().solved(forcing, self.model.with_logarithm(forcing, y) if self.in_logarithms else y)

    def plain(self, forcing: Any, tau: FloatArray, numbers: State) -> State:
        y = super().plain(forcing, tau, numbers)
        return self.model.without_logarithm(forcing, tau, y) if self.in_logarithms else y

    def solved_rates(self, forcing: Any, tau: FloatArray, numbers: State) -> State:
        if self.in_logarithms:
            y = super().plain(forcing, tau, numbers)
            return self.model.numbers(self.model.rates_with_logarithm(forcing, tau, y))
        return super().solved_rates(forcing, tau, numbers)

    def elastic_slip(self, velocity: FloatArray, y: State) -> FloatArray:
        slips = jnp.stack([jnp.asarray(law.elastic_slip, velocity.dtype) for law in self.model.laws])
        return slips if self.model.contacts else slips[0] / self.model.slip_of_law(y)


def field_of(system: System, smooth: Signal | None, method: Regularized, *, base_jumps: bool = True) -> AnyField:
    """The field of `system` under a realised smooth excitation; `method`: with every option filled in. `base_jumps`:
    whether the velocity of the base may jump.
    """
    assert method.threshold is not None
    assert method.minimum_duration is not None
    criterion, inner = Criterion(method.threshold, method.minimum_duration), system.inner_model(smooth)
    if inner is not None:
        return InnerField(inner, criterion, in_logarithms=inner.spans_decades and not base_jumps)
    assert method.width is not None
    model, switch = system.switched_model(smooth, None), Switch(method.width, method.shape)
    if isinstance(model, ContactsModel):
        return ContactsField(model, criterion, switch, system.static_exceeds_kinetic)
    one = one_contact_model(system, smooth, None)
    return Field(one, criterion, switch, one.friction.static_exceeds_kinetic)
