"""Statistics of recorded stick sequences whose derivatives are those of their expectations.

The derivative of a realisation's functional with the number of sticks held fixed is the pathwise part. The event part
comes from the edges of existence (`edges.py`), weighed by kernels (`kernels.py`): at each edge the functional's jump is
what a stick of no length adds there, or what it changes if a stick is parted in two by a slip of no length. One edge
more is told by the sticks themselves: one from t = 0 falls to nothing.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .._dynamics.lanes import follow_block, lanes_at_start
from .._status import Ending
from .._types import AnyArray, Array, IntArray
from .edges import Edges
from .kernels import crossing, hits, through
from .kernels import ending as ending_at
from .statistic import StickSequence, StickStatistic
from .traces import TracedIntervals, TracedSteps

_SAME = 64  # units in the last place by which the same instant may differ, computed twice


class BufferSizes(NamedTuple):
    """How much is kept of each realisation: blocks of intervals or steps, and slots for sticks and for edges; none for
    edges if they are not asked for.
    """

    blocks: int
    slots: int
    edges: int


class Recorded(NamedTuple):
    """The sticks of each lane's sample in order of time; the first three (slots, lanes), 0 in spare slots."""

    start: Array
    end: Array
    ending: IntArray
    certain: Array  # (lanes,), as the following; until when nothing is random, s
    status: IntArray
    sticks: IntArray  # how many slots would be needed
    edges: IntArray
    near: Edges | None  # (edges, lanes); in spare slots none decides


class Features(NamedTuple):
    """Of each sample: numerator and denominator (lanes, 2), with pathwise derivatives; zeros (lanes, windows, 2) whose
    derivatives are the event parts; zeros (lanes, windows) whose derivatives tell how many edges each window reached.
    """

    parts: Array
    events: Array
    near: Array


def record_sequences(
    engine: TracedIntervals | TracedSteps, key_data: Array, first: Array, *, lanes: int, buffer: BufferSizes, dtype: Any
) -> Recorded:
    """Simulate samples ``first .. first + lanes - 1`` for up to so many blocks, and keep their sticks and edges."""
    engine = dataclasses.replace(engine, with_edges=buffer.edges > 0)
    start = lanes_at_start(engine, key_data, first, lanes, dtype)

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
    certain = now.sample.certain
    sticks, moments, may_be_near = jax.tree.map(lambda leaf: leaf.reshape(-1, lanes), trace)
    kept, is_stick, sticks_found = _gathered(sticks.ending >= 0, sticks, buffer.slots)
    near, moments_found = None, jnp.zeros_like(sticks_found)
    if buffer.edges > 0:
        moments, is_moment, moments_found = _gathered(may_be_near, moments, buffer.edges)
        near = engine.edges(now.sample, moments)
        # In what is certain to come there is nothing to take a density of, but for when the base changes.
        near = near.only(is_moment & (near.time >= certain[None]), is_moment)
    start, end = (jnp.where(is_stick, column, 0) for column in (kept.start, kept.end))
    ending = jnp.where(is_stick, kept.ending, -1).astype(jnp.int32)
    status = jnp.asarray(jax.vmap(engine.results)(now.sample, now.motion), jnp.int32)
    return Recorded(start, end, ending, certain, status, sticks_found, moments_found, near)


def _gathered(exists: Array, columns: Any, slots: int) -> tuple[Any, Array, Array]:
    """The first so many rows of each lane that exist: columns, which slots are filled, how many rows there are."""
    found = jnp.cumsum(exists, axis=0)
    # The slot of row k is the first at which k + 1 have been found. (A scatter takes one after the other.)
    wanted = jnp.arange(1, slots + 1)
    at = jax.vmap(lambda found: jnp.searchsorted(found, wanted), in_axes=1, out_axes=1)(found)
    filled = wanted[:, None] <= found[-1][None]
    at = jnp.where(filled, at, 0)
    kept = jax.tree.map(lambda column: jnp.take_along_axis(column, at, axis=0), columns)
    return kept, filled, found[-1].astype(jnp.int32)


def features_of(statistic: StickStatistic, engine: Any, recorded: Recorded, bandwidths: AnyArray) -> Features:
    """The features of all samples; differentiate them to get pathwise and event parts (none without edges).

    `bandwidths` (windows,): how far kernels look, as shares of the parameter.
    """
    dtype = recorded.start.dtype
    t1, bandwidths = jnp.asarray(engine.engine.t1, dtype), jnp.asarray(bandwidths, dtype)

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
    """The sticks as the statistics take them, arrays (lanes, slots)."""
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
    """The event parts of one sample's numerator and denominator for each window, and how many edges they rest on."""
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

    # One after the other: jax 0.10.2 cannot map over them where this is differentiated inside of a loop.
    events, reached = zip(*(window(bandwidth) for bandwidth in bandwidths), strict=True)
    return jnp.stack(events), jnp.stack(reached)


def _jump_of_stick(parts: Any, sticks: StickSequence, time: Array, exists: Any) -> Array:
    """What a stick of no length at `time` adds; the one that is there, if it `exists`, is taken away first."""
    index = jnp.argmin(jnp.where(sticks.mask, jnp.abs(sticks.start - time), jnp.inf))
    found = exists & sticks.mask[index] & _same(sticks.start[index], time)
    without = jax.tree.map(lambda a, b: jnp.where(found, a, b), _without(sticks, index), sticks)
    return parts(_with(without, time)) - parts(without)


def _jump_of_slip(parts: Any, sticks: StickSequence, time: Array, exists: Array) -> Array:
    """What a slip of no length at `time` changes, by which one stick becomes two; zero where it is in none.

    If the slip `exists`, from `time` on, what it parts is made one first.
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
    """The sequence with one stick more."""
    numbers = jnp.arange(len(sticks.mask))
    place = jnp.sum(sticks.mask & (sticks.start < time))

    def put(column, value):
        return jnp.where(numbers < place, column, jnp.where(numbers == place, value, jnp.roll(column, 1)))

    return StickSequence(put(sticks.start, time), put(sticks.duration, duration), put(sticks.mask, True))


def _where(chosen: Array, new: Array, old: Array) -> Array:
    return jnp.where(chosen.reshape(chosen.shape + (1,) * (new.ndim - 1)), new, old)
