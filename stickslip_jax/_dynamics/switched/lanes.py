"""Lanes of the switched engine: each takes one time step after the other."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..._events.records import count_slips
from ..._excitation.excitation import Excitation
from ..._excitation.random import realised_state
from ..._excitation.smooth import Signal
from ..._types import AnyInteger, Array, BoolArray, Scalar
from ..lanes import BLOCK, Engine, LaneResults, Records
from .engine import Lane, SegmentLaws, advance, has_ended, status_of_lane
from .run import lane_at_start


class _Lanes(NamedTuple):
    """The state of every lane, and the smooth drive of its sample."""

    lane: Lane
    smooth: Signal | None


class SwitchedEngine(Engine):
    """Any system under any drive, up to `t1`, from `y0` (numbers, or `Uniform` values), by time steps of `step` s.

    A sample that takes more than `most_steps` steps and tries is given up.
    """

    system: Any
    excitation: Excitation
    solver: Any
    t1: Scalar
    y0: tuple[Any, ...]
    step: Scalar
    most_steps: AnyInteger

    def begin(self, key_data: tuple[Array, Array], dtype) -> _Lanes:
        y0 = realised_state(self.y0, key_data, dtype)
        lane = lane_at_start(self.system, self.excitation, key_data, y0, jnp.asarray(self.step, dtype), self.solver)
        smooth = self.excitation.realised(key_data, dtype)
        return _Lanes(lane, jax.tree.map(lambda number: jnp.asarray(number, dtype), smooth))

    def advance(self, state: _Lanes, dtype, buffer: Records | None, slot: Array | int) -> tuple[_Lanes, Records | None]:
        segment_laws = SegmentLaws.of(self.system, self.excitation)
        t1, step = jnp.asarray(self.t1, dtype), jnp.asarray(self.step, dtype)

        def step_one(lane, smooth):
            lane, stick = advance(self.system.switched_model(smooth, self.solver), segment_laws, t1, step, lane)
            return lane, (jnp.stack(stick[:3]), stick.ending)

        def one_step(carry, _):
            lanes, buffer, slot = carry
            lanes, sticks = jax.vmap(step_one, out_axes=(0, (1, 0)))(lanes, state.smooth)
            return (lanes, buffer if buffer is None else buffer.with_slot(slot, *sticks), slot + 1), None

        (lanes, buffer, _), _ = lax.scan(one_step, (state.lane, buffer, slot), None, length=BLOCK)
        return _Lanes(lanes, state.smooth), buffer

    def ended(self, state: _Lanes) -> BoolArray:
        most = jnp.asarray(self.most_steps, jnp.int32)
        return jax.vmap(lambda lane: has_ended(lane, self._t1(lane), most))(state.lane)

    def results(self, state: _Lanes) -> LaneResults:
        lanes = state.lane
        return LaneResults(
            sticks=lanes.totals.sticks,
            slips=count_slips(lanes.totals, lanes.at_start),
            stick_time=lanes.totals.stick_time,
            status=jax.vmap(lambda lane: status_of_lane(lane, self._t1(lane)))(lanes),
            near_grazing_count=lanes.near_grazing_count,
        )

    def _t1(self, lane: Lane) -> Array:
        return jnp.asarray(self.t1, lane.t.dtype)
