"""Engines that record, beside the sticks, the margins of sticks and slips about to appear or vanish."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from .._dynamics.interval.engine import Scales, scales_of, start_motion, status_of
from .._dynamics.interval.lanes import IntervalEngine, is_over
from .._dynamics.lanes import Engine
from .._dynamics.switched.engine import Lane, SegmentLaws, advance
from .._dynamics.switched.lanes import Shared, SwitchedEngine
from .._events.sticks import StickRecord, start_totals
from .._excitation.random import RandomSignal
from .._types import Array, BoolArray, FloatArray, IntArray
from .edges import Edges, IntervalLane, cross_with_edges
from .step_edges import Moment, crossed_at, edges_of_moment, may_be_near


class Trace(NamedTuple):
    """The record of one interval or step, with at most one stick.

    `moments`: data from which the engine finds edges; `may_be_near`: whether there may be any. None without edges.
    """

    sticks: StickRecord
    moments: Any
    may_be_near: BoolArray | None


class Sample(NamedTuple):
    """Constants of a sample: `own`, those of the traced engine; `certain`: until when nothing is random, s."""

    own: Any
    certain: FloatArray


class TracedIntervals(Engine):
    """An `IntervalEngine` that also records edges, if `with_edges`.

    `fixed_start`: whether all samples begin in the same state.
    """

    engine: IntervalEngine
    fixed_start: bool = eqx.field(static=True)
    with_edges: bool = eqx.field(static=True, default=True)

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Sample, IntervalLane]:
        law, zero = self.engine.law, jnp.zeros((), dtype)
        x, velocity = self.engine.y0
        motion = start_motion(self.shared(dtype), (x, velocity))
        memory = law.begin(key_data, dtype)
        first, _, _ = law.next_interval(memory, law.draw(key_data, jnp.zeros((), jnp.uint32), dtype), dtype)
        lane = IntervalLane(memory, motion, start_totals(dtype), zero)
        return Sample(key_data, first if self.fixed_start else zero), lane

    def shared(self, dtype) -> Scales:
        return scales_of(self.engine.system, self.engine.t1, dtype)

    def draw(self, sample: Sample, number: Array, dtype) -> Any:
        return self.engine.law.draw(sample.own, number, dtype)

    def step(self, shared: Scales, sample: Sample, motion: IntervalLane, drawn: Any) -> tuple[IntervalLane, Trace]:
        moved, stick, edges, _ = cross_with_edges(self.engine.law, shared, motion, drawn)
        if not self.with_edges:
            return moved, Trace(stick, None, None)
        return moved, Trace(stick, edges, edges.any & (edges.time <= shared.t1))

    def edges(self, samples: Sample, moments: Edges) -> Edges:
        """The edges of moments (slots, lanes)."""
        return moments

    def ended(self, motion: IntervalLane, before: IntervalLane) -> BoolArray:
        return is_over(motion.motion, before.motion, self.engine.t1)

    def results(self, sample: Sample, motion: IntervalLane) -> IntArray:
        """The `Status`."""
        return status_of(motion.motion, jnp.asarray(self.engine.t1, motion.motion.t.dtype))


class StepMotion(NamedTuple):
    """A lane of the switched engine, and its `Moment.crossed`."""

    lane: Lane
    crossed: FloatArray


class TracedSteps(Engine):
    """A `SwitchedEngine` that also records edges, if `with_edges`; `fixed_start` as for `TracedIntervals`."""

    engine: SwitchedEngine
    fixed_start: bool = eqx.field(static=True)
    with_edges: bool = eqx.field(static=True, default=True)

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Sample, StepMotion]:
        smooth, lane = self.engine.begin(key_data, dtype)
        laws = SegmentLaws.of(self.engine.system, self.engine.excitation).all
        ends = [state.segment.end for law, state in zip(laws, lane.segment_states, strict=True) if law.is_random]
        is_certain = self.fixed_start and ends and not isinstance(self.engine.excitation.smooth, RandomSignal)
        certain = jnp.min(jnp.stack(ends)) if is_certain else jnp.zeros((), dtype)
        return Sample(smooth, certain), StepMotion(lane, -jnp.ones((), dtype))

    def shared(self, dtype) -> Shared:
        return self.engine.shared(dtype)

    def step(self, shared: Shared, sample: Sample, motion: StepMotion, drawn: None) -> tuple[StepMotion, Trace]:
        lane, crossed = motion
        model = self.engine.system.switched_model(sample.own, self.engine.solver)
        moved, stick = advance(model, *shared, lane)
        if not self.with_edges:
            return StepMotion(moved, crossed), Trace(stick, None, None)
        moment = Moment.of(lane, moved, crossed)
        following = crossed_at(shared.segment_laws, shared.t1, moment)
        return StepMotion(moved, following), Trace(stick, moment, may_be_near(model, *shared, moment))

    def edges(self, samples: Sample, moments: Moment) -> Edges:
        """The edges of moments (slots, lanes)."""
        return jax.vmap(self.edges_of, in_axes=(0, None))(moments, samples.own)

    def edges_of(self, moments: Moment, smooth: Any) -> Edges:
        """The edges of moments (moments,), each under its own smooth excitation."""
        engine, shared = self.engine, self.shared(moments.t.dtype)

        def edges_of(moment, smooth):
            return edges_of_moment(engine.system.switched_model(smooth, engine.solver), *shared, moment)

        return jax.vmap(edges_of)(moments, smooth)

    def ended(self, motion: StepMotion, before: StepMotion) -> BoolArray:
        return self.engine.ended(motion.lane, before.lane)

    def results(self, sample: Sample, motion: StepMotion) -> IntArray:
        """The `Status`."""
        return jnp.asarray(self.engine.results(sample.own, motion.lane).status)


def traced(engine: Any, fixed_start: bool) -> TracedIntervals | TracedSteps:
    """`engine` with recorded edges; `fixed_start`: whether all samples begin in the same state."""
    if isinstance(engine, IntervalEngine):
        return TracedIntervals(engine, fixed_start)
    return TracedSteps(engine, fixed_start)
