"""A friction curve through measured points: monotone between them, with a continuous slope.

Between two points it is a cubic whose slopes at the points are those of F. N. Fritsch and J. Butland, "A method for
constructing local monotone piecewise cubic interpolants", SIAM J. Sci. Stat. Comput. 5 (1984), as in scipy's
`PchipInterpolator`; only the slope at the last point is zero here, because the coefficient is constant beyond.
The curvature jumps at the points. Steps of an eighth-order method that pass a point are shortened by their error
estimate: times of events stay within 1e-7 s of an event-driven integration with a relative tolerance of 1e-12
(tests/systems/test_friction_table.py).
"""

from functools import partial
from typing import Annotated, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._fields import Checked, Quantity
from .._types import AnyArray, Array, Float, FloatArray, Number

PerPoint: TypeAlias = Float[AnyArray, " points"]

_FEW = 64  # points: up to these, comparing with all is faster than bisection


class TabulatedCurve(Checked):
    """The friction coefficient at the relative speed (m/s) by a table; see `FrictionCurve.from_table`."""

    speeds: Annotated[PerPoint, Quantity("m/s", "increasing; the first is 0", ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "speeds")
    )
    coefficients: Annotated[PerPoint, Quantity(at_least=0, ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "coefficients")
    )
    scale: Annotated[Number, Quantity(meaning="what the coefficients are multiplied by", at_least=0)] = 1.0

    def check_parts(self) -> None:
        if np.shape(self.speeds) != np.shape(self.coefficients) or len(self.speeds) < 2:
            raise ValueError(
                "Arguments speeds and coefficients must have the same length of at least 2, but they have shapes "
                f"{np.shape(self.speeds)} and {np.shape(self.coefficients)}."
            )
        _checks.increasing_from_zero(
            "speeds", self.speeds, "put the coefficient at vanishing speed first, curve(0), say that of the first point"
        )
        if _checks.is_traced(self.speeds):
            return
        speeds = np.asarray(self.speeds).astype(jnp.result_type(float))
        if np.any(np.diff(speeds) <= 0):
            at = int(np.argmax(np.diff(speeds) <= 0)) + 1
            raise ValueError(
                f"Argument speeds must increase in {speeds.dtype} too, but speeds[{at}] = {self.speeds[at]} equals the "
                "one before it there; leave one of them out, or set jax_enable_x64."
            )

    def __call__(self, speed: FloatArray) -> FloatArray:
        speed = jnp.asarray(speed, jnp.result_type(float, speed))
        x, y = jnp.asarray(self.speeds, speed.dtype), jnp.asarray(self.coefficients, speed.dtype)
        method = "compare_all" if len(x) <= _FEW else "scan_unrolled"
        here = jnp.clip(jnp.searchsorted(x, speed, side="right", method=method) - 1, 0, len(x) - 2)
        begin, first, second, third = _cubics(x, y)[:, here]
        along = jnp.minimum(speed, x[-1]) - x[here]
        return self.scale * (begin + along * (first + along * (second + along * third)))


@jax.jit
def _cubics(x: PerPoint, y: PerPoint) -> Float[Array, "4 intervals"]:
    """Value and derivatives at the beginning of each interval, divided by factorials: coefficients of its cubic."""
    length = jnp.diff(x)
    secant = jnp.diff(y) / length
    slope = jnp.zeros_like(y).at[0].set(secant[0])  # and 0 at the last point
    if len(x) > 2:
        slope = slope.at[0].set(_edge_slope(*length[:2], *secant[:2]))
        slope = slope.at[1:-1].set(_inner_slopes(length[:-1], length[1:], secant[:-1], secant[1:]))
    bend = (slope[:-1] + slope[1:] - 2 * secant) / length
    return jnp.stack([y[:-1], slope[:-1], (secant - slope[:-1]) / length - bend, bend / length])


def _inner_slopes(length: PerPoint, after: PerPoint, secant: PerPoint, following: PerPoint) -> PerPoint:
    """The slope between two secants of these lengths: their weighted harmonic mean; 0 where the curve turns."""
    same = secant * following > 0
    first, second = 2 * after + length, after + 2 * length
    inverse = first / jnp.where(same, secant, 1) + second / jnp.where(same, following, 1)
    return jnp.where(same, (first + second) / jnp.where(same, inverse, 1), 0)


def _edge_slope(length: FloatArray, after: FloatArray, secant: FloatArray, following: FloatArray) -> FloatArray:
    """The slope at the first point: that of the parabola through three points, where it keeps the curve monotone."""
    parabola = ((2 * length + after) * secant - length * following) / (length + after)
    steep = (secant * following < 0) & (jnp.abs(parabola) > 3 * jnp.abs(secant))
    return jnp.where(parabola * secant > 0, jnp.where(steep, 3 * secant, parabola), 0)
