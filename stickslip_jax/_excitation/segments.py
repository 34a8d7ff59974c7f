"""Motions that come in pieces, one after the other, each linear in time: what laws of such motions offer.

A law tells piece number i from the key, i and what it remembers of the pieces before; so a motion needs no length of
its own, and an ensemble can draw pieces while it simulates.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._types import Array, FloatArray


class Piece(NamedTuple):
    """``value + slope (t - begin)`` for t from `begin` to `end` (s)."""

    begin: FloatArray
    end: FloatArray
    value: FloatArray
    slope: FloatArray


class Feed(NamedTuple):
    """The piece under way of one motion, and what is needed to tell the next; `spent` when there is none."""

    words: tuple[Array, Array]
    number: Array
    memory: Any
    piece: Piece
    spent: Array


class PieceLaw(eqx.Module):
    """What every law of piecewise-linear motions offers.

    `is_random`: whether realisations differ. `jumps`: whether the value jumps from piece to piece; a stick on a base
    whose velocity jumps ends there.
    """

    is_random: ClassVar[bool]
    jumps: ClassVar[bool]

    @abc.abstractmethod
    def pieces(self, t1: Any) -> int:
        """About how many pieces there are on ``[0, t1]``; `t1` (s) is no tracer."""

    @abc.abstractmethod
    def begin(self, words: Any, dtype) -> Any:
        """What is known before the first piece, drawn from the key's words."""

    @abc.abstractmethod
    def draw(self, words: Any, number: Array, dtype) -> Any:
        """What is random (or looked up) about piece `number`, from the key's words and that number alone."""

    @abc.abstractmethod
    def next_piece(self, memory: Any, drawn: Any, dtype) -> tuple[FloatArray, FloatArray, FloatArray, Any]:
        """Duration (s), value at its beginning, slope (1/s) of a piece, and what to remember for the next.

        A duration of 0 says that there is no further piece.
        """


def open_feed(law: PieceLaw, words: Any, dtype) -> Feed:
    """The first piece of the motion that `words` choose."""
    zero = jnp.zeros((), dtype)
    memory = law.begin(words, dtype)
    feed = Feed(
        (words[0], words[1]), jnp.zeros((), jnp.uint32), memory, Piece(zero, zero, zero, zero), jnp.zeros((), bool)
    )
    return next_feed(law, feed, dtype)


def next_feed(law: PieceLaw, feed: Feed, dtype) -> Feed:
    """The piece after the present one."""
    drawn = law.draw(feed.words, feed.number, dtype)
    duration, value, slope, memory = law.next_piece(feed.memory, drawn, dtype)
    value, slope = (jnp.asarray(number, dtype) for number in (value, slope))
    piece = Piece(feed.piece.end, feed.piece.end + duration, value, slope)
    return Feed(feed.words, feed.number + np.uint32(1), memory, piece, ~(duration > 0))


def added(t: FloatArray, pieces: tuple[Piece, ...]) -> tuple[FloatArray, FloatArray]:
    """Value at `t` and slope of the sum of some pieces."""
    value, slope = jnp.zeros_like(t), jnp.zeros_like(t)
    for piece in pieces:
        value, slope = value + piece.value + piece.slope * (t - piece.begin), slope + piece.slope
    return value, slope
