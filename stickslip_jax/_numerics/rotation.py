"""Damped rotation: the free motion of a linear oscillator."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from .._types import FloatArray
from .elementary import sincos

_SERIES = 0.1  # below this |(beta^2 - omega^2) h^2|, damped rotations are summed as series


class FreeMotion(NamedTuple):
    """The free motion of an oscillator after the time h, from the position u (m) and the velocity w (m/s).

    Its position is ``kept u + carried w``, its velocity ``slowed w - omega^2 carried u``. `settled`: ``1 - kept``,
    without cancellation under heavy damping.
    """

    kept: FloatArray
    carried: FloatArray
    slowed: FloatArray
    settled: FloatArray


def free_motion(beta: Any, omega_squared: Any, h: FloatArray) -> FreeMotion:
    """The `FreeMotion` of ``x'' + 2 beta x' + omega^2 x = 0`` after the time `h` (s), for any damping.

    `beta`: damping ratio times omega, 1/s (the int 0 for none); `omega_squared`: rad^2/s^2.
    """
    if isinstance(beta, int):
        w = jnp.sqrt(omega_squared)
        sine, cosine = sincos(w * h)
        return FreeMotion(cosine, sine / w, cosine, 1 - cosine)
    squared = omega_squared - beta * beta
    z = squared * h * h
    small, under = jnp.abs(z) < _SERIES, squared > 0
    w = jnp.sqrt(jnp.where(small, 1, jnp.abs(squared)))
    # The sum of two decays if overdamped. The slower rate is the quotient, since a difference would cancel.
    fast_rate = beta + w
    slow_rate = omega_squared / fast_rate
    faded = jnp.expm1(-jnp.where(under | small, beta, slow_rate) * h)  # what the slower decay has taken away
    decay, fast = 1 + faded, jnp.exp(-fast_rate * h)
    apart = 1 / jnp.where(under | small, 1, 2 * w)
    settled = apart * (slow_rate * (fast - 1) - fast_rate * faded)
    slowed = apart * (fast_rate * fast - slow_rate * decay)
    # Otherwise a rotation that decays.
    sine, cosine = sincos(jnp.where(under, w * h, 0))
    series = (1 - z / 2 * (1 - z / 12 * (1 - z / 30 * (1 - z / 56 * (1 - z / 90)))),
              h * (1 - z / 6 * (1 - z / 20 * (1 - z / 42 * (1 - z / 72 * (1 - z / 110))))))  # fmt: skip
    cosine = decay * jnp.where(small, series[0], cosine)
    turned = decay * jnp.where(small, series[1], sine / w)
    carried = jnp.where(under | small, turned, apart * (decay - fast))
    kept = jnp.where(under | small, cosine + beta * turned, 1 - settled)
    slowed = jnp.where(under | small, cosine - beta * turned, slowed)
    return FreeMotion(kept, carried, slowed, jnp.where(under | small, 1 - kept, settled))
