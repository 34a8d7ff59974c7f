"""Kernel weights that turn sticks about to appear or vanish into derivatives of expectations.

Let the margin ``g`` be positive while a stick exists and 0 where it vanishes, with density ``f(0)`` there. Sticks that
appear and vanish add ``f(0) E[dg/dtheta | g = 0]`` times its jump to the derivative of the mean of a functional. A
kernel ``K`` of width ``h`` estimates that as the mean of the sum of ``K(g / h) / h * dg/dtheta`` times the jump. With
``int K = 1`` and ``int u K = 0`` its bias is of order ``h^2`` (boundary kernels: Jones 1993, "Simple boundary
correction for kernel density estimation"; of flux: Liu and Hong 2011, "Kernel estimation of the Greeks for options with
discontinuous payoffs").
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
    """Zero, whose derivative estimates that of the expected count of positive `distance`, a margin known on both sides.

    The kernel is as wide as `distance` moves, to first order, when the parameters move `bandwidth` times the direction
    of differentiation: ``u = distance / (bandwidth |d distance|)``, and the derivative is ``sign(d distance) K(u) /
    bandwidth`` with Epanechnikov's ``K(u) = 3/4 (1 - u^2)`` for -1 < u < 1. So every weight is bounded, margins that do
    not move have none, and the result is, to first order, that of a central difference of this step. It is linear in
    the direction only in expectation: use forward mode only.
    """
    return 0 * distance


@crossing.defjvp
def _crossing_jvp(primals, tangents):
    weight, sign, hit = _moved(primals, tangents)
    return 0 * primals[0], jnp.where(hit, sign * 0.75 * (1 - weight * weight) / primals[1], 0)


@jax.custom_jvp
def ending(distance: FloatArray, bandwidth: Array, where: BoolArray) -> Array:
    """Like `crossing`, for a `distance` known only while positive, with ``K(u) = 4 - 6 u`` for 0 < u < 1."""
    return 0 * distance


@ending.defjvp
def _ending_jvp(primals, tangents):
    weight, sign, hit = _moved(primals, tangents)
    return 0 * primals[0], jnp.where(hit & (weight > 0), sign * (4 - 6 * weight) / primals[1], 0)


@jax.custom_jvp
def hits(distance: FloatArray, bandwidth: Array, where: BoolArray) -> Array:
    """Zero, whose derivative is 1 inside the window of `crossing` and `ending`: counts the margins they rest on."""
    return 0 * distance


@hits.defjvp
def _hits_jvp(primals, tangents):
    weight, _, hit = _moved(primals, tangents)
    return 0 * primals[0], hit.astype(weight.dtype)


def _moved(primals, tangents):
    """``u``, the sign of ``d distance``, and whether ``|u| < 1`` and `where` is true."""
    distance, bandwidth, where = primals
    change = jnp.abs(tangents[0])
    hit = where & (jnp.abs(distance) < bandwidth * change)
    return distance / jnp.where(hit, bandwidth * change, 1), jnp.sign(tangents[0]), hit


def weighted_flux(weight: Array, distance: FloatArray, where: BoolArray) -> Array:
    """Zero, whose derivative is ``weight * d distance`` where `where` is true.

    Added to a count, it makes the count's derivative an unbiased estimate of that of its expectation, if `weight` is
    the density of `distance` at 0.
    """
    distance = jnp.where(where, distance, 0)
    return jnp.where(where, lax.stop_gradient(weight), 0) * (distance - lax.stop_gradient(distance))


def through(edges: Edges, bandwidth: Array, both_sides: Kernel, one_side: Kernel) -> Array:
    """The sum over all margins of `edges`: the flux with kernels `crossing` and `ending`, their number with `hits`."""
    found = [both_sides(number.value, bandwidth, number.decides) for number in edges.both_sides]
    found += [one_side(number.value, bandwidth, number.decides) for number in edges.one_side]
    return sum(found[1:], found[0])
