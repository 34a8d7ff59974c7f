"""The pieces of one realisation, laid out in arrays."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, BoolArray, FloatArray
from .segments import Segment, SegmentLaw, first_segment, following_segment


class SegmentTable(eqx.Module):
    """Pieces in order of time, arrays (pieces,); spare ones begin at infinity. `jumps`: whether the value jumps."""

    segments: Segment
    end: Array
    jumps: bool = eqx.field(static=True)

    @classmethod
    def of(cls, law: SegmentLaw, key_data: Any, number: int, dtype) -> "SegmentTable":
        """The first `number` pieces of the motion that `key_data` choose."""

        def step(segment_state, _):
            segment = segment_state.segment._replace(
                begin=jnp.where(segment_state.spent, jnp.inf, segment_state.segment.begin)
            )
            return following_segment(law, segment_state, dtype), segment

        segment_state, segments = lax.scan(step, first_segment(law, key_data, dtype), None, length=number)
        return cls(segments, segment_state.segment.begin, law.jumps)

    def at(self, t: FloatArray) -> Segment:
        """The piece under way at time `t`; at the instant between two, the second."""
        index = jnp.clip(jnp.searchsorted(self.segments.begin, t, side="right") - 1, 0)
        return jax.tree.map(lambda values: values[index], self.segments)

    def reaches(self, t1: FloatArray) -> BoolArray:
        """Whether the pieces last until `t1`."""
        return self.end >= t1
