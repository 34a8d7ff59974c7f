"""Statistics of recorded stick sequences whose derivatives are those of their expectations.

The derivative of a realisation's functional with the number of sticks held fixed is the pathwise part. The event part
comes from the margins of existence (`edges.py`), weighted by kernels (`kernels.py`): the functional's jump at each is
its change when a stick of zero length is inserted there, or when a slip of zero length splits a stick in two. The
duration of a stick from t = 0 is a further margin.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._dynamics.lanes import Job, follow_block, lanes_at_start
from .._status import Ending
from .._types import AnyArray, Array, IntArray
from .edges import Edges
from .kernels import crossing, hits, through
from .kernels import ending as ending_at
from .random_inputs import constants_of, over, plain
from .statistic import StickSequence, StickStatistic

_SAME = 64  # units in the last place by which two computed values of the same instant may differ


class BufferSizes(NamedTuple):
    """Buffer sizes of a realisation: blocks of intervals or steps; slots for sticks and for edges (0: none kept)."""

    blocks: int
    slots: int
    edges: int


class Recorded(NamedTuple):
    """The sticks of each lane's sample in order of time; the first three (slots, lanes), 0 in spare slots."""

    start: Array
    end: Array
    ending: IntArray
    certain: Array  # until when nothing is random, s; (lanes,) like the next three
    status: IntArray
    sticks: IntArray  # how many slots would be needed
    edges: IntArray
    near: Edges | None  # (edges, lanes); in spare slots no margin decides


class Features(NamedTuple):
    """Numerator and denominator of each sample, and zeros that carry the event parts in their derivatives.

    `parts` (lanes, 2), with pathwise derivatives; `events` (lanes, windows, 2): zeros whose derivatives are the event
    parts; `near` (lanes, windows): zeros whose derivatives count the margins that each window reached.
    """

    parts: Array
    events: Array
    near: Array


def record_sequences(
    engine: Any, own: Any, key_data: Array, first: Array, *, lanes: int, buffer: BufferSizes, dtype: Any
) -> Recorded:
    """Simulate samples ``first .. first + lanes - 1`` for up to `buffer.blocks` blocks, and keep sticks and edges.

    `engine`: `traced`. `own`: the own leaves of its samples.
    """
    engine = over(engine, lambda engine: dataclasses.replace(engine, with_edges=buffer.edges > 0))
    start = lanes_at_start(Job(engine, key_data, first, np.int32(1), own).with_columns(), lanes, dtype)

    def advance(carry):
        # A lane that has ended idles: nothing happens after the horizon.
        now, ended = carry
        after, trace = follow_block(engine, now, dtype, stacked=True)
        following = jax.tree.map(lambda new, old: _where(~ended, new, old), after, now)
        return (following, ended | jax.vmap(engine.ended)(after.motion, now.motion)), trace

    begun = start, jnp.zeros(lanes, bool)
    shapes = jax.eval_shape(advance, begun)[1]

    def idle(carry):
        none = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        return carry, none._replace(sticks=none.sticks._replace(ending=none.sticks.ending - 1))

    def block(carry, _):
        return lax.cond(jnp.all(carry[1]), idle, advance, carry)

    (now, _), trace = lax.scan(block, begun, None, length=buffer.blocks)
    certain = constants_of(engine, now.sample).certain
    sticks, moments, may_be_near = jax.tree.map(lambda leaf: leaf.reshape(-1, lanes), trace)
    kept, is_stick, sticks_found = _gathered(sticks.ending >= 0, sticks, buffer.slots)
    near, moments_found = None, jnp.zeros_like(sticks_found)
    if buffer.edges > 0:
        moments, is_moment, moments_found = _gathered(may_be_near, moments, buffer.edges)
        near = engine.edges(now.sample, moments)
        # Before anything random happens no margin has a density, except the race with the base's first change.
        near = near.only(is_moment & (near.time >= certain[None]), is_moment)
    start, end = (jnp.where(is_stick, column, 0) for column in (kept.start, kept.end))
    ending = jnp.where(is_stick, kept.ending, -1).astype(jnp.int32)
    status = jnp.asarray(jax.vmap(engine.results)(now.sample, now.motion), jnp.int32)
    return Recorded(start, end, ending, certain, status, sticks_found, moments_found, near)


def _gathered(exists: Array, columns: Any, slots: int) -> tuple[Any, Array, Array]:
    """The first `slots` existing rows of each lane: columns, which slots are filled, how many rows exist."""
    found = jnp.cumsum(exists, axis=0)
    # The slot of row k is the first at which k + 1 have been found. (A scatter would run serially.)
    wanted = jnp.arange(1, slots + 1)
    at = jax.vmap(lambda found: jnp.searchsorted(found, wanted), in_axes=1, out_axes=1)(found)
    filled = wanted[:, None] <= found[-1][None]
    at = jnp.where(filled, at, 0)
    kept = jax.tree.map(lambda column: jnp.take_along_axis(column, at, axis=0), columns)
    return kept, filled, found[-1].astype(jnp.int32)


def features_of(statistic: StickStatistic, engine: Any, recorded: Recorded, bandwidths: AnyArray) -> Features:
    """The features of all samples; differentiate them to get pathwise and event parts (none without edges).

    `bandwidths` (windows,): relative bandwidths of the kernels.
    """
    dtype = recorded.start.dtype
    t1, bandwidths = jnp.asarray(plain(engine).engine.t1, dtype), jnp.asarray(bandwidths, dtype)

    if recorded.near is None:
        parts = jax.vmap(lambda one: stacked_parts(statistic, one, t1))(sequences_of(recorded))
        shape = (len(parts), len(bandwidths))
        return Features(parts, jnp.zeros((*shape, 2), dtype), jnp.zeros(shape, dtype))

    def one(sticks, ending, certain, near):
        events, reached = _events(statistic, sticks, ending, certain, near, bandwidths, t1)
        return Features(stacked_parts(statistic, sticks, t1), events, reached)

    near = jax.tree.map(jnp.transpose, recorded.near)
    return jax.vmap(one)(sequences_of(recorded), recorded.ending.T, recorded.certain, near)


def sequences_of(recorded: Recorded) -> StickSequence:
    """The sticks in the form that statistics take, arrays (lanes, slots)."""
    mask = (recorded.ending >= 0).T
    return StickSequence(
        jnp.where(mask, recorded.start.T, 0), jnp.where(mask, (recorded.end - recorded.start).T, 0), mask
    )


def _events(
    statistic: StickStatistic,
    sticks: StickSequence,
    ending: Array,
    certain: Array,
    near: Edges,
    bandwidths: Array,
    t1: Array,
) -> tuple[Array, Array]:
    """The event parts of one sample's numerator and denominator for each window, and how many margins they rest on."""
    fixed = lax.stop_gradient(sticks)

    def parts(sequence):
        return stacked_parts(statistic, sequence, t1)

    def jump_at(time, exists, is_slip):
        return jnp.where(is_slip, _jump_of_slip(parts, fixed, time, exists), _jump_of_stick(parts, fixed, time, exists))

    # Only the first stick can begin at t = 0.
    random = (certain == 0) | (ending[0] == Ending.BASE_SWITCHED)
    from_start = sticks.mask[0] & (sticks.start[0] == 0) & (ending[0] != Ending.HORIZON) & random
    time = lax.stop_gradient(near.time)
    at_edges = jax.vmap(jump_at)(time, near.exists, near.is_slip)
    at_start = _jump_of_stick(parts, fixed, fixed.start[0], True)

    def window(bandwidth):
        at = through(near, bandwidth, crossing, ending_at)[:, None] * at_edges
        first = ending_at(sticks.duration[0], bandwidth, from_start) * at_start
        reached = jnp.sum(through(near, bandwidth, hits, hits)) + hits(sticks.duration[0], bandwidth, from_start)
        return jnp.sum(at, axis=0) + first, reached

    # A Python loop: jax 0.10.2 cannot vmap over the windows where this is differentiated inside a loop.
    events, reached = zip(*(window(bandwidth) for bandwidth in bandwidths), strict=True)
    return jnp.stack(events), jnp.stack(reached)


def _jump_of_stick(parts: Any, sticks: StickSequence, time: Array, exists: Any) -> Array:
    """Change of the parts by a stick of zero length at `time`; a stick that `exists` there is removed first."""
    index = jnp.argmin(jnp.where(sticks.mask, jnp.abs(sticks.start - time), jnp.inf))
    found = exists & sticks.mask[index] & _same(sticks.start[index], time)
    without = jax.tree.map(lambda a, b: jnp.where(found, a, b), _without(sticks, index), sticks)
    return parts(_with(without, time)) - parts(without)


def _jump_of_slip(parts: Any, sticks: StickSequence, time: Array, exists: Array) -> Array:
    """Change of the parts by a slip of zero length at `time` that splits a stick in two; zero outside sticks.

    If the slip `exists`, from `time` on, the two sticks around it are joined first.
    """
    numbers = jnp.arange(len(sticks.mask))
    end = sticks.start + sticks.duration
    ends_here = jnp.argmin(jnp.where(sticks.mask, jnp.abs(end - time), jnp.inf))
    holds = jnp.argmax(sticks.mask & (sticks.start < time) & (time < end))
    index = jnp.where(exists, ends_here, holds)
    following = jnp.minimum(index + 1, len(numbers) - 1)
    is_parted = exists & _same(end[index], time) & sticks.mask[following] & (following > index)
    is_whole = ~exists & sticks.mask[index] & (sticks.start[index] < time) & (time < end[index])
    last = jnp.where(is_parted, end[following], end[index])
    one = jax.tree.map(lambda a, b: jnp.where(is_parted, a, b), _without(sticks, following), sticks)
    whole = one._replace(duration=jnp.where(numbers == index, last - sticks.start[index], one.duration))
    first = whole._replace(duration=jnp.where(numbers == index, time - sticks.start[index], whole.duration))
    return jnp.where(is_parted | is_whole, parts(_with(first, time, last - time)) - parts(whole), 0)


def _same(one: Array, other: Array) -> Array:
    return jnp.abs(one - other) <= _SAME * jnp.finfo(one.dtype).eps * (1 + jnp.abs(other))


def stacked_parts(statistic: StickStatistic, sticks: StickSequence, t1: Array) -> Array:
    """Numerator and denominator as one array."""
    return jnp.stack([jnp.asarray(part, sticks.start.dtype) for part in statistic.parts(sticks, t1)])


def _without(sticks: StickSequence, i: Array) -> StickSequence:
    """The sequence without stick `i`."""
    numbers = jnp.arange(len(sticks.mask))
    start, duration, mask = (jnp.where(numbers < i, column, jnp.roll(column, -1)) for column in sticks)
    mask = mask & (numbers < jnp.sum(sticks.mask) - 1)
    return StickSequence(jnp.where(mask, start, 0), jnp.where(mask, duration, 0), mask)


def _with(sticks: StickSequence, time: Array, duration: Any = 0) -> StickSequence:
    """The sequence with a stick inserted at `time`."""
    numbers = jnp.arange(len(sticks.mask))
    place = jnp.sum(sticks.mask & (sticks.start < time))

    def put(column, value):
        return jnp.where(numbers < place, column, jnp.where(numbers == place, value, jnp.roll(column, 1)))

    return StickSequence(put(sticks.start, time), put(sticks.duration, duration), put(sticks.mask, True))


def _where(chosen: Array, new: Array, old: Array) -> Array:
    return jnp.where(chosen.reshape(chosen.shape + (1,) * (new.ndim - 1)), new, old)
