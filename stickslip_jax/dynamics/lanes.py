"""Many trajectories in lock step: draw a block of base intervals for every lane, cross it, go on until all have ended.

Intervals are drawn while simulating, so a block of lanes stops when its last lane has reached ``t1``, no realisation
is ever too short, and nothing is stored but the state. With `slots`, every stick is stored too.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._types import Array, FloatArray, IntArray, Scalar
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

BLOCK = 16  # intervals drawn at once; a lane idles for half a block on average after its end


class Lanes(NamedTuple):
    """Results, one entry a lane."""

    totals: Totals
    slips: IntArray
    motion: Motion
    status: IntArray


class _Progress(NamedTuple):
    first: Array  # number of the next interval, the same for all lanes
    memory: Any  # what the law remembers
    motion: Motion
    totals: Totals
    advanced: Array  # False when a whole block moved no lane: the law has no more intervals


def sample_words(words: Array | None, index: Array) -> Array | None:
    """The key words of sample `index`: those of ``jax.random.fold_in(key, index)``."""
    return None if words is None else jnp.stack(random_words(words, index))


def simulate_lanes(
    system: MassSpring,
    law: BangBangLaw,
    words: Array | None,
    t1: Scalar,
    y0: tuple[Scalar, Scalar],
    *,
    lanes: int,
    dtype,
    slots: int | None = None,
) -> tuple[Lanes, StickRecord | None]:
    """Simulate `lanes` trajectories, lane i with the key words ``words[:, i]``.

    `slots` (a multiple of `BLOCK`) stores every interval's stick record in arrays (slots, lanes); lanes that need more
    intervals than that end with ``Status.BASE_TOO_SHORT``. Without it nothing is stored, and no lane is too short.
    Forward-mode differentiable; the loop has no fixed length, so reverse mode needs `simulate` under ``vmap``.
    """
    scales = scales_of(system, t1, dtype)
    start = start_motion(scales, y0)

    def begin(words):
        memory = law.begin(words, dtype)
        _, velocities, _ = law.intervals(words, memory, jnp.uint32(0), 1, dtype)
        return memory, sticks_at_start(scales, start, velocities[0])

    memory, at_start = jax.vmap(begin, in_axes=1, axis_size=lanes)(words)

    def per_lane(value):
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes,)), value)

    progress = _Progress(
        first=jnp.uint32(0),
        memory=memory,
        motion=per_lane(start),
        totals=per_lane(start_totals(dtype)),
        advanced=jnp.asarray(True),
    )
    records = None if slots is None else _empty_records(slots, lanes, dtype)

    def unfinished(carry):
        progress, _ = carry
        more = progress.advanced & jnp.any(progress.motion.t < scales.t1)
        return more if slots is None else more & (progress.first < slots)

    def advance(carry):
        progress, records = carry
        following, block = _advance_block(scales, law, words, progress, dtype)
        if records is not None:
            records = jax.tree.map(
                lambda buffer, part: lax.dynamic_update_slice_in_dim(buffer, part, progress.first.astype(int), 0),
                records,
                block,
            )
        return following, records

    progress, records = lax.while_loop(unfinished, advance, (progress, records))
    status = status_of(progress.motion, scales.t1)
    return Lanes(progress.totals, count_slips(progress.totals, at_start), progress.motion, status), records


def _advance_block(
    scales: Scales, law: BangBangLaw, words: Array | None, progress: _Progress, dtype
) -> tuple[_Progress, StickRecord]:
    """Cross the next `BLOCK` intervals of every lane."""

    def one_lane(words, memory, motion, totals):
        durations, velocities, memory = law.intervals(words, memory, progress.first, BLOCK, dtype)
        durations = jnp.where(durations < scales.t1, durations, scales.t1)  # no infinity enters the arithmetic

        def step(carry, interval):
            motion, totals, record = cross_interval(scales, *carry, *interval)
            return (motion, totals), record

        carry, records = lax.scan(step, (motion, totals), (durations, velocities))
        return memory, *carry, records

    lanes = jax.vmap(one_lane, in_axes=(1, 0, 0, 0), out_axes=(0, 0, 0, 1))
    memory, motion, totals, records = lanes(words, progress.memory, progress.motion, progress.totals)
    advanced = jnp.any(motion.t > progress.motion.t)
    return _Progress(progress.first + np.uint32(BLOCK), memory, motion, totals, advanced), records


def _empty_records(slots: int, lanes: int, dtype) -> StickRecord:
    values: FloatArray = jnp.zeros((slots, lanes), dtype)
    return StickRecord(values, values, values, jnp.full((slots, lanes), -1, jnp.int8))
