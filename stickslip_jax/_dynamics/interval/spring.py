"""Motion about the equilibrium of a spring, without a division by its stiffness, which may be zero.

Times in s, accelerations in m/s^2. Below, ``w2 = omega^2``. Derivatives are by ``w2``: all functions here are smooth in
it down to 0, where ``omega`` has no derivative.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..._numerics.elementary import arc_tangent, folded, sincos, unfolded
from ..._types import FloatArray

# Below this w2 t^2, and square of a tangent, slopes by w2 are summed as series.
_SMALL, _NARROW = 0.05, 0.01


class Spring(NamedTuple):
    """The squared angular frequency ``stiffness / mass`` (rad^2/s^2), and without a derivative: its root, and 1 over
    that, 0 where there is no spring.
    """

    squared: FloatArray
    omega: FloatArray
    inverse_omega: FloatArray  # multiplying costs a fifth of dividing

    @classmethod
    def of(cls, squared: FloatArray) -> "Spring":
        """The spring of this squared angular frequency; one too small to be a normal number is none."""
        fixed = lax.stop_gradient(squared)
        none = jnp.abs(fixed) < jnp.finfo(fixed.dtype).tiny
        omega = jnp.where(none, 0, jnp.sqrt(fixed))
        return cls(squared, omega, jnp.where(none, 0, 1 / jnp.where(none, 1, omega)))


@jax.custom_jvp
def quotient(acceleration: FloatArray, spring: Spring) -> FloatArray:
    """``acceleration / w2``, m; 0 without a spring."""
    return acceleration * (spring.inverse_omega * spring.inverse_omega)


@quotient.defjvp
def _quotient_jvp(primals, tangents):
    acceleration, spring = primals
    change, by_spring = tangents
    found = quotient(acceleration, spring)
    return found, quotient(change - found * by_spring.squared, spring)


@jax.custom_jvp
def swing(t: FloatArray, spring: Spring) -> tuple[FloatArray, FloatArray]:
    """``S = sin(omega t) / omega`` in s and ``C = (1 - cos(omega t)) / omega^2`` in s^2: t and t^2 / 2 if w2 = 0.

    From the position x, the velocity v and the acceleration -A the mass moves to ``x + v S - A C`` and has the velocity
    ``v (1 - w2 C) - A S`` then.
    """
    half = 0.5 * t
    sine, cosine = sincos(half * spring.omega)
    half = jnp.where(spring.omega > 0, sine * spring.inverse_omega, half)
    return 2 * half * cosine, 2 * half * half


@swing.defjvp
def _swing_jvp(primals, tangents):
    t, spring = primals
    dt, by_spring = tangents
    S, C = swing(t, spring)
    w2 = spring.squared
    cosine, z = 1 - w2 * C, w2 * t * t
    small = z < _SMALL
    over = 1 / jnp.where(small, 1, w2)
    of_S = jnp.where(small, -t * t * t / 6 * _series(z, 10, 28, 54, 88), 0.5 * over * (t * cosine - S))
    of_C = jnp.where(small, -t * t * t * t / 24 * _series(z, 15, 112 / 3, 67.5, 1056 / 10), over * (0.5 * t * S - C))
    return (S, C), (cosine * dt + of_S * by_spring.squared, S * dt + of_C * by_spring.squared)


def _series(z: FloatArray, *divisors: float) -> FloatArray:
    """``1 - z / a (1 - z / b (1 - ...))``."""
    result = jnp.ones_like(z)
    for divisor in divisors[::-1]:
        result = 1 - z * (1 / divisor) * result
    return result


@jax.custom_jvp
def to_meeting(
    A: FloatArray, v: FloatArray, q: FloatArray, H: FloatArray, side: FloatArray, spring: Spring
) -> tuple[FloatArray, FloatArray]:
    """Time and displacement from the state on an arc to its meeting with the velocity `q`, as `FirstArc` names them.

    Half the angle is ``atan2(omega |v - q|, H - A)`` or, on the same circle, ``atan2(H + A, -side omega (v + q))``.
    Each is free of cancellation where it is used, never negative, and 0 for a state already at the base velocity inside
    the band.
    """
    before, gap = A <= 0, jnp.abs(v - q)
    fold = folded(
        jnp.where(before, spring.omega * gap, H + A), jnp.where(before, H - A, -side * spring.omega * (v + q))
    )
    # Where the spring hardly turns the motion, its tangent is known over omega: then so is the time.
    flat = before & ~fold.is_steep & ~fold.is_high
    denominator = jnp.where(fold.denominator == 0, 1, fold.denominator)
    found = jnp.where(flat, gap, fold.numerator) / denominator
    part = arc_tangent(jnp.where(flat, spring.omega * found, found), found)
    time = 2 * jnp.where(flat, part, unfolded(part, fold) * spring.inverse_omega)
    return time, jnp.where(flat, (v + q) * found, -side * quotient(jnp.where(flat, 0, H + A), spring))


@to_meeting.defjvp
def _to_meeting_jvp(primals, tangents):
    A, v, q, H, side, spring = primals
    dA, dv, dq, dH, _, by_spring = tangents
    time, moved = to_meeting(A, v, q, H, side, spring)
    w2, d_w2 = spring.squared, by_spring.squared
    before, gap = A <= 0, -side * (v - q)
    # The angle is 2 atan(omega Y / X), or pi less that of the other form.
    X, Y = jnp.where(before, H - A, H + A), jnp.where(before, gap, -side * (v + q))
    dX, dY = jnp.where(before, dH - dA, dH + dA), -side * jnp.where(before, dv - dq, dv + dq)
    sign, half = jnp.where(before, 2, -2).astype(X.dtype), jnp.where(before, 0, half_turn(jnp.where(before, 1, w2)))
    over = X * X + w2 * Y * Y
    over = jnp.where(over > 0, 1 / jnp.where(over > 0, over, 1), 0)
    d_time = sign * over * (X * dY - Y * dX)
    slope = sign * slope_of_angle(Y, X, (time - half) / sign, w2)
    slope = slope - jnp.where(before, 0, 0.5 * half / jnp.where(before, 1, w2))
    flat = before & (w2 * Y * Y <= 0.17 * X * X) & (X > 0)
    tangent, per = jnp.where(flat, Y / jnp.where(flat, X, 1), 0), jnp.where(flat, 1 / jnp.where(flat, X, 1), 0)
    d_moved = (dv + dq) * tangent + (v + q) * per * (dY - tangent * dX)
    d_steep = -side * quotient(jnp.where(flat, 0, dH + dA + side * moved * d_w2), spring)
    return (time, moved), (d_time + slope * d_w2, jnp.where(flat, d_moved, d_steep))


def slope_of_angle(Y: FloatArray, X: FloatArray, angle: FloatArray, w2: FloatArray) -> FloatArray:
    """The derivative by w2 of ``atan(omega Y / X) / omega``, which is `angle`, for ``X >= 0``."""
    squared = w2 * Y * Y
    small = squared < _NARROW * X * X
    tangent = Y / jnp.where(small, X, 1)
    z, over = w2 * tangent * tangent, X * X + squared
    series = (
        -tangent * tangent * tangent / 3 * _series(z, 5 / 6, 14 / 15, 27 / 28, 44 / 45, 65 / 66, 90 / 91, 119 / 120)
    )
    exact = (X * Y / jnp.where(over > 0, over, 1) - angle) / (2 * jnp.where(small | (w2 <= 0), 1, w2))
    return jnp.where(small, series, exact)


def half_turn(w2: FloatArray) -> FloatArray:
    """``pi / omega``; 0 without a spring."""
    return jnp.where(w2 > 0, np.pi / jnp.sqrt(jnp.where(w2 > 0, w2, 1)), 0)
