"""Many trajectories in lock step: take every lane a block further, see which have ended, go on.

A lane starts its next sample as soon as one has ended. The excitation of a sample is drawn while simulating, so no
realisation is ever too short and none is stored. `summarise` keeps totals; `record` returns every stick, a few blocks
at a time. An `Engine` says how ONE lane begins, takes a step and ends; everything about many lanes is here.
"""

import abc
from functools import partial
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._events.sticks import NUMBERS
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
    """Lanes at work, each leaf with the lanes as its first axis.

    `row`: the row of samples that the lane is in. `number`: how many steps its sample has taken. `sample`: what stays
    as it is from the beginning of the sample to its end. `motion`: what moves.
    """

    row: IntArray
    number: Array
    sample: Any
    motion: Any


class Records(NamedTuple):
    """The sticks of some blocks, one slot an interval or step.

    Times and positions share one array: XLA updates a single large array of a shape in place, but copies several.
    """

    values: Array  # (slots, columns, lanes): the `NUMBERS` of sticks
    ending: Array  # (slots, lanes): an `Ending` code, or -1 where there is no stick

    @classmethod
    def empty(cls, slots: int, lanes: int, dtype) -> "Records":
        """Slots without sticks."""
        return cls(jnp.zeros((slots, len(NUMBERS), lanes), dtype), jnp.full((slots, lanes), -1, jnp.int8))

    def with_slot(self, slot: Array | int, sticks: Any) -> "Records":
        """The same with the values (columns, lanes) and endings (lanes,) of one slot's sticks put in."""
        return Records(*(_with(kept, new, slot) for kept, new in zip(self, sticks, strict=True)))


class Blocks(NamedTuple):
    """What some blocks left, (blocks, lanes) each.

    `row`: the row of samples that the lane was in, `job.used_rows` or more where there is nothing to be read.
    `ended`: whether its sample ended with the block, and `results`: its results up to then.
    """

    row: AnyArray
    ended: AnyArray
    results: LaneResults


class Engine(eqx.Module):
    """How one lane moves, step by step; a step is a time step, or a whole interval of the base."""

    looks_back: ClassVar[bool] = False
    """Whether `after_block` needs the records of the block."""

    @abc.abstractmethod
    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Any, Any]:
        """What stays as it is throughout the sample that `key_data` choose, and its motion at t = 0."""

    @abc.abstractmethod
    def shared(self, dtype) -> Any:
        """What all steps of all samples need, computed once a block."""

    def draw(self, sample: Any, number: Array, dtype) -> Any:
        """What is random (or looked up) in step `number`, drawn for a whole block at once."""
        return None

    @abc.abstractmethod
    def step(self, shared: Any, sample: Any, motion: Any, drawn: Any) -> tuple[Any, Any]:
        """Take one step: the motion after it, and what is recorded of it, a `StickRecord` or what holds one."""

    def after_block(self, samples: Any, motions: Any, records: Any) -> Any:
        """The motions of ALL lanes after a block that left these records, (BLOCK, lanes)."""
        return motions

    @abc.abstractmethod
    def ended(self, motion: Any, before: Any) -> BoolArray:
        """Whether the sample has come to its end, for whatever reason; `before`: its motion a block ago."""

    @abc.abstractmethod
    def results(self, sample: Any, motion: Any) -> Any:
        """What one sample has come to: `LaneResults`, or what else the engine is for."""


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
        after, _ = follow_block(job.engine, now, dtype)
        following, ended, new = _following(job, now, after, dtype)
        return following, _note(results, now.row, ended, new)

    now = lanes_at_start(job.engine, job.key_data, job.first_sample, lanes, dtype)
    shapes = jax.eval_shape(partial(_results, job.engine), now)
    results = jax.tree.map(lambda leaf: jnp.zeros((rows, *leaf.shape), leaf.dtype), shapes)
    return lax.while_loop(lambda carry: jnp.any(carry[0].row < job.used_rows), advance, (now, results))[1]


def open_lanes(job: Job, *, lanes: int, dtype) -> tuple[Array, ...]:
    """All lanes at the beginning of their first sample, as `record` takes them."""
    return packed(lanes_at_start(job.engine, job.key_data, job.first_sample, lanes, dtype))


def record(
    job: tuple[Array, ...], now: tuple[Array, ...], *, layout: Layout, lanes: int, blocks: int, dtype
) -> tuple[tuple[Array, ...], Records, Blocks]:
    """Go on for so many `blocks`, or until the job is done, and keep every stick.

    Takes the job, `packed` (`layout` is its), and the lanes that `open_lanes` or the call before returned. Returns the
    lanes for the next call, the records, and a report of each block.
    """
    task = unpacked(job, layout)
    start = partial(lanes_at_start, task.engine, task.key_data, task.first_sample, lanes, dtype)
    begun = unpacked(now, Layout.of(jax.eval_shape(start)))

    def goes_on(carry):
        block, now, _, _ = carry
        return (block < blocks) & jnp.any(now.row < task.used_rows)

    def advance(carry):
        block, now, records, reports = carry
        after, records = follow_block(task.engine, now, dtype, records, block * BLOCK)
        following, ended, results = _following(task, now, after, dtype)
        report = Blocks(now.row, ended, results)
        return block + 1, following, records, jax.tree.map(lambda kept, new: _with(kept, new, block), reports, report)

    def nothing(like, value=0):
        return jnp.full((blocks, *like.shape), value, like.dtype)

    results = jax.tree.map(nothing, jax.eval_shape(partial(_results, task.engine), begun))
    reports = Blocks(nothing(begun.row, task.used_rows), jnp.zeros((blocks, lanes), bool), results)
    records = Records.empty(blocks * BLOCK, lanes, dtype)
    _, following, records, reports = lax.while_loop(goes_on, advance, (jnp.int32(0), begun, records, reports))
    return packed(following), records, reports


def follow_block(
    engine: Engine, lanes: Lanes, dtype, into: Records | None = None, slot: Array | int = 0, *, stacked: bool = False
) -> tuple[Lanes, Any]:
    """Take all lanes `BLOCK` steps further.

    Returns them, and the records: put `into` given ones from `slot` on; or where they are to be `stacked`, as the
    engine leaves them, (BLOCK, lanes); else None.
    """
    stacks, shared = stacked or engine.looks_back, engine.shared(dtype)
    numbers = lanes.number[None] + jnp.arange(BLOCK, dtype=jnp.uint32)[:, None]
    draw = jax.vmap(lambda sample, number: engine.draw(sample, number, dtype))
    drawn = jax.vmap(draw, in_axes=(None, 0))(lanes.sample, numbers)

    def step_one(sample, motion, drawn):
        motion, record = engine.step(shared, sample, motion, drawn)
        if into is None:
            return motion, record if stacks else None
        return motion, (jnp.stack(record.numbers), record.ending)

    def step(carry, drawn):
        motions, records, slot = carry
        axes = (0, 0 if into is None else (1, 0))
        motions, new = jax.vmap(step_one, out_axes=axes)(lanes.sample, motions, drawn)
        if records is None:
            return (motions, None, slot), new
        return (motions, records.with_slot(slot, new), slot + 1), None

    (motions, records, _), traces = lax.scan(step, (lanes.motion, into, slot), drawn, length=BLOCK)
    motions = engine.after_block(lanes.sample, motions, traces)
    return lanes._replace(number=lanes.number + np.uint32(BLOCK), motion=motions), traces if stacked else records


def lanes_at_start(engine: Engine, key_data: Any, first_sample: AnyInteger, lanes: int, dtype) -> Lanes:
    """All lanes at the beginning of their first sample."""
    return _start_row(engine, key_data, first_sample, jnp.zeros(lanes, jnp.int32), dtype)


def _start_row(engine: Engine, key_data: Any, first_sample: AnyInteger, row: IntArray, dtype) -> Lanes:
    """Every lane at t = 0 of its sample in row `row` (lanes,)."""
    lanes = len(row)
    lane = jnp.arange(lanes, dtype=jnp.uint32)
    own = stored_words(key_data, first_sample + lane + row.astype(jnp.uint32) * np.uint32(lanes))
    sample, motion = jax.vmap(lambda high, low: engine.begin((high, low), dtype))(*own)
    return Lanes(row, jnp.zeros(lanes, jnp.uint32), sample, motion)


def _following(job: Job, before: Lanes, after: Lanes, dtype) -> tuple[Lanes, BoolArray, Any]:
    """After a block: lanes whose sample has ended start their next; which these are, and the results of all."""
    ended = jax.vmap(job.engine.ended)(after.motion, before.motion) & (before.row < job.used_rows)
    fresh = _start_row(job.engine, job.key_data, job.first_sample, before.row + ended, dtype)

    def pick(new, old):
        return jnp.where(ended.reshape(ended.shape + (1,) * (new.ndim - 1)), new, old)

    following = jax.tree.map(pick, fresh, after)._replace(row=before.row + ended)
    return following, ended, _results(job.engine, after)


def _results(engine: Engine, lanes: Lanes) -> Any:
    return jax.vmap(engine.results)(lanes.sample, lanes.motion)


def _with(kept: Array, new: Array, at: Array | int) -> Array:
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
