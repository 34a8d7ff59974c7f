"""Piecewise-linear functions of time: base velocities, ground accelerations and forces, segment by segment.

A law computes segment number i from the key, i, and a memory of the segments before. So a realisation has no fixed
length, and an ensemble can draw segments while it simulates.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._fields import Checked
from .._types import Array, FloatArray, KeyData, Scalar


class Segment(NamedTuple):
    """One linear segment: ``value + slope (t - begin)`` for t from `begin` to `end` (s)."""

    begin: FloatArray
    end: FloatArray
    value: FloatArray
    slope: FloatArray


class SegmentState(NamedTuple):
    """The present segment of one realisation, and what the next follows from; `spent` after the last one."""

    key_data: tuple[Array, Array]
    number: Array
    memory: Any
    segment: Segment
    spent: Array


class SegmentLaw(Checked):
    """Base class of the laws of piecewise-linear functions of time.

    `is_random`: whether realisations differ. `jumps`: whether the value jumps between segments; a stick on a base
    whose velocity jumps ends there.
    """

    is_random: ClassVar[bool]
    jumps: ClassVar[bool]

    @abc.abstractmethod
    def segments(self, t1: Scalar) -> int:
        """About how many segments there are on ``[0, t1]``; `t1` (s) must not be traced."""

    @abc.abstractmethod
    def begin(self, key_data: KeyData, dtype) -> Any:
        """The memory before the first segment, drawn by the key data."""

    @abc.abstractmethod
    def draw(self, key_data: KeyData, number: Array, dtype) -> Any:
        """What is random (or looked up) about segment `number`, from the key data and that number alone."""

    @abc.abstractmethod
    def next_segment(self, memory: Any, drawn: Any, dtype) -> tuple[FloatArray, FloatArray, FloatArray, Any]:
        """Duration (s), value at its beginning and slope (value per s) of a segment, and the memory for the next.

        A duration of 0 means that there is no further segment.
        """


def first_segment(law: SegmentLaw, key_data: KeyData, dtype) -> SegmentState:
    """The first segment of the realisation that `key_data` draw."""
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
    """The segment after the present one."""
    drawn = law.draw(segment_state.key_data, segment_state.number, dtype)
    duration, value, slope, memory = law.next_segment(segment_state.memory, drawn, dtype)
    value, slope = (jnp.asarray(number, dtype) for number in (value, slope))
    segment = Segment(segment_state.segment.end, segment_state.segment.end + duration, value, slope)
    return SegmentState(segment_state.key_data, segment_state.number + np.uint32(1), memory, segment, ~(duration > 0))


def added(t: FloatArray, segments: tuple[Segment, ...]) -> tuple[FloatArray, FloatArray]:
    """Value at `t` and slope of the sum of `segments`."""
    value, slope = jnp.zeros_like(t), jnp.zeros_like(t)
    for segment in segments:
        value, slope = value + segment.value + segment.slope * (t - segment.begin), slope + segment.slope
    return value, slope
