"""The friction forces in several contacts at which a stage of an implicit step balances, with all their derivatives.

With the relative velocities ``sigma = speed - stiffness force`` that the forces (contacts,) leave of the `speed`
without friction, the forces are those of the regularised law, ``force = law(sigma)``. Where the law rises with the
velocity and the stiffness is positive definite there is one solution: the minimum of a convex function of gradient
``stiffness (force - law(sigma))``. Newton's method finds it. Where a step would overshoot the minimum, because contacts
pass their narrow bands of small relative velocity in it, it ends at the minimum along its direction.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from ..._numerics.own_derivative import OwnDerivative
from ..._numerics.primal import without_derivatives
from ..._numerics.small_matrices import linear_solve, times
from ..._types import BoolScalar, FloatArray, FloatScalar, IntArray

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
    force = _root(*without_derivatives((*given, guess)))
    (force,) = _balance(*given, force)
    return force


@OwnDerivative
def _balance(law: ForceLaw, speed: FloatArray, stiffness: FloatArray, force: FloatArray) -> tuple[FloatArray, ...]:
    """The balanced `force`, with its derivatives of every order."""
    return (force,)


@_balance.def_jvp
def _balance_jvp(primals, tangents):
    *given, force = primals
    (force,) = _balance(*given, lax.stop_gradient(force))

    def residual(law, speed, stiffness):
        return law(speed - times(stiffness, force)) - force

    _, change = eqx.filter_jvp(residual, tuple(given), tuple(tangents[:-1]))
    law, speed, stiffness = given
    _, slope = _with_slope(law, speed - times(stiffness, force))
    return (force,), (linear_solve(_newton_matrix(slope, stiffness), change),)


def _root(law: ForceLaw, speed: FloatArray, stiffness: FloatArray, guess: FloatArray) -> FloatArray:
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
    return jnp.where(error <= jnp.sqrt(eps), force, jnp.nan)


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
