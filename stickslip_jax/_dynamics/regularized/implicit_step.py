"""One step of fixed length of regularised dynamics, stable for any width: with one contact, whose balance of forces
is the root of one function, and with several, whose forces are balanced together.
"""

import abc
import math
from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from ..._foundation.types import BoolScalar, FloatArray, FloatScalar, IntArray, Scalar
from ..._numerics.derivatives import OwnDerivative, without_derivatives
from ..._numerics.elementary import angle_of
from ..._numerics.matrices import linear_solve, times
from ..._systems.contacts import ContactsModel
from ..._systems.friction import FrictionLaw
from ..._systems.switched_model import OneContactModel, State

# Smooth switches that replace the sign of the relative velocity in regularised dynamics.


SMOOTH: dict[str, Callable[[FloatArray], Array]] = {
    "tanh": jnp.tanh,
    "linear": lambda s: jnp.clip(s, -1, 1),
    "arctan": lambda s: (2 / math.pi) * jnp.where(s < 0, -1, 1) * angle_of(jnp.abs(s), jnp.ones_like(s)),
    "rational": lambda s: s / jnp.sqrt(1 + s * s),
}
"""The switch of each name in `SHAPES`."""


class Switch(eqx.Module):
    """Smooth switch ``phi(v_rel / width)`` in place of ``sgn(v_rel)``; `width` in m/s, `shape` one of `SMOOTH`."""

    width: Scalar
    shape: str = eqx.field(static=True)

    def __call__(self, ratio: FloatArray) -> FloatArray:
        """``phi(ratio)``, the smooth sign; `ratio`: relative velocity over width."""
        return SMOOTH[self.shape](ratio)

    def coefficient(self, friction: FrictionLaw, velocity: FloatArray) -> FloatArray:
        """The signed friction coefficient at the relative `velocity` (m/s), ``kinetic(|v_rel|) phi(v_rel / width)``.

        Where ``static`` exceeds ``kinetic``, friction holds up to one width: it rises from 0 to exactly ``static``
        there, the largest value, and falls off to ``kinetic`` within a few widths more. The long tails of the smooth
        shapes are left out: on them a mass would creep faster than at one width, and not stick.
        """
        static = friction.stick_limit(velocity) if friction.static_exceeds_kinetic else None
        return self.friction(velocity, friction.slip_coefficient(velocity), static)

    def friction(
        self, velocity: FloatArray, kinetic: Scalar | FloatArray, static: Scalar | FloatArray | None
    ) -> FloatArray:
        """The signed friction, a coefficient or a force, from that of a slip at this relative `velocity` (m/s).

        `static`: the largest one, where it exceeds the `kinetic` one, else None. See `coefficient`.
        """
        ratio = velocity / self.width
        if static is None:
            return kinetic * self(ratio)
        part, beyond = jnp.clip(ratio, -1, 1), jnp.maximum(jnp.abs(ratio) - 1, 0)
        # Concave on the rise, so that a step can find the balance of forces from below (`balance_with_static`).
        if self.shape == "linear":
            # A corner: from a smooth summit a mass would part as slowly as ``width^(2/3)``.
            held, left = static * part, jnp.exp(-beyond)
        else:
            held, left = static * part * (3 - part * part) / 2, jnp.exp(-beyond * beyond)
        slides = kinetic * part
        return jnp.where(jnp.abs(ratio) < 1, held, slides + (held - slides) * left)

    def creep(self, speed: Scalar | FloatArray) -> Scalar | FloatArray:
        """The approximate relative velocity (m/s) of a mass at its release from a stick.

        Before its release the mass creeps: friction balances the growing force at ``phi = force / largest``. The
        release is where the creep can no longer follow this balance: where the gap ``1 - phi`` equals the time, in
        units of ``speed / deceleration``, in which the excess force brings the mass to the speed of creep. This gives
        the powers of the width below (`speed`: the system's velocity scale, m/s; deceleration: that by friction). The
        factors are fitted: with them exits are neither early nor late on average in the Poisson-switching system of
        Lima and Sampaio, at widths of 1/50, 1/500 and 1/5000 of `speed`.
        """
        parts = jnp.maximum(speed / self.width, 1)
        widths = {
            "linear": jnp.ones_like(parts),
            "tanh": 0.45 + jnp.log(parts) / 4,
            "rational": 0.82 * parts**0.2,
            "arctan": 0.78 * parts ** (1 / 3),
        }
        return self.width * widths[self.shape]


# The relative velocity at which the forces of a stage of an implicit step balance, with all its derivatives.


_LEAST_STEEP = 1e-6  # of the balance of forces, 1 without friction; not above it at the edge of a jump


@OwnDerivative
def balance_root(
    switch: Switch, friction: FrictionLaw, size: FloatArray, stiffness: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, ...]:
    """The root `sigma` of ``sigma + stiffness mu(sigma) = size``, with its derivatives of every order."""
    return (sigma,)


@balance_root.def_jvp
def _balance_root_jvp(primals, tangents):
    *given, sigma = primals
    (sigma,) = balance_root(*given, lax.stop_gradient(sigma))

    def residual(switch, friction, size, stiffness):
        return sigma + stiffness * switch.coefficient(friction, sigma) - size

    _, change = eqx.filter_jvp(residual, tuple(given), tuple(tangents[:-1]))
    switch, friction, size, stiffness = given
    *_, steep = _missing(switch, friction, size, stiffness, sigma)
    return (sigma,), (-change / jnp.where(steep > _LEAST_STEEP, steep, 1),)


def _missing(
    switch: Switch, friction: FrictionLaw, size: FloatArray, stiffness: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """At `sigma` the friction coefficient, its slope, what is missing from the balance, and the slope of that."""
    value, slope = jax.jvp(lambda at: switch.coefficient(friction, at), (sigma,), (jnp.ones_like(sigma),))
    return value, slope, sigma + stiffness * value - size, 1 + stiffness * slope


# The balance of forces in a stage of an implicit step where static friction exceeds kinetic friction.
#
# Friction then falls off where a stick ends, and a step that does not resolve this fall has two balances: the mass
# sticks, or it slides. Which one holds follows from what the mass did before: a sliding mass slides as long as it can,
# and one that sticks does so as long as it can.


_RISE, _FALL = 7, 10  # iterations
_BALANCED = 1e-6  # of the largest friction: as good as equal


def balance_with_static(
    switch: Switch, friction: FrictionLaw, speed: FloatArray, stiffness: FloatArray, slides: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The signed friction coefficient at a root of ``sigma + stiffness mu(sigma) = speed``, and whether it slides.

    `slides`, and what is returned: the sign of the relative velocity of a mass that slides, 0 for one that sticks.
    """
    sign = jnp.where(speed < 0, -1.0, 1.0)
    given = switch, friction.in_direction(sign), jnp.abs(speed), stiffness
    switch, friction, size, stiffness = without_derivatives(given)
    missing = partial(_missing, switch, friction, size, stiffness)
    most = switch.width + stiffness * friction.static  # what a stick can take up
    least = _BALANCED * stiffness * friction.static
    # The fastest balance beyond the width, by Newton's method from above, and whether there is one.
    low, high, sliding = jnp.minimum(jnp.full_like(size, switch.width), size), size, size
    for _ in range(_FALL):
        _, _, rest, gain = missing(sliding)
        low, high = jnp.where(rest > 0, low, sliding), jnp.where(rest > 0, sliding, high)
        following = sliding - rest / jnp.where(gain > 0, gain, 1)
        sliding = jnp.where((gain > 0) & (following >= low) & (following <= high), following, (low + high) / 2)
    _, _, rest, gain = missing(sliding)
    balanced = (jnp.abs(rest) <= least) & (gain > 0) & (sliding > switch.width)
    breaks = size > most + least
    chosen = breaks | ((slides == sign) & balanced)
    # The balance in a stick, by Newton's method from below: the rise to static friction is concave.
    inside = switch.width * (1 - 1e-7)
    *_, steepest = missing(jnp.full_like(size, 1e-9) * switch.width)
    sticking = jnp.minimum(size / steepest, inside)
    for _ in range(_RISE):
        _, _, rest, gain = missing(sticking)
        sticking = jnp.clip(sticking - rest / jnp.maximum(gain, 1), 0, inside)
    sigma = jnp.where(chosen, sliding, sticking)
    _, slope, rest, gain = missing(sigma)
    last = slope * rest / jnp.where(gain > 0, gain, 1)  # one more Newton step
    (sigma,) = balance_root(*given, sigma)
    switch, friction, *_ = given
    return sign * (switch.coefficient(friction, sigma) - last), jnp.where(chosen, sign, 0)


# One step of fixed length of regularised dynamics, stable for any width.
#
# The method is the singly diagonally implicit Runge-Kutta method of order 2 with ``gamma = 1 - 1/sqrt(2)`` (Alexander
# 1977; L-stable). In each stage everything but the friction is linearised at a predicted state. One equation for the
# relative velocity remains, ``sigma + K mu(sigma) = sigma*`` with the signed friction coefficient mu (`_balance`). A
# step may be far longer than the time in which friction changes the relative velocity by one width: it then ends in the
# stick, as it should, where a step with linearised friction would overshoot it to and fro.
#
# The error of everything but the friction is estimated: the stages against the quadrature of order 3 at the same
# instants, and what is not linear in the last of them. What friction may change in a step does not count: it is no
# smooth function of time where a stick begins or ends, and no shorter step would do.


GAMMA = 1 - 1 / math.sqrt(2)
# The weights of the quadrature of order 3 at the instants 0, gamma and 1 of a step, less those of the method.
_SECOND, _LAST = 1 / (6 * GAMMA * (1 - GAMMA)), (2 - 3 * GAMMA) / (6 * (1 - GAMMA))
WEIGHTS = 1 - _SECOND - _LAST, _SECOND - (1 - GAMMA), _LAST - GAMMA
KINK = GAMMA * abs(WEIGHTS[1]) + abs(WEIGHTS[2])  # the most that friction adds to the estimate
# Allowed in a step, of what the terms of the equations of motion change in it, each alone: that of a harmonic motion in
# some 45 steps in a period, whose error is below a thousandth of the amplitude per radian.
ERROR = 1e-4
ROUND_OFF = 64  # units in the last place
_NEWTON = {"linear": 3, "tanh": 7, "rational": 7, "arctan": 7}


def implicit_step(
    model: OneContactModel, switch: Switch, forcing: object, y: State, h: FloatArray, band: FloatArray | None = None
) -> tuple[State, FloatArray | None]:
    """The state after one step of length `h` (s) from the state `y`, and its estimated error over the allowed one; None
    where the time scales, which the given step suits, are known.

    `band`: where static friction exceeds kinetic friction, the relative speed above which the mass slides (m/s).
    """
    speed = model.relative_velocity(forcing, jnp.zeros_like(h), y)
    slides = None if band is None else jnp.where(jnp.abs(speed) > band, jnp.sign(speed), 0)
    start = model.rates_under(forcing, jnp.zeros_like(h), y, switch.coefficient(model.friction_at(y), speed))
    expected = moved(y, GAMMA * h, start)
    middle = _stage(model, switch, forcing, GAMMA * h, y, expected, GAMMA * h, slides)
    base, expected = moved(y, (1 - GAMMA) * h, middle.rates), moved(y, h, middle.rates)
    end = _stage(model, switch, forcing, h, base, expected, GAMMA * h, middle.slides)
    if model.time_scales_are_known:
        return end.state, None
    model, forcing, y, h, middle, last = without_derivatives((model, forcing, y, h, middle, end))
    first = model.rates_under(forcing, jnp.zeros_like(h), y, jnp.zeros_like(h))
    after = model.rates_under(forcing, h, last.state, jnp.zeros_like(h))
    free = zip(first, middle.free, last.free, after, strict=True)
    errors = map(partial(_error, h), y, free, last.gross, last.kink)
    return end.state, reduce(jnp.maximum, errors, jnp.zeros_like(h))


def _error(
    h: FloatArray, value: FloatArray, free: Sequence[FloatArray], gross: FloatArray, kink: FloatArray
) -> FloatArray:
    """The estimated error of numbers of the state in a step from `value`, over the allowed one; at most 1 is accurate
    enough.

    `free`: their rates without friction at the beginning, in both stages, and after the step. `gross` and `kink`: of
    the last stage, see `_Stage`.
    """
    *_, end, after = free
    stages = zip(WEIGHTS, free[:-1], strict=True)
    error = h * (jnp.abs(sum(weight * rate for weight, rate in stages)) + GAMMA * jnp.abs(after - end))
    error = error - ROUND_OFF * jnp.finfo(h.dtype).eps * (jnp.abs(value) + h * gross) - KINK * h * h * kink
    allowed = ERROR * h * gross
    share = error / jnp.where(allowed > 0, allowed, 1)
    return jnp.where((error > 0) & (allowed > 0), share, 0)


class _Stage(NamedTuple):
    """A stage of a step: its state and rates, its rates without friction, and what these follow from.

    `slides`: None, or the sign of the relative velocity after it, 0 in a stick. `gross`: for each rate without friction
    the sum of its terms, each alone. `kink`: what friction could change in it, per s.
    """

    state: State
    rates: State
    slides: FloatArray | None
    free: State
    gross: State
    kink: State


def _stage(
    model: OneContactModel,
    switch: Switch,
    forcing: object,
    tau: FloatArray,
    base: State,
    expected: State,
    weight: FloatArray,
    slides: FloatArray | None,
) -> _Stage:
    """Solve the stage ``Y = base + weight f(tau, Y)``, linear at `expected` but for friction.

    `slides`: None, or the sign of the relative velocity before the stage, 0 in a stick.
    """

    def free(state):
        return model.rates_under(forcing, tau, state, jnp.zeros_like(tau))

    rates = free(expected)
    by_friction = tuple(
        a - b for a, b in zip(model.rates_under(forcing, tau, expected, jnp.ones_like(tau)), rates, strict=True)
    )
    jacobian = jax.jacfwd(free)(expected)
    size = len(base)
    matrix = [[(i == j) - weight * jacobian[i][j] for j in range(size)] for i in range(size)]
    missing = tuple(b - e + weight * r for b, e, r in zip(base, expected, rates, strict=True))
    without, per_unit = _solve(matrix, [list(missing), [weight * value for value in by_friction]])

    speed, gain = jax.jvp(
        lambda state: model.relative_velocity(forcing, tau, state), (moved(expected, 1.0, without),), (per_unit,)
    )
    if slides is None:
        coefficient = _balance(switch, model.friction_at(expected), speed, -gain)
    else:
        coefficient, slides = balance_with_static(switch, model.friction_at(expected), speed, -gain, slides)
    change = moved(without, coefficient, per_unit)
    _, turned = jax.jvp(free, (expected,), (change,))
    alone = tuple(r + t for r, t in zip(rates, turned, strict=True))
    end_rates = moved(alone, coefficient, by_friction)
    terms = [[part * value for part, value in zip(row, expected, strict=True)] for row in jacobian]
    gross = tuple(jnp.abs(r - sum(row)) + sum(map(jnp.abs, row)) for r, row in zip(rates, terms, strict=True))
    # Where a rate passes through zero: as large as those that it is coupled with make it in one radian of the motion.
    pairs = [jacobian[i][j] * jacobian[j][i] for i in range(size) for j in range(size)]
    fastest = jnp.sqrt(sum(map(jnp.abs, pairs)) + jnp.finfo(tau.dtype).tiny)
    coupled = [sum(jnp.abs(j) * g for j, g in zip(row, gross, strict=True)) for row in jacobian]
    gross = tuple(
        own + jnp.where(fastest * weight > 1e-9, of / fastest, 0) for own, of in zip(gross, coupled, strict=True)
    )
    held = jnp.abs(model.friction.static)
    kink = tuple(held * sum(jnp.abs(j * f) for j, f in zip(row, by_friction, strict=True)) for row in jacobian)
    return _Stage(moved(expected, 1.0, change), end_rates, slides, alone, gross, kink)


def _balance(switch: Switch, friction: FrictionLaw, speed: FloatArray, stiffness: FloatArray) -> FloatArray:
    """The signed friction coefficient ``mu(sigma)`` at the root of ``sigma + stiffness mu(sigma) = speed``.

    Newton's method from below, on the magnitude: mu is concave up to its largest value, so that no iterate
    overshoots. With ``mu_static > mu``: `balance_with_static`. The derivatives are those of the implicit function
    (`balance_root`).
    """
    sign = jnp.where(speed < 0, -1.0, 1.0)
    given = switch, friction.in_direction(sign), jnp.abs(speed), stiffness
    switch, friction, size, stiffness = without_derivatives(given)

    missing = partial(_missing, switch, friction, size, stiffness)
    *_, steepest = missing(jnp.full_like(size, 1e-9) * switch.width)
    sigma = jnp.maximum(size - stiffness * friction.static, size / steepest)
    for _ in range(_NEWTON[switch.shape]):
        _, _, rest, gain = missing(sigma)
        sigma = jnp.maximum(sigma - rest / jnp.maximum(gain, 1), 0)
    _, slope, rest, gain = missing(sigma)
    last = slope * rest / jnp.maximum(gain, 1)  # one more Newton step
    (sigma,) = balance_root(*given, sigma)
    switch, friction, *_ = given
    return sign * (switch.coefficient(friction, sigma) - last)


def _solve(matrix: list[list[FloatArray]], sides: list[list[FloatArray]]) -> list[State]:
    """Solve small linear systems by elimination.

    Without pivoting, which steps shorter than the time scales do not need: the matrix is near the identity, or has a
    large positive diagonal where a state decays fast.
    """
    rows = [[*line, *(side[i] for side in sides)] for i, line in enumerate(matrix)]
    size = len(rows)
    for i in range(size):
        per = 1 / rows[i][i]
        rows[i] = [value * per for value in rows[i]]
        for j in range(size):
            if j != i:
                factor = rows[j][i]
                rows[j] = [a - factor * b for a, b in zip(rows[j], rows[i], strict=True)]
    return [tuple(rows[i][size + k] for i in range(size)) for k in range(len(sides))]


def moved(y: State, h: FloatArray | float, rates: State) -> State:
    """``y + h rates``."""
    return tuple(value + h * rate for value, rate in zip(y, rates, strict=True))


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
        value, slope = _with_slope(law, sigma)
        change = linear_solve(_newton_matrix(slope, stiffness), value - force)
        moved = times(stiffness, change)  # sigma falls by this
        scale = jnp.abs(speed) + times(jnp.abs(stiffness), jnp.abs(force))
        error = jnp.max(jnp.abs(moved) / jnp.where(scale > 0, scale, 1))
        return force + _share(law, sigma, force, moved, change) * change, error, tries + 1

    def goes_on(state: tuple[FloatArray, FloatScalar, IntArray]) -> BoolScalar:
        _, error, tries = state
        return (error > _ULPS * eps) & (tries < _MOST)

    force, error, _ = lax.while_loop(goes_on, again, (guess, jnp.full((), jnp.inf, speed.dtype), jnp.int32(0)))
    (force,) = _contacts_balance(*given, jnp.where(error <= jnp.sqrt(eps), force, jnp.nan))
    return force


@OwnDerivative
def _contacts_balance(
    law: ForceLaw, speed: FloatArray, stiffness: FloatArray, force: FloatArray
) -> tuple[FloatArray, ...]:
    """The balanced `force`, with its derivatives of every order."""
    return (force,)


@_contacts_balance.def_jvp
def _balance_jvp(primals, tangents):
    *given, force = primals
    (force,) = _contacts_balance(*given, lax.stop_gradient(force))

    def residual(law, speed, stiffness):
        return law(speed - times(stiffness, force)) - force

    _, change = eqx.filter_jvp(residual, tuple(given), tuple(tangents[:-1]))
    law, speed, stiffness = given
    _, slope = _with_slope(law, speed - times(stiffness, force))
    return (force,), (linear_solve(_newton_matrix(slope, stiffness), change),)


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

    def narrower(bracket: _Bracket, share: FloatScalar) -> _Bracket:
        here = downhill(share)
        is_low = here >= 0
        low, high = jnp.where(is_low, share, bracket.low), jnp.where(is_low, bracket.high, share)
        return _Bracket(low, high, jnp.where(is_low, here, bracket.of_low), jnp.where(is_low, bracket.of_high, here))

    bracket = _Bracket(low, high, downhill(low), downhill(high))
    if not law.is_straight:  # of long tails a secant sees little
        bracket = lax.fori_loop(0, _HALVINGS, lambda _, b: narrower(b, (b.low + b.high) / 2), bracket)
    for _ in range(_SECANTS):
        bracket = narrower(bracket, bracket.by_secant)
    return jnp.where(at_end >= -_OVERSHOT * at_start, all_of_it, bracket.by_secant)


class _Bracket(NamedTuple):
    """Two parts of a step between which the slope along it changes its sign, and the slopes there."""

    low: FloatScalar
    high: FloatScalar
    of_low: FloatScalar
    of_high: FloatScalar

    @property
    def by_secant(self) -> FloatScalar:
        total = self.of_low - self.of_high
        share = jnp.where(total > 0, self.of_low / jnp.where(total > 0, total, 1), 0.5)
        return self.low + (self.high - self.low) * share


def _with_slope(law: ForceLaw, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    return jax.jvp(law, (velocity,), (jnp.ones_like(velocity),))


def _newton_matrix(slope: FloatArray, stiffness: FloatArray) -> FloatArray:
    return jnp.eye(len(slope), dtype=slope.dtype) + slope[:, None] * stiffness


# One step of fixed length of regularised dynamics with several contacts, stable for any width.
#
# The method and its estimated error are those of `implicit_step`. In each stage everything but the friction is
# linearised at a predicted state; one equation for each contact remains, and all are solved together
# (`balanced_forces`).


class FrictionAt(ForceLaw):
    """The regularised friction forces at one instant and state."""

    model: ContactsModel
    switch: Switch
    static_exceeds_kinetic: bool = eqx.field(static=True)
    forcing: object
    tau: FloatScalar
    y: State

    def __call__(self, velocity: FloatArray) -> FloatArray:
        limits = self.model.limits(self.forcing, self.tau, self.y, velocity)
        # A contact without a positive normal force is open.
        kinetic = jnp.maximum(jnp.where(velocity < 0, limits.backward, limits.forward), 0)
        static = jnp.maximum(limits.static(velocity), 0) if self.static_exceeds_kinetic else None
        return self.switch.friction(velocity, kinetic, static)

    @property
    def width(self) -> FloatArray:
        return jnp.asarray(self.switch.width, self.tau.dtype)

    @property
    def is_straight(self) -> bool:
        return self.switch.shape == "linear"


def contacts_step(
    model: ContactsModel, switch: Switch, forcing: object, y: State, h: FloatArray
) -> tuple[State, FloatArray | None]:
    """The state after one step of length `h` (s) from the state `y`, and its estimated error over the allowed one; None
    where the time scales, which the given step suits, are known.
    """
    start = FrictionAt(model, switch, False, forcing, jnp.zeros_like(h), y)
    now = model.instant(forcing, start.tau, y)
    force = start(now.velocity)
    rates = moved(now.rates, 1.0, model.effect(forcing, start.tau, y, force))
    middle = _contacts_stage(model, switch, forcing, GAMMA * h, y, moved(y, GAMMA * h, rates), GAMMA * h, force)
    base, expected = moved(y, (1 - GAMMA) * h, middle.rates), moved(y, h, middle.rates)
    end = _contacts_stage(model, switch, forcing, h, base, expected, GAMMA * h, middle.force)
    if model.time_scales_are_known:
        return end.state, None
    model, forcing, y, h, middle, last = without_derivatives((model, forcing, y, h, middle, end))
    first = model.instant(forcing, jnp.zeros_like(h), y).rates
    after = model.instant(forcing, h, last.state).rates
    # Of each rate without friction the sum of its terms, each alone, and what friction could change in it, per s.
    now, jacobian = model.instant(forcing, h, last.expected), model.jacobian(forcing, h, last.expected)
    terms = jacobian * ravel_pytree(last.expected)[0][None, :]
    gross = jnp.abs(ravel_pytree(now.rates)[0] - jnp.sum(terms, axis=1)) + jnp.sum(jnp.abs(terms), axis=1)
    # Where a rate passes through zero: as large as those that it is coupled with make it in one radian of the motion.
    fastest = jnp.sqrt(jnp.sum(jnp.abs(jacobian * jacobian.T)) + jnp.finfo(h.dtype).tiny)
    coupled = times(jnp.abs(jacobian), gross)
    gross = gross + jnp.where(fastest * (GAMMA * h) > 1e-9, coupled / fastest, 0)
    held = model.limits(forcing, h, last.expected, now.velocity).largest
    by_friction = jnp.concatenate([part.reshape(-1, len(held)) for part in last.columns])
    kink = times(jnp.abs(jacobian) @ jnp.abs(by_friction), held)
    value, *free = (ravel_pytree(part)[0] for part in (y, first, middle.free, last.free, after))
    return end.state, jnp.max(_error(h, value, free, gross, kink))


class _ContactsStage(NamedTuple):
    """A stage of a step: its state, rates and friction forces, its rates without friction, and what these follow from.

    `expected`: the state at which it is linear. `columns`: what a unit of friction in each contact adds to the rates.
    """

    state: State
    rates: State
    force: FloatArray
    free: State
    expected: State
    columns: State


def _contacts_stage(
    model: ContactsModel,
    switch: Switch,
    forcing: object,
    tau: FloatArray,
    base: State,
    expected: State,
    weight: FloatArray,
    guess: FloatArray,
) -> _ContactsStage:
    """Solve the stage ``Y = base + weight f(tau, Y)``, linear at `expected` but for friction.

    `guess`: of the friction forces.
    """

    def free(state):
        return model.instant(forcing, tau, state).rates

    def velocity(state):
        return model.relative_velocity(forcing, tau, state)

    rates = free(expected)
    unit = jnp.eye(len(guess), dtype=tau.dtype)
    columns = jax.vmap(lambda force: model.effect(forcing, tau, expected, force), out_axes=-1)(unit)
    missing = (b - e + weight * r for b, e, r in zip(base, expected, rates, strict=True))
    sides = tuple(
        jnp.concatenate([m[..., None], weight * each], axis=-1) for m, each in zip(missing, columns, strict=True)
    )
    changes = model.implicit_changes(forcing, tau, expected, weight, sides)
    without, per_unit = tuple(part[..., 0] for part in changes), tuple(part[..., 1:] for part in changes)

    reached = moved(expected, 1.0, without)
    speed, along = jax.linearize(velocity, reached)
    stiffness = -jax.vmap(along, in_axes=-1, out_axes=-1)(per_unit)
    law = FrictionAt(model, switch, False, forcing, tau, expected)
    force = balanced_forces(law, speed, stiffness, guess)
    change = moved(without, 1.0, tuple(_of_all(part, force) for part in per_unit))
    _, turned = jax.jvp(free, (expected,), (change,))
    alone = moved(rates, 1.0, turned)
    end_rates = moved(alone, 1.0, tuple(_of_all(part, force) for part in columns))
    return _ContactsStage(moved(expected, 1.0, change), end_rates, force, alone, expected, columns)


def _of_all(columns: FloatArray, force: FloatArray) -> FloatArray:
    """What the forces of all contacts do together, by the last axis of `columns`."""
    return jnp.sum(columns * jnp.expand_dims(force, range(columns.ndim - 1)), axis=-1)
