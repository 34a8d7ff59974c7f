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
from ..._numerics.over_contacts import any_of
from ..._systems.switched_model import State
from ..._types import BoolArray, FloatArray, IntArray
from ..common.ending import is_spent
from ..common.segments import SegmentLaws, following_segments, to_digits
from .contacts_field import ContactsField
from .field import Field
from .landing import shortened
from .stick_detector import Criterion, StickDetector

_GROWTH = 8  # of a step that was shortened, at most
_SAFETY, _LEAST_ERROR = 0.9, 1e-3


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


def nothing_seen(numbers: State, contacts: int | None) -> tuple[StickRecord, Passage]:
    """The records of an idle step, for a trajectory with `numbers` of its state like these and so many contacts."""
    none = tuple(jnp.zeros_like(value) for value in numbers)
    return no_stick(none[0].dtype, ALL, () if contacts is None else (contacts + 1,)), Passage(none[0], none, none, none)


def start_fixed(
    field: Field | ContactsField,
    segment_laws: SegmentLaws,
    criterion: Criterion,
    segment_states: tuple[SegmentState, ...],
    y0: tuple,
    dtype,
    quantities: tuple[str, ...],
) -> FixedLane:
    """The lane at the beginning of a trajectory; `quantities` of each stick: those that are asked for."""
    zero, y = jnp.zeros((), dtype), field.model.start(y0, dtype)
    forcing = field.model.forcing(zero, segment_laws.segments(segment_states))
    limit = jnp.full((), jnp.inf, dtype) if field.may_be_short else None
    detector = field.start_detector(criterion, forcing, y, quantities)
    return FixedLane(zero, y, jnp.zeros((), jnp.int32), detector, segment_states, limit)


@sharing
def advance_fixed(
    field: Field | ContactsField,
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
    live = (lane.t < t1) & ~is_spent(lane) & (lane.steps < most_steps) & ~any_of(jnp.isnan(lane.y[0]))
    stop = t1
    for segment_state in lane.segment_states:
        stop = jnp.minimum(stop, segment_state.segment.end)
    left = jnp.where(live, stop - lane.t, 0)
    longest = step if lane.limit is None else jnp.minimum(step, lane.limit)
    # A little more than one step, so that no last step of a few units in the last place remains.
    to_stop = longest * (1 + 1e-6) >= left
    h = jnp.where(to_stop, left, to_digits(lane.t, longest))
    band = field.band(forcing, lane.t, lane.y)
    y, error = field.step(forcing, lane.y, h, band)
    seen, rates, end_rates = field.seen(forcing, lane.t, h, lane.y, y)
    # An acceleration that is NaN or infinite hides sticks, although the motion may not need it: `NOT_FINITE`.
    known = ~any_of(~(jnp.isfinite(seen.slope0) & jnp.isfinite(seen.slope1)))
    y = (jnp.where(known, y[0], jnp.nan), *y[1:])

    t = jnp.where(to_stop, stop, lane.t + h)
    segment_states, jumped = following_segments(segment_laws, lane.segment_states, t, t < t1)
    after = field.contact(field.model.forcing(t, segment_laws.segments(segment_states)), t, y)
    detector, record = field.detect(criterion, lane.detector, seen, jumped=jumped, after=after, last=t >= t1)
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
    return moved, record, Passage(lane.t, *map(field.model.numbers, (lane.y, rates, end_rates)))


def _judged(error: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Whether a step of this `error`, over the allowed one, is too inaccurate, and how many times as long the next one
    may be.
    """
    return error > 1, jnp.clip(_SAFETY / jnp.sqrt(jnp.maximum(error, _LEAST_ERROR)), 1 / _GROWTH, _GROWTH)
