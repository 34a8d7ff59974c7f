"""Engines that count sticks with the derivative of the expected count, or record all that decides about sticks."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, PyTree

from .._dynamics.common.lanes import Engine, Motion, Shared
from .._dynamics.common.path import SegmentLaws, StepsShared
from .._dynamics.interval.arcs import Scales, start_motion, status_of
from .._dynamics.interval.engine import IntervalEngine, is_over
from .._dynamics.sticks import StickRecord, start_totals
from .._dynamics.switched.engine import Lane, SwitchedEngine, advance
from .._excitation.motion import Signal
from .._foundation.types import AnyArray, BoolArray, FloatArray, IntArray, Scalar
from .._systems.system import one_contact_model
from .boundaries import (
    BoundaryDistances,
    BoundarySums,
    EngineStep,
    FirstSegment,
    IntervalLane,
    cross_with_distances,
    crossed_after,
    distances_of_step,
    is_candidate,
    zero_with_derivative,
)

# Engines that count sticks with the derivative of the expected count, or record what decides about them.
#
# To that derivative each stick and near miss adds an event part for every boundary that it is close to
# (`boundaries.py`). Counts are accumulated during the simulation. Beside the sticks, candidates are recorded: intervals
# or steps that may be close to a boundary.


class Trace(NamedTuple):
    """The record of one interval or step, with at most one stick.

    `candidates`: data from which the engine finds signed distances; `is_candidate`: whether the interval or step may be
    close to a boundary. Both None without distances.
    """

    sticks: StickRecord
    candidates: BoundaryDistances | EngineStep | None
    is_candidate: BoolArray | None


class Counted(NamedTuple):
    """The totals of each sample.

    `sums`: their values are zero; the derivative of `event_parts` is the event part of that of the number of sticks,
    the derivative of `in_window` counts the distances inside the kernel's window.
    """

    status: AnyArray
    stick_time: AnyArray
    sticks: AnyArray
    sums: BoundarySums


def recording(engine: IntervalEngine | SwitchedEngine, first: FirstSegment) -> "IntervalCounting | StepCounting":
    """`engine` with its candidates recorded."""
    if isinstance(engine, IntervalEngine):
        return IntervalCounting(engine, np.zeros(0), first, with_distances=True)
    return StepCounting(engine, np.zeros(0), first, with_distances=True)


class CountedSample(NamedTuple):
    """Constants of a sample: what its excitation follows from (the key data, or its smooth part), and when the first
    random thing happens in it, s.
    """

    own: Any
    deterministic_until: FloatArray


class CountingEngine(Engine[Shared, CountedSample, Motion, Trace, Counted]):
    """Engine that counts the sticks that another `engine` simulates, and records candidates, if `with_distances`.

    `bandwidths` (windows,): relative bandwidths of the kernels (see `two_sided_kernel`).
    """

    engine: Any
    bandwidths: AnyArray
    first: FirstSegment = eqx.field(static=True)
    with_distances: bool = eqx.field(static=True, default=False)

    def shared(self, dtype) -> Shared:
        return self.engine.shared(dtype)


# Over whole intervals of the base. Where the gaps between switches are exponential, the time left at an arrival is
# exponential too (memorylessness): its density at 0 is the rate, for every stick. So the distance to the switch needs
# no kernel.


class Likelihood(NamedTuple):
    """Data for the derivative by the rate of a Poisson base, from the likelihood of the number of switches (score)."""

    rate: Scalar  # a copy of the law's rate, 1/s: differentiated for the score part, the law's for the pathwise part
    stick_time: Scalar  # approximate means, s and 1, subtracted to reduce the variance (control variate)
    sticks: Scalar


class _IntervalMotion(NamedTuple):
    """The motion of one lane, its sums so far, and the number of switches of its base."""

    lane: IntervalLane
    sums: BoundarySums
    switches: IntArray


class IntervalCounting(CountingEngine[Scales, _IntervalMotion]):
    """The counting engine of an `IntervalEngine`."""

    engine: IntervalEngine
    likelihood: Likelihood | None = None

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[CountedSample, _IntervalMotion]:
        law, (x, velocity), zero = self.engine.law, self.engine.y0, jnp.zeros((), dtype)
        motion = start_motion(self.shared(dtype), (x, velocity))
        memory = law.begin(key_data, dtype)
        end, _, _ = law.next_interval(memory, law.draw(key_data, jnp.zeros((), jnp.uint32), dtype), dtype)
        lane = IntervalLane(memory, motion, start_totals(dtype), zero)
        begun = _IntervalMotion(lane, BoundarySums.none(len(self.bandwidths), dtype), jnp.zeros((), jnp.int32))
        return CountedSample(key_data, self.first.deterministic_until(end)), begun

    def draw(self, sample: CountedSample, number: Array, dtype) -> PyTree:
        return self.engine.law.draw(sample.own, number, dtype)

    def step(
        self, shared: Scales, sample: CountedSample, motion: _IntervalMotion, drawn: PyTree
    ) -> tuple[_IntervalMotion, Trace]:
        (lane, sums, switches), law = motion, self.engine.law
        moved, stick, distances, duration = cross_with_distances(law, shared, lane, drawn)
        arrival = stick.start - lane.motion.t
        exact, weighed = jnp.zeros_like(arrival), distances.after(sample.deterministic_until, jnp.ones((), bool))
        if law.gap_rate is not None:
            rate = jnp.asarray(getattr(law, law.gap_rate), arrival.dtype)
            # A gap that ends at the arrival, E / rate with its random number E held fixed.
            gap = lax.stop_gradient(arrival) * lax.stop_gradient(rate) / rate
            exact = zero_with_derivative(rate, gap - arrival, distances.exists)
            inactive = jnp.zeros((), bool)
            weighed = weighed._replace(switch=weighed.switch._replace(is_active=inactive))
        sums = sums._replace(event_parts=tuple(part + exact for part in sums.event_parts))
        bandwidths = jnp.asarray(self.bandwidths, arrival.dtype)
        more = BoundarySums.over(weighed, bandwidths)
        sums = jax.tree.map(jnp.add, sums, more)
        following = _IntervalMotion(moved, sums, switches + (lane.motion.t + duration < shared.t1))
        if not self.with_distances:
            return following, Trace(stick, None, None)
        return following, Trace(stick, distances, distances.any_active & (distances.time <= shared.t1))

    def distances(self, samples: CountedSample, candidates: BoundaryDistances) -> BoundaryDistances:
        """The signed distances of candidates (slots, lanes)."""
        return candidates

    def ended(self, motion: _IntervalMotion, before: _IntervalMotion) -> BoolArray:
        return is_over(motion.lane.motion, before.lane.motion, self.engine.t1)

    def results(self, sample: CountedSample, motion: _IntervalMotion) -> Counted:
        totals, sums = motion.lane.totals, motion.sums
        time = totals.stick_time
        if self.likelihood is not None:
            # Score of a Poisson process: d log p / d rate = switches / rate - t1.
            rate = jnp.asarray(self.likelihood.rate, time.dtype)
            score = zero_with_derivative(motion.switches / rate - self.engine.t1, rate, jnp.ones((), bool))
            more = (totals.sticks - self.likelihood.sticks) * score
            sums = sums._replace(event_parts=tuple(part + more for part in sums.event_parts))
            time = time + (time - self.likelihood.stick_time) * score
        status = status_of(motion.lane.motion, jnp.asarray(self.engine.t1, time.dtype))
        return Counted(status, time, totals.sticks, sums)


# For any motion that is simulated in time steps. Most steps are close to no boundary. The others are collected for a
# block, and their signed distances are found together.


class _StepMotion(NamedTuple):
    """A lane of the switched engine, its `EngineStep.crossed`, and its sums so far."""

    lane: Lane
    crossed: FloatArray
    sums: BoundarySums


class StepCounting(CountingEngine[StepsShared, _StepMotion]):
    """The counting engine of a `SwitchedEngine`. Without distances it gives only pathwise derivatives."""

    engine: SwitchedEngine
    looks_back = True

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[CountedSample, _StepMotion]:
        smooth, lane = self.engine.begin(key_data, dtype)
        laws = SegmentLaws.of(self.engine.system, self.engine.excitation).all
        ends = [state.segment.end for law, state in zip(laws, lane.segment_states, strict=True) if law.is_random]
        until = self.first.deterministic_until(jnp.min(jnp.stack(ends))) if ends else jnp.zeros((), dtype)
        begun = _StepMotion(lane, -jnp.ones((), dtype), BoundarySums.none(len(self.bandwidths), dtype))
        return CountedSample(smooth, until), begun

    def step(
        self, shared: StepsShared, sample: CountedSample, motion: _StepMotion, drawn: None
    ) -> tuple[_StepMotion, Trace]:
        model = one_contact_model(self.engine.system, sample.own, self.engine.solver)
        moved, stick, _ = advance(model, *shared, motion.lane)
        if not self.with_distances:
            return motion._replace(lane=moved), Trace(stick, None, None)
        before = motion.lane
        beginning, end = (before.t, before.y, before.sign, before.segment_states), (moved.t, moved.y, moved.sign)
        taken = EngineStep(*beginning, *end, motion.crossed)
        following = crossed_after(shared, taken)
        candidate = Trace(stick, taken, is_candidate(model, shared, taken))
        return motion._replace(lane=moved, crossed=following), candidate

    def after_block(self, samples: CountedSample, motions: _StepMotion, records: Trace) -> _StepMotion:
        if records.is_candidate is None or len(self.bandwidths) == 0:
            return motions
        bandwidths = jnp.asarray(self.bandwidths, samples.deterministic_until.dtype)

        def with_vanishing(sums, stick):
            of_stick = stick.start, stick.end - stick.start, stick.ending
            more = BoundarySums.over_vanishing(*of_stick, samples.deterministic_until, bandwidths)
            return jax.tree.map(jnp.add, sums, more), None

        sums, _ = lax.scan(with_vanishing, motions.sums, records.sticks)
        steps, lanes = records.is_candidate.shape
        found = jnp.cumsum(records.is_candidate.reshape(-1))
        taken = jax.tree.map(lambda leaf: leaf.reshape(steps * lanes, *leaf.shape[2:]), records.candidates)

        def with_some_more(carry):
            # As many candidates at once as there are lanes: the k-th is where k have been found.
            done, sums = carry
            wanted = done + jnp.arange(1, lanes + 1)
            at = jnp.minimum(jnp.searchsorted(found, wanted), steps * lanes - 1)
            lane, exists = at % lanes, wanted <= found[-1]
            smooth, deterministic_until = jax.tree.map(lambda leaf: leaf[lane], samples)
            distances = self._distances_of(jax.tree.map(lambda leaf: leaf[at], taken), smooth)
            more = BoundarySums.over(distances.after(deterministic_until, exists), bandwidths)
            return done + lanes, jax.tree.map(lambda so_far, new: _put(so_far, lane, new), sums, more)

        begun = jnp.zeros_like(found[-1]), sums
        _, sums = lax.while_loop(lambda carry: carry[0] < found[-1], with_some_more, begun)
        return motions._replace(sums=sums)

    def distances(self, samples: CountedSample, candidates: EngineStep) -> BoundaryDistances:
        """The signed distances of candidates (slots, lanes)."""
        return jax.vmap(self._distances_of, in_axes=(0, None))(candidates, samples.own)

    def _distances_of(self, candidates: EngineStep, smooth: Signal | None) -> BoundaryDistances:
        """The signed distances of candidates (candidates,), each under its own smooth excitation."""
        engine, shared = self.engine, self.shared(candidates.t.dtype)

        def of(candidate, smooth):
            return distances_of_step(one_contact_model(engine.system, smooth, engine.solver), shared, candidate)

        return jax.vmap(of)(candidates, smooth)

    def ended(self, motion: _StepMotion, before: _StepMotion) -> BoolArray:
        return self.engine.ended(motion.lane, before.lane)

    def results(self, sample: CountedSample, motion: _StepMotion) -> Counted:
        totals = self.engine.results(sample.own, motion.lane)
        return Counted(totals.status, totals.stick_time, totals.sticks, motion.sums)


def _put(so_far: FloatArray, lane: IntArray, more: FloatArray) -> FloatArray:
    """`so_far` (lanes,) with each of `more` added to its lane. (XLA does not compile a scatter to a native loop.)"""

    def one(i, kept):
        new = lax.dynamic_index_in_dim(kept, lane[i], keepdims=False) + more[i]
        return lax.dynamic_update_index_in_dim(kept, new, lane[i], 0)

    return lax.fori_loop(0, len(lane), one, so_far)
