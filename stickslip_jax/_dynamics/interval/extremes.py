"""Largest position and velocity while the base velocity is constant, in closed form.

Every slip is an arc of a circle (`arcs.py`): its position is extreme where the velocity is zero, and its velocity where
the mass passes the centre. Where arcs cross the base velocity one after the other, each has a smaller radius than the
one before: only the first on each side can hold an extreme that is not at the beginning of an interval.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from ..._types import BoolArray, FloatArray, Scalar
from .arcs import Scales, carry_across, first_arc, is_crossed, mirrored, time_of_arc
from .crossing import Motion
from .spring import Spring, quotient, swung

_AHEAD = {False: (0.0, jnp.pi), True: (-jnp.pi / 2, jnp.pi / 2)}
"""How much further an arc turns to its largest and to its smallest value than to its largest position."""


class _Arc(NamedTuple):
    """An arc from the position `x`, velocity `v` and deceleration `A`, which lasts for `time` if it `exists`."""

    exists: BoolArray
    x: FloatArray
    v: FloatArray
    A: FloatArray
    time: FloatArray


def largest_in_interval(
    scales: Scales, motion: Motion, duration: FloatArray, velocity: FloatArray, *, of_velocity: bool, sign: Scalar
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
    arcs = _arcs_until_stick(x, v, q, turned, scales, span)
    arcs.append(_Arc(passage.released, passage.left_at, q, jnp.zeros_like(q), span - passage.left))
    for arc in arcs:
        reached, value = _largest_on(arc, scales.spring, of_velocity, upwards)
        found.append(jnp.where(reached, value, upwards * start))
    return jnp.max(jnp.stack(found))


def _arcs_until_stick(
    x: FloatArray, v: FloatArray, q: FloatArray, turned: FloatArray, scales: Scales, span: FloatArray
) -> list[_Arc]:
    """The first arc of the interval, and the first two after crossings of the base velocity."""
    alpha, spring = scales.deceleration, scales.spring
    first = first_arc(x, v, q, turned, scales, span)
    begun = jnp.where(first.arrives, first.time, span)
    arcs = [_Arc(jnp.ones((), bool), x, first.v, first.side * first.A, begun)]
    crosses, side, H = first.arrives & is_crossed(first.H, alpha), first.side, first.H
    for _ in range(2):
        side, H = -side, jnp.where(crosses, H - 2 * alpha, 1)
        time = time_of_arc(H, side, turned, spring)
        arrives = begun + time < span
        time = jnp.where(arrives, time, span - begun)
        arcs.append(_Arc(crosses, side * quotient(alpha + H, crosses, spring), q, side * H, time))
        crosses, begun = crosses & arrives & is_crossed(H, alpha), begun + time
    return arcs


def _largest_on(arc: _Arc, spring: Spring, of_velocity: bool, sign: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Whether an arc reaches the largest value of `sign` times position or velocity on its circle, and that value."""
    x, v, A = arc.x, arc.v, arc.A
    # Clockwise from its beginning to the largest position. No derivative passes through when that is: there the value
    # does not change with time.
    angle = jnp.arctan2(*lax.stop_gradient((spring.omega * v, A)))
    to_largest, to_smallest = _AHEAD[of_velocity]
    ahead = jnp.mod(angle + jnp.where(sign > 0, to_largest, to_smallest), 2 * jnp.pi)
    when = ahead * spring.inverse_omega
    reached = arc.exists & ((A != 0) | (v != 0)) & (when <= arc.time)
    position, velocity = swung(x, v, A, jnp.where(reached, when, 0), spring)
    return reached, sign * (velocity if of_velocity else position)
