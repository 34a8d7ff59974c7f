"""Weights that turn sticks near the edge of existence into derivatives of expectations.

Let ``g`` be a number that is positive while a stick exists and falls to 0 as the stick vanishes, with density ``f`` at
0. What sticks born and lost add to the derivative of the mean of a functional is ``f(0) E[dg/dtheta at 0]`` times its
jump there. A kernel ``K`` of window ``h`` estimates that as the mean of the sum of ``K(g / h) / h * dg/dtheta`` times
the jump. With ``int K = 1`` and ``int u K = 0`` its bias is of order ``h^2`` (boundary kernels: Jones 1993, "Simple
boundary correction for kernel density estimation"; of flux: Liu and Hong 2011, "Kernel estimation of the Greeks for
options with discontinuous payoffs").
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, BoolArray, FloatArray
from .edges import Edges

Kernel = Callable[[FloatArray, Array, BoolArray], Array]


@jax.custom_jvp
def crossing(distance: FloatArray, bandwidth: Array, where: BoolArray) -> Array:
    """Zero, with the derivative of a count of what exists where `distance` is positive.

    Seen on both sides of 0, near misses included. The window is as wide as `distance` moves, to first order, when the
    parameters move `bandwidth` times the direction of differentiation: ``u = distance / (bandwidth |d distance|)``, and
    the derivative is ``sign(d distance) K(u) / bandwidth`` with ``K(u) = 3/4 (1 - u^2)`` for -1 < u < 1. So every
    weight is bounded, what does not move is left out, and the answer is what a central difference of that step would
    give to first order. It is linear in the direction only in expectation: forward mode alone.
    """
    return 0 * distance


@crossing.defjvp
def _crossing_jvp(primals, tangents):
    weight, sign, hit = _moved(primals, tangents)
    return 0 * primals[0], jnp.where(hit, sign * 0.75 * (1 - weight * weight) / primals[1], 0)


@jax.custom_jvp
def ending(distance: FloatArray, bandwidth: Array, where: BoolArray) -> Array:
    """The same where `distance` is seen only while it is positive, with ``K(u) = 4 - 6 u`` for 0 < u < 1."""
    return 0 * distance


@ending.defjvp
def _ending_jvp(primals, tangents):
    weight, sign, hit = _moved(primals, tangents)
    return 0 * primals[0], jnp.where(hit & (weight > 0), sign * (4 - 6 * weight) / primals[1], 0)


@jax.custom_jvp
def hits(distance: FloatArray, bandwidth: Array, where: BoolArray) -> Array:
    """Zero, with 1 for derivative where `crossing` or `ending` has any: to count what they rest on."""
    return 0 * distance


@hits.defjvp
def _hits_jvp(primals, tangents):
    weight, _, hit = _moved(primals, tangents)
    return 0 * primals[0], hit.astype(weight.dtype)


def _moved(primals, tangents):
    """``u``, the sign of the motion, and whether ``|u| < 1``, where it counts."""
    distance, bandwidth, where = primals
    change = jnp.abs(tangents[0])
    hit = where & (jnp.abs(distance) < bandwidth * change)
    return distance / jnp.where(hit, bandwidth * change, 1), jnp.sign(tangents[0]), hit


def weighted_flux(weight: Array, distance: FloatArray, where: BoolArray) -> Array:
    """Zero, with the derivative ``weight * d distance`` where it holds.

    Added to a count, it makes the derivative of the count that of its expectation.
    """
    distance = jnp.where(where, distance, 0)
    return jnp.where(where, lax.stop_gradient(weight), 0) * (distance - lax.stop_gradient(distance))


def through(edges: Edges, bandwidth: Array, both_sides: Kernel, one_side: Kernel) -> Array:
    """What all numbers of the edges add: `crossing` and `ending` for the flux, twice `hits` to count."""
    found = [both_sides(number.value, bandwidth, number.decides) for number in edges.both_sides]
    found += [one_side(number.value, bandwidth, number.decides) for number in edges.one_side]
    return sum(found[1:], found[0])
