"""Lanes of the switched engine: a step is a time step, accepted or rejected."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..._events.sticks import StickRecord, count_slips
from ..._excitation.excitation import Excitation
from ..._excitation.smooth import Signal
from ..._systems.system import System
from ..._types import AnyInteger, Array, BoolArray, Number, Scalar
from ..common.ending import has_ended, status_of_lane
from ..common.engine import Engine, SampleTotals
from ..common.segments import SegmentLaws
from ..common.tracks import of_track
from .lane import Lane
from .run import lane_at_start
from .stepping import advance


class SwitchedShared(NamedTuple):
    """Quantities that all steps share: the laws of the excitation's segments, the horizon and the time step (s)."""

    segment_laws: SegmentLaws
    t1: Array
    step: Array


class SwitchedEngine(Engine[SwitchedShared, Signal | None, Lane, StickRecord, SampleTotals]):
    """Any system under any excitation, up to `t1`, from `y0`, in time steps.

    A sample that needs more than `most_steps` steps, rejected ones included, is given up. `quantities` of each stick:
    those asked for. The constant of a sample is the smooth part of its excitation.
    """

    system: System
    excitation: Excitation
    solver: Any
    t1: Scalar
    y0: tuple[Number, ...]
    step_length: Scalar
    most_steps: AnyInteger
    quantities: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def tracks(self) -> int | None:
        return self.system.track_count

    @property
    def compiles_natively(self) -> bool:
        return self.system.compiles_natively

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Signal | None, Lane]:
        y0 = tuple(jnp.asarray(value, dtype) for value in self.y0)
        step = jnp.asarray(self.step_length, dtype)
        lane = lane_at_start(self.system, self.excitation, key_data, y0, step, self.solver, self.quantities)
        smooth = self.excitation.realized(key_data, dtype)
        return jax.tree.map(lambda number: jnp.asarray(number, dtype), smooth), lane

    def shared(self, dtype) -> SwitchedShared:
        laws = SegmentLaws.of(self.system, self.excitation)
        return SwitchedShared(laws, jnp.asarray(self.t1, dtype), jnp.asarray(self.step_length, dtype))

    def step(
        self, shared: SwitchedShared, sample: Signal | None, motion: Lane, drawn: None
    ) -> tuple[Lane, StickRecord]:
        motion, record = advance(self.system.switched_model(sample, self.solver), *shared, motion)
        return motion, of_track(record, self.system)

    def ended(self, motion: Lane, before: Lane) -> BoolArray:
        return has_ended(motion, self._t1(motion), jnp.asarray(self.most_steps, jnp.int32))

    def results(self, sample: Signal | None, motion: Lane) -> SampleTotals:
        totals, at_start = of_track((motion.totals, motion.at_start), self.system)
        return SampleTotals(
            sticks=totals.sticks,
            slips=count_slips(totals, at_start),
            stick_time=totals.stick_time,
            status=status_of_lane(motion, self._t1(motion)),
            near_grazing_count=motion.near_grazing_count,
        )

    def _t1(self, lane: Lane) -> Array:
        return jnp.asarray(self.t1, lane.t.dtype)
