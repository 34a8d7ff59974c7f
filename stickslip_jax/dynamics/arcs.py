"""Closed forms of the motion while the base velocity stays constant.

Units inside: lengths as given; time as the angle ``omega t``; velocities divided by ``omega``, so that every slip arc
is a circle run clockwise with unit angular speed. ``a`` is the stick half-width ``mu n / k``. All is told for a base
that moves forward, ``q = |v| / omega >= 0``; for a backward one the picture is mirrored (`carry_across`).

Slip below the base velocity circles about ``+a``, slip above it about ``-a`` (Lima and Sampaio, conference paper,
eq. 3). With ``side = +1`` below and ``-1`` above, every rule is the same for both:

- offset from the centre, towards the side: ``D = side x - a``; radius ``R^2 = D^2 + p^2``;
- the arc meets the base velocity at distance ``h = sqrt(R^2 - q^2)`` from the centre, at ``x = side (a - h)``;
- it sticks there if ``h <= 2 a``; otherwise it crosses to the other side, and meets the base velocity next at
  distance ``h - 2 a`` from the other centre, and so on.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._types import BoolArray, FloatArray
from ..numerics.elementary import angle_of, sincos

# An arc that left a stick at base velocity w has R = w exactly; if the base comes back to w while the mass is still on
# it, R^2 - w^2 is pure round-off and must not count as an arrival. The sum behind R^2 - q^2 carries an error of a few
# units in the last place of its terms for each interval passed on the arc; 64 leaves room for hundreds. A true arrival
# below the threshold (a stick shorter than about 1e-7 R/q) has a chance of about 1e-14 per arc.
_GRAZING_ULPS = 64


class Passage(NamedTuple):
    """What happened in one interval: the state at its end, and its stick, if any, in angle from its beginning."""

    x: FloatArray
    p: FloatArray
    entered: FloatArray
    left: FloatArray
    position: FloatArray
    stuck: BoolArray
    released: BoolArray


class _Arc(NamedTuple):
    """The arc that is under way after all crossings: where it began (`offset` from its centre, `p`), its arrival."""

    side: FloatArray
    offset: FloatArray
    p: FloatArray
    began: FloatArray
    h: FloatArray
    arrived: BoolArray


def carry_across(x: FloatArray, p: FloatArray, v: FloatArray, a: FloatArray, span: FloatArray) -> Passage:
    """Carry the state ``(x, p)`` across an interval of base velocity ``v`` (over omega) and length `span` (an angle).

    At most one stick happens: from a release on, the mass circles tangentially below the base velocity.
    """
    mirror = jnp.where(v < 0, -1, 1).astype(x.dtype)
    q = jnp.abs(v)
    first, entered = _first_arrival(mirror * x, mirror * p, q, a, span)
    arc, entered = _follow_crossings(first, entered, q, a, span)

    # Stick from `entered` at x = side (a - h) until the spring reaches the friction limit at x = +a.
    position = arc.side * (a - arc.h)
    way = a - position
    moving = q > 0
    release = jnp.where(moving, entered + way / jnp.where(moving, q, 1), jnp.inf)
    released = arc.arrived & (release <= span)
    left = jnp.where(released, release, span)
    stuck = arc.arrived & (left > entered)

    # One rotation ends the interval: about +a from the release point, or about the last arc's centre from its start.
    # A mass still stuck at the end is a rotation by angle 0 of its last point.
    still_stuck = arc.arrived & ~released
    offset = jnp.where(arc.arrived, jnp.where(released, 0, position + q * (span - entered) - a), arc.offset)
    centre = jnp.where(arc.arrived, a, arc.side * a)
    p_start = jnp.where(arc.arrived, q, arc.p)
    angle = jnp.where(arc.arrived, jnp.where(still_stuck, 0, span - left), span - arc.began)
    sine, cosine = sincos(angle)
    x_end = centre + offset * cosine + p_start * sine
    p_end = p_start * cosine - offset * sine
    return Passage(mirror * x_end, mirror * p_end, entered, left, mirror * position, stuck, released & stuck)


def _first_arrival(x, p, q, a, span) -> tuple[_Arc, FloatArray]:
    """The arc from the interval's first state, and the angle at which it meets the base velocity."""
    above = (p > q) | ((p == q) & (x < -a))
    side = jnp.where(above, -1, 1).astype(x.dtype)
    D = side * x - a
    excess = D * D + (p - q) * (p + q)  # R^2 - q^2, free of cancellation near p = q
    roundoff = _GRAZING_ULPS * jnp.finfo(x.dtype).eps * (D * D + q * q + a * jnp.abs(D))
    reaches = excess > jnp.where(p < q, roundoff, 0)
    h = jnp.sqrt(jnp.where(reaches, excess, 1))
    # Half the clockwise angle from (D, p) to (-h, q) on the same circle. Each form is free of cancellation where it is
    # used, never negative, and 0 when the state is already on the base velocity inside the band.
    before = D <= 0
    half_angle = angle_of(
        jnp.where(before, jnp.abs(p - q), h + D), jnp.where(before, h - D, -side * (p + q))
    )
    angle = 2 * half_angle
    arrived = reaches & (angle < span)
    arc = _Arc(side, side * D, p, jnp.zeros_like(x), h, arrived)
    return arc, jnp.where(arrived, angle, 0)


def _follow_crossings(arc: _Arc, entered, q, a, span) -> tuple[_Arc, FloatArray]:
    """Follow crossings of the base velocity until an arrival inside the stick band, or the end of the interval."""
    crossing = arc.arrived & (arc.h > 2 * a)
    room = jnp.where(crossing, span - entered, 0)
    h, elapsed, crossings, arrivals = _crossings(arc.h, q, a, arc.side, room)
    side = jnp.where(crossings % 2 == 1, -arc.side, arc.side)
    on_its_way = crossing & (arrivals < crossings)
    entered = entered + elapsed
    # An arc that began with a crossing starts at distance h beyond its own centre, on the base velocity.
    follow = _Arc(
        side=side,
        offset=jnp.where(on_its_way, side * h, arc.offset),
        p=jnp.where(on_its_way, q, arc.p),
        began=jnp.where(on_its_way, entered, 0),
        h=h,
        arrived=arc.arrived & ~on_its_way,
    )
    return follow, entered


@jax.custom_jvp
def _crossings(h, q, a, side, room):
    """Count crossings one after the other; nothing is done (and nearly nothing spent) where ``room`` is 0.

    `h` is the distance at which the first arc met the base velocity. Returns the distance of the last arc, the angle
    spent on the arcs that arrived, the number of crossings and of arrivals. All but `room` is differentiable: the
    derivative is that of the sum over the arcs, whose number does not change. Reverse mode works, too.
    """
    outcome, _ = _count_crossings(h, q, a, side, room)
    return outcome


@_crossings.defjvp
def _crossings_jvp(primals, tangents):
    h, q, a, side, room = primals
    dh, dq, da, _, _ = tangents
    (h_last, elapsed, crossings, arrivals), (by_h, by_q, by_a) = _count_crossings(h, q, a, side, room)
    count = crossings.astype(h.dtype)
    tangent_out = (
        dh - 2 * count * da,
        by_h * dh + by_q * dq + by_a * da,
        np.zeros(crossings.shape, jax.dtypes.float0),
        np.zeros(arrivals.shape, jax.dtypes.float0),
    )
    return (h_last, elapsed, crossings, arrivals), tangent_out


def _count_crossings(h, q, a, side, room):
    """The loop behind `_crossings`, with the partial derivatives of the elapsed angle."""
    zero = jnp.zeros_like(h)

    def more(state):
        return state[0]

    def cross(state):
        _, side, elapsed, crossings, arrivals, by_h, by_q, by_a = state
        side = -side
        crossings = crossings + 1
        j = crossings.astype(h.dtype)
        distance = h - 2 * j * a
        # The arc runs from (h, q) to (-h, q): clockwise pi + 2 atan(q/h) below and pi - 2 atan(q/h) above.
        angle = 2 * angle_of(distance, -side * q)
        arrived = elapsed + angle < room
        squared = distance * distance + q * q
        slope = jnp.where(arrived, 2 * side / jnp.where(squared > 0, squared, 1), 0)
        return (
            arrived & (distance > 2 * a),
            side,
            jnp.where(arrived, elapsed + angle, elapsed),
            crossings,
            arrivals + arrived,
            by_h - slope * q,
            by_q + slope * distance,
            by_a + slope * q * 2 * j,
        )

    none = jnp.zeros(jnp.shape(h), jnp.int32)
    start = ((room > 0) & (h > 2 * a), side, zero, none, none, zero, zero, zero)
    _, _, elapsed, crossings, arrivals, *partials = lax.while_loop(more, cross, start)
    return (h - 2 * crossings.astype(h.dtype) * a, elapsed, crossings, arrivals), partials
