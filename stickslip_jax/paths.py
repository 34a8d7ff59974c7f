"""One trajectory by either engine, and the state along it: what a `Simulation` is made of."""

import abc
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ._status import Status
from ._types import FloatArray, Scalar
from .base_motion.drive import Drive
from .base_motion.piecewise import VelocitySteps
from .dynamics.given_intervals import Given, beginnings, final_motion, ordered_sticks
from .dynamics.interval_engine import (
    Motion,
    Totals,
    cross_interval,
    scales_of,
    start_motion,
    start_totals,
    status_of,
)
from .dynamics.method import Exact
from .dynamics.switched_run import Beginnings, base_velocity_at, run_trajectory, state_at, turns_for
from .dynamics.time_scales import room_to_give
from .events import Sticks, sticks_in_order
from .numerics.known import NotKnown, largest
from .set_up import checked_step
from .systems.mass_spring import MassSpring
from .systems.switched_model import State

_MOST_KEPT = 2**25  # turns of the loop whose states are kept: about 3 GB
_MOST_DOUBLINGS = 6  # of the turns of the loop, before a trajectory is given up


class Path(eqx.Module):
    """What is needed to tell the state at any time."""

    @property
    @abc.abstractmethod
    def times(self) -> Array:
        """When the pieces of the path begin, s."""

    @abc.abstractmethod
    def state(self, time: FloatArray) -> State:
        """The state at one time (s)."""

    @abc.abstractmethod
    def base_velocity(self, time: FloatArray) -> FloatArray:
        """The base velocity at one time (s), m/s."""


class IntervalPath(Path):
    """The states at the beginnings of the base's intervals."""

    system: MassSpring
    base: VelocitySteps
    t1: Scalar
    beginnings: Motion

    @property
    def times(self) -> Array:
        return self.beginnings.t

    def state(self, time: FloatArray) -> State:
        scales = scales_of(self.system, self.t1, time.dtype)
        began, velocity = jax.tree.map(
            lambda values: values[self._index(time)], (self.beginnings, self.base.velocities)
        )
        motion, _, _ = cross_interval(scales, began, start_totals(time.dtype), time - began.t, velocity)
        return motion.x, motion.p * scales.omega

    def base_velocity(self, time: FloatArray) -> FloatArray:
        return self.base.velocities[self._index(time)].astype(time.dtype)

    def _index(self, time: FloatArray) -> Array:
        # Among intervals that begin together (spare slots of no length), the last: it is the one that lasts.
        return jnp.clip(jnp.searchsorted(self.beginnings.t, time, side="right") - 1, 0)


class StepPath(Path):
    """The states at the beginnings of time steps."""

    system: Any
    drive: Drive
    solver: Any
    beginnings: Beginnings

    @property
    def times(self) -> Array:
        return self.beginnings.t

    def state(self, time: FloatArray) -> State:
        return state_at(self.system, self.drive, self.solver, self.beginnings, time)

    def base_velocity(self, time: FloatArray) -> FloatArray:
        return base_velocity_at(self.drive, self.beginnings, time)


class Run(NamedTuple):
    """One trajectory, as a `Simulation` names its parts."""

    sticks: Sticks
    totals: Totals
    status: Array
    time_reached: Array
    final_state: State
    doubts: Array
    path: Path


@partial(jax.jit, static_argnames="dtype")
def follow_intervals(system: MassSpring, base: VelocitySteps, t1: Scalar, y0: tuple[Any, ...], dtype) -> Run:
    """One trajectory in closed form, interval by interval."""
    scales = scales_of(system, t1, dtype)
    # Nothing later than t1 matters; cutting here keeps infinite durations out of all arithmetic.
    durations = jnp.where(base.durations >= t1, t1, base.durations).astype(dtype)
    motion = start_motion(scales, (y0[0], y0[1]))
    given = Given(scales, motion, durations, base.velocities.astype(dtype))
    final, totals = final_motion(given)
    final_state = (final.x, final.p * scales.omega)
    path = IntervalPath(system, base, t1, beginnings(given))
    none = jnp.zeros((), jnp.int32)
    records = ordered_sticks(given)
    sticks = Sticks(*records, records.ending >= 0)
    return Run(sticks, totals, status_of(final, scales.t1), final.t, final_state, none, path)


def follow_steps(system: Any, base: Any, method: Exact, t1: Scalar, y0: tuple[Any, ...], dtype) -> Run:
    """One trajectory in time steps with located switches; again with more steps where they did not suffice."""
    drive, step = checked_step(system, base, method, t1)
    try:
        turns = turns_for(system, drive, t1, step) if method.max_steps is None else method.max_steps
    except NotKnown:
        raise ValueError(
            "Argument method must give max_steps, Exact(max_steps=...), when t1 or the time scales are arguments of a "
            f"function under jax.jit: {room_to_give(system, drive, method, t1)}."
        ) from None
    if turns > _MOST_KEPT:
        raise ValueError(
            f"Argument t1 must be shorter: {turns} steps would be kept, and at most {_MOST_KEPT} can be; "
            "simulate_ensemble keeps sticks only, for a single sample too."
        )
    run: Run = _follow_steps(system, drive, method.solver, t1, y0, step, turns=turns, dtype=dtype)
    for _ in range(_MOST_DOUBLINGS if method.max_steps is None else 0):
        if not _is_short(run):
            break
        turns *= 2
        run = _follow_steps(system, drive, method.solver, t1, y0, step, turns=turns, dtype=dtype)
    return run


def _is_short(run: Run) -> bool:
    """Whether steps did not suffice, of a single trajectory or in a batch, if that is known."""
    with suppress(NotKnown):
        return largest(run.status == Status.OUT_OF_STEPS) > 0
    return False


@partial(jax.jit, static_argnames=("turns", "dtype"))
def _follow_steps(system, drive, solver, t1, y0, step, *, turns, dtype) -> Run:
    done = run_trajectory(system, drive, solver, t1, y0, step, turns=turns, dtype=dtype)
    lane = done.lane
    path = StepPath(system, drive, solver, done.beginnings)
    return Run(sticks_in_order(*done.records), lane.totals, done.status, lane.t, lane.y, lane.doubts, path)
