"""The parts of an excitation that consist of segments, as a trajectory passes through them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._excitation.excitation import Excitation
from ..._excitation.segments import SegmentLaw, SegmentState, following_segment
from ..._systems.switched_model import Segments
from ..._systems.system import System
from ..._types import BoolArray, FloatArray


class SegmentLaws(eqx.Module):
    """The laws of all parts of the excitation that consist of segments; a lane's `segment_states` have their order."""

    base: tuple[SegmentLaw, ...]
    ground: tuple[SegmentLaw, ...]
    force: tuple[SegmentLaw, ...]
    normal: tuple[SegmentLaw, ...]

    @classmethod
    def of(cls, system: System, excitation: Excitation) -> "SegmentLaws":
        """The parts of excitation, force and normal forces that consist of segments."""
        return cls(excitation.base, excitation.ground, system.recorded_loads, system.recorded_normal_forces)

    @property
    def all(self) -> tuple[SegmentLaw, ...]:
        return self.base + self.ground + self.force + self.normal

    def segments(self, segment_states: tuple[SegmentState, ...]) -> Segments:
        """The current segments."""
        now = tuple(segment_state.segment for segment_state in segment_states)
        ends = np.cumsum([len(self.base), len(self.ground), len(self.force)])
        return Segments(now[: ends[0]], now[ends[0] : ends[1]], now[ends[1] : ends[2]], now[ends[2] :])


def following_segments(
    segment_laws: SegmentLaws, segment_states: tuple[SegmentState, ...], t: FloatArray, ended: BoolArray
) -> tuple[tuple[SegmentState, ...], BoolArray]:
    """The current segments after time `t`, and whether a base velocity jumped there. `ended`: whether the step reached
    the end of a segment.
    """
    following, jumped = [], jnp.zeros((), bool)
    for law, segment_state in zip(segment_laws.all, segment_states, strict=True):
        over = ended & (segment_state.segment.end <= t)
        new = following_segment(law, segment_state, t.dtype)
        following.append(jax.tree.map(lambda new, old, over=over: jnp.where(over, new, old), new, segment_state))
        if law.jumps:  # but not from a value to the same
            before = segment_state.segment
            jumped = jumped | (over & (new.segment.value != before.value + before.slope * (before.end - before.begin)))
    return tuple(following), jumped


def to_digits(t: FloatArray, step: FloatArray) -> FloatArray:
    """The `step` (s) by which the time `t` moves on in fact: what it is rounded by would add up, over many steps."""
    moves = (t + step) - t
    return jnp.where(moves > 0, moves, step)
