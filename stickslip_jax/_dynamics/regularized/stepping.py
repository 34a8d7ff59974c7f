"""Regularised motion of one trajectory in steps of fixed length; the caller makes batches with ``jax.vmap``.

A step ends early where a segment of the base motion or of the load ends, so that it never crosses a jump. Adaptive
steps: `solve.py`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..._compiler import sharing
from ..._events.stick_quantities import ALL
from ..._events.sticks import StickRecord, no_stick
from ..._excitation.segments import SegmentState
from ..._systems.one_contact import OneContactModel
from ..._systems.switched_model import NOISE_ULPS, State
from ..._types import BoolArray, FloatArray, IntArray
from ..common.ending import is_spent
from ..common.segments import SegmentLaws, following_segments
from .implicit_step import implicit_step
from .landing import shortened
from .stick_detector import Criterion, Step, StickDetector, detect, start_detector
from .switch import Switch

_TIME_ULPS = 4  # the round-off of the time, in units in the last place
_GROWTH = 8  # of a step that was shortened, at most
_SAFETY, _LEAST_ERROR = 0.9, 1e-3


class Field(NamedTuple):
    """A system under its excitation, with friction regularised by `switch`."""

    model: OneContactModel
    switch: Switch

    def rates(self, forcing: object, tau: FloatArray, y: State) -> State:
        """The time derivative of the state."""
        speed = self.model.relative_velocity(forcing, tau, y)
        return self.model.rates_under(forcing, tau, y, self.switch.coefficient(self.model.friction, speed))

    def need(self, forcing: object, tau: FloatArray, y: State) -> FloatArray:
        """Friction that keeps the relative velocity constant, over the largest friction; infinite without friction."""
        free, held = self._accelerations(forcing, tau, y)
        return jnp.where(held > 0, jnp.abs(free) / jnp.where(held > 0, held, 1), jnp.inf)

    def band(self, forcing: object, t: FloatArray, y: State) -> FloatArray:
        """The relative speed (m/s) below which static friction can hold the mass: the width, and what is round-off."""
        _, held = self._accelerations(forcing, jnp.zeros_like(t), y)
        scale = NOISE_ULPS * self.model.guard_scale(forcing, y, jnp.ones_like(t)) + _TIME_ULPS * t * held
        return self.switch.width + lax.stop_gradient(jnp.finfo(t.dtype).eps * scale)

    def _accelerations(self, forcing: object, tau: FloatArray, y: State) -> tuple[FloatArray, FloatArray]:
        """The relative acceleration without friction, and the largest one that friction causes, m/s^2."""
        free, gain = self.model.effect_of_friction(forcing, tau, y)
        return free, jnp.abs(gain) * self.model.friction.stick_limit(free)

    def seen(
        self, forcing: object, t: FloatArray, h: FloatArray, before: State, after: State
    ) -> tuple[Step, State, State]:
        """The step from `t` to ``t + h`` as the stick detector reads it, and the rates at both ends."""
        zero = jnp.zeros_like(h)
        rates, end_rates = self.rates(forcing, zero, before), self.rates(forcing, h, after)
        first = (
            self.model.relative_velocity(forcing, zero, before),
            self.model.relative_acceleration(forcing, zero, before, rates),
        )
        last = (
            self.model.relative_velocity(forcing, h, after),
            self.model.relative_acceleration(forcing, h, after, end_rates),
        )
        needs = self.need(forcing, zero, before), self.need(forcing, h, after)
        return Step(t, h, *first, *last, before[0], rates[0], after[0], end_rates[0], *needs), rates, end_rates


class FixedLane(NamedTuple):
    """Loop state of one trajectory; `has_ended` and `status_of_lane` of the switched engine accept it too.

    `limit`: of the next step, s, by the error of the last one and by what static friction holds or lets go; None where
    all steps may be as long as the given one.
    """

    t: FloatArray
    y: State
    steps: IntArray
    detector: StickDetector
    segment_states: tuple[SegmentState, ...]
    limit: FloatArray | None


class Passage(NamedTuple):
    """Record of a step for the `CubicPath`: its beginning, the state there, and the rates at both ends."""

    t: FloatArray
    y: State
    rates: State
    end_rates: State


def nothing_seen(y: State) -> tuple[StickRecord, Passage]:
    """The records of an idle step, for a trajectory with states like `y`."""
    none = tuple(jnp.zeros_like(value) for value in y)
    return no_stick(y[0].dtype, ALL), Passage(none[0], none, none, none)


def start_fixed(
    field: Field,
    segment_laws: SegmentLaws,
    criterion: Criterion,
    segment_states: tuple[SegmentState, ...],
    y0: tuple,
    dtype,
    quantities: tuple[str, ...],
) -> FixedLane:
    """The lane at the beginning of a trajectory; `quantities` of each stick: those that are asked for."""
    zero = jnp.zeros((), dtype)
    y = tuple(jnp.asarray(value, dtype) for value in y0)
    speed = field.model.relative_velocity(field.model.forcing(zero, segment_laws.segments(segment_states)), zero, y)
    may_be_short = field.model.friction.static_exceeds_kinetic or not field.model.time_scales_are_known
    limit = jnp.full((), jnp.inf, dtype) if may_be_short else None
    detector = start_detector(criterion, speed, y[0], quantities)
    return FixedLane(zero, y, jnp.zeros((), jnp.int32), detector, segment_states, limit)


@sharing
def advance_fixed(
    field: Field,
    segment_laws: SegmentLaws,
    criterion: Criterion,
    t1: FloatArray,
    step: FloatArray,
    most_steps: IntArray,
    lane: FixedLane,
) -> tuple[FixedLane, StickRecord, Passage]:
    """One loop step; returns the lane after it, the record of the stick that ended in it, if any, and its `Passage`.

    The step may be rejected, for its error or where static friction exceeds kinetic friction: the lane stays, and tries
    a shorter one.
    """
    forcing = field.model.forcing(lane.t, segment_laws.segments(lane.segment_states))
    live = (lane.t < t1) & ~is_spent(lane) & (lane.steps < most_steps) & ~jnp.isnan(lane.y[0])
    stop = t1
    for segment_state in lane.segment_states:
        stop = jnp.minimum(stop, segment_state.segment.end)
    left = jnp.where(live, stop - lane.t, 0)
    longest = step if lane.limit is None else jnp.minimum(step, lane.limit)
    # A little more than one step, so that no last step of a few units in the last place remains.
    to_stop = longest * (1 + 1e-6) >= left
    h = jnp.where(to_stop, left, longest)
    band = field.band(forcing, lane.t, lane.y) if field.model.friction.static_exceeds_kinetic else None
    y, error = implicit_step(field.model, field.switch, forcing, lane.y, h, band)
    seen, rates, end_rates = field.seen(forcing, lane.t, h, lane.y, y)
    # An acceleration that is NaN or infinite hides sticks, although the motion may not need it: `NOT_FINITE`.
    known = jnp.isfinite(seen.slope0) & jnp.isfinite(seen.slope1)
    y = (jnp.where(known, y[0], jnp.nan), *y[1:])

    t = jnp.where(to_stop, stop, lane.t + h)
    segment_states, jumped = following_segments(segment_laws, lane.segment_states, t, t < t1)
    after = field.model.relative_velocity(
        field.model.forcing(t, segment_laws.segments(segment_states)), jnp.zeros_like(t), y
    )
    detector, record = detect(criterion, lane.detector, seen, jumped=jumped, after=after, last=t >= t1, resolved=False)
    moved = FixedLane(t, y, lane.steps + 1, detector, segment_states, lane.limit)
    accepted = live
    if lane.limit is not None:
        inaccurate, change = (jnp.zeros((), bool), _GROWTH) if error is None else _judged(error)
        again, length = inaccurate, lax.stop_gradient(h * change)
        if band is not None:
            passes, until = shortened(seen, band)
            again, length = inaccurate | passes, jnp.where(inaccurate, length, until)
        accepted = live & ~again
        stays = lane._replace(steps=lane.steps + 1, limit=length)
        moved = moved._replace(limit=jnp.minimum(lax.stop_gradient(longest * change), step))
        moved = jax.tree.map(lambda new, old: jnp.where(again, new, old), stays, moved)
    moved = jax.tree.map(lambda new, old: jnp.where(live, new, old), moved, lane)
    record = record._replace(ending=jnp.where(accepted, record.ending, jnp.int8(-1)))
    return moved, record, Passage(lane.t, lane.y, rates, end_rates)


def _judged(error: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Whether a step of this `error`, over the allowed one, is too inaccurate, and how many times as long the next one
    may be.
    """
    return error > 1, jnp.clip(_SAFETY / jnp.sqrt(jnp.maximum(error, _LEAST_ERROR)), 1 / _GROWTH, _GROWTH)
