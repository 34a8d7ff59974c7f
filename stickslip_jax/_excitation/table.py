"""The pieces of one realisation, laid out in arrays."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, BoolArray, FloatArray
from .segments import Piece, PieceLaw, next_feed, open_feed


class PieceTable(eqx.Module):
    """Pieces in order of time, arrays (pieces,); spare ones begin at infinity. `jumps`: whether the value jumps."""

    pieces: Piece
    end: Array
    jumps: bool = eqx.field(static=True)

    @classmethod
    def of(cls, law: PieceLaw, words: Any, number: int, dtype) -> "PieceTable":
        """The first `number` pieces of the motion that `words` choose."""

        def step(feed, _):
            piece = feed.piece._replace(begin=jnp.where(feed.spent, jnp.inf, feed.piece.begin))
            return next_feed(law, feed, dtype), piece

        feed, pieces = lax.scan(step, open_feed(law, words, dtype), None, length=number)
        return cls(pieces, feed.piece.begin, law.jumps)

    def at(self, t: FloatArray) -> Piece:
        """The piece under way at time `t`; at the instant between two, the second."""
        index = jnp.clip(jnp.searchsorted(self.pieces.begin, t, side="right") - 1, 0)
        return jax.tree.map(lambda values: values[index], self.pieces)

    def reaches(self, t1: FloatArray) -> BoolArray:
        """Whether the pieces last until `t1`."""
        return self.end >= t1
