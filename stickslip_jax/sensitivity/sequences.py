"""Statistics of recorded stick sequences whose derivatives are those of their expectations.

The derivative of a realisation's functional with the number of sticks held fixed is the pathwise part. The event part
comes from sticks near the edge of existence (`kernels.py`): of each the functional's jump is what a stick of no length
in its place adds. There are three edges: the duration of a stick falls to 0; its start passes the horizon; a slip
between two sticks falls to 0, where they become one.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .._status import Ending
from .._types import AnyArray, Array, BoolArray, IntArray
from ..dynamics.interval_lanes import IntervalEngine
from ..dynamics.lanes import BLOCK, Engine, Records
from ..numerics.random_bits import random_words
from .kernels import ending as ending_at
from .kernels import flux, grazing_weight
from .statistic import StickSequence, StickStatistic


class Recorded(NamedTuple):
    """The sticks of each lane's sample in order of time; the first three (slots, lanes), 0 in spare slots."""

    start: Array
    end: Array
    ending: IntArray
    count: IntArray  # (lanes,), as the following; beyond the slots it tells how many would be needed
    opening: BoolArray  # whether the first interval had a stick
    status: IntArray


class Spans(NamedTuple):
    """How far kernels reach: in durations (s), and over how large a share of the parameter; several to choose from
    (windows,).
    """

    durations: AnyArray
    reaches: AnyArray


class Features(NamedTuple):
    """Of each sample: numerator and denominator (lanes, 2), with pathwise derivatives; zeros (lanes, windows, 2) whose
    derivatives are the event parts; how many sticks and slips each window reached (lanes, windows).
    """

    parts: Array
    events: Array
    near: Array


def record_sequences(
    engine: Engine, words: Array, first: Array, *, lanes: int, blocks: int, slots: int, dtype: Any
) -> Recorded:
    """Simulate samples ``first .. first + lanes - 1`` for up to so many blocks, and keep their sticks."""
    number = first + jnp.arange(lanes, dtype=jnp.uint32)
    state = jax.vmap(lambda high, low: engine.begin((high, low), dtype))(*random_words(words, number))
    room = Records.empty(BLOCK, lanes, dtype)

    def advance(state):
        # A lane that has ended idles: nothing happens after the horizon.
        following, filled = engine.advance(state, dtype, room, 0)
        live = ~engine.ended(state)
        return jax.tree.map(lambda new, old: _where(live, new, old), following, state), filled

    def block(state, _):
        return lax.cond(jnp.all(engine.ended(state)), lambda state: (state, room), advance, state)

    state, filled = lax.scan(block, state, None, length=blocks)
    room = Records(filled.values.reshape(-1, 3, lanes), filled.ending.reshape(-1, lanes))
    found = jnp.cumsum(room.ending >= 0, axis=0)
    # The slot of stick k is the first at which k + 1 have been found. (Scattering would do it at once, but jaxlib
    # 0.10.2 breaks down compiling that with the options of `enable_fast_cpu`.)
    wanted = jnp.arange(1, slots + 1)
    at = jax.vmap(lambda found: jnp.searchsorted(found, wanted), in_axes=1, out_axes=1)(found)
    exists = wanted[:, None] <= found[-1]
    at = jnp.where(exists, at, 0)
    start, end = (jnp.where(exists, jnp.take_along_axis(room.values[:, i], at, axis=0), 0) for i in (0, 1))
    ending = jnp.where(exists, jnp.take_along_axis(room.ending, at, axis=0), -1).astype(jnp.int32)
    status = jnp.asarray(engine.results(state).status, jnp.int32)
    return Recorded(start, end, ending, found[-1].astype(jnp.int32), room.ending[0] >= 0, status)


def features_of(
    statistic: StickStatistic, engine: Any, recorded: Recorded, spans: Spans, fixed_start: bool
) -> Features:
    """The features of all samples; differentiate them to get pathwise and event parts."""
    dtype = recorded.start.dtype
    t1 = jnp.asarray(engine.t1, dtype)

    def one(sticks, ending, opening):
        # What the first interval holds is no random number with a density where all samples begin alike.
        fixed = opening & fixed_start & isinstance(engine, IntervalEngine)
        first = jnp.arange(len(ending)) == 0
        random = sticks.mask & ~(fixed & first & (ending != Ending.BASE_SWITCHED))
        events, near = _events(statistic, sticks, ending, random, spans, t1)
        return Features(stacked_parts(statistic, sticks, t1), events, near)

    return jax.vmap(one)(sequences_of(recorded), recorded.ending.T, recorded.opening)


def sequences_of(recorded: Recorded) -> StickSequence:
    """The sticks as the statistics take them, arrays (lanes, slots)."""
    mask = (recorded.ending >= 0).T
    return StickSequence(
        jnp.where(mask, recorded.start.T, 0), jnp.where(mask, (recorded.end - recorded.start).T, 0), mask
    )


def _events(
    statistic: StickStatistic, sticks: StickSequence, ending: Array, random: Array, spans: Spans, t1: Array
) -> tuple[Array, Array]:
    """The event parts of one sample's numerator and denominator for each window, and how many sticks and slips they
    rest on.
    """
    numbers = jnp.arange(len(sticks.mask))
    fixed = lax.stop_gradient(sticks)

    def parts(sequence):
        return stacked_parts(statistic, sequence, t1)

    def jump_of_stick(i):
        return parts(fixed._replace(duration=jnp.where(numbers == i, 0, fixed.duration))) - parts(_without(fixed, i))

    def jump_at_horizon(i):
        before = _first(fixed, i)
        here = numbers == i
        added = StickSequence(jnp.where(here, t1, before.start), before.duration, before.mask | here)
        return parts(added) - parts(before)

    def jump_of_slip(i):
        # The slip after stick i; its end is moved to its start, and then the sticks are made one.
        following = jnp.minimum(i + 1, len(numbers) - 1)
        length = fixed.duration[i] + fixed.duration[following]
        merged = _without(fixed, following)
        return parts(fixed) - parts(merged._replace(duration=jnp.where(numbers == i, length, merged.duration)))

    end = sticks.start + sticks.duration
    next_start = jnp.concatenate([sticks.start[1:], jnp.zeros(1, end.dtype)])
    has_next = jnp.concatenate([sticks.mask[1:], jnp.zeros(1, bool)])
    duration, slip, left = sticks.duration, next_start - end, t1 - sticks.start
    wide, reach = spans.durations[:, None], jnp.broadcast_to(spans.reaches[:, None], (len(spans.reaches), len(numbers)))
    is_over = random & (ending != Ending.HORIZON)
    at_rest = sticks.start == 0  # from the first instant: no arc arrives there, so none grazes

    def by_duration(length, where):
        weight = grazing_weight(length, wide)
        return flux(weight, length, where), where & (weight != 0)

    def by_reach(length, where):
        length, where = (jnp.broadcast_to(column, reach.shape) for column in (length, where))
        return ending_at(length, reach, where)

    edges = (
        (*by_duration(duration, is_over & ~at_rest), jump_of_stick),
        (*by_duration(slip, has_next & (ending == Ending.RELEASED)), jump_of_slip),
        (by_reach(duration, is_over & at_rest), jnp.zeros_like(wide, bool), jump_of_stick),
        (by_reach(left, random), jnp.zeros_like(wide, bool), jump_at_horizon),
    )
    events, near = jnp.zeros((len(wide), 2), end.dtype), jnp.zeros(len(wide), jnp.int32)
    for flow, reached, jump in edges:
        events = events + jnp.sum(flow[:, :, None] * jax.vmap(jump)(numbers), axis=1)
        near = near + jnp.sum(reached, axis=1, dtype=jnp.int32)
    return events, near


def stacked_parts(statistic: StickStatistic, sticks: StickSequence, t1: Array) -> Array:
    """Numerator and denominator as one array."""
    return jnp.stack([jnp.asarray(part, sticks.start.dtype) for part in statistic.parts(sticks, t1)])


def _without(sticks: StickSequence, i: Array) -> StickSequence:
    """The sequence without stick `i`."""
    numbers = jnp.arange(len(sticks.mask))
    start, duration, mask = (jnp.where(numbers < i, column, jnp.roll(column, -1)) for column in sticks)
    mask = mask & (numbers < jnp.sum(sticks.mask) - 1)
    return StickSequence(jnp.where(mask, start, 0), jnp.where(mask, duration, 0), mask)


def _first(sticks: StickSequence, number: Array) -> StickSequence:
    """The first so many sticks."""
    mask = sticks.mask & (jnp.arange(len(sticks.mask)) < number)
    return StickSequence(jnp.where(mask, sticks.start, 0), jnp.where(mask, sticks.duration, 0), mask)


def _where(chosen: Array, new: Array, old: Array) -> Array:
    return jnp.where(chosen.reshape(chosen.shape + (1,) * (new.ndim - 1)), new, old)
