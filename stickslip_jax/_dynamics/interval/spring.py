"""Motion about the equilibrium of a spring, without a division by its stiffness, which may be zero.

Times in s, accelerations in m/s^2; ``w2 = omega^2``. Derivatives are by ``w2``: all functions here are smooth in it
down to 0, where ``omega`` has no derivative.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..._compiler import computed_once
from ..._numerics.elementary import TAN_PI_8, arc_tangent, folded, sincos, unfolded
from ..._types import BoolArray, FloatArray

# Below this w2 t^2, and square of a tangent, slopes by w2 are summed as series.
_SMALL, _NARROW = 0.05, 0.01
# The softest spring, rad/s: within round-off, ``sin(omega t) / omega`` is t then, and no square of it overflows.
_SOFTEST = {8: 1e-100, 4: 1e-15}


class Spring(NamedTuple):
    """The squared angular frequency ``stiffness / mass`` (rad^2/s^2), and without a derivative: its root, for no spring
    that of the softest, and 1 over that.
    """

    squared: FloatArray
    omega: FloatArray
    inverse_omega: FloatArray  # multiplying costs a fifth of dividing

    @classmethod
    def of(cls, squared: FloatArray) -> "Spring":
        """The spring of this squared angular frequency."""
        softest = _SOFTEST[squared.dtype.itemsize]
        fixed = lax.stop_gradient(squared)
        omega = jnp.where(jnp.abs(fixed) < softest**2, softest, jnp.sqrt(fixed))
        return cls(squared, omega, 1 / omega)


@jax.custom_jvp
def quotient(acceleration: FloatArray, needed: BoolArray, spring: Spring) -> FloatArray:
    """``acceleration / w2``, m, with its derivative where it is `needed`, for a spring that is not too soft."""
    return acceleration * (spring.inverse_omega * spring.inverse_omega)


@quotient.defjvp
def _quotient_jvp(primals, tangents):
    acceleration, needed, spring = primals
    change, _, by_spring = tangents
    found = quotient(acceleration, needed, spring)
    change = change - jnp.where(needed, found, 0) * by_spring.squared
    return found, quotient(jnp.where(needed, change, 0), needed, spring)


def swung(x: FloatArray, v: FloatArray, A: FloatArray, t: FloatArray, spring: Spring) -> tuple[FloatArray, FloatArray]:
    """Position and velocity after the time t, from the position x, the velocity v and the deceleration A.

    As after half the time, the velocity is ``v cos - A sin / omega`` of half the angle, and the deceleration
    ``A cos + omega v sin``; both changes are those times ``2 sin / omega``.
    """
    twice, cosine = _half_swing(t, spring)
    half = 0.5 * twice
    return x + twice * (v * cosine - A * half), v - twice * (A * cosine + v * (spring.squared * half))


@jax.custom_jvp
def _half_swing(t: FloatArray, spring: Spring) -> tuple[FloatArray, FloatArray]:
    """``2 sin(omega t / 2) / omega`` in s, which is t without a spring, and ``cos(omega t / 2)``."""
    sine, cosine = sincos((0.5 * spring.omega) * t)
    return sine * (2 * spring.inverse_omega), cosine


@_half_swing.defjvp
def _half_swing_jvp(primals, tangents):
    t, spring = primals
    dt, by_spring = tangents
    twice, cosine = _half_swing(t, spring)
    w2, d_w2 = spring.squared, by_spring.squared
    z = 0.25 * w2 * t * t
    small = z < _SMALL
    series = -t * t * t / 24 * _series(z, 10.0, 28.0, 54.0, 88.0)
    slope = jnp.where(small, series, (t * cosine - twice) / (2 * jnp.where(small, 1, w2)))
    return (twice, cosine), (cosine * dt + slope * d_w2, -0.25 * twice * (w2 * dt + 0.5 * t * d_w2))


def _series(z: FloatArray, *divisors: float) -> FloatArray:
    """``1 - z / a (1 - z / b (1 - ...))``."""
    result = jnp.ones_like(z)
    for divisor in divisors[::-1]:
        result = 1 - z * (1 / divisor) * result
    return result


@jax.custom_jvp
def to_meeting(
    A: FloatArray, v: FloatArray, q: FloatArray, H: FloatArray, side: FloatArray, spring: Spring
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Time and displacement from the state on an arc to its meeting with the velocity `q`, as `FirstArc` names them.

    Half the angle is ``atan2(omega |v - q|, H - A)`` or, on the same circle, ``atan2(H + A, -side omega (v + q))``.
    Each is free of cancellation where it is used, never negative, and 0 for a state already at the base velocity inside
    the band. The displacement is known only where the spring hardly turns the motion, and that is the third result: it
    is the mean velocity by the time, both as tangents of half the angle.
    """
    y, x = _half_angle(A, v, q, H, side, spring)
    fold = folded(y, x)
    tangent = fold.numerator / jnp.where(fold.denominator == 0, 1, fold.denominator)
    time = 2 * spring.inverse_omega * unfolded(arc_tangent(tangent), fold)
    return time, (v + q) * (tangent * spring.inverse_omega), (A <= 0) & (y <= TAN_PI_8 * x)


@computed_once
def _half_angle(A, v, q, H, side, spring):
    before, far = A <= 0, H + jnp.abs(A)
    turned = spring.omega * jnp.where(before, jnp.abs(v - q), v + q)
    return jnp.where(before, turned, far), jnp.where(before, far, -side * turned)


@to_meeting.defjvp
def _to_meeting_jvp(primals: Any, tangents: Any) -> Any:  # of the truth there is no tangent
    A, v, q, H, side, spring = primals
    dA, dv, dq, dH, _, by_spring = tangents
    time, moved, flat = to_meeting(A, v, q, H, side, spring)
    w2, before = spring.squared, A <= 0
    # The angle is 2 atan(omega Y / X), or pi less that of the other form.
    X, Y = jnp.where(before, H - A, H + A), -side * jnp.where(before, v - q, v + q)
    dX, dY = jnp.where(before, dH - dA, dH + dA), -side * jnp.where(before, dv - dq, dv + dq)
    sign, half = jnp.where(before, 2, -2).astype(X.dtype), jnp.where(before, 0, half_turn(jnp.where(before, 1, w2)))
    over = X * X + w2 * Y * Y
    over = jnp.where(over > 0, 1 / jnp.where(over > 0, over, 1), 0)
    slope = sign * slope_of_angle(Y, X, (time - half) / sign, w2)
    slope = slope - jnp.where(before, 0, 0.5 * half / jnp.where(before, 1, w2))
    d_time = sign * over * (X * dY - Y * dX) + slope * by_spring.squared
    per = jnp.where(flat & (X > 0), 1 / jnp.where(flat & (X > 0), X, 1), 0)
    tangent = Y * per
    d_moved = (dv + dq) * tangent + (v + q) * per * (dY - tangent * dX)
    return (time, moved, flat), (d_time, d_moved, np.zeros(flat.shape, jax.dtypes.float0))


@jax.custom_jvp
def time_until(lacks: FloatArray, rate: FloatArray, limit: FloatArray) -> FloatArray:
    """``lacks / rate``, infinite at the rate 0; with a derivative where it is at most `limit`."""
    moving = rate > 0
    return jnp.where(moving, lacks / jnp.where(moving, rate, 1), jnp.inf)


@time_until.defjvp
def _time_until_jvp(primals, tangents):
    lacks, rate, limit = primals
    d_lacks, d_rate, _ = tangents
    found = time_until(lacks, rate, limit)
    due = (rate > 0) & (found <= limit)
    change = (jnp.where(due, d_lacks, 0) - jnp.where(due, found, 0) * d_rate) / jnp.where(due, rate, 1)
    return found, change


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
