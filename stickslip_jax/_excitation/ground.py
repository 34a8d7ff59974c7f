"""Ground motions: accelerations of the ground under a system described in coordinates relative to it."""

from functools import partial
from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp

from .. import _checks
from .._fields import Quantity
from .._types import AnyArray, Float, FloatArray
from .recorded import Recorded, check_times, end_of, line_between
from .segments import GivenSegments, PerSegment, SegmentLaw


class GroundMotion(SegmentLaw):
    """Base class of ground accelerations (m/s^2), piecewise linear in time; subclass it as shown for `SegmentLaw`.

    They excite a `MassSpring` described by its position relative to the ground: there the base is at rest, and the
    acceleration of the ground acts as the force ``-mass * acceleration``.
    """

    part_of_excitation = "ground"
    jumps = False
    takes_jumps = False

    def realization(self, durations: PerSegment, values: PerSegment, slopes: PerSegment) -> SegmentLaw:
        """The realisation with these segments, arrays (segments,)."""
        return GroundSegments(durations, values, slopes, may_jump=False)


class GroundSegments(GivenSegments, GroundMotion):  # pyright: ignore[reportIncompatibleVariableOverride] - a property
    """One realisation of a ground acceleration, ``values[i] + slopes[i] (t - times[i])`` for ``durations[i]`` (s)."""

    def acceleration(self, t: AnyArray | float) -> FloatArray:
        """The ground acceleration at times `t` (s, any shape), m/s^2."""
        return self.value(t)


class GroundAcceleration(GroundMotion):
    """A recorded ground acceleration, linear in time between the points of the record.

    Args:
        times: s, increasing, the first one 0, (points,), at least 2.
        accelerations: m/s^2, as many.

    Raises:
        ValueError: For times that do not increase from 0, different lengths, or numbers that are not finite.
    """

    times: Annotated[Float[AnyArray, " points"], Quantity("s", "increasing; the first is 0", ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "times")
    )
    accelerations: Annotated[Float[AnyArray, " points"], Quantity("m/s^2", ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "accelerations")
    )
    is_random = False
    is_record = True
    duration = Recorded.duration
    rests_on: ClassVar = {"covered_time": ("draw", "next_segment")}
    only_with: ClassVar = {"acceleration": ("draw", "next_segment")}

    def check_relations(self) -> None:
        check_times("accelerations", self.times, self.accelerations)

    @property
    def covered_time(self) -> float:
        return end_of(self.times)

    def acceleration(self, t: AnyArray | float) -> FloatArray:
        """The ground acceleration at times `t` (s, any shape), m/s^2."""
        return jnp.interp(jnp.asarray(t), jnp.asarray(self.times), jnp.asarray(self.accelerations))

    def segments(self, t1) -> int:
        return len(self.times)

    def draw(self, key_data, number, dtype):
        return line_between(self.times, self.accelerations, number, dtype)

    def next_segment(self, memory, drawn, dtype):
        return *drawn, ()
