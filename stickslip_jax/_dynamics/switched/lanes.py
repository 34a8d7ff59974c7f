"""Lanes of the switched engine: each takes one time step after the other."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..._events.records import count_slips
from ..._excitation.excitation import Drive
from ..._excitation.random import realised_state
from ..._excitation.smooth import Signal
from ..._types import AnyInteger, Array, BoolArray, Scalar
from ..lanes import BLOCK, Engine, LaneResults, Records
from .engine import Lane, Streams, advance, has_ended, status_of_lane
from .run import lane_at_start


class _Lanes(NamedTuple):
    """The state of every lane, and the smooth drive of its sample."""

    lane: Lane
    smooth: Signal | None


class SwitchedEngine(Engine):
    """Any system under any drive, up to `t1`, from `y0` (numbers, or `Uniform` values), by time steps of `step` s.

    A sample that takes more than `most_turns` steps and tries is given up.
    """

    system: Any
    drive: Drive
    solver: Any
    t1: Scalar
    y0: tuple[Any, ...]
    step: Scalar
    most_turns: AnyInteger

    def begin(self, words: tuple[Array, Array], dtype) -> _Lanes:
        y0 = realised_state(self.y0, words, dtype)
        lane = lane_at_start(self.system, self.drive, words, y0, jnp.asarray(self.step, dtype), self.solver)
        smooth = self.drive.realised(words, dtype)
        return _Lanes(lane, jax.tree.map(lambda number: jnp.asarray(number, dtype), smooth))

    def advance(self, state: _Lanes, dtype, room: Records | None, slot: Array | int) -> tuple[_Lanes, Records | None]:
        streams = Streams.of(self.system, self.drive)
        t1, step = jnp.asarray(self.t1, dtype), jnp.asarray(self.step, dtype)

        def step_one(lane, smooth):
            lane, stick = advance(self.system.switched_model(smooth, self.solver), streams, t1, step, lane)
            return lane, (jnp.stack(stick[:3]), stick.ending)

        def turn(carry, _):
            lanes, room, slot = carry
            lanes, sticks = jax.vmap(step_one, out_axes=(0, (1, 0)))(lanes, state.smooth)
            return (lanes, room if room is None else room.with_slot(slot, *sticks), slot + 1), None

        (lanes, room, _), _ = lax.scan(turn, (state.lane, room, slot), None, length=BLOCK)
        return _Lanes(lanes, state.smooth), room

    def ended(self, state: _Lanes) -> BoolArray:
        most = jnp.asarray(self.most_turns, jnp.int32)
        return jax.vmap(lambda lane: has_ended(lane, self._t1(lane), most))(state.lane)

    def results(self, state: _Lanes) -> LaneResults:
        lanes = state.lane
        return LaneResults(
            sticks=lanes.totals.sticks,
            slips=count_slips(lanes.totals, lanes.at_start),
            stick_time=lanes.totals.stick_time,
            status=jax.vmap(lambda lane: status_of_lane(lane, self._t1(lane)))(lanes),
            doubts=lanes.doubts,
        )

    def _t1(self, lane: Lane) -> Array:
        return jnp.asarray(self.t1, lane.t.dtype)
