"""The switched engine: one trajectory and its state at any time, and lanes in which a step is a time step."""

import math
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.errors import ConcretizationTypeError
from jaxtyping import Array

from ..._excitation.excitation import Excitation
from ..._excitation.motion import Signal
from ..._excitation.segments import segment_at
from ..._foundation.types import BoolArray, DType, FloatArray, Number, Scalar
from ..._numerics.derivatives import NotKnown, largest, smallest, with_slopes
from ..._systems.switched_model import Segments, State, SwitchedModel
from ..._systems.system import System
from ..common.lanes import SampleTotals
from ..common.method import Arguments, Exact, max_steps_advice
from ..common.path import (
    MotionPath,
    Run,
    SegmentLaws,
    StepsEngine,
    StepsShared,
    has_ended,
    is_short,
    largest_in_steps,
    of_track,
    padded_length,
    sample_totals,
    status_of_lane,
    stopping_scan,
)
from ..sticks import ALL, StickRecord, no_stick
from .stepping import Lane, advance, start_lane

# One trajectory of the switched engine, and its state at any time.


MOST_STEPS = 2**30  # steps are counted in 32 bits
_SPARE = 4  # times as many steps where it is not known before the call how fast the motion is
_ROOM = 96  # steps more, for short trajectories
_PER_SEGMENT = 8  # time steps in a segment of a record where neither is known


class StepBeginnings(NamedTuple):
    """The beginning of each loop step, arrays (steps,): time (s), state, sign of the mode, and the current segments."""

    t: Array
    y: tuple[Array, ...]
    sign: Array
    segments: Segments

    def at(self, time: FloatArray) -> "StepBeginnings":
        """The beginning of the step that contains `time` (s)."""
        # Of loop steps with the same beginning (tries of one time step), the last is the one that was accepted.
        index = jnp.clip(jnp.searchsorted(self.t, time, side="right") - 1, 0)
        return jax.tree.map(lambda values: values[index], self)


class Trajectory(eqx.Module):
    """Result of one trajectory: its last `Lane`, a `StickRecord` for each loop step, and the beginning of each."""

    lane: Lane
    status: Array
    records: StickRecord
    beginnings: StepBeginnings


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
    segment_states = segment_laws.first(own, dtype)
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
        return StepBeginnings(lane.t, lane.y, lane.sign, segment_laws.segments(lane.segment_states))

    def one_step(lane, _):
        following, record = advance(model, segment_laws, t1, step, lane)
        return following, (record, beginning(lane))

    def idle(lane):
        return no_stick(dtype, ALL, lane.stick_start.shape), beginning(lane)

    lane, (records, beginnings) = stopping_scan(one_step, start, steps, lambda lane, _: has_ended(lane, t1, most), idle)
    return Trajectory(lane, status_of_lane(lane, t1), records, beginnings)


def state_at(
    system: System, excitation: Excitation, solver: Any, beginnings: StepBeginnings, time: FloatArray
) -> State:
    """The state at one `time`, from the beginning of the step that contains it."""
    begun = beginnings.at(time)
    model = system.switched_model(excitation.signal, solver)
    return model.numbers(state_in_step(model, begun, time - begun.t))


def state_in_step(model: SwitchedModel, begun: StepBeginnings, h: FloatArray) -> State:
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
        horizon, shortest = largest(t1), smallest(step)
    except NotKnown:
        # By the number of segments alone, where there is a record.
        if not any(law.is_record for law in laws):
            raise
        try:
            segments = sum(law.segments(t1) for law in laws)
        except ConcretizationTypeError:  # of a law whose segments are not a record's
            raise NotKnown from None
        return padded_length((_PER_SEGMENT + 2) * segments + _ROOM)
    try:
        shortest = min(shortest, smallest(system.time_scales(excitation, None).usual_step))
    except NotKnown:
        shortest /= _SPARE
    segments = sum(law.segments(horizon) for law in laws)
    steps = 1.5 * (horizon / shortest) + 2 * segments + _ROOM
    if steps > MOST_STEPS:
        raise ValueError(
            f"Argument {name} must be shorter: {horizon:g} s hold more than {MOST_STEPS} steps of {shortest:.3g} s or "
            "segments of the motion."
        )
    return padded_length(math.ceil(steps))


# Lanes of the switched engine: a step is a time step, accepted or rejected.


class SwitchedEngine(StepsEngine[Lane]):
    """Time steps in which events are located; slips without closed forms are solved by `solver`."""

    solver: Any

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Signal | None, Lane]:
        y0 = tuple(jnp.asarray(value, dtype) for value in self.y0)
        step = jnp.asarray(self.step_length, dtype)
        lane = lane_at_start(self.system, self.excitation, key_data, y0, step, self.solver, self.quantities)
        return self.smooth(key_data, dtype), lane

    def step(self, shared: StepsShared, sample: Signal | None, motion: Lane, drawn: None) -> tuple[Lane, StickRecord]:
        motion, record = advance(self.system.switched_model(sample, self.solver), *shared, motion)
        return motion, of_track(record, self.system)

    def results(self, sample: Signal | None, motion: Lane) -> SampleTotals:
        status, near = self.status(motion), motion.near_grazing_count
        return sample_totals(self.system, motion.totals, motion.at_start, status, near)


# One trajectory in time steps with located events, and the state along it.


_MOST_KEPT = 2**25  # loop steps whose states are kept: about 3 GB
_MOST_SLOPES = 3  # by more numbers, going back over the steps takes less time
_MOST_DOUBLINGS = 6  # of the number of loop steps, before a trajectory is given up


class StepPath(MotionPath):
    """Path given by the states at the beginnings of time steps."""

    system: System
    excitation: Excitation
    solver: Any
    beginnings: StepBeginnings

    @property
    def times(self) -> Array:
        return self.beginnings.t

    def state(self, time: FloatArray) -> State:
        return state_at(self.system, self.excitation, self.solver, self.beginnings, time)

    def largest(self, number: int, sign: Scalar, last: FloatArray, final: FloatArray) -> FloatArray:
        begun, model = self.beginnings, self.system.switched_model(self.excitation.signal, self.solver)
        lengths = jnp.append(begun.t[1:], last) - begun.t

        def inside(step: StepBeginnings, h: FloatArray) -> tuple[FloatArray, FloatArray]:
            y = state_in_step(model, step, h)
            rates = model.rates(model.forcing(step.t, step.segments), h, y, step.sign)
            return sign * model.numbers(y)[number], sign * model.numbers(rates)[number]

        at_beginnings = jax.vmap(lambda y: model.numbers(y)[number])(begun.y)
        return largest_in_steps(inside, begun, sign * at_beginnings, lengths, sign * final)

    def rates(self, time: FloatArray) -> State:
        """The rates of the state at one time (s), per second; at an event, those after it."""
        begun, model = self.beginnings.at(time), self.system.switched_model(self.excitation.signal, self.solver)
        forcing, h = model.forcing(begun.t, begun.segments), time - begun.t
        return model.numbers(model.rates(forcing, h, model.flow(forcing, begun.y, h, begun.sign), begun.sign))

    @property
    def smooth(self) -> Signal | None:
        return self.excitation.signal

    def segments(self, time: FloatArray) -> Segments:
        return self.beginnings.at(time).segments


def follow_steps(system: System, base: Any, method: Exact, t1: Scalar, y0: tuple[Number, ...], dtype) -> Run:
    """Simulate one trajectory in time steps with located events, again with twice the steps while they are too few."""
    excitation, step = Arguments(system, base, method, t1).checked_step()
    try:
        steps = steps_for(system, excitation, t1, step) if method.max_steps is None else method.max_steps
    except NotKnown:
        raise ValueError(
            "Argument method must give max_steps, Exact(max_steps=...), when t1 or the time scales are arguments of a "
            f"function under jax.jit: {max_steps_advice(system, excitation, method, t1)}."
        ) from None
    if steps > _MOST_KEPT:
        raise ValueError(
            f"Argument t1 must be shorter: {steps} steps would be kept, and at most {_MOST_KEPT} can be; "
            "simulate_ensemble keeps sticks only, for a single sample too."
        )
    run: Run = _follow_steps(system, excitation, method.solver, t1, y0, step, steps=steps, dtype=dtype)
    for _ in range(_MOST_DOUBLINGS if method.max_steps is None else 0):
        if not is_short(run.status):
            break
        steps *= 2
        run = _follow_steps(system, excitation, method.solver, t1, y0, step, steps=steps, dtype=dtype)
    return run


@partial(jax.jit, static_argnames=("steps", "dtype"))
def _follow_steps(system, excitation, solver, t1, y0, step, *, steps, dtype) -> Run:
    run = partial(run_trajectory, steps=steps, dtype=dtype)
    done = with_slopes(run, system, excitation, solver, t1, y0, step, most=_MOST_SLOPES)
    return run_of(system, excitation, solver, done)


def run_of(system: System, excitation: Excitation, solver: Any, done: Trajectory) -> Run:
    """The parts of a `Simulation` of one trajectory."""
    lane = done.lane
    path = StepPath(system, excitation, solver, done.beginnings)
    state = system.switched_model(excitation.signal, solver).numbers(lane.y)
    return Run.of(system, done.records, lane.totals, done.status, lane.t, state, lane.near_grazing_count, path)
