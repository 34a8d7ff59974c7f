"""The switched engine: one trajectory and its state at any time, and lanes in which a step is a time step."""

import math
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.errors import ConcretizationTypeError
from jaxtyping import Array

from ..._excitation.excitation import Excitation
from ..._excitation.motion import Signal
from ..._excitation.segments import segment_at
from ..._foundation.types import BoolArray, FloatArray, Number, Scalar
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
    is_short,
    largest_in_steps,
    padded_length,
    sample_totals,
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

    def lane(
        self,
        smooth: Signal | None,
        key_data: Any,
        dtype,
        t0: FloatArray | None = None,
        resting: BoolArray | None = None,
    ) -> Lane:
        """As in all engines; at the time `t0` (s), 0 by default.

        `resting`: contacts whose relative velocity is made zero there.
        """
        segment_laws, step = SegmentLaws.of(self.system, self.excitation), jnp.asarray(self.step_length, dtype)
        states = segment_laws.first(self.excitation.segment_key_data(key_data), dtype)
        if t0 is None:
            t0 = jnp.zeros((), dtype)
        else:
            states = tuple(segment_at(law, first, t0) for law, first in zip(segment_laws.all, states, strict=True))
        y0 = tuple(jnp.asarray(value, dtype) for value in self.y0)
        return start_lane(self._model(smooth), segment_laws, states, y0, step, self.quantities, t0, resting)

    def advanced(
        self, shared: StepsShared, smooth: Signal | None, lane: Lane
    ) -> tuple[Lane, StickRecord, StepBeginnings]:
        return *advance(self._model(smooth), *shared, lane), self._beginning(lane)

    def idle(self, lane: Lane) -> tuple[StickRecord, StepBeginnings]:
        return no_stick(lane.t.dtype, ALL, lane.stick_start.shape), self._beginning(lane)

    def run(self, lane: Lane, kept: tuple[StickRecord, StepBeginnings]) -> Run:
        """The parts of a `Simulation` of one trajectory that `follow` gave."""
        (records, beginnings), smooth = kept, self.excitation.signal
        path, state = StepPath(smooth, self.system, self.solver, beginnings), self._model(smooth).numbers(lane.y)
        others = self.status(lane), lane.t, state, lane.near_grazing_count, path
        return Run.of(self.system, records, lane.totals, *others)

    def _model(self, smooth: Signal | None) -> SwitchedModel:
        return self.system.switched_model(smooth, self.solver)

    def _beginning(self, lane: Lane) -> StepBeginnings:
        laws = SegmentLaws.of(self.system, self.excitation)
        return StepBeginnings(lane.t, lane.y, lane.sign, laws.segments(lane.segment_states))

    def results(self, sample: Signal | None, motion: Lane) -> SampleTotals:
        status, near = self.status(motion), motion.near_grazing_count
        return sample_totals(self.system, motion.totals, motion.at_start, status, near)


# One trajectory in time steps with located events, and the state along it.


_MOST_KEPT = 2**25  # loop steps whose states are kept: about 3 GB
_MOST_SLOPES = 3  # by more numbers, going back over the steps takes less time
_MOST_DOUBLINGS = 6  # of the number of loop steps, before a trajectory is given up


class StepPath(MotionPath):
    """Path given by the states at the beginnings of time steps."""

    smooth: Signal | None
    system: System
    solver: Any
    beginnings: StepBeginnings

    @property
    def model(self) -> SwitchedModel:
        """The system under its excitation."""
        return self.system.switched_model(self.smooth, self.solver)

    @property
    def times(self) -> Array:
        return self.beginnings.t

    def state(self, time: FloatArray) -> State:
        begun = self.beginnings.at(time)
        return self.model.numbers(state_in_step(self.model, begun, time - begun.t))

    def largest(self, number: int, sign: Scalar, last: FloatArray, final: FloatArray) -> FloatArray:
        begun, model = self.beginnings, self.model
        lengths = jnp.append(begun.t[1:], last) - begun.t

        def inside(step: StepBeginnings, h: FloatArray) -> tuple[FloatArray, FloatArray]:
            y = state_in_step(model, step, h)
            rates = model.rates(model.forcing(step.t, step.segments), h, y, step.sign)
            return sign * model.numbers(y)[number], sign * model.numbers(rates)[number]

        at_beginnings = jax.vmap(lambda y: model.numbers(y)[number])(begun.y)
        return largest_in_steps(inside, begun, sign * at_beginnings, lengths, sign * final)

    def rates(self, time: FloatArray) -> State:
        """The rates of the state at one time (s), per second; at an event, those after it."""
        begun, model = self.beginnings.at(time), self.model
        forcing, h = model.forcing(begun.t, begun.segments), time - begun.t
        return model.numbers(model.rates(forcing, h, state_in_step(model, begun, h), begun.sign))

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
    engine = SwitchedEngine(system, excitation, t1, y0, step, steps, solver, quantities=ALL)
    return engine.run(*with_slopes(lambda engine: engine.follow(dtype), engine, most=_MOST_SLOPES))
