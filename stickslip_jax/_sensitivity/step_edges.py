"""Margins of existence (`edges.py`) for any system, one step of the switched engine at a time.

While a mode lasts its guard is positive (`_dynamics/switched/engine.py`). Where the guard falls and rises again, its
minimum is the distance of the arc from an event; where it falls through zero, the flow continued beyond the event has
that minimum too, with the other sign. So the minimum is smooth through 0 and known on both sides.

Its place is located without derivatives (`_places`); the derivatives come from one evaluation there (`_at`).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._dynamics.switched.engine import Lane, SegmentLaws, following_segments
from .._excitation.segments import SegmentState
from .._numerics.primal import without_derivatives
from .._numerics.roots import steepest_fall
from .._numerics.sharing import sharing
from .._systems.switched_model import Segments, State, SwitchedModel
from .._types import BoolArray, FloatArray
from .edges import Edges, Number

_NOISE = {8: 1e-9, 4: 1e-3}  # of the guard's scale: a minimum closer to 0 is exactly 0 but for round-off
_FAR = 0.5  # of the guard's scale: beyond the width of any kernel
# Search along a flow: increments in time steps, then a number of refinements between the last two places.
_STEPS, _TRIES = np.linspace(0.5, 1.5, 12), 5
_JUST_AFTER, _SOON = 0.05, 4.0  # time steps; beyond the width of any kernel


class Moment(NamedTuple):
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
    def of(cls, before: Lane, after: Lane, crossed: FloatArray) -> "Moment":
        """The step that led from `before` to `after`."""
        return cls(before.t, before.y, before.sign, before.segment_states, after.t, after.y, after.sign, crossed)


class _StepSeen(NamedTuple):
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
    def may_be_near(self) -> BoolArray:
        """Whether the step may have margins near zero; no other step has any."""
        return self.has_event | self.crosses | self.dips | self.falls


class _Place(NamedTuple):
    """A place on a flow: time `tau` from its start (s); whether the search succeeded; slope of the goal there."""

    tau: FloatArray
    found: BoolArray
    rate: FloatArray


class _Look(NamedTuple):
    """Time and state at a place, and the guard with its slope there."""

    t: FloatArray
    y: State
    value: FloatArray
    slope: FloatArray


def crossed_at(segment_laws: SegmentLaws, t1: FloatArray, moment: Moment) -> FloatArray:
    """`Moment.crossed` for the step after `moment`."""
    ends = [
        (law.jumps, segment_state.segment.end)
        for law, segment_state in zip(segment_laws.all, moment.segment_states, strict=True)
    ]
    crosses = (moment.sign != 0) & (moment.sign_end == -moment.sign) & (moment.end < _stop(t1, moment))
    jumped = jnp.any(jnp.stack([jnp.zeros((), bool), *(moment.end >= end for jumps, end in ends if jumps)]))
    goes_on = (moment.sign_end == moment.sign) & ~jumped
    return jnp.where(crosses, moment.end, jnp.where(goes_on, moment.crossed, -1))


@sharing
def may_be_near(
    model: SwitchedModel, segment_laws: SegmentLaws, t1: FloatArray, step: FloatArray, moment: Moment
) -> BoolArray:
    """Whether the step may have margins near zero."""
    return _step_seen(*without_derivatives((model, segment_laws, t1, step, moment))).may_be_near


@sharing
def edges_of_moment(
    model: SwitchedModel, segment_laws: SegmentLaws, t1: FloatArray, step: FloatArray, moment: Moment
) -> Edges:
    """The margins of a step for which `may_be_near` is true."""
    still, calm, fixed = without_derivatives((model, segment_laws, moment))
    one_step, sticking = (
        _step_seen(still, calm, lax.stop_gradient(t1), lax.stop_gradient(step), fixed),
        moment.sign == 0,
    )
    segments = segment_laws.segments(moment.segment_states)
    # Two flows: that of the step, and that of a mass which crosses the base velocity at the step's end.
    start = _stacked((moment.t, moment.y, moment.sign), (moment.end, moment.y_end, -moment.sign))
    places = _places(
        still, calm.segments(fixed.segment_states), without_derivatives(start), fixed, one_step, lax.stop_gradient(step)
    )
    looks = _at(model, segments, start, places.tau)

    def of(flow: int) -> Any:
        return jax.tree.map(lambda leaf: leaf[flow], (places, looks))

    (here, then), (across, then_across) = of(0), of(1)
    grazing, nearest = _grazing(model, segments, moment, one_step, here, then)
    would, is_late = _late(model, segments, fixed, one_step, here, then)
    happens, is_undone = jnp.where(one_step.has_event, moment.end, would), _is_undone(still, calm, fixed, one_step)
    at_horizon = one_step.stop >= t1
    # No stick begins after t1; a slip after t1 splits none.
    horizon = Number(t1 - happens, (one_step.has_event | (is_late & at_horizon)) & ~sticking)
    # Ends of segments depend on the parameters; `one_step` has no derivatives.
    race = Number(_stop(t1, moment) - happens, (one_step.has_event | is_late) & is_undone & ~at_horizon)
    time = jnp.where(one_step.has_event | one_step.crosses, fixed.end, jnp.where(is_late, one_step.stop, nearest))
    return Edges(
        time=lax.stop_gradient(time),
        exists=one_step.has_event,
        is_slip=sticking,
        grazing=grazing,
        race=race,
        horizon=horizon,
        crossing=_crossing(model, segments, moment, one_step, across, then_across),
    )


def _step_seen(
    model: SwitchedModel, segment_laws: SegmentLaws, t1: FloatArray, step: FloatArray, moment: Moment
) -> _StepSeen:
    sticking = moment.sign == 0
    tau = moment.end - moment.t
    stop = _stop(t1, moment)
    inputs = model.forcing(moment.t, segment_laws.segments(moment.segment_states))

    def measured(tau, y):
        s, d = model.guard(inputs, tau, y, moment.sign)
        return s, d, *_measure(s, d, tau + _lag(moment), _after_crossing(moment))

    s, d, q, dq = jax.vmap(measured)(*_stacked((jnp.zeros_like(tau), moment.y), (tau, moment.y_end)))
    fall = steepest_fall(q[0], dq[0] * tau, q[1], dq[1] * tau)
    fall = jnp.where(_after_crossing(moment) & (moment.t <= moment.crossed), _JUST_AFTER, fall)
    taken = (moment.t < t1) & (tau > 0)
    inside = taken & (moment.end < stop)
    has_event = inside & ((moment.sign_end == 0) != sticking)
    crosses = inside & ~sticking & (moment.sign_end == -moment.sign)
    held, _ = model.guard(
        model.forcing(moment.end, segment_laws.segments(moment.segment_states)), 0 * tau, moment.y_end, 0 * tau
    )
    crosses = crosses & (jnp.abs(held) < _FAR)
    dips = taken & ~has_event & ~crosses & (fall < 1) & (dq[1] > 0)
    falls = taken & (moment.end >= stop) & (s[1] > 0) & (s[1] < -_SOON * step * d[1])
    return _StepSeen(tau, stop, has_event, crosses, dips, fall, falls, dq[1])


def _stop(t1: FloatArray, moment: Moment) -> FloatArray:
    return jnp.min(jnp.stack([t1, *(segment_state.segment.end for segment_state in moment.segment_states)]), axis=0)


def _after_crossing(moment: Moment) -> BoolArray:
    """Whether the step belongs to a slip that began as the mass crossed the base velocity."""
    return (moment.crossed >= 0) & (moment.sign != 0)


def _lag(moment: Moment) -> FloatArray:
    """Time from that crossing to the start of the step, s; 0 without one."""
    return jnp.where(_after_crossing(moment), moment.t - moment.crossed, 0)


def _measure(s: FloatArray, d: FloatArray, age: FloatArray, is_ratio: BoolArray) -> tuple[FloatArray, FloatArray]:
    """The measure whose minimum is the grazing margin, and its slope: the guard `s` (slope `d`), or ``s / age``.

    In a slip that began as the mass crossed the base velocity, a small change of parameters can turn the guard's first
    minimum into an inflection. The ratio ``s / age``, of slope ``(d age - s) / age^2``, keeps its
    minimum; both minima pass zero together.
    """
    age = jnp.where(is_ratio & (age > 0), age, 1)
    return jnp.where(is_ratio, s / age, s), jnp.where(is_ratio, (d * age - s) / (age * age), d)


def _flow(model: SwitchedModel, inputs: Any, y: State, length: FloatArray, sign: FloatArray) -> State:
    # The branch that is not chosen must stay finite too: see `advance`.
    slid = model.slip(inputs, y, jnp.where(sign == 0, 0, length), sign)
    return tuple(jnp.where(sign == 0, a, b) for a, b in zip(model.stick(inputs, y, length), slid, strict=True))


def _places(
    model: SwitchedModel, segments: Segments, start: Any, moment: Moment, one_step: _StepSeen, step: FloatArray
) -> _Place:
    """The places (2,) at which the margins are evaluated, one on each flow.

    On the flow of the step: the minimum of the measure (`_measure`), in the step or beyond the event that ended it; for
    a step cut short by the end of a segment, where the guard would have reached zero. On the flow of a mass which
    crosses the base velocity: the minimum for the slip that begins there.
    """

    def look(t0, y0, sign, is_across):
        lag, is_ratio = jnp.where(is_across, 0, _lag(moment)), is_across | _after_crossing(moment)

        def goal(tau, s, d):
            """Negative before the place, positive after it."""
            return jnp.where(one_step.falls & ~is_across, -s, _measure(s, d, lag + tau, is_ratio)[1])

        first = jnp.where(is_across, _JUST_AFTER * step, jnp.where(one_step.dips, one_step.fall, 1) * one_step.tau)
        longest = jnp.where(sign == 0, step, model.step_limit(jnp.full_like(step, jnp.inf), step, y0, sign))

        @sharing
        def go_on(carry, share):
            before, after, y = carry
            # One side known: go further. Both known: where the line through their values is zero (regula falsi).
            to = before.tau + jnp.where(after.found, _between(before, after), jnp.nan_to_num(share) * longest)
            to = jnp.where(jnp.isnan(share), first, to)
            inputs = model.forcing(t0 + before.tau, segments)
            ahead = _flow(model, inputs, y, to - before.tau, sign)
            value = goal(to, *model.guard(inputs, to - before.tau, ahead, sign))
            # A goal that is positive at the first place has no zero after it.
            new, is_before = _Side(to, value, jnp.ones_like(to), jnp.isnan(share) | before.found), value < 0
            before, after = _replaced(before, new, is_before), _replaced(after, new, ~is_before)
            return (before, after, _either(is_before, ahead, y)), None

        none, no, yes = jnp.zeros_like(step), jnp.zeros((), bool), jnp.ones((), bool)
        inside = one_step.dips & ~is_across
        ends = _Side(none, -(none + 1), none + 1, no), _Side(one_step.tau, one_step.rise, none + 1, inside & yes)
        shares = jnp.asarray([np.nan, *_STEPS, *[0.0] * _TRIES], step.dtype)
        (before, after, _), _ = lax.scan(go_on, (*ends, y0), shares)
        length = after.tau - before.tau
        rate = (after.value - before.value) / jnp.where(length > 0, length, 1)
        found = before.found & after.found & (length > 0)
        return _Place(jnp.where(found, before.tau + _between(before, after), before.tau), found, rate)

    t0, y0, sign = start
    return jax.vmap(look)(t0, y0, sign, jnp.array([False, True]))


class _Side(NamedTuple):
    """A place on one side of the zero searched for, the value there, and its weight in the Illinois rule."""

    tau: FloatArray
    value: FloatArray
    weight: FloatArray
    found: BoolArray


def _between(before: _Side, after: _Side) -> FloatArray:
    """Time from `before` to the zero of the line through both weighted values: ``a / (a - b)`` of their distance."""
    a, b = before.value * before.weight, after.value * after.weight
    return jnp.clip(a / jnp.where(a == b, 1, a - b), 0, 1) * (after.tau - before.tau)


def _replaced(side: _Side, new: _Side, by_new: BoolArray) -> _Side:
    """A side, replaced by `new` where `by_new`; a side that stays has its weight halved (Illinois rule)."""
    stays = side._replace(weight=side.weight / 2)
    return _Side(*(jnp.where(by_new, a, b) for a, b in zip(new, stays, strict=True)))


def _at(model: SwitchedModel, segments: Segments, start: Any, tau: FloatArray) -> _Look:
    """Time, state and guard at the places `tau` (2,) on both flows, with their derivatives."""
    # A solver must not be given steps longer than its limit.
    steps = 1 if model.steps_may_be_long else len(_STEPS)

    def look(t0, y0, sign, tau):
        length = tau / steps

        @sharing
        def go_on(carry, _):
            t, y = carry
            return (t + length, _flow(model, model.forcing(t, segments), y, length, sign)), None

        (t, y), _ = lax.scan(go_on, (t0, y0), None, length=steps)
        return _Look(t, y, *model.guard(model.forcing(t, segments), jnp.zeros_like(t), y, sign))

    t0, y0, sign = start
    return jax.vmap(look)(t0, y0, sign, lax.stop_gradient(tau))


def _grazing(
    model: SwitchedModel, segments: Segments, moment: Moment, one_step: _StepSeen, here: _Place, then: _Look
) -> tuple[Number, FloatArray]:
    """The grazing margin, minus the minimum of the measure, and when that is reached (s)."""
    fixed, is_ratio = lax.stop_gradient(moment), _after_crossing(moment)
    # One more Newton step, along a parabola; to first order the minimum does not depend on its place.
    bend = jnp.where(here.rate > 0, here.rate, 1)
    shift = jnp.where(is_ratio, 0, -lax.stop_gradient(then.slope) / bend)
    lowest = then.value + then.slope * shift + 0.5 * bend * shift * shift
    when = lax.stop_gradient(then.t) + shift
    scale = model.guard_scale(model.forcing(fixed.t, lax.stop_gradient(segments)), fixed.y, fixed.sign)
    size = jnp.abs(lowest)
    near = (size > _NOISE[size.dtype.itemsize] * scale) & (size < _FAR * scale)
    steps = (one_step.dips | one_step.has_event) & here.found & (here.rate > 0)
    age = jnp.where(is_ratio & here.found, then.t - moment.crossed, 1)
    return Number(-lowest / age, steps & near & (when < one_step.stop)), when


def _late(
    model: SwitchedModel, segments: Segments, fixed: Moment, one_step: _StepSeen, here: _Place, then: _Look
) -> tuple[FloatArray, BoolArray]:
    """When the mode would have switched, had the segment not ended (s), and whether it would."""
    falls = one_step.falls & here.found & (then.slope < 0)
    slope = lax.stop_gradient(jnp.where(falls, then.slope, -1))
    # The Newton step carries the derivative.
    would = then.t - then.value / slope
    there = model.forcing(lax.stop_gradient(would), lax.stop_gradient(segments))
    sticks = model.can_stick(there, model.on_base(there, lax.stop_gradient(then.y)))
    return would, falls & ((fixed.sign == 0) | sticks)


def _is_undone(model: SwitchedModel, segment_laws: SegmentLaws, fixed: Moment, one_step: _StepSeen) -> BoolArray:
    """Whether the excitation's next segment undoes a switch of mode just before it."""
    if not segment_laws.all:
        return jnp.zeros_like(one_step.falls)
    following, jumped = following_segments(segment_laws, fixed.segment_states, one_step.stop, jnp.ones((), bool))
    now = jnp.where(one_step.has_event, fixed.end, one_step.stop)
    inputs = model.forcing(now, segment_laws.segments(following))
    y = model.on_base(inputs, fixed.y_end)
    _, rate = model.guard(inputs, jnp.zeros_like(now), y, jnp.zeros_like(now))
    return jnp.where(fixed.sign == 0, ~jumped & (rate > 0), jumped | ~model.can_stick(inputs, y))


def _crossing(
    model: SwitchedModel, segments: Segments, moment: Moment, one_step: _StepSeen, across: _Place, then: _Look
) -> Number:
    """How far friction is from being unable to hold an arrival near the far edge of the stick band.

    Where the friction needed grows, the margin is the guard of the stick. Where it falls, a mass that is not held
    crosses, and may soon come back to stick: the margin of an arrival that is held is the grazing margin of the slip
    that it would begin. Arrivals that are not held have that margin in their own slips.
    """
    fixed = lax.stop_gradient(moment)
    inputs, nothing = model.forcing(moment.end, segments), jnp.zeros_like(moment.end)
    guard, rate = model.guard(inputs, nothing, moment.y_end, nothing)
    other = model.release_sign(lax.stop_gradient(inputs), fixed.y_end) == -fixed.sign
    near = (one_step.has_event | one_step.crosses) & (fixed.sign != 0) & other & (jnp.abs(guard) < _FAR)
    returns = rate > 0
    down = -then.value / jnp.where(across.found, across.tau, 1)
    return Number(jnp.where(returns, down, guard), near & (~returns | (one_step.has_event & across.found)))


def _stacked(*trees: Any) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _either(first: BoolArray, one: State, other: State) -> State:
    return tuple(jnp.where(first, a, b) for a, b in zip(one, other, strict=True))
