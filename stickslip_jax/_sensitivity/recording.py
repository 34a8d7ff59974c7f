"""Engines that record, beside the sticks, the candidates: intervals or steps that may be close to a boundary."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from .._dynamics.common.engine import Engine
from .._dynamics.common.segments import SegmentLaws
from .._dynamics.interval.arcs import Scales
from .._dynamics.interval.crossing import scales_of, start_motion, status_of
from .._dynamics.interval.engine import IntervalEngine, is_over
from .._dynamics.switched.engine import SwitchedEngine, SwitchedShared
from .._dynamics.switched.lane import Lane
from .._dynamics.switched.stepping import advance
from .._events.sticks import StickRecord, start_totals
from .._excitation.random import RandomSignal
from .._excitation.smooth import Signal
from .._types import Array, BoolArray, FloatArray, IntArray
from .boundaries import BoundaryDistances, IntervalLane, cross_with_distances
from .step_boundaries import Step, crossed_after, distances_of_step, is_candidate


class Trace(NamedTuple):
    """The record of one interval or step, with at most one stick.

    `candidates`: data from which the engine finds signed distances; `is_candidate`: whether the interval or step may be
    close to a boundary. Both None without distances.
    """

    sticks: StickRecord
    candidates: BoundaryDistances | Step | None
    is_candidate: BoolArray | None


class IntervalSample(NamedTuple):
    """Constants of a sample: its key data, and when the first random thing happens in it, s."""

    key_data: tuple[Array, Array]
    deterministic_until: FloatArray


class IntervalRecording(Engine[Scales, IntervalSample, IntervalLane, Trace, IntArray]):
    """An `IntervalEngine` that also records candidates, if `with_distances`.

    `fixed_start`: whether all samples begin in the same state.
    """

    engine: IntervalEngine
    fixed_start: bool = eqx.field(static=True)
    with_distances: bool = eqx.field(static=True, default=True)

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[IntervalSample, IntervalLane]:
        law, zero = self.engine.law, jnp.zeros((), dtype)
        x, velocity = self.engine.y0
        motion = start_motion(self.shared(dtype), (x, velocity))
        memory = law.begin(key_data, dtype)
        first, _, _ = law.next_interval(memory, law.draw(key_data, jnp.zeros((), jnp.uint32), dtype), dtype)
        lane = IntervalLane(memory, motion, start_totals(dtype), zero)
        return IntervalSample(key_data, first if self.fixed_start else zero), lane

    def shared(self, dtype) -> Scales:
        return scales_of(self.engine.system, self.engine.t1, dtype)

    def draw(self, sample: IntervalSample, number: Array, dtype) -> PyTree:
        return self.engine.law.draw(sample.key_data, number, dtype)

    def step(
        self, shared: Scales, sample: IntervalSample, motion: IntervalLane, drawn: PyTree
    ) -> tuple[IntervalLane, Trace]:
        moved, stick, distances, _ = cross_with_distances(self.engine.law, shared, motion, drawn)
        if not self.with_distances:
            return moved, Trace(stick, None, None)
        return moved, Trace(stick, distances, distances.any_active & (distances.time <= shared.t1))

    def distances(self, samples: IntervalSample, candidates: BoundaryDistances) -> BoundaryDistances:
        """The signed distances of candidates (slots, lanes)."""
        return candidates

    def ended(self, motion: IntervalLane, before: IntervalLane) -> BoolArray:
        return is_over(motion.motion, before.motion, self.engine.t1)

    def results(self, sample: IntervalSample, motion: IntervalLane) -> IntArray:
        """The `Status`."""
        return status_of(motion.motion, jnp.asarray(self.engine.t1, motion.motion.t.dtype))


class StepSample(NamedTuple):
    """Constants of a sample: the smooth part of its excitation, and when the first random thing happens in it, s."""

    smooth: Signal | None
    deterministic_until: FloatArray


class StepMotion(NamedTuple):
    """A lane of the switched engine, and its `Step.crossed`."""

    lane: Lane
    crossed: FloatArray


class StepRecording(Engine[SwitchedShared, StepSample, StepMotion, Trace, IntArray]):
    """A `SwitchedEngine` that also records candidates, if `with_distances`; `fixed_start` as in `IntervalRecording`."""

    engine: SwitchedEngine
    fixed_start: bool = eqx.field(static=True)
    with_distances: bool = eqx.field(static=True, default=True)

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[StepSample, StepMotion]:
        smooth, lane = self.engine.begin(key_data, dtype)
        laws = SegmentLaws.of(self.engine.system, self.engine.excitation).all
        ends = [state.segment.end for law, state in zip(laws, lane.segment_states, strict=True) if law.is_random]
        # All samples move alike until their first random segment ends, if nothing else is random from the start on.
        is_deterministic = self.fixed_start and ends and not isinstance(self.engine.excitation.smooth, RandomSignal)
        until = jnp.min(jnp.stack(ends)) if is_deterministic else jnp.zeros((), dtype)
        return StepSample(smooth, until), StepMotion(lane, -jnp.ones((), dtype))

    def shared(self, dtype) -> SwitchedShared:
        return self.engine.shared(dtype)

    def step(
        self, shared: SwitchedShared, sample: StepSample, motion: StepMotion, drawn: None
    ) -> tuple[StepMotion, Trace]:
        lane, crossed = motion
        model = self.engine.system.one_contact_model(sample.smooth, self.engine.solver)
        moved, stick = advance(model, *shared, lane)
        if not self.with_distances:
            return StepMotion(moved, crossed), Trace(stick, None, None)
        taken = Step.of(lane, moved, crossed)
        following = crossed_after(shared.segment_laws, shared.t1, taken)
        return StepMotion(moved, following), Trace(stick, taken, is_candidate(model, *shared, taken))

    def distances(self, samples: StepSample, candidates: Step) -> BoundaryDistances:
        """The signed distances of candidates (slots, lanes)."""
        return jax.vmap(self.distances_of, in_axes=(0, None))(candidates, samples.smooth)

    def distances_of(self, candidates: Step, smooth: Signal | None) -> BoundaryDistances:
        """The signed distances of candidates (candidates,), each under its own smooth excitation."""
        engine, shared = self.engine, self.shared(candidates.t.dtype)

        def of(candidate, smooth):
            return distances_of_step(engine.system.one_contact_model(smooth, engine.solver), *shared, candidate)

        return jax.vmap(of)(candidates, smooth)

    def ended(self, motion: StepMotion, before: StepMotion) -> BoolArray:
        return self.engine.ended(motion.lane, before.lane)

    def results(self, sample: StepSample, motion: StepMotion) -> IntArray:
        """The `Status`."""
        return jnp.asarray(self.engine.results(sample.smooth, motion.lane).status)


def recording(engine: IntervalEngine | SwitchedEngine, fixed_start: bool) -> IntervalRecording | StepRecording:
    """`engine` with its candidates recorded; `fixed_start`: whether all samples begin in the same state."""
    if isinstance(engine, IntervalEngine):
        return IntervalRecording(engine, fixed_start)
    return StepRecording(engine, fixed_start)
