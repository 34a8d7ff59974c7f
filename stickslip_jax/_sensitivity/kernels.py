"""Kernel weights that turn sticks about to appear or vanish into derivatives of expectations.

Let the signed distance ``g`` be positive while a stick exists and 0 where it vanishes, with density ``f(0)`` there.
Sticks that appear and vanish add ``f(0) E[dg/dtheta | g = 0]`` times its jump to the derivative of the mean of a
functional. A kernel ``K`` of width ``h`` estimates that as the mean of the sum of ``K(g / h) / h * dg/dtheta`` times
the jump. With ``int K = 1`` and ``int u K = 0`` its bias is of order ``h^2`` (one-sided kernels: Jones 1993, "Simple
boundary correction for kernel density estimation"; derivatives of expectations: Liu and Hong 2011, "Kernel estimation
of the Greeks for options with discontinuous payoffs").
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax import lax

from .._types import BoolArray, DType, FloatArray
from .boundaries import SignedDistance

Kernel: TypeAlias = Callable[[FloatArray, FloatArray, BoolArray], FloatArray]
"""A function of distance, bandwidth and where the distance is active."""


def _kernel(slope: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]) -> Kernel:
    """Zero, whose derivative is ``slope(u, sign(d distance), bandwidth)`` where the distance is active and |u| < 1."""

    @jax.custom_jvp
    def zero(distance, bandwidth, where):
        return 0 * distance

    @zero.defjvp
    def _(primals, tangents):
        distance, bandwidth, where = primals
        change = jnp.abs(tangents[0])
        inside = where & (jnp.abs(distance) < bandwidth * change)
        u = distance / jnp.where(inside, bandwidth * change, 1)
        return 0 * distance, jnp.where(inside, slope(u, jnp.sign(tangents[0]), bandwidth), 0)

    return zero


two_sided_kernel = _kernel(lambda u, sign, bandwidth: sign * 0.75 * (1 - u * u) / bandwidth)
"""Zero, whose derivative estimates that of the expected count of positive `distance`, known on both sides of 0.

The kernel is as wide as `distance` moves, to first order, when the parameters move `bandwidth` times the direction of
differentiation: ``u = distance / (bandwidth |d distance|)``, and the derivative is ``sign(d distance) K(u) /
bandwidth`` with Epanechnikov's ``K(u) = 3/4 (1 - u^2)`` for -1 < u < 1. So every weight is bounded, distances that do
not move have none, and the result is, to first order, that of a central difference of this step. It is linear in the
direction only in expectation: use forward mode only.
"""

one_sided_kernel = _kernel(lambda u, sign, bandwidth: jnp.where(u > 0, sign * (4 - 6 * u) / bandwidth, 0))
"""Like `two_sided_kernel`, for a `distance` known only while positive, with ``K(u) = 4 - 6 u`` for 0 < u < 1."""

inside_window = _kernel(lambda u, sign, bandwidth: jnp.ones_like(u))
"""Zero, whose derivative is 1 inside the window of the other two: counts the distances that they rest on."""


def zero_with_derivative(weight: FloatArray, distance: FloatArray, where: BoolArray) -> FloatArray:
    """Zero, whose derivative is ``weight * d distance`` where `where` is true.

    Added to a count, it makes the count's derivative an unbiased estimate of that of its expectation, if `weight` is
    the density of `distance` at 0.
    """
    distance = jnp.where(where, distance, 0)
    return jnp.where(where, lax.stop_gradient(weight), 0) * (distance - lax.stop_gradient(distance))


class BoundarySums(NamedTuple):
    """Sums over boundaries for each window: zeros whose derivatives are event parts, or count distances inside it."""

    event_parts: tuple[FloatArray, ...]
    in_window: tuple[FloatArray, ...]

    @classmethod
    def none(cls, windows: int, dtype: DType) -> "BoundarySums":
        """The sums over no boundaries."""
        zeros = (jnp.zeros((), dtype),) * windows
        return cls(zeros, zeros)

    @classmethod
    def over(
        cls, two_sided: tuple[SignedDistance, ...], one_sided: tuple[SignedDistance, ...], bandwidths: FloatArray
    ) -> "BoundarySums":
        """The sums over distances known on both sides of 0, and over those known only while positive."""

        def of(bandwidth: FloatArray, kernels: tuple[Kernel, Kernel]) -> FloatArray:
            found = [kernels[0](distance.value, bandwidth, distance.is_active) for distance in two_sided]
            found += [kernels[1](distance.value, bandwidth, distance.is_active) for distance in one_sided]
            return sum(found[1:], found[0])

        # A Python loop: jax 0.10.2 cannot vmap over the windows where this is differentiated inside a loop.
        both = (two_sided_kernel, one_sided_kernel), (inside_window, inside_window)
        return cls(*(tuple(of(bandwidth, kernels) for bandwidth in bandwidths) for kernels in both))
