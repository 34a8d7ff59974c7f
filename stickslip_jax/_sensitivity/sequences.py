"""Statistics of recorded stick sequences whose derivatives are those of their expectations.

The derivative of a realisation's functional with the number of sticks held fixed is the pathwise part. The event part
comes from the signed distances to the boundaries (`boundaries.py`), weighted by kernels (`kernels.py`): the
functional's jump at each is its change when a stick of zero length is inserted there, or when a slip of zero length
splits a stick in two. The duration of a stick from t = 0 is a further distance.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float, Int

from .._dynamics.common.engine import Engine
from .._dynamics.common.lanes import Job, follow_block, lanes_at_start
from .._types import AnyArray, Array, BoolArray, DType, FloatArray, IntArray
from .boundaries import BoundaryDistances, SignedDistance, vanishes_from_start
from .kernels import BoundarySums
from .random_inputs import constants_of, single_engine, wrapped
from .statistic import StickSequence, StickStatistic

_Tree = TypeVar("_Tree")
_SAME = 64  # units in the last place by which two computed values of the same instant may differ


class BufferSizes(NamedTuple):
    """Buffer sizes of a realisation: blocks of intervals or steps; slots for sticks; slots for candidates (0: none)."""

    blocks: int
    slots: int
    candidates: int


class RecordedCounts(NamedTuple):
    """Of every lane's sample: status, and how many slots its sticks and its candidates would need."""

    status: Int[AnyArray, " lanes"]
    sticks: Int[AnyArray, " lanes"]
    candidates: Int[AnyArray, " lanes"]


class LaneSticks(NamedTuple):
    """The sticks of each lane's sample in order of time, 0 in spare slots."""

    start: Float[Array, "slots lanes"]
    end: Float[Array, "slots lanes"]
    ending: Int[Array, "slots lanes"]
    deterministic_until: Float[Array, " lanes"]  # when the first random thing happens, s
    counts: RecordedCounts
    distances: BoundaryDistances | None  # (candidates, lanes); none is active in spare slots


class Features(NamedTuple):
    """Numerator and denominator of each sample, and zeros that carry the event parts in their derivatives.

    `parts`: with pathwise derivatives; `event_parts`: zeros whose derivatives are the event parts; `in_window`: zeros
    whose derivatives count the distances inside each window.
    """

    parts: Float[Array, "lanes 2"]
    event_parts: Float[Array, "lanes windows 2"]
    in_window: Float[Array, "lanes windows"]


def record_sequences(job: Job, *, lanes: int, buffer: BufferSizes, dtype: DType) -> LaneSticks:
    """Simulate the first row of a job's samples for up to `buffer.blocks` blocks; keep sticks and candidates.

    The engine is one that `recording` made, or `wrapped` by it.
    """
    engine = wrapped(job.engine, lambda engine: dataclasses.replace(engine, with_distances=buffer.candidates > 0))
    start = lanes_at_start(job._replace(engine=engine).with_columns(), lanes, dtype)

    def advance(carry):
        # A lane that has ended idles: nothing happens after the horizon.
        now, ended = carry
        after, trace = follow_block(engine, now, dtype, stacked=True)
        following = jax.tree.map(lambda new, old: jax.vmap(jnp.where)(~ended, new, old), after, now)
        return (following, ended | jax.vmap(engine.ended)(after.motion, now.motion)), trace

    begun = start, jnp.zeros(lanes, bool)
    shapes = jax.eval_shape(advance, begun)[1]

    def idle(carry):
        none = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        return carry, none._replace(sticks=none.sticks._replace(ending=none.sticks.ending - 1))

    def block(carry, _):
        return lax.cond(jnp.all(carry[1]), idle, advance, carry)

    (now, _), trace = lax.scan(block, begun, None, length=buffer.blocks)
    deterministic_until = constants_of(engine, now.sample).deterministic_until
    sticks, candidates, is_candidate = jax.tree.map(lambda leaf: leaf.reshape(-1, lanes), trace)
    kept, is_stick, sticks_found = _gathered(sticks.ending >= 0, sticks, buffer.slots)
    distances, candidates_found = None, jnp.zeros_like(sticks_found)
    if buffer.candidates > 0:
        candidates, is_filled, candidates_found = _gathered(is_candidate, candidates, buffer.candidates)
        distances = engine.distances(now.sample, candidates)
        # Before anything random happens no distance has a density, except that to the base's first change.
        distances = distances.only(is_filled & (distances.time >= deterministic_until[None]), is_filled)
    start, end = (jnp.where(is_stick, column, 0) for column in (kept.start, kept.end))
    ending = jnp.where(is_stick, kept.ending, -1).astype(jnp.int32)
    status = jnp.asarray(jax.vmap(engine.results)(now.sample, now.motion), jnp.int32)
    counts = RecordedCounts(status, sticks_found, candidates_found)
    return LaneSticks(start, end, ending, deterministic_until, counts, distances)


def _gathered(exists: BoolArray, columns: _Tree, slots: int) -> tuple[_Tree, BoolArray, IntArray]:
    """The first `slots` existing rows of each lane: columns, which slots are filled, how many rows exist."""
    found = jnp.cumsum(exists, axis=0)
    # The slot of row k is the first at which k + 1 have been found. (A scatter would run serially.)
    wanted = jnp.arange(1, slots + 1)
    at = jax.vmap(lambda found: jnp.searchsorted(found, wanted), in_axes=1, out_axes=1)(found)
    filled = wanted[:, None] <= found[-1][None]
    at = jnp.where(filled, at, 0)
    kept = jax.tree.map(lambda column: jnp.take_along_axis(column, at, axis=0), columns)
    return kept, filled, found[-1].astype(jnp.int32)


def features_of(statistic: StickStatistic, engine: Engine, recorded: LaneSticks, bandwidths: AnyArray) -> Features:
    """The features of all samples; differentiate them to get pathwise and event parts (these from distances only).

    `bandwidths` (windows,): relative bandwidths of the kernels.
    """
    dtype = recorded.start.dtype
    t1, bandwidths = jnp.asarray(single_engine(engine).engine.t1, dtype), jnp.asarray(bandwidths, dtype)

    if recorded.distances is None:
        parts = jax.vmap(lambda one: stacked_parts(statistic, one, t1))(sequences_of(recorded))
        shape = (len(parts), len(bandwidths))
        return Features(parts, jnp.zeros((*shape, 2), dtype), jnp.zeros(shape, dtype))

    def one(sticks, ending, deterministic_until, distances):
        # Only the first stick can begin at t = 0.
        from_start = vanishes_from_start(sticks.start[0], ending[0], deterministic_until)
        return Features(
            stacked_parts(statistic, sticks, t1), *_events(statistic, sticks, from_start, distances, bandwidths, t1)
        )

    distances = jax.tree.map(jnp.transpose, recorded.distances)
    return jax.vmap(one)(sequences_of(recorded), recorded.ending.T, recorded.deterministic_until, distances)


def sequences_of(recorded: LaneSticks) -> StickSequence:
    """The sticks in the form that statistics take, arrays (lanes, slots)."""
    mask = (recorded.ending >= 0).T
    return StickSequence(
        jnp.where(mask, recorded.start.T, 0), jnp.where(mask, (recorded.end - recorded.start).T, 0), mask
    )


def _events(
    statistic: StickStatistic,
    sticks: StickSequence,
    from_start: BoolArray,
    distances: BoundaryDistances,
    bandwidths: Float[Array, " windows"],
    t1: FloatArray,
) -> tuple[Float[Array, "windows 2"], Float[Array, " windows"]]:
    """The event parts of one sample's numerator and denominator for each window, and how many distances are inside.

    `from_start`: whether its first stick begins at t = 0 and may vanish.
    """
    fixed = lax.stop_gradient(sticks)

    def parts(sequence):
        return stacked_parts(statistic, sequence, t1)

    def jump_at(time, exists, is_slip):
        return jnp.where(is_slip, _jump_of_slip(parts, fixed, time, exists), _jump_of_stick(parts, fixed, time, exists))

    time = lax.stop_gradient(distances.time)
    at_boundaries = jax.vmap(jump_at)(time, distances.exists, distances.is_slip)
    at_start = _jump_of_stick(parts, fixed, fixed.start[0], True)

    sums = BoundarySums.over(distances.two_sided, distances.one_sided, bandwidths)
    first = BoundarySums.over((), (SignedDistance(sticks.duration[0], from_start),), bandwidths)
    event_parts = [jnp.sum(weights[:, None] * at_boundaries, axis=0) + weight * at_start
                   for weights, weight in zip(sums.event_parts, first.event_parts, strict=True)]  # fmt: skip
    in_window = [jnp.sum(number) + one for number, one in zip(sums.in_window, first.in_window, strict=True)]
    return jnp.stack(event_parts), jnp.stack(in_window)


_Parts: TypeAlias = Callable[[StickSequence], FloatArray]
"""A statistic's numerator and denominator, of one sequence."""


def _jump_of_stick(parts: _Parts, sticks: StickSequence, time: FloatArray, exists: BoolArray | bool) -> FloatArray:
    """Change of the parts by a stick of zero length at `time`; a stick that `exists` there is removed first."""
    index = jnp.argmin(jnp.where(sticks.mask, jnp.abs(sticks.start - time), jnp.inf))
    found = exists & sticks.mask[index] & _same(sticks.start[index], time)
    without = jax.tree.map(lambda a, b: jnp.where(found, a, b), _without(sticks, index), sticks)
    return parts(_with(without, time)) - parts(without)


def _jump_of_slip(parts: _Parts, sticks: StickSequence, time: FloatArray, exists: BoolArray) -> FloatArray:
    """Change of the parts by a slip of zero length at `time` that splits a stick in two; zero outside sticks.

    If the slip `exists`, from `time` on, the two sticks around it are joined first.
    """
    numbers = jnp.arange(len(sticks.mask))
    end = sticks.start + sticks.duration
    ends_here = jnp.argmin(jnp.where(sticks.mask, jnp.abs(end - time), jnp.inf))
    around = jnp.argmax(sticks.mask & (sticks.start < time) & (time < end))
    index = jnp.where(exists, ends_here, around)
    following = jnp.minimum(index + 1, len(numbers) - 1)
    is_parted = exists & _same(end[index], time) & sticks.mask[following] & (following > index)
    is_whole = ~exists & sticks.mask[index] & (sticks.start[index] < time) & (time < end[index])
    last = jnp.where(is_parted, end[following], end[index])
    one = jax.tree.map(lambda a, b: jnp.where(is_parted, a, b), _without(sticks, following), sticks)
    whole = one._replace(duration=jnp.where(numbers == index, last - sticks.start[index], one.duration))
    first = whole._replace(duration=jnp.where(numbers == index, time - sticks.start[index], whole.duration))
    return jnp.where(is_parted | is_whole, parts(_with(first, time, last - time)) - parts(whole), 0)


def _same(one: FloatArray, other: FloatArray) -> BoolArray:
    return jnp.abs(one - other) <= _SAME * jnp.finfo(one.dtype).eps * (1 + jnp.abs(other))


def stacked_parts(statistic: StickStatistic, sticks: StickSequence, t1: FloatArray) -> Float[Array, "2"]:
    """Numerator and denominator as one array."""
    return jnp.stack([jnp.asarray(part, sticks.start.dtype) for part in statistic.parts(sticks, t1)])


def _without(sticks: StickSequence, i: IntArray) -> StickSequence:
    """The sequence without stick `i`."""
    numbers = jnp.arange(len(sticks.mask))
    start, duration, mask = (jnp.where(numbers < i, column, jnp.roll(column, -1)) for column in sticks)
    mask = mask & (numbers < jnp.sum(sticks.mask) - 1)
    return StickSequence(jnp.where(mask, start, 0), jnp.where(mask, duration, 0), mask)


def _with(sticks: StickSequence, time: FloatArray, duration: FloatArray | int = 0) -> StickSequence:
    """The sequence with a stick inserted at `time`."""
    numbers = jnp.arange(len(sticks.mask))
    place = jnp.sum(sticks.mask & (sticks.start < time))

    def put(column, value):
        return jnp.where(numbers < place, column, jnp.where(numbers == place, value, jnp.roll(column, 1)))

    return StickSequence(put(sticks.start, time), put(sticks.duration, duration), put(sticks.mask, True))
