"""Lanes of regularised dynamics: steps of fixed length, and adaptive steps of friction that is smooth by itself."""

import abc
from functools import partial, reduce
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..._compiler.native import sharing
from ..._excitation.motion import Signal
from ..._excitation.segments import SegmentState
from ..._foundation.types import BoolArray, FloatArray, IntArray, Status
from ..._numerics.derivatives import with_slope, without_derivatives
from ..._numerics.matrices import WRITTEN_OUT, any_of, largest_of
from ..._numerics.steps import rosenbrock_step
from ..._systems.switched_model import Along, Form, State, of_form
from ..common.lanes import SampleTotals
from ..common.method import Regularized
from ..common.path import (
    SegmentLaws,
    StepsEngine,
    StepsShared,
    following_segments,
    has_ended,
    is_spent,
    sample_totals,
    to_digits,
)
from ..sticks import ALL, StickRecord, Totals, no_stick
from .field import AnyField, InnerField, SteppedField, field_of
from .sticks import (
    Cubic,
    JoiningDetector,
    SeenStep,
    StickDetector,
    detect,
    detect_joined,
    fall_in,
    hermite,
    start_detector,
    start_joining,
    stationary,
)

# Steps that end where static friction takes hold of the mass or lets it go.
#
# Where static friction exceeds kinetic friction, a step that passes such an instant goes wrong by more than its length:
# a mass that jumps over the narrow band of relative velocities in which static friction holds it slides on for good. So
# the step is tried again, shortened to end at that instant. The instants carry derivatives: those of the motion after a
# release depend on when it was.


_SAME = 1e-6  # of the change of the needed friction in a step: so near to the limit counts as there
_ULPS = 16
_NEAR = 0.98  # of a step: a passage that soon is at its end


def shortened(step: SeenStep, band: FloatArray, need: FloatArray, end_need: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Whether the step must be tried again, and its new length, s.

    `band`: the relative speed below which static friction can hold the mass, m/s. `need`, `end_need`: friction that
    does, over the largest friction.
    """
    r0, slope, r1, end_slope, _ = step.relative
    before, after = _side(r0, band), _side(r1, band)
    # Bounded measures of the needed friction, 1/2 at its limit.
    holds, held = 1 / (1 + need) - 0.5, 1 / (1 + end_need) - 0.5
    least = _SAME * jnp.abs(holds - held) + _ULPS * jnp.finfo(step.h.dtype).eps
    released = (before == 0) & (holds > least) & (held < -least)
    # While less than static friction is needed, no mass leaves the band.
    strays = (before == 0) & (after != 0) & (held > -least) & (holds > least)

    # Where it slid slowest; if it slid the other way, it was in the band.
    falls, rises = -before * slope, before * end_slope
    turns = (before != 0) & (before == after) & (falls > 0) & (rises > 0)
    lowest_at = jnp.where(turns, step.h * falls / jnp.where(turns, falls + rises, 1), step.h)
    lowest = jnp.where(turns, hermite(lowest_at, step.h, step.relative), r1)
    crosses = (before != 0) & ((before == -after) | turns) & (before * lowest < 0)

    # Where more than static friction is needed, it only passes the band.
    soon = jnp.abs(r0) / jnp.where(falls > 0, falls, 1)
    passes = (before != 0) & (after == 0) & (held < -least) & (falls > 0) & (soon < _NEAR * step.h)

    until_release = step.h * _share(released, holds, -held)
    until_zero = lowest_at * _share(crosses, jnp.abs(r0), jnp.abs(lowest))
    length = jnp.where(passes, soon, jnp.where(crosses, until_zero, step.h / 2))
    return released | strays | crosses | passes, jnp.where(released, until_release, length)


def _side(speed: FloatArray, band: FloatArray) -> FloatArray:
    return jnp.where(jnp.abs(speed) > band, jnp.sign(speed), 0)


def _share(chosen: BoolArray, one: FloatArray, other: FloatArray) -> FloatArray:
    """``one / (one + other)``."""
    return jnp.where(chosen, one, 0) / jnp.where(chosen, one + other, 1)


# Regularised motion in steps of fixed length.
#
# A step ends early where a segment of the base motion or of the load ends, so that it never crosses a jump.


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


class PathStep(NamedTuple):
    """Record of a step for the `CubicPath`: its beginning, the state there, the rates at both ends, and the state in
    the middle, if it is known.
    """

    t: FloatArray
    y: State
    rates: State
    end_rates: State
    middle: State | None = None


def along_step(forms: tuple[Form, ...], step: tuple[PathStep, State, FloatArray], is_fixed: bool) -> Along:
    """The `forms` of the state in a step that ends so and is so long, s; `is_fixed`: without derivatives."""
    (_, y, rates, end_rates, middle), end, h = without_derivatives(step) if is_fixed else step

    def of_all(numbers: State) -> FloatArray:
        return jnp.stack([of_form(form, numbers) for form in forms], axis=-1)

    cubic = Cubic(*map(of_all, (y, rates, end, end_rates)))
    if middle is not None:
        cubic = cubic.through(h, of_all(middle))
    return partial(with_slope, lambda tau: hermite(tau, h, cubic))


def nothing_seen(numbers: State, contacts: int | None, quantities: tuple[str, ...]) -> tuple[StickRecord, PathStep]:
    """The records of an idle step, for a trajectory with `numbers` of its state like these and so many contacts."""
    none = tuple(jnp.zeros_like(value) for value in numbers)
    stick = no_stick(none[0].dtype, quantities, () if contacts is None else (contacts + 1,))
    return stick, PathStep(none[0], none, none, none)


@sharing
def _advance_fixed(
    field: SteppedField,
    segment_laws: SegmentLaws,
    t1: FloatArray,
    step: FloatArray,
    most_steps: IntArray,
    lane: FixedLane,
) -> tuple[FixedLane, StickRecord, PathStep]:
    """One loop step; returns the lane after it, the record of the stick that ended in it, if any, and its `PathStep`.

    The step may be rejected, for its error or where static friction exceeds kinetic friction: the lane stays, and tries
    a shorter one.
    """
    forcing = field.model.forcing(lane.t, segment_laws.segments(lane.segment_states))
    live = (lane.t < t1) & ~is_spent(lane) & (lane.steps < most_steps) & ~any_of(jnp.isnan(lane.y[0]))
    stop = reduce(jnp.minimum, (state.segment.end for state in lane.segment_states), t1)
    left = jnp.where(live, stop - lane.t, 0)
    longest = step if lane.limit is None else jnp.minimum(step, lane.limit)
    # A little more than one step, so that no last step of a few units in the last place remains.
    to_stop = longest * (1 + 1e-6) >= left
    h = jnp.where(to_stop, left, to_digits(lane.t, longest))
    band = field.band(forcing, lane.t, lane.y)
    y, error = field.step(forcing, lane.y, h, band)
    seen, rates, end_rates = field.seen(forcing, lane.t, h, lane.y, y)
    y = (jnp.where(seen.hides_sticks, jnp.nan, y[0]), *y[1:])

    t = jnp.where(to_stop, stop, lane.t + h)
    segment_states, jumped = following_segments(segment_laws, lane.segment_states, t, t < t1)
    after = field.at_contact(field.model.forcing(t, segment_laws.segments(segment_states)), t, y)
    detector, record = detect(field.criterion, lane.detector, seen, jumped=jumped, after=after, last=t >= t1)
    moved = FixedLane(t, y, lane.steps + 1, detector, segment_states, lane.limit)
    accepted = live
    if lane.limit is not None:
        inaccurate, change = jnp.zeros((), bool), _GROWTH
        if error is not None:
            inaccurate = error > 1
            change = jnp.clip(_SAFETY / jnp.sqrt(jnp.maximum(error, _LEAST_ERROR)), 1 / _GROWTH, _GROWTH)
        again, length = inaccurate, lax.stop_gradient(h * change)
        if band is not None:
            in_band = (jnp.abs(seen.relative.begin) <= band) | (jnp.abs(seen.relative.end) <= band)
            needs = field.need(forcing, 0 * h, lane.y, in_band), field.need(forcing, h, y, in_band)
            passes, until = shortened(seen, band, *needs)
            passes, until = any_of(passes), -largest_of(-jnp.where(passes, until, jnp.inf))
            again, length = inaccurate | passes, jnp.where(inaccurate, length, until)
        accepted = live & ~again
        stays = lane._replace(steps=lane.steps + 1, limit=length)
        moved = moved._replace(limit=jnp.minimum(lax.stop_gradient(longest * change), step))
        moved = jax.tree.map(lambda new, old: jnp.where(again, new, old), stays, moved)
    moved = jax.tree.map(lambda new, old: jnp.where(live, new, old), moved, lane)
    record = record._replace(ending=jnp.where(accepted, record.ending, jnp.int8(-1)))
    return moved, record, PathStep(lane.t, *map(field.model.numbers, (lane.y, rates, end_rates)))


RegularizedLane = TypeVar("RegularizedLane")


class RegularizedEngine(StepsEngine[RegularizedLane]):
    """Steps of regularised dynamics; `method`: with every option filled in (`resolved`)."""

    method: eqx.AbstractVar[Regularized]

    @abc.abstractmethod
    def field(self, smooth: Signal | None) -> AnyField:
        """The field under this smooth excitation."""

    def inside(self, smooth: Signal | None, forms: tuple[Form, ...], step: tuple[PathStep, State, FloatArray]) -> Along:
        return along_step(forms, step, True)

    def totals(self, lane: Any) -> Totals:
        return lane.detector.found.totals

    def begun(self, smooth: Signal | None, key_data: Any, dtype) -> tuple[Any, tuple[SegmentState, ...], Any, State]:
        """At the beginning of a trajectory: the field, the segments, the forcing and the state."""
        segment_laws, field = SegmentLaws.of(self.system, self.excitation), self.field(smooth)
        segment_states = segment_laws.first(self.excitation.segment_key_data(key_data), dtype)
        forcing = field.model.forcing(jnp.zeros((), dtype), segment_laws.segments(segment_states))
        return field, segment_states, forcing, field.model.start(tuple(jnp.asarray(of, dtype) for of in self.y0), dtype)

    def results(self, sample: Signal | None, motion: Any) -> SampleTotals:
        _, totals, at_start = motion.detector.found
        return sample_totals(self.system, totals, at_start, self.status(motion), jnp.zeros((), jnp.int32))


class FixedEngine(RegularizedEngine[FixedLane]):
    """Fixed steps; that of `method` is left to `step_length`."""

    method: Regularized

    def lane(self, smooth: Signal | None, key_data: Any, dtype) -> FixedLane:
        field, segment_states, forcing, y = self.begun(smooth, key_data, dtype)
        zero = jnp.zeros((), dtype)
        limit = jnp.full((), jnp.inf, dtype) if field.may_be_short else None
        seen, tracks = field.at_contact(forcing, zero, y), field.model.stick_position(y)
        detector = start_detector(field.criterion, seen, tracks, self.quantities)
        return FixedLane(zero, y, jnp.zeros((), jnp.int32), detector, segment_states, limit)

    def advanced(
        self, shared: StepsShared, smooth: Signal | None, lane: FixedLane
    ) -> tuple[FixedLane, StickRecord, PathStep]:
        return _advance_fixed(self.field(smooth), *shared, jnp.asarray(self.most_steps, jnp.int32), lane)

    def idle(self, lane: FixedLane) -> tuple[StickRecord, PathStep]:
        model = self.field(self.excitation.signal).model
        return nothing_seen(model.numbers(lane.y), model.contacts, ALL)

    def numbers(self, smooth: Signal | None, lane: FixedLane) -> State:
        return self.field(smooth).model.numbers(lane.y)

    def field(self, smooth: Signal | None) -> SteppedField:
        field = field_of(self.system, smooth, self.method)
        assert isinstance(field, SteppedField)
        return field


# Regularised motion in adaptive steps, of friction that is smooth by itself, but may be stiff: bristles, asperities.
#
# Each lane chooses its steps by the error of the last one: `rosenbrock_step`. Where the rates have a kink (`kinks`: of
# bristles, where the relative velocity of a contact passes zero), a step that passes it is tried again, to end there.
# So each step is smooth, and its order that of the method. The instants carry derivatives, as those of segments' ends
# do, and no other length does: what is differentiated is the sequence of steps that were taken. Derivatives of the
# second order need that: across a kink the sequence alone would miss what the jump of the first one adds, however short
# the steps.


_ORDER = 5
_LEAST_CHANGE, _MOST_CHANGE = 0.1, 6.0  # of a step
_FIRST = 0.1  # of the time in which the state would change by itself, times a power of the tolerance: the first step
_AT_END = 1e-3  # of a step: a passage through zero so near to an end is there
_TOO_SHORT = 4  # units in the last place of the time
_ROUND_OFF = 16  # of the relative velocity, likewise


class AdaptiveLane(NamedTuple):
    """Loop state of one trajectory; `y`: what is `AnyField.solved`.

    `limit`: of the next step, s; 0 where none is short enough. `closed`: whether a step of no length has followed the
    last: see `detect_joined`.
    """

    t: FloatArray
    y: State
    steps: IntArray
    detector: JoiningDetector
    segment_states: tuple[SegmentState, ...]
    limit: FloatArray
    closed: BoolArray


def tolerances(field: AnyField, method: Regularized, numbers: int, dtype) -> tuple[FloatArray, FloatArray]:
    """The relative tolerance, and the absolute one of each number that is `AnyField.solved`."""
    rtol = jnp.asarray(method.rtol, dtype)
    atol = jnp.broadcast_to(jnp.asarray(method.atol, dtype), (numbers,))
    if isinstance(field, InnerField) and field.in_logarithms:
        atol = jnp.where(np.arange(numbers) == field.model.speed, rtol, atol)
    return rtol, atol


def _share_of_tolerance(
    field: AnyField,
    forcing: Any,
    h: FloatArray,
    tolerance: tuple[FloatArray, FloatArray],
    error: State,
    before: State,
    after: State,
) -> FloatArray:
    """The `error` of a step of length `h` over what is allowed: the root mean square of all numbers, or if larger that
    of the relative velocity of a contact.

    A contact's is allowed `rtol` of itself, and where it is below the threshold of sticks, of that: an error that is
    small beside the velocities of a slip would shift the beginnings and ends of sticks by far more.
    """
    rtol, atol = tolerance
    sizes = (jnp.maximum(jnp.abs(begin), jnp.abs(end)) for begin, end in zip(before, after, strict=True))
    shares = [wrong / (rtol * size + atol[i]) for i, (wrong, size) in enumerate(zip(error, sizes, strict=True))]
    share = jnp.sqrt(sum((share * share for share in shares), jnp.zeros_like(h)) / len(shares))

    def relative_velocity(tau: FloatArray, numbers: State) -> FloatArray:
        return field.model.relative_velocity(forcing, tau, field.plain(forcing, tau, numbers))

    first = relative_velocity(jnp.zeros_like(h), before)
    last, wrong = jax.jvp(partial(relative_velocity, h), (after,), (error,))
    size = jnp.maximum(jnp.maximum(jnp.abs(first), jnp.abs(last)), field.criterion.threshold)
    return jnp.maximum(share, largest_of(jnp.abs(wrong) / (rtol * size)))


def _known_to(field: AnyField, forcing: Any, h: FloatArray, rtol: FloatArray, numbers: State) -> FloatArray:
    """To what the relative velocities are known where a step ends: what the tolerance allows of one below the threshold
    of sticks, or if larger their round-off.

    That is in proportion to the velocities of which it is the difference; different weights keep these from cancelling.
    """
    weighted = tuple((place + 1) * number for place, number in enumerate(numbers))
    value, gross = jax.jvp(
        lambda numbers: field.model.relative_velocity(forcing, h, field.plain(forcing, h, numbers)),
        (numbers,), (weighted,),
    )  # fmt: skip
    noise = _ROUND_OFF * jnp.finfo(h.dtype).eps * (jnp.abs(value) + jnp.abs(gross))
    return jnp.maximum(rtol * jnp.asarray(field.criterion.threshold, h.dtype), noise)


def _passed(seen: SeenStep, velocity: FloatArray | float, has_corner: bool, known_to: FloatArray) -> FloatArray:
    """Where a step must end for the sake of the kink at this relative velocity, s after it began; infinity if it need
    not.

    Where a contact passes the kink, if it is a corner; and where it is farthest beyond in a step that ends on the side
    on which it began: rates that do not change on that side would let a long step pass over what is beyond. What is
    nearer to the kink than it is `known_to` is on neither side: steps of a contact at rest would never end.
    """
    h, relative = seen.h, seen.relative
    side = jnp.where(relative.begin < velocity, -1, 1).astype(h.dtype)
    above = relative._replace(begin=relative.begin - velocity, end=relative.end - velocity)
    above: Cubic = jax.tree.map(lambda number: side * number, above)
    until = fall_in(h, above) if has_corner else jnp.full_like(above.begin, jnp.inf)
    inside = (above.end < 0) & (until > _AT_END * h) & (until < (1 - _AT_END) * h)
    inside = inside & (jnp.maximum(above.begin, -above.end) > known_to)
    turns = (above.begin > 0) & (above.end > 0) & (above.slope < 0) & (above.end_slope > 0)
    lowest = stationary(h, above, turns)
    dips = turns & (hermite(lowest, h, above) < -known_to)
    until = jnp.where(dips, lowest, jnp.where(inside, until, jnp.inf))
    return -largest_of(-until)


@sharing
def _advance_adaptive(
    field: AnyField,
    segment_laws: SegmentLaws,
    t1: FloatArray,
    longest: FloatArray,
    most_steps: IntArray,
    tolerance: tuple[FloatArray, FloatArray],
    lane: AdaptiveLane,
) -> tuple[AdaptiveLane, StickRecord, PathStep]:
    """As `_advance_fixed`, in a step as long as the tolerance allows; after the last one, a step of no length."""
    forcing = field.model.forcing(lane.t, segment_laws.segments(lane.segment_states))
    is_over = ~(lane.t < t1) | is_spent(lane)
    live = ~lane.closed & (lane.steps < most_steps) & (lane.limit > 0) & ~jnp.isnan(lane.y[0])
    stop = reduce(jnp.minimum, (state.segment.end for state in lane.segment_states), t1)
    left = jnp.where(live & ~is_over, stop - lane.t, 0)
    limit = jnp.minimum(longest, lane.limit)
    to_stop = limit * (1 + 1e-6) >= left
    h = jnp.where(to_stop, left, to_digits(lane.t, limit))
    moves = h > 0
    found = rosenbrock_step(partial(field.solved_rates, forcing), lane.y, jnp.where(moves, h, 1))
    numbers, middle, error = (
        tuple(jnp.where(moves, new, old) for new, old in zip(part, still, strict=True))
        for part, still in zip(found, (lane.y, lane.y, tuple(map(jnp.zeros_like, lane.y))), strict=True)
    )
    share = _share_of_tolerance(*without_derivatives((field, forcing, h, tolerance, error, lane.y, numbers)))
    share = jnp.where(share < 1e10, share, 1e10)  # NaN too
    change = jnp.clip(_SAFETY * jnp.maximum(share, 1e-10) ** (-1 / _ORDER), _LEAST_CHANGE, _MOST_CHANGE)
    inaccurate = share > 1

    states = (field.plain(forcing, tau, part) for tau, part in ((0 * h, lane.y), (h, numbers), (h / 2, middle)))
    before, y, middle = states
    seen, rates, end_rates = field.seen(forcing, lane.t, h, before, y, middle)
    known_to = _known_to(*without_derivatives((field, forcing, h, tolerance[0], numbers)))
    ends = (_passed(seen, kink, field.has_corners, known_to) for kink in field.kinks)
    until = reduce(jnp.minimum, ends, jnp.full_like(h, jnp.inf))
    passes = (until < h) & ~inaccurate
    again = live & (inaccurate | passes)
    numbers = (jnp.where(seen.hides_sticks, jnp.nan, numbers[0]), *numbers[1:])
    t = jnp.where(to_stop & moves, stop, lane.t + h)
    segment_states, jumped = following_segments(segment_laws, lane.segment_states, t, moves & (t < t1))
    after = field.at_contact(field.model.forcing(t, segment_laws.segments(segment_states)), t, y)
    detector, record = detect_joined(field.criterion, lane.detector, seen, jumped=jumped, after=after, last=t >= t1)

    # A step that was cut short says little of how long the next may be.
    following = jnp.where(to_stop, jnp.maximum(h * change, lane.limit), h * change)
    shorter = jnp.where(h > _TOO_SHORT * jnp.finfo(t.dtype).eps * lane.t, h * jnp.minimum(change, _SAFETY), 0)
    limit, steps = lax.stop_gradient(jnp.where(inaccurate, shorter, following)), lane.steps + 1
    limit = jnp.where(passes, until, limit)
    moved = AdaptiveLane(t, numbers, steps, detector, segment_states, limit, is_over)
    stays = lane._replace(steps=steps, limit=limit)
    moved = jax.tree.map(lambda new, old: jnp.where(again, old, new), moved, stays)
    moved = jax.tree.map(lambda new, old: jnp.where(live, new, old), moved, lane)
    record = record._replace(ending=jnp.where(live & ~again, record.ending, jnp.int8(-1)))
    end_rates, middle = jax.tree.map(lambda new, old: jnp.where(again, old, new), (end_rates, middle), (rates, before))
    return moved, record, PathStep(lane.t, *map(field.model.numbers, (before, rates, end_rates, middle)))


class AdaptiveEngine(RegularizedEngine[AdaptiveLane]):
    """Adaptive steps, at most as long as `step_length`; `base_jumps`: whether the velocity of the base may jump."""

    method: Regularized
    base_jumps: bool = eqx.field(static=True, kw_only=True)

    # A lane's stages take as much of the cache as four lanes of other engines. And of more lanes, as of more numbers,
    # some operation is so large that XLA gives it to several threads, and refuses the native loop.

    @property
    def lanes(self) -> int:
        return 64

    @property
    def compiles_natively(self) -> bool:
        return super().compiles_natively and len(self.y0) <= WRITTEN_OUT

    @property
    def knows_extremes(self) -> bool:
        field = self.field(None)
        return not (isinstance(field, InnerField) and field.in_logarithms)

    def lane(self, smooth: Signal | None, key_data: Any, dtype) -> AdaptiveLane:
        field, segment_states, forcing, y = self.begun(smooth, key_data, dtype)
        zero = jnp.zeros((), dtype)
        numbers = field.solved(forcing, y)
        rtol, atol = tolerances(field, self.method, len(numbers), dtype)
        # The rates over every number, or over what is small of it.
        rates = zip(field.solved_rates(forcing, zero, numbers), numbers, atol, strict=True)
        fastest = reduce(jnp.maximum, (jnp.abs(rate) / (jnp.abs(of) + least / rtol) for rate, of, least in rates))
        limit = lax.stop_gradient(_FIRST * rtol ** (1 / _ORDER) / jnp.where(fastest > 0, fastest, 1))
        detector = start_joining(
            field.criterion, field.at_contact(forcing, zero, y), field.model.stick_position(y), self.quantities
        )
        closed = jnp.zeros((), bool)
        return AdaptiveLane(zero, numbers, jnp.zeros((), jnp.int32), detector, segment_states, limit, closed)

    def advanced(
        self, shared: StepsShared, smooth: Signal | None, lane: AdaptiveLane
    ) -> tuple[AdaptiveLane, StickRecord, PathStep]:
        field, most = self.field(smooth), jnp.asarray(self.most_steps, jnp.int32)
        return _advance_adaptive(field, *shared, most, tolerances(field, self.method, len(lane.y), lane.t.dtype), lane)

    def idle(self, lane: AdaptiveLane) -> tuple[StickRecord, PathStep]:
        stick, step = nothing_seen(lane.y, self.field(self.excitation.signal).model.contacts, ALL)
        return stick, step._replace(middle=step.y)

    def ended(self, motion: Any, before: Any) -> BoolArray:
        # What a step of no length must follow is not over yet, though it has reached the end.
        never, most = jnp.full_like(motion.t, jnp.inf), jnp.asarray(self.most_steps, jnp.int32)
        fails = has_ended(motion, never, most) & ~is_spent(motion)
        return motion.closed | fails | ~(motion.limit > 0)

    def status(self, motion: Any) -> IntArray:
        found = super().status(motion)
        gave_up = (motion.limit == 0) & (found == Status.OUT_OF_STEPS)
        return jnp.where(gave_up, jnp.int8(Status.SOLVER_FAILED), found)

    def numbers(self, smooth: Signal | None, lane: AdaptiveLane) -> State:
        field, segment_laws = self.field(smooth), SegmentLaws.of(self.system, self.excitation)
        forcing = field.model.forcing(lane.t, segment_laws.segments(lane.segment_states))
        return field.model.numbers(field.plain(forcing, jnp.zeros_like(lane.t), lane.y))

    def field(self, smooth: Signal | None) -> AnyField:
        return field_of(self.system, smooth, self.method, base_jumps=self.base_jumps)
