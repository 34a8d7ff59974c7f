"""Elementary functions that vectorise: sine and cosine together, the angle of a vector, the logarithm.

XLA's CPU back end calls scalar library code for ``sin``, ``cos``, ``atan2`` and ``log``; the polynomials below
compile to vector instructions and cost a fifth of that. The coefficients are those of
FreeBSD's msun (fdlibm) kernels except the logarithm's, accurate to about one unit in the last place in float64;
float32 uses the same polynomials with its own range reduction. Derivatives are the exact ones, not those of the
polynomials.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._compiler import computed_once
from .._types import BoolArray, FloatArray

_SIN = (-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
        2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10)  # fmt: skip
_COS = (4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
        -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11)  # fmt: skip
_ATAN = (3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01,
         -1.11111104054623557880e-01, 9.09088713343650656196e-02, -7.69187620504482999495e-02,
         6.66107313738753120669e-02, -5.83357013379057348645e-02, 4.97687799461593236017e-02,
         -3.65315727442169155270e-02, 1.62858201153657823623e-02)  # fmt: skip
# (log(1 + f) - f + f^2/2) / f^3 on [sqrt(1/2) - 1, sqrt(2) - 1], a Chebyshev fit with error 6e-17. Longer than the
# usual form in s = f / (2 + f), but free of division: XLA stores the result of a division and computes everything
# before it again for each use, here the random bits.
_LOG = (0.33333333333333337, -0.2499999999999993, 0.19999999999993223, -0.16666666666697305, 0.1428571428759174,
        -0.12499999997109267, 0.11111110909841072, -0.0999999999631727, 0.09090919875998202, -0.08333345056413204,
        0.0769198812013375, -0.0714223204915847, 0.06671985555271291, -0.06265031869518063, 0.05837018351464999,
        -0.05368280388050548, 0.0537187789066478, -0.06129561980727906, 0.0566642324205218,
        -0.025061228095282464)  # fmt: skip

# pi/2 in three parts whose products with a whole number below 2^20 (float64) or 2^13 (float32) are exact.
_HALF_PI_PARTS = {
    np.dtype(np.float64): (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21),
    np.dtype(np.float32): (1.5703125, 4.837512969970703125e-4, 7.549789948768648e-8),
}
TAN_PI_8 = 0.41421356237309503


def _horner(coefficients: tuple[float, ...], z: FloatArray) -> FloatArray:
    result = jnp.full_like(z, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        result = result * z + coefficient
    return result


@jax.custom_jvp
def _sincos(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    r, quadrant = _reduced(angle)
    sine, cosine = _polynomials(r)
    swap = (quadrant & 1) == 1
    s, c = jnp.where(swap, cosine, sine), jnp.where(swap, sine, cosine)
    return jnp.where((quadrant & 2) == 2, -s, s), jnp.where(((quadrant + 1) & 2) == 2, -c, c)


@jax.jit  # traced once, so that `sharing` recognises calls with the same angle
def sincos(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``(sin(angle), cos(angle))``, the angle in radians and below 2^30. NaN where it is NaN or infinite."""
    return _sincos(angle)


@computed_once
def _reduced(angle: FloatArray):
    steps = jnp.round(angle * (2 / np.pi))
    high, middle, low = _HALF_PI_PARTS[np.dtype(angle.dtype)]
    return ((angle - steps * high) - steps * middle) - steps * low, steps.astype(jnp.int32)


@computed_once
def _polynomials(r: FloatArray):
    z = r * r
    return r + r * z * _horner(_SIN, z), 1 - 0.5 * z + z * z * _horner(_COS, z)


@_sincos.defjvp
def _sincos_jvp(primals, tangents):
    (angle,), (d_angle,) = primals, tangents
    s, c = _sincos(angle)
    return (s, c), (c * d_angle, -s * d_angle)


def sincos_of_small(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``(sin(angle), cos(angle))`` for angles below 0.6 rad: the polynomials alone, a third of the work."""
    z = angle * angle
    return angle + angle * z * _horner(_SIN, z), 1 - 0.5 * z + z * z * _horner(_COS, z)


@jax.custom_jvp
def angle_of(y: FloatArray, x: FloatArray) -> FloatArray:
    """``atan2(y, x)`` for ``y >= 0``: the angle of the vector ``(x, y)``, in [0, pi]; 0 at the origin.

    The derivative at the origin does not exist; 0 is returned there, so that gradients stay finite.
    """
    fold = folded(y, x)
    t = fold.numerator / jnp.where(fold.denominator == 0, 1, fold.denominator)
    return unfolded(arc_tangent(t), fold)


class Fold(NamedTuple):
    """An angle folded to one below pi/8, of the tangent ``numerator / denominator``, and how: see `unfolded`."""

    numerator: FloatArray
    denominator: FloatArray
    is_steep: BoolArray
    is_high: BoolArray
    is_behind: BoolArray


def folded(y: FloatArray, x: FloatArray) -> Fold:
    """The angle of the vector ``(x, y)``, ``y >= 0``, folded."""
    width = jnp.abs(x)
    least, most = jnp.minimum(width, y), jnp.maximum(width, y)
    # Fold [0, 1] to |t| <= tan(pi/8) with one division for both halves.
    steep = least > TAN_PI_8 * most
    numerator = jnp.where(steep, least - most, least)
    return Fold(numerator, jnp.where(steep, least + most, most), steep, y > width, x < 0)


def unfolded(angle: FloatArray, fold: Fold) -> FloatArray:
    """The angle whose `fold` has the folded `angle`."""
    angle = jnp.where(fold.is_steep, np.pi / 4 + angle, angle)
    angle = jnp.where(fold.is_high, np.pi / 2 - angle, angle)
    return jnp.where(fold.is_behind, np.pi - angle, angle)


def arc_tangent(t: FloatArray) -> FloatArray:
    """``atan(t)`` for ``|t| <= tan(pi/8)``."""
    z = t * t
    return t - t * z * _horner(_ATAN, z)


@angle_of.defjvp
def _angle_of_jvp(primals, tangents):
    (y, x), (dy, dx) = primals, tangents
    squared = x * x + y * y
    somewhere = squared > 0
    scale = jnp.where(somewhere, 1 / jnp.where(somewhere, squared, 1), 0)
    return angle_of(y, x), (x * scale) * dy - (y * scale) * dx


@jax.custom_jvp
def log(x: FloatArray) -> FloatArray:
    """Natural logarithm of positive, normal, finite numbers (no other input is allowed)."""
    if x.dtype == jnp.float64:
        whole, mantissa_bits, root_half = np.int64, 52, np.int64(0x3FE6A09E667F3BCD)
    else:
        whole, mantissa_bits, root_half = np.int32, 23, np.int32(0x3F3504F3)
    bits = lax.bitcast_convert_type(x, whole)
    exponent = (bits - root_half) >> whole(mantissa_bits)
    f = lax.bitcast_convert_type(bits - (exponent << whole(mantissa_bits)), x.dtype) - 1  # in [sqrt(1/2)-1, sqrt(2)-1]
    near_one = f + f * f * (f * _horner(_LOG, f) - 0.5)
    k = exponent.astype(jnp.int32).astype(x.dtype)
    # ln 2 in two parts: the first times a whole number is exact.
    return k * 6.93147180369123816490e-01 + (near_one + k * 1.90821492927058770002e-10)


@log.defjvp
def _log_jvp(primals, tangents):
    (x,), (dx,) = primals, tangents
    return log(x), dx / x
