"""Which mode a trajectory is in after an event or at the end of a segment: stick, or slip of either direction."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from ..._events.stick_quantities import StickSpan, measured
from ..._events.sticks import StickRecord, ending_of, with_stick
from ..._systems.switched_model import NOISE_ULPS, State, SwitchedModel
from ..._types import BoolArray, FloatArray
from ..common.segments import SegmentLaws, following_segments
from .lane import CLOCK_ULPS, NEAR_GRAZING, Lane, chosen_state


class Stop(NamedTuple):
    """How a time step ended: on an event of the mode (`landed`), or where a segment ends or at the horizon (`at_stop`).

    `brief`: a slip that ended there would end where it began, but for round-off.
    """

    landed: BoolArray
    brief: BoolArray
    at_stop: BoolArray


class _Mode(NamedTuple):
    """The state with its mode, `sign` (0 in a stick). `at_rest`: whether an event found the mass at rest.

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
    mode = _mode_after(model, forcing, lane, stop, ended, jumped)
    at_horizon = stop.at_stop & ~(lane.t < t1)
    following, record = _with_mode(lane, mode, ended & jumped, at_horizon)
    return following._replace(segment_states=segment_states), record, mode.margin, at_horizon | jumped


def _mode_after(
    model: SwitchedModel, forcing: object, lane: Lane, stop: Stop, ended: BoolArray, jumped: BoolArray
) -> _Mode:
    """The mode from here on. `ended`: whether a segment ended here; `jumped`: whether the base velocity jumped."""
    was_stick = lane.sign == 0
    on_base = model.on_base(forcing, lane.y)
    holds = model.can_stick(forcing, on_base)
    resting = model.at_rest(forcing, lane.y)
    guard, guard_rate = _stick_guard(model, forcing, on_base)
    # An event. A mass that is not at rest at it slips on, and friction reverses; so it does if a slip ends as it
    # begins. A slip that ends at rest is a stick where friction holds the mass, and else a slip by the force on it.
    turned = jnp.where(was_stick | (resting & ~stop.brief), model.release_sign(forcing, on_base), -lane.sign)
    sign = jnp.where(stop.landed, jnp.where(~was_stick & holds, 0, turned), lane.sign)
    # The end of a segment. A slip goes on unless the base jumps; everything else is decided as at a start.
    slipping = (lane.sign != 0) & ~jumped
    # A stick that goes on over the end of a segment is released by a force beyond the limit, not by round-off at it.
    goes_on = was_stick & ~jumped
    at_limit = goes_on & _is_not_below(guard, guard_rate, lane.t)
    resolved_y, resolved_sign = resolved_mode(model, forcing, lane.y, resting | goes_on, at_limit)
    resolve = ended & ~slipping
    sign = jnp.where(resolve, resolved_sign, sign)
    # A mass that sticks has the base's velocity to the last bit.
    y = chosen_state(resolve, resolved_y, chosen_state(stop.landed & (sign == 0), on_base, lane.y))
    at_rest = stop.landed & (resting | (sign == 0))
    decided = (stop.landed & ~was_stick) | (ended & ((jumped & resting) | goes_on))
    return _Mode(y, sign, at_rest, jnp.where(decided, jnp.abs(guard), jnp.inf))


def _with_mode(lane: Lane, mode: _Mode, jumped: BoolArray, at_horizon: BoolArray) -> tuple[Lane, StickRecord]:
    """The lane in its `mode`, its sticks counted, and the record of the stick that ended, if any."""
    was_stick, sticks = lane.sign == 0, mode.sign == 0
    over = was_stick & (~sticks | at_horizon) & (lane.t > lane.stick_start)
    stick = StickSpan(lane.stick_start, lane.t, lane.stick_position, left_at=mode.y[0])
    quantities, remembered = measured(lane.remembered, over, stick)
    ending = ending_of(over, ~at_horizon & ~jumped, at_horizon)
    record = StickRecord(stick.start, stick.end, stick.position, quantities, ending)
    begins = ~was_stick & sticks
    # A stick that starts exactly on the edge of the band ends at once: of no length, it does not count.
    no_stick = was_stick & ~sticks & ~over
    following = lane._replace(
        y=mode.y,
        sign=mode.sign,
        totals=with_stick(lane.totals, over, at_horizon, lane.t - lane.stick_start),
        event=jnp.where(mode.at_rest, lax.stop_gradient(lane.t), lane.event),
        at_start=lane.at_start & ~no_stick,
        stick_start=jnp.where(begins, lane.t, lane.stick_start),
        stick_position=jnp.where(begins, mode.y[0], lane.stick_position),
        remembered=remembered,
    )
    return following, record


def resolved_mode(
    model: SwitchedModel, forcing: object, y: State, resting: BoolArray, at_limit: BoolArray | bool = False
) -> tuple[State, FloatArray]:
    """The state and the sign of the mode of a mass in the state `y`, given whether it is `resting` on the base.

    `at_limit`: whether it sticks on although the force is at the limit, but for round-off.
    """
    on_base = model.on_base(forcing, y)
    held = model.can_stick(forcing, on_base) | at_limit
    held_or_released = jnp.where(held, 0, model.release_sign(forcing, on_base))
    return chosen_state(resting, on_base, y), jnp.where(resting, held_or_released, model.slip_sign(forcing, y))


def margin_at_start(model: SwitchedModel, forcing: object, y: State, resting: BoolArray) -> FloatArray:
    """The size of the stick guard where a trajectory begins at rest, infinity where it does not."""
    return jnp.where(resting, jnp.abs(_stick_guard(model, forcing, y)[0]), jnp.inf)


def is_tie(margin: FloatArray) -> BoolArray:
    """Whether the last digits decide if friction holds: `margin` is the size of the guard of a stick."""
    return margin < 2 * NEAR_GRAZING[margin.dtype.itemsize]


def _stick_guard(model: SwitchedModel, forcing: object, on_base: State) -> tuple[FloatArray, FloatArray]:
    """The guard of a stick, and its time derivative, now."""
    none = jnp.zeros_like(on_base[0])
    return model.guard(forcing, none, on_base, none)


def _is_not_below(guard: FloatArray, guard_rate: FloatArray, t: FloatArray) -> BoolArray:
    """Whether the guard of a stick is not below zero, but for its own round-off and that of the time."""
    return guard >= -jnp.finfo(t.dtype).eps * (2 * NOISE_ULPS + CLOCK_ULPS * t * jnp.abs(guard_rate))
