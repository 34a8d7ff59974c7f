"""Recorded motions: values at given times, joined by straight lines; their noise; ground motions and forces in
steps.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.typing import DTypeLike
from jaxtyping import Float

from .._foundation import checks
from .._foundation.fields import Quantity
from .._foundation.types import AnyArray, FloatArray, FloatScalar, Number, Word
from .motion import SIGNAL_UNIT
from .segments import GivenSegments, PerSegment, SegmentLaw

# Noise of recorded motions: how it is told from motion, and taken out.
#
# Each point is compared with the straight line between the points before and after it, and between those two before and
# two after: differences of the second order, divided by what independent errors of unit variance would make of them. Of
# independent errors both mean squares are the variance, their ratio is 1. Of a motion that the points resolve the
# second is 16 times the first (a smooth velocity), 6 times (kinks), or twice (jumps; random steps; a random walk, the
# roughest).
#
# The logarithm of the ratio has, for a random walk of N points, the mean log 2 and the standard deviation 1.87 /
# sqrt(N): both differences are moving averages of normal numbers, with autocorrelations -1/2 and 1/4, -1/2, -1/4, whose
# mean squares have the relative variances 3 / N and 3.5 / N and the covariance 1.5 / N. With the largest ones cut it is
# 1.95. A ratio below ``2 exp(-6 / sqrt(N))`` is three of these away: 1 in 1000 random walks is taken for noise, and
# fewer of what is smoother.


_FEWEST = 50  # points; of fewer the ratio says too little
_RANDOM_WALK, _FALSE_ALARM = math.log(2.0), 6.0
_CUT = 3.0  # standard deviations: jumps of a square wave with noise must not hide the noise
_NORMAL_MEDIAN = 0.67449  # of the absolute value of a standard normal number
_LARGEST = 0.3  # of the root mean square: what is larger is the motion itself
_LEAST = 0.1  # of the root mean square change from point to point: what is smaller does no harm
_COARSEST, _FINEST = 1 / 2, 1 / 2000  # cutoff times the time between points; below, the spline loses digits

PerPoint = Float[np.ndarray, " points"]


def warn_of_noise(times: AnyArray, values: AnyArray) -> None:
    """Warn of a record that looks like a motion with independent errors; nothing is asked of traced numbers."""
    if checks.is_traced(times) or checks.is_traced(values) or len(times) < _FEWEST:
        return
    times, values = np.asarray(times, float), np.asarray(values, float)
    noise = noise_of(times, values)
    if noise is None:
        return
    rate = math.sqrt(2) * noise / float(np.median(np.diff(times)))
    checks.warn(
        f"The record of {len(times)} points looks noisy: from point to point it jumps by independent errors of about "
        f"{noise:.2g} (standard deviation, in the unit of the values), which as a base velocity in m/s accelerate by "
        f"{rate:.2g} m/s^2 and break sticks into many short ones. Smooth it, Recorded.smoothed(times, values, "
        "cutoff_hz=...) or read_recorded_csv(..., cutoff_hz=...); where every point is meant, call "
        "warnings.filterwarnings('ignore', message='The record of')."
    )


def noise_of(times: PerPoint, values: PerPoint) -> float | None:
    """The standard deviation of the independent errors in a record; None where it does not look noisy."""
    one, two = _mean_square(times, values, 1), _mean_square(times, values, 2)
    if not one > 0:
        return None
    bound = min(_RANDOM_WALK / 2, _RANDOM_WALK - _FALSE_ALARM / math.sqrt(len(times)))
    noise, size = math.sqrt(one), math.sqrt(np.mean(values**2))
    change = math.sqrt(_mean_without_jumps(np.diff(values) ** 2))
    is_noise = two < one * math.exp(bound)
    matters = noise < _LARGEST * size and math.sqrt(2) * noise > _LEAST * change
    return noise if is_noise and matters else None


def _mean_square(times: PerPoint, values: PerPoint, apart: int) -> float:
    """The mean square, with the largest ones cut, of the differences of points from lines between others.

    They are divided by what errors of unit variance make of them; 0 where half of the points lie on the line.
    """
    before, here, after = slice(None, -2 * apart), slice(apart, -apart), slice(2 * apart, None)
    share = (times[after] - times[here]) / (times[after] - times[before])
    away = values[here] - share * values[before] - (1 - share) * values[after]
    return _mean_without_jumps(away**2 / (1 + share**2 + (1 - share) ** 2))


def _mean_without_jumps(squares: Float[np.ndarray, " differences"]) -> float:
    """The mean, with what is far above the median cut."""
    most = (_CUT / _NORMAL_MEDIAN) ** 2 * np.median(squares)
    return float(np.mean(np.minimum(squares, most)))


# Recorded motions: values at given times, joined by straight lines.


class Points(SegmentLaw):
    """Base class of what is given by numbers at points in time: lines between them, or steps from one to the next.

    Args:
        times: s, increasing, the first one 0, (points,), at least 2.
    """

    times: Annotated[Float[AnyArray, " points"], Quantity("s", "increasing; the first is 0", ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "times")
    )
    jumps = False

    def segments(self, t1) -> int:
        return len(self.times)

    def next_segment(self, memory, drawn, dtype):
        return *drawn, ()


class Recorded(Points):
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

    values: Annotated[Float[AnyArray, " points"], Quantity(SIGNAL_UNIT, ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "values")
    )
    smoothing: str | None = eqx.field(static=True, default=None)
    is_record = True
    rests_on: ClassVar = {"covered_time": ("draw", "next_segment")}
    only_with: ClassVar = {"value": ("draw", "next_segment")}

    def check_parts(self) -> None:
        if self.smoothing is not None and not isinstance(self.smoothing, str):
            hint = "to smooth a record call Recorded.smoothed(times, values, cutoff_hz=...)"
            raise checks.refused("smoothing", "be words that say how the values were smoothed", self.smoothing, hint)

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
        from scipy.interpolate import make_smoothing_spline  # noqa: PLC0415 - loaded when asked for

        times, values = (checks.real_array(name, v) for name, v in (("times", times), ("values", values)))
        if any(map(checks.is_traced, (times, values, cutoff_hz))):
            raise ValueError(
                "Recorded.smoothed needs numbers, but JAX is tracing them; smooth the record outside jit, vmap and "
                "grad."
            )
        checks.same_length(5, times=times, values=values)
        checks.increasing_from_zero("times", times, "subtract it to start the record there")
        checks.positive("cutoff_hz", cutoff_hz, "Hz")
        at, cutoff = np.asarray(times, float), float(cutoff_hz)
        apart = np.diff(at)
        usual = float(np.median(apart))
        if not _FINEST <= cutoff * usual <= _COARSEST:
            hint = "or give every tenth point only, say" if cutoff * usual < _FINEST else "the points resolve no more"
            bounds = f"{_FINEST / usual:.4g} and {_COARSEST / usual:.4g} Hz"
            raise checks.refused("cutoff_hz", f"be between {bounds} for points {usual:.4g} s apart", cutoff_hz, hint)
        # The spline s minimises ``sum w (value - s)^2 + integral s''^2 / (2 pi cutoff)^4`` with the time that each
        # point stands for as its weight w: its response to a frequency f is then ``1 / (1 + (f / cutoff)^4)`` (P.
        # Craven and G. Wahba, Numer. Math. 31 (1979)).
        weights = (np.append(apart, 0) + np.append(0, apart)) / 2
        unit = 1 / (2 * math.pi * cutoff)
        spline = make_smoothing_spline(at / unit, np.asarray(values, float), w=weights / unit, lam=1.0)
        return cls(times, spline(at / unit), f"cubic smoothing spline, half of the amplitude at {cutoff:g} Hz")

    @property
    def duration(self):
        """Duration of the record, s: the last of `times`."""
        return self.times[-1]

    @property
    def covered_time(self) -> float:
        return math.inf if checks.is_traced(self.times) else float(self.times[-1])

    def value(self, t: AnyArray | float) -> FloatArray:
        """The signal at times `t` (s, any shape)."""
        return jnp.interp(jnp.asarray(t), jnp.asarray(self.times), jnp.asarray(self.values))

    def draw(self, key_data, number, dtype):
        return line_between(self.times, self.values, number, dtype)


def line_between(times: AnyArray, values: AnyArray, number: Word, dtype: DTypeLike) -> tuple[FloatScalar, ...]:
    """Duration (s), value at the beginning and slope of the line after point `number`; a duration of 0 at the end."""
    times, values = jnp.asarray(times, dtype), jnp.asarray(values, dtype)
    last = len(times) - 2
    here = jnp.minimum(number.astype(jnp.int32), last)
    duration = times[here + 1] - times[here]
    slope = (values[here + 1] - values[here]) / duration
    return jnp.where(number <= last, duration, 0), values[here], slope


def check_times(name: str, times: AnyArray, values: AnyArray) -> None:
    """Check that `times` increase from 0 and that the argument `name`, `values`, has as many entries, at least 2."""
    checks.same_length(2, times=times, **{name: values})
    checks.increasing_from_zero("times", times, "subtract it to start the record there")


# Piecewise-constant forces.


class ForceSteps(Points):
    """A force that jumps at given times and is constant in between: the normal force of a clutch, closed and opened.

    Args:
        times: s, at which its values begin, increasing, the first one 0, (steps,), at least 2.
        values: N, as many; the last one goes on.

    Raises:
        ValueError: For times that do not increase from 0, different lengths, or numbers that are not finite.
    """

    values: Annotated[Float[AnyArray, " points"], Quantity("N", ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "values")
    )
    part_of_excitation = "none"
    only_with: ClassVar = {"value": ("draw", "next_segment")}

    def check_relations(self) -> None:
        check_times("values", self.times, self.values)

    def value(self, t: AnyArray | float) -> FloatArray:
        """The force at times `t` (s, any shape), N; at a jump, the one after it."""
        here = jnp.searchsorted(jnp.asarray(self.times), jnp.asarray(t), side="right") - 1
        return jnp.asarray(self.values)[here]

    def draw(self, key_data, number, dtype):
        times, values = jnp.asarray(self.times, dtype), jnp.asarray(self.values, dtype)
        last = len(times) - 1
        here = jnp.minimum(number.astype(jnp.int32), last)
        duration = jnp.where(number < last, times[jnp.minimum(here + 1, last)] - times[here], jnp.inf)
        return jnp.where(number <= last, duration, 0), values[here], jnp.zeros_like(duration)


# Ground motions: accelerations of the ground under a system described in coordinates relative to it.


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


class GroundAcceleration(GroundMotion, Points):
    """A recorded ground acceleration, linear in time between the points of the record.

    Args:
        times: s, increasing, the first one 0, (points,), at least 2.
        accelerations: m/s^2, as many.

    Raises:
        ValueError: For times that do not increase from 0, different lengths, or numbers that are not finite.
    """

    accelerations: Annotated[Float[AnyArray, " points"], Quantity("m/s^2", ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "accelerations")
    )
    is_record = True
    duration = Recorded.duration

    def __repr__(self) -> str:
        if checks.is_traced(self.times) or checks.is_traced(self.accelerations):
            return super().__repr__()
        peak = np.max(np.abs(np.asarray(self.accelerations)))
        return f"{type(self).__name__}({len(self.times)} points, {float(self.times[-1]):g} s, peak {peak:.4g} m/s^2)"

    covered_time = Recorded.covered_time  # pyright: ignore[reportIncompatibleMethodOverride] - of another class
    rests_on: ClassVar = {"covered_time": ("draw", "next_segment")}
    only_with: ClassVar = {"acceleration": ("draw", "next_segment")}

    def check_relations(self) -> None:
        check_times("accelerations", self.times, self.accelerations)

    def acceleration(self, t: AnyArray | float) -> FloatArray:
        """The ground acceleration at times `t` (s, any shape), m/s^2."""
        return jnp.interp(jnp.asarray(t), jnp.asarray(self.times), jnp.asarray(self.accelerations))

    def draw(self, key_data, number, dtype):
        return line_between(self.times, self.accelerations, number, dtype)


class GroundRecords(GroundMotion):
    """Several recorded ground accelerations, of which a sample takes number `which`, times `scale`.

    The `points` of each, `times` (s) and `accelerations` (m/s^2), one record after the other in arrays
    (records * points,), for XLA copies tables whose rows it reads. Linear between the points, as `GroundAcceleration`.
    `which` and `scale` may be arrays with one number for each sample.
    """

    times: Annotated[AnyArray, Quantity("s", ndim=1)]
    accelerations: Annotated[AnyArray, Quantity("m/s^2", ndim=1)]
    which: Annotated[Number, Quantity(meaning="number of the record", at_least=0)]
    scale: Annotated[Number, Quantity(meaning="factor of the accelerations")]
    points: int = eqx.field(static=True)
    is_record = True

    @classmethod
    def padded(
        cls, records: Sequence[GroundAcceleration], t1: float, which: AnyArray, scale: AnyArray
    ) -> "GroundRecords":
        """Those of `records`, each followed by rest until `t1` (s): from its last point it falls to 0 in one step."""
        points = max(len(one.times) for one in records) + 2
        times, values = np.zeros((2, len(records), points))
        for row, one in enumerate(records):
            size = len(one.times)
            times[row, :size], values[row, :size] = one.times, one.accelerations
            end = 2 * times[row, size - 1] - times[row, size - 2]
            times[row, size:] = end, *(max(end, t1) + 1.0 + np.arange(points - size - 1))
        return cls(times.ravel(), values.ravel(), which, scale, points)

    def segments(self, t1) -> int:
        return self.points

    def draw(self, key_data, number, dtype):
        last = self.points - 2
        here = self.points * jnp.asarray(self.which).astype(jnp.int32) + jnp.minimum(number.astype(jnp.int32), last)
        times, values = (jnp.asarray(array, dtype) for array in (self.times, self.accelerations))
        duration, value = times[here + 1] - times[here], self.scale * values[here]
        slope = (self.scale * values[here + 1] - value) / duration
        return jnp.where(number <= last, duration, 0), value, slope

    def next_segment(self, memory, drawn, dtype):
        return *drawn, ()
