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

from .._numerics.packing import Layout, packed, unpacked
from .._numerics.random_bits import stored_words
from .._types import AnyArray, AnyInteger, Array, BoolArray, IntArray

BLOCK = 24  # intervals or steps taken at once; a lane idles for half a block on average after its sample's end


class LaneResults(NamedTuple):
    """What the statistics need of each sample, one entry a sample."""

    sticks: AnyArray
    slips: AnyArray
    stick_time: AnyArray
    status: AnyArray
    near_grazing_count: AnyArray


class Lanes(NamedTuple):
    """Lanes at work: the row of samples that each is in, (lanes,), and their states."""

    row: IntArray
    state: Any


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
        return Records(*(_with(kept, new, slot) for kept, new in zip(self, (values, ending), strict=True)))


class Blocks(NamedTuple):
    """What some blocks left, (blocks, lanes) each.

    `row`: the row of samples that the lane was in, `job.used_rows` or more where there is nothing to be read.
    `ended`: whether its sample ended with the block, and `results`: what it had come to by then.
    """

    row: AnyArray
    ended: AnyArray
    results: LaneResults


class Engine(eqx.Module):
    """How lanes move. All leaves of a state have the lanes as their first axis."""

    @abc.abstractmethod
    def begin(self, key_data: tuple[Array, Array], dtype) -> Any:
        """The state of ONE lane at t = 0 of the sample whose key has these words."""

    @abc.abstractmethod
    def advance(self, state: Any, dtype, buffer: Records | None, slot: Array | int) -> tuple[Any, Records | None]:
        """Take all lanes `BLOCK` intervals or steps further; put their sticks into `buffer` (if any) from `slot` on."""

    @abc.abstractmethod
    def ended(self, state: Any) -> BoolArray:
        """Which lanes have come to the end of their sample, for whatever reason."""

    @abc.abstractmethod
    def results(self, state: Any) -> Any:
        """The totals of all lanes: `LaneResults`, or what else the engine is for."""


class Job(NamedTuple):
    """What to simulate: samples ``first_sample .. first_sample + used_rows * lanes - 1`` of the key `key_data`.

    Lane i simulates samples ``first_sample + i + lanes * row``, one after the other, which wastes less than waiting for
    the slowest lane after each.
    """

    engine: Engine
    key_data: Array
    first_sample: AnyInteger
    used_rows: AnyInteger


def summarise(job: Job, *, lanes: int, rows: int, dtype) -> Any:
    """Simulate the whole job and keep its engine's results; arrays (rows, lanes). `job.used_rows` may be anything up to
    `rows`.

    Forward-mode differentiable; the loop has no fixed length, so reverse mode needs `simulate` under ``vmap``.
    """

    def advance(carry):
        now, results = carry
        state, _ = job.engine.advance(now.state, dtype, None, 0)
        following, ended, new = _following(job, now.row, state, dtype)
        return following, _note(results, now.row, ended, new)

    now = _at_start(job, lanes, dtype)
    shapes = jax.eval_shape(job.engine.results, now.state)
    results = jax.tree.map(lambda leaf: jnp.zeros((rows, *leaf.shape), leaf.dtype), shapes)
    return lax.while_loop(lambda carry: jnp.any(carry[0].row < job.used_rows), advance, (now, results))[1]


def open_lanes(job: Job, *, lanes: int, dtype) -> tuple[Array, ...]:
    """All lanes at the beginning of their first sample, as `record` takes them."""
    return packed(_at_start(job, lanes, dtype))


def record(
    job: tuple[Array, ...], now: tuple[Array, ...], *, layout: Layout, lanes: int, blocks: int, dtype
) -> tuple[tuple[Array, ...], Records, Blocks]:
    """Go on for so many `blocks`, or until the job is done, and keep every stick.

    Takes the job, `packed` (`layout` is its), and what `open_lanes` gave, or the call before. Returns what the next
    call takes, the records, and what is told of each block.
    """
    task = unpacked(job, layout)
    begun = unpacked(now, Layout.of(jax.eval_shape(lambda: _at_start(task, lanes, dtype))))

    def goes_on(carry):
        block, now, _, _ = carry
        return (block < blocks) & jnp.any(now.row < task.used_rows)

    def advance(carry):
        block, now, buffer, told = carry
        state, buffer = task.engine.advance(now.state, dtype, buffer, block * BLOCK)
        following, ended, results = _following(task, now.row, state, dtype)
        told = jax.tree.map(lambda kept, new: _with(kept, new, block), told, Blocks(now.row, ended, results))
        return block + 1, following, buffer, told

    def nothing(like, value=0):
        return jnp.full((blocks, *like.shape), value, like.dtype)

    results = jax.tree.map(nothing, jax.eval_shape(task.engine.results, begun.state))
    told = Blocks(nothing(begun.row, task.used_rows), jnp.zeros((blocks, lanes), bool), results)
    buffer = Records.empty(blocks * BLOCK, lanes, dtype)
    _, following, buffer, told = lax.while_loop(goes_on, advance, (jnp.int32(0), begun, buffer, told))
    return packed(following), buffer, told


def _following(job: Job, row: IntArray, state: Any, dtype) -> tuple[Lanes, BoolArray, Any]:
    """After a block: lanes whose sample has ended start their next; which these are, and the results of all."""
    ended = job.engine.ended(state) & (row < job.used_rows)
    fresh = _start_row(job, row + ended, dtype)

    def pick(new, old):
        return jnp.where(ended.reshape(ended.shape + (1,) * (new.ndim - 1)), new, old)

    return Lanes(row + ended, jax.tree.map(pick, fresh, state)), ended, job.engine.results(state)


def _with(kept: Array, new: Array, at: Array) -> Array:
    """`kept` with `new` as its entry `at`."""
    return lax.dynamic_update_slice_in_dim(kept, new[None], at, 0)


def _note(results: Any, row: IntArray, ended: BoolArray, new: Any) -> Any:
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


def _at_start(job: Job, lanes: int, dtype) -> Lanes:
    """All lanes at the beginning of their first sample."""
    row = jnp.zeros(lanes, jnp.int32)
    return Lanes(row, _start_row(job, row, dtype))


def _start_row(job: Job, row: IntArray, dtype) -> Any:
    """Every lane at t = 0 of its sample in row `row` (lanes,)."""
    lanes = len(row)
    lane = jnp.arange(lanes, dtype=jnp.uint32)
    key_data = stored_words(job.key_data, job.first_sample + lane + row.astype(jnp.uint32) * np.uint32(lanes))
    return jax.vmap(lambda high, low: job.engine.begin((high, low), dtype))(*key_data)
