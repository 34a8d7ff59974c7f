"""Closed forms of the motion while the base velocity stays constant: arcs, and one interval of the base."""

import math
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ..._compiler.native import computed_once
from ..._foundation.types import BoolArray, FloatArray, IntArray, Scalar, Status
from ..._numerics.elementary import TAN_PI_8, angle_of, arc_tangent, folded, sincos, unfolded
from ..._systems.mass_spring import MassSpring
from ..sticks import Remembered, StickRecord, StickSpan, Totals, begin_quantities, ending_of, recorded, start_totals

# Motion about the equilibrium of a spring, without a division by its stiffness, which may be zero.
#
# Times in s, accelerations in m/s^2; ``w2 = omega^2``. Derivatives are by ``w2``: all functions here are smooth in it
# down to 0, where ``omega`` has no derivative.


# Below this w2 t^2, and square of a tangent, slopes by w2 are summed as series.
_SMALL, _NARROW = 0.05, 0.01
# The softest spring, rad/s: within round-off, ``sin(omega t) / omega`` is t then, and no square of it overflows.
_SOFTEST = {8: 1e-100, 4: 1e-15}


class SpringScales(NamedTuple):
    """The squared angular frequency ``stiffness / mass`` (rad^2/s^2), and without a derivative: its root, for no spring
    that of the softest, and 1 over that.
    """

    squared: FloatArray
    omega: FloatArray
    inverse_omega: FloatArray  # multiplying costs a fifth of dividing

    @classmethod
    def of(cls, squared: FloatArray) -> "SpringScales":
        """The spring of this squared angular frequency."""
        softest = _SOFTEST[squared.dtype.itemsize]
        fixed = lax.stop_gradient(squared)
        omega = jnp.where(jnp.abs(fixed) < softest**2, softest, jnp.sqrt(fixed))
        return cls(squared, omega, 1 / omega)


@jax.custom_jvp
def quotient(acceleration: FloatArray, needed: BoolArray, spring: SpringScales) -> FloatArray:
    """``acceleration / w2``, m, with its derivative where it is `needed`, for a spring that is not too soft."""
    return acceleration * (spring.inverse_omega * spring.inverse_omega)


@quotient.defjvp
def _quotient_jvp(primals, tangents):
    acceleration, needed, spring = primals
    change, _, by_spring = tangents
    found = quotient(acceleration, needed, spring)
    change = change - jnp.where(needed, found, 0) * by_spring.squared
    return found, quotient(jnp.where(needed, change, 0), needed, spring)


def swung(
    x: FloatArray, v: FloatArray, A: FloatArray, t: FloatArray, spring: SpringScales
) -> tuple[FloatArray, FloatArray]:
    """Position and velocity after the time t, from the position x, the velocity v and the deceleration A.

    As after half the time, the velocity is ``v cos - A sin / omega`` of half the angle, and the deceleration
    ``A cos + omega v sin``; both changes are those times ``2 sin / omega``.
    """
    twice, cosine = _half_swing(t, spring)
    half = 0.5 * twice
    return x + twice * (v * cosine - A * half), v - twice * (A * cosine + v * (spring.squared * half))


@jax.custom_jvp
def _half_swing(t: FloatArray, spring: SpringScales) -> tuple[FloatArray, FloatArray]:
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
    A: FloatArray, v: FloatArray, q: FloatArray, H: FloatArray, side: FloatArray, spring: SpringScales
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


# Closed forms of the motion while the base velocity stays constant.
#
# Times in s, positions in m, velocities in m/s; nothing is divided by the stiffness, which may be zero (see above).
# ``alpha = mu n / m`` is the deceleration by friction, ``w2 = omega^2 = k / m``. The formulas are for a base that moves
# forward, at the speed ``q = |base velocity| >= 0``; for a backward one the state is mirrored (`carry_across`).
#
# In the plane of ``omega x`` and velocity, slip below the base velocity circles about ``+alpha / omega``, slip above it
# about ``-alpha / omega`` (Lima and Sampaio, conference paper, eq. 3). With ``side = +1`` below and ``-1`` above, the
# rules that follow from this geometry are the same for both. In accelerations, the lengths there times omega:
#
# - offset from the centre, towards the side: ``A = side w2 x - alpha``, the deceleration; radius
#   ``R^2 = A^2 + w2 v^2``;
# - the arc meets the base velocity at distance ``H = sqrt(R^2 - w2 q^2)`` from the centre, where
#   ``w2 x = side (alpha - H)``;
# - the mass sticks there if ``H <= 2 alpha``; otherwise it crosses to the other side, and meets the base velocity next
#   at distance ``H - 2 alpha`` from the other centre, and so on.
#
# Without a spring ``H = alpha``: every meeting is a stick, which lasts as long as the base velocity.


# After a release at base velocity w the arc has R = w exactly. If the base velocity returns to w while the mass is on
# that arc (perhaps after a rest, or half a turn about the other centre), the arc is tangent to it, and round-off must
# not create a stick there. The error of R^2 - q^2, in units in the last place of the terms in `_meeting`, grows with
# the square root of the number of intervals: 80 after 10^4. With this threshold a true arrival is missed only if its
# stick is shorter than about 1e-6 R/q (float64), which happens once in 10^12 arcs.
_TOUCH_ULPS = {8: 4096, 4: 64}
# Tolerance, in units in the last place, within which a mass on a base at rest counts as resting inside the band: of
# its offset, and of its velocity beside the one that friction stops in 1 / omega, or in t1 where that is shorter.
_REST_ULPS = 128
# How far round-off can have moved the state, in units in the last place of the numbers involved: three times its error
# after 10^4 intervals, which grows with the square root of their number. By chance, 4 of 10^12 intervals of the default
# study come so close to an event (float32: 4 of 10^4).
NEAR_ULPS = {8: 256, 4: 64}
CLOCK_ULPS = 4  # the round-off of the time at which an interval begins, in units in the last place
# The longest interval, rad: the last place of a larger angle exceeds 1e-7. Longer intervals give NaN (`NOT_FINITE`).
_LONGEST_SPAN = 2.0**30


class Scales(NamedTuple):
    """Parameters of the closed forms: the spring, the `deceleration` by friction ``mu n / m`` (m/s^2), the speed below
    which a mass on a base at rest rests (m/s, without a derivative), and the horizon `t1`, s.
    """

    spring: SpringScales
    deceleration: FloatArray
    rest_speed: FloatArray
    t1: FloatArray

    @classmethod
    def of(cls, squared: FloatArray, deceleration: FloatArray, t1: FloatArray) -> "Scales":
        """The scales for a squared angular frequency (rad^2/s^2), a deceleration and a horizon."""
        scales = cls(SpringScales.of(squared), deceleration, t1, t1)
        rest_speed = _REST_ULPS * jnp.finfo(squared.dtype).eps * deceleration * scales.clock
        return scales._replace(rest_speed=lax.stop_gradient(rest_speed))

    @property
    def clock(self) -> FloatArray:
        """The time in which the velocity changes by friction at most: 1 / omega, or t1 where that is shorter, s."""
        return jnp.where(self.spring.omega * self.t1 > 1, self.spring.inverse_omega, self.t1)


class IntervalPassage(NamedTuple):
    """Result of one interval: the state at its end and its stick, if any; `entered`, `left`: times since its start, s.

    `position`, `left_at`: where the stick begins and ends. `released`: whether friction gave way, after a stick or
    where the mass arrived. `tie`: whether the mass arrived for no time.
    """

    x: FloatArray
    v: FloatArray
    entered: FloatArray
    left: FloatArray
    position: FloatArray
    left_at: FloatArray
    stuck: BoolArray
    released: BoolArray
    tie: BoolArray


class FirstArc(NamedTuple):
    """The arc from an interval's first state: its `side`, its offset `A` from the centre and the velocity `v`.

    It meets the base velocity at the distance `H` from the centre, after `time`; `excess` ``= H^2 = R^2 - w2 q^2``.
    `arrives`: whether it does so within the interval. `position`: where, if `is_flat` (see `to_meeting`).
    """

    side: FloatArray
    A: FloatArray
    v: FloatArray
    excess: FloatArray
    H: FloatArray
    time: FloatArray
    position: FloatArray
    is_flat: BoolArray
    arrives: BoolArray


_LastMeeting: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, BoolArray]
"""The last arc that begins in the interval, as seen from the base velocity: its side and distance H; the time at which
it meets it, or else began; and whether the mass has arrived inside the stick band.
"""


def carry_across(
    x: FloatArray, v: FloatArray, base: FloatArray, scales: Scales, span: FloatArray, began: FloatArray,
    *, moving: bool = False,
) -> IntervalPassage:  # fmt: skip
    """Carry the state ``(x, v)`` across an interval of the base velocity `base`, from `began` on for `span` (s).

    There is at most one stick: after a release the mass moves on a circle tangent to the base velocity from below.
    `moving`: whether it is known that the base is not at rest, which saves a tenth of the work.
    """
    mirror, x, v, q, turned, span = mirrored(x, v, base, scales, span)
    first = first_arc(x, v, q, turned, scales, span, moving=moving)
    given = first.side, first.H, first.time, first.arrives, q, turned, scales.deceleration, scales.spring, span
    last = _follow_crossings(*given)
    _, _, entered, arrived = last
    position, left_at, left, released, stuck = _stick(first, last, q, scales, span, began)
    x, v, A, time = _last_rotation(x, first, last, left_at, left, q, span)
    x_end, v_end = swung(x, v, A, time, scales.spring)
    x_end = x_end + 0 * first.excess  # a radius whose square overflows would miss its arrivals: NaN (`NOT_FINITE`)
    position, left_at, tie = mirror * position, mirror * left_at, arrived & ~stuck
    return IntervalPassage(mirror * x_end, mirror * v_end, entered, left, position, left_at, stuck, released, tie)


@computed_once
def mirrored(x, v, base, scales, span):
    mirror = jnp.where(base < 0, -1, 1).astype(x.dtype)
    known = scales.spring.omega * span < _LONGEST_SPAN
    q = jnp.abs(base)
    return mirror, mirror * x, mirror * v, q, scales.spring.omega * q, jnp.where(known, span, jnp.nan)


@computed_once
def _stick(
    first: FirstArc, last: _LastMeeting, q: FloatArray, scales: Scales, span: FloatArray, began: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray, BoolArray]:
    """The stick from the last meeting at ``w2 x = side (alpha - H)`` until the spring reaches the friction limit at
    alpha: where it begins and ends; when it is left; whether friction gave way; if it is one.
    """
    side, H, entered, arrived = last
    alpha, spring = scales.deceleration, scales.spring
    is_flat = first.is_flat & ~(first.arrives & is_crossed(first.H, alpha))  # and not crossed
    # After a crossing that has led to no arrival: where the crossing was, H beyond the centre.
    elsewhere = side * quotient(alpha - jnp.where(arrived, H, -H), ~is_flat & first.arrives, spring)
    position = jnp.where(is_flat, first.position, elsewhere)
    lacks, rate = jnp.where(side > 0, H, 2 * alpha - H), spring.squared * q
    release = entered + time_until(lacks, rate, span)
    released = arrived & (release <= span)
    left = jnp.where(released, release, span)
    left_at = position + jnp.where(arrived, q * (left - entered), 0)
    # An interval without length is no stick. With the error of the velocity, that of the instant of an arrival is this
    # error / H (near a tangency less than the square root of it). From below a release has the same error: it cancels.
    length = left - entered - CLOCK_ULPS * float(jnp.finfo(H.dtype).eps) * began
    # The round-off of the velocity on an arc from which the mass can stick, of radius 2 alpha + omega q at most.
    speed_error = few(q) * q + 3 * NEAR_ULPS[q.dtype.itemsize] / _REST_ULPS * scales.rest_speed
    least = jnp.where(released & (side > 0), 0, speed_error)
    lasts = (lacks > 4 * few(H) * alpha) & (length * H > least)
    lasts = lasts | (length > math.sqrt(few(H)) * scales.clock)
    return position, left_at, left, released, arrived & lasts


def is_crossed(H: FloatArray, alpha: FloatArray) -> BoolArray:
    """Whether friction cannot hold a mass that meets the base velocity. At the limit it does: a crossing there would be
    one of no motion, which on a base at rest lasts for half a turn.
    """
    return (2 + 2 * few(H)) * alpha < H


def few(like: FloatArray) -> float:
    """The relative round-off of what depends on the state, see `NEAR_ULPS`."""
    return NEAR_ULPS[like.dtype.itemsize] * float(jnp.finfo(like.dtype).eps)


@computed_once
def _last_rotation(
    x: FloatArray,
    first: FirstArc,
    last: _LastMeeting,
    left_at: FloatArray,
    left: FloatArray,
    q: FloatArray,
    span: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The last motion of the interval, one rotation: position, velocity and deceleration at its beginning; its time.

    From the end of the stick, where a release leaves no acceleration; or along the current arc from where that arc
    began, which is the interval's first state or (after a crossing) distance H beyond the centre at the velocity q. A
    mass still stuck at the end is rotated for no time.
    """
    side, H, entered, arrived = last
    crossed = first.arrives & ~arrived
    start = jnp.where(first.arrives, left_at, x)
    v_start = jnp.where(first.arrives, q, first.v)
    deceleration = jnp.where(arrived, 0, side * jnp.where(crossed, H, first.A))
    time = span - jnp.where(arrived, left, jnp.where(crossed, entered, 0))
    return start, v_start, deceleration, time


def sticks_from_start(x: FloatArray, v: FloatArray, base: FloatArray, scales: Scales) -> BoolArray:
    """Whether a mass in the state ``(x, v)`` is in a stick from the first instant on a base of velocity ``base``."""
    pull = scales.spring.squared * jnp.where(base < 0, -x, x)
    alpha = scales.deceleration
    held = (v == base) & (pull >= -alpha) & (alpha - pull > 4 * few(x) * alpha)
    return held | _rests(scales.spring.squared * x, v, base, scales)


def _rests(pull, v, base, scales):
    """Whether the mass rests inside the stick band on a base at rest; `pull`: ``w2 x``.

    The edge of the band is included: the slip circle there has radius 0, which is no motion. Without friction there is
    no band: a mass that does not move does not stick.
    """
    alpha = scales.deceleration
    most = (1 + _REST_ULPS * float(jnp.finfo(v.dtype).eps)) * alpha
    return (base == 0) & (jnp.abs(v) <= scales.rest_speed) & (jnp.abs(pull) <= most) & (alpha > 0)


def first_arc(
    x: FloatArray, v: FloatArray, q: FloatArray, turned: FloatArray, scales: Scales, span: FloatArray,
    *, moving: bool = False,
) -> FirstArc:  # fmt: skip
    """The arc from the interval's first state; `turned`: ``omega q``; `moving`: whether that is known not to be 0."""
    at_rest = None
    if moving:
        side, A = _seen_from_moving_center(x, v, q, scales)
    else:
        at_rest, side, A, v = _seen_from_center(x, v, q, scales)
    excess, reaches, H = _meeting(at_rest, A, v, q, turned, scales)
    time, moved, is_flat = _to_meeting(A, v, q, H, side, scales.spring)
    return FirstArc(side, A, v, excess, H, time, x + moved, is_flat, reaches & _is_within(time, span))


_to_meeting = computed_once(to_meeting)


def _is_within(time: FloatArray, span: FloatArray) -> BoolArray:
    """Whether an arrival lies in the interval, or on its end but for round-off: for no time, which is a tie."""
    return time < (1 + few(span)) * span


@computed_once
def _seen_from_center(x, v, q, scales):
    alpha, pull = scales.deceleration, scales.spring.squared * x
    at_rest = _rests(pull, v, q, scales)
    pull, v = jnp.where(at_rest, jnp.clip(pull, -alpha, alpha), pull), jnp.where(at_rest, 0, v)
    above = (v > q) | ((v == q) & (pull < -alpha))
    side = jnp.where(above, -1, 1).astype(x.dtype)
    # Without friction a mass at rest has no direction of slip: the smallest friction would hold it, which derivatives
    # must know.
    idle = (alpha == 0) & (pull == 0) & (v == 0) & (q == 0)
    return at_rest, side, side * pull - jnp.where(idle, 0, alpha), v


@computed_once
def _seen_from_moving_center(x, v, q, scales):
    alpha, pull = scales.deceleration, scales.spring.squared * x
    side = jnp.where((v > q) | ((v == q) & (pull < -alpha)), -1, 1).astype(x.dtype)
    return side, side * pull - alpha


@computed_once
def _meeting(at_rest, A, v, q, turned, scales):
    excess = excess_of(A, v, q, scales.spring)
    reaches = excess > jnp.where(v < q, touch(A, turned, scales), 0)
    reaches = reaches if at_rest is None else at_rest | reaches
    positive = excess > 0
    H = jnp.where(positive, jnp.sqrt(jnp.where(positive, excess, 1)), 0)
    return excess, reaches, H


def excess_of(A: FloatArray, v: FloatArray, q: FloatArray, spring: SpringScales) -> FloatArray:
    """``R^2 - w2 q^2``, free of cancellation near v = q; positive if the arc from there reaches the base velocity."""
    return A * A + spring.squared * ((v - q) * (v + q))


def touch(A: FloatArray, turned: FloatArray, scales: Scales) -> FloatArray:
    """``R^2 - w2 q^2`` up to which an arc that begins below the base velocity is tangent to it; `turned`: omega q."""
    ulp = _TOUCH_ULPS[A.dtype.itemsize] * jnp.finfo(A.dtype).eps
    return ulp * (A * A + turned * turned + scales.deceleration * (jnp.abs(A) + turned))


@jax.custom_jvp
def _follow_crossings(side, H, entered, arrived, q, turned, alpha, spring, span):
    """Follow crossings of the base velocity until an arrival inside the stick band, or the end of the interval.

    Takes and returns: the side of the current arc, the distance H at which it meets the base velocity, the time of the
    last arrival, and whether the current arc arrives within the span. Costs nearly nothing where the first arc does not
    cross. Differentiable in both modes: the derivative holds the number of crossings fixed, and is summed over them
    along with the times.
    """
    # Among thousands of lanes some lane nearly always needs the first crossing: it is done without a loop.
    state = (arrived & is_crossed(H, alpha), side, H, entered, arrived)
    crossed = _cross(state, turned, alpha, spring, span)
    state = jax.tree.map(lambda new, old: jnp.where(state[0], new, old), crossed, state)
    return lax.while_loop(lambda s: s[0], lambda s: _cross(s, turned, alpha, spring, span), state)[1:]


@_follow_crossings.defjvp
def _follow_crossings_jvp(primals, tangents):
    side, H, entered, arrived, q, turned, alpha, spring, span = primals
    d_side, dH, d_entered, d_arrived, dq, _, d_alpha, by_spring, _ = tangents
    w2 = spring.squared
    later = half_turn(w2)  # each arc lasts pi / omega and 2 side atan(omega q / H) / omega

    def cross(carry):
        state, (crossings, by_H, by_q, by_alpha, by_w2) = carry
        before = state[3]
        state = _cross(state, turned, alpha, spring, span)
        _, now, distance, arrival, arrived = state
        crossings = crossings + 1
        squared = distance * distance + w2 * q * q
        slope = jnp.where(arrived, 2 * now / jnp.where(squared > 0, squared, 1), 0)
        by_turn = 2 * now * slope_of_angle(q, distance, 0.5 * now * (arrival - before - later), w2)
        by_turn = jnp.where(arrived, by_turn - 0.5 * later / jnp.where(w2 > 0, w2, 1), 0)
        sums = crossings, by_H - slope * q, by_q + slope * distance, by_alpha + slope * q * 2 * crossings
        return state, (*sums, by_w2 + by_turn)

    state = (arrived & is_crossed(H, alpha), side, H, entered, arrived)
    sums = (jnp.zeros_like(H),) * 5
    state, (crossings, by_H, by_q, by_alpha, by_w2) = lax.while_loop(lambda c: c[0][0], cross, (state, sums))
    d_entered = d_entered + by_H * dH + by_q * dq + by_alpha * d_alpha + by_w2 * by_spring.squared
    return state[1:], (d_side, dH - 2 * crossings * d_alpha, d_entered, d_arrived)


def _cross(state, turned, alpha, spring, span):
    """Cross to the other side and follow the arc there, from (H, omega q) to (-H, omega q) as seen from its
    centre.
    """
    _, side, H, entered, _ = state
    side = -side
    H = H - 2 * alpha
    arrival = entered + time_of_arc(H, side, turned, spring)
    arrived = _is_within(arrival, span)
    return arrived & is_crossed(H, alpha), side, H, jnp.where(arrived, arrival, entered), arrived


@computed_once
def time_of_arc(H, side, turned, spring):
    """From a crossing at H beyond the centre to the next meeting: clockwise, pi + 2 atan(omega q / H) below and
    pi - 2 atan(omega q / H) above.
    """
    return 2 * spring.inverse_omega * angle_of(H, -side * turned)


# Exact motion on a base of piecewise-constant velocity: a closed form for each interval, in a scan over intervals.
#
# One trajectory per call; the caller makes batches with ``jax.vmap``. Time is in seconds, so that switching instants
# are exact sums of durations.


class MassState(NamedTuple):
    """The state of the mass: time `t` in s, position `x` in m, velocity `v` in m/s.

    `remembered`: by the quantities of each stick that are asked for.
    """

    t: FloatArray
    x: FloatArray
    v: FloatArray
    remembered: Remembered


def scales_of(system: MassSpring, t1: Scalar, dtype) -> Scales:
    """The system's scales as arrays of `dtype`."""
    mass, held = jnp.asarray(system.mass, dtype), jnp.asarray(system.friction.static * system.normal_force, dtype)
    # An infinite mass would rest on every base: 0 * infinity makes its state NaN (`NOT_FINITE`).
    return Scales.of(jnp.asarray(system.stiffness, dtype) / mass, held / mass + 0 * mass, jnp.asarray(t1, dtype))


def start_motion(scales: Scales, y0: tuple[Scalar, Scalar], quantities: tuple[str, ...] = ()) -> MassState:
    """The initial state ``y0 = (position, velocity)``.

    `quantities` of each stick: those that are asked for.
    """
    dtype = scales.t1.dtype
    x, v = jnp.asarray(y0[0], dtype), jnp.asarray(y0[1], dtype)
    return MassState(jnp.zeros((), dtype), x, v, begin_quantities(x, quantities))


def cross_interval(
    scales: Scales, motion: MassState, totals: Totals, duration: FloatArray, velocity: FloatArray,
    *, moving: bool = False,
) -> tuple[MassState, Totals, StickRecord, BoolArray]:  # fmt: skip
    """Cross one interval, cut at the horizon; returns the next state, the totals with its stick, its record, and
    whether the mass met the base for no time. `moving`: whether it is known that the base is not at rest.
    """
    t1 = scales.t1
    uncut = ~(motion.t + duration >= t1)  # a NaN duration is not cut: the time becomes NaN (`NOT_FINITE`)
    span = jnp.where(uncut, duration, t1 - motion.t)
    passage = carry_across(motion.x, motion.v, velocity, scales, span, motion.t, moving=moving)
    t_end = jnp.where(uncut, motion.t + duration, t1)
    stuck, released = passage.stuck, passage.released
    start = motion.t + passage.entered
    # A stick ends where the spring reaches the friction limit, or with the interval.
    end = jnp.where(released, motion.t + passage.left, t_end)
    stick, ending = StickSpan(start, end, passage.position, passage.left_at), ending_of(stuck, released, ~uncut)
    # Not end - start, whose round-off grows with the time since t = 0.
    duration = passage.left - passage.entered
    record, remembered, totals = recorded(motion.remembered, totals, stuck, stick, ending, ~released & ~uncut, duration)
    return MassState(t_end, passage.x, passage.v, remembered), totals, record, passage.tie


def cross_live_interval(
    scales: Scales, motion: MassState, totals: Totals, duration: FloatArray, velocity: FloatArray
) -> tuple[MassState, Totals, StickRecord, BoolArray]:
    """`cross_interval`, which after the horizon leaves everything as it is, to the last bit."""
    live = ~(motion.t >= scales.t1)
    following, totals, record, tie = cross_interval(scales, motion, totals, duration, velocity)
    return jax.tree.map(lambda new, old: jnp.where(live, new, old), following, motion), totals, record, tie & live


def run_intervals(
    scales: Scales, motion: MassState, durations: Array, velocities: Array
) -> tuple[MassState, Totals, StickRecord, MassState, BoolArray]:
    """Simulate all intervals of one realisation.

    Returns the final state, the totals, and of each interval a `StickRecord`, the state at its beginning, and whether
    the mass met the base for no time.
    """

    @partial(jax.checkpoint, prevent_cse=False)  # computing an interval again takes less time than storing its values
    def step(carry, interval):
        *following, record, tie = cross_live_interval(scales, *carry, *interval)
        return tuple(following), (record, carry[0], tie)

    start = (motion, start_totals(motion.x.dtype))
    (motion, totals), of_each = lax.scan(step, start, (durations, velocities))
    return motion, totals, *of_each


def status_of(motion: MassState, t1: FloatArray) -> IntArray:
    """The `Status` of a trajectory that ended in the state `motion`."""
    finite = jnp.isfinite(motion.t + t1) & jnp.isfinite(motion.x) & jnp.isfinite(motion.v)
    code = jnp.where(motion.t < t1, Status.BASE_TOO_SHORT, Status.FINISHED)
    # Only a duration that is NaN makes the time NaN: that of an interval that cannot be.
    failed = jnp.where(jnp.isnan(motion.t) & jnp.isfinite(t1), Status.BASE_INVALID, Status.NOT_FINITE)
    return jnp.where(finite, code, failed).astype(jnp.int8)


# Whether round-off decided about an event in an interval of the base (`near_grazing_count`).
#
# Found from the state in which the interval began, beside the motion. With H, the distance from the centre at which an
# arc meets the base velocity, the last digits decide
#
# - on an arc that is nearly tangent to the base velocity, whether it meets it;
# - at ``H = 2 alpha``, whether friction holds the mass, and at ``H = 0`` whether it does so for more than an instant;
# - where an arrival or a release falls on the end of the interval, whether there is one. A stick between the two would
#   have no length: it is none (`IntervalPassage.tie`, which ensembles count too);
# - where an arrival falls on its beginning, whether there was a slip before.


LAST_LEFT = "slip_displacement"  # the quantity of a stick that remembers where the last one ended


def is_tie(scales: Scales, began: MassState, duration: FloatArray, velocity: FloatArray) -> BoolArray:
    """Whether round-off decided about an event in the interval of the base that began so. No derivative."""
    scales, began, duration, velocity = lax.stop_gradient((scales, began, duration, velocity))
    alpha, t1, omega, w2 = scales.deceleration, scales.t1, scales.spring.omega, scales.spring.squared
    span = jnp.where(began.t + duration >= t1, t1 - began.t, duration)
    # The first arc, in accelerations: its velocity v and the base speed q are times omega.
    _, x, v, speed, q, span = mirrored(began.x, began.v, velocity, scales, span)
    side, A, v, excess, first_H, first_time, _, _, _ = first_arc(x, v, speed, q, scales, span)
    meets = excess > jnp.where(v < speed, touch(A, q, scales), 0)
    A, begins = jnp.abs(A), v == speed
    # The errors of positions times w2, of velocities (m/s), and of H.
    of_v = few(x) * (jnp.abs(v) + speed + (A + alpha) * scales.clock)
    v = omega * v
    size = A + jnp.abs(v) + q + alpha
    of_x, of_state = few(x) * (A + 2 * alpha), few(x) * size
    # H^2 = A^2 + v^2 - q^2 has the error of its terms; a mass that has the base's velocity exactly meets it at H = A.
    of_H = jnp.where(begins, of_x, of_state * size / jnp.where(meets, first_H, 1))

    # Ties of the first arc: of the place where the mass begins on the base, of tangency, of the edge of the band. After
    # a release at this velocity the arc is tangent to it in exact numbers, which the threshold knows.
    threshold, left_at = touch(A, q, scales), w2 * jnp.abs(began.remembered[LAST_LEFT])
    released = (jnp.abs(left_at - alpha) <= few(alpha) * alpha) & (began.t > 0)
    returns = released & (jnp.abs(excess) <= threshold)
    tangent = (v < q) & (jnp.abs(excess) <= 2 * threshold) & ~returns
    at_edge = meets & (jnp.abs(first_H - 2 * alpha) <= of_H)
    at_first = ((first_time < span) & (tangent | at_edge)) | (begins & (of_x >= A))

    # The first meeting with the base velocity that friction can hold or that lies after the interval, at the distance H
    # from the centre; all before it are crossings.
    def crosses(state):
        _, H, arrival = state
        return is_crossed(H, alpha) & (arrival < span)

    def cross(state):
        side, H, arrival = state
        return -side, H - 2 * alpha, arrival + time_of_arc(H - 2 * alpha, -side, q, scales.spring)

    state = side, jnp.where(meets, first_H, 0), first_time
    state = jax.tree.map(lambda new, old: jnp.where(crosses(state), new, old), cross(state), state)
    side, H, arrival = lax.while_loop(crosses, cross, state)

    # Ties after crossings, and of arrivals and releases with the ends of the interval.
    arrived, crossed = meets & (arrival < span), meets & (first_H > H)
    holds = crossed & ((arrived & (jnp.abs(H - 2 * alpha) <= of_H)) | (of_H >= H))
    # The relative velocity changes at the rate H where it passes zero: times H, times are velocities.
    eps, rate = float(jnp.finfo(H.dtype).eps), w2 * speed
    when = of_v + H * (few(H) * span + CLOCK_ULPS * eps * began.t)
    at_end = meets & (2 * alpha + of_H >= H) & (jnp.abs(arrival - span) * H <= when)
    at_start = arrived & ~crossed & ~begins & (arrival * H <= of_v)
    beyond = side * (alpha - H) + rate * (span - arrival) - alpha
    at_release = arrived & (rate > 0) & (jnp.abs(beyond) * H <= (of_H + of_x) * H + rate * when)
    has_events = (span > 0) & (alpha > 0)  # without friction there is none
    return has_events & (at_first | (holds | at_end | at_start | at_release))


def starts_at_edge(scales: Scales, start: MassState, velocity: FloatArray) -> BoolArray:
    """Whether a trajectory starts with its base's `velocity` at an edge of the stick band: one of the ties of `is_tie`,
    which alone costs nearly nothing.
    """
    pull, alpha = scales.spring.squared * jnp.abs(start.x), scales.deceleration
    return (jnp.abs(pull - alpha) <= few(pull) * (pull + alpha)) & (start.v == velocity) & (alpha > 0)


# Largest position and velocity while the base velocity is constant, in closed form.
#
# Every slip is an arc of a circle: its position is extreme where the velocity is zero, and its velocity
# where the mass passes the centre. Where arcs cross the base velocity one after the other, each has a smaller radius
# than the one before: only the first on each side can hold an extreme that is not at the beginning of an interval.


def largest_in_interval(
    scales: Scales, motion: MassState, duration: FloatArray, velocity: FloatArray, *, of_velocity: bool, sign: Scalar
) -> FloatArray:
    """The largest value of `sign` times the position (m), or the velocity (m/s), in an interval.

    It begins with `motion`; its end is not included. Base `velocity` in m/s.
    """
    left = scales.t1 - motion.t
    span = jnp.clip(jnp.where(duration < left, duration, left), 0)
    mirror, x, v, q, turned, span = mirrored(motion.x, motion.v, velocity, scales, span)
    passage = carry_across(x, v, q, scales, span, motion.t)
    upwards = sign * mirror
    start, stick = (v, q) if of_velocity else (x, passage.position)
    # A stick moves at the base's velocity, from where it begins.
    found = [upwards * start, jnp.where(passage.stuck, upwards * stick, upwards * start)]
    # Arcs: whether each exists, its position, velocity and deceleration at its beginning, and how long it lasts. The
    # first one of the interval, the first two after crossings of the base velocity, and the one after a stick.
    alpha, spring = scales.deceleration, scales.spring
    first = first_arc(x, v, q, turned, scales, span)
    begun = jnp.where(first.arrives, first.time, span)
    arcs = [(jnp.ones((), bool), x, first.v, first.side * first.A, begun)]
    crosses, side, H = first.arrives & is_crossed(first.H, alpha), first.side, first.H
    for _ in range(2):
        side, H = -side, jnp.where(crosses, H - 2 * alpha, 1)
        time = time_of_arc(H, side, turned, spring)
        arrives = begun + time < span
        time = jnp.where(arrives, time, span - begun)
        arcs.append((crosses, side * quotient(alpha + H, crosses, spring), q, side * H, time))
        crosses, begun = crosses & arrives & is_crossed(H, alpha), begun + time
    arcs.append((passage.released, passage.left_at, q, jnp.zeros_like(q), span - passage.left))
    for exists, x, v, A, time in arcs:
        # Clockwise from its beginning to the largest value, or half a turn further to the smallest. By the signs of the
        # components, for on a soft spring the angle is too small to be added to another. No derivative passes through
        # when that is: there the value does not change with time.
        across, along = (-A, spring.omega * v) if of_velocity else (spring.omega * v, A)
        ahead = jnp.arctan2(*lax.stop_gradient((upwards * across, upwards * along)))
        when = jnp.mod(ahead, 2 * jnp.pi) * spring.inverse_omega
        reached = exists & ((A != 0) | (v != 0)) & (when <= time)
        position, velocity = swung(x, v, A, jnp.where(reached, when, 0), spring)
        found.append(jnp.where(reached, upwards * (velocity if of_velocity else position), upwards * start))
    return jnp.max(jnp.stack(found))
