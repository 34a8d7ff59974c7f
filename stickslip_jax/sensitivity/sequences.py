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
from .._types import Array, BoolArray, IntArray
from ..dynamics.interval_lanes import IntervalEngine
from ..dynamics.lanes import BLOCK, Engine, Records
from ..numerics.random_bits import random_words
from .counting import Windows
from .kernels import flux, grazing_weight, regular_weight
from .statistic import StickSequence, StickStatistic


class Recorded(NamedTuple):
    """The sticks of each lane's sample in order of time; the first three (slots, lanes), 0 in spare slots."""

    start: Array
    end: Array
    ending: IntArray
    count: IntArray  # (lanes,), as the following; beyond the slots it tells how many would be needed
    opening: BoolArray  # whether the first interval had a stick
    status: IntArray


class Features(NamedTuple):
    """Of each sample (lanes,): numerator and denominator, with pathwise derivatives; and zeros whose derivatives are
    the event parts; how many sticks and slips the kernels reached.
    """

    parts: tuple[Array, Array]
    events: tuple[Array, Array]
    near: Array


def record_sequences(engine: Engine, words: Array, first: Array, *, lanes: int, slots: int, dtype: Any) -> Recorded:
    """Simulate samples ``first .. first + lanes - 1`` and keep their sticks."""
    number = first + jnp.arange(lanes, dtype=jnp.uint32)
    state = jax.vmap(lambda high, low: engine.begin((high, low), dtype))(*random_words(words, number))
    nothing, zeros = jnp.zeros((slots, lanes), dtype), jnp.zeros(lanes, jnp.int32)
    recorded = Recorded(nothing, nothing, jnp.full((slots, lanes), -1, jnp.int32), zeros, zeros < 0, zeros)
    room = Records.empty(BLOCK, lanes, dtype)

    def go_on(carry):
        return ~jnp.all(engine.ended(carry[0]))

    def block(carry):
        state, recorded, is_first = carry
        # A lane that has ended idles; what it then does is no stick.
        live = ~engine.ended(state)
        following, filled = engine.advance(state, dtype, room, 0)
        assert filled is not None
        state = jax.tree.map(lambda new, old: _where(live, new, old), following, state)
        found = (filled.ending >= 0) & live
        at = recorded.count + jnp.cumsum(found, axis=0) - 1
        at = jnp.where(found, at, slots)
        lane = jnp.arange(lanes)[None, :]
        recorded = recorded._replace(
            start=recorded.start.at[at, lane].set(filled.values[:, 0], mode="drop"),
            end=recorded.end.at[at, lane].set(filled.values[:, 1], mode="drop"),
            ending=recorded.ending.at[at, lane].set(filled.ending.astype(jnp.int32), mode="drop"),
            count=recorded.count + jnp.sum(found, axis=0, dtype=jnp.int32),
            opening=recorded.opening | (found[0] & is_first),
        )
        return state, recorded, jnp.zeros((), bool)

    state, recorded, _ = lax.while_loop(go_on, block, (state, recorded, jnp.ones((), bool)))
    return recorded._replace(status=engine.results(state).status.astype(jnp.int32))


def features_of(
    statistic: StickStatistic, engine: Any, recorded: Recorded, windows: Windows, fixed_start: bool
) -> Features:
    """The features of all samples; differentiate them to get pathwise and event parts."""
    dtype = recorded.start.dtype
    t1 = jnp.asarray(engine.t1, dtype)

    def one(start, end, ending, opening):
        mask = ending >= 0
        sticks = StickSequence(jnp.where(mask, start, 0), jnp.where(mask, end - start, 0), mask)
        # What the first interval holds is no random number with a density where all samples begin alike.
        fixed = opening & fixed_start & isinstance(engine, IntervalEngine)
        random = mask & ~(fixed & (jnp.arange(len(mask)) == 0) & (ending != Ending.BASE_SWITCHED))
        events, near = _events(statistic, sticks, ending, random, windows, t1)
        parts = tuple(jnp.asarray(part, dtype) for part in statistic.parts(sticks, t1))
        return Features((parts[0], parts[1]), events, near)

    return jax.vmap(one, in_axes=(1, 1, 1, 0))(recorded.start, recorded.end, recorded.ending, recorded.opening)


def _events(
    statistic: StickStatistic, sticks: StickSequence, ending: Array, random: Array, windows: Windows, t1: Array
) -> tuple[tuple[Array, Array], Array]:
    """The event parts of one sample's numerator and denominator, and how many sticks and slips they rest on."""
    numbers = jnp.arange(len(sticks.mask))
    fixed = lax.stop_gradient(sticks)

    def parts(sequence):
        return jnp.stack([jnp.asarray(part, fixed.start.dtype) for part in statistic.parts(sequence, t1)])

    def jump_of_stick(i):
        return parts(fixed._replace(duration=fixed.duration.at[i].set(0))) - parts(_without(fixed, i))

    def jump_at_horizon(i):
        before = _first(fixed, i)
        added = StickSequence(before.start.at[i].set(t1), before.duration, before.mask.at[i].set(True))
        return parts(added) - parts(before)

    def jump_of_slip(i):
        # The slip after stick i; its end is moved to its start, and then the sticks are made one.
        following = jnp.minimum(i + 1, len(numbers) - 1)
        length = fixed.duration[i] + fixed.duration[following]
        merged = _without(fixed, following)
        return parts(fixed) - parts(merged._replace(duration=merged.duration.at[i].set(length)))

    end = sticks.start + sticks.duration
    next_start = jnp.concatenate([sticks.start[1:], jnp.zeros(1, end.dtype)])
    has_next = jnp.concatenate([sticks.mask[1:], jnp.zeros(1, bool)])
    duration, slip, left = sticks.duration, next_start - end, t1 - sticks.start
    edges = (
        (duration, grazing_weight(duration, windows.duration), random & (ending != Ending.HORIZON), jump_of_stick),
        (left, regular_weight(left, windows.horizon), random, jump_at_horizon),
        (slip, grazing_weight(slip, windows.duration), has_next & (ending == Ending.RELEASED), jump_of_slip),
    )
    events, near = jnp.zeros(2, end.dtype), jnp.zeros((), jnp.int32)
    for distance, weight, where, jump in edges:
        jumps = jax.vmap(jump)(numbers)
        events = events + jnp.sum(jumps * flux(weight, distance, where)[:, None], axis=0)
        near = near + jnp.sum(where & (weight != 0), dtype=jnp.int32)
    return (events[0], events[1]), near


def _without(sticks: StickSequence, i: Array) -> StickSequence:
    """The sequence without stick `i`."""
    numbers = jnp.arange(len(sticks.mask))
    after = jnp.minimum(numbers + (numbers >= i), len(numbers) - 1)
    mask = sticks.mask[after] & (numbers < jnp.sum(sticks.mask) - 1)
    return StickSequence(jnp.where(mask, sticks.start[after], 0), jnp.where(mask, sticks.duration[after], 0), mask)


def _first(sticks: StickSequence, number: Array) -> StickSequence:
    """The first so many sticks."""
    mask = sticks.mask & (jnp.arange(len(sticks.mask)) < number)
    return StickSequence(jnp.where(mask, sticks.start, 0), jnp.where(mask, sticks.duration, 0), mask)


def _where(chosen: Array, new: Array, old: Array) -> Array:
    return jnp.where(chosen.reshape(chosen.shape + (1,) * (new.ndim - 1)), new, old)
