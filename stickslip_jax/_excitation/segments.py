"""Motions that come in pieces, one after the other, each linear in time: what laws of such motions offer.

A law tells piece number i from the key, i and what it remembers of the pieces before; so a motion needs no length of
its own, and an ensemble can draw pieces while it simulates.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._fields import Checked
from .._types import Array, FloatArray


class Segment(NamedTuple):
    """``value + slope (t - begin)`` for t from `begin` to `end` (s)."""

    begin: FloatArray
    end: FloatArray
    value: FloatArray
    slope: FloatArray


class SegmentState(NamedTuple):
    """The piece under way of one motion, and what is needed to tell the next; `spent` when there is none."""

    key_data: tuple[Array, Array]
    number: Array
    memory: Any
    segment: Segment
    spent: Array


class SegmentLaw(Checked):
    """What every law of piecewise-linear motions offers.

    `is_random`: whether realisations differ. `jumps`: whether the value jumps from piece to piece; a stick on a base
    whose velocity jumps ends there.
    """

    is_random: ClassVar[bool]
    jumps: ClassVar[bool]

    @abc.abstractmethod
    def segments(self, t1: Any) -> int:
        """About how many pieces there are on ``[0, t1]``; `t1` (s) is no tracer."""

    @abc.abstractmethod
    def begin(self, key_data: Any, dtype) -> Any:
        """What is known before the first piece, drawn from the key's words."""

    @abc.abstractmethod
    def draw(self, key_data: Any, number: Array, dtype) -> Any:
        """What is random (or looked up) about piece `number`, from the key's words and that number alone."""

    @abc.abstractmethod
    def next_segment(self, memory: Any, drawn: Any, dtype) -> tuple[FloatArray, FloatArray, FloatArray, Any]:
        """Duration (s), value at its beginning, slope (1/s) of a piece, and what to remember for the next.

        A duration of 0 says that there is no further piece.
        """


def first_segment(law: SegmentLaw, key_data: Any, dtype) -> SegmentState:
    """The first piece of the motion that `key_data` choose."""
    zero = jnp.zeros((), dtype)
    memory = law.begin(key_data, dtype)
    segment_state = SegmentState(
        (key_data[0], key_data[1]),
        jnp.zeros((), jnp.uint32),
        memory,
        Segment(zero, zero, zero, zero),
        jnp.zeros((), bool),
    )
    return following_segment(law, segment_state, dtype)


def following_segment(law: SegmentLaw, segment_state: SegmentState, dtype) -> SegmentState:
    """The piece after the present one."""
    drawn = law.draw(segment_state.key_data, segment_state.number, dtype)
    duration, value, slope, memory = law.next_segment(segment_state.memory, drawn, dtype)
    value, slope = (jnp.asarray(number, dtype) for number in (value, slope))
    segment = Segment(segment_state.segment.end, segment_state.segment.end + duration, value, slope)
    return SegmentState(segment_state.key_data, segment_state.number + np.uint32(1), memory, segment, ~(duration > 0))


def added(t: FloatArray, segments: tuple[Segment, ...]) -> tuple[FloatArray, FloatArray]:
    """Value at `t` and slope of the sum of some pieces."""
    value, slope = jnp.zeros_like(t), jnp.zeros_like(t)
    for segment in segments:
        value, slope = value + segment.value + segment.slope * (t - segment.begin), slope + segment.slope
    return value, slope
