"""Simulation of many samples side by side in lanes: what each engine defines for that, and the loop over lanes,
which is written once.
"""

import abc
import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ..._compiler.native import LANES, Layout, packed, unpacked
from ..._foundation import checks
from ..._foundation.processes import WIDE_BLOCKS, is_wide
from ..._foundation.types import AnyArray, AnyInteger, BoolArray, FloatArray, IntArray, Scalar, State
from ..._numerics.elementary import stored_words
from ..._systems.switched_model import Form, of_form
from ..sticks import NUMBERS, Totals

# How one trajectory among many is followed: what each engine of ensembles defines.


Shared = TypeVar("Shared")  # what all steps of all samples share
Sample = TypeVar("Sample")  # the constants of a sample
Motion = TypeVar("Motion")  # its state of motion, which every step changes
Record = TypeVar("Record")  # what a step leaves: a `StickRecord`, or an object that holds one
Results = TypeVar("Results")  # of a sample


class SampleTotals(NamedTuple):
    """What is recorded of each sample: numbers of sticks and slips, total stick time (s), `Status` code, and number of
    near-grazing instants (see `Simulation`); one entry for each sample.

    Of a system with several contacts, an engine's first three are arrays (samples, tracks).
    """

    sticks: AnyArray
    slips: AnyArray
    stick_time: AnyArray
    status: AnyArray
    near_grazing_count: AnyArray

    def of_track(self, track: int | None) -> "SampleTotals":
        """Those of one track; all of them where there is one contact."""
        if track is None:
            return self
        sticks, slips, stick_time = (column[:, track] for column in (self.sticks, self.slips, self.stick_time))
        return SampleTotals(sticks, slips, stick_time, self.status, self.near_grazing_count)


class End(NamedTuple):
    """Where a sample ended: the sums over its sticks, of what is counted; the time, s; and the numbers of its state."""

    totals: Totals
    time: FloatArray
    state: State


class Engine(eqx.Module, Generic[Shared, Sample, Motion, Record, Results]):
    """How one lane is simulated step by step; a step is a time step, or a whole interval of the base."""

    looks_back: ClassVar[bool] = False
    """Whether `after_block` reads the records of the block."""

    @property
    def tracks(self) -> int | None:
        """Of a system with several contacts, how many of its results and records are of something that sticks: each
        contact, and all at once. None for one contact.
        """
        return None

    @property
    def compiles_natively(self) -> bool:
        """Whether its steps can be compiled into native loops."""
        return True

    @property
    def lanes(self) -> int:
        """How many lanes move in lock step on a CPU: the arrays of so many stay in the cache (benchmarks/README.md)."""
        return LANES

    @property
    def knows_extremes(self) -> bool:
        """Whether `watched` follows extremes as exactly as the path of one trajectory does."""
        return True

    def asked(self, quantities: tuple[str, ...]) -> "Engine":
        """The same engine, whose records hold these `quantities` of each stick; without them it computes none."""
        return dataclasses.replace(self, quantities=quantities)

    @abc.abstractmethod
    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Sample, Motion]:
        """The constants of the sample that `key_data` choose, and its motion at t = 0."""

    def columns(self, varying: tuple[AnyArray, ...]) -> tuple[AnyArray, ...]:
        """The varying leaves of all samples, from what `Job.varying` holds of them."""
        return varying

    def begin_varying(self, key_data: tuple[Array, Array], varying: tuple[Array, ...], dtype) -> tuple[Sample, Motion]:
        """As `begin`, for the sample with these `varying` leaves; none where samples differ in their key data only."""
        return self.begin(key_data, dtype)

    @abc.abstractmethod
    def shared(self, dtype) -> Shared:
        """Quantities that all steps of all samples share, computed once per block."""

    def draw(self, sample: Sample, number: Array, dtype) -> Any:
        """The random (or looked-up) numbers of step `number`; drawn for a whole block at once."""
        return None

    @abc.abstractmethod
    def step(self, shared: Shared, sample: Sample, motion: Motion, drawn: Any) -> tuple[Motion, Record]:
        """Take one step: returns the motion after it and its record."""

    @property
    def knows_observed(self) -> bool:
        """Whether `watched` follows what is observed beside the state, and what adds up."""
        return False

    @property
    def decay_in_step(self) -> Scalar:
        """By how many time constants the fastest motion may die out within a step."""
        return 0.0

    def no_sums(self, dtype) -> "Sums":
        """What adds up, before the first step."""
        raise NotImplementedError("of engines that do not know them")

    def watched(
        self, shared: Shared, sample: Sample, motion: Motion, drawn: Any, asked: "Asked"
    ) -> tuple[Motion, Record, FloatArray, "Work | None"]:
        """A `step`; the largest of each of the forms that are asked for in it, and minus the smallest, (2, forms), of
        those of the state but for the values at its end; and what adds up in it.
        """
        raise NotImplementedError("of engines of sensitivities")

    def end(self, sample: Sample, motion: Motion) -> End:
        """Where the sample has ended."""
        raise NotImplementedError("of engines of sensitivities")

    def after_block(self, samples: Sample, motions: Motion, records: Record) -> Motion:
        """The motions of ALL lanes, corrected after a block with these records, (BLOCK, lanes)."""
        return motions

    @abc.abstractmethod
    def ended(self, motion: Motion, before: Motion) -> BoolArray:
        """Whether the sample has ended, for whatever reason; `before`: its motion a block ago."""

    @abc.abstractmethod
    def results(self, sample: Sample, motion: Motion) -> Results:
        """The results of one sample."""


class _AroundEngine(Engine):
    """An engine that does something beside what another one, its `template`, does."""

    template: eqx.AbstractVar[Any]

    @property
    def tracks(self) -> int | None:
        return self.template.tracks

    @property
    def compiles_natively(self) -> bool:
        return self.template.compiles_natively

    @property
    def lanes(self) -> int:
        return self.template.lanes

    def asked(self, quantities: tuple[str, ...]) -> "Engine":
        return dataclasses.replace(self, template=self.template.asked(quantities))


# Lanes that also know where each sample ended, and the extremes on its way: outputs of a user's own are made of these.


SIGNS = (1, -1)


def values_of_forms(forms: tuple[Form, ...], numbers: State) -> FloatArray:
    """The values of the `forms`, (forms,)."""
    return jnp.stack([of_form(form, numbers) for form in forms]) if forms else jnp.zeros_like(numbers[0], shape=(0,))


class Asked(eqx.Module):
    """What is asked for of the way of a sample: the extremes of `forms` of the state, and of those with what is
    `observed` beside it; and `sums`, whether what adds up. `halves`: how often a step is halved for that, see
    `halves_for`.
    """

    forms: tuple[Form, ...] = eqx.field(static=True, default=())
    observed: tuple[Form, ...] = eqx.field(static=True, default=())
    sums: bool = eqx.field(static=True, default=False)
    halves: int = eqx.field(static=True, default=0)

    @property
    def every(self) -> tuple[Form, ...]:
        """All forms, in the order of `WatchedTotals.extremes`."""
        return self.forms + self.observed


class Work(NamedTuple):
    """What adds up in one step: of each contact the slip path, m, and its way, the sign of the slip or 0; what base and
    load supply, and what friction and damping dissipate, J.
    """

    slip_path: FloatArray
    way: FloatArray
    supplied: FloatArray
    friction: FloatArray
    damping: FloatArray


class Sums(NamedTuple):
    """What adds up, as in `Work`; `way`: of the last slip of each contact; `reversals`: slips the other way than the
    slip before.
    """

    slip_path: FloatArray
    way: FloatArray
    supplied: FloatArray
    friction: FloatArray
    damping: FloatArray
    reversals: AnyArray

    @classmethod
    def zero(cls, contacts: int | None, dtype) -> "Sums":
        """Before the first step."""
        each, none = jnp.zeros(() if contacts is None else (contacts,), dtype), jnp.zeros((), dtype)
        return cls(each, each, none, none, none, each.astype(jnp.int32))

    def with_work(self, work: Work) -> "Sums":
        """After a step."""
        turned = self.way * work.way < 0
        return Sums(
            self.slip_path + work.slip_path,
            jnp.where(work.way != 0, work.way, self.way),
            self.supplied + work.supplied,
            self.friction + work.friction,
            self.damping + work.damping,
            self.reversals + turned,
        )


class WatchedTotals(NamedTuple):
    """What is recorded of each sample, and where it ended; `extremes`: of each form that was asked for the largest
    value, and minus the smallest one, (2, forms); and what added up, if that was.
    """

    totals: SampleTotals
    end: End
    extremes: AnyArray
    sums: Sums | None


class _Watched(NamedTuple):
    """The motion of an engine, and the extremes and sums so far."""

    motion: Any
    extremes: FloatArray
    sums: Sums | None


class WatchedEngine(_AroundEngine):
    """The `template`, which also keeps what is `asked` of the way of each sample, and its end."""

    template: Any
    asked_for: Asked

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Any, _Watched]:
        sample, motion = self.template.begin(key_data, dtype)
        sums = self.template.no_sums(dtype) if self.asked_for.sums else None
        return sample, _Watched(motion, jnp.full((len(SIGNS), len(self.asked_for.every)), -jnp.inf, dtype), sums)

    def shared(self, dtype) -> Any:
        return self.template.shared(dtype)

    def draw(self, sample: Any, number: Array, dtype) -> Any:
        return self.template.draw(sample, number, dtype)

    def step(self, shared: Any, sample: Any, motion: _Watched, drawn: Any) -> tuple[_Watched, Any]:
        if not (motion.extremes.size or self.asked_for.sums):
            moved, record = self.template.step(shared, sample, motion.motion, drawn)
            return motion._replace(motion=moved), record
        moved, record, found, work = self.template.watched(shared, sample, motion.motion, drawn, self.asked_for)
        sums = None if motion.sums is None else motion.sums.with_work(work)
        return _Watched(moved, jnp.maximum(motion.extremes, found), sums), record

    def ended(self, motion: _Watched, before: _Watched) -> BoolArray:
        return self.template.ended(motion.motion, before.motion)

    def results(self, sample: Any, motion: _Watched) -> WatchedTotals:
        end, forms = self.template.end(sample, motion.motion), self.asked_for.forms
        at_end = np.array(SIGNS)[:, None] * values_of_forms(forms, end.state)[None]
        extremes = motion.extremes.at[:, : len(forms)].max(at_end)
        return WatchedTotals(self.template.results(sample, motion.motion), end, extremes, motion.sums)


# Lanes whose system, excitation or start differ from sample to sample.


class _Common(eqx.Module):
    """What the steps of the template share, and which of its leaves differ from sample to sample."""

    shared: Any
    leaf_numbers: tuple[int, ...] = eqx.field(static=True)


class VaryingEngine(_AroundEngine):
    """An engine with numbers of its own for every sample.

    `template`: the engine of any sample. `leaf_numbers`: which of its leaves vary, in the order of ``jax.tree.leaves``.
    """

    template: Any
    leaf_numbers: tuple[int, ...] = eqx.field(static=True)

    @property
    def looks_back(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """That of the template."""
        return self.template.looks_back

    def of_sample(self, varying: tuple[Array, ...]) -> Any:
        """The engine of the sample with its `varying` leaves."""
        return with_leaves(self.template, self.leaf_numbers, varying)

    def begin(self, key_data: Any, dtype) -> tuple[Any, Any]:
        leaves = jax.tree.leaves(self.template)
        return self.begin_varying(key_data, tuple(leaves[place] for place in self.leaf_numbers), dtype)

    def begin_varying(self, key_data: Any, varying: tuple[Array, ...], dtype) -> tuple[Any, Any]:
        """As `begin`, for the sample with its `varying` leaves.

        Its constants are these, what its steps share unlike those of other samples, and the template's constants.
        """
        engine = self.of_sample(varying)
        sample, motion = engine.begin(key_data, dtype)
        leaves = jax.tree.leaves(engine.shared(dtype))
        return (varying, tuple(leaves[place] for place in self._shared_leaf_numbers(dtype)), sample), motion

    def constants(self, sample: Any) -> Any:
        """The constants of samples as the template knows them."""
        return sample[2]

    def shared(self, dtype) -> _Common:
        return _Common(self.template.shared(dtype), self._shared_leaf_numbers(dtype))

    def _shared_leaf_numbers(self, dtype) -> tuple[int, ...]:
        """Which leaves of what the steps share follow from `varying` leaves.

        The others are not carried from lane to lane: a record of a base motion has thousands of points.
        """
        leaves = jax.tree.leaves(self.template)
        varying = tuple(jnp.asarray(leaves[place])[None] for place in self.leaf_numbers)

        def differs(place: int) -> bool:
            def leaf(varying):
                return jax.tree.leaves(self.of_sample(varying).shared(dtype))[place]

            try:
                jax.eval_shape(jax.vmap(leaf, out_axes=None), varying)
            except ValueError:  # the leaf is mapped
                return True
            return False

        return tuple(filter(differs, range(len(jax.tree.leaves(self.template.shared(dtype))))))

    def draw(self, sample: Any, number: Array, dtype) -> Any:
        varying, _, constants = sample
        return self.of_sample(varying).draw(constants, number, dtype)

    def step(self, shared: _Common, sample: Any, motion: Any, drawn: Any) -> tuple[Any, Any]:
        varying, mine, constants = sample
        here = with_leaves(shared.shared, shared.leaf_numbers, mine)
        return self.of_sample(varying).step(here, constants, motion, drawn)

    def ended(self, motion: Any, before: Any) -> BoolArray:
        return self.template.ended(motion, before)  # asks for the horizon only, which is the same for all samples

    def results(self, sample: Any, motion: Any) -> Any:
        varying, _, constants = sample
        return self.of_sample(varying).results(constants, motion)


def with_leaves(tree: Any, leaf_numbers: tuple[int, ...], values: Any) -> Any:
    """`tree` with the leaves at `leaf_numbers` replaced by `values`."""
    leaves, structure = jax.tree.flatten(tree)
    for place, value in zip(leaf_numbers, values, strict=True):
        leaves[place] = value
    return jax.tree.unflatten(structure, leaves)


class Engines(NamedTuple):
    """Engines of many samples.

    - `template`: one of them; where they differ, with the leaves of the first. Sizes, such as numbers of steps, are the
      largest that any sample needs.
    - `leaf_numbers`: which leaves vary; `varying`: these, arrays (samples, ...).
    - `origins`: for each place, which of the values it is; None where it follows from them.
    """

    template: Any
    leaf_numbers: tuple[int, ...]
    varying: tuple[AnyArray, ...]
    origins: tuple[int | None, ...]


def engines_of(build: Callable[..., Any], values: tuple[AnyArray, ...], others: Any = None) -> Engines:
    """The engines that `build` makes of each entry of `values` and `others`, arrays (samples, ...)."""
    made, origins = [], []

    def leaves_that_differ(values, others):
        engine = build(values, others)
        varying = [leaf for leaf in jax.tree.leaves(engine) if checks.is_traced(leaf)]
        made.append(engine)
        origins.extend(next((i for i, value in enumerate(values) if value is leaf), None) for leaf in varying)
        return varying

    varying = jax.vmap(leaves_that_differ)(values, others)
    leaves, structure = jax.tree.flatten(made[0])
    leaf_numbers = tuple(place for place, leaf in enumerate(leaves) if checks.is_traced(leaf))
    for place, column in zip(leaf_numbers, varying, strict=True):
        leaves[place] = column[0]
    return Engines(jax.tree.unflatten(structure, leaves), leaf_numbers, tuple(varying), tuple(origins))


def widest(templates: list[Any], leaf_numbers: tuple[int, ...]) -> Any:
    """The first template, with sizes (whole numbers that all samples share) as large as in any other."""
    leaves, structure = jax.tree.flatten(templates[0])
    for other in templates[1:]:
        for place, leaf in enumerate(jax.tree.leaves(other)):
            if place not in leaf_numbers and isinstance(leaf, (int, np.integer)):
                leaves[place] = np.maximum(leaves[place], leaf)
    return jax.tree.unflatten(structure, leaves)


# Simulation of many samples side by side in lanes, one block of steps at a time.
#
# A lane simulates one sample after the other: when a sample has ended, it starts its next one after the block. The
# excitation of a sample is drawn while simulating, so no realisation is ever too short and none is stored. `summarize`
# keeps totals; `record` returns every stick, a few blocks at a time. An `Engine` defines how ONE lane begins, takes a
# step and ends; everything about many lanes is here.


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

    def with_slot(self, slot: Array | int, sticks: Any) -> "Records":
        """A copy in which slot `slot` holds `sticks`: values (columns, lanes) and endings (lanes,); or with a further
        axis, of the tracks.
        """
        return Records(
            *(_with(kept, new.reshape(kept.shape[1:]), slot) for kept, new in zip(self, sticks, strict=True))
        )


class Opened(NamedTuple):
    """A job to be recorded, and its lanes at the beginning, each `packed`; and room for its results, (rows, lanes)."""

    job: tuple[Array, ...]
    now: tuple[Array, ...]
    results: Any


class Recorded(NamedTuple):
    """What some blocks have brought.

    - `now`: the lanes, packed. `results`: those of all samples that have ended so far.
    - `records`: the sticks. `whose`: (blocks, lanes), the sample in which each lane was, counted from the first of the
      job; of several contacts its tracks, as if each were a sample. `goes_on`: whether a sample has not ended.
    """

    now: tuple[Array, ...]
    results: Any
    records: Records
    whose: IntArray
    goes_on: BoolArray


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


def lane_size(job: Job, dtype, *, rows: int, is_recorded: bool) -> int:
    """About how many bytes a lane of the job takes: what it carries from step to step, as that is read, written and
    begun anew; the numbers that it draws in a block; its results in `rows`; and the records of a block.
    """
    now = jax.eval_shape(partial(lanes_at_start, job, 1, dtype))
    drawn = jax.eval_shape(
        jax.vmap(lambda sample, number: job.engine.draw(sample, number, dtype)), now.sample, now.number
    )
    results = jax.eval_shape(partial(_results, job.engine), now)
    of_block = (len(NUMBERS) * jnp.dtype(dtype).itemsize + 1) * (job.engine.tracks or 1) if is_recorded else 0
    if is_wide():  # records of two calls, and what finds the sticks among them
        of_block *= 3 * WIDE_BLOCKS
    carried, each, noted = (
        sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(part)) for part in (now, drawn, results)
    )
    return 4 * carried + BLOCK * (each + of_block) + rows * noted


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
    results = _no_results(job, now, rows)
    return lax.while_loop(lambda carry: jnp.any(carry[0].row < job.used_rows), advance, (now, results))[1]


def open_lanes(job: Job, *, lanes: int, rows: int, dtype) -> Opened:
    """All lanes at the beginning of their first sample; `job.used_rows` is at most `rows`."""
    now = lanes_at_start(job, lanes, dtype)
    return Opened(packed(job), packed(now), _no_results(job, now, rows))


def record(
    job: tuple[Array, ...], now: tuple[Array, ...], results: Any, *, layout: Layout, lanes: int, blocks: int, dtype
) -> Recorded:
    """Simulate the next `blocks` blocks, or fewer if the job is done before, and record every stick.

    Takes the job with its `layout`, and the lanes and results, as `open_lanes` or the previous call returned them.
    """
    task = unpacked(job, layout)
    start = partial(lanes_at_start, task, lanes, dtype)
    begun = unpacked(now, Layout.of(jax.eval_shape(start)))
    tracks = task.engine.tracks or 1

    def unfinished(now):
        return jnp.any(now.row < task.used_rows)

    def advance(carry):
        block, now, results, records, whose = carry
        after, records = follow_block(task.engine, now, dtype, records, block * BLOCK)
        following, ended, new = _following(task, now, after, dtype)
        sample = (now.row * lanes + jnp.arange(lanes, dtype=jnp.int32))[:, None]
        own = (sample * tracks + jnp.arange(tracks, dtype=jnp.int32)[None]).reshape(-1)
        return block + 1, following, _note(results, now.row, ended, new), records, _with(whose, own, block)

    slots, columns = blocks * BLOCK, lanes * tracks
    records = Records(jnp.zeros((slots, len(NUMBERS), columns), dtype), jnp.full((slots, columns), -1, jnp.int8))
    # Blocks that are not needed hold no stick, of whichever sample.
    carry = jnp.int32(0), begun, results, records, jnp.full((blocks, columns), 2**31 - 1, jnp.int32)
    carry = lax.while_loop(lambda carry: (carry[0] < blocks) & unfinished(carry[1]), advance, carry)
    _, following, results, records, whose = carry
    return Recorded(packed(following), results, records, whose, unfinished(following))


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


def _no_results(job: Job, now: Lanes, rows: int) -> Any:
    shapes = jax.eval_shape(partial(_results, job.engine), now)
    return jax.tree.map(lambda leaf: jnp.zeros((rows, *leaf.shape), leaf.dtype), shapes)


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
