"""The motion of a damped linear oscillator without division by its stiffness or damping: both may be zero."""

import math
from typing import Any, NamedTuple

import jax.numpy as jnp

from .._types import FloatArray
from .elementary import sincos

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
        step, ramp = h * h * _series(z, 2), h * h * h * _series(z, 3)
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


def _series(z: FloatArray, order: int) -> FloatArray:
    """``1 / n! - z / (n + 2)! + z^2 / (n + 4)! - ...`` for z below 1/2, n the `order`."""
    result = jnp.zeros_like(z)
    for n in range(order + 16, order - 1, -2):
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
    second = jnp.zeros_like(y)
    for n in range(20, 1, -1):
        second = 1 / math.factorial(n) - z * second
    far = jnp.where(near, 1, y)
    first = jnp.where(near, 1 - z * second, (1 - jnp.exp(-far)) / far)
    return h * first, h * h * jnp.where(near, second, (1 - first) / far)
