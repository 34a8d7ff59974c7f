"""Signed distances (`boundaries.py`) for any system, one step of the switched engine at a time.

While a mode lasts its guard is positive (`_dynamics/switched/stepping.py`). Where the guard falls and rises again, its
minimum tells how far the arc is from an event; where it falls through zero, the flow continued beyond the event has
that minimum too, with the other sign. So the minimum is smooth through 0 and known on both sides.

Its instant is searched for without derivatives (`_search`); the derivatives come from one evaluation there (`_at`).
"""

from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import PyTree

from .._compiler import sharing
from .._dynamics.common.path import SegmentLaws, following_segments
from .._dynamics.switched.stepping import Lane
from .._excitation.segments import SegmentState
from .._foundation.types import BoolArray, FloatArray
from .._numerics.derivatives import without_derivatives
from .._numerics.steps import steepest_fall
from .._systems.switched_model import OneContactModel, Segments, State
from .boundaries import BoundaryDistances, SignedDistance

_ROUND_OFF = {8: 1e-9, 4: 1e-3}  # of the guard's scale: a minimum closer to 0 is exactly 0 but for round-off
_FAR = 0.5  # of the guard's scale: beyond the width of any kernel
# Search along a flow: increments in time steps, then a number of refinements between the last two instants.
_INCREMENTS, _REFINEMENTS = np.linspace(0.5, 1.5, 12), 5
_JUST_AFTER, _SOON = 0.05, 4.0  # time steps; beyond the width of any kernel

_Tree = TypeVar("_Tree")
_Start: TypeAlias = tuple[FloatArray, State, FloatArray]
"""Time, state and sign at the beginning of a flow; a first axis of two for both flows of a step (`_search`)."""


class EngineStep(NamedTuple):
    """A step of the engine: time, state, sign and segment states at its start; time, state and sign at its end.

    `crossed`: when the slip began, if it began as the mass crossed the base velocity, s; else negative.
    """

    t: FloatArray
    y: State
    sign: FloatArray
    segment_states: tuple[SegmentState, ...]
    end: FloatArray
    y_end: State
    sign_end: FloatArray
    crossed: FloatArray

    @classmethod
    def of(cls, before: Lane, after: Lane, crossed: FloatArray) -> "EngineStep":
        """The step that led from `before` to `after`."""
        return cls(before.t, before.y, before.sign, before.segment_states, after.t, after.y, after.sign, crossed)


class _Outcome(NamedTuple):
    """What happened in a step of length `tau`; `stop`: end of the current excitation segment, or t1 if earlier (s)."""

    tau: FloatArray
    stop: FloatArray
    has_event: BoolArray  # the mode switched, not because of a jump of the excitation
    crosses: BoolArray  # the mass crossed the base velocity, and friction could hold it or nearly could
    dips: BoolArray  # the grazing measure (`_measure`) fell and rose again
    fall: FloatArray  # where it fell most steeply, as a fraction of the step
    falls: BoolArray  # the guard was falling when the segment ended, and about to reach zero
    rise: FloatArray  # slope of the grazing measure at the end of the step

    @property
    def is_candidate(self) -> BoolArray:
        """Whether the step may be close to a boundary; no other step is."""
        return self.has_event | self.crosses | self.dips | self.falls


class _Root(NamedTuple):
    """Result of a search along a flow: time `tau` from its start (s); whether it succeeded; the residual's slope."""

    tau: FloatArray
    found: BoolArray
    rate: FloatArray


class _AtRoot(NamedTuple):
    """Time and state at a root, and the guard with its slope there."""

    t: FloatArray
    y: State
    value: FloatArray
    slope: FloatArray


def crossed_after(segment_laws: SegmentLaws, t1: FloatArray, step: EngineStep) -> FloatArray:
    """`EngineStep.crossed` for the step after `step`."""
    ends = [
        (law.jumps, segment_state.segment.end)
        for law, segment_state in zip(segment_laws.all, step.segment_states, strict=True)
    ]
    crosses = (step.sign != 0) & (step.sign_end == -step.sign) & (step.end < _stop(t1, step))
    # Once the base velocity has jumped, the slip does not count as begun at the base velocity any more.
    jumped = jnp.any(jnp.stack([jnp.zeros((), bool), *(step.end >= end for jumps, end in ends if jumps)]))
    goes_on = (step.sign_end == step.sign) & ~jumped
    return jnp.where(crosses, step.end, jnp.where(goes_on, step.crossed, -1))


@sharing
def is_candidate(
    model: OneContactModel, segment_laws: SegmentLaws, t1: FloatArray, step_length: FloatArray, step: EngineStep
) -> BoolArray:
    """Whether the step may be close to a boundary."""
    return _outcome_of(*without_derivatives((model, segment_laws, t1, step_length, step))).is_candidate


@sharing
def distances_of_step(
    model: OneContactModel, segment_laws: SegmentLaws, t1: FloatArray, step_length: FloatArray, step: EngineStep
) -> BoundaryDistances:
    """The signed distances of a step for which `is_candidate` is true."""
    # What has no derivatives decides and searches; the rest is evaluated once, at the instants found.
    still, still_laws, fixed = without_derivatives((model, segment_laws, step))
    still_t1, still_length = lax.stop_gradient(t1), lax.stop_gradient(step_length)
    outcome, sticking = _outcome_of(still, still_laws, still_t1, still_length, fixed), step.sign == 0
    segments = segment_laws.segments(step.segment_states)
    # Two flows: that of the step, and that of a mass which crosses the base velocity at the step's end.
    start = _stacked((step.t, step.y, step.sign), (step.end, step.y_end, -step.sign))
    still_segments = still_laws.segments(fixed.segment_states)
    roots = _search(still, still_segments, without_derivatives(start), fixed, outcome, still_length)
    at_roots = _at(model, segments, start, roots.tau)
    (here, then), (across, then_across) = (
        jax.tree.map(lambda leaf, flow=flow: leaf[flow], (roots, at_roots)) for flow in (0, 1)
    )
    grazing, nearest = _grazing(model, segments, step, outcome, here, then)
    would_switch, is_late = _switch_without_stop(model, segments, fixed, outcome, here, then)
    switch = jnp.where(outcome.has_event, step.end, would_switch)
    is_undone = _is_undone(still, still_laws, fixed, outcome)
    at_horizon = outcome.stop >= t1
    # No stick begins after t1; a slip after t1 splits none.
    horizon = SignedDistance(t1 - switch, (outcome.has_event | (is_late & at_horizon)) & ~sticking)
    # Ends of segments depend on the parameters; `outcome.stop` has no derivatives.
    before_stop = SignedDistance(_stop(t1, step) - switch, (outcome.has_event | is_late) & is_undone & ~at_horizon)
    time = jnp.where(outcome.has_event | outcome.crosses, fixed.end, jnp.where(is_late, outcome.stop, nearest))
    return BoundaryDistances(
        time=lax.stop_gradient(time),
        exists=outcome.has_event,
        is_slip=sticking,
        grazing=grazing,
        switch=before_stop,
        horizon=horizon,
        crossing=_crossing(model, segments, step, outcome, across, then_across),
    )


def _outcome_of(
    model: OneContactModel, segment_laws: SegmentLaws, t1: FloatArray, step_length: FloatArray, step: EngineStep
) -> _Outcome:
    sticking = step.sign == 0
    tau = step.end - step.t
    stop = _stop(t1, step)
    inputs = model.forcing(step.t, segment_laws.segments(step.segment_states))

    def measured(tau, y):
        s, d = model.guard(inputs, tau, y, step.sign)
        return s, d, *_measure(s, d, tau + _lag(step), _after_crossing(step))

    s, d, q, dq = jax.vmap(measured)(*_stacked((jnp.zeros_like(tau), step.y), (tau, step.y_end)))
    # A minimum lies where the measure falls and then rises. From values and slopes at both ends of the step alone, a
    # cubic tells where it falls most steeply, if it does at all; a ratio has no value at the crossing itself.
    fall = steepest_fall(q[0], dq[0] * tau, q[1], dq[1] * tau)
    fall = jnp.where(_after_crossing(step) & (step.t <= step.crossed), _JUST_AFTER, fall)
    taken = (step.t < t1) & (tau > 0)  # else the step was only tried
    inside = taken & (step.end < stop)
    has_event = inside & ((step.sign_end == 0) != sticking)
    crosses = inside & ~sticking & (step.sign_end == -step.sign)
    # Far from the edge of the stick band a crossing stays one whatever the parameter's change.
    held, _ = model.guard(
        model.forcing(step.end, segment_laws.segments(step.segment_states)), 0 * tau, step.y_end, 0 * tau
    )
    crosses = crosses & (jnp.abs(held) < _FAR)
    dips = taken & ~has_event & ~crosses & (fall < 1) & (dq[1] > 0)
    # Would the mode have switched soon, had the segment gone on? Along the tangent of the guard, within a few steps.
    falls = taken & (step.end >= stop) & (s[1] > 0) & (s[1] < -_SOON * step_length * d[1])
    return _Outcome(tau, stop, has_event, crosses, dips, fall, falls, dq[1])


def _stop(t1: FloatArray, step: EngineStep) -> FloatArray:
    return jnp.min(jnp.stack([t1, *(segment_state.segment.end for segment_state in step.segment_states)]), axis=0)


def _after_crossing(step: EngineStep) -> BoolArray:
    """Whether the step belongs to a slip that began as the mass crossed the base velocity."""
    return (step.crossed >= 0) & (step.sign != 0)


def _lag(step: EngineStep) -> FloatArray:
    """Time from that crossing to the start of the step, s; 0 without one."""
    return jnp.where(_after_crossing(step), step.t - step.crossed, 0)


def _measure(s: FloatArray, d: FloatArray, age: FloatArray, is_ratio: BoolArray) -> tuple[FloatArray, FloatArray]:
    """The measure whose minimum is the grazing distance, and its slope: the guard `s` (slope `d`), or ``s / age``.

    In a slip that began as the mass crossed the base velocity, a small change of parameters can turn the guard's first
    minimum into an inflection. The ratio ``s / age``, of slope ``(d age - s) / age^2``, keeps its minimum; both minima
    pass zero together.
    """
    age = jnp.where(is_ratio & (age > 0), age, 1)
    return jnp.where(is_ratio, s / age, s), jnp.where(is_ratio, (d * age - s) / (age * age), d)


def _flow(model: OneContactModel, inputs: PyTree, y: State, length: FloatArray, sign: FloatArray) -> State:
    # The branch that is not chosen must stay finite too: see `advance`.
    slid = model.slip(inputs, y, jnp.where(sign == 0, 0, length), sign)
    return _either(sign == 0, model.stick(inputs, y, length), slid)


def _search(
    model: OneContactModel,
    segments: Segments,
    start: _Start,
    step: EngineStep,
    outcome: _Outcome,
    step_length: FloatArray,
) -> _Root:
    """The instants (2,) at which the distances are evaluated, one on each flow: roots of a residual.

    On the flow of the step: the minimum of the measure (`_measure`), in the step or beyond the event that ended it; for
    a step cut short by the end of a segment, where the guard would have reached zero. On the flow of a mass which
    crosses the base velocity: the minimum for the slip that begins there.
    """

    def search(t0, y0, sign, is_across):
        lag, is_ratio = jnp.where(is_across, 0, _lag(step)), is_across | _after_crossing(step)

        def residual(tau, s, d):
            """Negative before the root, positive after it: minus the guard, or the slope of the measure."""
            return jnp.where(outcome.falls & ~is_across, -s, _measure(s, d, lag + tau, is_ratio)[1])

        # A minimum inside the step lies after the steepest fall; one beyond the step's event, after its end. Right at
        # the crossing the ratio is not defined.
        first = jnp.where(is_across, _JUST_AFTER * step_length, jnp.where(outcome.dips, outcome.fall, 1) * outcome.tau)
        longest = jnp.where(
            sign == 0, step_length, model.step_limit(jnp.full_like(step_length, jnp.inf), step_length, y0, sign)
        )

        @sharing
        def go_on(carry, share):
            before, after, y = carry
            # One side known: go further. Both known: where the line through their values is zero (regula falsi).
            to = before.tau + jnp.where(after.found, _between(before, after), jnp.nan_to_num(share) * longest)
            to = jnp.where(jnp.isnan(share), first, to)
            # The flow goes on from the last instant before the root, not from its beginning.
            inputs = model.forcing(t0 + before.tau, segments)
            ahead = _flow(model, inputs, y, to - before.tau, sign)
            value = residual(to, *model.guard(inputs, to - before.tau, ahead, sign))
            # A residual that is positive at the first instant has no root after it: `before` is then never found.
            new, is_before = _RootBracket(to, value, jnp.ones_like(to), jnp.isnan(share) | before.found), value < 0
            before, after = _replaced(before, new, is_before), _replaced(after, new, ~is_before)
            return (before, after, _either(is_before, ahead, y)), None

        none, no, yes = jnp.zeros_like(step_length), jnp.zeros((), bool), jnp.ones((), bool)
        # Of a minimum inside the step, the step's end is a known instant after it.
        inside = outcome.dips & ~is_across
        ends = (
            _RootBracket(none, -(none + 1), none + 1, no),
            _RootBracket(outcome.tau, outcome.rise, none + 1, inside & yes),
        )
        # NaN stands for the first instant; zeros, once the root is bracketed, for refinements alone.
        shares = jnp.asarray([np.nan, *_INCREMENTS, *[0.0] * _REFINEMENTS], step_length.dtype)
        (before, after, _), _ = lax.scan(go_on, (*ends, y0), shares)
        length = after.tau - before.tau
        rate = (after.value - before.value) / jnp.where(length > 0, length, 1)
        found = before.found & after.found & (length > 0)
        return _Root(jnp.where(found, before.tau + _between(before, after), before.tau), found, rate)

    t0, y0, sign = start
    return jax.vmap(search)(t0, y0, sign, jnp.array([False, True]))


class _RootBracket(NamedTuple):
    """One end of the bracket of a root: its instant, the residual there, and its weight in the Illinois rule."""

    tau: FloatArray
    value: FloatArray
    weight: FloatArray
    found: BoolArray


def _between(before: _RootBracket, after: _RootBracket) -> FloatArray:
    """Time from `before` to the zero of the line through both weighted values: ``a / (a - b)`` of their distance."""
    a, b = before.value * before.weight, after.value * after.weight
    return jnp.clip(a / jnp.where(a == b, 1, a - b), 0, 1) * (after.tau - before.tau)


def _replaced(end: _RootBracket, new: _RootBracket, by_new: BoolArray) -> _RootBracket:
    """An end, replaced by `new` where `by_new`; an end that stays has its weight halved (Illinois rule)."""
    return _either(by_new, new, end._replace(weight=end.weight / 2))


def _at(model: OneContactModel, segments: Segments, start: _Start, tau: FloatArray) -> _AtRoot:
    """Time, state and guard at the instants `tau` (2,) on both flows, with their derivatives."""
    # A solver must not be given steps longer than its limit.
    parts = 1 if model.steps_may_be_long else len(_INCREMENTS)

    def at(t0, y0, sign, tau):
        length = tau / parts

        @sharing
        def go_on(carry, _):
            t, y = carry
            return (t + length, _flow(model, model.forcing(t, segments), y, length, sign)), None

        (t, y), _ = lax.scan(go_on, (t0, y0), None, length=parts)
        return _AtRoot(t, y, *model.guard(model.forcing(t, segments), jnp.zeros_like(t), y, sign))

    t0, y0, sign = start
    return jax.vmap(at)(t0, y0, sign, lax.stop_gradient(tau))


def _grazing(
    model: OneContactModel, segments: Segments, step: EngineStep, outcome: _Outcome, here: _Root, then: _AtRoot
) -> tuple[SignedDistance, FloatArray]:
    """The grazing distance, minus the minimum of the measure, and when that is reached (s)."""
    fixed, is_ratio = lax.stop_gradient(step), _after_crossing(step)
    # One more Newton step, along a parabola; to first order the minimum does not depend on its instant.
    bend = jnp.where(here.rate > 0, here.rate, 1)
    shift = jnp.where(is_ratio, 0, -lax.stop_gradient(then.slope) / bend)
    lowest = then.value + then.slope * shift + 0.5 * bend * shift * shift
    when = lax.stop_gradient(then.t) + shift
    scale = model.guard_scale(model.forcing(fixed.t, lax.stop_gradient(segments)), fixed.y, fixed.sign)
    # A minimum that is 0 but for round-off stays so, as after a release; one of half the scale is out of reach.
    size = jnp.abs(lowest)
    is_close = (size > _ROUND_OFF[size.dtype.itemsize] * scale) & (size < _FAR * scale)
    is_minimum = (outcome.dips | outcome.has_event) & here.found & (here.rate > 0)
    age = jnp.where(is_ratio & here.found, then.t - step.crossed, 1)
    # Beyond the stop the motion is another one.
    return SignedDistance(-lowest / age, is_minimum & is_close & (when < outcome.stop)), when


def _switch_without_stop(
    model: OneContactModel, segments: Segments, fixed: EngineStep, outcome: _Outcome, here: _Root, then: _AtRoot
) -> tuple[FloatArray, BoolArray]:
    """When the mode would have switched, had the segment not ended (s), and whether it would."""
    falls = outcome.falls & here.found & (then.slope < 0)
    slope = lax.stop_gradient(jnp.where(falls, then.slope, -1))
    # The Newton step carries the derivative.
    when = then.t - then.value / slope
    there = model.forcing(lax.stop_gradient(when), lax.stop_gradient(segments))
    # A slip's end is a stick only if friction can hold the mass there; a stick's end is a slip in any case.
    sticks = model.can_stick(there, model.on_base(there, lax.stop_gradient(then.y)))
    return when, falls & ((fixed.sign == 0) | sticks)


def _is_undone(model: OneContactModel, segment_laws: SegmentLaws, fixed: EngineStep, outcome: _Outcome) -> BoolArray:
    """Whether the excitation's next segment undoes a switch of mode just before it."""
    if not segment_laws.all:
        return jnp.zeros_like(outcome.falls)
    following, jumped = following_segments(segment_laws, fixed.segment_states, outcome.stop, jnp.ones((), bool))
    now = jnp.where(outcome.has_event, fixed.end, outcome.stop)
    inputs = model.forcing(now, segment_laws.segments(following))
    y = model.on_base(inputs, fixed.y_end)
    _, rate = model.guard(inputs, jnp.zeros_like(now), y, jnp.zeros_like(now))
    # A release is undone where the force needed falls back; an arrival, where the base velocity jumps or friction can
    # hold the mass no more.
    return jnp.where(fixed.sign == 0, ~jumped & (rate > 0), jumped | ~model.can_stick(inputs, y))


def _crossing(
    model: OneContactModel, segments: Segments, step: EngineStep, outcome: _Outcome, across: _Root, then: _AtRoot
) -> SignedDistance:
    """How far friction is from being unable to hold an arrival, near the edge of the band beyond which it would cross.

    Where the friction needed grows, the distance is the guard of the stick. Where it falls, a mass that is not held
    crosses, and may soon come back to stick: the distance of an arrival that is held is the grazing distance of the
    slip that it would begin. Arrivals that are not held have that distance in their own slips.
    """
    fixed = lax.stop_gradient(step)
    inputs, nothing = model.forcing(step.end, segments), jnp.zeros_like(step.end)
    guard, rate = model.guard(inputs, nothing, step.y_end, nothing)
    # At this edge a released mass goes on in the other direction: it crosses the base velocity.
    other = model.release_sign(lax.stop_gradient(inputs), fixed.y_end) == -fixed.sign
    is_close = (outcome.has_event | outcome.crosses) & (fixed.sign != 0) & other & (jnp.abs(guard) < _FAR)
    returns = rate > 0
    down = -then.value / jnp.where(across.found, across.tau, 1)
    value = jnp.where(returns, down, guard)
    return SignedDistance(value, is_close & (~returns | (outcome.has_event & across.found)))


def _stacked(*trees: _Tree) -> _Tree:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _either(first: BoolArray, one: _Tree, other: _Tree) -> _Tree:
    return jax.tree.map(lambda a, b: jnp.where(first, a, b), one, other)
