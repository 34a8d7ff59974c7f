"""The segments of one realisation in arrays, for look-up by time."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, BoolArray, FloatArray, KeyData
from .segments import Segment, SegmentLaw, first_segment, following_segment, is_invalid


class SegmentTable(eqx.Module):
    """Segments in order of time, arrays (segments,); unused ones begin at infinity.

    Attributes:
        segments: In order of time.
        end: Where the last one ends, s.
        is_invalid: Whether an impossible one follows there.
        jumps: Whether the value jumps between segments.
    """

    segments: Segment
    end: Array
    is_invalid: Array
    jumps: bool = eqx.field(static=True)

    @classmethod
    def of(cls, law: SegmentLaw, key_data: KeyData, number: int, dtype) -> "SegmentTable":
        """The first `number` segments of the realisation that `key_data` draw."""

        def step(segment_state, _):
            segment = segment_state.segment._replace(
                begin=jnp.where(segment_state.spent, jnp.inf, segment_state.segment.begin)
            )
            following = following_segment(law, segment_state, dtype)
            # After the last segment, whatever the law may give.
            following = jax.tree.map(partial(jnp.where, segment_state.spent), segment_state, following)
            return following, segment

        after, segments = lax.scan(step, first_segment(law, key_data, dtype), None, length=number)
        return cls(segments, after.segment.begin, is_invalid(after), law.jumps)

    def at(self, t: FloatArray) -> Segment:
        """The segment at time `t` (s); at the instant between two, the second."""
        index = jnp.clip(jnp.searchsorted(self.segments.begin, t, side="right") - 1, 0)
        return jax.tree.map(lambda values: values[index], self.segments)

    def reaches(self, t1: FloatArray) -> BoolArray:
        """Whether the segments last until `t1` (s)."""
        return self.end >= t1
