"""Smooth switches in place of the sign of the relative velocity, and the balances of forces in a stage of an implicit
step: with one contact the root of one function, with several those of all together.
"""

import abc
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from ..._foundation.types import BoolArray, BoolScalar, FloatArray, FloatScalar, IntArray, Scalar
from ..._numerics.derivatives import OwnDerivative, without_derivatives
from ..._numerics.elementary import angle_of
from ..._numerics.matrices import linear_solve, times
from ..._systems.friction import FrictionLaw
from ..common.path import Bracket

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
        # Concave on the rise, so that a step can find the balance of forces from below (`balance`).
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


# Roots of equations, with derivatives by the implicit function theorem.


def root_of(residual: Callable[..., FloatArray], changed: Callable[..., FloatArray]) -> OwnDerivative:
    """A function of numbers and of the root of ``residual(*numbers, root) = 0`` that returns (root,), with its
    derivatives of every order.

    `changed`: the change of the root, from the numbers, the root and the change of the residual at this root.
    """
    found = OwnDerivative(lambda *args: args[-1:])

    @found.def_jvp
    def _(primals: Any, tangents: Any) -> Any:
        *given, root = primals
        (root,) = found(*given, lax.stop_gradient(root))
        _, change = eqx.filter_jvp(lambda *given: residual(*given, root), tuple(given), tuple(tangents[:-1]))
        return (root,), (changed(*given, root, change),)

    return found


def with_slope(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The value of a function and its slope."""
    return jax.jvp(function, (at,), (jnp.ones_like(at),))


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
