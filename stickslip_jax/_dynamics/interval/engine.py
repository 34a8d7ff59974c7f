"""The interval engine: lanes in which a step is a whole interval of the base, motion over given intervals, and one
trajectory with its states.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array

from ..._compiler.native import LANES, block_width, computed_once, in_blocks, native_loop, native_loops_work
from ..._compiler.programs import kept_jit
from ..._excitation.motion import Signal
from ..._excitation.piecewise_constant import PiecewiseConstantLaw, VelocitySteps
from ..._excitation.segments import Segment, marked
from ..._foundation.types import BoolArray, FloatArray, IntArray, Number, Scalar
from ..._systems.mass_spring import MassSpring
from ..._systems.switched_model import Form, Segments, State
from ..common.lanes import SIGNS, Asked, End, Engine, SampleTotals
from ..common.path import MotionPath, Run, sample_totals
from ..sticks import ALL, QUANTITIES, StickRecord, Totals, closed_up, start_totals, sticks_of
from .arcs import (
    LAST_LEFT,
    MassState,
    Scales,
    cross_interval,
    cross_live_interval,
    is_tie,
    largest_in_interval,
    run_intervals,
    scales_of,
    start_motion,
    starts_at_edge,
    status_of,
    sticks_from_start,
)

# Lanes of the interval engine: a step is a whole base interval, drawn when it is simulated.


class _Sample(NamedTuple):
    """Constants of a sample: its key data, and whether it begins with a stick."""

    key_data: tuple[Array, Array]
    at_start: BoolArray


class _Lane(NamedTuple):
    """The motion of one lane; `memory`: the state of the random law, which the next interval depends on; `ties`: the
    number of intervals in which round-off decided.
    """

    memory: Any
    motion: MassState
    totals: Totals
    ties: IntArray


class IntervalEngine(Engine[Scales, _Sample, _Lane, StickRecord, SampleTotals]):
    """A `MassSpring` on a base that follows `law`, up to `t1`, from `y0`.

    `quantities` of each stick: those asked for.
    """

    system: MassSpring
    law: PiecewiseConstantLaw
    t1: Scalar
    y0: tuple[Number, ...]
    quantities: tuple[str, ...] = eqx.field(static=True, default=())

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[_Sample, _Lane]:
        scales = self.shared(dtype)
        x, velocity = self.y0
        motion = start_motion(scales, (x, velocity), self.quantities)
        memory = computed_once(lambda key_data: self.law.begin(key_data, dtype))(key_data)
        _, base, _ = self.law.next_interval(memory, self.law.draw(key_data, jnp.zeros((), jnp.uint32), dtype), dtype)
        at_start = sticks_from_start(motion.x, motion.v, base, scales)
        at_edge = starts_at_edge(scales, motion, base).astype(jnp.int32)
        return _Sample(key_data, at_start), _Lane(memory, motion, start_totals(dtype), at_edge)

    def shared(self, dtype) -> Scales:
        return scales_of(self.system, self.t1, dtype)

    def draw(self, sample: _Sample, number: Array, dtype) -> Any:
        return self.law.draw(sample.key_data, number, dtype)

    def step(self, shared: Scales, sample: _Sample, motion: _Lane, drawn: Any) -> tuple[_Lane, StickRecord]:
        duration, velocity, memory = self.law.next_interval(motion.memory, drawn, shared.t1.dtype)
        duration = jnp.where(duration >= shared.t1, shared.t1, duration)  # no infinity enters the arithmetic
        moved, totals, stick, tie = cross_interval(
            shared, motion.motion, motion.totals, duration, velocity, moving=self.law.is_never_at_rest
        )
        return _Lane(memory, moved, totals, motion.ties + tie), stick

    def watched(
        self, shared: Scales, sample: _Sample, motion: _Lane, drawn: Any, asked: Asked
    ) -> tuple[_Lane, StickRecord, FloatArray, None]:
        duration, velocity, _ = self.law.next_interval(motion.memory, drawn, shared.t1.dtype)
        of_interval = partial(largest_in_interval, shared, motion.motion, duration, velocity)
        found = [of_interval(of_velocity=form[0][0] == 1, sign=sign) for sign in SIGNS for form in asked.forms]
        return *self.step(shared, sample, motion, drawn), jnp.stack(found).reshape(len(SIGNS), -1), None

    def end(self, sample: _Sample, motion: _Lane) -> End:
        return End(motion.totals, motion.motion.t, (motion.motion.x, motion.motion.v))

    def ended(self, motion: _Lane, before: _Lane) -> BoolArray:
        return is_over(motion.motion, before.motion, self.t1)

    def results(self, sample: _Sample, motion: _Lane) -> SampleTotals:
        status = status_of(motion.motion, jnp.asarray(self.t1, motion.motion.t.dtype))
        # Ties of other kinds (`is_tie`) are not looked for: it would cost a third of the time.
        return sample_totals(self.system, motion.totals, sample.at_start, status, motion.ties)


def is_over(motion: MassState, before: MassState, t1: Scalar) -> BoolArray:
    """Whether a sample reached the horizon, had no further interval since `before`, or has a NaN time."""
    return ~(motion.t < jnp.asarray(t1, motion.t.dtype)) | (motion.t <= before.t)


# Motion over given base intervals: one trajectory, which ``jax.vmap`` turns into blocks of lanes.
#
# XLA runs a vmapped loop over intervals operation by operation, each over all samples, and over all slots for
# intervals. Here a vmapped trajectory becomes blocks of lanes whose arrays stay in the cache; a block is one native
# loop, which ends with its last lane. Such a loop has no reverse mode. So derivatives with respect to scalars
# (parameters of the system and the initial state) are computed in forward mode along with the motion: the tangents of
# the results are sums of stored slopes, which JAX transposes for reverse mode. Derivatives with respect to the base
# (its durations or velocities) go through `run_intervals`.
#
# What of it is asked for is one of three, so that results that are not used cost nothing.


What = Literal["final", "sticks", "beginnings"]
_ASKED: dict[What, tuple[str, ...]] = {"final": (), "sticks": ALL, "beginnings": (LAST_LEFT,)}  # quantities of a stick


class Given(NamedTuple):
    """The scales and initial state of a trajectory, and the durations (s) and velocities (m/s) of its base's intervals,
    (intervals,). For many lanes, each leaf has the lanes as its first axis.
    """

    scales: Scales
    y0: tuple[Array, Array]  # position (m) and velocity (m/s)
    durations: Array
    velocities: Array


class _Block(NamedTuple):
    """Loop state of a block of lanes: the number of intervals crossed, the state and sums of each lane, and what is
    kept of each interval: `StickRecord` (intervals, lanes), `IntervalBeginnings` (lanes, intervals) or nothing.
    """

    crossed: IntArray
    motion: MassState
    totals: Totals
    kept: Any


class IntervalBeginnings(NamedTuple):
    """The state at the beginning of each interval, and the number of intervals in which round-off decided."""

    motion: MassState
    near_grazing_count: IntArray


def motion_over(what: What, given: Given) -> Any:
    """What is asked for of one trajectory.

    - "final": its state at the end, and the `Totals` of its sticks.
    - "sticks": a `StickRecord` in order of time, in slots (intervals,), as `closed_up` returns them.
    - "beginnings": the `IntervalBeginnings`, (intervals,), with what `is_tie` finds in them.
    """
    return _fast(what, given) if native_loops_work() else _plain(what, given)


def _plain(what: What, given: Given) -> Any:
    """One scan over all intervals, which every transformation of JAX supports."""
    start = start_motion(given.scales, given.y0, _ASKED[what])
    motion, totals, records, began, brief = run_intervals(given.scales, start, given.durations, given.velocities)
    if what == "final":
        return motion, totals
    if what == "sticks":
        return closed_up(records)[0]
    ties = jax.vmap(is_tie, (None, 0, 0, 0))(given.scales, began, given.durations, given.velocities)
    return IntervalBeginnings(began, jnp.sum(ties | brief, dtype=jnp.int32))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _fast(what: What, given: Given) -> Any:
    return _only_lane(_lanes_of(what)(_one_lane(given)))


@partial(_fast.defjvp, symbolic_zeros=True)
def _fast_jvp(what: What, primals: tuple[Given], tangents: tuple[Given]) -> tuple[Any, Any]:
    (given,), (direction,) = primals, tangents
    if not (_is_zero(direction.durations) and _is_zero(direction.velocities)):
        whole = jax.tree.map(
            lambda value, tangent: jnp.zeros_like(value) if _is_zero(tangent) else tangent,
            given, direction, is_leaf=_is_zero,
        )  # fmt: skip
        return jax.jvp(partial(_plain, what), (given,), (whole,))
    changes = _numbers_of(direction)
    moved = tuple(not _is_zero(change) for change in changes)
    out, slopes = _only_lane(_lanes_with_slopes(what, moved)(_one_lane(given)))
    slopes = iter(slopes)

    def tangent(value):
        if not jnp.issubdtype(value.dtype, jnp.floating):
            return np.zeros(value.shape, jax.dtypes.float0)
        columns = next(slopes)
        chosen = (change for change in changes if not _is_zero(change))
        return sum((change * columns[k] for k, change in enumerate(chosen)), jnp.zeros_like(value))

    return out, jax.tree.map(tangent, out)


def _numbers_of(given: Given) -> list[Any]:
    return jax.tree.leaves((given.scales, given.y0), is_leaf=_is_zero)


def _is_zero(leaf: Any) -> bool:
    return isinstance(leaf, SymbolicZero)


def _one_lane(given: Given) -> Given:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], given)


def _only_lane(results: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[0], results)


@cache
def _lanes_of(what: What) -> Callable[[Given], Any]:
    return _for_any_batch(partial(_run_block, what))


@cache
def _lanes_with_slopes(what: What, moved: tuple[bool, ...]) -> Callable[[Given], Any]:
    """Results, and a list of the slopes (lanes, numbers, ...) of the real ones with respect to the numbers `moved`."""

    def run(given: Given) -> Any:
        numbers = _numbers_of(given)
        basis = jnp.eye(sum(moved), dtype=given.durations.dtype)

        def block_of(numbers):
            scales, y0 = jax.tree.unflatten(jax.tree.structure((given.scales, given.y0)), numbers)
            return _run_block(what, given._replace(scales=scales, y0=y0))

        def along(direction):
            entries = iter(direction)
            change = [
                jnp.full_like(n, next(entries)) if m else jnp.zeros_like(n) for n, m in zip(numbers, moved, strict=True)
            ]
            out, slopes = jax.jvp(block_of, (numbers,), (change,))
            real = [leaf for leaf in jax.tree.leaves(slopes) if leaf.dtype != jax.dtypes.float0]
            return out, real

        return jax.vmap(along, out_axes=(None, 1))(basis)

    return _for_any_batch(run)


def _for_any_batch(run_block: Callable[[Given], Any]) -> Callable[[Given], Any]:
    """`run_block` for any number of lanes, block by block; under vmap the new axis becomes more lanes."""

    def run(given: Given) -> Any:
        lanes = given.durations.shape[0]
        if 0 < lanes <= LANES:
            return run_block(given)
        return in_blocks(run_block, given, max(block_width(lanes, LANES), 1))

    mapped = custom_vmap(run)

    @mapped.def_vmap
    def _more_lanes(size, batched, given):
        (batched,) = batched  # one entry per argument
        if not any(jax.tree.leaves(batched)):
            out = run(given)
            return out, jax.tree.map(lambda _: False, out)
        each = jax.tree.map(
            lambda leaf, has: leaf if has else jnp.broadcast_to(leaf, (size, *leaf.shape)), given, batched
        )
        lanes = given.durations.shape[batched.durations]
        out = mapped(jax.tree.map(lambda leaf: leaf.reshape(size * lanes, *leaf.shape[2:]), each))
        parted = jax.tree.map(lambda leaf: leaf.reshape(size, lanes, *leaf.shape[1:]), out)
        return parted, jax.tree.map(lambda _: True, out)

    return mapped


def _run_block(what: What, given: Given) -> Any:
    """The results of a block of lanes; all leaves have the lanes as their first axis."""
    durations = given.durations
    start = jax.vmap(partial(start_motion, quantities=_ASKED[what]))(given.scales, given.y0)
    totals = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, start.t.shape), start_totals(durations.dtype))
    buffer: Any = jnp.zeros_like(durations)
    began = IntervalBeginnings(jax.tree.map(lambda _: buffer, start), totals.sticks)
    buffer = {"final": None, "sticks": _no_sticks(buffer.T), "beginnings": began}[what]
    block = _Block(jnp.zeros((), jnp.int32), start, totals, buffer)
    block = _cross_all(given.scales, durations, given.velocities, block)
    if what == "final":
        return block.motion, block.totals
    if what == "sticks":
        return _close_up(block.kept, _no_sticks(jnp.full_like(durations, jnp.nan)), block.crossed)
    later = jnp.arange(durations.shape[1]) >= block.crossed
    began = jax.tree.map(lambda kept, last: jnp.where(later, last[:, None], kept), block.kept.motion, block.motion)
    return block.kept._replace(motion=began)


def _no_sticks(times: Array) -> StickRecord:
    return StickRecord(times, times, times, dict.fromkeys(QUANTITIES, times), jnp.full(times.shape, -1, jnp.int8))


@native_loop
def _cross_all(scales: Scales, durations: Array, velocities: Array, block: _Block) -> _Block:
    """Cross interval by interval until no lane is short of the horizon."""

    def cross(block):
        number = block.crossed
        base = _column(durations, number), _column(velocities, number)
        motion, totals, record, brief = jax.vmap(cross_live_interval)(scales, block.motion, block.totals, *base)
        kept = block.kept
        if isinstance(kept, StickRecord):
            kept = jax.tree.map(lambda old, row: lax.dynamic_update_index_in_dim(old, row, number, 0), kept, record)
        elif isinstance(kept, IntervalBeginnings):
            began = jax.tree.map(
                lambda old, new: lax.dynamic_update_index_in_dim(old, new, number, 1), kept.motion, block.motion
            )
            ties = jax.vmap(is_tie)(scales, block.motion, *base)
            kept = IntervalBeginnings(began, kept.near_grazing_count + (ties | brief))
        return _Block(number + 1, motion, totals, kept)

    def goes_on(block):
        return (block.crossed < durations.shape[1]) & ~jnp.all(block.motion.t >= scales.t1)

    return lax.while_loop(goes_on, cross, block)


@computed_once  # neighbours in a column lie far apart in memory: read each once
def _column(table: Array, number: IntArray) -> Array:
    return lax.dynamic_index_in_dim(table, number, 1, keepdims=False)


@native_loop
def _close_up(records: StickRecord, buffer: StickRecord, crossed: IntArray) -> StickRecord:
    """The sticks among the first records (intervals, lanes), put into the first slots of `buffer` (lanes, slots)."""

    def put(number, carry):
        lane, buffer, count = carry
        is_stick = records.ending[number, lane] >= 0

        def move(old, column):
            # An interval without a stick leaves the slot empty, for the next.
            spare = jnp.asarray(-1 if column.dtype == jnp.int8 else jnp.nan, column.dtype)
            entry = jnp.where(is_stick, lax.dynamic_slice(column, (number, lane), (1, 1)), spare)
            return lax.dynamic_update_slice(old, entry, (lane, count))

        return lane, jax.tree.map(move, buffer, records), count + is_stick

    def close_lane(lane, buffer):
        return lax.fori_loop(jnp.int32(0), crossed, put, (lane, buffer, jnp.zeros((), jnp.int32)))[1]

    return lax.fori_loop(jnp.int32(0), jnp.int32(records.ending.shape[1]), close_lane, buffer)


# One trajectory in closed form over base intervals, and the state along it.


class IntervalPath(MotionPath):
    """Path given by the states at the beginnings of the base intervals."""

    smooth: Signal | None
    system: MassSpring
    base: VelocitySteps
    t1: Scalar
    beginnings: MassState

    @property
    def times(self) -> Array:
        return self.beginnings.t

    def state(self, time: FloatArray) -> State:
        scales = scales_of(self.system, self.t1, time.dtype)
        began, velocity = jax.tree.map(
            lambda values: values[self._index(time)], (self.beginnings, self.base.velocities)
        )
        motion, *_ = cross_interval(scales, began, start_totals(time.dtype), time - began.t, velocity)
        return motion.x, motion.v

    def largest(self, form: Form, sign: Scalar, last: FloatArray, final: State) -> FloatArray:
        dtype, ((number, _),) = last.dtype, form  # position and velocity have no sum
        scales = scales_of(self.system, self.t1, dtype)
        of_interval = partial(largest_in_interval, scales, of_velocity=number == 1, sign=sign)
        durations, velocities = (jnp.asarray(one, dtype) for one in (self.base.durations, self.base.velocities))
        found = jnp.max(jax.vmap(of_interval)(self.beginnings, durations, velocities))
        return jnp.maximum(found, sign * final[number])

    def segments(self, time: FloatArray) -> Segments:
        index = self._index(time)
        begin, velocity = self.beginnings.t[index], self.base.velocities[index].astype(time.dtype)
        here = Segment(begin, begin + self.base.durations[index].astype(time.dtype), velocity, jnp.zeros_like(velocity))
        return Segments((here,), (), ())

    def _index(self, time: FloatArray) -> Array:
        # Of intervals with the same beginning (empty slots of no length), the last is the one with a length.
        return jnp.clip(jnp.searchsorted(self.beginnings.t, time, side="right") - 1, 0)


@kept_jit(static_argnames="dtype")
def follow_intervals(system: MassSpring, base: VelocitySteps, t1: Scalar, y0: tuple[Number, ...], dtype) -> Run:
    """One trajectory in closed form, interval by interval."""
    scales = scales_of(system, t1, dtype)
    # Nothing after t1 matters; cutting durations here keeps infinities out of the arithmetic.
    durations = marked(jnp.where(base.durations >= t1, t1, base.durations), base.velocities).astype(dtype)
    start = jnp.asarray(y0[0], dtype), jnp.asarray(y0[1], dtype)
    given = Given(scales, start, durations, base.velocities.astype(dtype))
    final, totals = motion_over("final", given)
    began: IntervalBeginnings = motion_over("beginnings", given)
    path, sticks = IntervalPath(None, system, base, t1, began.motion), sticks_of(motion_over("sticks", given))
    return Run(sticks, totals, status_of(final, scales.t1), final.t, (final.x, final.v), began.near_grazing_count, path)
