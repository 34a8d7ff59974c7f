"""The engine of regularised dynamics: its settings, lanes of steps of fixed length, adaptive steps by diffrax, and one
trajectory with its states.
"""

import dataclasses
import math
from collections.abc import Callable
from functools import cache, partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ..._compiler.native import sharing
from ..._compiler.programs import kept_jit, plain_numpy
from ..._excitation.excitation import Excitation, excitation_of
from ..._excitation.motion import Signal
from ..._excitation.segments import SegmentState, SegmentTable
from ..._foundation import checks
from ..._foundation import lazy_diffrax as diffrax
from ..._foundation.types import AnyArray, AnyInteger, BoolArray, DType, FloatArray, IntArray, Number, Scalar, Status
from ..._numerics.derivatives import NotKnown, largest, smallest, with_slope, with_slopes
from ..._numerics.elementary import random_words
from ..._numerics.matrices import any_of
from ..._systems.switched_model import Segments, State
from ..._systems.system import System
from ..common.lanes import SampleTotals, with_leaves
from ..common.method import Regularized, accurate_step, longest_step, max_steps_advice, step_for, time_scales_of
from ..common.path import (
    MotionPath,
    Parts,
    Run,
    SegmentLaws,
    StepsEngine,
    StepsShared,
    following_segments,
    is_short,
    is_spent,
    largest_in_steps,
    of_track,
    padded_length,
    sample_totals,
    status_of_lane,
    stopping_scan,
    to_digits,
)
from ..sticks import ALL, StickRecord, no_stick
from .field import AnyField, InnerField, SteppedField, Switch, field_of
from .sticks import (
    Cubic,
    JoiningDetector,
    SeenStep,
    StickDetector,
    detect,
    detect_joined,
    hermite,
    start_detector,
    start_joining,
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
    r0, slope, r1, end_slope = step.relative
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
    """Record of a step for the `CubicPath`: its beginning, the state there, and the rates at both ends."""

    t: FloatArray
    y: State
    rates: State
    end_rates: State


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
            needs = field.need(forcing, 0 * h, lane.y), field.need(forcing, h, y)
            passes, until = shortened(seen, band, *needs)
            again, length = inaccurate | passes, jnp.where(inaccurate, length, until)
        accepted = live & ~again
        stays = lane._replace(steps=lane.steps + 1, limit=length)
        moved = moved._replace(limit=jnp.minimum(lax.stop_gradient(longest * change), step))
        moved = jax.tree.map(lambda new, old: jnp.where(again, new, old), stays, moved)
    moved = jax.tree.map(lambda new, old: jnp.where(live, new, old), moved, lane)
    record = record._replace(ending=jnp.where(accepted, record.ending, jnp.int8(-1)))
    return moved, record, PathStep(lane.t, *map(field.model.numbers, (lane.y, rates, end_rates)))


class FixedEngine(StepsEngine[FixedLane]):
    """Fixed steps; `method`: with every option filled in (`resolved`), its step left to `step_length`."""

    method: Regularized

    def lane(self, smooth: Signal | None, key_data: Any, dtype) -> FixedLane:
        segment_laws, field = SegmentLaws.of(self.system, self.excitation), self._field(smooth)
        segment_states = segment_laws.first(self.excitation.segment_key_data(key_data), dtype)
        y = field.model.start(tuple(jnp.asarray(value, dtype) for value in self.y0), dtype)
        zero = jnp.zeros((), dtype)
        forcing = field.model.forcing(zero, segment_laws.segments(segment_states))
        limit = jnp.full((), jnp.inf, dtype) if field.may_be_short else None
        seen, tracks = field.at_contact(forcing, zero, y), field.model.stick_position(y)
        detector = start_detector(field.criterion, seen, tracks, self.quantities)
        return FixedLane(zero, y, jnp.zeros((), jnp.int32), detector, segment_states, limit)

    def advanced(
        self, shared: StepsShared, smooth: Signal | None, lane: FixedLane
    ) -> tuple[FixedLane, StickRecord, PathStep]:
        return _advance_fixed(self._field(smooth), *shared, jnp.asarray(self.most_steps, jnp.int32), lane)

    def idle(self, lane: FixedLane) -> tuple[StickRecord, PathStep]:
        model = self._field(self.excitation.signal).model
        return nothing_seen(model.numbers(lane.y), model.contacts, ALL)

    def results(self, sample: Signal | None, motion: FixedLane) -> SampleTotals:
        _, totals, at_start = motion.detector.found
        return sample_totals(self.system, totals, at_start, self.status(motion), jnp.zeros((), jnp.int32))

    def _field(self, smooth: Signal | None) -> SteppedField:
        field = field_of(self.system, smooth, self.method)
        assert isinstance(field, SteppedField)
        return field


# Regularised motion of one trajectory in adaptive steps, by diffrax.


_CLOSING = 2  # steps of no length after the last, at most: see `detect_joined`


class Tables(Parts[SegmentTable]):
    """All segments of one realisation, in the order of `SegmentLaws`."""

    @classmethod
    def of(cls, system: System, excitation: Excitation, key_data: Any, sizes: tuple[int, ...], dtype) -> "Tables":
        """The segments that `key_data` choose; `sizes`: how many of each part (`table_sizes`)."""
        segment_laws, own = SegmentLaws.of(system, excitation), excitation.segment_key_data(key_data)
        tables = (SegmentTable.of(law, own, size, dtype) for law, size in zip(segment_laws.all, sizes, strict=True))
        return cls(*segment_laws.parted(tables))

    def at(self, t: FloatArray) -> Segments:
        """The current segments at time `t`."""
        return Segments(*self.parted(table.at(t) for table in self.all))

    @property
    def base_jumps(self) -> bool:
        """Whether the velocity of the base may jump."""
        return any(table.jumps and len(table.segments.begin) > 1 for table in self.base)

    @property
    def end(self) -> FloatArray | float:
        """Earliest end of a part, s."""
        return reduce(jnp.minimum, (table.end for table in self.all), jnp.inf)

    @property
    def are_invalid(self) -> BoolArray:
        """Whether the part that ends first ends with a segment that cannot be."""
        found = jnp.zeros((), bool)
        for table in self.all:
            found = found | (table.is_invalid & (table.end <= self.end))
        return found

    @property
    def times(self) -> Array | None:
        """The instants at which one segment follows another, s; None without any."""
        times = [table.segments.begin[1:] for table in self.all]
        return jnp.concatenate(times) if sum(map(len, times)) else None


def table_sizes(system: System, excitation: Excitation, t1: Any) -> tuple[int, ...]:
    """Number of segments of each part that suffices for nearly every realisation until `t1` (not traced)."""
    return tuple(law.segments(t1) for law in SegmentLaws.of(system, excitation).all)


class Solution(NamedTuple):
    """The accepted steps of a solution: the state at the beginning of each, and at the end of the last.

    `t`: (steps + 1,), infinity in spare slots. `y`: (steps + 1, states). `steps`: number of accepted steps.
    """

    t: Array
    y: Array
    steps: IntArray
    status: IntArray

    @property
    def seen_steps(self) -> IntArray:
        """How many steps `_detect_in_step` has to see: one of no length follows the last."""
        return jnp.maximum(self.steps, 1) + 1


@cache
def _every_stage_control() -> Any:
    """The class of the control of steps, made when diffrax is first needed."""
    clipped: Any = diffrax.ClipStepSizeController

    class EveryStageControl(clipped):
        """A control after whose steps the solver computes the first stage of the next one anew.

        By itself it takes that stage from the step before, unless there was a jump in between, in any trajectory of the
        batch: the two differ in the last digits of implicit solvers, and each sample would depend on its neighbours.
        """

        def adapt_step_size(self, *args: Any) -> Any:
            keeps, t0, t1, _, state, result = super().adapt_step_size(*args)
            return keeps, t0, t1, True, state, result

    return EveryStageControl


def solve_adaptive(
    field: AnyField,
    tables: Tables,
    t1: FloatArray,
    y0: tuple[Number, ...],
    method: Regularized,
    longest_step: Scalar,
    max_steps: int,
) -> Solution:
    """Solve one trajectory up to `t1` or the end of the base motion, in at most `max_steps` steps, accepted or not.

    `method`: with every option filled in. `longest_step`: s.
    """
    dtype = t1.dtype
    zero = jnp.zeros((), dtype)

    atol = jnp.broadcast_to(jnp.asarray(method.atol, dtype), (len(y0),))
    start = jnp.stack([jnp.asarray(v, dtype) for v in y0])
    in_logarithms = None
    if isinstance(field, InnerField) and field.model.spans_decades and not tables.base_jumps:
        in_logarithms = field.model
        start = jnp.stack(in_logarithms.with_logarithm(in_logarithms.forcing(zero, tables.at(zero)), tuple(start)))
        atol = atol.at[in_logarithms.speed].set(method.rtol)

    def rates(t, y, _):
        forcing = field.model.forcing(t, tables.at(t))
        if in_logarithms is not None:
            return jnp.stack(in_logarithms.rates_with_logarithm(forcing, tuple(y)))
        return jnp.stack(field.model.numbers(field.rates(forcing, zero, field.model.start(tuple(y), dtype))))

    jumps = tables.times
    control = diffrax.PIDController(rtol=method.rtol, atol=atol, dtmax=jnp.asarray(longest_step, dtype))
    # The first stage of a very stiff step, computed anew from the state, would be its round-off enlarged: without jumps
    # no trajectory of a batch needs it.
    if in_logarithms is None or jumps is not None:
        control = _every_stage_control()(control, jump_ts=jumps)
    end = jnp.minimum(t1, tables.end)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates), method.solver, zero, end, None, start,
        saveat=diffrax.SaveAt(t0=True, steps=True), stepsize_controller=control, max_steps=max_steps,
        adjoint=method.adjoint, throw=False,
    )  # fmt: skip
    t, y = jnp.asarray(solution.ts), jnp.asarray(solution.ys)
    if in_logarithms is not None:

        def plain(t: FloatArray, y: Array) -> Array:
            here = jnp.where(jnp.isfinite(t), t, 0)
            return jnp.stack(in_logarithms.without_logarithm(in_logarithms.forcing(here, tables.at(here)), tuple(y)))

        y = jax.vmap(plain)(t, y)
    steps = jnp.sum(jnp.isfinite(t)).astype(jnp.int32) - 1
    full = solution.result == diffrax.RESULTS.max_steps_reached
    code = jnp.where(solution.result == diffrax.RESULTS.successful, Status.FINISHED, Status.SOLVER_FAILED)
    code = jnp.where(full, Status.OUT_OF_STEPS, code)
    ended = jnp.where(tables.are_invalid, Status.BASE_INVALID, Status.BASE_TOO_SHORT)
    code = jnp.where((code == Status.FINISHED) & (end < t1), ended, code)
    finite = jnp.all(jnp.isfinite(y[steps])) & jnp.isfinite(t1)
    return Solution(t, y, steps, jnp.where(finite, code, Status.NOT_FINITE).astype(jnp.int8))


def follow_adaptive(
    field: AnyField,
    tables: Tables,
    t1: FloatArray,
    y0: tuple[Number, ...],
    method: Regularized,
    longest_step: Scalar,
    max_steps: int,
    quantities: tuple[str, ...],
    kept: Callable[[StickRecord, PathStep], Any],
) -> tuple[Solution, JoiningDetector, Any]:
    """Solve one trajectory (`solve_adaptive`) and find its sticks; also what is `kept` of each step.

    `quantities` of each stick: those that are asked for.
    """
    solution = solve_adaptive(field, tables, t1, y0, method, longest_step, max_steps)
    model, zero = field.model, jnp.zeros((), t1.dtype)
    start = model.start(tuple(solution.y[0]), t1.dtype)
    seen, tracks = field.at_contact(model.forcing(zero, tables.at(zero)), zero, start), model.stick_position(start)

    def one_step(detector: JoiningDetector, index: IntArray) -> tuple[JoiningDetector, Any]:
        detector, record, passage = _detect_in_step(field, tables, t1, solution, detector, index)
        return detector, kept(record, passage)

    detector, found = stopping_scan(
        one_step,
        start_joining(field.criterion, seen, tracks, quantities),
        max_steps + _CLOSING,
        lambda _, index: index >= solution.seen_steps,
        lambda _: kept(*nothing_seen(tuple(solution.y[0]), model.contacts, quantities)),
    )
    return solution, detector, found


def _detect_in_step(
    field: AnyField,
    tables: Tables,
    t1: FloatArray,
    solution: Solution,
    detector: JoiningDetector,
    index: IntArray,
) -> tuple[JoiningDetector, StickRecord, PathStep]:
    """Run the stick detector over step number `index` of a solution; beyond its `seen_steps` nothing changes."""
    live = index < solution.seen_steps
    index = jnp.minimum(index, solution.steps)
    model, dtype = field.model, solution.y.dtype
    t, y = solution.t[index], model.start(tuple(solution.y[index]), dtype)
    # A solution without steps is read as steps of no length.
    following = jnp.minimum(index + 1, solution.steps)
    now, reached = solution.t[following], model.start(tuple(solution.y[following]), dtype)
    h = now - t
    segments, next_segments = tables.at(t + h / 2), tables.at(now)
    seen, rates, end_rates = field.seen(model.forcing(t, segments), t, h, y, reached)
    jumped = jnp.zeros((), bool)
    for table, old, new in zip(tables.base, segments.base, next_segments.base, strict=True):
        jumped = jumped | ((old.begin != new.begin) & table.jumps)
    after = field.at_contact(model.forcing(now, next_segments), now, reached)
    jumped, last = jumped & (now < t1), now >= t1
    moved, record = detect_joined(field.criterion, detector, seen, jumped=jumped, after=after, last=last)
    moved = jax.tree.map(lambda new, old: jnp.where(live, new, old), moved, detector)
    hidden = live & (tables.end > 0) & seen.hides_sticks  # what ends where it begins has no motion
    totals = moved.found.totals
    totals = totals._replace(stick_time=jnp.where(hidden, jnp.nan, totals.stick_time))
    moved = moved._replace(found=moved.found._replace(totals=totals))
    record = record._replace(ending=jnp.where(live, record.ending, jnp.int8(-1)))
    return moved, record, PathStep(t, *map(model.numbers, (y, rates, end_rates)))


def status_of(solution: Solution, detector: JoiningDetector) -> IntArray:
    """How a solution ended whose steps the `detector` has seen."""
    return jnp.where(any_of(jnp.isnan(detector.found.totals.stick_time)), jnp.int8(Status.NOT_FINITE), solution.status)


# Defaults of a regularised simulation: thresholds and tolerances from the scales of the system.


ADAPTIVE_STEPS, MORE = 2**14, 8
"""Adaptive steps of a trajectory, and how many times as many where they are too few; twice."""
_TRIES, _FEW = 2, 256  # of shortened steps
_SLOW = 1e-3  # of the velocity that friction changes: the threshold of laws with an inner state


def resolved(system: System, excitation: Excitation, method: Regularized, dtype) -> Regularized:
    """`method` with every option filled in, its numbers as arrays of `dtype`.

    Raises ValueError where an option is needed because the system's scales are not known.
    """
    if system.memory.ages:
        raise ValueError(
            "Argument method must be Exact(...) for friction that grows while a stick lasts, but "
            f"{checks.show(method)} was given: smoothed friction has no stick whose age is known."
        )
    if system.traits.jumps_at_places:
        raise checks.refused("method", "be Exact(...) for friction that jumps from place to place", method)
    inner = bool(system.memory.laws)
    if inner and (method.width is not None or method.step is not None):
        laws = "for friction laws with an inner state, which are smooth by themselves and stiff"
        raise checks.refused("method", f"be Regularized() without a width and a step {laws}", method)
    if not inner and method.width is None:
        hint = "only friction laws with an inner state, such as LuGre, need none"
        raise checks.refused("width", "be positive (in m/s)", None, hint)
    _check_contacts(system, method)
    xp = plain_numpy()
    width = None if method.width is None else jnp.asarray(method.width, dtype)
    speed, deceleration, state_sizes = system.sizes(excitation)
    # Static friction above kinetic friction holds a mass up to one width.
    slow = width if system.static_exceeds_kinetic and not inner else speed
    for name, scale in (("threshold", slow), ("minimum_duration", deceleration)):
        if getattr(method, name) is None and scale is None:
            own = "; or give it the properties speed_scale and shortest_time" if hasattr(system, "speed_scale") else ""
            raise ValueError(
                f"Argument method must give the {name}, Regularized(..., {name}=...), because the velocities of a "
                f"{type(system).__name__} are not known{own}."
            )
    threshold = method.threshold
    if threshold is None:
        if width is None:
            threshold = _SLOW * xp.asarray(speed)
        else:
            held = system.static_exceeds_kinetic
            threshold = width if held else Switch(width, method.shape).creep(jnp.asarray(speed))
    duration = method.minimum_duration
    if duration is None:
        assert deceleration is not None
        # Without friction nothing sticks, however slowly the mass passes through.
        slows = xp.asarray(deceleration) > 0
        never = min(checks.LARGEST, float(jnp.finfo(dtype).max))
        duration = xp.where(slows, 10 * threshold / xp.where(slows, deceleration, 1), never)
        duration = duration if method.step is None else xp.maximum(duration, 2 * method.step)
    adaptive = method.step is None
    scales = xp.stack([xp.asarray(size, dtype) for size in state_sizes])
    scales = xp.where(scales > 0, scales, 1)
    atol = method.rtol * scales if method.atol is None else method.atol
    if np.shape(atol) not in ((), scales.shape):
        raise ValueError(
            f"Argument atol must be one number, or one for each of the {len(scales)} states, but an array of shape "
            f"{np.shape(atol)} was given."
        )
    return dataclasses.replace(
        method,
        width=width,
        step=None if adaptive else jnp.asarray(method.step, dtype),
        solver=diffrax.Kvaerno3() if adaptive and method.solver is None else method.solver,
        rtol=jnp.asarray(method.rtol, dtype),
        atol=jnp.asarray(atol, dtype),
        threshold=jnp.asarray(threshold, dtype),
        minimum_duration=jnp.asarray(duration, dtype),
        adjoint=diffrax.RecursiveCheckpointAdjoint() if adaptive and method.adjoint is None else method.adjoint,
    )


def _check_contacts(system: System, method: Regularized) -> None:
    """Check what several contacts cannot have. Raises ValueError for it."""
    contacts = system.tracks.contacts
    for name in ("threshold", "minimum_duration"):
        shape = np.shape(getattr(method, name)) if getattr(method, name) is not None else ()
        if shape not in ((),) + (() if contacts is None else ((contacts,),)):
            each = "" if contacts is None else f", or one for each of the {contacts} contacts"
            raise ValueError(f"Argument {name} must be one number{each}, but an array of shape {shape} was given.")
    if contacts is not None and method.step is not None and system.static_exceeds_kinetic:
        raise ValueError(
            "Argument method must be Exact(), or Regularized(width) without a step, where static friction exceeds "
            "kinetic friction in a list of contacts or under a normal force that varies, but a fixed step was given; "
            "or make static friction equal to kinetic friction."
        )


def fixed_steps(system: System, excitation: Excitation, method: Regularized, t1: Scalar) -> int:
    """The largest number of fixed steps that a trajectory takes: ``t1 / step``, and one for the end of each segment,
    twice that where steps must be shorter.

    Where JAX traces a time scale, the given step counts: a trajectory whose steps must be shorter may run out of them.
    Raises NotKnown where `t1` or the given step is traced, ValueError for a step that is too long for the shortest
    time scale.
    """
    horizon, step = largest(t1), step_for(system, excitation, method)
    try:
        shortest = smallest(step)
    except NotKnown:
        shortest = smallest(method.step)
    found = time_scales_of(system, excitation)
    suits = found.are_all and all(of.time is not None for of in found.scales.values())
    if not suits:
        shortest = accurate_step(system, excitation, shortest)
    steps = math.ceil(horizon / shortest) + sum(table_sizes(system, excitation, horizon)) + 1
    return steps if suits and not system.static_exceeds_kinetic else _TRIES * steps + _FEW


def numbers_as_arrays(tree: Any, dtype) -> Any:
    """Plain numbers in `tree`, whole ones too, as arrays, so that other numbers need no recompilation."""

    def convert(leaf):
        return jnp.asarray(leaf, dtype) if isinstance(leaf, (int, float)) and not isinstance(leaf, bool) else leaf

    return jax.tree.map(convert, tree)


# Many trajectories of regularised dynamics in adaptive steps: whole batches.


class AdaptiveBatch(NamedTuple):
    """Samples of any system under any excitation that diffrax solves together, each in its own steps.

    `method`: with every option filled in. `longest_step`: of any sample, s (`method.py`). `sizes`: number
    of segments to draw for each part of the excitation (`table_sizes`). The slowest sample determines the time of the
    batch.
    """

    system: System
    excitation: Excitation
    method: Regularized
    t1: Scalar
    y0: tuple[Number, ...]
    longest_step: Scalar
    sizes: tuple[AnyInteger, ...]


def solve_batch(
    batch: AdaptiveBatch,
    varying: tuple[AnyArray, ...],
    key_data: Array,
    realization: AnyArray,
    used: AnyInteger,
    *,
    samples: int,
    leaf_numbers: tuple[int, ...],
    sizes: tuple[int, ...],
    most: int,
    keep: bool,
    dtype: DType,
) -> tuple[SampleTotals, StickRecord | None]:
    """Solve samples of a key; with `keep`, also a `StickRecord` (samples, steps).

    `realization` (samples,): the number that each draws its excitation by. `used`: number of samples that are needed;
    the others end at once. `most`: the largest number of steps of each. `varying`, `leaf_numbers`: the leaves of the
    batch that differ from sample to sample, arrays (samples, ...), and which these are. `sizes`: those of the batch.
    """
    t1 = jnp.asarray(batch.t1, dtype)

    def one(place, number, varying):
        words = random_words(key_data, number)
        here = with_leaves(batch, leaf_numbers, varying)
        smooth = jax.tree.map(partial(jnp.asarray, dtype=dtype), here.excitation.realized(words, dtype))
        tables = Tables.of(here.system, here.excitation, words, sizes, dtype)
        y0, until = tuple(jnp.asarray(value, dtype) for value in here.y0), jnp.where(place < used, t1, 0)
        given = field_of(here.system, smooth, here.method), tables, until, y0, here.method, here.longest_step
        solution, detector, records = follow_adaptive(
            *given, most, ALL if keep else (), lambda record, _: of_track(record, here.system) if keep else None
        )
        return detector.found, status_of(solution, detector), records

    found, statuses, records = jax.vmap(one)(
        jnp.arange(samples, dtype=jnp.uint32), jnp.asarray(realization, jnp.uint32), varying
    )
    near = jnp.zeros(statuses.shape, jnp.int32)
    return sample_totals(batch.system, found.totals, found.at_start, statuses, near), records


# One trajectory of regularised dynamics, in fixed or adaptive steps, and the state along it.


_MOST_SLOPES = 8  # by more numbers, going back over the steps takes less time
_NO_KEY_DATA = np.zeros(2, np.uint32)  # a realisation draws nothing


class CubicPath(MotionPath):
    """Path given by the states and rates at the ends of all steps, with a cubic for each state in between.

    `t` (s) and `y` have an entry for the beginning of each step and one for the end of the last.
    """

    smooth: Signal | None
    tables: Tables
    t: Array
    y: State
    rates: State
    end_rates: State

    @classmethod
    def of(
        cls, smooth: Signal | None, tables: Tables, passages: PathStep, steps: IntArray, last: FloatArray, final: State
    ):
        """The path of the first `steps` passages (the others are empty), which ends at time `last` in `final`."""
        live = jnp.arange(len(passages.t)) < steps

        def closed(values, end):
            return jnp.append(jnp.where(live, values, end), end)

        y = tuple(closed(values, end) for values, end in zip(passages.y, final, strict=True))
        return cls(smooth, tables, closed(passages.t, last), y, passages.rates, passages.end_rates)

    @property
    def times(self) -> Array:
        return self.t[:-1]

    def state(self, time: FloatArray) -> State:
        index = jnp.clip(jnp.searchsorted(self.t, time, side="right") - 1, 0, len(self.t) - 2)
        tau, h = time - self.t[index], self.t[index + 1] - self.t[index]
        return tuple(
            hermite(tau, h, Cubic(y[index], rate[index], y[index + 1], end_rate[index]))
            for y, rate, end_rate in zip(self.y, self.rates, self.end_rates, strict=True)
        )

    def largest(self, number: int, sign: Scalar, last: FloatArray, final: FloatArray) -> FloatArray:
        y, lengths = self.y[number], jnp.diff(self.t)
        cubics = Cubic(y[:-1], self.rates[number], y[1:], self.end_rates[number])

        def inside(step: tuple[Cubic, FloatArray], tau: FloatArray) -> tuple[FloatArray, FloatArray]:
            return with_slope(lambda tau: sign * hermite(tau, step[1], step[0]), tau)

        return largest_in_steps(inside, (cubics, lengths), sign * cubics.begin, lengths, sign * final)

    def segments(self, time: FloatArray) -> Segments:
        return self.tables.at(time)


def follow_regularized(
    system: System, base: Any, method: Regularized, t1: Scalar, y0: tuple[Number, ...], dtype
) -> tuple[Regularized, Run]:
    """Simulate one realisation; returns the method with every option filled in, and the trajectory."""
    excitation = excitation_of(base)
    system.check_excitation(excitation)
    given, method = method, resolved(system, excitation, method, dtype)
    if given.step is not None:
        step = step_for(system, excitation, given)  # raises for a step that is too long; shortens it where traced
        if checks.is_traced(step):
            method = dataclasses.replace(method, step=lax.stop_gradient(jnp.asarray(step, dtype)))
    adaptive = method.step is None
    steps = method.max_steps or ADAPTIVE_STEPS
    if not adaptive and method.max_steps is None:
        try:
            steps = padded_length(fixed_steps(system, excitation, given, t1))
        except NotKnown:
            raise ValueError(
                "Argument method must give max_steps, Regularized(..., max_steps=...), when t1 or the step is an "
                f"argument of a function under jax.jit: {max_steps_advice(system, excitation, given, t1)}."
            ) from None
    sizes = table_sizes(system, excitation, t1)
    longest = longest_step(system, excitation) if adaptive else math.inf
    system, excitation, t1, y0, longest = numbers_as_arrays((system, excitation, t1, y0, longest), dtype)
    setting = system, excitation, method, jnp.asarray(t1), y0, longest
    run: Run = _follow(*setting, steps, sizes)
    if not adaptive:
        return method, run
    while given.max_steps is None and steps < ADAPTIVE_STEPS * MORE**2 and is_short(run.status):
        steps *= MORE
        run = _follow(*setting, steps, sizes)
    return dataclasses.replace(method, max_steps=steps), run


@kept_jit(filtered=True)
def _follow(
    system: System,
    excitation: Excitation,
    method: Regularized,
    t1: Array,
    y0: tuple[Number, ...],
    longest: Scalar,  # of adaptive steps, s
    steps: int,
    sizes: tuple[int, ...],
) -> Run:
    tables = Tables.of(system, excitation, _NO_KEY_DATA, sizes, t1.dtype)
    if method.step is None:
        field = field_of(system, excitation.signal, method)
        solution, detector, kept = follow_adaptive(
            field, tables, t1, y0, method, longest, steps, ALL, lambda *found: found
        )
        end = solution.steps, solution.t[solution.steps], tuple(solution.y[solution.steps])
        status = status_of(solution, detector)
    else:
        # Tolerances are for adaptive steps, and the shortest duration only decides: neither has a derivative.
        shortest = lax.stop_gradient(method.minimum_duration)
        fixed = dataclasses.replace(method, step=None, atol=None, minimum_duration=shortest)
        engine = FixedEngine(system, excitation, t1, y0, method.step, steps, fixed, quantities=ALL)
        lane, kept = with_slopes(lambda engine: engine.follow(t1.dtype), engine, most=_MOST_SLOPES)
        final = system.switched_model(excitation.signal, None).numbers(lane.y)
        detector, end, status = lane.detector, (lane.steps, lane.t, final), status_of_lane(lane, t1)
    records, passages = kept
    path = CubicPath.of(excitation.signal, tables, passages, *end)
    return Run.of(system, records, detector.found.totals, status, *end[1:], jnp.zeros((), jnp.int32), path)
