"""Compiled functions that simulate a chunk of an ensemble: what a worker thread calls."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._types import Array, FloatArray, IntArray, Scalar
from ..base_motion.laws import BangBangLaw
from ..systems.mass_spring import MassSpring
from .interval_engine import StickRecord
from .lanes import Lanes, sample_words, simulate_lanes

# 512-bit vectors halve the time where the CPU has them, and change nothing where it has not.
_WIDE = {"xla_cpu_prefer_vector_width": 512}


class LaneResults(NamedTuple):
    """What the statistics need of each sample; arrays (samples,)."""

    sticks: IntArray
    released: IntArray
    slips: IntArray
    stick_time: FloatArray
    t: FloatArray  # the time reached, s
    status: IntArray


def _results(lanes: Lanes) -> LaneResults:
    totals = lanes.totals
    return LaneResults(totals.sticks, totals.released, lanes.slips, totals.stick_time, lanes.motion.t, lanes.status)


@partial(jax.jit, static_argnames=("lanes", "blocks", "dtype"), compiler_options=_WIDE)
def summarise_chunk(
    system: MassSpring,
    law: BangBangLaw,
    words: Array | None,
    t1: Scalar,
    y0: tuple[Scalar, Scalar],
    first: Array,
    used_blocks: Array,
    *,
    lanes: int,
    blocks: int,
    dtype,
) -> LaneResults:
    """Simulate samples ``first ..`` in `used_blocks` blocks of `lanes`; results in arrays of ``blocks * lanes``.

    The number of blocks in use is no part of the compiled shape: any number of samples shares one compilation.
    """

    def simulate_block(i):
        index = first + i.astype(jnp.uint32) * np.uint32(lanes) + jnp.arange(lanes, dtype=jnp.uint32)
        done, _ = simulate_lanes(system, law, sample_words(words, index), t1, y0, lanes=lanes, dtype=dtype)
        return _results(done)

    def put(i, results):
        return jax.tree.map(
            lambda all_, part: lax.dynamic_update_slice_in_dim(all_, part[None], i, 0), results, simulate_block(i)
        )

    shapes = jax.eval_shape(simulate_block, jnp.int32(0))
    results = jax.tree.map(lambda leaf: jnp.zeros((blocks, *leaf.shape), leaf.dtype), shapes)
    results = lax.fori_loop(jnp.int32(0), used_blocks, put, results)
    return jax.tree.map(lambda leaf: leaf.reshape(-1), results)


@partial(jax.jit, static_argnames=("lanes", "slots", "dtype"), compiler_options=_WIDE)
def record_chunk(
    system: MassSpring,
    law: BangBangLaw,
    words: Array | None,
    t1: Scalar,
    y0: tuple[Scalar, Scalar],
    index: Array,
    *,
    lanes: int,
    slots: int,
    dtype,
) -> tuple[LaneResults, StickRecord]:
    """Simulate the samples numbered `index` (lanes,) and keep each interval's stick, arrays (slots, lanes)."""
    done, records = simulate_lanes(
        system, law, sample_words(words, index), t1, y0, lanes=lanes, dtype=dtype, slots=slots
    )
    assert records is not None
    return _results(done), records
