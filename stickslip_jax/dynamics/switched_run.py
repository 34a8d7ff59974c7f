"""One whole trajectory of the switched engine, and its state at any time."""

import math
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax

from .._types import Array, FloatArray, Scalar
from ..base_motion.drive import Drive
from ..base_motion.pieces import open_feed
from ..base_motion.voltage import SourceVoltage
from .interval_engine import StickRecord
from .models import model_of, streams_of
from .switched_engine import Lane, Pieces, State, advance, has_ended, start_lane, status_of_lane

_BLOCK = 32  # turns of the loop after which to see whether the trajectory has ended
MOST_TURNS = 2**30  # they are counted in 32 bits


class Beginnings(NamedTuple):
    """Where each turn of the loop began, arrays (turns,): time (s), state, sign, and the pieces under way."""

    t: Array
    y: tuple[Array, ...]
    sign: Array
    pieces: Pieces


class Trajectory(eqx.Module):
    """What one trajectory leaves: its last `Lane`, a `StickRecord` for each turn of the loop, and where each began."""

    lane: Lane
    status: Array
    records: StickRecord
    beginnings: Beginnings


def lane_at_start(system: Any, drive: Drive, words: Any, y0: tuple[Any, ...], step: FloatArray, solver: Any) -> Lane:
    """The beginning of the trajectory that `words` choose."""
    dtype = step.dtype
    streams = streams_of(system, drive)
    model = model_of(system, drive.realised(words, dtype), solver)
    own = drive.words_of_pieces(words)
    feeds = tuple(open_feed(law, own, dtype) for law in streams.all)
    return start_lane(model, streams, feeds, y0, step)


@partial(jax.jit, static_argnames=("turns", "dtype"))
def run_trajectory(
    system: Any, drive: Drive, solver: Any, t1: Scalar, y0: tuple[Any, ...], step: Scalar, *, turns: int, dtype: Any
) -> Trajectory:
    """Follow one realisation for up to `turns` turns of the loop; where it ends earlier, the loop idles."""
    t1, step = jnp.asarray(t1, dtype), jnp.asarray(step, dtype)
    streams, model = streams_of(system, drive), model_of(system, drive.signal, solver)
    start = lane_at_start(system, drive, jnp.zeros(2, jnp.uint32), y0, step, solver)

    def turn(lane, _):
        following, record = advance(model, streams, t1, step, lane)
        return following, (record, Beginnings(lane.t, lane.y, lane.sign, streams.pieces(lane.feeds)))

    def run(lane):
        return lax.scan(turn, lane, None, length=_BLOCK)

    shapes = jax.eval_shape(run, start)[1]

    def idle(lane):
        begun = Beginnings(lane.t, lane.y, lane.sign, streams.pieces(lane.feeds))
        none = jax.tree.map(lambda leaf: jnp.full(leaf.shape, -1, leaf.dtype), shapes[0])
        return lane, (none, jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (_BLOCK, *jnp.shape(leaf))), begun))

    most = jnp.asarray(turns, jnp.int32)

    def block(lane, _):
        return lax.cond(has_ended(lane, t1, most), idle, run, lane)

    lane, traces = lax.scan(block, start, None, length=math.ceil(turns / _BLOCK))
    records, beginnings = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), traces)
    return Trajectory(lane, status_of_lane(lane, t1), records, beginnings)


def state_at(system: Any, drive: Drive, solver: Any, beginnings: Beginnings, time: FloatArray) -> State:
    """The state at one `time`, from the beginning of the turn that holds it."""
    model = model_of(system, drive.signal, solver)
    # Among turns that begin together (tries of the same step), the last: it is the one that was taken.
    index = jnp.clip(jnp.searchsorted(beginnings.t, time, side="right") - 1, 0)
    t, y, sign, pieces = jax.tree.map(lambda values: values[index], beginnings)
    inputs, h = model.inputs(t, pieces), time - t
    stuck, slid = model.stick(inputs, y, h), model.slip(inputs, y, jnp.where(sign == 0, 0, h), sign)
    return tuple(jnp.where(sign == 0, a, b) for a, b in zip(stuck, slid, strict=True))


def base_velocity_at(drive: Drive, beginnings: Beginnings, time: FloatArray) -> FloatArray:
    """The base velocity at one `time`, m/s; 0 where nothing but a voltage or the ground's acceleration drives."""
    index = jnp.clip(jnp.searchsorted(beginnings.t, time, side="right") - 1, 0)
    velocity = jnp.zeros_like(time)
    if drive.signal is not None and not isinstance(drive.signal, SourceVoltage):
        velocity = velocity + drive.signal.value(time)
    for piece in beginnings.pieces.base:
        begin, value, slope = (values[index] for values in (piece.begin, piece.value, piece.slope))
        velocity = velocity + value + slope * (time - begin)
    return velocity


def turns_for(system: Any, drive: Drive, t1: Scalar, step: Scalar) -> int:
    """How many turns of the loop nearly every trajectory needs: a few for every step's worth of time and piece.

    Raises ConcretizationTypeError if JAX is tracing a number that it depends on, ValueError if they are too many to be
    counted in 32 bits.
    """
    pieces = sum(law.pieces(t1) for law in streams_of(system, drive).all)
    turns = 1.5 * (float(t1) / float(step)) + 2 * pieces + 96
    if turns > MOST_TURNS:
        raise ValueError(
            f"Argument t1 must be shorter: {float(t1):g} s hold more than {MOST_TURNS} steps of {float(step):.3g} s or "
            "pieces of the motion."
        )
    return _BLOCK * math.ceil(turns / _BLOCK)
