"""Intervals that a user's law gives: impossible ones are marked, equal neighbours joined.

An impossible interval (a negative duration, a number that is not finite) gets the duration NaN, from which the
engines make ``Status.BASE_INVALID``.
"""

from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._types import Array, Float, FloatArray

Each: TypeAlias = Float[Array, " intervals"]


def marked(duration: FloatArray, *numbers: FloatArray) -> FloatArray:
    """`duration`, NaN where it is negative or where an interval that lasts has a number that is not finite."""
    finite = jnp.ones((), bool)
    for number in numbers:
        finite = finite & jnp.isfinite(number)
    return jnp.where((duration == 0) | ((duration > 0) & finite), duration, jnp.nan)


def joined(durations: Each, velocities: Each) -> tuple[Each, Each]:
    """Durations and velocities of intervals (intervals,): neighbours of equal velocity are one, impossible ones are
    `marked`, and after the first of duration 0 there are none.
    """
    number = len(durations)
    durations = jnp.where(jnp.cumsum(durations == 0) > 0, 0, marked(durations, velocities))
    if number == 1:
        return durations, velocities
    begins = jnp.concatenate([jnp.ones(1, bool), velocities[1:] != velocities[:-1]])
    joint = jnp.cumsum(begins) - 1
    first = jnp.minimum(jnp.searchsorted(joint, jnp.arange(number)), number - 1)
    return jax.ops.segment_sum(durations, joint, number, indices_are_sorted=True), velocities[first]


def check_drawn(law: object, method: str, unit: str, durations: Each, *numbers: Each) -> None:
    """Check segments (segments,) that the `method` of a user's `law` gave. Raises ValueError that names the first
    impossible one; traced ones pass, and show in the status of a simulation.
    """
    if any(_checks.is_traced(array) for array in (durations, *numbers)):
        return
    wrong = np.flatnonzero(np.isnan(np.asarray(marked(durations, *numbers))))
    if len(wrong):
        here = ", ".join(f"{float(array[wrong[0]]):g}" for array in numbers)
        raise ValueError(
            f"Method {method} of {type(law).__name__} must give durations above 0 (0: there is no further one) and "
            f"finite numbers, but number {wrong[0]} lasts {float(durations[wrong[0]]):g} s at {here} {unit}."
        )
