"""One trajectory in closed form over base intervals, and the state along it."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._events.sticks import start_totals, sticks_of
from ..._excitation.interval_checks import marked
from ..._excitation.piecewise_constant import VelocitySteps
from ..._excitation.segments import Segment
from ..._systems.mass_spring import MassSpring
from ..._systems.switched_model import Segments, State
from ..._types import FloatArray, Number, Scalar
from ..common.path import Path, Run
from .crossing import Motion, cross_interval, scales_of, status_of
from .extremes import largest_in_interval
from .given import Given, beginnings, final_motion, ordered_sticks


class IntervalPath(Path):
    """Path given by the states at the beginnings of the base intervals."""

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
        motion, *_ = cross_interval(scales, began, start_totals(time.dtype), time - began.t, velocity)
        return motion.x, motion.v

    def largest(self, number: int, sign: Scalar, last: FloatArray, final: FloatArray) -> FloatArray:
        dtype = final.dtype
        scales = scales_of(self.system, self.t1, dtype)
        of_interval = partial(largest_in_interval, scales, of_velocity=number == 1, sign=sign)
        durations, velocities = (jnp.asarray(one, dtype) for one in (self.base.durations, self.base.velocities))
        found = jnp.max(jax.vmap(of_interval)(self.beginnings, durations, velocities))
        return jnp.maximum(found, sign * final)

    @property
    def smooth(self) -> None:
        return None

    def segments(self, time: FloatArray) -> Segments:
        index = self._index(time)
        begin, velocity = self.beginnings.t[index], self.base.velocities[index].astype(time.dtype)
        here = Segment(begin, begin + self.base.durations[index].astype(time.dtype), velocity, jnp.zeros_like(velocity))
        return Segments((here,), (), ())

    def _index(self, time: FloatArray) -> Array:
        # Of intervals with the same beginning (empty slots of no length), the last is the one with a length.
        return jnp.clip(jnp.searchsorted(self.beginnings.t, time, side="right") - 1, 0)


@partial(jax.jit, static_argnames="dtype")
def follow_intervals(system: MassSpring, base: VelocitySteps, t1: Scalar, y0: tuple[Number, ...], dtype) -> Run:
    """One trajectory in closed form, interval by interval."""
    scales = scales_of(system, t1, dtype)
    # Nothing after t1 matters; cutting durations here keeps infinities out of the arithmetic.
    durations = marked(jnp.where(base.durations >= t1, t1, base.durations), base.velocities).astype(dtype)
    start = jnp.asarray(y0[0], dtype), jnp.asarray(y0[1], dtype)
    given = Given(scales, start, durations, base.velocities.astype(dtype))
    final, totals = final_motion(given)
    final_state = (final.x, final.v)
    began = beginnings(given)
    path = IntervalPath(system, base, t1, began.motion)
    sticks = sticks_of(ordered_sticks(given))
    return Run(sticks, totals, status_of(final, scales.t1), final.t, final_state, began.near_grazing_count, path)
