"""Many trajectories in lock step: take every lane a block further, see which have ended, go on.

A lane starts its next sample as soon as one has ended. What drives a sample is drawn while simulating, so no
realisation is ever too short and none is stored. `summarise` keeps totals; `record` hands out every stick, a few
blocks at a time. How a lane moves is the engine's affair (`interval_lanes.py`, `switched_lanes.py`).
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._types import AnyArray, AnyInteger, Array, BoolArray, IntArray
from ..numerics.random_bits import stored_words

BLOCK = 24  # intervals or steps taken at once; a lane idles for half a block on average after its sample's end


class LaneResults(NamedTuple):
    """What the statistics need of each sample, one entry a sample."""

    sticks: AnyArray
    slips: AnyArray
    stick_time: AnyArray
    status: AnyArray
    doubts: AnyArray


class Stream(NamedTuple):
    """Lanes at work on rows of samples: which row each lane is in, its state, and the results so far (rows, lanes)."""

    row: IntArray
    state: Any
    results: LaneResults


class Records(NamedTuple):
    """Room for the sticks of some blocks, one slot an interval or step.

    Times and positions share one array: XLA updates a single large array of a shape in place, but copies several.
    """

    values: Array  # (slots, 3, lanes): start, end (s), position (m)
    ending: Array  # (slots, lanes): an `Ending` code, or -1 where there is no stick

    @classmethod
    def empty(cls, slots: int, lanes: int, dtype) -> "Records":
        """Room without sticks."""
        return cls(jnp.zeros((slots, 3, lanes), dtype), jnp.full((slots, lanes), -1, jnp.int8))

    def with_slot(self, slot: Array, values: Array, ending: Array) -> "Records":
        """The same with the sticks (3, lanes) and endings (lanes,) of one slot put in."""
        return Records(*(
            lax.dynamic_update_slice_in_dim(kept, new[None], slot, 0)
            for kept, new in zip(self, (values, ending), strict=True)
        ))  # fmt: skip


class Engine(eqx.Module):
    """How lanes move. All leaves of a state have the lanes as their first axis."""

    @abc.abstractmethod
    def begin(self, words: tuple[Array, Array], dtype) -> Any:
        """The state of ONE lane at t = 0 of the sample whose key has these words."""

    @abc.abstractmethod
    def advance(self, state: Any, dtype, room: Records | None, slot: Array | int) -> tuple[Any, Records | None]:
        """Take all lanes `BLOCK` intervals or steps further; put their sticks into `room` (if any) from `slot` on."""

    @abc.abstractmethod
    def ended(self, state: Any) -> BoolArray:
        """Which lanes have come to the end of their sample, for whatever reason."""

    @abc.abstractmethod
    def results(self, state: Any) -> LaneResults:
        """The totals of all lanes."""


class Job(NamedTuple):
    """What to simulate: samples ``first_sample .. first_sample + used_rows * lanes - 1`` of the key `words`.

    Lane i simulates samples ``first_sample + i + lanes * row``, one after the other, which wastes less than waiting for
    the slowest lane after each.
    """

    engine: Engine
    words: Array
    first_sample: AnyInteger
    used_rows: AnyInteger


def open_stream(job: Job, *, lanes: int, rows: int, dtype) -> Stream:
    """Every lane at the beginning of its first sample. `job.used_rows` may be anything up to `rows`."""
    row = jnp.zeros(lanes, jnp.int32)
    state = _start_row(job, row, dtype)
    shapes = jax.eval_shape(job.engine.results, state)
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
    """Go on with `stream` for as many blocks as `room` holds, or until the job is done, and keep every stick.

    Returns the stream to go on with (the job is done when no row is below `job.used_rows`), the records, and the row
    that each block of records belongs to, (blocks, lanes): `job.used_rows` or more where there is nothing to be read.
    """
    blocks = len(room.ending) // BLOCK

    def goes_on(carry):
        block, stream, _, _ = carry
        return (block < blocks) & jnp.any(stream.row < job.used_rows)

    def advance(carry):
        block, stream, room, rows = carry
        rows = lax.dynamic_update_slice_in_dim(rows, stream.row[None], block, 0)
        stream, room = _advance_stream(job, stream, dtype, room, block * BLOCK)
        return block + 1, stream, room, rows

    idle = jnp.full((blocks, len(stream.row)), job.used_rows, stream.row.dtype)
    _, stream, room, rows = lax.while_loop(goes_on, advance, (jnp.int32(0), stream, room, idle))
    return stream, room, rows


def _advance_stream(job: Job, stream: Stream, dtype, room: Any = None, slot: Array | int = 0) -> tuple[Stream, Any]:
    """Take all lanes a block further; those whose sample has ended note its results and start their next."""
    state, room = job.engine.advance(stream.state, dtype, room, slot)
    ended = job.engine.ended(state) & (stream.row < job.used_rows)
    results = _note(stream.results, stream.row, ended, job.engine.results(state))
    row = stream.row + ended
    fresh = _start_row(job, row, dtype)

    def pick(new, old):
        return jnp.where(ended.reshape(ended.shape + (1,) * (new.ndim - 1)), new, old)

    return Stream(row, jax.tree.map(pick, fresh, state), results), room


def _note(results: LaneResults, row: IntArray, ended: BoolArray, new: LaneResults) -> LaneResults:
    """`results` (rows, lanes) with those of the lanes that `ended` put into their rows.

    Lanes keep abreast, so only a few rows are touched: far fewer than there are.
    """
    first = jnp.min(jnp.where(ended, row, np.int32(2**31 - 1)))
    last = jnp.max(jnp.where(ended, row, np.int32(-1)))

    def note_row(carry):
        at, results = carry

        def note(kept, new):
            old = lax.dynamic_index_in_dim(kept, at, keepdims=False)
            return lax.dynamic_update_index_in_dim(kept, jnp.where(ended & (row == at), new, old), at, 0)

        return at + 1, jax.tree.map(note, results, new)

    return lax.while_loop(lambda carry: carry[0] <= last, note_row, (first, results))[1]


def _start_row(job: Job, row: IntArray, dtype) -> Any:
    """Every lane at t = 0 of its sample in row `row` (lanes,)."""
    lanes = len(row)
    lane = jnp.arange(lanes, dtype=jnp.uint32)
    words = stored_words(job.words, job.first_sample + lane + row.astype(jnp.uint32) * np.uint32(lanes))
    return jax.vmap(lambda high, low: job.engine.begin((high, low), dtype))(*words)
