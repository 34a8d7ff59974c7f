"""Detection of sticks in regularised dynamics: in fixed steps by a threshold of the relative velocity, in adaptive
steps by the path that is slipped.
"""

from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from ..._foundation.types import AnyArray, BoolArray, Ending, FloatArray, IntArray, Scalar
from ..._numerics.derivatives import root_of, with_slope
from ..._numerics.matrices import any_of
from ..._numerics.steps import look_ahead
from ..sticks import Remembered, StickRecord, StickSpan, Totals, begin_quantities, ending_of, recorded, start_totals

# Detection of sticks in fixed steps: the relative velocity stays below a threshold for long enough.
#
# Each contact sticks while it is closed and its relative velocity is below the threshold. With one contact all are
# scalars. With several, all at once stick while every closed contact does, and one is closed: the arrays of a detector
# and of positions have an entry for each contact and a last one for all at once; everything else, one for each contact.


_Pair: TypeAlias = tuple[Array, Array]
_ULPS = 64  # of the relative velocities: a smaller change is round-off, and no jump
_TURNS = 4  # tries of where a number is lowest


class Criterion(NamedTuple):
    """Criterion of a stick: ``|v_rel| <= threshold`` (m/s) for at least `minimum_duration` (s).

    Of several contacts one number each, or arrays (contacts,).
    """

    threshold: AnyArray | Scalar
    minimum_duration: AnyArray | Scalar


class Found(NamedTuple):
    """What a detector has found so far, of each track: what quantities of a stick remember, the `Totals`, and whether
    there was a stick from the start.
    """

    remembered: Remembered
    totals: Totals
    at_start: BoolArray

    @classmethod
    def nothing(cls, tracks: FloatArray, quantities: tuple[str, ...]) -> "Found":
        """At the beginning of a trajectory; `tracks`: positions."""
        remembered, totals = begin_quantities(tracks, quantities), start_totals(tracks.dtype, tracks.shape)
        return cls(remembered, totals, jnp.zeros(tracks.shape, bool))


class StickDetector(NamedTuple):
    """State of the detector after the steps so far.

    - `inside`: whether the relative velocity is below the threshold, since `start` (s) at `position` (m).
    - `crossed`: when it passed through zero in the last step without ending inside, s, infinity if it did not;
      `crossed_at`: the position there.
    """

    inside: BoolArray
    start: FloatArray
    position: FloatArray
    crossed: FloatArray
    crossed_at: FloatArray
    found: Found


class Cubic(NamedTuple):
    """A number in a step, by its values and slopes at both ends: it is a cubic in between, or a quartic, by the value
    in the middle too, less that of the cubic (`bulge`).
    """

    begin: FloatArray
    slope: FloatArray
    end: FloatArray
    end_slope: FloatArray
    bulge: FloatArray | None = None

    def through(self, h: FloatArray, middle: FloatArray) -> "Cubic":
        """That with this value in the middle of a step of length `h`."""
        return self._replace(bulge=middle - (self.begin + self.end) / 2 - h * (self.slope - self.end_slope) / 8)


class SeenStep(NamedTuple):
    """One step from `t` to ``t + h`` as the detector reads it.

    `relative`: velocity, before a jump of the base. Of several contacts they are arrays: the positions of each and of
    all at once, everything else of each, with the `normal` forces.
    """

    t: FloatArray
    h: FloatArray
    relative: Cubic
    position: Cubic
    normal: Cubic | None = None

    @property
    def hides_sticks(self) -> BoolArray:
        """Whether a relative acceleration is NaN or infinite, although the motion may not need it: `NOT_FINITE`."""
        return any_of(~(jnp.isfinite(self.relative.slope) & jnp.isfinite(self.relative.end_slope)))


class AtContact(NamedTuple):
    """What is asked about each contact at one instant: its relative velocity, whether it is closed, and how far it can
    slip while bristles only bend.
    """

    velocity: FloatArray
    closed: BoolArray
    elastic_slip: FloatArray


def start_detector(
    criterion: Criterion, seen: AtContact, tracks: FloatArray, quantities: tuple[str, ...]
) -> StickDetector:
    """The detector at the beginning of a trajectory; `tracks`: positions, of several contacts (contacts + 1,).

    `quantities` of each stick: those that are asked for.
    """
    inside = _with_all((jnp.abs(seen.velocity) <= criterion.threshold) & seen.closed, seen.closed)
    zero, never = jnp.zeros_like(tracks), jnp.full_like(tracks, jnp.inf)
    return StickDetector(inside, zero, tracks, never, tracks, Found.nothing(tracks, quantities))


def detect(
    criterion: Criterion,
    detector: StickDetector,
    step: SeenStep,
    *,
    jumped: BoolArray,
    after: AtContact,
    last: BoolArray,
) -> tuple[StickDetector, StickRecord]:
    """Update the detector by one step; returns it and the record of the stick that ended in the step, if any.

    The step may end in a jump of the base (`jumped`), `after` which the contacts are so, or be the `last`. It need not
    resolve the width: the relative velocity is taken to fall linearly to zero inside the step in which a stick begins.
    """
    threshold = jnp.asarray(criterion.threshold, step.t.dtype)
    was, crossed_before = _own(detector.inside), _own(detector.crossed)
    given = _straight_entry(threshold, step), crossing(threshold, step, entering=False)
    slow, passes, (entry, leave), (closed_before, closed), (opening, closing) = _passage(threshold, step, was, *given)
    enters, leaves, passes = ~was & slow, was & ~slow, passes & ~jumped
    # A long step in which a contact comes to rest may end a little beyond rest; the next step corrects this.
    late = enters & jnp.isfinite(crossed_before)
    begun = jnp.where(late, crossed_before, step.t + entry)
    crossed, crossing_at = jnp.where(passes, step.t + entry, jnp.inf), entry
    start, inside = jnp.where(enters, begun, _own(detector.start)), _with_all(slow, closed)
    if step.position.begin.ndim:
        # All at once begin with the last that comes to rest, or with the opening of the last that slips; they end with
        # the first that leaves or closes while it slips, or with the last that opens.
        opens, closes = closed_before & ~closed, ~closed_before & closed
        all_begun = jnp.max(jnp.where(slow, start, jnp.where(opens & ~was, step.t + opening, -jnp.inf)))
        slips = closed & ~slow & (was | closes)
        ended = jnp.min(jnp.where(slips, jnp.where(was, leave, closing), jnp.inf))
        ended = jnp.where(jnp.any(slips), ended, jnp.max(jnp.where(leaves, leave, 0)))
        all_enter, all_leave = ~detector.inside[-1] & inside[-1], detector.inside[-1] & ~inside[-1]
        enters, leaves, leave = jnp.append(enters, all_enter), jnp.append(leaves, all_leave), jnp.append(leave, ended)
        entry = jnp.append(entry, jnp.clip(all_begun - step.t, 0, step.h))
        start = jnp.append(start, jnp.where(all_enter, all_begun, detector.start[-1]))
        late = jnp.append(late, all_begun < step.t)
        all_crossed = jnp.max(jnp.where(passes, crossed, -jnp.inf))
        crossing_at = jnp.append(crossing_at, jnp.where(jnp.any(passes), all_crossed - step.t, 0))
        crossed = jnp.append(crossed, jnp.where(jnp.any(passes), all_crossed, jnp.inf))
        passes = jnp.append(passes, jnp.any(passes))
    at = jnp.where(late, detector.crossed_at, hermite(entry, step.h, step.position))
    position = jnp.where(enters, at, detector.position)
    crossed_at = jnp.where(passes, hermite(crossing_at, step.h, step.position), step.position.end)

    # Jumps, and what opens or closes as the step ends, end what goes on; so does the end of the time.
    turned = _turned_by_jump(threshold, step, after.velocity, jumped)
    over = turned | (after.closed != closed)
    goes_on = jnp.where(over, (jnp.abs(after.velocity) <= threshold) & after.closed, slow)
    goes_on = _with_all(goes_on, after.closed)
    if step.position.begin.ndim:
        over = jnp.append(over, jnp.any(turned & slow) | (goes_on[-1] != inside[-1]))
    now, cut = step.t + step.h, last & inside
    end = jnp.where(leaves, step.t + leave, now)
    left_at = jnp.where(leaves, hermite(leave, step.h, step.position), step.position.end)
    ending = ending_of(leaves | cut | (over & inside), leaves | (over & ~jumped), cut)
    found, record = _found(criterion, detector.found, StickSpan(start, end, position, left_at), ending, cut)
    start, position = jnp.where(over, now, start), jnp.where(over, step.position.end, position)
    return StickDetector(goes_on, start, position, crossed, crossed_at, found), record


def _found(
    criterion: Criterion, before: Found, span: StickSpan, ending: IntArray, cut: BoolArray
) -> tuple[Found, StickRecord]:
    """What is found after a step in which these slow times ended (`ending`: how, -1 where none did), and the record of
    those that are sticks; `cut`: by the horizon.
    """
    duration, least = span.end - span.start, jnp.asarray(criterion.minimum_duration, span.start.dtype)
    if duration.ndim:  # all at once stick for the longest that any contact must
        least = jnp.append(jnp.broadcast_to(least, duration[:-1].shape), jnp.max(least))
    counts = (ending >= 0) & (duration >= least) & (duration > 0)
    ending = jnp.where(counts, ending, jnp.int8(-1))
    record, remembered, totals = recorded(before.remembered, before.totals, counts, span, ending, cut, duration)
    return Found(remembered, totals, before.at_start | (counts & (span.start <= 0))), record


def _with_all(holds: BoolArray, closed: BoolArray) -> BoolArray:
    """Of several contacts, with a last entry for all at once."""
    return jnp.append(holds, _all_of(holds, closed)) if holds.ndim else holds


def _all_of(holds: BoolArray, closed: BoolArray) -> BoolArray:
    return jnp.all(holds | ~closed) & jnp.any(holds & closed)


def _own(tracks: Array) -> Array:
    """Of what each track has, that of the contacts."""
    return tracks[:-1] if tracks.ndim else tracks


def _turned_by_jump(threshold: FloatArray, step: SeenStep, velocity: FloatArray, jumped: BoolArray) -> BoolArray:
    """Whether the relative velocity jumps to `velocity` where the step ends: between two masses a base does nothing."""
    if velocity.ndim == 0:
        return jumped
    size = jnp.maximum(jnp.maximum(jnp.abs(velocity), jnp.abs(step.relative.end)), threshold)
    return jumped & (jnp.abs(velocity - step.relative.end) > _ULPS * jnp.finfo(size.dtype).eps * size)


def crossing(threshold: FloatArray, step: SeenStep, *, entering: bool) -> FloatArray:
    """When ``|v_rel|`` passes the threshold, s after the step began; meaningless where it does not."""
    sign = _sign(step.relative.begin if entering else step.relative.end)
    # Positive before the crossing and negative after it.
    turn = sign if entering else -sign
    shift = threshold if entering else -threshold
    turned: Cubic = jax.tree.map(lambda number: turn * number, step.relative)
    return fall_in(step.h, turned._replace(begin=turned.begin - shift, end=turned.end - shift))


def fall_in(h: FloatArray, cubic: Cubic) -> FloatArray:
    """When the `cubic` of a step of length `h` falls through zero; meaningless where it does not."""
    falls = (cubic.begin > 0) & (cubic.end < 0)
    s0, s1 = jnp.where(falls, cubic.begin, 1), jnp.where(falls, cubic.end, -1)
    cubic = Cubic(s0, cubic.slope * h, s1, cubic.end_slope * h, cubic.bulge)
    u, usable = look_ahead(*cubic[:4], jnp.zeros_like(s0)).where, falls
    for _ in range(1 if cubic.bulge is None else 3):  # Newton steps: from the root of the cubic, to that of the quartic
        value, slope = hermite(u, jnp.ones_like(u), cubic), _slope_of_cubic(u, cubic)
        usable = falls & (slope < 0)
        u = lax.stop_gradient(jnp.clip(u - jnp.where(usable, value / jnp.where(usable, slope, -1), 0), 0, 1))
    return h * _root(cubic, usable, u)[0]


def stationary(h: FloatArray, cubic: Cubic, turns: BoolArray) -> FloatArray:
    """Where the `cubic` of a step of length `h` is lowest, if it falls at the beginning and rises at the end (`turns`),
    s after the step began; without derivatives.
    """
    h, cubic, turns = lax.stop_gradient((h, cubic, turns))
    scaled = cubic._replace(slope=cubic.slope * h, end_slope=cubic.end_slope * h)
    low, high = jnp.zeros_like(cubic.begin), jnp.ones_like(cubic.begin)
    u = jnp.where(turns, scaled.slope / jnp.where(turns, scaled.slope - scaled.end_slope, 1), 0.5)
    for _ in range(_TURNS):  # Newton's method on the slope, and halvings where it would leave the bracket
        slope, bent = with_slope(lambda u: _slope_of_cubic(u, scaled), u)
        low, high = jnp.where(slope < 0, u, low), jnp.where(slope < 0, high, u)
        newton = u - slope / jnp.where(bent > 0, bent, 1)
        u = jnp.where((bent > 0) & (newton > low) & (newton < high), newton, (low + high) / 2)
    return u * h


def _root_change(cubic: Cubic, usable: BoolArray, u: FloatArray, change: FloatArray) -> FloatArray:
    usable = usable & (u > 0) & (u < 1)
    return jnp.where(usable, -change / jnp.where(usable, _slope_of_cubic(u, cubic), -1), 0)


_root = root_of(lambda cubic, _, u: hermite(u, jnp.ones_like(u), cubic), _root_change)
"""The root `u` of a cubic on [0, 1], with its derivatives of every order; without any where not `usable`."""


def _slope_of_cubic(u: FloatArray, cubic: Cubic) -> FloatArray:
    s0, d0, s1, d1, bulge = cubic
    slope = 6 * u * (1 - u) * (s1 - s0) + d0 * (1 - u) * (1 - 3 * u) + d1 * u * (3 * u - 2)
    return slope if bulge is None else slope + 32 * bulge * u * (1 - u) * (1 - 2 * u)


def _straight_entry(threshold: FloatArray, step: SeenStep) -> FloatArray:
    """When ``|v_rel|`` falls to the threshold, by its slope at the beginning, or by the chord if it rises there."""
    size, rise, end, _ = (_sign(step.relative.begin) * number for number in step.relative[:4])
    above = jnp.maximum(size - threshold, 0)
    total = jnp.maximum(size - end, threshold)
    where = jnp.where(rise < 0, above / jnp.where(rise < 0, -rise, 1), step.h * above / total)
    return jnp.clip(where, 0, step.h)


def _sign(value: FloatArray) -> FloatArray:
    return jnp.where(value < 0, -1.0, 1.0).astype(value.dtype)


def hermite(tau: FloatArray, h: FloatArray, cubic: Cubic) -> FloatArray:
    """The `cubic` of a step of length `h`, `tau` after it began; its first value for a step of no length."""
    x0, v0, x1, v1, bulge = cubic
    u = jnp.where(h > 0, tau / jnp.where(h > 0, h, 1), 0)
    bend = (1 - u) * (1 - u)
    values = x0 * bend * (1 + 2 * u) + x1 * u * u * (3 - 2 * u)
    values = values + h * (v0 * u * bend - v1 * u * u * (1 - u))
    return values if bulge is None else values + 16 * bulge * u * u * bend


def _passage(
    threshold: FloatArray, step: SeenStep, was: BoolArray, entry: FloatArray, leave: FloatArray
) -> tuple[BoolArray, BoolArray, _Pair, _Pair, _Pair]:
    """Which contacts are slow at the end of a step, and which pass rest in it; when they come to rest and leave it; if
    they are closed at both ends; and when they open and close. Instants, s after the step began, are meaningless where
    nothing happens.

    `was`: which were slow. `entry`, `leave`: when a contact would come and go that is closed all the time.
    """
    if step.normal is None:
        closed_before, opening = jnp.ones_like(was), jnp.zeros_like(step.relative.begin)
        closed, closing = closed_before, opening
    else:
        closed_before, closed = step.normal.begin > 0, step.normal.end > 0
        opening, closing = fall_in(step.h, step.normal), fall_in(step.h, jax.tree.map(jnp.negative, step.normal))
    fast_before, fast = (jnp.abs(value) > threshold for value in (step.relative.begin, step.relative.end))
    entry = jnp.maximum(jnp.where(fast_before, entry, 0), jnp.where(closed_before, 0, closing))
    leave = jnp.where(closed, leave, jnp.where(fast, jnp.minimum(leave, opening), opening))
    slow = ~fast & closed
    passes = ~was & ~slow & (step.relative.begin * step.relative.end < 0) & closed_before & closed
    return slow, passes, (entry, leave), (closed_before, closed), (opening, closing)


# Detection of sticks in adaptive steps, which resolve the relative velocity.
#
# A contact is slow while it is closed and its relative velocity is below the threshold, and where this passes zero.
# Between two such times it slips. Where it slips by less than bristles bend from one limit to the other (`elastic_slip`
# of a friction law), it rang after it was caught, or its bristles bent over: it was stuck all the time. So the end of a
# stick is known only when the contact has slipped that far. All closed contacts at once stick while each of them does.


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
    - `all_at_once`: None with one contact.
    """

    slow: BoolArray
    start: FloatArray
    position: FloatArray
    left: Left
    all_at_once: AllAtOnce | None
    found: Found


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
    return JoiningDetector(slow, zero, position, none, all_at_once, Found.nothing(tracks, quantities))


def detect_joined(
    criterion: Criterion,
    detector: JoiningDetector,
    step: SeenStep,
    *,
    jumped: BoolArray,
    after: AtContact,
    last: BoolArray,
) -> tuple[JoiningDetector, StickRecord]:
    """Update the detector by one step; returns it and the record of the stick that is known to have ended, if any.

    A stick is recorded at the latest in the step after its end, so that one of no length must follow the `last`.
    The step may end in a jump of the base (`jumped`), `after` which the contacts are so.
    """
    threshold, now = jnp.asarray(criterion.threshold, step.t.dtype), step.t + step.h
    was, left, bend = detector.slow, detector.left, after.elastic_slip
    given = (crossing(threshold, step, entering=entering) for entering in (True, False))
    slow, passes, (entry, leave), (closed_before, closed), (opening, closing) = _passage(threshold, step, was, *given)
    zero = crossing(jnp.zeros_like(threshold), step, entering=True)
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
    over = _turned_by_jump(threshold, step, after.velocity, jumped) | (after.closed != closed) | last
    holds = slow | following.may_go_on(bend)
    cut = StickSpan(jnp.where(slow, start, following.span.start), jnp.broadcast_to(now, start.shape),
                    jnp.where(slow, position, following.span.position), _own(step.position.end))  # fmt: skip
    how = jnp.where(last, Ending.HORIZON, jnp.where(jumped, Ending.BASE_SWITCHED, Ending.RELEASED)).astype(jnp.int8)
    cut = Left(
        cut,
        jnp.broadcast_to(how, start.shape),
        jnp.full_like(start, jnp.inf),
        jnp.broadcast_to(_of_all(step.position.end), start.shape),
    )
    following = _chosen(holds & over, cut, following)
    slow = jnp.where(over, (jnp.abs(after.velocity) <= threshold) & after.closed & ~last, slow)
    start, position = jnp.where(over, now, start), jnp.where(over, _own(step.position.end), position)

    spans, endings = left.span, jnp.where(ends, left.ending, jnp.int8(-1))
    all_at_once = None
    if detector.all_at_once is not None:
        at_end = jnp.where(over, after.closed, closed)
        changed = jnp.where(closed_before == closed, now, step.t + jnp.where(closed, closing, opening))
        contacts = _Contacts(
            ended=jax.tree.map(
                jnp.append, left._replace(ending=jnp.where(closed_before, endings, jnp.int8(-1))), following
            ),
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
    found, record = _found(criterion, detector.found, spans, endings, endings == Ending.HORIZON)
    return JoiningDetector(slow, start, position, following, all_at_once, found), record


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


def _all_at_once(before: AllAtOnce, step: SeenStep, of: _Contacts) -> tuple[AllAtOnce, StickSpan, IntArray]:
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


def _of_all(tracks: FloatArray) -> FloatArray:
    return tracks[-1] if tracks.ndim else tracks


def _at(step: SeenStep, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where the contacts, and all at once, are in a step `tau` (s) after it began; each has its own `tau`."""
    contacts, of_all = (jax.tree.map(of, step.position) for of in (_own, _of_all))
    return hermite(tau, step.h, contacts), hermite(tau, step.h, of_all)


def _slip(step: SeenStep, first: FloatArray, last: FloatArray) -> FloatArray:
    """How far the contacts slip between two instants of a step, by the cubic of the relative velocity."""
    h, (begin, slope, end, end_slope, bulge) = jnp.where(step.h > 0, step.h, 1), step.relative

    def until(tau: FloatArray) -> FloatArray:
        u = tau / h
        early, late = u * u * u * (u - 2) / 2 + u, u * u * u * (2 - u) / 2
        slopes = slope * u * u * (6 - 8 * u + 3 * u * u) + end_slope * u * u * u * (3 * u - 4)
        area = begin * early + end * late + h * slopes / 12
        if bulge is not None:
            area = area + bulge * u * u * u * (16 / 3 - 8 * u + 16 / 5 * u * u)
        return h * area

    return lax.stop_gradient(jnp.abs(until(last) - until(first)))


def _chosen(which: BoolArray, one: Left, other: Left) -> Left:
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), one, other)
