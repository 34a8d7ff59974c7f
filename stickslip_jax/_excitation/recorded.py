"""Recorded motions: values at given times, joined by straight lines."""

import math
from functools import partial
from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.typing import DTypeLike

from .. import _checks
from .._fields import Quantity
from .._types import AnyArray, Float, FloatArray, FloatScalar, Word
from .noise import smoothed_values, warn_of_noise
from .segments import SegmentLaw
from .smooth import SIGNAL_UNIT


class Recorded(SegmentLaw):
    """A recorded base velocity or force, linear in time between the points of the record.

    The acceleration of a base whose velocity is linear between points jumps at each point. Short slips there
    may interrupt a stick that friction can just hold: there are then more and shorter sticks than on a smooth base.
    Noise of a measured velocity does the same: 0.01 m/s at 100 points a second is an acceleration of 1.4 m/s^2. A
    record that looks noisy causes a RuntimeWarning; `smoothed` takes the noise out.

    Args:
        times: s, increasing, the first one 0, (points,), at least 2.
        values: As many; m/s for a base velocity, N for a force.
        smoothing: How the values were smoothed, in words, None if they were not: `smoothed` says it.

    Raises:
        ValueError: For times that do not increase from 0, different lengths, or numbers that are not finite.
    """

    times: Annotated[Float[AnyArray, " points"], Quantity("s", "increasing; the first is 0", ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "times")
    )
    values: Annotated[Float[AnyArray, " points"], Quantity(SIGNAL_UNIT, ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "values")
    )
    smoothing: str | None = eqx.field(static=True, default=None)
    is_random = False
    is_record = True
    rests_on: ClassVar = {"covered_time": ("draw", "next_segment")}
    only_with: ClassVar = {"value": ("draw", "next_segment")}
    jumps = False

    def check_parts(self) -> None:
        if self.smoothing is not None and not isinstance(self.smoothing, str):
            hint = "to smooth a record call Recorded.smoothed(times, values, cutoff_hz=...)"
            raise _checks.refused("smoothing", "be words that say how the values were smoothed", self.smoothing, hint)

    def check_relations(self) -> None:
        check_times("values", self.times, self.values)
        warn_of_noise(self.times, self.values)

    @classmethod
    def smoothed(cls, times: npt.ArrayLike, values: npt.ArrayLike, *, cutoff_hz: float) -> "Recorded":
        """The record of noisy measurements, smoothed by a cubic smoothing spline (scipy) of a given bandwidth.

        A motion of the frequency f keeps ``1 / (1 + (f / cutoff_hz)^4)`` of its amplitude, without delay, whether the
        times are equally spaced or not: 0.9999 at a tenth of the cutoff, 0.94 at half of it, half at the cutoff, 0.06
        at twice. Jumps become ramps of about ``0.3 / cutoff_hz`` seconds. The result's `smoothing` states what was
        done.

        Args:
            times: s, increasing, the first one 0, (points,), at least 5.
            values: As many; m/s for a base velocity, N for a force.
            cutoff_hz: The frequency at which half of the amplitude remains, Hz: above those of the motion, and between
                1/2000 and 1/2 of the (median) number of points in a second.

        Returns:
            The smoothed values at the same times.

        Raises:
            ValueError: For numbers outside these bounds, and those that ``jit``, ``vmap`` or ``grad`` trace.
        """
        times, values = (_checks.real_array(name, v) for name, v in (("times", times), ("values", values)))
        smooth, words = smoothed_values(times, values, cutoff_hz)
        return cls(times, smooth, words)

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
        return line_between(self.times, self.values, number, dtype)

    def next_segment(self, memory, drawn, dtype):
        return *drawn, ()


def line_between(times: AnyArray, values: AnyArray, number: Word, dtype: DTypeLike) -> tuple[FloatScalar, ...]:
    """Duration (s), value at the beginning and slope of the line after point `number`; a duration of 0 at the end."""
    times, values = jnp.asarray(times, dtype), jnp.asarray(values, dtype)
    last = len(times) - 2
    here = jnp.minimum(number.astype(jnp.int32), last)
    duration = times[here + 1] - times[here]
    slope = (values[here + 1] - values[here]) / duration
    return jnp.where(number <= last, duration, 0), values[here], slope


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
