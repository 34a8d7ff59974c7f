"""Exact switched motion of any system: time steps in which every event is located to machine precision.

A system is given as a `SwitchedModel`: its motion in a slip of either direction and in a stick, and the guard, a
function that is positive while the current mode (stick, slip forward, slip backward) lasts. Each loop step tries one
time step:

- if the guard stays positive, the time step is accepted;
- if the guard falls through zero inside, the step is tried again with the estimated event as its end, until it ends
  within `_LANDED` of the event; a last Newton step then lands on the event (its derivatives: `carried.py`);
- if the guard has a minimum near zero, the step is tried again up to this minimum, to see whether it falls below;
- a time step never crosses the end of a segment of the base motion or of the load: there the mode is found anew;
- a time step whose error estimate is too large is tried again, shorter.

Two falls in one step with two more extrema of the guard between them can be missed, because the cubic through the ends
of a step cannot have these; so steps must be short compared to the shortest time scale (`time_scales.py` checks this).
Instants at which a change below `_NEAR_GRAZING` would create or remove an event are counted (`_close_calls`).
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..._compiler import sharing
from ..._events.sticks import StickRecord, Totals, ending_of, start_totals
from ..._excitation.excitation import Excitation
from ..._excitation.segments import SegmentLaw, SegmentState, following_segment, is_invalid
from ..._numerics.primal import without_derivatives
from ..._numerics.roots import look_ahead
from ..._status import Status
from ..._systems.switched_model import NOISE_ULPS, Segments, State, SwitchedModel
from ..._systems.system import System
from ..._types import BoolArray, FloatArray, IntArray
from .carried import HowItEnds, carried

_LANDED = {8: 1e-8, 4: 3e-4}  # fraction of a step; the Newton step that follows squares it
_NEAR_GRAZING = {8: 1e-9, 4: 1e-3}  # fraction of the guard's scale
_CLOCK_ULPS = 4  # the round-off of times, in units in the last place
_ERROR = {8: 1e-9, 4: 1e-5}  # relative, of a step without a closed form; the estimate of its solver is far too high
_LEAST_ERROR = 1e-20
_AT_ONCE = 1e-9  # fraction of a step: an earlier fall means that the mode was over when the step began
_GRAZING = 64  # times the guard's round-off: a slip whose guard changes by less than this in a step begins at rest
_EARLY, _SHORTER = 0.02, 0.25  # fractions of a step
_MANY_TRIES = 12  # after so many tries that missed the event, the step is halved instead, down to round-off


class Lane(NamedTuple):
    """Loop state of one trajectory. `sign`: that of the relative velocity, 0 in a stick."""

    t: FloatArray
    y: State
    sign: FloatArray
    target: FloatArray  # length of the next step to try
    pace: FloatArray  # the longest step that the errors of the steps so far allow
    event: FloatArray  # time of the last event at rest
    tries: IntArray
    steps: IntArray  # loop steps so far
    stick_start: FloatArray
    stick_position: FloatArray
    slid_from: FloatArray  # position where the current slip began, or during a stick where the slip before it began
    totals: Totals
    at_start: BoolArray
    near_grazing_count: IntArray
    segment_states: tuple[SegmentState, ...]


class SegmentLaws(eqx.Module):
    """The laws of all parts of the excitation that consist of segments; a lane's `segment_states` have their order."""

    base: tuple[SegmentLaw, ...]
    ground: tuple[SegmentLaw, ...]
    force: tuple[SegmentLaw, ...]

    @classmethod
    def of(cls, system: System, excitation: Excitation) -> "SegmentLaws":
        """The parts of excitation and force that consist of segments."""
        return cls(excitation.base, excitation.ground, system.recorded_loads)

    @property
    def all(self) -> tuple[SegmentLaw, ...]:
        return self.base + self.ground + self.force

    def segments(self, segment_states: tuple[SegmentState, ...]) -> Segments:
        """The current segments."""
        now = tuple(segment_state.segment for segment_state in segment_states)
        second, third = len(self.base), len(self.base) + len(self.ground)
        return Segments(now[:second], now[second:third], now[third:])


def start_lane(
    model: SwitchedModel,
    segment_laws: SegmentLaws,
    segment_states: tuple[SegmentState, ...],
    y0: tuple[Any, ...],
    step: FloatArray,
) -> Lane:
    """The lane at the beginning of a trajectory, with its mode (stick or slip) found."""
    dtype = step.dtype
    zero, none = jnp.zeros((), dtype), jnp.zeros((), jnp.int32)
    y = tuple(jnp.asarray(value, dtype) for value in y0)
    forcing = model.forcing(zero, segment_laws.segments(segment_states))
    resting = model.at_rest(forcing, y)
    y, sign = _resolve_mode(model, forcing, y, resting)
    edge = jnp.where(resting, jnp.abs(_stick_guard(model, forcing, y)[0]), jnp.inf)
    return Lane(
        zero,
        y,
        sign,
        lax.stop_gradient(model.step_limit(zero, step, y, sign)),
        jnp.full((), jnp.inf, dtype),
        zero,
        none,
        none,
        zero,
        y[0],
        y[0],
        start_totals(dtype),
        sign == 0,
        _on_edge(edge).astype(jnp.int32),
        segment_states,
    )


@sharing
def advance(
    model: SwitchedModel, segment_laws: SegmentLaws, t1: FloatArray, step: FloatArray, lane: Lane
) -> tuple[Lane, StickRecord]:
    """One loop step; returns the lane after it and the record of the stick that ended in it, if any."""
    dtype = lane.t.dtype
    before, given = lane, (model, model.forcing(lane.t, segment_laws.segments(lane.segment_states)), lane.y)
    stop = jnp.minimum(t1, _first(segment_state.segment.end for segment_state in lane.segment_states))
    left = time_left = stop - lane.t
    # No derivative passes through the search for the end of the step: `carried` knows what it depends on.
    (model, forcing, _), left, step, lane = without_derivatives((given, left, step, lane))
    to_stop = lane.t + lane.target >= stop  # not target >= left: the sum may be rounded up to stop
    h = jnp.where(to_stop, left, lane.target)
    y1, error, (s0, d0), (s1, d1), scale = _tried(model, forcing, lane, h)
    # Round-off of the guard itself, and of the time at which it is evaluated.
    clock = _CLOCK_ULPS * jnp.finfo(dtype).eps * (lane.t + h)
    noise = NOISE_ULPS * jnp.finfo(dtype).eps * scale + clock * jnp.maximum(jnp.abs(d0), jnp.abs(d1))
    look = look_ahead(s0, d0 * h, s1, d1 * h, noise)
    delta = jnp.where(d1 < 0, -s1 / jnp.where(d1 < 0, d1, -1), jnp.inf)
    near = jnp.abs(delta) <= _LANDED[dtype.itemsize] * step + clock
    stalled = (lane.tries > 3 * _MANY_TRIES) & (jnp.abs(s1) <= 16 * noise)
    # A released mass leaves its stick with no relative velocity and nearly no relative acceleration: a step that ends
    # after it has stuck again cannot show whether it slipped at all. Shorter steps show it.
    slow = jnp.abs(d0) * h <= _GRAZING * noise
    hidden = look.falls & (lane.sign != 0) & (s0 <= noise) & slow & (look.where < _EARLY)
    early = (look.where < _AT_ONCE) & ~hidden
    at_once = look.falls & (s0 <= noise) & (early | (lane.tries > 2 * _MANY_TRIES))
    # An event at the very end of a segment is decided there, where all is known.
    landed = at_once | ((near | (stalled & (d1 < 0))) & ~look.early & (h + delta < left - clock))
    again = ~landed & (look.falls | look.turns) & ~stalled
    # The error counts only if the step is not tried again anyway: it may be large because the step passes the event.
    rough = jnp.zeros((), bool) if error is None else ~again & (error > _ERROR[dtype.itemsize])
    landed, again = landed & ~rough, again | rough
    taken = ~landed & ~again
    stretch = _Stretch(lane.sign == 0, s0, s1, d1, look.lowest, noise, scale, step, lane.t + h - lane.event)
    touched, race = _close_calls(stretch, taken, landed & ~at_once, taken & to_stop)

    # The event: a Newton step from the end of the step.
    stays, delta = again | at_once, jnp.where(landed & ~at_once, delta, 0)
    tau = jnp.where(stays, 0, h + delta)
    moving = zip(y1, model.rates(forcing, h, y1, lane.sign), strict=True)
    y = _where(stays, lane.y, tuple(value + delta * rate for value, rate in moving))
    model, lane, ends = given[0], before, HowItEnds(~stays, landed & ~at_once, taken & to_stop)
    tau, *y = carried(*given, time_left, lane.sign, ends, tau, y)
    t = jnp.where(taken & to_stop, stop, lane.t + tau)
    live = ~(lane.t >= t1) & ~is_spent(lane) & ~jnp.isnan(lane.y[0])
    moved = lane._replace(
        t=t, y=_known(tuple(y), s1 + noise, again), tries=jnp.where(again, lane.tries + 1, 0), steps=lane.steps + 1
    )
    guess = jnp.where(lane.tries > _MANY_TRIES, 0.5, jnp.where(hidden, _SHORTER, look.where))
    brief = at_once | (t - lane.event <= _LANDED[dtype.itemsize] * step + clock)  # a slip that only round-off makes
    switched, record, edge, abrupt = _switch(model, segment_laws, moved, landed, brief, live & taken & to_stop, t1)
    near_grazing = touched | (race & abrupt) | _on_edge(edge) | (brief & (lane.sign != 0) & (switched.sign == 0))
    switched = switched._replace(near_grazing_count=lane.near_grazing_count + near_grazing)
    pace = lane.pace if error is None else _pace(lane.pace, h, error, taken, rough)
    longest = jnp.minimum(model.step_limit(t - switched.event, step, switched.y, switched.sign), pace)
    target = jnp.where(again & ~rough, guess * h, longest)
    switched = switched._replace(target=lax.stop_gradient(target), pace=lax.stop_gradient(pace))
    following = jax.tree.map(lambda new, old: jnp.where(live, new, old), switched, lane)
    return following, record._replace(ending=jnp.where(live, record.ending, np.int8(-1)))


class _Tried(NamedTuple):
    """A step of some length: the state after it, its error, the guard and its rate before and after, and its scale."""

    reached: State
    error: FloatArray | None
    before: tuple[FloatArray, FloatArray]
    after: tuple[FloatArray, FloatArray]
    scale: FloatArray


def _tried(model: SwitchedModel, forcing: Any, lane: Lane, h: FloatArray) -> _Tried:
    sticking = lane.sign == 0
    # A slip over a stick's long step may overflow.
    slid, error = model.slip_and_error(forcing, lane.y, jnp.where(sticking, 0, h), lane.sign)
    held, error_held = model.stick_and_error(forcing, lane.y, h)
    y1, error = _where(sticking, held, slid), _chosen(sticking, error_held, error)
    before = model.guard(forcing, jnp.zeros_like(h), lane.y, lane.sign)
    after = model.guard(forcing, h, y1, lane.sign)
    return _Tried(y1, error, before, after, model.guard_scale(forcing, y1, lane.sign))


def _known(y: State, guard: FloatArray, again: BoolArray) -> State:
    """The state `y`, NaN (`NOT_FINITE`) after a step whose `guard` is NaN: it would never fall, whatever happens."""
    return jnp.where(jnp.isnan(guard) & ~again, jnp.nan, y[0]), *y[1:]


class _Stretch(NamedTuple):
    """Quantities of a step that show how close an event was: the guard at both ends and its minimum, and times, s."""

    sticking: BoolArray
    s0: FloatArray
    s1: FloatArray
    d1: FloatArray
    lowest: FloatArray
    noise: FloatArray
    scale: FloatArray
    step: FloatArray
    age: FloatArray  # since the last event at rest, at the end of the step


def _close_calls(of: _Stretch, taken: BoolArray, landed: BoolArray, stopped: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Whether round-off decided if there was an event, and whether it would if the mode ended abruptly."""
    few = _NEAR_GRAZING[of.s1.dtype.itemsize]
    # The guard is so flat that it is close to its minimum: if the minimum were a little higher or lower, there would be
    # no event, or one. (In a slip that has just begun at rest the guard is still small, and this says nothing.)
    flat = (jnp.abs(of.d1) * of.step < math.sqrt(2 * few) * of.scale) & (of.sticking | (of.age > of.step))
    inside = (of.lowest < few * of.scale) & (of.lowest > -of.noise) & (of.s0 > of.noise)
    touched = (taken & (inside | (flat & (of.s1 < few * of.scale)))) | (landed & flat)
    # An event that was imminent, or had only just happened.
    due = (of.d1 < 0) & (of.s1 < -few * of.step * of.d1)
    return touched, stopped & (due | (of.age < few * of.step))


def _pace(pace: FloatArray, h: FloatArray, error: FloatArray, taken: BoolArray, rough: BoolArray) -> FloatArray:
    """The longest step allowed from here on, by the error of the step tried (order of the solvers: 8 or less)."""
    allowed = _ERROR[h.dtype.itemsize] / jnp.maximum(error, _LEAST_ERROR)
    change = jnp.clip(0.9 * jnp.sqrt(jnp.sqrt(jnp.sqrt(allowed))), 0.1, 5)
    faster = jnp.where(taken & (h >= 0.999 * pace), pace * change, pace)
    return jnp.where(rough, h * jnp.minimum(change, 0.8), faster)


def _switch(model, segment_laws, lane, landed, brief, at_stop, t1) -> tuple[Lane, StickRecord, FloatArray, BoolArray]:
    """Find the mode after an event or at the end of a segment; returns the lane and the record of the ended stick.

    Also returned: the size of the stick guard (0 at the edge of the band) where it was decided whether the mass sticks,
    infinity elsewhere; and whether a jump of the base or the horizon ended the mode.
    """
    ended = at_stop & (lane.t < t1)
    was_stick = lane.sign == 0
    segment_states, jumped = following_segments(segment_laws, lane.segment_states, lane.t, ended)
    forcing = model.forcing(lane.t, segment_laws.segments(segment_states))

    on_base = model.on_base(forcing, lane.y)
    holds = model.can_stick(forcing, on_base)
    resting = model.at_rest(forcing, lane.y)
    guard, guard_rate = _stick_guard(model, forcing, on_base)
    # A mass that is not at rest at the event slips on, and friction reverses; so it does if a slip ends as it begins.
    turned = jnp.where(was_stick | (resting & ~brief), model.release_sign(forcing, on_base), -lane.sign)
    sign = jnp.where(landed, jnp.where(~was_stick & holds, 0, turned), lane.sign)
    slipping = (lane.sign != 0) & ~jumped
    # A stick that goes on over the end of a segment is released by a force beyond the limit, not by round-off at it.
    goes_on = was_stick & ~jumped
    at_limit = goes_on & _is_not_below(guard, guard_rate, lane.t)
    resolved_y, resolved_sign = _resolve_mode(model, forcing, lane.y, resting | goes_on, at_limit)
    resolve = ended & ~slipping
    sign = jnp.where(resolve, resolved_sign, sign)
    y = _where(resolve, resolved_y, _where(landed & (sign == 0), on_base, lane.y))

    cut = at_stop & ~(lane.t < t1)
    over = was_stick & ((sign != 0) | cut) & (lane.t > lane.stick_start)
    ending = ending_of(over, ~cut & ~(ended & jumped), cut)
    displacement = lane.stick_position - lane.slid_from
    record = StickRecord(lane.stick_start, lane.t, lane.stick_position, displacement, ending)
    begins = ~was_stick & (sign == 0)
    at_rest = landed & (resting | (sign == 0))
    decided = (landed & ~was_stick) | (ended & ((jumped & resting) | goes_on))
    edge = jnp.where(decided, jnp.abs(guard), jnp.inf)
    # A stick that starts exactly on the edge of the band ends at once: of no length, it does not count.
    no_stick = was_stick & (sign != 0) & ~over
    totals = Totals(
        sticks=lane.totals.sticks + over,
        censored=lane.totals.censored + (over & cut),
        stick_time=lane.totals.stick_time + jnp.where(over, lane.t - lane.stick_start, 0),
    )
    return (
        lane._replace(
            y=y,
            sign=sign,
            totals=totals,
            segment_states=segment_states,
            event=jnp.where(at_rest, lax.stop_gradient(lane.t), lane.event),
            at_start=lane.at_start & ~no_stick,
            stick_start=jnp.where(begins, lane.t, lane.stick_start),
            stick_position=jnp.where(begins, y[0], lane.stick_position),
            slid_from=jnp.where(over, y[0], lane.slid_from),
        ),
        record,
        edge,
        cut | jumped,
    )


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


def _stick_guard(model, forcing, on_base) -> tuple[FloatArray, FloatArray]:
    """The guard of a stick, and its time derivative, now."""
    none = jnp.zeros_like(on_base[0])
    return model.guard(forcing, none, on_base, none)


def _is_not_below(guard: FloatArray, guard_rate: FloatArray, t: FloatArray) -> BoolArray:
    """Whether the guard of a stick is not below zero, but for its own round-off and that of the time."""
    return guard >= -jnp.finfo(t.dtype).eps * (2 * NOISE_ULPS + _CLOCK_ULPS * t * jnp.abs(guard_rate))


def _on_edge(edge: FloatArray) -> BoolArray:
    """Whether the last digits decide if friction holds: `edge` is the size of the guard of a stick."""
    return edge < 2 * _NEAR_GRAZING[edge.dtype.itemsize]


def _resolve_mode(model, forcing, y, resting, at_limit=False):
    """The state and the sign of the mode of a mass in the state `y`, given whether it is `resting` on the base.

    `at_limit`: whether it sticks on although the force is at the limit, but for round-off.
    """
    on_base = model.on_base(forcing, y)
    held = model.can_stick(forcing, on_base) | at_limit
    held_or_released = jnp.where(held, 0, model.release_sign(forcing, on_base))
    return _where(resting, on_base, y), jnp.where(resting, held_or_released, model.slip_sign(forcing, y))


def status_of_lane(lane: Any, t1: FloatArray) -> IntArray:
    """The `Status` of a trajectory that has ended or is given up."""
    finite = jnp.isfinite(lane.t + t1)
    for value in lane.y:
        finite = finite & jnp.isfinite(value)
    unfinished = jnp.where(is_spent(lane), Status.BASE_TOO_SHORT, Status.OUT_OF_STEPS)
    code = jnp.where(finite, jnp.where(lane.t < t1, unfinished, Status.FINISHED), Status.NOT_FINITE)
    for segment_state in lane.segment_states:  # one that cannot be may have made the state infinite
        code = jnp.where(is_invalid(segment_state) & ~(lane.t >= t1), Status.BASE_INVALID, code)
    return code.astype(jnp.int8)


def has_ended(lane: Any, t1: FloatArray, most_steps: IntArray) -> BoolArray:
    """Whether the trajectory has ended: by the horizon, the end of the base motion, a NaN, or too many loop steps."""
    finite = jnp.ones((), bool)
    for value in lane.y:
        finite = finite & jnp.isfinite(value)
    return ~(lane.t < t1) | is_spent(lane) | (lane.steps >= most_steps) | ~finite


def is_spent(lane: Any) -> BoolArray:
    """Whether some part of the excitation has no further segment."""
    spent = jnp.zeros((), bool)
    for segment_state in lane.segment_states:
        spent = spent | segment_state.spent
    return spent


def _first(times) -> FloatArray | float:
    earliest = jnp.inf
    for time in times:
        earliest = jnp.minimum(earliest, time)
    return earliest


def _chosen(first: BoolArray, one: FloatArray | None, other: FloatArray | None) -> FloatArray | None:
    """One of two error estimates; None stands for 0, and both None give None."""
    if one is None and other is None:
        return None
    return jnp.where(first, 0 if one is None else one, 0 if other is None else other)


def _where(chosen: BoolArray, new: State, old: State) -> State:
    return tuple(jnp.where(chosen, a, b) for a, b in zip(new, old, strict=True))
