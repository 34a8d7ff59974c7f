"""Lanes of the interval engine: a step is a whole base interval, drawn when it is simulated."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from ..._compiler import computed_once
from ..._events.sticks import StickRecord, Totals, count_slips, start_totals
from ..._excitation.piecewise_constant import PiecewiseConstantLaw
from ..._systems.mass_spring import MassSpring
from ..._types import Array, BoolArray, IntArray, Number, Scalar
from ..common.engine import Engine, SampleTotals
from .arcs import Scales
from .crossing import Motion, cross_interval, scales_of, start_motion, status_of, sticks_at_start
from .ties import starts_at_edge


class _Sample(NamedTuple):
    """Constants of a sample: its key data, and whether it begins with a stick."""

    key_data: tuple[Array, Array]
    at_start: BoolArray


class _Lane(NamedTuple):
    """The motion of one lane; `memory`: the state of the random law, which the next interval depends on; `ties`: the
    number of intervals in which round-off decided.
    """

    memory: Any
    motion: Motion
    totals: Totals
    ties: IntArray


class IntervalEngine(Engine[Scales, _Sample, _Lane, StickRecord, SampleTotals]):
    """A `MassSpring` on a base that follows `law`, up to `t1`, from `y0`.

    `quantities` of each stick: those asked for.
    """

    system: MassSpring
    law: PiecewiseConstantLaw
    t1: Scalar
    y0: tuple[Number, ...]
    quantities: tuple[str, ...] = eqx.field(static=True, default=())

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[_Sample, _Lane]:
        scales = self.shared(dtype)
        x, velocity = self.y0
        motion = start_motion(scales, (x, velocity), self.quantities)
        memory = computed_once(lambda key_data: self.law.begin(key_data, dtype))(key_data)
        _, base, _ = self.law.next_interval(memory, self.law.draw(key_data, jnp.zeros((), jnp.uint32), dtype), dtype)
        at_start = sticks_at_start(scales, motion, base)
        at_edge = starts_at_edge(scales, motion, base).astype(jnp.int32)
        return _Sample(key_data, at_start), _Lane(memory, motion, start_totals(dtype), at_edge)

    def shared(self, dtype) -> Scales:
        return scales_of(self.system, self.t1, dtype)

    def draw(self, sample: _Sample, number: Array, dtype) -> Any:
        return self.law.draw(sample.key_data, number, dtype)

    def step(self, shared: Scales, sample: _Sample, motion: _Lane, drawn: Any) -> tuple[_Lane, StickRecord]:
        duration, velocity, memory = self.law.next_interval(motion.memory, drawn, shared.t1.dtype)
        duration = jnp.where(duration >= shared.t1, shared.t1, duration)  # no infinity enters the arithmetic
        moved, totals, stick, tie = cross_interval(shared, motion.motion, motion.totals, duration, velocity)
        return _Lane(memory, moved, totals, motion.ties + tie), stick

    def ended(self, motion: _Lane, before: _Lane) -> BoolArray:
        return is_over(motion.motion, before.motion, self.t1)

    def results(self, sample: _Sample, motion: _Lane) -> SampleTotals:
        return SampleTotals(
            sticks=motion.totals.sticks,
            slips=count_slips(motion.totals, sample.at_start),
            stick_time=motion.totals.stick_time,
            status=status_of(motion.motion, jnp.asarray(self.t1, motion.motion.t.dtype)),
            # Ties of other kinds (`is_tie`) are not looked for: it would cost a third of the time.
            near_grazing_count=motion.ties,
        )


def is_over(motion: Motion, before: Motion, t1: Scalar) -> BoolArray:
    """Whether a sample reached the horizon, had no further interval since `before`, or has a NaN time."""
    return ~(motion.t < jnp.asarray(t1, motion.t.dtype)) | (motion.t <= before.t)
