"""Detection of sticks of several contacts in fixed steps, and of the times in which all closed ones stick.

Each contact sticks while it is closed and its relative velocity is below the threshold. All at once stick while every
closed contact does, and one is closed. The arrays of a detector and of positions have an entry for each contact and a
last one for all at once; everything else, one for each contact.
"""

import jax.numpy as jnp

from ..._events.stick_quantities import begin_quantities
from ..._events.sticks import StickRecord, start_totals
from ..._types import BoolArray, FloatArray
from .stick_detector import (
    AtEnd,
    Criterion,
    NormalForces,
    Step,
    StickDetector,
    TimeInside,
    fall_in,
    passages,
    position_in,
    recorded,
)

_ULPS = 64  # of the relative velocities: a smaller change is round-off, and no jump


def start_contacts(
    criterion: Criterion, velocity: FloatArray, closed: BoolArray, position: FloatArray, quantities: tuple[str, ...]
) -> StickDetector:
    """The detector at the beginning of a trajectory."""
    inside = _with_all((jnp.abs(velocity) <= criterion.threshold) & closed, closed)
    zero, never = jnp.zeros_like(position), jnp.full_like(position, jnp.inf)
    totals, remembered = start_totals(position.dtype, inside.shape), begin_quantities(position, quantities)
    return StickDetector(inside, zero, position, never, position, remembered, totals, jnp.zeros_like(inside))


def detect_contacts(
    criterion: Criterion,
    detector: StickDetector,
    step: Step,
    *,
    jumped: BoolArray,
    after: tuple[FloatArray, BoolArray],
    last: BoolArray,
) -> tuple[StickDetector, StickRecord]:
    """Update the detector by one step; see `stick_detector.detect`.

    `after`: the relative velocities where the step ends, after a jump there, and whether contacts are closed.
    """
    threshold = jnp.asarray(criterion.threshold, step.t.dtype)
    time, closed = _time_inside(threshold, detector, step, jumped)
    velocity, closed_after = after
    turned = turned_by_jump(threshold, step, velocity, jumped)
    over = turned | (closed_after != closed)
    goes_on = jnp.where(over, (jnp.abs(velocity) <= threshold) & closed_after, time.inside[:-1])
    goes_on = _with_all(goes_on, closed_after)
    all_over = jnp.any(turned & time.inside[:-1]) | (goes_on[-1] != time.inside[-1])
    over = jnp.append(over, all_over)
    least = jnp.broadcast_to(jnp.asarray(criterion.minimum_duration, step.r1.dtype), step.r1.shape)
    at_end = AtEnd(over, goes_on, last, time.leaves | (over & ~jumped))
    return recorded(jnp.append(least, jnp.max(least)), detector, step, time, at_end)


def turned_by_jump(threshold: FloatArray, step: Step, velocity: FloatArray, jumped: BoolArray) -> BoolArray:
    """Whether the relative velocity jumps to `velocity` where the step ends: between two masses a base does nothing."""
    size = jnp.maximum(jnp.maximum(jnp.abs(velocity), jnp.abs(step.r1)), threshold)
    return jumped & (jnp.abs(velocity - step.r1) > _ULPS * jnp.finfo(size.dtype).eps * size)


def _with_all(inside: BoolArray, closed: BoolArray) -> BoolArray:
    """With a last entry for all at once."""
    return jnp.append(inside, jnp.all(inside | ~closed) & jnp.any(inside))


def _time_inside(
    threshold: FloatArray, detector: StickDetector, step: Step, jumped: BoolArray
) -> tuple[TimeInside, BoolArray]:
    """How the step changes the times below the threshold, and which contacts are closed at its end."""
    was = detector.inside[:-1]
    closed_before, closed, opening, closing = closed_in(step.normal, step.h, was)
    slow = (jnp.abs(step.r1) <= threshold) & closed
    enters, leaves = ~was & slow, was & ~slow
    entry, leave = passages(threshold, step)
    falls = jnp.abs(step.r0) > threshold
    entry = jnp.maximum(jnp.where(falls, entry, 0), jnp.where(closed_before, 0, closing))
    leave = jnp.where(closed, leave, jnp.where(jnp.abs(step.r1) > threshold, jnp.minimum(leave, opening), opening))
    start = jnp.where(enters, step.t + entry, detector.start[:-1])
    # A long step in which a contact comes to rest may end a little beyond rest; the next step corrects this.
    start = jnp.where(enters & jnp.isfinite(detector.crossed[:-1]), detector.crossed[:-1], start)
    passes = ~was & ~slow & (step.r0 * step.r1 < 0) & ~jumped & closed_before & closed
    crossed = jnp.where(passes, step.t + entry, jnp.inf)

    inside = _with_all(slow, closed)
    # All at once begin with the last that comes to rest, or with the opening of the last that slips; they end with the
    # first that leaves or closes while it slips, or with the last that opens.
    opens, closes = closed_before & ~closed, ~closed_before & closed
    begun = jnp.max(jnp.where(slow, start, jnp.where(opens & ~was, step.t + opening, -jnp.inf)))
    slips = closed & ~slow & (was | closes)
    ended = jnp.min(jnp.where(slips, jnp.where(was, leave, closing), jnp.inf))
    ended = jnp.where(jnp.any(slips), ended, jnp.max(jnp.where(leaves, leave, 0)))
    all_enter, all_leave = ~detector.inside[-1] & inside[-1], detector.inside[-1] & ~inside[-1]
    start = jnp.append(start, jnp.where(all_enter, begun, detector.start[-1]))
    enters = jnp.append(enters, all_enter)
    crossed = jnp.append(crossed, jnp.max(jnp.where(jnp.isfinite(crossed), crossed, -jnp.inf)))
    crossed = jnp.where(jnp.isfinite(crossed), crossed, jnp.inf)

    at = position_in(step, jnp.clip(start - step.t, 0, step.h))
    position = jnp.where(enters, jnp.where(start < step.t, detector.crossed_at, at), detector.position)
    crossed_at = jnp.where(
        crossed < jnp.inf, position_in(step, jnp.where(crossed < jnp.inf, crossed - step.t, 0)), step.x1
    )
    leaves, leave = jnp.append(leaves, all_leave), jnp.append(leave, ended)
    return TimeInside(inside, leaves, start, position, leave, crossed, crossed_at), closed


def closed_in(
    normal: NormalForces | None, h: FloatArray, like: BoolArray
) -> tuple[BoolArray, BoolArray, FloatArray, FloatArray]:
    """Which contacts are closed at the two ends of a step, and when they open and close in it, s after it began.

    The instants are meaningless where they do not.
    """
    if normal is None:
        always, none = jnp.ones_like(like), jnp.zeros(like.shape, h.dtype)
        return always, always, none, none
    n0, d0, n1, d1 = normal
    return n0 > 0, n1 > 0, fall_in(h, n0, d0, n1, d1), fall_in(h, -n0, -d0, -n1, -d1)
