"""Exact motion on a base of piecewise-constant velocity: a closed form for each interval, in a scan over intervals.

One trajectory per call; the caller makes batches with ``jax.vmap``. Time is in seconds, so that switching instants are
exact sums of durations.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ..._events.stick_quantities import Remembered, StickSpan, begin_quantities, measured
from ..._events.sticks import StickRecord, Totals, ending_of, start_totals, with_stick
from ..._status import Status
from ..._systems.mass_spring import MassSpring
from ..._types import Array, BoolArray, FloatArray, IntArray, Scalar
from .arcs import Scales, carry_across, sticks_from_start


class Motion(NamedTuple):
    """The state of the mass: time `t` in s, position `x` in m, velocity `v` in m/s.

    `remembered`: by the quantities of each stick that are asked for.
    """

    t: FloatArray
    x: FloatArray
    v: FloatArray
    remembered: Remembered


def scales_of(system: MassSpring, t1: Scalar, dtype) -> Scales:
    """The system's scales as arrays of `dtype`."""
    mass, held = jnp.asarray(system.mass, dtype), jnp.asarray(system.friction.static * system.normal_force, dtype)
    # An infinite mass would rest on every base: 0 * infinity makes its state NaN (`NOT_FINITE`).
    return Scales.of(jnp.asarray(system.stiffness, dtype) / mass, held / mass + 0 * mass, jnp.asarray(t1, dtype))


def start_motion(scales: Scales, y0: tuple[Scalar, Scalar], quantities: tuple[str, ...] = ()) -> Motion:
    """The initial state ``y0 = (position, velocity)``.

    `quantities` of each stick: those that are asked for.
    """
    dtype = scales.t1.dtype
    x, v = jnp.asarray(y0[0], dtype), jnp.asarray(y0[1], dtype)
    return Motion(jnp.zeros((), dtype), x, v, begin_quantities(x, quantities))


def sticks_at_start(scales: Scales, motion: Motion, velocity: FloatArray) -> BoolArray:
    """Whether the trajectory begins with a stick, and so without a slip before it, at the first base `velocity`."""
    return sticks_from_start(motion.x, motion.v, velocity, scales)


def cross_interval(
    scales: Scales, motion: Motion, totals: Totals, duration: FloatArray, velocity: FloatArray
) -> tuple[Motion, Totals, StickRecord, BoolArray]:
    """Cross one interval, cut at the horizon; returns the next state, the totals with its stick, its record, and
    whether the mass met the base for no time.
    """
    t1 = scales.t1
    uncut = ~(motion.t + duration >= t1)  # a NaN duration is not cut: the time becomes NaN (`NOT_FINITE`)
    span = jnp.where(uncut, duration, t1 - motion.t)
    passage = carry_across(motion.x, motion.v, velocity, scales, span, motion.t)
    t_end = jnp.where(uncut, motion.t + duration, t1)
    stuck, released = passage.stuck, passage.released
    start = motion.t + passage.entered
    # A stick ends where the spring reaches the friction limit, or with the interval.
    end = jnp.where(released, motion.t + passage.left, t_end)
    span_of_stick = StickSpan(start, end, passage.position, passage.left_at)
    quantities, remembered = measured(motion.remembered, stuck, span_of_stick)
    record = StickRecord(start, end, passage.position, quantities, ending_of(stuck, released, ~uncut))
    # Not end - start, whose round-off grows with the time since t = 0.
    totals = with_stick(totals, stuck, ~released & ~uncut, passage.left - passage.entered)
    return Motion(t_end, passage.x, passage.v, remembered), totals, record, passage.tie


def cross_live_interval(
    scales: Scales, motion: Motion, totals: Totals, duration: FloatArray, velocity: FloatArray
) -> tuple[Motion, Totals, StickRecord, BoolArray]:
    """`cross_interval`, which after the horizon leaves everything as it is, to the last bit."""
    live = ~(motion.t >= scales.t1)
    following, totals, record, tie = cross_interval(scales, motion, totals, duration, velocity)
    return jax.tree.map(lambda new, old: jnp.where(live, new, old), following, motion), totals, record, tie & live


def run_intervals(
    scales: Scales, motion: Motion, durations: Array, velocities: Array
) -> tuple[Motion, Totals, StickRecord, Motion, BoolArray]:
    """Simulate all intervals of one realisation.

    Returns the final state, the totals, and of each interval a `StickRecord`, the state at its beginning, and whether
    the mass met the base for no time.
    """

    @partial(jax.checkpoint, prevent_cse=False)  # computing an interval again takes less time than storing its values
    def step(carry, interval):
        *following, record, tie = cross_live_interval(scales, *carry, *interval)
        return tuple(following), (record, carry[0], tie)

    start = (motion, start_totals(motion.x.dtype))
    (motion, totals), of_each = lax.scan(step, start, (durations, velocities))
    return motion, totals, *of_each


def status_of(motion: Motion, t1: FloatArray) -> IntArray:
    """The `Status` of a trajectory that ended in the state `motion`."""
    finite = jnp.isfinite(motion.t + t1) & jnp.isfinite(motion.x) & jnp.isfinite(motion.v)
    code = jnp.where(motion.t < t1, Status.BASE_TOO_SHORT, Status.FINISHED)
    # Only a duration that is NaN makes the time NaN: that of an interval that cannot be.
    failed = jnp.where(jnp.isnan(motion.t) & jnp.isfinite(t1), Status.BASE_INVALID, Status.NOT_FINITE)
    return jnp.where(finite, code, failed).astype(jnp.int8)
