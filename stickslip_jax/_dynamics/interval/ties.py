"""Intervals of the base in which round-off decided whether there was an event (`near_grazing_count`).

They are found afterwards, from the states at which the intervals began, so that the loops over intervals, in which the
count would cost as much as the motion, know nothing of it. With h, the distance from the centre at which an arc meets
the base velocity, the last digits decide

- on an arc that is nearly tangent to the base velocity, whether it meets it;
- at ``h = 2 a``, whether friction holds the mass, and at ``h = 0`` whether it does so for more than an instant;
- where the arrival or the release falls on the end of the interval, whether there is one;
- where the arrival falls on its beginning, whether there was a slip before.
"""

import jax.numpy as jnp
from jax import lax

from ..._types import BoolArray, FloatArray
from .arcs import first_arc, follow_crossings, mirrored, touch, twice_the_angle
from .engine import Motion, Scales

# How close is near, in units in the last place of the lengths involved: three times the error of the state after 10^4
# intervals, which grows with the square root of their number (`_TOUCH_ULPS` of `arcs.py`). By chance, an interval
# comes so close once in 10^13 (float32: once in 10^5).
_NEAR_ULPS = {8: 256, 4: 64}


def is_tie(scales: Scales, began: Motion, duration: FloatArray, velocity: FloatArray) -> BoolArray:
    """Whether round-off decided about an event in the interval that began so."""
    scales, began, duration, velocity = lax.stop_gradient((scales, began, duration, velocity))
    omega, inverse_omega, a, t1 = scales
    span = omega * jnp.where(began.t + duration >= t1, t1 - began.t, duration)
    _, x, p, q, span = mirrored(began.x, began.p, velocity * inverse_omega, span)
    side, offset, p, excess, first_h, angle, met = first_arc(x, p, q, a, span)
    last_side, h, entered, arrived = follow_crossings(side, first_h, angle, met, q, a, span)

    D, on_base = jnp.abs(offset), p == q
    few = _NEAR_ULPS[x.dtype.itemsize] * jnp.finfo(x.dtype).eps
    size = D + jnp.abs(p) + q + a
    of_x, of_state, of_angle = few * (D + 2 * a), few * size, few * (span + omega * began.t)
    # h^2 = D^2 + p^2 - q^2 has the error of its terms; a mass that has the base's velocity exactly meets it at D.
    of_h = jnp.where(on_base, of_x, of_state * size / jnp.where(first_h > 0, first_h, 1))

    # After a release at this velocity the arc is tangent to it in exact numbers, which the threshold knows.
    threshold = touch(D, q, a)
    returns = (jnp.abs(began.slid_from) == a) & (jnp.abs(excess) <= threshold)
    tangent = (p < q) & (jnp.abs(excess) <= 2 * threshold) & (angle <= span) & ~returns

    crossed = met & (h != first_h)
    held = (met & arrived & (jnp.abs(h - 2 * a) <= of_h)) | (crossed & (h <= of_h)) | (on_base & (D <= of_x))

    meets = jnp.where(p < q, excess > threshold, excess > 0)
    after = entered + twice_the_angle(h, -last_side * q)
    arrival = jnp.where(crossed & ~arrived, after, jnp.where(arrived, entered, angle))
    # The relative velocity changes at the rate h.
    when = of_state + of_angle * h
    at_end = meets & (h <= 2 * a + of_h) & (jnp.abs(arrival - span) * h <= when)
    at_start = arrived & ~crossed & (entered > 0) & (entered * h <= of_state)
    lasts = (a - last_side * (a - h)) - q * (span - entered)
    at_release = arrived & (q > 0) & (jnp.abs(lasts) <= of_h + of_x + q * when / jnp.where(h > 0, h, 1))
    return (span > 0) & (tangent | held | at_end | at_start | at_release)
