"""Counts of sticks whose derivative is that of the expected count, accumulated during the simulation.

To that derivative each stick and near miss adds an event part for every boundary that it is close to (`boundaries.py`,
`kernels.py`). Where the gaps between switches are exponential, the time left at an arrival is exponential too
(memorylessness): its density at 0 is the rate, for every stick. So the distance to the switch needs no kernel.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import PyTree

from .._dynamics.common.engine import Engine
from .._dynamics.interval.arcs import Scales
from .._dynamics.interval.crossing import status_of
from .._dynamics.interval.engine import IntervalEngine
from .._types import AnyArray, Array, BoolArray, FloatArray, IntArray, Scalar
from .boundaries import BoundaryDistances, IntervalLane, cross_with_distances
from .kernels import BoundarySums, zero_with_derivative
from .recording import IntervalRecording


class Likelihood(NamedTuple):
    """Data for the derivative by the rate of a Poisson base, from the likelihood of the number of switches (score)."""

    rate: Scalar  # a copy of the law's rate, 1/s: differentiated for the score part, the law's for the pathwise part
    stick_time: Scalar  # approximate means, s and 1, subtracted to reduce the variance (control variate)
    sticks: Scalar


class Counted(NamedTuple):
    """The totals of each sample.

    `event_parts` and `in_window` hold one entry per window. Their values are zero; the derivative of `event_parts` is
    the event part of that of the number of sticks, the derivative of `in_window` counts the distances inside the
    kernel's window.
    """

    status: AnyArray
    stick_time: AnyArray
    sticks: AnyArray
    event_parts: tuple[AnyArray, ...]
    in_window: tuple[AnyArray, ...]


class _Motion(NamedTuple):
    """The motion of one lane, its sums so far, and the number of switches of its base."""

    lane: IntervalLane
    sums: BoundarySums
    switches: IntArray


class IntervalCounting(Engine[Scales, tuple[Array, Array], _Motion, None, Counted]):
    """Engine that counts the sticks that an `IntervalEngine` simulates.

    `bandwidths` (windows,): relative bandwidths of the kernels (see `two_sided_kernel`). `fixed_start`: whether all
    samples begin in the same state: then the outcome of the first arc has no density.
    """

    engine: IntervalEngine
    bandwidths: AnyArray
    likelihood: Likelihood | None
    fixed_start: bool = eqx.field(static=True)

    @property
    def _recording(self) -> IntervalRecording:
        return IntervalRecording(self.engine, self.fixed_start)

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[tuple[Array, Array], _Motion]:
        sample, lane = self._recording.begin(key_data, dtype)
        return sample.key_data, _Motion(lane, BoundarySums.none(len(self.bandwidths), dtype), jnp.zeros((), jnp.int32))

    def shared(self, dtype) -> Scales:
        return self.engine.shared(dtype)

    def draw(self, sample: tuple[Array, Array], number: Array, dtype) -> tuple[PyTree, BoolArray]:
        return self.engine.law.draw(sample, number, dtype), number == 0

    def step(
        self, shared: Scales, sample: tuple[Array, Array], motion: _Motion, drawn: tuple[PyTree, BoolArray]
    ) -> tuple[_Motion, None]:
        (lane, sums, switches), (drawn, is_first) = motion, drawn
        moved, stick, distances, duration = cross_with_distances(self.engine.law, shared, lane, drawn)
        sums = self._with_interval(sums, distances, stick.start - lane.motion.t, is_first & self.fixed_start)
        return _Motion(moved, sums, switches + (lane.motion.t + duration < shared.t1)), None

    def ended(self, motion: _Motion, before: _Motion) -> BoolArray:
        return self._recording.ended(motion.lane, before.lane)

    def results(self, sample: tuple[Array, Array], motion: _Motion) -> Counted:
        totals, (event_parts, in_window) = motion.lane.totals, motion.sums
        time = totals.stick_time
        if self.likelihood is not None:
            # Score of a Poisson process: d log p / d rate = switches / rate - t1.
            rate = jnp.asarray(self.likelihood.rate, time.dtype)
            score = zero_with_derivative(motion.switches / rate - self.engine.t1, rate, jnp.ones((), bool))
            event_parts = tuple(part + (totals.sticks - self.likelihood.sticks) * score for part in event_parts)
            time = time + (time - self.likelihood.stick_time) * score
        status = status_of(motion.lane.motion, jnp.asarray(self.engine.t1, time.dtype))
        return Counted(status, time, totals.sticks, event_parts, in_window)

    def _with_interval(
        self, sums: BoundarySums, distances: BoundaryDistances, arrival: FloatArray, is_fixed: BoolArray
    ) -> BoundarySums:
        """`sums` with what one interval adds; `is_fixed`: whether nothing before the arrival was random."""
        exact, switch_where = jnp.zeros_like(arrival), ~is_fixed
        law = self.engine.law
        if law.gap_rate is not None:
            rate = jnp.asarray(getattr(law, law.gap_rate), arrival.dtype)
            # A gap that ends at the arrival, E / rate with its random number E held fixed.
            gap = lax.stop_gradient(arrival) * lax.stop_gradient(rate) / rate
            exact = zero_with_derivative(rate, gap - arrival, distances.exists)
            switch_where = jnp.zeros((), bool)
        sums = sums._replace(event_parts=tuple(part + exact for part in sums.event_parts))
        distances, bandwidths = distances.only(~is_fixed, switch_where), jnp.asarray(self.bandwidths, arrival.dtype)
        return jax.tree.map(jnp.add, sums, BoundarySums.over(distances.two_sided, distances.one_sided, bandwidths))
