"""Many trajectories in lock step: draw a block of base intervals for every lane, cross it, go on.

Intervals are drawn while simulating, so no realisation is ever too short and none is stored. `stream_lanes` gives a
lane its next sample as soon as one has ended, and keeps totals; `record_lanes` runs one sample a lane and keeps
every stick.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._types import AnyArray, Array, BoolArray, Scalar
from ..base_motion.laws import BangBangLaw
from ..numerics.random_bits import random_words
from ..systems.mass_spring import MassSpring
from .interval_engine import (
    Motion,
    Scales,
    StickRecord,
    Totals,
    count_slips,
    cross_interval,
    scales_of,
    start_motion,
    start_totals,
    status_of,
    sticks_at_start,
)

BLOCK = 16  # intervals drawn at once; a lane idles for half a block on average after its sample's end


class LaneResults(NamedTuple):
    """What the statistics need of each sample, one entry a sample."""

    sticks: AnyArray
    released: AnyArray
    slips: AnyArray
    stick_time: AnyArray
    t: AnyArray  # the time reached, s
    status: AnyArray


class _Lanes(NamedTuple):
    """The state of every lane; the first axis (of `words`: the last) counts lanes."""

    words: Array  # the key words of the lane's sample
    first: Array  # number of its next interval
    memory: Any  # what the law remembers
    motion: Motion
    totals: Totals
    at_start: BoolArray  # whether the sample began with a stick
    stalled: BoolArray  # whether the last block did not move it: the law has no more intervals


def stream_lanes(
    system: MassSpring,
    law: BangBangLaw,
    words: Array,
    t1: Scalar,
    y0: tuple[Scalar, Scalar],
    first_sample: Array,
    used_rows: Array,
    *,
    lanes: int,
    rows: int,
    dtype,
) -> LaneResults:
    """Simulate samples ``first_sample .. first_sample + used_rows * lanes - 1`` of the key `words`.

    Results are arrays (rows, lanes): lane i simulates samples ``first_sample + i + lanes * row``, one after the other,
    which wastes less than waiting for the slowest lane after each. `used_rows` is no part of the compiled shape.
    Forward-mode differentiable; the loop has no fixed length, so reverse mode needs `simulate` under ``vmap``.
    """
    scales = scales_of(system, t1, dtype)
    lane = jnp.arange(lanes, dtype=jnp.uint32)
    row_numbers = jnp.arange(rows)[:, None]

    def start(row):
        sample = first_sample + lane + row.astype(jnp.uint32) * np.uint32(lanes)
        return _start_lanes(scales, law, random_words(words, sample), y0, dtype)

    def unfinished(carry):
        return jnp.any(carry[0] < used_rows)

    def advance(carry):
        row, state, results = carry
        state, _ = _advance_block(scales, law, state, dtype)
        ended = (_ended(scales, state)) & (row < used_rows)
        here = ended & (row_numbers == row)
        results = jax.tree.map(lambda kept, new: jnp.where(here, new, kept), results, _results(scales, state))
        row = row + ended
        return row, _where_lanes(ended, start(row), state), results

    row = jnp.zeros(lanes, jnp.int32)
    state = start(row)
    shapes = jax.eval_shape(lambda s: _results(scales, s), state)
    results = jax.tree.map(lambda leaf: jnp.zeros((rows, *leaf.shape), leaf.dtype), shapes)
    return lax.while_loop(unfinished, advance, (row, state, results))[2]


def record_lanes(
    system: MassSpring,
    law: BangBangLaw,
    words: Array,
    t1: Scalar,
    y0: tuple[Scalar, Scalar],
    samples: Array,
    *,
    slots: int,
    dtype,
) -> tuple[LaneResults, StickRecord]:
    """Simulate the samples numbered `samples` (lanes,) of the key `words` and keep each interval's stick record.

    Records are arrays (slots, lanes), `slots` a multiple of `BLOCK`; a lane that needs more intervals than that ends
    with ``Status.BASE_TOO_SHORT``.
    """
    scales = scales_of(system, t1, dtype)
    values, endings = jnp.zeros((slots, *samples.shape), dtype), jnp.full((slots, *samples.shape), -1, jnp.int8)
    state = _start_lanes(scales, law, random_words(words, samples), y0, dtype)

    def unfinished(carry):
        slot, state, _ = carry
        return (slot < slots) & ~jnp.all(_ended(scales, state))

    def advance(carry):
        slot, state, records = carry
        state, block = _advance_block(scales, law, state, dtype)
        records = jax.tree.map(lambda kept, new: lax.dynamic_update_slice_in_dim(kept, new, slot, 0), records, block)
        return slot + BLOCK, state, records

    records = StickRecord(values, values, values, endings)
    _, state, records = lax.while_loop(unfinished, advance, (jnp.zeros((), int), state, records))
    return _results(scales, state), records


def _start_lanes(scales: Scales, law: BangBangLaw, words: tuple[Array, Array], y0, dtype) -> _Lanes:
    """Every lane at t = 0 of the sample that its key words belong to."""
    start = start_motion(scales, y0)
    start_and_zero = (start, start_totals(dtype))
    stacked = jnp.stack(words)

    def begin(words):
        memory = law.begin(words, dtype)
        _, velocity, _ = law.next_interval(memory, law.draw(words, jnp.uint32(0), dtype), dtype)
        return memory, sticks_at_start(scales, start, velocity)

    lanes = stacked.shape[1]
    memory, at_start = jax.vmap(begin, in_axes=1)(stacked)
    motion, totals = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes,)), start_and_zero)
    return _Lanes(stacked, jnp.zeros(lanes, jnp.uint32), memory, motion, totals, at_start, jnp.zeros(lanes, bool))


def _advance_block(scales: Scales, law: BangBangLaw, state: _Lanes, dtype) -> tuple[_Lanes, StickRecord]:
    """Cross the next `BLOCK` intervals of every lane."""

    # All draws of the block at once, laid out (BLOCK, lanes) as the scan reads them.
    draw = jax.vmap(lambda words, number: law.draw(words, number, dtype), in_axes=(1, 0))
    numbers = state.first + jnp.arange(BLOCK, dtype=jnp.uint32)[:, None]
    drawn = jax.vmap(draw, in_axes=(None, 0))(state.words, numbers)

    def step(carry, drawn):
        memory, motion, totals = carry
        duration, velocity, memory = law.next_interval(memory, drawn, dtype)
        duration = jnp.where(duration < scales.t1, duration, scales.t1)  # no infinity enters the arithmetic
        motion, totals, record = cross_interval(scales, motion, totals, duration, velocity)
        return (memory, motion, totals), record

    carry = (state.memory, state.motion, state.totals)
    (memory, motion, totals), records = lax.scan(jax.vmap(step), carry, drawn, length=BLOCK)
    stalled = motion.t <= state.motion.t
    following = _Lanes(state.words, state.first + np.uint32(BLOCK), memory, motion, totals, state.at_start, stalled)
    return following, records


def _ended(scales: Scales, state: _Lanes) -> BoolArray:
    # Written so that a NaN time counts as ended.
    return ~(state.motion.t < scales.t1) | state.stalled


def _results(scales: Scales, state: _Lanes) -> LaneResults:
    totals = state.totals
    return LaneResults(
        sticks=totals.sticks,
        released=totals.released,
        slips=count_slips(totals, state.at_start),
        stick_time=totals.stick_time,
        t=state.motion.t,
        status=status_of(state.motion, scales.t1),
    )


def _where_lanes(chosen: BoolArray, new: _Lanes, old: _Lanes) -> _Lanes:
    """`new` in the `chosen` lanes; lanes are the last axis of words and the first of everything else."""

    def pick(fresh, current):
        shape = chosen.shape + (1,) * (fresh.ndim - 1)
        return jnp.where(chosen.reshape(shape), fresh, current)

    picked = jax.tree.map(pick, new._replace(words=()), old._replace(words=()))
    return picked._replace(words=jnp.where(chosen, new.words, old.words))
