"""The segments of one realisation in arrays, for look-up by time."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, BoolArray, FloatArray, KeyData
from .segments import Segment, SegmentLaw, first_segment, following_segment


class SegmentTable(eqx.Module):
    """Segments in order of time, arrays (segments,); unused ones begin at infinity.

    `end`: where the last one ends, s. `jumps`: whether the value jumps between segments.
    """

    segments: Segment
    end: Array
    jumps: bool = eqx.field(static=True)

    @classmethod
    def of(cls, law: SegmentLaw, key_data: KeyData, number: int, dtype) -> "SegmentTable":
        """The first `number` segments of the realisation that `key_data` draw."""

        def step(segment_state, _):
            segment = segment_state.segment._replace(
                begin=jnp.where(segment_state.spent, jnp.inf, segment_state.segment.begin)
            )
            return following_segment(law, segment_state, dtype), segment

        segment_state, segments = lax.scan(step, first_segment(law, key_data, dtype), None, length=number)
        return cls(segments, segment_state.segment.begin, law.jumps)

    def at(self, t: FloatArray) -> Segment:
        """The segment at time `t` (s); at the instant between two, the second."""
        index = jnp.clip(jnp.searchsorted(self.segments.begin, t, side="right") - 1, 0)
        return jax.tree.map(lambda values: values[index], self.segments)

    def reaches(self, t1: FloatArray) -> BoolArray:
        """Whether the segments last until `t1` (s)."""
        return self.end >= t1
