"""Lanes of the interval engine: each takes one base interval after the other, drawn as it goes."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..._events.records import Totals, count_slips, start_totals
from ..._excitation.laws import BangBangLaw
from ..._excitation.random import realised_state
from ..._numerics.compiling import computed_once
from ..._systems.mass_spring import MassSpring
from ..._types import Array, BoolArray, Scalar
from ..lanes import BLOCK, Engine, LaneResults, Records
from .engine import Motion, Scales, cross_interval, scales_of, start_motion, status_of, sticks_at_start


class _Lanes(NamedTuple):
    """The state of every lane."""

    key_data: tuple[Array, Array]  # the key words of the lane's sample
    first: Array  # number of its next interval
    memory: Any  # what the law remembers
    motion: Motion
    totals: Totals
    at_start: BoolArray  # whether the sample began with a stick
    stalled: BoolArray  # whether the last block did not move it: the law has no more intervals


def draw_block(law: BangBangLaw, key_data: tuple[Array, Array], first: Array, dtype: Any) -> tuple[Any, Array]:
    """What is random in the `BLOCK` intervals from number `first` (lanes,) on, (BLOCK, lanes), and their numbers."""
    draw = jax.vmap(lambda key_data, number: law.draw(key_data, number, dtype))
    numbers = first[None] + jnp.arange(BLOCK, dtype=jnp.uint32)[:, None]
    return jax.vmap(draw, in_axes=(None, 0))(key_data, numbers), numbers


class IntervalEngine(Engine):
    """A `MassSpring` on a base that follows `law`, up to `t1`, from `y0` (numbers, or `Uniform` values)."""

    system: MassSpring
    law: BangBangLaw
    t1: Scalar
    y0: tuple[Any, ...]

    def begin(self, key_data: tuple[Array, Array], dtype) -> _Lanes:
        scales = self._scales(dtype)
        x, velocity = realised_state(self.y0, key_data, dtype)
        motion = start_motion(scales, (x, velocity))
        memory = computed_once(lambda key_data: self.law.begin(key_data, dtype))(key_data)
        zero = jnp.zeros((), jnp.uint32)
        _, base, _ = self.law.next_interval(memory, self.law.draw(key_data, zero, dtype), dtype)
        at_start = sticks_at_start(scales, motion, base)
        return _Lanes(key_data, zero, memory, motion, start_totals(dtype), at_start, jnp.zeros((), bool))

    def advance(self, state: _Lanes, dtype, buffer: Records | None, slot: Array | int) -> tuple[_Lanes, Records | None]:
        law, scales = self.law, self._scales(dtype)
        drawn, _ = draw_block(law, state.key_data, state.first, dtype)

        def step_one(lane, drawn):
            memory, motion, totals = lane
            duration, velocity, memory = law.next_interval(memory, drawn, dtype)
            duration = jnp.where(duration >= scales.t1, scales.t1, duration)  # no infinity enters the arithmetic
            motion, totals, stick = cross_interval(scales, motion, totals, duration, velocity)
            return (memory, motion, totals), (jnp.stack(stick[:3]), stick.ending)

        def step(carry, drawn):
            lanes, buffer, slot = carry
            lanes, sticks = jax.vmap(step_one, out_axes=(0, (1, 0)))(lanes, drawn)
            return (lanes, buffer if buffer is None else buffer.with_slot(slot, *sticks), slot + 1), None

        carry = ((state.memory, state.motion, state.totals), buffer, slot)
        ((memory, motion, totals), buffer, _), _ = lax.scan(step, carry, drawn, length=BLOCK)
        stalled = motion.t <= state.motion.t
        first = state.first + np.uint32(BLOCK)
        return _Lanes(state.key_data, first, memory, motion, totals, state.at_start, stalled), buffer

    def ended(self, state: _Lanes) -> BoolArray:
        # Written so that a NaN time counts as ended.
        return ~(state.motion.t < jnp.asarray(self.t1, state.motion.t.dtype)) | state.stalled

    def results(self, state: _Lanes) -> LaneResults:
        return LaneResults(
            sticks=state.totals.sticks,
            slips=count_slips(state.totals, state.at_start),
            stick_time=state.totals.stick_time,
            status=status_of(state.motion, jnp.asarray(self.t1, state.motion.t.dtype)),
            near_grazing_count=jnp.zeros_like(state.totals.sticks),
        )

    def _scales(self, dtype) -> Scales:
        return scales_of(self.system, self.t1, dtype)
