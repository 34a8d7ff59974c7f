"""Whether round-off decided about an event in an interval of the base (`near_grazing_count`).

Found from the state in which the interval began, beside the motion. With H, the distance from the centre at which an
arc meets the base velocity, the last digits decide

- on an arc that is nearly tangent to the base velocity, whether it meets it;
- at ``H = 2 alpha``, whether friction holds the mass, and at ``H = 0`` whether it does so for more than an instant;
- where an arrival or a release falls on the end of the interval, whether there is one. A stick between the two would
  have no length: it is none (`Passage.tie`, which ensembles count too);
- where an arrival falls on its beginning, whether there was a slip before.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..._types import BoolArray, FloatArray
from .arcs import CLOCK_ULPS, Scales, few, first_arc, is_crossed, mirrored, time_of_arc, touch
from .crossing import Motion

LAST_LEFT = "slip_displacement"  # the quantity of a stick that remembers where the last one ended


class _Arc(NamedTuple):
    """The first arc of an interval, in accelerations (`arcs.py`): `A`, its distance from the centre at the beginning;
    its first velocity and the base speed times omega, `v` and `q`; where (`H`, `side`) and when (`time`, s) it meets
    the base velocity, and whether it `meets` it; `excess` ``= R^2 - q^2``.

    `begins`: with the base velocity. Errors: `of_x`, that of positions times w2; `of_v`, of velocities (m/s); `of_H`,
    that of H.
    """

    A: FloatArray
    v: FloatArray
    q: FloatArray
    speed: FloatArray  # of the base, m/s
    begins: BoolArray
    span: FloatArray
    excess: FloatArray
    side: FloatArray
    H: FloatArray
    time: FloatArray
    meets: BoolArray
    of_x: FloatArray
    of_v: FloatArray
    of_H: FloatArray


def is_tie(scales: Scales, began: Motion, duration: FloatArray, velocity: FloatArray) -> BoolArray:
    """Whether round-off decided about an event in the interval of the base that began so. No derivative."""
    scales, began, duration, velocity = lax.stop_gradient((scales, began, duration, velocity))
    arc = _arc(scales, began, duration, velocity)
    has_events = (arc.span > 0) & (scales.deceleration > 0)  # without friction there is none
    return has_events & (_ties_at_first(scales, began, arc) | _ties_later(scales, began, arc))


def starts_at_edge(scales: Scales, start: Motion, velocity: FloatArray) -> BoolArray:
    """Whether a trajectory starts with its base's `velocity` at an edge of the stick band: one of the ties of `is_tie`,
    which alone costs nearly nothing.
    """
    pull, alpha = scales.spring.squared * jnp.abs(start.x), scales.deceleration
    return (jnp.abs(pull - alpha) <= few(pull) * (pull + alpha)) & (start.v == velocity) & (alpha > 0)


def _arc(scales, began, duration, velocity) -> _Arc:
    alpha, t1, omega = scales.deceleration, scales.t1, scales.spring.omega
    span = jnp.where(began.t + duration >= t1, t1 - began.t, duration)
    _, x, v, speed, q, span = mirrored(began.x, began.v, velocity, scales, span)
    side, A, v, excess, H, time, _, _, _ = first_arc(x, v, speed, q, scales, span)
    meets = excess > jnp.where(v < speed, touch(A, q, scales), 0)
    A, begins = jnp.abs(A), v == speed
    of_v = few(x) * (jnp.abs(v) + speed + (A + alpha) * scales.clock)
    v = omega * v
    size = A + jnp.abs(v) + q + alpha
    of_x, of_state = few(x) * (A + 2 * alpha), few(x) * size
    # H^2 = A^2 + v^2 - q^2 has the error of its terms; a mass that has the base's velocity exactly meets it at H = A.
    of_H = jnp.where(begins, of_x, of_state * size / jnp.where(meets, H, 1))
    return _Arc(A, v, q, speed, begins, span, excess, side, H, time, meets, of_x, of_v, of_H)


def _ties_at_first(scales, began, arc) -> BoolArray:
    """Ties of the first arc: of the place where the mass begins on the base, of tangency, of the edge of the band."""
    alpha, threshold = scales.deceleration, touch(arc.A, arc.q, scales)
    # After a release at this velocity the arc is tangent to it in exact numbers, which the threshold knows.
    left_at = scales.spring.squared * jnp.abs(began.remembered[LAST_LEFT])
    released = (jnp.abs(left_at - alpha) <= few(alpha) * alpha) & (began.t > 0)
    returns = released & (jnp.abs(arc.excess) <= threshold)
    tangent = (arc.v < arc.q) & (jnp.abs(arc.excess) <= 2 * threshold) & ~returns
    at_edge = arc.meets & (jnp.abs(arc.H - 2 * alpha) <= arc.of_H)
    return ((arc.time < arc.span) & (tangent | at_edge)) | (arc.begins & (arc.of_x >= arc.A))


def _ties_later(scales, began, arc) -> BoolArray:
    """Ties after crossings, and of arrivals and releases with the ends of the interval."""
    alpha, span = scales.deceleration, arc.span
    side, H, arrival = _last_meeting(jnp.where(arc.meets, arc.H, 0), arc.side, arc.time, arc.q, scales, span)
    arrived, crossed = arc.meets & (arrival < span), arc.meets & (H < arc.H)
    holds = crossed & ((arrived & (jnp.abs(H - 2 * alpha) <= arc.of_H)) | (arc.of_H >= H))
    # The relative velocity changes at the rate H where it passes zero: times H, times are velocities.
    eps, rate = float(jnp.finfo(H.dtype).eps), scales.spring.squared * arc.speed
    when = arc.of_v + H * (few(H) * span + CLOCK_ULPS * eps * began.t)
    at_end = arc.meets & (2 * alpha + arc.of_H >= H) & (jnp.abs(arrival - span) * H <= when)
    at_start = arrived & ~crossed & ~arc.begins & (arrival * H <= arc.of_v)
    beyond = side * (alpha - H) + rate * (span - arrival) - alpha
    at_release = arrived & (rate > 0) & (jnp.abs(beyond) * H <= (arc.of_H + arc.of_x) * H + rate * when)
    return holds | at_end | at_start | at_release


def _last_meeting(H, side, arrival, q, scales, span):
    """Side, distance H and time of the first meeting with the base velocity that friction can hold or that lies after
    the interval; all before it are crossings.
    """
    alpha = scales.deceleration

    def crosses(state):
        _, H, arrival = state
        return is_crossed(H, alpha) & (arrival < span)

    def cross(state):
        side, H, arrival = state
        return -side, H - 2 * alpha, arrival + time_of_arc(H - 2 * alpha, -side, q, scales.spring)

    state = side, H, arrival
    state = jax.tree.map(lambda new, old: jnp.where(crosses(state), new, old), cross(state), state)
    return lax.while_loop(crosses, cross, state)
