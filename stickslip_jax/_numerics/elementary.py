"""Elementary functions that vectorise: of angles and of random bits, and the motion of a damped linear oscillator."""

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from .._compiler.native import computed_once
from .._foundation.checks import show
from .._foundation.types import BoolArray, FloatArray, KeyData

# Elementary functions that vectorise: sine and cosine together, the angle of a vector, the logarithm.
#
# XLA's CPU back end calls scalar library code for ``sin``, ``cos``, ``atan2`` and ``log``; the polynomials below
# compile to vector instructions and cost a fifth of that. The coefficients are those of
# FreeBSD's msun (fdlibm) kernels except the logarithm's, accurate to about one unit in the last place in float64;
# float32 uses the same polynomials with its own range reduction. Derivatives are the exact ones, not those of the
# polynomials.


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


@_sincos.defjvp
def _sincos_jvp(primals, tangents):
    (angle,), (d_angle,) = primals, tangents
    s, c = _sincos(angle)
    return (s, c), (c * d_angle, -s * d_angle)


def sincos_of_small(angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``(sin(angle), cos(angle))`` for angles below 0.6 rad: the polynomials alone, a third of the work."""
    z = angle * angle
    return angle + angle * z * _horner(_SIN, z), 1 - 0.5 * z + z * z * _horner(_COS, z)


_polynomials = computed_once(sincos_of_small)


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


# Counter-based random bits: word ``i`` of the stream of a key is computed from the key and ``i`` alone.
#
# So a stream can be cut into blocks anywhere and continued without end, and a longer sample of the same key begins
# with the shorter one. The generator is JAX's own threefry-2x32; ``random_words`` returns the bits that
# ``jax.random.bits(key, (n,), "uint64")`` holds at those positions. It is written out here because JAX's CPU version
# runs its 20 rounds as a rolled loop, four times slower (Salmon et al. 2011, "Parallel random
# numbers: as easy as 1, 2, 3").


_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def key_data_of(key: Array) -> Array:
    """The two 32-bit words of a threefry key (new style ``jax.random.key`` or old style ``PRNGKey``).

    Raises ValueError for anything else; other generators are refused because under ``vmap`` some of them
    give every element of the batch the same stream.
    """
    if isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        if "fry" in str(jax.random.key_impl(key)) and key.shape == ():
            return jax.random.key_data(key)
    elif isinstance(key, (jax.Array, np.ndarray)) and key.dtype == np.uint32 and key.shape == (2,):
        return jnp.asarray(key)
    raise ValueError(f"Argument key must be a threefry key made by jax.random.key(seed), but {show(key)} was given.")


def random_words(words: KeyData, counter: Array) -> tuple[Array, Array]:
    """High and low 32 random bits for each 32-bit ``counter`` (any shape)."""
    schedule = (words[0], words[1], words[0] ^ words[1] ^ np.uint32(0x1BD11BDA))
    x = jnp.zeros_like(counter) + schedule[0]
    y = counter + schedule[1]
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            x = x + y
            y = x ^ ((y << np.uint32(rotation)) | (y >> np.uint32(32 - rotation)))
        x = x + schedule[(group + 1) % 3]
        y = y + schedule[(group + 2) % 3] + np.uint32(group + 1)
    return x, y


def stored_words(words: KeyData, counter: Array) -> tuple[Array, Array]:
    """`random_words`, computed only once for both words and all their uses."""
    if not jax.config.read("jax_enable_x64"):
        return computed_once(random_words)(words, counter)
    both = computed_once(_joined_words)(words, counter)
    return (both >> np.uint64(32)).astype(np.uint32), both.astype(np.uint32)


def _joined_words(words: KeyData, counter: Array) -> Array:
    """Both words in one number; XLA would compute each of two results from the beginning."""
    high, low = random_words(words, counter)
    return (high.astype(np.uint64) << np.uint64(32)) | low.astype(np.uint64)


def exponential(high: Array, low: Array, dtype) -> FloatArray:
    """Exponential deviates of mean 1 from random words: ``-log(u)``, u from `fine_uniform`."""
    return -log(_STORED_UNIFORM[np.dtype(dtype)](high, low))


def fine_uniform(high: Array, low: Array, dtype) -> FloatArray:
    """Uniform deviates from both random words: ``(j + 1/2) / 2^52`` (2^23 in float32)."""
    if jnp.dtype(dtype) == jnp.float64:
        mantissa = ((high.astype(jnp.uint64) << np.uint64(32)) | low.astype(jnp.uint64)) >> np.uint64(12)
        one_to_two = jax.lax.bitcast_convert_type(mantissa | np.uint64(0x3FF0000000000000), jnp.float64)
        return one_to_two - (1 - 2.0**-53)
    one_to_two = jax.lax.bitcast_convert_type((high >> np.uint32(9)) | np.uint32(0x3F800000), jnp.float32)
    return one_to_two - np.float32(1 - 2.0**-24)


# Stored, so that the bits are drawn in one loop and their logarithms are taken in another: each is a long chain of
# operations that wait for one another, and a processor has only so many operations under way.
_STORED_UNIFORM = {
    np.dtype(dtype): computed_once(partial(fine_uniform, dtype=dtype)) for dtype in (np.float64, np.float32)
}


def uniform(words: Array, dtype) -> FloatArray:
    """Uniform deviates from 32 random bits (23 in float32): the midpoints of equal cells of (0, 1)."""
    bits = 32 if jnp.dtype(dtype) == jnp.float64 else 23
    return ((words >> np.uint32(32 - bits)).astype(dtype) + 0.5) * np.asarray(2.0**-bits, dtype)


# The motion of a damped linear oscillator without division by its stiffness or damping: both may be zero.


# Up to this angle, and this part of it that damping takes, motions are summed as series, of so many terms.
_ANGLE, _TERMS = 0.5, 17
_NEAR = 0.1  # below this |(beta^2 - omega^2) h^2|, the rotation of damped motions is summed as a series


class Responses(NamedTuple):
    """What an oscillator ``x'' + 2 beta x' + omega^2 x = f`` at rest in 0 does in the time h.

    `impulse`: its position after an impulse that gives it the velocity 1; `rate`: its velocity then. `step`: its
    position under the constant f = 1, whose velocity is `impulse`. `ramp`: its position under f = t; its velocity is
    `step`. Each is the integral of the one before, and without spring and damping h, 1, h^2 / 2 and h^3 / 6.
    """

    impulse: FloatArray
    rate: FloatArray
    step: FloatArray
    ramp: FloatArray


def responses(beta: Any, omega_squared: Any, h: FloatArray) -> Responses:
    """The `Responses` after the time `h` (s), for any damping and any stiffness from zero on.

    `beta`: damping ratio times omega, 1/s (the int 0 for none); `omega_squared`: rad^2/s^2. All digits of each are
    right but where the motion itself passes zero, and so are the derivatives, at zero stiffness too.
    """
    turned = omega_squared * h * h
    if isinstance(beta, int):
        near = turned < _ANGLE
        z = jnp.where(near, turned, 0)
        step, ramp = h * h * _series(z, range(2, 19, 2)), h * h * h * _series(z, range(3, 20, 2))
        squared = jnp.where(near, 1, omega_squared)
        w = jnp.sqrt(squared)
        sine, cosine = sincos(jnp.where(near, 0, w * h))
        turn = sine / w
        far = Responses(turn, cosine, (1 - cosine) / squared, (h - turn) / squared)
        return _chosen(near, Responses(h - omega_squared * ramp, 1 - omega_squared * step, step, ramp), far)
    faded = beta * h
    near = (turned < _ANGLE * _ANGLE) & (faded < _ANGLE)
    return _chosen(
        near, _short(jnp.where(near, faded, 0), jnp.where(near, turned, 0), h), _long(beta, omega_squared, h, near)
    )


def _chosen(first: Any, one: Responses, other: Responses) -> Responses:
    return Responses(*(jnp.where(first, a, b) for a, b in zip(one, other, strict=True)))


def _series(z: FloatArray, numbers: range) -> FloatArray:
    """``1 / n! - z / m! + z^2 / k! - ...`` with the `numbers` n, m, k and so on."""
    result = jnp.zeros_like(z)
    for n in reversed(numbers):
        result = 1 / math.factorial(n) - z * result
    return result


def _short(faded: FloatArray, turned: FloatArray, h: FloatArray) -> Responses:
    """Where damping and spring have done little: ``beta h`` and ``(omega h)^2``.

    The n-th integral of the velocity, over h^n, is ``1 / n! - 2 beta h`` times the next, less ``(omega h)^2`` times the
    one after that.
    """
    after = next_ = jnp.zeros_like(h)
    sums: list[FloatArray] = []
    for n in range(_TERMS + 3, -1, -1):
        after, next_ = next_, 1 / math.factorial(n) - 2 * faded * next_ - turned * after
        sums.append(next_)
    rate, impulse, step, ramp = sums[:-5:-1]
    return Responses(h * impulse, rate, h * h * step, h * h * h * ramp)


def _long(beta: Any, omega_squared: Any, h: FloatArray, is_short: Any) -> Responses:
    """Where damping or spring has done much; for other times something finite."""
    squared = jnp.where(is_short, 1, omega_squared - beta * beta)
    z = squared * h * h
    small, under = jnp.abs(z) < _NEAR, squared > 0
    over = ~(small | under)
    w = jnp.sqrt(jnp.where(small, 1, jnp.abs(squared)))
    apart = 1 / jnp.where(over, 2 * w, 1)
    # The sum of two decays if overdamped. The slower rate is the quotient, since a difference would cancel.
    fast_rate = jnp.where(over, beta + w, 1)
    slow_rate = omega_squared / fast_rate
    fast, slow = jnp.exp(-fast_rate * h), jnp.exp(-slow_rate * h)
    slow_1, slow_2 = _decays(jnp.where(over, slow_rate * h, 0), h)
    fast_1 = (1 - fast) / fast_rate
    decays = Responses(
        apart * (slow - fast),
        apart * (fast_rate * fast - slow_rate * slow),
        apart * (slow_1 - fast_1),
        apart * (slow_2 - (h - fast_1) / fast_rate),
    )
    # Otherwise a rotation that decays.
    decay = jnp.exp(-jnp.where(over, 0, beta * h))
    sine, cosine = sincos(jnp.where(under & ~small, w * h, 0))
    series = (1 - z / 2 * (1 - z / 12 * (1 - z / 30 * (1 - z / 56 * (1 - z / 90)))),
              h * (1 - z / 6 * (1 - z / 20 * (1 - z / 42 * (1 - z / 72 * (1 - z / 110))))))  # fmt: skip
    cosine = decay * jnp.where(small, series[0], cosine)
    impulse = decay * jnp.where(small, series[1], sine / w)
    stiff = jnp.where(over | is_short, 1, omega_squared)
    step = (1 - cosine - beta * impulse) / stiff
    turns = Responses(impulse, cosine - beta * impulse, step, (h - impulse - 2 * beta * step) / stiff)
    return _chosen(over, decays, turns)


def _decays(y: FloatArray, h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The integral of ``exp(-s t)`` up to h, and the integral of that; ``y = s h``."""
    near = y < 1
    z = jnp.where(near, y, 0)
    second = _series(z, range(2, 21))
    far = jnp.where(near, 1, y)
    first = jnp.where(near, 1 - z * second, (1 - jnp.exp(-far)) / far)
    return h * first, h * h * jnp.where(near, second, (1 - first) / far)
