"""Lanes that hand out, beside their sticks, how near sticks and slips of no length were."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._dynamics.interval.engine import scales_of, start_motion, status_of
from .._dynamics.interval.lanes import IntervalEngine, draw_block
from .._dynamics.lanes import BLOCK
from .._dynamics.switched.engine import SegmentLaws, advance
from .._dynamics.switched.lanes import SwitchedEngine
from .._events.records import StickRecord, start_totals
from .._excitation.random import RandomPhase, realised_state
from .._types import Array, BoolArray, FloatArray, IntArray
from .edges import Edges, IntervalLane, cross_with_edges
from .step_edges import Moment, crossed_at, edges_of_moment, may_be_near


class Trace(NamedTuple):
    """What `BLOCK` intervals or turns hold, at most one stick each; all arrays (BLOCK, lanes).

    `moments`: what the engine finds edges from; `may_be_near`: in which there may be any. None without edges.
    """

    sticks: StickRecord
    moments: Any
    may_be_near: BoolArray | None


class TracedIntervals(eqx.Module):
    """An `IntervalEngine` that hands out edges."""

    engine: IntervalEngine
    fixed_start: bool = eqx.field(static=True)

    def begin(self, key_data: tuple[Array, Array], dtype) -> Any:
        """One lane at t = 0, and until when nothing in it is random, s."""
        engine = self.engine
        x, velocity = realised_state(engine.y0, key_data, dtype)
        motion = start_motion(scales_of(engine.system, engine.t1, dtype), (x, velocity))
        zero, none = jnp.zeros((), dtype), jnp.zeros((), jnp.uint32)
        memory = engine.law.begin(key_data, dtype)
        first, _, _ = engine.law.next_interval(memory, engine.law.draw(key_data, none, dtype), dtype)
        lane = IntervalLane(memory, motion, start_totals(dtype), zero)
        return (key_data, none, lane, jnp.zeros((), bool)), first if self.fixed_start else zero

    def advance(self, state: Any, dtype, with_edges: bool) -> tuple[Any, Trace]:
        """Take all lanes a block further."""
        engine, (key_data, first, start, _) = self.engine, state
        scales = scales_of(engine.system, engine.t1, dtype)
        drawn, numbers = draw_block(engine.law, key_data, first, dtype)

        def step_one(lane, drawn):
            moved, stick, edges, _ = cross_with_edges(engine.law, scales, lane, drawn)
            if not with_edges:
                return moved, Trace(stick, None, None)
            return moved, Trace(stick, edges, edges.any & (edges.time <= scales.t1))

        lane, trace = lax.scan(jax.vmap(step_one), start, drawn, length=BLOCK)
        return (key_data, first + np.uint32(len(numbers)), lane, lane.motion.t <= start.motion.t), trace

    def edges(self, state: Any, moments: Edges) -> Edges:
        """The edges of moments (slots, lanes)."""
        return moments

    def ended(self, state: Any) -> BoolArray:
        """Which lanes have come to the end of their sample."""
        _, _, lane, stalled = state
        return ~(lane.motion.t < jnp.asarray(self.engine.t1, lane.motion.t.dtype)) | stalled

    def status(self, state: Any) -> IntArray:
        """The `Status` of every lane."""
        motion = state[2].motion
        return status_of(motion, jnp.asarray(self.engine.t1, motion.t.dtype))


class _Followed(NamedTuple):
    """What a `SwitchedEngine` keeps of its lanes, and `Moment.crossed` of each."""

    steps: Any
    crossed: FloatArray


class TracedSteps(eqx.Module):
    """A `SwitchedEngine` that hands out edges."""

    engine: SwitchedEngine
    fixed_start: bool = eqx.field(static=True)

    def begin(self, key_data: tuple[Array, Array], dtype) -> Any:
        """One lane at t = 0, and until when nothing in it is random, s."""
        state = self.engine.begin(key_data, dtype)
        laws = SegmentLaws.of(self.engine.system, self.engine.excitation).all
        ends = [
            segment_state.segment.end
            for law, segment_state in zip(laws, state.lane.segment_states, strict=True)
            if law.is_random
        ]
        certain = self.fixed_start and ends and not isinstance(self.engine.excitation.smooth, RandomPhase)
        followed = _Followed(state, -jnp.ones((), dtype))
        return followed, jnp.min(jnp.stack(ends)) if certain else jnp.zeros((), dtype)

    def advance(self, state: Any, dtype, with_edges: bool) -> tuple[Any, Trace]:
        """Take all lanes a block further."""
        engine = self.engine
        segment_laws = SegmentLaws.of(engine.system, engine.excitation)
        t1, step = jnp.asarray(engine.t1, dtype), jnp.asarray(engine.step, dtype)

        smooth = state.steps.smooth

        def advance_one(lane, crossed, smooth):
            model = engine.system.switched_model(smooth, engine.solver)
            moved, stick = advance(model, segment_laws, t1, step, lane)
            if not with_edges:
                return (moved, crossed), Trace(stick, None, None)
            moment = Moment.of(lane, moved, crossed)
            following = crossed_at(segment_laws, t1, moment)
            return (moved, following), Trace(stick, moment, may_be_near(model, segment_laws, t1, step, moment))

        def one_step(now, _):
            lanes, crossed = now
            return jax.vmap(advance_one)(lanes, crossed, smooth)

        (lanes, crossed), trace = lax.scan(one_step, (state.steps.lane, state.crossed), None, length=BLOCK)
        return _Followed(state.steps._replace(lane=lanes), crossed), trace

    def edges(self, state: _Followed, moments: Moment) -> Edges:
        """The edges of moments (slots, lanes)."""
        return jax.vmap(self.edges_of, in_axes=(0, None))(moments, state.steps.smooth)

    def edges_of(self, moments: Moment, smooth: Any) -> Edges:
        """The edges of moments (moments,), each under its own smooth drive."""
        engine, dtype = self.engine, moments.t.dtype
        segment_laws = SegmentLaws.of(engine.system, engine.excitation)
        t1, step = jnp.asarray(engine.t1, dtype), jnp.asarray(engine.step, dtype)

        def edges_of(moment, smooth):
            return edges_of_moment(engine.system.switched_model(smooth, engine.solver), segment_laws, t1, step, moment)

        return jax.vmap(edges_of)(moments, smooth)

    def ended(self, state: Any) -> BoolArray:
        """Which lanes have come to the end of their sample."""
        return self.engine.ended(state.steps)

    def status(self, state: Any) -> IntArray:
        """The `Status` of every lane."""
        return jnp.asarray(self.engine.results(state.steps).status)


def traced(engine: Any, fixed_start: bool) -> TracedIntervals | TracedSteps:
    """`engine`, to hand out edges; `fixed_start` tells that all samples begin in the same state."""
    if isinstance(engine, IntervalEngine):
        return TracedIntervals(engine, fixed_start)
    return TracedSteps(engine, fixed_start)
