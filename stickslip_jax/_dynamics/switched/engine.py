"""The switched engine: time steps in which every event is located to machine precision, in lanes or for one
trajectory.
"""

import math
from contextlib import suppress
from functools import partial, reduce
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.errors import ConcretizationTypeError
from jaxtyping import Array

from ..._compiler.native import sharing
from ..._compiler.programs import is_compiling, kept_jit
from ..._excitation.excitation import Excitation
from ..._excitation.motion import Signal
from ..._excitation.segments import SegmentState, segment_at
from ..._foundation.types import BoolArray, BoolScalar, FloatArray, FloatScalar, IntArray, Number, Scalar
from ..._numerics.derivatives import NotKnown, OwnDerivative, largest, smallest, without_derivatives
from ..._numerics.matrices import MANY, any_of, largest_of, stacked, sum_of
from ..._numerics.steps import look_ahead
from ..._systems.switched_model import (
    NOISE_ULPS,
    Along,
    Form,
    Question,
    Segments,
    State,
    SwitchedModel,
    chosen_state,
    of_form,
)
from ..._systems.system import System
from ..common.lanes import Asked, SampleTotals, Sums, Work
from ..common.method import Arguments, Exact, max_steps_advice, time_scales_of
from ..common.path import (
    MotionPath,
    Run,
    SegmentLaws,
    StepsEngine,
    StepsShared,
    following_segments,
    is_short,
    is_spent,
    largest_in_steps,
    padded_length,
    sample_totals,
    to_digits,
)
from ..sticks import (
    ALL,
    Remembered,
    StickRecord,
    StickSpan,
    Totals,
    begin_quantities,
    ending_of,
    no_stick,
    recorded,
    start_totals,
)
from .inside import StepBeginnings, along_step, seen_in_step, state_in_step

# The state of a trajectory between two steps of the switched engine, and what counts as round-off in it.


CLOCK_ULPS = 4  # the round-off of times, in units in the last place
NEAR_GRAZING = {8: 1e-9, 4: 1e-3}  # fraction of the guard's scale


class Lane(NamedTuple):
    """Loop state of one trajectory.

    Of each contact (scalars, or arrays): `sign`, that of the relative velocity, 0 in a stick, and `event`. What belongs
    to sticks is of each that can be `SwitchedModel.stuck`.
    """

    t: FloatArray
    y: State
    sign: FloatArray
    target: FloatArray  # length of the next step to try
    accurate_step: FloatArray  # the longest step that the errors of the steps so far allow
    event: FloatArray  # time of the last event at rest
    tries: IntArray
    steps: IntArray  # loop steps so far
    stick_start: FloatArray
    start_error: FloatArray  # by how much round-off may have moved it, s
    stick_position: FloatArray
    remembered: Remembered  # by the quantities of each stick that are asked for
    totals: Totals
    at_start: BoolArray
    near_grazing_count: IntArray
    segment_states: tuple[SegmentState, ...]


# Derivatives of a time step, of every order.
#
# A step ends at an event, at the end of a segment, or after a length that was chosen for it. Where it ends is found by
# trial; its derivative comes from what defines it. The event time `tau` solves ``guard(tau, flow(tau)) = 0``, so that
#
#     d tau = -(d guard at fixed tau) / (rate of the guard)
#     d y   =  (d flow at fixed tau) + (rates at tau) d tau
#
# (the implicit function theorem). Both hold for all parameters, with `tau` and `y` functions of them: differentiated
# again, by the same rule for `tau` and `y`, they give the second derivatives, and so on.
#
# All are evaluated a little before the event (`before`), where round-off cannot have ended the mode, if friction may
# have a kink there: where the relative velocity is exactly zero, a force written with its absolute value may have the
# slope of the other side. In the last step, however short it is, that is an error in second derivatives of `tau`.
#
# A contact without friction that is at rest and stays so has no direction of slip. The smallest friction would hold it,
# so that friction has no effect on it, in derivatives as well: they are taken with a sign that is nearly zero.


class HowItEnds(NamedTuple):
    """Whether a step moves at all; if so, of which contact's mode the end ends it (`at_event`; of one at most), or
    whether the end of a segment or the horizon does. `idle`: which contacts slip without friction, with no motion.
    """

    moves: BoolArray
    at_event: BoolArray
    at_stop: BoolArray
    idle: BoolArray


@OwnDerivative
def carried(
    model: SwitchedModel,
    forcing: object,
    y: State,
    left: FloatArray,
    sign: FloatArray,
    ends: HowItEnds,
    before: tuple[FloatArray, State] | None,
    tau: FloatArray,
    reached: State,
) -> tuple[FloatArray, ...]:
    """The length `tau` (s) of a step from `y` and the state `reached` in it, with their derivatives of every order.

    `left`: time from the beginning of the step to the end of the segment or the horizon, s. `before`: the time (s)
    before an event by which round-off cannot have ended the mode, and the change of state in it; None for friction
    without kinks. `tau` and `reached` are taken as they are; their derivatives are those of what they were found to be.
    """
    return tau, *reached


@carried.def_jvp
def _carried_jvp(primals, tangents):
    model, forcing, y, left, sign, ends, before, tau, reached = primals
    tau, *reached = carried(model, forcing, y, left, sign, ends, before, *lax.stop_gradient((tau, reached)))
    by = (tangents[0], tangents[1], tangents[2])
    inside, there = tau, tuple(reached)
    if before is not None:
        time, change = before
        inside, there = tau - time, tuple(value - less for value, less in zip(reached, change, strict=True))

    slips = jnp.where(ends.idle, sign * jnp.finfo(sign.dtype).tiny, sign)

    def flow(model, forcing, y):
        moved = chosen_state(ends.moves, model.flow(forcing, y, inside, slips), y)
        return moved, model.guard(forcing, inside, moved, sign)[0]

    _, (d_reached, d_guard) = eqx.filter_jvp(flow, (model, forcing, y), by)
    _, rate = model.guard(forcing, inside, there, sign)
    d_left = jnp.zeros_like(tau) if tangents[3] is None else tangents[3]
    d_event = -_or_zero(d_guard, rate) / jnp.where(ends.at_event, rate, -1)
    at_stop = jnp.where(ends.at_stop, d_left, 0)
    if rate.ndim:
        d_tau = jnp.where(any_of(ends.at_event), sum_of(jnp.where(ends.at_event, d_event, 0)), at_stop)
    else:
        d_tau = jnp.where(ends.at_event, d_event, at_stop)
    rates = model.rates(forcing, inside, there, sign)
    d_reached = tuple(_or_zero(d, v) + r * d_tau for d, v, r in zip(d_reached, reached, rates, strict=True))
    return (tau, *reached), (d_tau, *d_reached)


def _or_zero(tangent: Any, like: Any) -> Any:
    return jnp.zeros_like(like) if tangent is None else tangent


# Which mode a trajectory is in after an event or at the end of a segment: stick, or slip of either direction.


def switched(
    model: SwitchedModel,
    segment_laws: SegmentLaws,
    lane: Lane,
    t1: FloatArray,
    ends: BoolArray,
    brief: BoolArray,
    at_stop: BoolArray,
    start_error: FloatScalar,
) -> tuple[Lane, StickRecord, FloatArray, BoolArray]:
    """The lane after an event or at the end of a segment, in its mode, and the record of the stick that ended, if any.

    The step ended on an event of the modes of contacts (`ends`), or where a segment ends or at the horizon (`at_stop`).
    `brief`: a slip would end where it began, but for round-off. `start_error`: by how much round-off may have moved the
    start of a stick that begins here, s.

    Also returned: of each contact the margin, the size of the stick guard (0 where friction just holds) where it was
    decided whether the mass sticks, infinity elsewhere; and whether a jump of the base or the horizon ended the mode.
    """
    ended = at_stop & (lane.t < t1)
    segment_states, jumped = following_segments(segment_laws, lane.segment_states, lane.t, ended)
    forcing = model.forcing(lane.t, segment_laws.segments(segment_states))
    was_held = lane.sign == 0
    resting = model.at_rest(forcing, lane.y)
    sign, landed, changed = model.after(forcing, lane.y, lane.sign, ends, ended)
    # The end of a segment. A slip goes on unless the base jumps; everything else is decided as at a start.
    resolve = (ended & (was_held | jumped)) | changed
    # A stick that goes on over the end of a segment is released by a force beyond the limit, not by round-off at it.
    goes_on = was_held & ~jumped
    asked, stays = landed | (resolve & (resting | goes_on)), jnp.zeros_like(was_held)
    slips = model.slip_sign(forcing, lane.y)
    if model.coupled:
        # What slips from here on acts on the others at once.
        sign = jnp.where(resolve & ~(resting | goes_on), slips, sign)
        # Where one mode changes, the friction that other sticks need changes too.
        stays = was_held & any_of(landed | changed) & ~landed
        asked, goes_on = asked | stays, goes_on | stays
    released = landed & was_held
    holds, release_sign, guard, guard_rate = model.decided(
        forcing, lane.y, Question(sign, asked, released, goes_on & ~released)
    )
    # At the limit, friction that need not grow holds: else the mass would slip to and fro with no motion.
    not_below = is_not_below(guard, guard_rate, lane.t)
    # (A cart passes zero velocity at full speed of its motor too, where the guard and its rate have poles.)
    holds = holds | (resting & not_below & is_not_below(-guard, guard_rate, lane.t) & (guard_rate >= 0))
    # An event. A mass that is not at rest at it slips on, and friction reverses; so it does if a slip ends as it
    # begins. A slip that ends at rest is a stick where friction holds the mass, and else a slip by the force on it.
    turned = jnp.where(was_held | (resting & ~brief), release_sign, -sign)
    sign = jnp.where(landed, jnp.where(~was_held & holds, 0, turned), sign)
    held_or_released = jnp.where(holds | (not_below & goes_on), 0, release_sign)
    resolved = jnp.where(resting | goes_on, held_or_released, slips)
    sign = jnp.where(resolve, resolved, jnp.where(stays, held_or_released, sign))
    y = _snapped(model, forcing, lane.y, (resolve & (resting | goes_on)) | (landed & (sign == 0)), (lane.sign, sign))
    at_rest = (landed & (resting | (sign == 0))) | (stays & (sign != 0))
    decided = (landed & ~was_held) | (ended & ((jumped & resting) | goes_on)) | stays
    margin = jnp.where(decided, jnp.abs(guard), jnp.inf)
    if any(law.jumps for law in segment_laws.all):
        # Right after a jump, a velocity that is zero but for round-off may be on either side of it, or at rest.
        nearly = NEAR_GRAZING[lane.t.dtype.itemsize] / (NOISE_ULPS * float(jnp.finfo(lane.t.dtype).eps))
        near_rest = ended & jumped & ~was_held & holds & model.at_rest(forcing, lane.y, nearly)
        margin = jnp.where(near_rest, 0, margin)

    # The lane in this mode: its sticks counted, and the record of the stick that ended, if any.
    at_horizon = at_stop & ~(lane.t < t1)
    was_stick, sticks, position = model.stuck(lane.sign), model.stuck(sign), model.stick_position(y)
    over = was_stick & (~sticks | at_horizon) & (lane.t > lane.stick_start + lane.start_error)
    now = jnp.broadcast_to(lane.t, lane.stick_start.shape)
    stick = StickSpan(lane.stick_start, now, lane.stick_position, left_at=position)
    ending, duration = ending_of(over, ~at_horizon & ~(ended & jumped), at_horizon), lane.t - lane.stick_start
    record, remembered, totals = recorded(lane.remembered, lane.totals, over, stick, ending, at_horizon, duration)
    begins = ~was_stick & sticks
    # A stick that starts on the edge of the band, or on the end of a segment, ends at once: of no length, it is none.
    no_stick = was_stick & ~sticks & ~over
    undecided = any_of(no_stick & (lane.t > lane.stick_start))
    following = lane._replace(
        y=y,
        sign=sign,
        totals=totals,
        event=jnp.where(at_rest, lax.stop_gradient(lane.t), lane.event),
        at_start=lane.at_start & ~no_stick,
        near_grazing_count=lane.near_grazing_count + undecided,
        stick_start=jnp.where(begins, lane.t, lane.stick_start),
        start_error=jnp.where(begins, lax.stop_gradient(start_error), lane.start_error),
        stick_position=jnp.where(begins, position, lane.stick_position),
        remembered=remembered,
        segment_states=segment_states,
    )
    return following, record, margin, at_horizon | jumped


def _snapped(model: SwitchedModel, forcing: object, y: State, resting: BoolArray, modes: tuple[Any, Any]) -> State:
    """The state after the change of `modes` with the base's velocity to the last bit for what is `resting`.

    Only the velocity of what `sticks` is the base's in derivatives too: what slips from here on keeps its own.
    """
    y = model.entered(forcing, y, *modes)
    held = model.at_base_velocity(forcing, y, resting & (modes[1] == 0))
    model, forcing, fixed = without_derivatives((model, forcing, held))
    exact = model.at_base_velocity(forcing, fixed, resting)
    return tuple(a + lax.stop_gradient(b - a) for a, b in zip(held, exact, strict=True))


def is_tie(margin: FloatArray) -> BoolArray:
    """Whether the last digits decide if friction holds: `margin` is the size of the guard of a stick."""
    return margin < 2 * NEAR_GRAZING[margin.dtype.itemsize]


def is_not_below(guard: FloatArray, guard_rate: FloatArray, t: FloatArray) -> BoolArray:
    """Whether the guard of a stick is not below zero, but for its own round-off and that of the time."""
    return guard >= -jnp.finfo(t.dtype).eps * (2 * NOISE_ULPS + CLOCK_ULPS * t * jnp.abs(guard_rate))


# Exact switched motion of any system: time steps in which every event is located to machine precision.
#
# A system is given as a `SwitchedModel`: its motion in a slip of either direction and in a stick, and the guard, a
# function that is positive while the current mode (stick, slip forward, slip backward) lasts. Each loop step tries one
# time step:
#
# - if the guard stays positive, the time step is accepted;
# - if the guard falls through zero inside, the step is tried again with the estimated event as its end, until it ends
#   within `_LANDED` of the event; a last Newton step then lands on the event (its derivatives: see above);
# - if the guard has a minimum near zero, the step is tried again up to this minimum, to see whether it falls below;
# - a time step never crosses the end of a segment of the base motion or of the load: there the mode is found anew;
# - a time step whose error estimate is too large is tried again, shorter.
#
# Two falls in one step with two more extrema of the guard between them can be missed, because the cubic through the
# ends of a step cannot have these; so steps must be short compared to the shortest time scale (`method.py` checks
# this). Instants at which a change below `NEAR_GRAZING` would create or remove an event are counted (`_close_calls`).


_LANDED = {8: 1e-8, 4: 3e-4}  # fraction of a step; the Newton step that follows squares it
_ERROR = {8: 1e-9, 4: 1e-5}  # relative, of a step without a closed form; the estimate of its solver is far too high
_LEAST_ERROR = 1e-20
_AT_ONCE = 1e-9  # fraction of a step: an earlier fall means that the mode was over when the step began
_GRAZING = 64  # times the guard's round-off: a slip whose guard changes by less than this in a step begins at rest
_EARLY, _SHORTER = 0.02, 0.25  # fractions of a step
_MANY_TRIES = 12  # after so many tries that missed the event, the step is halved instead, down to round-off


def start_lane(
    model: SwitchedModel,
    segment_laws: SegmentLaws,
    segment_states: tuple[SegmentState, ...],
    y0: tuple[Number, ...] | FloatArray,
    step: FloatArray,
    quantities: tuple[str, ...],
    t0: FloatArray,
    resting: BoolArray | None = None,
) -> Lane:
    """The lane at the beginning of a trajectory, at `t0` (s), with its mode (stick or slip) found.

    `quantities` of each stick: those that are asked for. `resting`: contacts whose relative velocity is made zero.
    """
    dtype = step.dtype
    zero, none = jnp.zeros((), dtype), jnp.zeros((), jnp.int32)
    forcing = model.forcing(t0, segment_laws.segments(segment_states))
    y = model.start(y0, dtype)
    y = y if resting is None else model.at_base_velocity(forcing, y, resting)
    at_rest = model.at_rest(forcing, y)
    slips, never = jnp.where(at_rest, 0, model.slip_sign(forcing, y)), jnp.zeros_like(at_rest)
    holds, release_sign, guard, _ = model.decided(forcing, y, Question(slips, at_rest, never, never))
    sign = jnp.where(at_rest, jnp.where(holds, 0, release_sign), slips)
    margin = jnp.where(at_rest, jnp.abs(guard), jnp.inf)
    y = _snapped(model, forcing, y, at_rest, (sign, sign))
    sticks, position = model.stuck(sign), model.stick_position(y)
    return Lane(
        t0,
        y,
        sign,
        lax.stop_gradient(model.step_limit(zero, step, y, sign)),
        jnp.full((), jnp.inf, dtype),
        jnp.broadcast_to(t0, sign.shape),
        none,
        none,
        jnp.broadcast_to(t0, sticks.shape),
        jnp.zeros(sticks.shape, dtype),
        position,
        begin_quantities(position, quantities),
        start_totals(dtype, sticks.shape),
        sticks,
        sum_of(is_tie(margin).astype(jnp.int32)),
        segment_states,
    )


@sharing
def advance(
    model: SwitchedModel, segment_laws: SegmentLaws, t1: FloatArray, step: FloatArray, lane: Lane
) -> tuple[Lane, StickRecord, FloatArray]:
    """One loop step; returns the lane after it, the record of the stick that ended in it, if any, and the length that
    was tried, s.
    """
    before, given = lane, (model, model.forcing(lane.t, segment_laws.segments(lane.segment_states)), lane.y)
    stop = jnp.minimum(t1, reduce(jnp.minimum, (state.segment.end for state in lane.segment_states), jnp.inf))
    left = time_left = stop - lane.t
    # No derivative passes through the search for the end of the step: `carried` knows what it depends on.
    (model, forcing, _), left, step, lane = without_derivatives((given, left, step, lane))
    to_stop = lane.t + lane.target >= stop  # not target >= left: the sum may be rounded up to stop
    target = jnp.where(lane.tries == 0, to_digits(lane.t, lane.target), lane.target)  # not in a search
    trial = _tried(model, forcing, lane, jnp.where(to_stop, left, target), left, step)
    h, again, scale, itemsize = trial.h, trial.again, trial.scale, step.dtype.itemsize
    at_event, at_stop = trial.landed & ~trial.at_once, trial.taken & to_stop
    ends = trial.ends & at_event
    tie, tie_if_abrupt = _close_calls(trial, lane, step, ends, at_stop)

    # The step ends where it began, on the event (one Newton step from its end), or at its end.
    stays, delta = again | trial.at_once, jnp.where(at_event, trial.to_event, 0)
    tau = jnp.where(stays, 0, h + delta)
    rates = model.rates(forcing, h, trial.reached, lane.sign)
    y = chosen_state(
        stays, lane.y, tuple(value + delta * rate for value, rate in zip(trial.reached, rates, strict=True))
    )
    model, lane = given[0], before
    idle = (lane.sign != 0) & (trial.s0 == 0) & (trial.d0 == 0) & (trial.s1 == 0) & (trial.d1 == 0)
    # Events that coincide end a step at the same time: its derivatives are those of the first.
    first = ends if ends.ndim == 0 else ends & (jnp.arange(len(ends)) == jnp.argmax(ends))
    just_before = None
    if model.has_kinks:
        # So long before the event its guard is above its round-off; at a grazing event, which ensembles count, not
        # longer than the event is exact to. The rates of a step that is tried again may be infinite.
        falls = ends & (trial.d1 < 0)
        time = jnp.where(falls, trial.noise, 0) / jnp.where(falls, -trial.d1, 1)
        time = jnp.minimum(largest_of(time), _LANDED[itemsize] * step)
        just_before = time, tuple(jnp.where(any_of(ends), time * rate, 0) for rate in rates)
    tau, *y = carried(*given, time_left, lane.sign, HowItEnds(~stays, first, at_stop, idle), just_before, tau, y)
    # At a stop the time is that of the stop to the last bit: the sum could miss it, and the next step would be empty.
    t = jnp.where(at_stop, stop, lane.t + tau)

    # By how much round-off may have moved the instant at which slips ended, s: a stick that is shorter has no length.
    # That of the velocity over the deceleration. Where the velocity is tangent to that of the base it is the square
    # root: 32 steps are about a period, 5 the time in which a motion changes by its own size.
    few = NOISE_ULPS * float(jnp.finfo(step.dtype).eps)
    slope = jnp.abs(jnp.where(trial.at_once, trial.d0, trial.d1))
    tangent = math.sqrt(few) / (5 * step) * scale  # the slope of a tangent where round-off ends it
    error = few * scale / (slope + tangent + float(jnp.finfo(step.dtype).tiny))
    start_error = trial.clock + largest_of(jnp.where(trial.ends, error, 0))

    live = ~(lane.t >= t1) & ~is_spent(lane) & ~any_of(jnp.isnan(lane.y[0]))
    # NaN (`NOT_FINITE`) after a step whose guard is NaN: it would never fall, whatever happens.
    y[0] = jnp.where(any_of(jnp.isnan(trial.s1 + trial.noise)) & ~again, jnp.nan, y[0])
    moved = lane._replace(t=t, y=tuple(y), tries=jnp.where(again, lane.tries + 1, 0), steps=lane.steps + 1)
    # A slip that only round-off makes: it would end where it began, and neither reverses friction nor counts.
    brief = (trial.ends & trial.at_once) | (t - lane.event <= _LANDED[itemsize] * step + trial.clock)
    ended = trial.ends, brief, live & at_stop, start_error
    following, record, margin, abrupt = switched(model, segment_laws, moved, t1, *ended)
    vanished = brief & (lane.sign != 0) & (following.sign == 0)
    near_grazing = tie | (tie_if_abrupt & abrupt) | is_tie(margin) | vanished

    # The longest step that the errors so far allow (order of the solvers: 8 or less), and the next one to try.
    by_error = lane.accurate_step
    if trial.error is not None:
        allowed = _ERROR[itemsize] / jnp.maximum(trial.error, _LEAST_ERROR)
        change = jnp.clip(0.9 * jnp.sqrt(jnp.sqrt(jnp.sqrt(allowed))), 0.1, 5)
        # Only a step as long as allowed, but for digits, says that a longer one would do: others ended at events.
        longer = jnp.where(trial.taken & (h + trial.clock >= 0.999 * by_error), by_error * change, by_error)
        by_error = jnp.where(trial.inaccurate, h * jnp.minimum(change, 0.8), longer)
    longest = model.step_limit(following.t - following.event, step, following.y, following.sign)
    target = jnp.where(again & ~trial.inaccurate, trial.guess * h, jnp.minimum(longest, by_error))
    following = following._replace(
        near_grazing_count=following.near_grazing_count + sum_of(near_grazing),
        target=lax.stop_gradient(target),
        accurate_step=lax.stop_gradient(by_error),
    )
    following = jax.tree.map(lambda new, old: jnp.where(live, new, old), following, lane)
    return following, record._replace(ending=jnp.where(live, record.ending, np.int8(-1))), h


class _Trial(NamedTuple):
    """A step of length `h` (s) as it was tried: the state it `reached`, how the guard behaved in it, and what becomes
    of it: it is `taken`, or ends in an event (`landed`), or is tried `again`.

    - `ends`: of each contact, whether its mode ends there. `at_once`: the event was at the beginning of the step.
    - `to_event`: from the end of the step to the event, s; negative if it lies before.
    - `inaccurate`: again, for its error. `guess`: else the length to try, as a fraction of the step.
    """

    h: FloatArray
    reached: State
    error: FloatArray | None  # relative, by the solver's estimate
    s0: FloatArray  # the guard and its rate, before the step
    d0: FloatArray
    s1: FloatArray  # and after it
    d1: FloatArray
    lowest: FloatArray  # the minimum inside of each contact's guard; infinity: none
    scale: FloatArray  # of the guard
    clock: FloatArray  # round-off of the time, s
    noise: FloatArray  # round-off of the guard
    taken: BoolScalar
    landed: BoolScalar
    again: BoolScalar
    ends: BoolArray
    at_once: BoolScalar
    inaccurate: BoolScalar
    to_event: FloatScalar
    guess: FloatScalar


def _tried(
    model: SwitchedModel, forcing: object, lane: Lane, h: FloatArray, left: FloatArray, step: FloatArray
) -> _Trial:
    reached, error = model.flow_and_error(forcing, lane.y, h, lane.sign)
    s0, d0 = model.guard(forcing, jnp.zeros_like(h), lane.y, lane.sign)
    s1, d1 = model.guard(forcing, h, reached, lane.sign)
    scale = model.guard_scale(forcing, reached, lane.sign)
    # Round-off of the guard itself, and of the time at which it is evaluated.
    eps, itemsize = jnp.finfo(h.dtype).eps, h.dtype.itemsize
    clock = CLOCK_ULPS * eps * (lane.t + h)
    noise = NOISE_ULPS * eps * scale + clock * jnp.maximum(jnp.abs(d0), jnp.abs(d1))
    look = look_ahead(s0, d0 * h, s1, d1 * h, noise)
    # One Newton step from the end. It is exact enough if the end is as near to the event as this, in short pulses too.
    to_event = jnp.where(d1 < 0, -s1 / jnp.where(d1 < 0, d1, -1), jnp.inf)
    is_near = jnp.abs(to_event) <= _LANDED[itemsize] * jnp.minimum(step, left) + clock
    # Tries that come no nearer, while the guard is zero but for round-off: the event is where the step ends.
    stalled = (lane.tries > 3 * _MANY_TRIES) & (jnp.abs(s1) <= 16 * noise)
    # A released mass leaves its stick with no relative velocity and nearly no relative acceleration: a step that ends
    # after it has stuck again cannot show whether it slipped at all. Shorter steps show it, down to those in which the
    # guard cannot change by more than its round-off.
    slow = jnp.abs(d0) * h <= _GRAZING * noise
    shows = jnp.maximum(jnp.abs(d0), jnp.abs(d1)) * h > noise
    hidden = look.falls & (lane.sign != 0) & (s0 <= noise) & slow & shows & (look.where < _EARLY)
    # A guard that is zero and falls at once: the mode was over when the step began.
    early = (look.where < _AT_ONCE) & ~hidden
    at_once = look.falls & (s0 <= noise) & (early | (lane.tries > 2 * _MANY_TRIES))
    # An event at the very end of a segment is decided there, where all is known.
    ends = at_once | ((is_near | (stalled & (d1 < 0))) & ~look.early & (h + to_event < left - clock))
    # A guard that falls below zero inside, or turns so near to it that its minimum must be looked at.
    again = ~ends & (look.falls | look.turns) & ~stalled
    # Up to the event that is expected; by halves where the expectations failed, down to round-off.
    guess = jnp.where(lane.tries > _MANY_TRIES, 0.5, jnp.where(hidden, _SHORTER, look.where))
    if ends.ndim:
        # The earliest event of several contacts ends the step; the other modes go on. What was over when the step began
        # comes first, then what falls inside, then what ends near the end of the step.
        now, inside = jnp.any(at_once), jnp.any(again)
        ends = jnp.where(now, at_once, ends & ~inside)
        first = jnp.min(jnp.where(ends, to_event, jnp.inf))
        ends = jnp.where(now, ends, ends & (to_event <= first + clock))
        guess = jnp.min(jnp.where(again, guess, jnp.inf))
        again, to_event, at_once = inside & ~now, first, any_of(at_once)
    landed = any_of(ends)
    # The error counts only if the step is not tried again anyway: it may be large because the step passes the event.
    inaccurate = jnp.zeros((), bool) if error is None else ~again & (error > _ERROR[itemsize])
    landed, again = landed & ~inaccurate, again | inaccurate
    behaved = h, reached, error, s0, d0, s1, d1, look.lowest, scale, clock, noise
    return _Trial(*behaved, ~landed & ~again, landed, again, ends & landed, at_once, inaccurate, to_event, guess)


def _close_calls(
    trial: _Trial, lane: Lane, step: FloatArray, at_event: BoolArray, at_stop: BoolArray
) -> tuple[BoolArray, BoolArray]:
    """Whether round-off decided if there was an event, and whether it did if the mode ended abruptly at the stop."""
    few = NEAR_GRAZING[step.dtype.itemsize]
    age = lane.t + trial.h - lane.event  # since the last event at rest, at the end of the step
    # The guard is so flat that it is close to its minimum: if the minimum were a little higher or lower, there would be
    # no event, or one. (In a slip that has just begun at rest the guard is still small, and this says nothing.)
    flat = jnp.abs(trial.d1) * step < math.sqrt(2 * few) * trial.scale
    # With curvature c, that of the cubic through the ends of the step and its round-off, the minimum is d1^2 / (2 c)
    # away: a slow guard without curvature, such as that of an overdamped mass, falls far below.
    h = jnp.maximum(trial.h, jnp.finfo(step.dtype).tiny)
    bend = jnp.abs(2 * trial.d0 + 4 * trial.d1 - 6 * (trial.s1 - trial.s0) / h)
    bend = jnp.maximum(bend, jnp.abs(trial.d1 - trial.d0)) + 6 * trial.noise / h
    flat = flat & (trial.d1 * (trial.d1 / trial.scale) * h < 2 * few * bend) & ((lane.sign == 0) | (age > step))
    inside = trial.lowest < few * trial.scale
    inside = inside & (trial.lowest > -trial.noise) & (trial.s0 > trial.noise)
    tie = (trial.taken & (inside | (flat & (trial.s1 < few * trial.scale)))) | (at_event & flat)
    # An event that was imminent, or had only just happened.
    due = (trial.d1 < 0) & (trial.s1 < -few * step * trial.d1)
    return tie, at_stop & (due | (age < few * step))


# How many steps a trajectory has room for.


MOST_STEPS = 2**30  # steps are counted in 32 bits
_SPARE = 4  # times as many steps where it is not known before the call how fast the motion is
_ROOM = 96  # steps more, for short trajectories
_FEWEST = 256  # steps that one trajectory has room for: all short ones share a program
_PER_GROUP = 16  # contacts whose events need as many steps as the motion
_PER_SEGMENT = 8  # time steps in a segment of a record where neither is known


def steps_for(system: System, excitation: Excitation, t1: Scalar, step: Scalar, name: str = "t1") -> int:
    """Number of loop steps that suffices for nearly every trajectory: by the time steps and segments until `t1`.

    Rounded up by `padded_length`, so that similar lengths share a compilation; the loop stops when the trajectory ends.
    Where a number that it depends on is traced, it follows from the lengths of records. Raises NotKnown where there are
    none, ValueError for more steps than 32 bits can count: argument `name` is too long.
    """
    laws = SegmentLaws.of(system, excitation).all
    try:
        horizon, shortest = largest(t1), smallest(step)
    except NotKnown:
        # By the number of segments alone, where there is a record.
        if not any(law.is_record for law in laws):
            raise
        try:
            segments = sum(law.segments(t1) for law in laws)
        except ConcretizationTypeError:  # of a law whose segments are not a record's
            raise NotKnown from None
        return padded_length((_PER_SEGMENT + 2) * segments + _ROOM)
    try:
        shortest = min(shortest, smallest(time_scales_of(system, excitation).usual_step))
    except NotKnown:
        shortest /= _SPARE
    segments = sum(law.segments(horizon) for law in laws)
    # Each contact has events of its own, the first soon after the start.
    groups = (system.tracks.contacts or 0) // _PER_GROUP
    steps = 1.5 * (1 + groups) * (horizon / shortest) + 2 * segments + _ROOM * (1 + groups / 2)
    if steps > MOST_STEPS:
        known = {math.inf: ""}
        for which, of in time_scales_of(system, excitation).scales.items():
            with suppress(NotKnown):
                time = smallest(math.inf if of.time is None else of.time)
                known.setdefault(time, f"; the {which} is {time:.3g} s")
        raise ValueError(
            f"Argument {name} must be shorter: {horizon:g} s hold more than {MOST_STEPS} steps of {shortest:.3g} s or "
            f"segments of the motion{known[min(known)]}. Where a fast decay is what is short, "
            "method=ss.Regularized(width) follows the slow motion after it in long steps."
        )
    return padded_length(math.ceil(steps))


# Lanes of the switched engine: a step is a time step, accepted or rejected.


class SwitchedEngine(StepsEngine[Lane]):
    """Time steps in which events are located; slips without closed forms are solved by `solver`."""

    solver: Any
    knows_motion: ClassVar[bool] = True

    def lane(
        self,
        smooth: Signal | None,
        key_data: Any,
        dtype,
        t0: FloatArray | None = None,
        resting: BoolArray | None = None,
    ) -> Lane:
        """As in all engines; at the time `t0` (s), 0 by default.

        `resting`: contacts whose relative velocity is made zero there.
        """
        segment_laws, step = SegmentLaws.of(self.system, self.excitation), jnp.asarray(self.step_length, dtype)
        states = segment_laws.first(self.excitation.segment_key_data(key_data), dtype)
        if t0 is None:
            t0 = jnp.zeros((), dtype)
        else:
            states = tuple(segment_at(law, first, t0) for law, first in zip(segment_laws.all, states, strict=True))
        return start_lane(self._model(smooth), segment_laws, states, self.y0, step, self.quantities, t0, resting)

    def advanced(
        self, shared: StepsShared, smooth: Signal | None, lane: Lane
    ) -> tuple[Lane, StickRecord, StepBeginnings]:
        lane_after, record, tried = advance(self._model(smooth), *shared, lane)
        return lane_after, record, self._beginning(lane)._replace(tried=tried)

    def idle(self, lane: Lane) -> tuple[StickRecord, StepBeginnings]:
        begun = self._beginning(lane)._replace(tried=jnp.zeros_like(lane.t))
        return no_stick(lane.t.dtype, ALL, lane.stick_start.shape), begun

    def inside(
        self, smooth: Signal | None, forms: tuple[Form, ...], step: tuple[StepBeginnings, State, FloatArray]
    ) -> Along:
        begun, _, length = step  # as long as was tried: that motion has been computed
        return along_step(self._model(smooth), forms, (begun, length if begun.tried is None else begun.tried), True)

    def steps_are_short(self, smooth: Signal | None) -> bool:
        return self._model(smooth).has_short_steps

    def seen(
        self, smooth: Signal | None, begun: StepBeginnings, length: FloatArray, end: State, asked: Asked
    ) -> tuple[FloatArray, Work | None]:
        return seen_in_step(self._model(smooth), begun, length, end, asked)

    @property
    def decay_in_step(self) -> Scalar:
        return self._model(None).without_memory(())[0].fastest_decay * self.step_length

    def no_sums(self, dtype) -> Sums:
        return Sums.zero(self.system.tracks.contacts, dtype)

    @property
    def knows_observed(self) -> bool:
        return bool(self.system.observed)

    def totals(self, lane: Lane) -> Totals:
        return lane.totals

    def numbers(self, smooth: Signal | None, lane: Lane) -> State:
        return self._model(smooth).numbers(lane.y)

    def run(self, lane: Lane, kept: tuple[StickRecord, StepBeginnings]) -> Run:
        """The parts of a `Simulation` of one trajectory that `follow` gave."""
        (records, beginnings), smooth = kept, self.excitation.signal
        beginnings = beginnings._replace(tried=None)
        path, state = StepPath(smooth, self.system, self.solver, beginnings), self.numbers(smooth, lane)
        others = self.status(lane), lane.t, state, lane.near_grazing_count, path
        return Run.of(self.system, records, lane.totals, *others)

    def _model(self, smooth: Signal | None) -> SwitchedModel:
        return self.system.switched_model(smooth, self.solver)

    def _beginning(self, lane: Lane) -> StepBeginnings:
        laws = SegmentLaws.of(self.system, self.excitation)
        return StepBeginnings(lane.t, lane.y, lane.sign, laws.segments(lane.segment_states))

    def results(self, sample: Signal | None, motion: Lane) -> SampleTotals:
        status, near = self.status(motion), motion.near_grazing_count
        return sample_totals(self.system, motion.totals, motion.at_start, status, near)


# One trajectory in time steps with located events, and the state along it.


_MOST_KEPT = 2**25  # loop steps whose states are kept: about 3 GB
_MOST_SLOPES = 3  # by more numbers, going back over the steps takes less time
_MOST_DOUBLINGS = 6  # of the number of loop steps, before a trajectory is given up


class StepPath(MotionPath):
    """Path given by the states at the beginnings of time steps."""

    smooth: Signal | None
    system: System
    solver: Any
    beginnings: StepBeginnings

    @property
    def model(self) -> SwitchedModel:
        """The system under its excitation."""
        return self.system.switched_model(self.smooth, self.solver)

    @property
    def times(self) -> Array:
        return self.beginnings.t

    def state(self, time: FloatArray) -> State:
        begun, model = self.beginnings.at(time), self.model
        # Terms of a power series are not computed anew for each that follows.
        inside = sharing(state_in_step) if model.has_short_steps else state_in_step
        return model.numbers(inside(model, begun, time - begun.t))

    def largest(self, form: Form, sign: Scalar, last: FloatArray, final: State) -> FloatArray:
        begun, model = self.beginnings, self.model
        lengths = jnp.append(begun.t[1:], last) - begun.t
        starts = jax.vmap(lambda y: of_form(form, model.numbers(y)))(begun.y)
        inside, steps = partial(along_step, model, (form,)), (begun, lengths)
        ends = sign, of_form(form, final)
        return largest_in_steps(inside, steps, starts, lengths, *ends, are_short=model.has_short_steps)

    def along_steps(self, last: FloatArray, asked: Asked) -> tuple[FloatArray, Sums | None]:
        begun, model = self.beginnings, self.model
        lengths = jnp.append(begun.t[1:], last) - begun.t
        end = state_in_step(model, jax.tree.map(lambda values: values[-1], begun), lengths[-1])
        ends = jax.tree.map(lambda values, of_last: jnp.concatenate([values[1:], of_last[None]]), begun.y, end)
        each = jax.vmap(lambda begun, h, end: seen_in_step(model, begun, h, end, asked))
        extremes, works = each(begun, lengths, ends)
        if works is None:
            return jnp.max(extremes, axis=0), None
        none = Sums.zero(self.system.tracks.contacts, last.dtype)
        return jnp.max(extremes, axis=0), lax.scan(lambda sums, work: (sums.with_work(work), None), none, works)[0]

    def with_observed(self, time: FloatArray) -> State:
        begun, model = self.beginnings.at(time), self.model
        y = state_in_step(model, begun, time - begun.t)
        known, own = model.without_memory(y, begun.sign)
        now, mode = model.forcing(time, begun.segments), model.modes_without_memory(begun.sign)
        return *model.numbers(y), *known.observed(now, own, mode)

    def rates(self, time: FloatArray) -> State:
        """The rates of the state at one time (s), per second; at an event, those after it."""
        begun, model = self.beginnings.at(time), self.model
        forcing, h = model.forcing(begun.t, begun.segments), time - begun.t
        return model.numbers(model.rates(forcing, h, state_in_step(model, begun, h), begun.sign))

    def segments(self, time: FloatArray) -> Segments:
        return self.beginnings.at(time).segments


def follow_steps(system: System, base: Any, method: Exact, t1: Scalar, y0: tuple[Number, ...], dtype) -> Run:
    """Simulate one trajectory in time steps with located events, again with twice the steps while they are too few."""
    excitation, step = Arguments(system, base, method, t1).checked_step()
    try:
        steps = steps_for(system, excitation, t1, step) if method.max_steps is None else method.max_steps
    except NotKnown:
        raise ValueError(
            "Argument method must give max_steps, Exact(max_steps=...), when t1 or the time scales are arguments of a "
            f"function under jax.jit: {max_steps_advice(system, excitation, method, t1)}."
        ) from None
    if steps > _MOST_KEPT:
        raise ValueError(
            f"Argument t1 must be shorter: {steps} steps would be kept, and at most {_MOST_KEPT} can be; "
            "simulate_ensemble keeps sticks only, for a single sample too."
        )
    if method.max_steps is None and not is_compiling():
        steps = max(steps, _FEWEST)
    start: Any = y0
    if len(y0) > MANY:  # few arrays: JAX would trace the numbers of each contact
        system, start = system.ready(), stacked(y0, dtype)
    run: Run = _follow_steps(system, excitation, method.solver, t1, start, step, steps=steps, dtype=dtype)
    for _ in range(_MOST_DOUBLINGS if method.max_steps is None else 0):
        if not is_short(run.status):
            break
        steps *= 2
        run = _follow_steps(system, excitation, method.solver, t1, start, step, steps=steps, dtype=dtype)
    return run


@kept_jit(static_argnames=("steps", "dtype"))
def _follow_steps(system, excitation, solver, t1, y0, step, *, steps, dtype) -> Run:
    engine = SwitchedEngine(system, excitation, t1, y0, step, steps, solver, quantities=ALL)
    return engine.run(*engine.followed(dtype, _MOST_SLOPES))
