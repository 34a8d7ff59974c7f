"""Largest position and velocity while the base velocity is constant, in closed form.

Every slip is an arc of a circle about ``+a`` or ``-a`` (`arcs.py`): its position is extreme where ``p = 0``, at the
distance R from the centre, and its velocity where the mass passes the centre. Where arcs cross the base velocity one
after the other, each has a smaller radius than the one before: only the first on each side can hold an extreme that is
not at the beginning of an interval.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from ..._types import BoolArray, FloatArray, Scalar
from .arcs import carry_across, first_arc, mirrored, twice_the_angle
from .crossing import Motion, Scales

_AHEAD = {False: (0.0, jnp.pi), True: (-jnp.pi / 2, jnp.pi / 2)}
"""How much further an arc turns to its largest and to its smallest value than to its largest position."""


class _Arc(NamedTuple):
    """An arc about `center` that begins at the `offset` from it and with `p`, and turns by `angle` if it `exists`."""

    exists: BoolArray
    center: FloatArray
    offset: FloatArray
    p: FloatArray
    angle: FloatArray


def largest_in_interval(
    scales: Scales, motion: Motion, duration: FloatArray, velocity: FloatArray, *, of_velocity: bool, sign: Scalar
) -> FloatArray:
    """The largest value of `sign` times the position (m), or the velocity over omega (m), in an interval.

    It begins with `motion`; its end is not included. Base `velocity` in m/s.
    """
    left = scales.t1 - motion.t
    span = scales.omega * jnp.clip(jnp.where(duration < left, duration, left), 0)
    mirror, x, p, q, span = mirrored(motion.x, motion.p, velocity * scales.inverse_omega, span)
    passage = carry_across(x, p, q, scales.half_width, span)
    upwards = sign * mirror
    start, stick = (p, q) if of_velocity else (x, passage.position)
    # A stick moves at the base's velocity, from where it begins.
    found = [upwards * start, jnp.where(passage.stuck, upwards * stick, upwards * start)]
    arcs = [*_arcs_until_stick(x, p, q, scales.half_width, span)]
    arcs.append(_Arc(passage.released, scales.half_width, jnp.zeros_like(q), q, span - passage.left))
    for arc in arcs:
        reached, value = _largest_on(arc, of_velocity, upwards)
        found.append(jnp.where(reached, value, upwards * start))
    return jnp.max(jnp.stack(found))


def _arcs_until_stick(x: FloatArray, p: FloatArray, q: FloatArray, a: FloatArray, span: FloatArray) -> list[_Arc]:
    """The first arc of the interval, and the first two after crossings of the base velocity."""
    first = first_arc(x, p, q, a, span)
    begun = jnp.where(first.arrives, first.angle, span)
    arcs = [_Arc(jnp.ones((), bool), first.side * a, first.offset, first.p, begun)]
    crosses, side, h = first.arrives & (first.h > 2 * a), first.side, first.h
    for _ in range(2):
        side, h = -side, jnp.where(crosses, h - 2 * a, 1)
        angle = twice_the_angle(h, -side * q)
        arrives = begun + angle < span
        angle = jnp.where(arrives, angle, span - begun)
        arcs.append(_Arc(crosses, side * a, side * h, q, angle))
        crosses, begun = crosses & arrives & (h > 2 * a), begun + angle
    return arcs


def _largest_on(arc: _Arc, of_velocity: bool, sign: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Whether an arc reaches the largest value of `sign` times position or velocity on its circle, and that value."""
    squared = arc.offset**2 + arc.p**2
    moves = squared > 0
    radius = jnp.where(moves, jnp.sqrt(jnp.where(moves, squared, 1)), 0)
    # Clockwise from its beginning to the largest position. No derivative passes through what decides.
    turned = lax.stop_gradient(jnp.arctan2(arc.p, arc.offset))
    to_largest, to_smallest = _AHEAD[of_velocity]
    ahead = jnp.mod(turned + jnp.where(sign > 0, to_largest, to_smallest), 2 * jnp.pi)
    center = jnp.zeros_like(radius) if of_velocity else arc.center
    return arc.exists & moves & (ahead <= arc.angle), sign * center + radius
