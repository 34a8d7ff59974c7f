"""Damped rotation: the free motion of a linear oscillator."""

from typing import Any

import jax.numpy as jnp

from .._types import FloatArray
from .sharing import sincos

_SERIES = 0.1  # below this |(beta^2 - omega^2) h^2|, damped rotations are summed as series


def damped_rotation(beta: Any, omega_squared: Any, h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``exp(-beta h)`` times ``cos(w h)`` and ``sin(w h) / w``, where ``w^2 = omega^2 - beta^2`` may have any sign.

    The free motion of a damped oscillator is a combination of the two. `beta`: damping ratio times omega, 1/s (the int
    0 for none); `omega_squared`: rad^2/s^2; `h`: time, s.
    """
    if isinstance(beta, int):
        w = jnp.sqrt(omega_squared)
        sine, cosine = sincos(w * h)
        return cosine, sine / w
    squared = omega_squared - beta * beta
    z = squared * h * h
    small, under = jnp.abs(z) < _SERIES, squared > 0
    w = jnp.sqrt(jnp.where(small, 1, jnp.abs(squared)))
    sine, cosine = sincos(jnp.where(under, w * h, 0))
    fast, slow = jnp.exp(-(beta + w) * h), jnp.exp(-jnp.where(under | small, beta, beta - w) * h)
    decay = slow
    series = (1 - z / 2 * (1 - z / 12 * (1 - z / 30 * (1 - z / 56 * (1 - z / 90)))),
              h * (1 - z / 6 * (1 - z / 20 * (1 - z / 42 * (1 - z / 72 * (1 - z / 110))))))  # fmt: skip
    cosine = jnp.where(under, decay * cosine, (slow + fast) / 2)
    sine = jnp.where(under, decay * sine, (slow - fast) / 2) / w
    return jnp.where(small, decay * series[0], cosine), jnp.where(small, decay * series[1], sine)
