"""One trajectory of the switched engine, and its state at any time."""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.errors import ConcretizationTypeError

from ..._events.stick_quantities import ALL
from ..._events.sticks import StickRecord, no_stick
from ..._excitation.excitation import Excitation
from ..._excitation.segments import SegmentLaw, first_segment, segment_at
from ..._numerics.known import NotKnown, largest, smallest
from ..._systems.switched_model import Segments, State, SwitchedModel
from ..._systems.system import System
from ..._types import Array, BoolArray, DType, FloatArray, Number, Scalar
from ..common.ending import has_ended, status_of_lane
from ..common.segments import SegmentLaws
from ..common.stopping_scan import padded_length, stopping_scan
from .lane import Lane
from .stepping import advance, start_lane

MOST_STEPS = 2**30  # steps are counted in 32 bits
_SPARE = 4  # times as many steps where it is not known before the call how fast the motion is
_ROOM = 96  # steps more, for short trajectories
_PER_SEGMENT = 8  # time steps in a segment of a record where neither is known


class Beginnings(NamedTuple):
    """The beginning of each loop step, arrays (steps,): time (s), state, sign of the mode, and the current segments."""

    t: Array
    y: tuple[Array, ...]
    sign: Array
    segments: Segments

    def at(self, time: FloatArray) -> "Beginnings":
        """The beginning of the step that contains `time` (s)."""
        # Of loop steps with the same beginning (tries of one time step), the last is the one that was accepted.
        index = jnp.clip(jnp.searchsorted(self.t, time, side="right") - 1, 0)
        return jax.tree.map(lambda values: values[index], self)


class Trajectory(eqx.Module):
    """Result of one trajectory: its last `Lane`, a `StickRecord` for each loop step, and the beginning of each."""

    lane: Lane
    status: Array
    records: StickRecord
    beginnings: Beginnings


def lane_at_start(
    system: System,
    excitation: Excitation,
    key_data: Any,
    y0: tuple[Number, ...],
    step: FloatArray,
    solver: Any,
    quantities: tuple[str, ...],
    t0: FloatArray | None = None,
    resting: BoolArray | None = None,
) -> Lane:
    """The lane at the beginning of the trajectory that `key_data` choose, at the time `t0` (s), 0 by default.

    `resting`: contacts whose relative velocity is made zero there.
    """
    dtype = step.dtype
    segment_laws = SegmentLaws.of(system, excitation)
    model = system.switched_model(excitation.realized(key_data, dtype), solver)
    own = excitation.segment_key_data(key_data)
    segment_states = tuple(first_segment(law, own, dtype) for law in segment_laws.all)
    if t0 is None:
        t0 = jnp.zeros((), dtype)
    else:
        pairs = zip(segment_laws.all, segment_states, strict=True)
        segment_states = tuple(segment_at(law, first, t0) for law, first in pairs)
    return start_lane(model, segment_laws, segment_states, y0, step, quantities, t0, resting)


def run_trajectory(
    system: System,
    excitation: Excitation,
    solver: Any,
    t1: Scalar,
    y0: tuple[Number, ...],
    step: Scalar,
    *,
    steps: int,
    dtype: DType,
    t0: FloatArray | None = None,
    resting: BoolArray | None = None,
) -> Trajectory:
    """Simulate one realisation in at most `steps` loop steps, from `t0` (s, 0 by default) to `t1` (s).

    The loop idles once the trajectory has ended. `resting`: contacts whose relative velocity is made zero at `t0`.
    """
    t1, step = jnp.asarray(t1, dtype), jnp.asarray(step, dtype)
    segment_laws, model = SegmentLaws.of(system, excitation), system.switched_model(excitation.signal, solver)
    start = lane_at_start(system, excitation, jnp.zeros(2, jnp.uint32), y0, step, solver, ALL, t0, resting)
    most = jnp.asarray(steps, jnp.int32)

    def beginning(lane):
        return Beginnings(lane.t, lane.y, lane.sign, segment_laws.segments(lane.segment_states))

    def one_step(lane, _):
        following, record = advance(model, segment_laws, t1, step, lane)
        return following, (record, beginning(lane))

    def idle(lane):
        return no_stick(dtype, ALL, lane.stick_start.shape), beginning(lane)

    lane, (records, beginnings) = stopping_scan(one_step, start, steps, lambda lane, _: has_ended(lane, t1, most), idle)
    return Trajectory(lane, status_of_lane(lane, t1), records, beginnings)


def state_at(system: System, excitation: Excitation, solver: Any, beginnings: Beginnings, time: FloatArray) -> State:
    """The state at one `time`, from the beginning of the step that contains it."""
    begun = beginnings.at(time)
    model = system.switched_model(excitation.signal, solver)
    return model.numbers(state_in_step(model, begun, time - begun.t))


def state_in_step(model: SwitchedModel, begun: Beginnings, h: FloatArray) -> State:
    """The state at `h` (s) after the beginning of one step."""
    _, y, sign, segments = begun
    return model.flow(model.forcing(begun.t, segments), y, h, sign)


def steps_for(system: System, excitation: Excitation, t1: Scalar, step: Scalar, name: str = "t1") -> int:
    """Number of loop steps that suffices for nearly every trajectory: by the time steps and segments until `t1`.

    Rounded up by `padded_length`, so that similar lengths share a compilation; the loop stops when the trajectory ends.
    Where a number that it depends on is traced, it follows from the lengths of records. Raises NotKnown where there are
    none, ValueError for more steps than 32 bits can count: argument `name` is too long.
    """
    laws = SegmentLaws.of(system, excitation).all
    try:
        horizon, shortest = largest(t1), _shortest(system, excitation, step)
    except NotKnown:
        return _steps_by_length(laws, t1)
    segments = sum(law.segments(horizon) for law in laws)
    steps = 1.5 * (horizon / shortest) + 2 * segments + _ROOM
    if steps > MOST_STEPS:
        raise ValueError(
            f"Argument {name} must be shorter: {horizon:g} s hold more than {MOST_STEPS} steps of {shortest:.3g} s or "
            "segments of the motion."
        )
    return padded_length(math.ceil(steps))


def _steps_by_length(laws: tuple[SegmentLaw, ...], t1: Scalar) -> int:
    """The number of loop steps by the number of segments alone, where there is a record. Else raises NotKnown."""
    if not any(law.is_record for law in laws):
        raise NotKnown
    try:
        segments = sum(law.segments(t1) for law in laws)
    except ConcretizationTypeError:  # of a law whose segments are not a record's
        raise NotKnown from None
    return padded_length((_PER_SEGMENT + 2) * segments + _ROOM)


def _shortest(system: System, excitation: Excitation, step: Scalar) -> float:
    """The length of most time steps, s."""
    shortest = smallest(step)
    try:
        return min(shortest, smallest(system.usual_step(excitation)))
    except NotKnown:
        return shortest / _SPARE
