"""Detection of sticks in adaptive steps, which resolve the relative velocity.

A contact is slow while it is closed and its relative velocity is below the threshold, and where this passes zero.
Between two such times it slips. Where it slips by less than bristles bend from one limit to the other (`elastic_slip`
of a friction law), it rang after it was caught, or its bristles bent over: it was stuck all the time. So the end of a
stick is known only when the contact has slipped that far. All closed contacts at once stick while each of them does.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..._events.stick_quantities import Remembered, StickSpan, begin_quantities, measured
from ..._events.sticks import StickRecord, Totals, start_totals, with_stick
from ..._status import Ending
from ..._types import BoolArray, FloatArray, IntArray
from .contacts_detector import closed_in, turned_by_jump
from .stick_detector import Criterion, Step, crossing, fall_in, hermite


class AtContact(NamedTuple):
    """What is asked about each contact at one instant: its relative velocity, whether it is closed, and how far it can
    slip while bristles only bend.
    """

    velocity: FloatArray
    closed: BoolArray
    elastic_slip: FloatArray


class Left(NamedTuple):
    """A slow time that a contact has left: a stick, unless the contact comes back before it has slipped far enough.

    - `ending`: how it ends, an `Ending` code; -1 where there is none. `slipped`: how far the contact has slipped since
      then; infinity if it is over in any case. `of_all`: where all at once are recorded to be at its end, m.
    """

    span: StickSpan
    ending: IntArray
    slipped: FloatArray
    of_all: FloatArray

    def may_go_on(self, elastic_slip: FloatArray) -> BoolArray:
        """Whether the contact may still be stuck."""
        return (self.ending >= 0) & (self.slipped < elastic_slip)


class AllAtOnce(NamedTuple):
    """Whether all closed contacts stick, since `start` (s) at `position` (m).

    `ended`: the time before in which they did, and how it ended, -1 where there is none: a contact that has left may
    turn out to have ended it sooner.
    """

    stick: BoolArray
    start: FloatArray
    position: FloatArray
    ended: tuple[StickSpan, IntArray]


class JoiningDetector(NamedTuple):
    """State of the detector after the steps so far.

    - `slow`: whether each contact is, since `start` (s) at `position` (m), those of the slow time it was joined to.
    - `all_at_once`: None with one contact. `remembered`, `totals`, `at_start`: of each track, as in a `StickDetector`.
    """

    slow: BoolArray
    start: FloatArray
    position: FloatArray
    left: Left
    all_at_once: AllAtOnce | None
    remembered: Remembered
    totals: Totals
    at_start: BoolArray


def start_joining(
    criterion: Criterion, seen: AtContact, tracks: FloatArray, quantities: tuple[str, ...]
) -> JoiningDetector:
    """The detector at the beginning of a trajectory; `tracks`: positions, of several contacts (contacts + 1,)."""
    slow, position = (jnp.abs(seen.velocity) <= criterion.threshold) & seen.closed, _own(tracks)
    zero = jnp.zeros_like(position)
    none = Left(StickSpan(zero, zero, position, position), jnp.full_like(slow, -1, jnp.int8), zero + jnp.inf, zero)
    all_at_once = None
    if tracks.ndim:
        start, of_all = jnp.zeros_like(tracks[-1]), tracks[-1]
        nothing = StickSpan(start, start, of_all, of_all), jnp.full((), -1, jnp.int8)
        all_at_once = AllAtOnce(_all_of(slow, seen.closed), start, of_all, nothing)
    remembered, totals = begin_quantities(tracks, quantities), start_totals(tracks.dtype, tracks.shape)
    return JoiningDetector(slow, zero, position, none, all_at_once, remembered, totals, jnp.zeros(tracks.shape, bool))


def detect_joined(
    criterion: Criterion, detector: JoiningDetector, step: Step, *, jumped: BoolArray, after: AtContact, last: BoolArray
) -> tuple[JoiningDetector, StickRecord]:
    """Update the detector by one step; returns it and the record of the stick that is known to have ended, if any.

    A stick is recorded at the latest in the step after its end, so that one of no length must follow the `last`.
    The step may end in a jump of the base (`jumped`), `after` which the contacts are so.
    """
    threshold, now = jnp.asarray(criterion.threshold, step.t.dtype), step.t + step.h
    was, left, bend = detector.slow, detector.left, after.elastic_slip
    closed_before, closed, opening, closing = closed_in(step.normal, step.h, was)
    fast_before, fast = jnp.abs(step.r0) > threshold, jnp.abs(step.r1) > threshold
    entry, leave = (crossing(threshold, step, entering=entering) for entering in (True, False))
    entry = jnp.maximum(jnp.where(fast_before, entry, 0), jnp.where(closed_before, 0, closing))
    leave = jnp.where(closed, leave, jnp.where(fast, jnp.minimum(leave, opening), opening))
    sign = jnp.where(step.r0 < 0, -1.0, 1.0).astype(entry.dtype)
    zero = fall_in(step.h, sign * step.r0, sign * step.slope0, sign * step.r1, sign * step.slope1)
    slow = ~fast & closed
    passes = ~was & ~slow & (step.r0 * step.r1 < 0) & closed_before & closed
    comes, goes = (~was & slow) | passes, (was & ~slow) | passes
    entry, leave = jnp.where(passes, zero, entry), jnp.where(passes, zero, leave)

    # What has slipped too far is over, whether or not the contact comes back.
    slipped = left.slipped + jnp.where(was, 0, _slip(step, jnp.zeros_like(entry), jnp.where(comes, entry, step.h)))
    ends = (left.ending >= 0) & (slipped >= bend)
    joins = comes & (left.ending >= 0) & ~ends
    start = jnp.where(joins, left.span.start, jnp.where(comes, step.t + entry, detector.start))
    position = jnp.where(joins, left.span.position, jnp.where(comes, _at(step, entry)[0], detector.position))
    left_at, all_left_at = _at(step, leave)
    released = StickSpan(start, step.t + leave, position, left_at)
    # A contact that opens is not held by bristles.
    further = jnp.where(closed, _slip(step, leave, step.h), jnp.inf)
    waiting = left._replace(ending=jnp.where(ends | comes, jnp.int8(-1), left.ending), slipped=slipped)
    following = _chosen(
        goes, Left(released, jnp.full_like(left.ending, Ending.RELEASED), further, all_left_at), waiting
    )

    # Jumps and the end of the time end what may go on there.
    over = jumped if step.x0.ndim == 0 else turned_by_jump(threshold, step, after.velocity, jumped)
    over = over | (after.closed != closed) | last
    holds = slow | following.may_go_on(bend)
    cut = StickSpan(jnp.where(slow, start, following.span.start), jnp.broadcast_to(now, start.shape),
                    jnp.where(slow, position, following.span.position), _own(step.x1))  # fmt: skip
    how = jnp.where(last, Ending.HORIZON, jnp.where(jumped, Ending.BASE_SWITCHED, Ending.RELEASED)).astype(jnp.int8)
    cut = Left(
        cut,
        jnp.broadcast_to(how, start.shape),
        jnp.full_like(start, jnp.inf),
        jnp.broadcast_to(_of_all(step.x1), start.shape),
    )
    following = _chosen(holds & over, cut, following)
    slow = jnp.where(over, (jnp.abs(after.velocity) <= threshold) & after.closed & ~last, slow)
    start, position = jnp.where(over, now, start), jnp.where(over, _own(step.x1), position)

    spans, endings = left.span, jnp.where(ends, left.ending, jnp.int8(-1))
    least, all_at_once = jnp.asarray(criterion.minimum_duration, start.dtype), None
    if detector.all_at_once is not None:
        at_end = jnp.where(over, after.closed, closed)
        changed = jnp.where(closed_before == closed, now, step.t + jnp.where(closed, closing, opening))
        contacts = _Contacts(
            ended=_joined(left._replace(ending=jnp.where(closed_before, endings, jnp.int8(-1))), following),
            is_over=jnp.append(
                ends & closed_before & left.may_go_on(bend),
                (following.ending >= 0) & ~following.may_go_on(bend) & at_end,
            ),
            start=jnp.where(slow, start, following.span.start),
            holds=slow | following.may_go_on(bend),
            closed=at_end,
            opened=jnp.where(closed_before & ~at_end, changed, -jnp.inf),
            closes=jnp.where(~closed_before & at_end, changed, jnp.inf),
            may_end=jnp.where(following.may_go_on(bend), following.span.end, jnp.inf),
        )
        all_at_once, of_all, how_all = _all_at_once(detector.all_at_once, step, contacts)
        spans, endings = jax.tree.map(jnp.append, spans, of_all), jnp.append(endings, how_all)
        least = jnp.append(jnp.broadcast_to(least, start.shape), jnp.max(least))
    duration = spans.end - spans.start
    counts = (endings >= 0) & (duration >= least) & (duration > 0)
    quantities, remembered = measured(detector.remembered, counts, spans)
    record = StickRecord(spans.start, spans.end, spans.position, quantities, jnp.where(counts, endings, jnp.int8(-1)))
    totals = with_stick(detector.totals, counts, endings == Ending.HORIZON, duration)
    at_start = detector.at_start | (counts & (spans.start <= 0))
    return JoiningDetector(slow, start, position, following, all_at_once, remembered, totals, at_start), record


class _Contacts(NamedTuple):
    """What a step knows of each contact, for all at once.

    - `ended`: what it left in the step and before, (2 contacts,), and of this what `is_over` for good.
    - `start`: of what `holds` it at the end of the step, s. `closed`: whether it is, at the end.
    - `opened`, `closes`: when it does in the step, s; -infinity and infinity where it does not. `may_end`: when it
      left, if it may still be stuck; else infinity.
    """

    ended: Left
    is_over: BoolArray
    start: FloatArray
    holds: BoolArray
    closed: BoolArray
    opened: FloatArray
    closes: FloatArray
    may_end: FloatArray


def _all_at_once(before: AllAtOnce, step: Step, of: _Contacts) -> tuple[AllAtOnce, StickSpan, IntArray]:
    """All at once after a step, the time in which they stuck until then, and how it ended, -1 if it did not.

    They begin with the last that comes to rest, or with the opening of the last that slips; they end with the first
    that leaves or closes while it slips, or with the last that opens. One that left before may be known to slip later.
    """

    def cut(span: StickSpan, ending: IntArray) -> tuple[StickSpan, IntArray]:
        ends = jnp.where(of.is_over, of.ended.span.end, jnp.inf)
        first = jnp.argmin(ends)
        sooner = ends[first] < span.end
        end, left_at = (
            jnp.where(sooner, new[first], old) for new, old in ((ends, span.end), (of.ended.of_all, span.left_at))
        )
        ending = jnp.where(sooner & (ending >= 0), of.ended.ending[first], ending)
        return StickSpan(span.start, end, span.position, left_at), ending

    stick, now = _all_of(of.holds, of.closed), step.t + step.h
    slips = jnp.min(jnp.where(of.holds, jnp.inf, of.closes))
    left_at = _at(step, jnp.where(jnp.isfinite(slips), slips - step.t, 0))[1]
    span, how = cut(StickSpan(before.start, slips, before.position, left_at), jnp.int8(Ending.RELEASED))
    opened = jnp.max(of.opened)
    opened = jnp.where(jnp.isfinite(opened), opened, now)
    by_opening = StickSpan(before.start, opened, before.position, _at(step, opened - step.t)[1])
    span = jax.tree.map(lambda new, old: jnp.where(~stick & ~jnp.isfinite(span.end), new, old), by_opening, span)
    ends = before.stick & jnp.isfinite(span.end)
    known, known_how = cut(*before.ended)
    replaced = ends & (known_how >= 0)
    ended, how = jax.tree.map(lambda new, old: jnp.where(ends, new, old), (span, how), (known, known_how))
    is_known = (how >= 0) & ~jnp.any(of.may_end < ended.end)
    recorded, recorded_how = jax.tree.map(
        lambda old, new: jnp.where(replaced, old, new), (known, known_how), (ended, jnp.where(is_known, how, -1))
    )
    how = jnp.where(is_known & ~replaced, jnp.int8(-1), how)

    begun = jnp.maximum(jnp.max(jnp.where(of.holds & of.closed, of.start, -jnp.inf)), jnp.max(of.opened))
    begun = jnp.clip(begun, step.t, now)
    begins = stick & (ends | ~before.stick)
    start = jnp.where(begins, begun, before.start)
    position = jnp.where(begins, _at(step, begun - step.t)[1], before.position)
    return AllAtOnce(stick, start, position, (ended, how)), recorded, recorded_how


def _all_of(holds: BoolArray, closed: BoolArray) -> BoolArray:
    return jnp.all(holds | ~closed) & jnp.any(holds & closed)


def _of_all(tracks: FloatArray) -> FloatArray:
    return tracks[-1] if tracks.ndim else tracks


def _own(tracks: FloatArray) -> FloatArray:
    """Of the positions of all tracks, those of the contacts."""
    return tracks[:-1] if tracks.ndim else tracks


def _at(step: Step, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the contacts, and all at once, are in a step `tau` (s) after it began; each has its own `tau`."""
    ends = step.x0, step.v0, step.x1, step.v1
    if step.x0.ndim == 0:
        return (at := hermite(tau, step.h, *ends)), at
    return hermite(tau, step.h, *(x[:-1] for x in ends)), hermite(tau, step.h, *(x[-1] for x in ends))


def _slip(step: Step, first: FloatArray, last: FloatArray) -> FloatArray:
    """How far the contacts slip between two instants of a step, by the cubic of the relative velocity."""
    h = jnp.where(step.h > 0, step.h, 1)

    def until(tau: FloatArray) -> FloatArray:
        u = tau / h
        early, late = u * u * u * (u - 2) / 2 + u, u * u * u * (2 - u) / 2
        slopes = step.slope0 * u * u * (6 - 8 * u + 3 * u * u) + step.slope1 * u * u * u * (3 * u - 4)
        return h * (step.r0 * early + step.r1 * late + h * slopes / 12)

    return lax.stop_gradient(jnp.abs(until(last) - until(first)))


def _chosen(which: BoolArray, one: Left, other: Left) -> Left:
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), one, other)


def _joined(one: Left, other: Left) -> Left:
    return jax.tree.map(jnp.append, one, other)
