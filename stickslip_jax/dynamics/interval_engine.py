"""Exact motion on a base of piecewise-constant velocity: one closed form per interval, scanned over the intervals.

One trajectory per call; batches are made with ``jax.vmap`` outside. Time is carried in seconds, so that switching
instants are exact sums of durations; inside an interval the closed forms measure it as the angle ``omega t``.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from .._status import Ending, Status
from .._types import Array, BoolArray, FloatArray, IntArray, Scalar
from ..systems.mass_spring import MassSpring
from .arcs import carry_across


class Motion(NamedTuple):
    """Where the mass is: time in s, position in m, velocity divided by omega in m."""

    t: FloatArray
    x: FloatArray
    p: FloatArray


class Scales(NamedTuple):
    """What the closed forms need to know of the system, and the horizon."""

    omega: FloatArray
    half_width: FloatArray
    t1: FloatArray


class StickRecord(NamedTuple):
    """The stick of one interval, if ``stuck``; times in s, position in m."""

    start: FloatArray
    end: FloatArray
    position: FloatArray
    ending: IntArray
    stuck: BoolArray


class Totals(NamedTuple):
    """Sums over the sticks of one trajectory."""

    sticks: IntArray
    released: IntArray
    slips_before: IntArray  # sticks that follow a slip: all but one that lasts from t = 0
    sticking_at_end: BoolArray
    stick_time: FloatArray


def scales_of(system: MassSpring, t1: Scalar, dtype) -> Scales:
    """The system's scales as arrays of `dtype`."""
    omega = jnp.sqrt(jnp.asarray(system.stiffness, dtype) / jnp.asarray(system.mass, dtype))
    return Scales(omega, jnp.asarray(system.stick_half_width, dtype), jnp.asarray(t1, dtype))


def start_motion(scales: Scales, y0: tuple[Scalar, Scalar]) -> Motion:
    """The initial state ``y0 = (position, velocity)``; a velocity equal to the base's is kept equal to the last bit."""
    dtype = scales.omega.dtype
    return Motion(jnp.zeros((), dtype), jnp.asarray(y0[0], dtype), jnp.asarray(y0[1], dtype) / scales.omega)


def start_totals(dtype) -> Totals:
    """Nothing counted yet."""
    none = jnp.zeros((), jnp.int32)
    return Totals(none, none, none, jnp.zeros((), bool), jnp.zeros((), dtype))


def cross_interval(
    scales: Scales, motion: Motion, duration: FloatArray, velocity: FloatArray
) -> tuple[Motion, StickRecord, FloatArray]:
    """Cross one interval, cut at the horizon: the next state, the stick in it, and that stick's duration in s.

    The duration is not taken as ``end - start``, whose error grows with the time of day.
    """
    omega, a, t1 = scales
    before_horizon = motion.t + duration < t1
    span = jnp.where(before_horizon, duration, t1 - motion.t)
    passage = carry_across(motion.x, motion.p, velocity / omega, a, omega * span)
    t_end = jnp.where(before_horizon, motion.t + duration, t1)
    live = motion.t < t1
    following = Motion(t_end, jnp.where(live, passage.x, motion.x), jnp.where(live, passage.p, motion.p))
    ending = jnp.where(
        passage.released, Ending.RELEASED, jnp.where(before_horizon, Ending.BASE_SWITCHED, Ending.HORIZON)
    )
    record = StickRecord(
        start=motion.t + passage.entered / omega,
        end=jnp.where(passage.released, motion.t + passage.left / omega, t_end),
        position=passage.position,
        ending=ending.astype(jnp.int8),
        stuck=passage.stuck,
    )
    return following, record, jnp.where(passage.stuck, (passage.left - passage.entered) / omega, 0)


def add_stick(totals: Totals, record: StickRecord, duration: FloatArray) -> Totals:
    """Count one interval's stick."""
    return Totals(
        sticks=totals.sticks + record.stuck,
        released=totals.released + (record.stuck & (record.ending == Ending.RELEASED)),
        slips_before=totals.slips_before + (record.stuck & (record.start > 0)),
        sticking_at_end=totals.sticking_at_end | (record.stuck & (record.ending == Ending.HORIZON)),
        stick_time=totals.stick_time + duration,
    )


def run_intervals(
    scales: Scales, motion: Motion, durations: Array, velocities: Array
) -> tuple[Motion, Totals, StickRecord, Motion]:
    """Simulate all intervals of one realisation.

    Returns the final state, the totals, one `StickRecord` an interval, and the state at the beginning of each.
    """

    def step(carry, interval):
        motion, totals = carry
        following, record, duration = cross_interval(scales, motion, *interval)
        return (following, add_stick(totals, record, duration)), (record, motion)

    start = (motion, start_totals(motion.x.dtype))
    (motion, totals), (records, beginnings) = lax.scan(step, start, (durations, velocities))
    return motion, totals, records, beginnings


def status_of(motion: Motion, t1: FloatArray) -> IntArray:
    """The `Status` of a trajectory that ended in the state `motion`."""
    finite = jnp.isfinite(motion.t) & jnp.isfinite(motion.x) & jnp.isfinite(motion.p)
    code = jnp.where(motion.t < t1, Status.BASE_TOO_SHORT, Status.FINISHED)
    return jnp.where(finite, code, Status.NOT_FINITE).astype(jnp.int8)
