"""Whether round-off decided about an event in an interval of the base (`near_grazing_count`).

Found from the state in which the interval began, beside the motion. With h, the distance from the centre at which an
arc meets the base velocity, the last digits decide

- on an arc that is nearly tangent to the base velocity, whether it meets it;
- at ``h = 2 a``, whether friction holds the mass, and at ``h = 0`` whether it does so for more than an instant;
- where an arrival or a release falls on the end of the interval, whether there is one;
- where an arrival falls on its beginning, whether there was a slip before.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..._types import BoolArray, FloatArray
from .arcs import first_arc, mirrored, touch, twice_the_angle
from .crossing import Motion, Scales

# How close is near, in units in the last place of the lengths involved: three times the error of the state after 10^4
# intervals, which grows with the square root of their number (`_TOUCH_ULPS` of `arcs.py`). By chance,
# 4 of 10^12 intervals of the default study come so close (float32: 4 of 10^4).
_NEAR_ULPS = {8: 256, 4: 64}
LAST_LEFT = "slip_displacement"  # the quantity of a stick that remembers where the last one ended
_CLOCK_ULPS = 4  # the round-off of the time at which an interval begins, in units in the last place


class _Arc(NamedTuple):
    """The first arc of an interval: `D`, its distance from the centre, and `p` at the beginning; where (`h`, `side`)
    and when (`angle`) it meets the base velocity `q`, and whether it `meets` it; `excess` ``= R^2 - q^2``.

    Errors: `of_x`, that of positions; `of_state`, that of the state on the arc; `of_h`, that of h.
    """

    D: FloatArray
    p: FloatArray
    q: FloatArray
    span: FloatArray
    excess: FloatArray
    side: FloatArray
    h: FloatArray
    angle: FloatArray
    meets: BoolArray
    of_x: FloatArray
    of_state: FloatArray
    of_h: FloatArray


def is_tie(scales: Scales, began: Motion, duration: FloatArray, velocity: FloatArray) -> BoolArray:
    """Whether round-off decided about an event in the interval of the base that began so. No derivative."""
    scales, began, duration, velocity = lax.stop_gradient((scales, began, duration, velocity))
    arc = _arc(scales, began, duration, velocity)
    return (arc.span > 0) & (_ties_at_first(scales, began, arc) | _ties_later(scales, began, arc))


def starts_at_edge(scales: Scales, start: Motion, velocity: FloatArray) -> BoolArray:
    """Whether a trajectory starts with its base's `velocity` at an edge of the stick band: one of the ties of `is_tie`,
    which alone costs nearly nothing.
    """
    off = jnp.abs(jnp.abs(start.x) - scales.half_width)
    near = off <= _few(off) * (jnp.abs(start.x) + scales.half_width)
    return near & (start.p == velocity * scales.inverse_omega)


def _arc(scales, began, duration, velocity) -> _Arc:
    omega, inverse_omega, a, t1 = scales
    span = omega * jnp.where(began.t + duration >= t1, t1 - began.t, duration)
    _, x, p, q, span = mirrored(began.x, began.p, velocity * inverse_omega, span)
    side, offset, p, excess, h, angle, _ = first_arc(x, p, q, a, span)
    D = jnp.abs(offset)
    meets = excess > jnp.where(p < q, touch(D, q, a), 0)
    size = D + jnp.abs(p) + q + a
    of_x, of_state = _few(x) * (D + 2 * a), _few(x) * size
    # h^2 = D^2 + p^2 - q^2 has the error of its terms; a mass that has the base's velocity exactly meets it at h = D.
    of_h = jnp.where(p == q, of_x, of_state * size / jnp.where(meets, h, 1))
    return _Arc(D, p, q, span, excess, side, h, angle, meets, of_x, of_state, of_h)


def _ties_at_first(scales, began, arc) -> BoolArray:
    """Ties of the first arc: of the place where the mass begins on the base, of tangency, of the edge of the band."""
    a, threshold = scales.half_width, touch(arc.D, arc.q, scales.half_width)
    # After a release at this velocity the arc is tangent to it in exact numbers, which the threshold knows.
    released = (jnp.abs(began.remembered[LAST_LEFT]) == a) & (began.t > 0)
    returns = released & (jnp.abs(arc.excess) <= threshold)
    tangent = (arc.p < arc.q) & (jnp.abs(arc.excess) <= 2 * threshold) & ~returns
    at_edge = arc.meets & (jnp.abs(arc.h - 2 * a) <= arc.of_h)
    return ((arc.angle < arc.span) & (tangent | at_edge)) | ((arc.p == arc.q) & (arc.of_x >= arc.D))


def _ties_later(scales, began, arc) -> BoolArray:
    """Ties after crossings, and of arrivals and releases with the ends of the interval."""
    a, q, span = scales.half_width, arc.q, arc.span
    side, h, arrival = _last_meeting(jnp.where(arc.meets, arc.h, 0), arc.side, arc.angle, q, a, span)
    arrived, crossed = arc.meets & (arrival < span), arc.meets & (h < arc.h)
    holds = crossed & ((arrived & (jnp.abs(h - 2 * a) <= arc.of_h)) | (h <= arc.of_h))
    # The relative velocity changes at the rate h where it passes zero: times h, angles are lengths.
    eps = float(jnp.finfo(h.dtype).eps)
    when = arc.of_state + h * (_few(h) * span + _CLOCK_ULPS * eps * scales.omega * began.t)
    at_end = arc.meets & (h <= 2 * a + arc.of_h) & (jnp.abs(arrival - span) * h <= when)
    at_start = arrived & ~crossed & (arc.p != q) & (arrival * h <= arc.of_state)
    beyond = side * (a - h) + q * (span - arrival) - a
    at_release = arrived & (q > 0) & (jnp.abs(beyond) * h <= (arc.of_h + arc.of_x) * h + q * when)
    return holds | at_end | at_start | at_release


def _last_meeting(h, side, arrival, q, a, span):
    """Side, distance h and angle of the first meeting with the base velocity that friction can hold or that lies after
    the interval; all before it are crossings.
    """

    def crosses(state):
        _, h, arrival = state
        return (h > 2 * a) & (arrival < span)

    def cross(state):
        side, h, arrival = state
        return -side, h - 2 * a, arrival + twice_the_angle(h - 2 * a, side * q)

    state = side, h, arrival
    state = jax.tree.map(lambda new, old: jnp.where(crosses(state), new, old), cross(state), state)
    return lax.while_loop(crosses, cross, state)


def _few(like: FloatArray) -> float:
    return _NEAR_ULPS[like.dtype.itemsize] * float(jnp.finfo(like.dtype).eps)
