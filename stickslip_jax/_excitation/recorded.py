"""Recorded motions: values at given times, joined by straight lines."""

import math
from functools import partial
from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._fields import Quantity
from .._types import AnyArray, Float, FloatArray
from .segments import SegmentLaw
from .smooth import SIGNAL_UNIT


class Recorded(SegmentLaw):
    """A recorded base velocity or force, linear in time between the points of the record.

    The acceleration of a base whose velocity is linear between points jumps at each point. Short slips there
    may interrupt a stick that friction can just hold: there are then more and shorter sticks than on a smooth base.

    Args:
        times: s, increasing, the first one 0, (points,), at least 2.
        values: As many; m/s for a base velocity, N for a force.

    Raises:
        ValueError: For times that do not increase from 0, different lengths, or numbers that are not finite.
    """

    times: Annotated[Float[AnyArray, " points"], Quantity("s", "increasing; the first is 0", ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "times")
    )
    values: Annotated[Float[AnyArray, " points"], Quantity(SIGNAL_UNIT, ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "values")
    )
    is_random = False
    rests_on: ClassVar = {"covered_time": ("draw", "next_segment")}
    only_with: ClassVar = {"value": ("draw", "next_segment")}
    jumps = False

    def check_relations(self) -> None:
        check_times("values", self.times, self.values)

    @property
    def duration(self):
        """Duration of the record, s: the last of `times`."""
        return self.times[-1]

    @property
    def covered_time(self) -> float:
        return end_of(self.times)

    def value(self, t: AnyArray | float) -> FloatArray:
        """The signal at times `t` (s, any shape)."""
        return jnp.interp(jnp.asarray(t), jnp.asarray(self.times), jnp.asarray(self.values))

    def segments(self, t1) -> int:
        return len(self.times)

    def draw(self, key_data, number, dtype):
        times, values = jnp.asarray(self.times, dtype), jnp.asarray(self.values, dtype)
        last = len(self.times) - 2
        here = jnp.minimum(number.astype(jnp.int32), last)
        duration = times[here + 1] - times[here]
        slope = (values[here + 1] - values[here]) / duration
        return jnp.where(number <= last, duration, 0), values[here], slope

    def next_segment(self, memory, drawn, dtype):
        return *drawn, ()


def end_of(times: AnyArray) -> float:
    """The last of `times`, s; infinity where they are traced."""
    return math.inf if _checks.is_traced(times) else float(times[-1])


def check_times(name: str, times: AnyArray, values: AnyArray) -> None:
    """Check that `times` increase from 0 and that the argument `name`, `values`, has as many entries, at least 2."""
    if np.shape(times) != np.shape(values) or len(times) < 2:
        raise ValueError(
            f"Arguments times and {name} must have the same length of at least 2, but they have shapes "
            f"{np.shape(times)} and {np.shape(values)}."
        )
    _checks.increasing_from_zero("times", times, "subtract it to start the record there")
