"""Which mode a trajectory is in after an event or at the end of a segment: stick, or slip of either direction."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from ..._events.stick_quantities import StickSpan, measured
from ..._events.sticks import StickRecord, ending_of, with_stick
from ..._numerics.over_contacts import any_of
from ..._systems.switched_model import NOISE_ULPS, Question, State, SwitchedModel
from ..._types import BoolArray, FloatArray, FloatScalar
from ..common.segments import SegmentLaws, following_segments
from .lane import CLOCK_ULPS, NEAR_GRAZING, Lane


class Stop(NamedTuple):
    """How a time step ended: on an event of the mode (`landed`), or where a segment ends or at the horizon (`at_stop`).

    `landed`: of each contact, whether its mode ended there. `brief`: its slip would end where it began, but for
    round-off. `start_error`: by how much round-off may have moved the start of a stick that begins here, s.
    """

    landed: BoolArray
    brief: BoolArray
    at_stop: BoolArray
    start_error: FloatScalar


class _Mode(NamedTuple):
    """The state with its mode, `sign` (0 in a stick). `at_rest`: whether an event found the contact at rest.

    `margin`: the size of the stick guard (0 where friction just holds) where it was decided whether the mass sticks,
    infinity elsewhere.
    """

    y: State
    sign: FloatArray
    at_rest: BoolArray
    margin: FloatArray


def switched(
    model: SwitchedModel, segment_laws: SegmentLaws, lane: Lane, stop: Stop, t1: FloatArray
) -> tuple[Lane, StickRecord, FloatArray, BoolArray]:
    """The lane after an event or at the end of a segment, in its mode, and the record of the stick that ended, if any.

    Also returned: the margin by which friction held or did not (see `_Mode`), and whether a jump of the base or the
    horizon ended the mode.
    """
    ended = stop.at_stop & (lane.t < t1)
    segment_states, jumped = following_segments(segment_laws, lane.segment_states, lane.t, ended)
    forcing = model.forcing(lane.t, segment_laws.segments(segment_states))
    may_jump = any(law.jumps for law in segment_laws.all)
    mode = _mode_after(model, forcing, lane, stop, ended, jumped, may_jump=may_jump)
    at_horizon = stop.at_stop & ~(lane.t < t1)
    following, record = _with_mode(model, lane, mode, ended & jumped, at_horizon, stop.start_error)
    return following._replace(segment_states=segment_states), record, mode.margin, at_horizon | jumped


def _mode_after(
    model: SwitchedModel,
    forcing: object,
    lane: Lane,
    stop: Stop,
    ended: BoolArray,
    jumped: BoolArray,
    *,
    may_jump: bool,
) -> _Mode:
    """The mode from here on. `ended`: whether a segment ended here; `jumped`: whether the base velocity jumped."""
    was_stick = lane.sign == 0
    resting = model.at_rest(forcing, lane.y)
    sign, landed, changed = model.after(forcing, lane.y, lane.sign, stop.landed, ended)
    # The end of a segment. A slip goes on unless the base jumps; everything else is decided as at a start.
    resolve = (ended & (was_stick | jumped)) | changed
    # A stick that goes on over the end of a segment is released by a force beyond the limit, not by round-off at it.
    goes_on = was_stick & ~jumped
    asked, stays = landed | (resolve & (resting | goes_on)), jnp.zeros_like(was_stick)
    slips = model.slip_sign(forcing, lane.y)
    if model.coupled:
        # What slips from here on acts on the others at once.
        sign = jnp.where(resolve & ~(resting | goes_on), slips, sign)
        # Where one mode changes, the friction that other sticks need changes too.
        stays = was_stick & any_of(landed | changed) & ~landed
        asked, goes_on = asked | stays, goes_on | stays
    released = landed & was_stick
    holds, release_sign, guard, guard_rate = model.decided(
        forcing, lane.y, Question(sign, asked, released, goes_on & ~released)
    )
    # At the limit, friction that need not grow holds: else the mass would slip to and fro with no motion.
    not_below = is_not_below(guard, guard_rate, lane.t)
    # (A cart passes zero velocity at full speed of its motor too, where the guard and its rate have poles.)
    holds = holds | (resting & not_below & is_not_below(-guard, guard_rate, lane.t) & (guard_rate >= 0))
    # An event. A mass that is not at rest at it slips on, and friction reverses; so it does if a slip ends as it
    # begins. A slip that ends at rest is a stick where friction holds the mass, and else a slip by the force on it.
    turned = jnp.where(was_stick | (resting & ~stop.brief), release_sign, -sign)
    sign = jnp.where(landed, jnp.where(~was_stick & holds, 0, turned), sign)
    held_or_released = jnp.where(holds | (not_below & goes_on), 0, release_sign)
    resolved = jnp.where(resting | goes_on, held_or_released, slips)
    sign = jnp.where(resolve, resolved, jnp.where(stays, held_or_released, sign))
    # A mass that sticks has the base's velocity to the last bit.
    rests = (resolve & (resting | goes_on)) | (landed & (sign == 0))
    y = model.at_base_velocity(forcing, lane.y, rests)
    at_rest = (landed & (resting | (sign == 0))) | (stays & (sign != 0))
    decided = (landed & ~was_stick) | (ended & ((jumped & resting) | goes_on)) | stays
    margin = jnp.where(decided, jnp.abs(guard), jnp.inf)
    if may_jump:
        # Right after a jump, a velocity that is zero but for round-off may be on either side of it, or at rest.
        nearly = NEAR_GRAZING[lane.t.dtype.itemsize] / (NOISE_ULPS * float(jnp.finfo(lane.t.dtype).eps))
        near_rest = ended & jumped & ~was_stick & holds & model.at_rest(forcing, lane.y, nearly)
        margin = jnp.where(near_rest, 0, margin)
    return _Mode(y, sign, at_rest, margin)


def _with_mode(
    model: SwitchedModel, lane: Lane, mode: _Mode, jumped: BoolArray, at_horizon: BoolArray, start_error: FloatScalar
) -> tuple[Lane, StickRecord]:
    """The lane in its `mode`, its sticks counted, and the record of the stick that ended, if any."""
    was_stick, sticks, position = model.stuck(lane.sign), model.stuck(mode.sign), model.stick_position(mode.y)
    over = was_stick & (~sticks | at_horizon) & (lane.t > lane.stick_start + lane.start_error)
    now = jnp.broadcast_to(lane.t, lane.stick_start.shape)
    stick = StickSpan(lane.stick_start, now, lane.stick_position, left_at=position)
    quantities, remembered = measured(lane.remembered, over, stick)
    ending = ending_of(over, ~at_horizon & ~jumped, at_horizon)
    record = StickRecord(stick.start, stick.end, stick.position, quantities, ending)
    begins = ~was_stick & sticks
    # A stick that starts on the edge of the band, or on the end of a segment, ends at once: of no length, it is none.
    no_stick = was_stick & ~sticks & ~over
    undecided = any_of(no_stick & (lane.t > lane.stick_start))
    following = lane._replace(
        y=mode.y,
        sign=mode.sign,
        totals=with_stick(lane.totals, over, at_horizon, lane.t - lane.stick_start),
        event=jnp.where(mode.at_rest, lax.stop_gradient(lane.t), lane.event),
        at_start=lane.at_start & ~no_stick,
        near_grazing_count=lane.near_grazing_count + undecided,
        stick_start=jnp.where(begins, lane.t, lane.stick_start),
        start_error=jnp.where(begins, lax.stop_gradient(start_error), lane.start_error),
        stick_position=jnp.where(begins, position, lane.stick_position),
        remembered=remembered,
    )
    return following, record


def mode_at_start(model: SwitchedModel, forcing: object, y: State) -> tuple[State, FloatArray, FloatArray]:
    """The state, the sign of the mode and the margin (see `_Mode`) of a trajectory that begins in the state `y`."""
    resting = model.at_rest(forcing, y)
    slips = model.slip_sign(forcing, y)
    never = jnp.zeros_like(resting)
    holds, release_sign, guard, _ = model.decided(forcing, y, Question(slips, resting, never, never))
    sign = jnp.where(resting, jnp.where(holds, 0, release_sign), slips)
    return model.at_base_velocity(forcing, y, resting), sign, jnp.where(resting, jnp.abs(guard), jnp.inf)


def is_tie(margin: FloatArray) -> BoolArray:
    """Whether the last digits decide if friction holds: `margin` is the size of the guard of a stick."""
    return margin < 2 * NEAR_GRAZING[margin.dtype.itemsize]


def is_not_below(guard: FloatArray, guard_rate: FloatArray, t: FloatArray) -> BoolArray:
    """Whether the guard of a stick is not below zero, but for its own round-off and that of the time."""
    return guard >= -jnp.finfo(t.dtype).eps * (2 * NOISE_ULPS + CLOCK_ULPS * t * jnp.abs(guard_rate))
