"""Closed forms of the motion while the base velocity stays constant.

Units inside: lengths as given; time as the angle ``omega t``; velocities divided by ``omega``, so that every slip arc
is a clockwise circle of unit angular speed. ``a`` is the stick half-width ``mu n / k``. The formulas are for a base
that moves forward, ``q = |v| / omega >= 0``; for a backward one the state is mirrored (`carry_across`).

Slip below the base velocity circles about ``+a``, slip above it about ``-a`` (Lima and Sampaio, conference paper,
eq. 3). With ``side = +1`` below and ``-1`` above, the rules that follow from this geometry are the same for both:

- offset from the centre, towards the side: ``D = side x - a``; radius ``R^2 = D^2 + p^2``;
- the arc meets the base velocity at distance ``h = sqrt(R^2 - q^2)`` from the centre, at ``x = side (a - h)``;
- the mass sticks there if ``h <= 2 a``; otherwise it crosses to the other side, and meets the base velocity next at
  distance ``h - 2 a`` from the other centre, and so on.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..._compiler import computed_once
from ..._numerics.elementary import angle_of, sincos
from ..._types import BoolArray, FloatArray

# After a release at base velocity w the arc has R = w exactly. If the base velocity returns to w while the mass is on
# that arc (perhaps after a rest, or half a turn about the other centre), the arc is tangent to it, and round-off must
# not create a stick there. The error of R^2 - q^2, in units in the last place of the terms in `_meeting`, grows with
# the square root of the number of intervals: 80 after 10^4. With this threshold a true arrival is missed only if its
# stick is shorter than about 1e-6 R/q (float64), which happens once in 10^12 arcs.
_TOUCH_ULPS = {8: 4096, 4: 64}
# Tolerance, in units in the last place, within which a mass on a base at rest counts as resting inside the band.
_REST_ULPS = 128
# The longest interval, rad: the last place of a larger angle exceeds 1e-7. Longer intervals give NaN (`NOT_FINITE`).
_LONGEST_SPAN = 2.0**30


class Passage(NamedTuple):
    """Result of one interval: the state at its end and its stick, if any; `entered`, `left`: angles since its start."""

    x: FloatArray
    p: FloatArray
    entered: FloatArray
    left: FloatArray
    position: FloatArray
    stuck: BoolArray
    released: BoolArray


class FirstArc(NamedTuple):
    """The arc from an interval's first state: its `side`, its `offset` from the centre and `p`.

    It meets the base velocity at the distance `h` from the centre, after `angle`; `excess` ``= h^2 = R^2 - q^2``.
    `arrives`: whether it does so within the interval.
    """

    side: FloatArray
    offset: FloatArray
    p: FloatArray
    excess: FloatArray
    h: FloatArray
    angle: FloatArray
    arrives: BoolArray


class _LastMeeting(NamedTuple):
    """The last arc that begins in the interval, as seen from the base velocity: its `side` and distance `h`; the angle
    `entered` at which it meets it, or else began; and whether the mass has `arrived` inside the stick band.
    """

    side: FloatArray
    h: FloatArray
    entered: FloatArray
    arrived: BoolArray


class _Stick(NamedTuple):
    """The stick from the last meeting on: its position; the angle at which it is `left`; how it ends; if it is one."""

    position: FloatArray
    left: FloatArray
    released: BoolArray
    stuck: BoolArray


def carry_across(x: FloatArray, p: FloatArray, v: FloatArray, a: FloatArray, span: FloatArray) -> Passage:
    """Carry the state ``(x, p)`` across an interval of base velocity ``v`` (over omega) and length `span` (an angle).

    There is at most one stick: after a release the mass moves on a circle tangent to the base velocity from below.
    """
    mirror, x, p, q, span = mirrored(x, p, v, span)
    first = first_arc(x, p, q, a, span)
    last = _LastMeeting(*_follow_crossings(first.side, first.h, first.angle, first.arrives, q, a, span))
    stick = _stick(last, q, a, span)
    center, offset, p_start, angle = _last_rotation(first, last, stick, q, a, span)
    sine, cosine = sincos(angle)
    # A radius whose square overflows would miss its arrivals: 0 * infinity makes the state NaN (`NOT_FINITE`).
    x_end = center + offset * cosine + p_start * sine + 0 * first.excess
    p_end = p_start * cosine - offset * sine
    position, left, released, stuck = stick
    return Passage(mirror * x_end, mirror * p_end, last.entered, left, mirror * position, stuck, released & stuck)


@computed_once
def mirrored(x, p, v, span):
    mirror = jnp.where(v < 0, -1, 1).astype(x.dtype)
    return mirror, mirror * x, mirror * p, jnp.abs(v), jnp.where(span < _LONGEST_SPAN, span, jnp.nan)


@computed_once
def _stick(last: _LastMeeting, q: FloatArray, a: FloatArray, span: FloatArray) -> _Stick:
    """The stick from `entered` at ``x = side (a - h)`` until the spring reaches the friction limit at ``x = +a``."""
    side, h, entered, arrived = last
    position = side * (a - h)
    moving = q > 0
    release = jnp.where(moving, entered + (a - position) / jnp.where(moving, q, 1), jnp.inf)
    released = arrived & (release <= span)
    left = jnp.where(released, release, span)
    return _Stick(position, left, released, arrived & (left > entered))


@computed_once
def _last_rotation(
    first: FirstArc, last: _LastMeeting, stick: _Stick, q: FloatArray, a: FloatArray, span: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The last motion of the interval, one rotation: its centre; the offset from it and p at its beginning; its angle.

    About +a from the release point, or about the centre of the current arc from where that arc began, which is the
    interval's first state or (after a crossing) distance h beyond the centre at p = q. A mass still stuck at the end
    is rotated by the angle 0.
    """
    side, h, entered, arrived = last
    crossed = first.arrives & ~arrived
    offset = jnp.where(crossed, side * h, first.offset)
    offset_at_end = stick.position + q * (span - entered) - a
    offset = jnp.where(arrived, jnp.where(stick.released, 0, offset_at_end), offset)
    center = jnp.where(arrived, a, side * a)
    p_start = jnp.where(first.arrives, q, first.p)
    angle = jnp.where(arrived, span - stick.left, span - jnp.where(crossed, entered, 0))
    return center, offset, p_start, angle


def sticks_from_start(x: FloatArray, p: FloatArray, v: FloatArray, a: FloatArray) -> BoolArray:
    """Whether a mass in the state ``(x, p)`` is in a stick from the first instant on a base of velocity ``v``."""
    forward = jnp.where(v < 0, -x, x)
    return ((p == v) & (forward >= -a) & (forward < a)) | _rests(x, p, v, a)


def _rests(x, p, v, a):
    """Whether the mass rests inside the stick band on a base at rest.

    The edge of the band is included: the slip circle there has radius 0, which is no motion.
    """
    edge = _REST_ULPS * jnp.finfo(x.dtype).eps * a
    return (v == 0) & (jnp.abs(p) <= edge) & (jnp.abs(x) <= a + edge)


def first_arc(x: FloatArray, p: FloatArray, q: FloatArray, a: FloatArray, span: FloatArray) -> FirstArc:
    """The arc from the interval's first state."""
    at_rest, side, D, p = _seen_from_center(x, p, q, a)
    excess, reaches, h = _meeting(at_rest, D, p, q, a)
    angle = _angle_to_meeting(D, p, q, h, side)
    return FirstArc(side, side * D, p, excess, h, angle, reaches & (angle < span))


@computed_once
def _seen_from_center(x, p, q, a):
    at_rest = _rests(x, p, q, a)
    x, p = jnp.where(at_rest, jnp.clip(x, -a, a), x), jnp.where(at_rest, 0, p)
    above = (p > q) | ((p == q) & (x < -a))
    side = jnp.where(above, -1, 1).astype(x.dtype)
    return at_rest, side, side * x - a, p


@computed_once
def _meeting(at_rest, D, p, q, a):
    excess = excess_of(D, p, q)
    reaches = at_rest | (excess > jnp.where(p < q, touch(D, q, a), 0))
    positive = excess > 0
    h = jnp.where(positive, jnp.sqrt(jnp.where(positive, excess, 1)), 0)
    return excess, reaches, h


def excess_of(D: FloatArray, p: FloatArray, q: FloatArray) -> FloatArray:
    """``R^2 - q^2``, free of cancellation near p = q; positive if the arc through ``(D, p)`` reaches the base velocity.

    Any unit will do that `D`, `p` and `q` share.
    """
    return D * D + (p - q) * (p + q)


def touch(D: FloatArray, q: FloatArray, a: FloatArray) -> FloatArray:
    """``R^2 - q^2`` up to which an arc that begins below the base velocity is tangent to it."""
    ulp = _TOUCH_ULPS[D.dtype.itemsize] * jnp.finfo(D.dtype).eps
    return ulp * (D * D + q * q + a * (jnp.abs(D) + q))


def _angle_to_meeting(D, p, q, h, side):
    # The clockwise angle from (D, p) to (-h, q) on the same circle, as twice its half. Each half-angle form is free of
    # cancellation where it is used, never negative, and 0 for a state already at the base velocity inside the band.
    before = D <= 0
    return twice_the_angle(jnp.where(before, jnp.abs(p - q), h + D), jnp.where(before, h - D, -side * (p + q)))


@jax.custom_jvp
def _follow_crossings(side, h, entered, arrived, q, a, span):
    """Follow crossings of the base velocity until an arrival inside the stick band, or the end of the interval.

    Takes and returns: the side of the current arc, the distance h at which it meets the base velocity, the angle of the
    last arrival, and whether the current arc arrives within the span. Costs nearly nothing where the first arc does not
    cross. Differentiable in both modes: the derivative holds the number of crossings fixed, and is summed over them
    along with the angles.
    """
    # Among thousands of lanes some lane nearly always needs the first crossing: it is done without a loop.
    state = _cross_if_needed((arrived & (h > 2 * a), side, h, entered, arrived), q, a, span)
    return lax.while_loop(lambda s: s[0], lambda s: _cross(s, q, a, span), state)[1:]


def _cross_if_needed(state, q, a, span):
    return jax.tree.map(lambda new, old: jnp.where(state[0], new, old), _cross(state, q, a, span), state)


@_follow_crossings.defjvp
def _follow_crossings_jvp(primals, tangents):
    side, h, entered, arrived, q, a, span = primals
    d_side, dh, d_entered, d_arrived, dq, da, _ = tangents

    def cross(carry):
        state, (crossings, by_h, by_q, by_a) = carry
        state = _cross(state, q, a, span)
        _, now, distance, _, arrived = state
        crossings = crossings + 1
        squared = distance * distance + q * q
        slope = jnp.where(arrived, 2 * now / jnp.where(squared > 0, squared, 1), 0)
        return state, (crossings, by_h - slope * q, by_q + slope * distance, by_a + slope * q * 2 * crossings)

    zero = jnp.zeros_like(h)
    state = (arrived & (h > 2 * a), side, h, entered, arrived)
    state, (crossings, by_h, by_q, by_a) = lax.while_loop(lambda c: c[0][0], cross, (state, (zero, zero, zero, zero)))
    d_out = (d_side, dh - 2 * crossings * da, d_entered + by_h * dh + by_q * dq + by_a * da, d_arrived)
    return state[1:], d_out


def _cross(state, q, a, span):
    """Cross to the other side and follow the arc there, from (h, q) to (-h, q) as seen from its centre."""
    _, side, h, entered, _ = state
    side = -side
    h = h - 2 * a
    arrival = entered + twice_the_angle(h, -side * q)  # clockwise, pi + 2 atan(q/h) below and pi - 2 atan(q/h) above
    arrived = arrival < span
    return arrived & (h > 2 * a), side, h, jnp.where(arrived, arrival, entered), arrived


@computed_once
def twice_the_angle(y, x):
    return 2 * angle_of(y, x)
