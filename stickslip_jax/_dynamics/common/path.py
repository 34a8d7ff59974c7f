"""What the engines share about one trajectory: its result, the segments of its excitation that it passes through,
the tracks of which sticks are counted, its extremes, and how it ends.
"""

import abc
import operator
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial, reduce
from itertools import islice
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ..._compiler.native import sharing
from ..._excitation.excitation import Excitation
from ..._excitation.motion import Signal, SourceVoltage
from ..._excitation.segments import SegmentLaw, SegmentState, added, first_segment, following_segment, is_invalid
from ..._foundation.types import AnyInteger, BoolArray, FloatArray, IntArray, Number, Scalar, Status
from ..._numerics.derivatives import NotKnown, values_of, with_slope, with_slopes
from ..._systems.switched_model import Along, Form, Segments, State
from ..._systems.system import System, is_built_in
from ..sticks import StickRecord, Sticks, Totals, count_slips, sticks_in_order
from .lanes import SIGNS, Asked, End, Engine, SampleTotals, Sums, Work, values_of_forms

T = TypeVar("T")
Other = TypeVar("Other")

# Result of one trajectory, the same for every engine: the state along it, and the parts of a `Simulation`.


class MotionPath(eqx.Module):
    """The state and the base velocity of one trajectory as functions of time."""

    smooth: eqx.AbstractVar[Signal | None]  # part of the excitation

    @property
    @abc.abstractmethod
    def times(self) -> Array:
        """The instants at which the steps or intervals of the path begin, s."""

    @abc.abstractmethod
    def state(self, time: FloatArray) -> State:
        """The state at one time (s)."""

    @abc.abstractmethod
    def largest(self, form: Form, sign: Scalar, last: FloatArray, final: State) -> FloatArray:
        """The largest value of `sign` times a `form` of the state until the time `last` (s), where that is `final`."""

    def with_observed(self, time: FloatArray) -> State:
        """The state at one time (s), followed by what is observed beside it."""
        raise LookupError("of paths of time steps with events")

    def along_steps(self, last: FloatArray, asked: Asked) -> tuple[FloatArray, Sums | None]:
        """What is `asked` of the way until the time `last` (s): extremes as in `WatchedTotals`, and sums."""
        raise LookupError("of paths of time steps with events")

    @abc.abstractmethod
    def segments(self, time: FloatArray) -> Segments:
        """The segments of the piecewise-linear parts of the excitation at one time (s); at a jump, those after it."""

    def base_velocity(self, time: FloatArray) -> FloatArray:
        """The base velocity at one time (s), m/s; 0 where the excitation is only a voltage or a ground acceleration."""
        velocity, _ = added(time, self.segments(time).base)
        if self.smooth is None or isinstance(self.smooth, SourceVoltage):
            return velocity
        return velocity + jnp.asarray(self.smooth.value(time), time.dtype)


class Run(NamedTuple):
    """One trajectory; the fields are those of a `Simulation`."""

    sticks: Sticks
    totals: Totals
    status: Array
    time_reached: Array
    final_state: State
    near_grazing_count: Array
    path: MotionPath
    of_all_contacts: tuple[Sticks, Totals] | None = None

    @classmethod
    def of(cls, system: System, records: StickRecord, totals: Totals, *others: Any) -> "Run":
        """A trajectory with its sticks and totals, and where every contact is counted those of all at once.

        `records`: (records,) or (records, tracks). `totals`: (tracks,), if there are any. `others`: the fields from
        `status` to `path`.
        """
        (records, totals), of_all = apart(of_track((records, totals), system), system)
        of_all = None if of_all is None else (sticks_in_order(of_all[0]), of_all[1])
        return cls(sticks_in_order(records), totals, *others, of_all_contacts=of_all)


# The parts of an excitation that consist of segments, as a trajectory passes through them.


class Parts(eqx.Module, Generic[T]):
    """What belongs to each part of the excitation that consists of segments, as in `Segments`."""

    base: tuple[T, ...]
    ground: tuple[T, ...]
    force: tuple[T, ...]
    normal: tuple[T, ...]

    @property
    def all(self) -> tuple[T, ...]:
        return self.base + self.ground + self.force + self.normal

    def parted(self, of_all: Iterable[Other]) -> Iterator[tuple[Other, ...]]:
        """What belongs to `all` of them, for each of the four parts."""
        remaining = iter(of_all)
        return (tuple(islice(remaining, len(part))) for part in (self.base, self.ground, self.force, self.normal))


class SegmentLaws(Parts[SegmentLaw]):
    """The laws of all parts of the excitation that consist of segments; a lane's `segment_states` have their order."""

    @classmethod
    def of(cls, system: System, excitation: Excitation) -> "SegmentLaws":
        """The parts of excitation, force and normal forces that consist of segments."""
        return cls(excitation.base, excitation.ground, *system.recorded)

    def first(self, key_data: Any, dtype) -> tuple[SegmentState, ...]:
        """The segments at the beginning of the trajectory that `key_data`, those of the excitation, choose."""
        return tuple(first_segment(law, key_data, dtype) for law in self.all)

    def segments(self, segment_states: tuple[SegmentState, ...]) -> Segments:
        """The current segments."""
        return Segments(*self.parted(state.segment for state in segment_states))


def following_segments(
    segment_laws: SegmentLaws, segment_states: tuple[SegmentState, ...], t: FloatArray, ended: BoolArray
) -> tuple[tuple[SegmentState, ...], BoolArray]:
    """The current segments after time `t`, and whether a base velocity jumped there. `ended`: whether the step reached
    the end of a segment.
    """
    following, jumped = [], jnp.zeros((), bool)
    for law, segment_state in zip(segment_laws.all, segment_states, strict=True):
        over = ended & (segment_state.segment.end <= t)
        new = following_segment(law, segment_state, t.dtype)
        following.append(jax.tree.map(lambda new, old, over=over: jnp.where(over, new, old), new, segment_state))
        if law.jumps:  # but not from a value to the same
            before = segment_state.segment
            jumped = jumped | (over & (new.segment.value != before.value + before.slope * (before.end - before.begin)))
    return tuple(following), jumped


def to_digits(t: FloatArray, step: FloatArray) -> FloatArray:
    """The `step` (s) by which the time `t` moves on in fact: what it is rounded by would add up, over many steps."""
    moves = (t + step) - t
    return jnp.where(moves > 0, moves, step)


# The tracks of a system with several contacts: what sticks are counted of, each contact and all at once.


def of_track(tree: T, system: System) -> T:
    """The arrays (..., tracks) in `tree`, or of these what the `system` counts alone, if it does."""
    return (
        tree
        if system.tracks.counted is None
        else jax.tree.map(lambda of_each: of_each[..., system.tracks.counted], tree)
    )


def apart(of_each: T, system: System) -> tuple[T, T | None]:
    """Arrays (..., tracks) of every contact, and those of all contacts at once, where all are counted."""
    if system.tracks.number is None:
        return of_each, None
    own, of_all = (jax.tree.map(lambda values, part=part: values[..., part], of_each) for part in (slice(-1), -1))
    return own, of_all


def sample_totals(
    system: System, totals: Totals, at_start: BoolArray, status: IntArray, near_grazing_count: IntArray
) -> SampleTotals:
    """What is recorded of samples; `totals`, `at_start` (whether a sample began with a stick): (..., tracks)."""
    totals, at_start = of_track((totals, at_start), system)
    return SampleTotals(totals.sticks, count_slips(totals, at_start), totals.stick_time, status, near_grazing_count)


# The extremes of linear forms of the state, where the motion is known as a function of time inside each step.
#
# Each is at the beginning of a step, at the end of the last, or inside a step where the slope is zero. There it is
# found by the slope's sign at a few instants, and then by Newton's method in a short step, else by secants with a
# bisection now and then. The instants need no derivative: an extreme at an inner instant moves, to first order, as the
# value there does (envelope theorem), and one at the beginning of a step as the state there does, events included.


_Step = TypeVar("_Step")


class Bracket(NamedTuple):
    """Two points between which a function falls through zero, and its values there."""

    low: FloatArray
    high: FloatArray
    of_low: FloatArray
    of_high: FloatArray

    @property
    def by_secant(self) -> FloatArray:
        """Where the line through both values is zero."""
        fall = self.of_low - self.of_high
        share = jnp.where(fall > 0, self.of_low / jnp.where(fall > 0, fall, 1), 0.5)
        return self.low + (self.high - self.low) * share

    def narrowed(self, at: FloatArray, value: FloatArray, kept: float = 1.0) -> "Bracket":
        """That with the `value` at a point in it; of the end that stays, so much of the value is `kept`."""
        is_low = value >= 0
        low, high = jnp.where(is_low, at, self.low), jnp.where(is_low, self.high, at)
        of_low, of_high = jnp.where(is_low, value, kept * self.of_low), jnp.where(is_low, kept * self.of_high, value)
        return Bracket(low, high, of_low, of_high)


# Fractions of a step between which the slope's sign is looked at: fine near the beginning, where a motion may die out;
# and in a step that is short beside all that moves.
_INSTANTS = (0.0, 2.0**-12, 2.0**-7, 2.0**-4, 0.25, 0.5, 0.75, 1.0)
_FEW_INSTANTS = (0.0, 0.25, 0.5, 0.75, 1.0)
_TRIES, _NEWTON_STEPS = 12, 3  # the error of the value is that of the instant squared


def largest_in_step(
    fixed: Along, along: Along, start: FloatArray, length: FloatArray, signs: Any, *, is_short: bool
) -> FloatArray:
    """The largest values at the beginning of a step and inside, of each of the `signs` times each form.

    Args:
        fixed: The motion in the step, without derivatives.
        along: The same with them.
        start: The values of the forms at its beginning, (forms,).
        length: Of the step, s; 0 of one that was only tried. Without derivatives.
        signs: 1 or -1, (signs,).
        is_short: Whether the step is short beside all that moves.

    Returns:
        (signs, forms).
    """
    side = jnp.broadcast_to(jnp.asarray(signs, length.dtype)[:, None], (len(signs), len(start)))
    here, everywhere = jax.vmap(fixed), jax.vmap(along)
    # The time since the beginning of the step at which an inner maximum is largest; 0 if there is none.
    instants = np.repeat(np.array(_FEW_INSTANTS if is_short else _INSTANTS)[:, None], len(start), axis=1)
    at = length * jnp.asarray(instants, length.dtype)
    values, slopes = (side[None] * found[:, None] for found in here(at))
    at = jnp.broadcast_to(at[:, None], slopes.shape)
    turns = (slopes[:-1] > 0) & (slopes[1:] < 0)
    # Of several turns the one beside the largest value; in a short step there is one.
    beside = jnp.where(turns, 0 if is_short else jnp.maximum(values[:-1], values[1:]), -jnp.inf)
    bracket, highest = Bracket(at[0], at[-1], slopes[0], slopes[-1]), jnp.full_like(slopes[0], -jnp.inf)
    for i in range(len(turns)):
        part, higher = Bracket(at[i], at[i + 1], slopes[i], slopes[i + 1]), beside[i] > highest
        bracket = jax.tree.map(lambda new, old, higher=higher: jnp.where(higher, new, old), part, bracket)
        highest = jnp.maximum(highest, beside[i])

    def narrow(number: Array, bracket: Bracket) -> Bracket:
        middle = 0.5 * (bracket.low + bracket.high)
        at = jnp.where(number % 4 == 3, middle, bracket.by_secant)  # the Illinois rule, and halving
        # An end that stays has its slope halved, so that the other end moves next.
        return bracket.narrowed(at, side * here(at)[1], kept=0.5)

    if is_short:
        inner = bracket.by_secant
        for _ in range(_NEWTON_STEPS):
            slope, bend = with_slope(lambda at: side * here(at)[1], inner)
            inner = jnp.clip(inner - slope / jnp.where(bend < 0, bend, -jnp.inf), bracket.low, bracket.high)
    else:
        # The secant of the last bracket, not what was tried last: where one end is the zero, the other may be far.
        inner = lax.fori_loop(0, _TRIES, narrow, bracket).by_secant
    inner = lax.stop_gradient(jnp.where(highest > -jnp.inf, inner, 0))
    return jnp.maximum(side * everywhere(inner)[0], side * start[None])


def largest_in_steps(
    inside: Callable[[_Step, bool], Along],
    steps: _Step,
    starts: FloatArray,
    lengths: FloatArray,
    sign: Scalar,
    last: FloatArray,
    *,
    are_short: bool,
) -> FloatArray:
    """The largest value of `sign` times one form over all steps, and where it is the `last`.

    Args:
        inside: Of the data of one step, and whether the motion has no derivatives.
        steps: These data, along a first axis.
        starts: The values at their beginnings, (steps,).
        lengths: Of the steps, s, (steps,); 0 for those that were only tried.
        sign: 1 or -1.
        last: The value at the end of the last step.
        are_short: Whether steps are short beside all that moves.
    """
    signs = jnp.asarray(sign, lengths.dtype)[None]

    def of_one(step: _Step, start: FloatArray, length: FloatArray) -> FloatArray:
        both = inside(step, True), inside(step, False)
        return largest_in_step(*both, start, length, signs, is_short=are_short)

    return jnp.maximum(jnp.max(jax.vmap(of_one)(steps, starts[:, None], lax.stop_gradient(lengths))), sign * last)


# A scan of fixed length that stops early, for trajectories whose number of steps is not known in advance.


CHECK_EVERY = 32
"""Steps between two checks whether all lanes of a batch have ended."""

_Carry = TypeVar("_Carry")
_Record = TypeVar("_Record")


def stopping_scan(
    step: Callable[[_Carry, IntArray], tuple[_Carry, _Record]],
    start: _Carry,
    number: int,
    is_over: Callable[[_Carry, IntArray], BoolArray],
    idle_record: Callable[[_Carry], _Record],
) -> tuple[_Carry, _Record]:
    """``lax.scan(step, start, arange(number))``, idle once ``is_over(carry, index)`` holds in all lanes of a batch.

    `number` is rounded up to a multiple of `CHECK_EVERY`. An idle step leaves the carry unchanged and records
    ``idle_record(carry)``.
    """

    def run(carry, first):
        return lax.scan(step, carry, first + jnp.arange(CHECK_EVERY, dtype=jnp.int32))

    def rest(carry, _):
        record = idle_record(carry)
        return carry, jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (CHECK_EVERY, *jnp.shape(leaf))), record)

    def run_or_rest(carry, first):
        # One condition for the whole batch: with one per lane, vmap would always compute both branches.
        over = eqxi.unvmap_all(lax.stop_gradient(is_over(carry, first)))
        # Reverse mode keeps only the start of these steps and computes them again: that takes less time and far less
        # memory than keeping every intermediate value.
        return lax.cond(over, rest, jax.checkpoint(run), carry, first)

    firsts = jnp.arange(-(-number // CHECK_EVERY), dtype=jnp.int32) * CHECK_EVERY
    carry, records = lax.scan(run_or_rest, start, firsts)
    return carry, jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), records)


def padded_length(number: int) -> int:
    """`number` rounded up to ``2^k`` or ``1.5 * 2^k``, at least `CHECK_EVERY`: few lengths are compiled."""
    size = max(CHECK_EVERY, 1 << (number - 1).bit_length())
    return size * 3 // 4 if size * 3 // 4 >= max(number, CHECK_EVERY) else size


# Whether a trajectory in time steps has ended, and why.


def status_of_lane(lane: Any, t1: FloatArray) -> IntArray:
    """The `Status` of a trajectory that has ended or is given up."""
    finite = reduce(operator.and_, map(_is_finite, lane.y), jnp.isfinite(lane.t + t1))
    unfinished = jnp.where(is_spent(lane), Status.BASE_TOO_SHORT, Status.OUT_OF_STEPS)
    code = jnp.where(finite, jnp.where(lane.t < t1, unfinished, Status.FINISHED), Status.NOT_FINITE)
    for segment_state in lane.segment_states:  # one that cannot be may have made the state infinite
        code = jnp.where(is_invalid(segment_state) & ~(lane.t >= t1), Status.BASE_INVALID, code)
    return code.astype(jnp.int8)


def has_ended(lane: Any, t1: FloatArray, most_steps: IntArray) -> BoolArray:
    """Whether the trajectory has ended: by the horizon, the end of the base motion, a NaN, or too many loop steps."""
    finite = reduce(operator.and_, map(_is_finite, lane.y), jnp.ones((), bool))
    return ~(lane.t < t1) | is_spent(lane) | (lane.steps >= most_steps) | ~finite


def is_short(status: Any) -> bool:
    """Whether a trajectory, or one of a batch, ran out of steps; False where the status is traced."""
    with suppress(NotKnown):
        return bool(np.any(values_of(status) == Status.OUT_OF_STEPS))
    return False


def is_spent(lane: Any) -> BoolArray:
    """Whether some part of the excitation has no further segment."""
    return reduce(operator.or_, (state.spent for state in lane.segment_states), jnp.zeros((), bool))


def _is_finite(value: FloatArray) -> BoolArray:
    finite = jnp.isfinite(value)
    return finite if finite.ndim == 0 else jnp.all(finite)


# Lanes in which a step is a time step.


class StepsShared(NamedTuple):
    """Quantities that all steps share: the laws of the excitation's segments, the horizon and the time step (s)."""

    segment_laws: SegmentLaws
    t1: Array
    step: Array


StepsLane = TypeVar("StepsLane")


_NO_KEY_DATA = np.zeros(2, np.uint32)  # a realisation draws nothing


class StepsEngine(Engine[StepsShared, Signal | None, StepsLane, StickRecord, SampleTotals]):
    """Any system under any excitation, up to `t1`, from `y0`, in time steps of `step_length`.

    A sample that needs more than `most_steps` steps, rejected ones included, is given up. `quantities` of each stick:
    those asked for. The constant of a sample is the smooth part of its excitation.
    """

    system: System
    excitation: Excitation
    t1: Scalar
    y0: tuple[Number, ...] | FloatArray
    step_length: Scalar
    most_steps: AnyInteger | int
    quantities: tuple[str, ...] = eqx.field(static=True, default=(), kw_only=True)
    knows_motion: ClassVar[bool] = False
    """Whether a step has computed the motion that `inside` gives."""

    @property
    def tracks(self) -> int | None:
        return self.system.tracks.number

    @property
    def compiles_natively(self) -> bool:
        return self.system.traits.compiles_natively

    @property
    def lanes(self) -> int:
        return self.system.traits.lanes

    @abc.abstractmethod
    def lane(self, smooth: Signal | None, key_data: Any, dtype) -> StepsLane:
        """The lane at the beginning of the trajectory under this smooth excitation whose segments `key_data` choose."""

    @abc.abstractmethod
    def advanced(
        self, shared: StepsShared, smooth: Signal | None, lane: StepsLane
    ) -> tuple[StepsLane, StickRecord, Any]:
        """The lane after a step, the record of the stick that ended in it, and what the path keeps of the step."""

    @abc.abstractmethod
    def inside(self, smooth: Signal | None, forms: tuple[Form, ...], step: tuple[Any, State, FloatArray]) -> Along:
        """The `forms` of the state within a step, without derivatives.

        `step`: what the path keeps of it, the numbers of the state at its end, and its length, s.
        """

    def steps_are_short(self, smooth: Signal | None) -> bool:
        """Whether steps are short beside all that moves in what `inside` gives."""
        return True

    @abc.abstractmethod
    def totals(self, lane: StepsLane) -> Totals:
        """The sums over the sticks so far, (tracks,)."""

    @abc.abstractmethod
    def numbers(self, smooth: Signal | None, lane: StepsLane) -> State:
        """The numbers of its state."""

    @abc.abstractmethod
    def idle(self, lane: StepsLane) -> tuple[StickRecord, Any]:
        """The same of a step that is not taken."""

    def follow(self, dtype, **begun: Any) -> tuple[StepsLane, tuple[StickRecord, Any]]:
        """One realisation in at most `most_steps` steps: the lane after them, and what is kept of each.

        The loop idles once the trajectory has ended. `begun`: further arguments of `lane`.
        """
        shared, smooth = self.shared(dtype), self.excitation.signal

        def one_step(lane: StepsLane, _: IntArray) -> tuple[StepsLane, tuple[StickRecord, Any]]:
            lane, record, passage = self.advanced(shared, smooth, lane)
            return lane, (record, passage)

        start = self.lane(smooth, _NO_KEY_DATA, dtype, **begun)
        return stopping_scan(one_step, start, int(self.most_steps), lambda lane, _: self.ended(lane, lane), self.idle)

    def followed(self, dtype, most: int) -> Any:
        """`follow`, with derivatives by at most so many numbers computed along with it; under ``jax.vmap`` in native
        blocks where ensembles are followed so too.
        """
        lanes = self.lanes if is_built_in(self) and self.compiles_natively else 1
        return with_slopes(lambda engine: engine.follow(dtype), self, most=most, lanes=lanes)

    def begin(self, key_data: tuple[Array, Array], dtype) -> tuple[Signal | None, StepsLane]:
        realized = self.excitation.realized(key_data, dtype)
        smooth = jax.tree.map(lambda number: jnp.asarray(number, dtype), realized)
        return smooth, self.lane(smooth, key_data, dtype)

    def step(
        self, shared: StepsShared, sample: Signal | None, motion: StepsLane, drawn: None
    ) -> tuple[StepsLane, StickRecord]:
        motion, record, _ = self.advanced(shared, sample, motion)
        return motion, of_track(record, self.system)

    def watched(
        self, shared: StepsShared, sample: Signal | None, motion: StepsLane, drawn: None, asked: Asked
    ) -> tuple[StepsLane, StickRecord, FloatArray, Work | None]:
        if self.knows_motion:
            lane, record, found, work = _watched_step(self, shared, sample, motion, asked)
        else:
            lane, record, passage = self.advanced(shared, sample, motion)
            # One form after the other: for more at once some operation is so large that XLA refuses the native loop.
            given, work = (self, sample, motion, lane, passage), None
            found = jnp.concatenate([_extremes_alone(*given, Asked((form,))) for form in asked.forms], axis=1)
        return lane, of_track(record, self.system), found, work

    def seen(
        self, smooth: Signal | None, begun: Any, length: FloatArray, end: State, asked: Asked
    ) -> tuple[FloatArray, Work | None]:
        """What is asked for beside the extremes of forms of the state, of a step; `begun`: what the path keeps of it,
        `end`: the state after it.
        """
        raise NotImplementedError("of engines that do not know it")

    def end(self, sample: Signal | None, motion: StepsLane) -> End:
        lane: Any = motion
        return End(of_track(self.totals(lane), self.system), lane.t, self.numbers(sample, lane))

    def shared(self, dtype) -> StepsShared:
        t1, step = jnp.asarray(self.t1, dtype), jnp.asarray(self.step_length, dtype)
        return StepsShared(SegmentLaws.of(self.system, self.excitation), t1, step)

    def ended(self, motion: Any, before: Any) -> BoolArray:
        return has_ended(motion, jnp.asarray(self.t1, motion.t.dtype), jnp.asarray(self.most_steps, jnp.int32))

    def status(self, motion: Any) -> IntArray:
        """The `Status` of a lane that has ended or is given up."""
        return status_of_lane(motion, jnp.asarray(self.t1, motion.t.dtype))


def _extremes(
    engine: StepsEngine, smooth: Signal | None, before: Any, after: Any, passage: Any, asked: Asked
) -> FloatArray:
    """Of lanes before and after a step, and what the path keeps of it: extremes of forms of the state."""
    length, end = after.t - before.t, engine.numbers(smooth, after)
    along = engine.inside(smooth, asked.forms, (passage, end, length))
    start = values_of_forms(asked.forms, engine.numbers(smooth, before))
    return largest_in_step(along, along, start, length, SIGNS, is_short=engine.steps_are_short(smooth))


_extremes_alone = sharing(_extremes)


@partial(sharing, whole=True)
def _watched_step(
    engine: StepsEngine, shared: StepsShared, smooth: Signal | None, lane: Any, asked: Asked
) -> tuple[Any, StickRecord, FloatArray, Work | None]:
    """Cut together: the motion in the step is computed once."""
    moved, record, passage = engine.advanced(shared, smooth, lane)
    found, work = [], None
    if asked.forms:
        found.append(_extremes(engine, smooth, lane, moved, passage, asked))
    if asked.observed or asked.sums:
        seen, work = engine.seen(smooth, passage, moved.t - lane.t, moved.y, asked)
        found.append(seen)
    return moved, record, jnp.concatenate(found, axis=1), work
