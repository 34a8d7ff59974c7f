"""One trajectory in time steps with located events, and the state along it."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._excitation.excitation import Excitation
from ..._excitation.smooth import Signal
from ..._numerics.known import NotKnown
from ..._numerics.slopes import with_slopes
from ..._systems.switched_model import Segments, State
from ..._systems.system import System
from ..._types import FloatArray, Number, Scalar
from ..common.ending import is_short
from ..common.extremes import largest_in_steps
from ..common.method import Exact
from ..common.path import Path, Run
from ..common.time_scales import max_steps_advice
from ..common.tracks import sticks_and_totals
from ..common.validation import Arguments
from .run import Beginnings, Trajectory, run_trajectory, state_at, state_in_step, steps_for

_MOST_KEPT = 2**25  # loop steps whose states are kept: about 3 GB
_MOST_SLOPES = 3  # by more numbers, going back over the steps takes less time
_MOST_DOUBLINGS = 6  # of the number of loop steps, before a trajectory is given up


class StepPath(Path):
    """Path given by the states at the beginnings of time steps."""

    system: System
    excitation: Excitation
    solver: Any
    beginnings: Beginnings

    @property
    def times(self) -> Array:
        return self.beginnings.t

    def state(self, time: FloatArray) -> State:
        return state_at(self.system, self.excitation, self.solver, self.beginnings, time)

    def largest(self, number: int, sign: Scalar, last: FloatArray, final: FloatArray) -> FloatArray:
        begun, model = self.beginnings, self.system.switched_model(self.excitation.signal, self.solver)
        lengths = jnp.append(begun.t[1:], last) - begun.t

        def inside(step: Beginnings, h: FloatArray) -> tuple[FloatArray, FloatArray]:
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
    sticks, totals, of_all = sticks_and_totals(done.records, lane.totals, system)
    return Run(sticks, totals, done.status, lane.t, state, lane.near_grazing_count, path, of_all)
