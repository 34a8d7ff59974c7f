"""Piecewise-constant forces."""

from functools import partial
from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp

from .. import _checks
from .._fields import Quantity
from .._types import AnyArray, Float, FloatArray
from .motion import Parts
from .recorded import check_times
from .segments import SegmentLaw


class ForceSteps(SegmentLaw):
    """A force that jumps at given times and is constant in between: the normal force of a clutch, closed and opened.

    Args:
        times: s, at which its values begin, increasing, the first one 0, (steps,), at least 2.
        values: N, as many; the last one goes on.

    Raises:
        ValueError: For times that do not increase from 0, different lengths, or numbers that are not finite.
    """

    times: Annotated[Float[AnyArray, " steps"], Quantity("s", "increasing; the first is 0", ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "times")
    )
    values: Annotated[Float[AnyArray, " steps"], Quantity("N", ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "values")
    )
    is_random = False
    only_with: ClassVar = {"value": ("draw", "next_segment")}
    jumps = False  # of the base velocity: none

    def check_relations(self) -> None:
        check_times("values", self.times, self.values)

    def parts(self) -> Parts:
        raise ValueError("Argument base must be a base motion, but a ForceSteps was given, which is a force.")

    def value(self, t: AnyArray | float) -> FloatArray:
        """The force at times `t` (s, any shape), N; at a jump, the one after it."""
        here = jnp.searchsorted(jnp.asarray(self.times), jnp.asarray(t), side="right") - 1
        return jnp.asarray(self.values)[here]

    def segments(self, t1) -> int:
        return len(self.times)

    def draw(self, key_data, number, dtype):
        times, values = jnp.asarray(self.times, dtype), jnp.asarray(self.values, dtype)
        last = len(times) - 1
        here = jnp.minimum(number.astype(jnp.int32), last)
        duration = jnp.where(number < last, times[jnp.minimum(here + 1, last)] - times[here], jnp.inf)
        return jnp.where(number <= last, duration, 0), values[here], jnp.zeros_like(duration)

    def next_segment(self, memory, drawn, dtype):
        return *drawn, ()
