"""Simulation of many samples side by side in lanes, one block of steps at a time.

A lane simulates one sample after the other: when a sample has ended, it starts its next one after the block. The
excitation of a sample is drawn while simulating, so no realisation is ever too short and none is stored. `summarize`
keeps totals; `record` returns every stick, a few blocks at a time. An `Engine` defines how ONE lane begins, takes a
step and ends; everything about many lanes is here.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..._compiler import Layout, packed, unpacked
from ..._events.sticks import NUMBERS
from ..._numerics.random_bits import stored_words
from ..._types import AnyArray, AnyInteger, Array, BoolArray, IntArray
from .engine import Engine, SampleTotals

BLOCK = 24  # intervals or steps in a block; after the end of a sample a lane idles for half a block on average


class Lanes(NamedTuple):
    """The state of all lanes; the first axis of each leaf is the lanes.

    - `row`: the row of samples that the lane simulates (see `Job`). `number`: steps taken in its sample.
    - `sample`: constants of the sample. `motion`: its state of motion, which every step changes.
    """

    row: IntArray
    number: Array
    sample: Any
    motion: Any


class Records(NamedTuple):
    """The sticks of some blocks, one slot for each interval or step.

    Of several contacts, the tracks of a lane stand one after the other, as if they were lanes.

    Times and positions share one array: XLA updates a single large array of a shape in place, but copies several.
    """

    values: Array  # (slots, columns, lanes): the `NUMBERS` of sticks
    ending: Array  # (slots, lanes): an `Ending` code, or -1 where there is no stick

    @classmethod
    def empty(cls, slots: int, lanes: int, dtype) -> "Records":
        """Slots without sticks."""
        return cls(jnp.zeros((slots, len(NUMBERS), lanes), dtype), jnp.full((slots, lanes), -1, jnp.int8))

    def with_slot(self, slot: Array | int, sticks: Any) -> "Records":
        """A copy in which slot `slot` holds `sticks`: values (columns, lanes) and endings (lanes,); or with a further
        axis, of the tracks.
        """
        return Records(
            *(_with(kept, new.reshape(kept.shape[1:]), slot) for kept, new in zip(self, sticks, strict=True))
        )


class Blocks(NamedTuple):
    """A report of some blocks, arrays (blocks, lanes).

    - `row`: the row of samples that the lane was in; `job.used_rows` or more where the lane had no sample left.
    - `ended`: whether its sample ended in the block. `results`: the results of the sample up to the end of the block.
    """

    row: AnyArray
    ended: AnyArray
    results: SampleTotals


class Job(NamedTuple):
    """Samples to simulate: ``first_sample .. first_sample + used_rows * lanes - 1`` of the key `key_data`.

    Lane i simulates samples ``first_sample + i + lanes * row``, one after the other; no lane waits for the slowest one
    after each row. `varying`: of an engine whose samples differ, the leaves of each, arrays (samples, ...).
    `realization`: (samples,), the numbers that the samples draw their excitation by; None for their own.
    """

    engine: Engine
    key_data: Array
    first_sample: AnyInteger
    used_rows: AnyInteger
    varying: tuple[AnyArray, ...] = ()
    realization: AnyArray | None = None

    def with_columns(self) -> "Job":
        """The same job; what its samples draw is drawn once, before the first of them begins."""
        return self._replace(varying=self.engine.columns(self.varying))


def summarize(job: Job, *, lanes: int, rows: int, dtype) -> Any:
    """Simulate the whole job; returns the engine's results, arrays (rows, lanes). `job.used_rows` is at most `rows`.

    Forward-mode differentiable only, because the loop has no fixed length; for reverse mode use `simulate` under
    ``vmap``.
    """

    def advance(carry):
        now, results = carry
        after, _ = follow_block(job.engine, now, dtype)
        following, ended, new = _following(job, now, after, dtype)
        return following, _note(results, now.row, ended, new)

    job = job.with_columns()
    now = lanes_at_start(job, lanes, dtype)
    shapes = jax.eval_shape(partial(_results, job.engine), now)
    results = jax.tree.map(lambda leaf: jnp.zeros((rows, *leaf.shape), leaf.dtype), shapes)
    return lax.while_loop(lambda carry: jnp.any(carry[0].row < job.used_rows), advance, (now, results))[1]


def open_lanes(job: Job, *, lanes: int, dtype) -> tuple[Array, ...]:
    """All lanes at the beginning of their first sample, `packed` as `record` takes them."""
    return packed(lanes_at_start(job, lanes, dtype))


def record(
    job: tuple[Array, ...], now: tuple[Array, ...], *, layout: Layout, lanes: int, blocks: int, dtype
) -> tuple[tuple[Array, ...], Records, Blocks]:
    """Simulate the next `blocks` blocks, or fewer if the job is done before, and record every stick.

    Takes the `packed` job with its `layout`, and the lanes that `open_lanes` or the previous call returned. Returns the
    lanes for the next call, the records, and a report of each block.
    """
    task = unpacked(job, layout)
    start = partial(lanes_at_start, task, lanes, dtype)
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
    records = Records.empty(blocks * BLOCK, lanes * (task.engine.tracks or 1), dtype)
    _, following, records, reports = lax.while_loop(goes_on, advance, (jnp.int32(0), begun, records, reports))
    return packed(following), records, reports


def follow_block(
    engine: Engine, lanes: Lanes, dtype, into: Records | None = None, slot: Array | int = 0, *, stacked: bool = False
) -> tuple[Lanes, Any]:
    """Advance all lanes by `BLOCK` steps.

    Returns the lanes and the records: those `into` which the block was written from slot `slot` on; with `stacked`, the
    engine's own, (BLOCK, lanes); else None.
    """
    stacks, shared = stacked or engine.looks_back, engine.shared(dtype)
    numbers = lanes.number[None] + jnp.arange(BLOCK, dtype=jnp.uint32)[:, None]
    draw = jax.vmap(lambda sample, number: engine.draw(sample, number, dtype))
    drawn = jax.vmap(draw, in_axes=(None, 0))(lanes.sample, numbers)

    def step_one(sample, motion, drawn):
        motion, record = engine.step(shared, sample, motion, drawn)
        if into is None:
            return motion, record if stacks else None
        return motion, (jnp.stack(list(record.columns.values())), record.ending)

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


def lanes_at_start(job: Job, lanes: int, dtype) -> Lanes:
    """All lanes at the beginning of their first sample."""
    return _start_row(job, jnp.zeros(lanes, jnp.int32), dtype)


def _start_row(job: Job, row: IntArray, dtype) -> Lanes:
    """Every lane at t = 0 of its sample in row `row`, (lanes,)."""
    engine, lanes = job.engine, len(row)
    lane = jnp.arange(lanes, dtype=jnp.uint32)
    place = lane + row.astype(jnp.uint32) * np.uint32(lanes)
    number = job.first_sample + place
    if job.realization is not None:
        number = jnp.asarray(job.realization)[jnp.minimum(place, len(job.realization) - 1)]
    words = stored_words(job.key_data, number)
    varying = tuple(jnp.asarray(column)[jnp.minimum(place, len(column) - 1)] for column in job.varying)
    sample, motion = jax.vmap(lambda high, low, varying: engine.begin_varying((high, low), varying, dtype))(
        *words, varying
    )
    return Lanes(row, jnp.zeros(lanes, jnp.uint32), sample, motion)


def _following(job: Job, before: Lanes, after: Lanes, dtype) -> tuple[Lanes, BoolArray, Any]:
    """The lanes after a block, ended samples replaced by the next; which had ended, and the results of all lanes."""
    ended = jax.vmap(job.engine.ended)(after.motion, before.motion) & (before.row < job.used_rows)
    fresh = _start_row(job, before.row + ended, dtype)

    def pick(new, old):
        return jnp.where(ended.reshape(ended.shape + (1,) * (new.ndim - 1)), new, old)

    following = jax.tree.map(pick, fresh, after)._replace(row=before.row + ended)
    return following, ended, _results(job.engine, after)


def _results(engine: Engine, lanes: Lanes) -> Any:
    return jax.vmap(engine.results)(lanes.sample, lanes.motion)


def _with(kept: Array, new: Array, at: Array | int) -> Array:
    """A copy of `kept` whose entry `at` is `new`."""
    return lax.dynamic_update_slice_in_dim(kept, new[None], at, 0)


def _note(results: Any, row: IntArray, ended: BoolArray, new: Any) -> Any:
    """`results` (rows, lanes) in which the lanes that `ended` have their new results, in their rows.

    The lanes are at most a few rows apart, so that few of the rows are rewritten.
    """
    first = jnp.min(jnp.where(ended, row, np.int32(2**31 - 1)))
    last = jnp.max(jnp.where(ended, row, np.int32(-1)))

    def note_row(carry):
        at, results = carry

        def note(kept, new):
            old = lax.dynamic_index_in_dim(kept, at, keepdims=False)
            here = (ended & (row == at)).reshape(ended.shape + (1,) * (new.ndim - 1))
            return lax.dynamic_update_index_in_dim(kept, jnp.where(here, new, old), at, 0)

        return at + 1, jax.tree.map(note, results, new)

    return lax.while_loop(lambda carry: carry[0] <= last, note_row, (first, results))[1]
