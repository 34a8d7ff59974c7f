"""The extreme of a number of the state over time, where the motion is known as a function of time inside each step.

It is at the beginning of a step, at the end of the last, or inside a step where the slope is zero. There it is found by
the slope's sign at a few instants, and then by secants with a bisection now and then. The instants need no derivative:
an extreme at an inner instant moves, to first order, as the value there does (envelope theorem), and one at the
beginning of a step as the state there does, events included.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax

from ..._numerics.primal import without_derivatives
from ..._types import Array, FloatArray

_Step = TypeVar("_Step")
Inside = Callable[[_Step, FloatArray], tuple[FloatArray, FloatArray]]
"""The number and its slope at some time (s) after the beginning of a step."""

# Fractions of a step between which the slope's sign is looked at: fine near the beginning, where a motion may die out.
_INSTANTS = (0.0, 2.0**-12, 2.0**-7, 2.0**-4, 0.25, 0.5, 0.75, 1.0)
_TRIES = 12  # the value's error is that of the instant squared


def largest_in_steps(
    inside: Inside[_Step], steps: _Step, starts: FloatArray, lengths: FloatArray, last: FloatArray
) -> FloatArray:
    """The largest value over all steps, of which `inside` gives the number, and of the `last` value.

    Args:
        inside: Of one step.
        steps: The data of the steps, along a first axis.
        starts: The values at the beginnings of the steps, (steps,).
        lengths: Of the steps, s, (steps,); 0 for those that were only tried.
        last: The value at the end of the last step.
    """
    fixed, where = without_derivatives((steps, lengths))
    at = lax.stop_gradient(_instants(jax.vmap(inside), fixed, where))
    values, _ = jax.vmap(inside)(steps, at)
    return jnp.maximum(jnp.max(jnp.maximum(values, starts)), last)


def _instants(inside: Inside[_Step], steps: _Step, lengths: FloatArray) -> FloatArray:
    """The time since the beginning of each step at which an inner maximum is largest; 0 if there is none.

    `inside`: of all steps at once. It stands in the program twice, for it takes long to compile.
    """
    h = jnp.asarray(_INSTANTS, lengths.dtype)[:, None] * lengths[None]
    values, slopes = lax.map(lambda at: inside(steps, at), h)
    turns = (slopes[:-1] > 0) & (slopes[1:] < 0)
    # Of several turns the one beside the largest value.
    beside = jnp.where(turns, jnp.maximum(values[:-1], values[1:]), -jnp.inf)
    chosen = jnp.argmax(beside, axis=0)[None]
    low, high = (jnp.take_along_axis(ends, chosen, 0)[0] for ends in (h[:-1], h[1:]))
    above, below = (jnp.take_along_axis(ends, chosen, 0)[0] for ends in (slopes[:-1], slopes[1:]))

    def narrow(number: Array, bracket: tuple[FloatArray, ...]) -> tuple[FloatArray, ...]:
        low, high, above, below, _ = bracket
        fall = above - below
        secant = low + (high - low) * jnp.where(fall > 0, above / jnp.where(fall > 0, fall, 1), 0.5)
        at = jnp.where(number % 4 == 3, 0.5 * (low + high), secant)  # the Illinois rule, and halving
        _, here = inside(steps, at)
        rises = here > 0
        # An end that stays has its slope halved, so that the other end moves next.
        return (
            jnp.where(rises, at, low),
            jnp.where(rises, high, at),
            jnp.where(rises, here, 0.5 * above),
            jnp.where(rises, 0.5 * below, here),
            at,
        )

    *_, found = lax.fori_loop(0, _TRIES, narrow, (low, high, above, below, 0.5 * (low + high)))
    return jnp.where(jnp.any(turns, axis=0), found, 0)
