"""Many trajectories in lock step: draw a block of base intervals for every lane, cross it, go on.

A lane starts its next sample as soon as one has ended. Intervals are drawn while simulating, so no realisation is ever
too short and none is stored. `summarise` keeps totals; `record` hands out every stick, a few blocks at a time.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._types import AnyArray, AnyInteger, Array, BoolArray, IntArray, Scalar
from ..base_motion.laws import BangBangLaw
from ..numerics.random_bits import random_words
from ..systems.mass_spring import MassSpring
from .interval_engine import (
    Motion,
    Scales,
    Totals,
    count_slips,
    cross_interval,
    scales_of,
    start_motion,
    start_totals,
    status_of,
    sticks_at_start,
)

BLOCK = 24  # intervals drawn at once; a lane idles for half a block on average after its sample's end


class LaneResults(NamedTuple):
    """What the statistics need of each sample, one entry a sample."""

    sticks: AnyArray
    slips: AnyArray
    stick_time: AnyArray
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


class Stream(NamedTuple):
    """Lanes at work on rows of samples: which row each lane is in, its state, and the results so far (rows, lanes)."""

    row: IntArray
    state: _Lanes
    results: LaneResults


class Records(NamedTuple):
    """Room for the sticks of some blocks, one slot an interval.

    Times and positions share one array: XLA updates a single large array of a shape in place, but copies several.
    """

    values: Array  # (slots, 3, lanes): start, end (s), position (m)
    ending: Array  # (slots, lanes): an `Ending` code, or -1 where there is no stick

    @classmethod
    def empty(cls, slots: int, lanes: int, dtype) -> "Records":
        """Room without sticks."""
        return cls(jnp.zeros((slots, 3, lanes), dtype), jnp.full((slots, lanes), -1, jnp.int8))


class Job(NamedTuple):
    """What to simulate: samples ``first_sample .. first_sample + used_rows * lanes - 1`` of the key `words`.

    Lane i simulates samples ``first_sample + i + lanes * row``, one after the other, which wastes less than waiting for
    the slowest lane after each.
    """

    system: MassSpring
    law: BangBangLaw
    words: Array
    t1: Scalar
    y0: tuple[Scalar, Scalar]
    first_sample: AnyInteger
    used_rows: AnyInteger


def open_stream(job: Job, *, lanes: int, rows: int, dtype) -> Stream:
    """Every lane at the beginning of its first sample. `job.used_rows` may be anything up to `rows`."""
    row = jnp.zeros(lanes, jnp.int32)
    state = _start_row(job, row, dtype)
    scales = scales_of(job.system, job.t1, dtype)
    shapes = jax.eval_shape(lambda s: _results(scales, s), state)
    results = jax.tree.map(lambda leaf: jnp.zeros((rows, *leaf.shape), leaf.dtype), shapes)
    return Stream(row, state, results)


def summarise(job: Job, *, lanes: int, rows: int, dtype) -> LaneResults:
    """Simulate the whole job and keep totals; arrays (rows, lanes).

    Forward-mode differentiable; the loop has no fixed length, so reverse mode needs `simulate` under ``vmap``.
    """

    def advance(stream):
        return _advance_stream(job, stream, dtype)[0]

    stream = open_stream(job, lanes=lanes, rows=rows, dtype=dtype)
    return lax.while_loop(lambda stream: jnp.any(stream.row < job.used_rows), advance, stream).results


def record(job: Job, stream: Stream, room: Records, *, dtype) -> tuple[Stream, Records, IntArray]:
    """Go on with `stream` for as many blocks as `room` holds, and keep each interval's stick.

    Returns the stream to go on with (the job is done when no row is below `job.used_rows`), the records, and the row
    that each block of records belongs to, (blocks, lanes).
    """

    def advance(carry, block):
        stream, room = carry
        following, room = _advance_stream(job, stream, dtype, room, block * BLOCK)
        return (following, room), stream.row

    (stream, room), rows = lax.scan(advance, (stream, room), jnp.arange(len(room.ending) // BLOCK))
    return stream, room, rows


def _advance_stream(job: Job, stream: Stream, dtype, room: Any = None, slot: Array | int = 0) -> tuple[Stream, Any]:
    """Cross one block of intervals; lanes whose sample has ended note its results and start their next."""
    scales = scales_of(job.system, job.t1, dtype)
    state, room = _advance_block(scales, job.law, stream.state, dtype, room, slot)
    ended = _ended(scales, state) & (stream.row < job.used_rows)
    here = ended & (jnp.arange(stream.results.status.shape[0])[:, None] == stream.row)
    results = jax.tree.map(lambda kept, new: jnp.where(here, new, kept), stream.results, _results(scales, state))
    row = stream.row + ended
    return Stream(row, _where_lanes(ended, _start_row(job, row, dtype), state), results), room


def _start_row(job: Job, row: IntArray, dtype) -> _Lanes:
    """Every lane at t = 0 of its sample in row `row` (lanes,)."""
    lanes = len(row)
    lane = jnp.arange(lanes, dtype=jnp.uint32)
    words = jnp.stack(random_words(job.words, job.first_sample + lane + row.astype(jnp.uint32) * np.uint32(lanes)))
    scales = scales_of(job.system, job.t1, dtype)
    start = start_motion(scales, job.y0)

    def begin(words):
        memory = job.law.begin(words, dtype)
        _, velocity, _ = job.law.next_interval(memory, job.law.draw(words, jnp.uint32(0), dtype), dtype)
        return memory, sticks_at_start(scales, start, velocity)

    memory, at_start = jax.vmap(begin, in_axes=1)(words)
    motion, totals = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes,)), (start, start_totals(dtype)))
    return _Lanes(words, jnp.zeros(lanes, jnp.uint32), memory, motion, totals, at_start, jnp.zeros(lanes, bool))


def _advance_block(scales: Scales, law: BangBangLaw, state: _Lanes, dtype, room: Records | None, slot: Array | int):
    """Cross the next `BLOCK` intervals of every lane; keep their sticks in `room` from `slot` on, if there is room."""
    # All draws of the block at once, laid out (BLOCK, lanes) as the scan reads them.
    draw = jax.vmap(lambda words, number: law.draw(words, number, dtype), in_axes=(1, 0))
    numbers = state.first + jnp.arange(BLOCK, dtype=jnp.uint32)[:, None]
    drawn = jax.vmap(draw, in_axes=(None, 0))(state.words, numbers)

    def step_one(lane, drawn):
        memory, motion, totals = lane
        duration, velocity, memory = law.next_interval(memory, drawn, dtype)
        duration = jnp.where(duration >= scales.t1, scales.t1, duration)  # no infinity enters the arithmetic
        motion, totals, stick = cross_interval(scales, motion, totals, duration, velocity)
        return (memory, motion, totals), (jnp.stack(stick[:3]), stick.ending)

    def step(carry, drawn):
        lanes, room, slot = carry
        lanes, sticks = jax.vmap(step_one, out_axes=(0, (1, 0)))(lanes, drawn)
        if room is not None:
            room = jax.tree.map(
                lambda kept, new: lax.dynamic_update_slice_in_dim(kept, new[None], slot, 0), room, Records(*sticks)
            )
        return (lanes, room, slot + 1), None

    carry = ((state.memory, state.motion, state.totals), room, slot)
    ((memory, motion, totals), room, _), _ = lax.scan(step, carry, drawn, length=BLOCK)
    stalled = motion.t <= state.motion.t
    following = _Lanes(state.words, state.first + np.uint32(BLOCK), memory, motion, totals, state.at_start, stalled)
    return following, room


def _ended(scales: Scales, state: _Lanes) -> BoolArray:
    # Written so that a NaN time counts as ended.
    return ~(state.motion.t < scales.t1) | state.stalled


def _results(scales: Scales, state: _Lanes) -> LaneResults:
    totals = state.totals
    return LaneResults(
        sticks=totals.sticks,
        slips=count_slips(totals, state.at_start),
        stick_time=totals.stick_time,
        status=status_of(state.motion, scales.t1),
    )


def _where_lanes(chosen: BoolArray, new: _Lanes, old: _Lanes) -> _Lanes:
    """`new` in the `chosen` lanes; lanes are the last axis of words and the first of everything else."""

    def pick(fresh, current):
        shape = chosen.shape + (1,) * (fresh.ndim - 1)
        return jnp.where(chosen.reshape(shape), fresh, current)

    picked = jax.tree.map(pick, new._replace(words=()), old._replace(words=()))
    return picked._replace(words=jnp.where(chosen, new.words, old.words))
