"""Whether a trajectory in time steps has ended, and why."""

from contextlib import suppress
from typing import Any

import jax.numpy as jnp

from ..._excitation.segments import is_invalid
from ..._numerics.known import NotKnown, largest
from ..._status import Status
from ..._types import BoolArray, FloatArray, IntArray


def status_of_lane(lane: Any, t1: FloatArray) -> IntArray:
    """The `Status` of a trajectory that has ended or is given up."""
    finite = jnp.isfinite(lane.t + t1)
    for value in lane.y:
        finite = finite & _all(jnp.isfinite(value))
    unfinished = jnp.where(is_spent(lane), Status.BASE_TOO_SHORT, Status.OUT_OF_STEPS)
    code = jnp.where(finite, jnp.where(lane.t < t1, unfinished, Status.FINISHED), Status.NOT_FINITE)
    for segment_state in lane.segment_states:  # one that cannot be may have made the state infinite
        code = jnp.where(is_invalid(segment_state) & ~(lane.t >= t1), Status.BASE_INVALID, code)
    return code.astype(jnp.int8)


def has_ended(lane: Any, t1: FloatArray, most_steps: IntArray) -> BoolArray:
    """Whether the trajectory has ended: by the horizon, the end of the base motion, a NaN, or too many loop steps."""
    finite = jnp.ones((), bool)
    for value in lane.y:
        finite = finite & _all(jnp.isfinite(value))
    return ~(lane.t < t1) | is_spent(lane) | (lane.steps >= most_steps) | ~finite


def is_short(status: Any) -> bool:
    """Whether a trajectory, or one of a batch, ran out of steps; False where the status is traced."""
    with suppress(NotKnown):
        return largest(status == Status.OUT_OF_STEPS) > 0
    return False


def is_spent(lane: Any) -> BoolArray:
    """Whether some part of the excitation has no further segment."""
    spent = jnp.zeros((), bool)
    for segment_state in lane.segment_states:
        spent = spent | segment_state.spent
    return spent


def _all(each: BoolArray) -> BoolArray:
    return each if each.ndim == 0 else jnp.all(each)
