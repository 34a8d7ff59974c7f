"""The edges of a stick's existence for any system, one turn of the switched engine's loop at a time.

While a mode lasts its guard is positive (`dynamics.switched_engine`). Where the guard falls and turns up again it has
a lowest value, which tells how far the arc was from touching zero; where it does fall through zero, following the same
flow beyond tells the same, with the other sign. So the lowest value is smooth through 0 and known on both sides.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .._types import BoolArray, FloatArray
from ..base_motion.pieces import Feed
from ..dynamics.switched_engine import Lane, Streams, next_feeds
from ..dynamics.switched_model import State, SwitchedModel
from ..numerics.roots import look_ahead, lowest_between, steepest_fall
from .edges import Edges, Number

_NOISE = {8: 1e-9, 4: 1e-3}  # of the guard's scale: a lowest value nearer to 0 is 0 by construction
_FAR = 0.5  # of the guard's scale: no kernel reaches so far
_STEPS_BEYOND = (0.5, 1.5, 12)  # how a flow is followed beyond what ended it: first and last of so many time steps
_TRIES = 3  # to find the lowest point in a step, by cubics


class Moment(NamedTuple):
    """A turn of the loop: time, state, sign and pieces under way at its beginning; the first three at its end."""

    t: FloatArray
    y: State
    sign: FloatArray
    feeds: tuple[Feed, ...]
    end: FloatArray
    y_end: State
    sign_end: FloatArray

    @classmethod
    def of(cls, before: Lane, after: Lane) -> "Moment":
        """The turn that led from `before` to `after`."""
        return cls(before.t, before.y, before.sign, before.feeds, after.t, after.y, after.sign)


class _Turn(NamedTuple):
    """What happened in a turn, its length, and when the piece of the drive under way ends, or the time (both s)."""

    tau: FloatArray
    stop: FloatArray
    has_event: BoolArray  # the mode was switched, by nothing from outside
    crosses: BoolArray  # the mass crossed the base velocity
    dips: BoolArray  # the guard fell and turned up again
    fall: FloatArray  # where it fell then, a fraction of the turn
    falls: BoolArray  # the guard was falling when the piece ended

    @property
    def may_be_near(self) -> BoolArray:
        """Whether anything can be: in all other turns nothing is."""
        return self.has_event | self.crosses | self.dips | self.falls


class _Stretch(NamedTuple):
    """A stretch of a flow: time and state at its beginning, its length; the guard's value and slope at both ends."""

    t: FloatArray
    y: State
    length: FloatArray
    s0: FloatArray
    d0: FloatArray
    s1: FloatArray
    d1: FloatArray


def may_be_near(model: SwitchedModel, streams: Streams, t1: FloatArray, moment: Moment) -> BoolArray:
    """Whether the turn has edges to look for."""
    return _turn(model, streams, t1, lax.stop_gradient(moment)).may_be_near


def edges_of_moment(model: SwitchedModel, streams: Streams, t1: FloatArray, step: FloatArray, moment: Moment) -> Edges:
    """The edges of one turn that may have some."""
    turn, sticking = _turn(model, streams, t1, moment), moment.sign == 0
    here = _stretch(model, streams, moment, turn, step)
    grazing, nearest = _grazing(model, streams, moment, turn, here)
    left, is_late, is_undone = _race(model, streams, moment, turn, here)
    at_horizon = turn.stop >= t1
    # No stick begins after t1; a slip after t1 parts none.
    horizon = Number(t1 + (left - turn.stop), (turn.has_event | (is_late & at_horizon)) & ~sticking)
    race = Number(left, (turn.has_event | is_late) & is_undone & ~at_horizon)
    switched = turn.has_event | turn.crosses
    time = jnp.where(switched, moment.end, jnp.where(is_late, turn.stop, nearest))
    return Edges(
        time=lax.stop_gradient(time),
        exists=turn.has_event,
        is_slip=sticking,
        grazing=grazing,
        race=race,
        horizon=horizon,
        crossing=_crossing(model, streams, moment, switched & ~sticking),
    )


def _turn(model: SwitchedModel, streams: Streams, t1: FloatArray, moment: Moment) -> _Turn:
    sticking = moment.sign == 0
    tau = lax.stop_gradient(moment.end - moment.t)
    stop = jnp.min(jnp.stack([t1, *(feed.piece.end for feed in moment.feeds)]), axis=0)
    inputs = model.inputs(moment.t, streams.pieces(moment.feeds))
    s0, d0 = model.guard(inputs, jnp.zeros_like(tau), moment.y, moment.sign)
    s1, d1 = model.guard(inputs, tau, moment.y_end, moment.sign)
    fall = steepest_fall(s0, d0 * tau, s1, d1 * tau)
    taken = (moment.t < t1) & (tau > 0)
    inside = taken & (moment.end < stop)
    has_event = inside & ((moment.sign_end == 0) != sticking)
    crosses = inside & ~sticking & (moment.sign_end == -moment.sign)
    dips = taken & ~has_event & ~crosses & (fall < 1) & (d1 > 0)
    falls = taken & (moment.end >= stop) & (s1 > 0) & (d1 < 0)
    return _Turn(tau, stop, has_event, crosses, dips, fall, falls)


def _stretch(model: SwitchedModel, streams: Streams, moment: Moment, turn: _Turn, step: FloatArray) -> _Stretch:
    """Where the guard turns up: in the turn, or, if that ended with an event, in what the flow would have done then.

    In a turn cut short by the end of a piece: where the guard would have come to zero.
    """
    pieces = streams.pieces(moment.feeds)

    def follow(t, y, length):
        inputs, nothing = model.inputs(t, pieces), jnp.zeros_like(length)
        ahead = _flow(model, inputs, y, length, moment.sign)
        before, after = model.guard(inputs, nothing, y, moment.sign), model.guard(inputs, length, ahead, moment.sign)
        return _Stretch(t, y, length, *before, *after), ahead

    # A turn that dips is looked at from where the guard falls.
    before = jnp.where(turn.dips, turn.fall * turn.tau, 0)
    inputs = model.inputs(moment.t, pieces)
    start = _flow(model, inputs, moment.y, before, moment.sign)
    whole, ahead = follow(moment.t + before, start, turn.tau - before)
    longest = lax.stop_gradient(model.step_limit(jnp.full_like(step, jnp.inf), step, ahead, moment.sign))
    longest = jnp.where(moment.sign == 0, step, longest)

    def go_on(carry, share):
        found, kept, t, y = carry
        length = share * longest
        beyond, ahead = follow(t, y, length)
        hit = ~found & jnp.where(turn.falls, beyond.s1 <= 0, (beyond.d0 < 0) & (beyond.d1 > 0))
        kept = jax.tree.map(lambda new, old: jnp.where(hit, new, old), beyond, kept)
        return (found | hit, kept, t + length, ahead), None

    # Not found is told by a stretch whose guard does not turn.
    nowhere = whole._replace(d1=jnp.where(turn.dips, whole.d1, -1.0))
    start = (turn.dips, nowhere, moment.t + turn.tau, ahead)
    (_, kept, _, _), _ = lax.scan(go_on, start, jnp.linspace(*_STEPS_BEYOND, dtype=step.dtype))
    return kept


def _flow(model: SwitchedModel, inputs: Any, y: State, length: FloatArray, sign: FloatArray) -> State:
    # What is not chosen must stay finite: see `advance`.
    slid = model.slip(inputs, y, jnp.where(sign == 0, 0, length), sign)
    return tuple(jnp.where(sign == 0, a, b) for a, b in zip(model.stick(inputs, y, length), slid, strict=True))


def _grazing(
    model: SwitchedModel, streams: Streams, moment: Moment, turn: _Turn, here: _Stretch
) -> tuple[Number, FloatArray]:
    """Minus the guard's lowest value, and when it is reached."""
    inputs = model.inputs(here.t, streams.pieces(moment.feeds))
    turns = (turn.dips | turn.has_event) & (here.d0 < 0) & (here.d1 > 0)

    def guard(tau):
        return model.guard(inputs, tau, _flow(model, inputs, here.y, tau, moment.sign), moment.sign)

    def narrow(bracket, _):
        at, _ = _lowest(bracket)
        new = (at, *lax.stop_gradient(guard(at)))
        below = new[2] < 0
        left, right = (jax.tree.map(lambda a, b: jnp.where(side, a, b), new, end)  # noqa: B023
                       for side, end in ((below, bracket[0]), (~below, bracket[1])))  # fmt: skip
        return (left, right), None

    bracket = lax.stop_gradient((
        (jnp.zeros_like(here.length), here.s0, jnp.where(turns, here.d0, -1)),
        (here.length, here.s1, jnp.where(turns, here.d1, 1)),
    ))  # fmt: skip
    bracket, _ = lax.scan(narrow, bracket, None, length=_TRIES)
    at, bend = _lowest(bracket)
    value, slope = guard(jnp.where(turns, at, 0))
    # One Newton step more, along a parabola; where the lowest point is does not matter to first order.
    shift = -lax.stop_gradient(slope) / jnp.where(bend > 0, bend, 1)
    lowest = value + slope * shift + 0.5 * bend * shift * shift
    when = here.t + at + shift
    scale = lax.stop_gradient(model.guard_scale(inputs, here.y, moment.sign))
    size = jnp.abs(lowest)
    near = (size > _NOISE[size.dtype.itemsize] * scale) & (size < _FAR * scale)
    return Number(-lowest, turns & (bend > 0) & near & (when < turn.stop)), when


def _lowest(bracket: tuple[Any, Any]) -> tuple[FloatArray, FloatArray]:
    """Where the guard is lowest between two points (time, value, slope) that it falls from and rises to, and its
    second derivative there.
    """
    (a, s0, d0), (b, s1, d1) = bracket
    length = b - a
    u, bend = lowest_between(s0, d0 * length, s1, d1 * length)
    return a + u * length, bend / jnp.where(length > 0, length * length, 1)


def _race(
    model: SwitchedModel, streams: Streams, moment: Moment, turn: _Turn, here: _Stretch
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Time from the switch of the mode to the end of the piece; whether the switch would have come after it; whether
    what follows in the drive undoes the switch.
    """
    sticking, pieces = moment.sign == 0, streams.pieces(moment.feeds)
    # When the switch would have come, had nothing ended: guessed by a cubic, and then a Newton step.
    inputs = model.inputs(here.t, pieces)
    falls = turn.falls & (here.s0 > 0) & (here.s1 <= 0)
    look = look_ahead(here.s0, here.d0 * here.length, here.s1, here.d1 * here.length, jnp.zeros_like(here.s0))
    guess = lax.stop_gradient(here.length) * look.where
    y = _flow(model, inputs, here.y, jnp.where(falls, guess, 0), moment.sign)
    value, slope = model.guard(inputs, guess, y, moment.sign)
    falls = falls & (slope < 0)
    would = here.t + guess - value / lax.stop_gradient(jnp.where(falls, slope, -1))
    there = model.inputs(lax.stop_gradient(would), pieces)
    is_late = falls & (sticking | model.can_stick(there, model.on_base(there, lax.stop_gradient(y))))
    left = turn.stop - jnp.where(turn.has_event, moment.end, would)
    if not streams.all:
        return left, is_late, jnp.zeros_like(falls)
    following, jumped = next_feeds(streams, moment.feeds, turn.stop, jnp.ones((), bool))
    now = lax.stop_gradient(jnp.where(turn.has_event, moment.end, turn.stop))
    inputs = model.inputs(now, streams.pieces(following))
    y = model.on_base(inputs, moment.y_end)
    _, rate = model.guard(inputs, jnp.zeros_like(now), y, jnp.zeros_like(now))
    undone = jnp.where(sticking, ~jumped & (rate > 0), jumped | ~model.can_stick(inputs, y))
    return left, is_late, undone


def _crossing(model: SwitchedModel, streams: Streams, moment: Moment, arrives: BoolArray) -> Number:
    """How far friction is from the other edge of what it can hold, for arrivals that this edge comes towards."""
    inputs = model.inputs(moment.end, streams.pieces(moment.feeds))
    nothing = jnp.zeros_like(moment.end)
    y = model.on_base(inputs, moment.y_end)
    guard, rate = model.guard(inputs, nothing, y, nothing)
    other = model.release_sign(inputs, y) == -moment.sign
    return Number(guard, arrives & other & (rate < 0) & (jnp.abs(guard) < _FAR))
