"""One interval of the base: the mass crosses it in closed form; what decided about events there; the largest
position and velocity in it.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from ..._foundation.types import BoolArray, FloatArray, IntArray, Scalar, Status
from ..._systems.mass_spring import MassSpring
from ..sticks import Remembered, StickRecord, StickSpan, Totals, begin_quantities, ending_of, recorded, start_totals
from .arcs import (
    CLOCK_ULPS,
    Scales,
    carry_across,
    few,
    first_arc,
    is_crossed,
    mirrored,
    quotient,
    swung,
    time_of_arc,
    touch,
)

# Exact motion on a base of piecewise-constant velocity: a closed form for each interval, in a scan over intervals.
#
# One trajectory per call; the caller makes batches with ``jax.vmap``. Time is in seconds, so that switching instants
# are exact sums of durations.


class MassState(NamedTuple):
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


def start_motion(scales: Scales, y0: tuple[Scalar, Scalar], quantities: tuple[str, ...] = ()) -> MassState:
    """The initial state ``y0 = (position, velocity)``.

    `quantities` of each stick: those that are asked for.
    """
    dtype = scales.t1.dtype
    x, v = jnp.asarray(y0[0], dtype), jnp.asarray(y0[1], dtype)
    return MassState(jnp.zeros((), dtype), x, v, begin_quantities(x, quantities))


def cross_interval(
    scales: Scales, motion: MassState, totals: Totals, duration: FloatArray, velocity: FloatArray
) -> tuple[MassState, Totals, StickRecord, BoolArray]:
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
    stick, ending = StickSpan(start, end, passage.position, passage.left_at), ending_of(stuck, released, ~uncut)
    # Not end - start, whose round-off grows with the time since t = 0.
    duration = passage.left - passage.entered
    record, remembered, totals = recorded(motion.remembered, totals, stuck, stick, ending, ~released & ~uncut, duration)
    return MassState(t_end, passage.x, passage.v, remembered), totals, record, passage.tie


def cross_live_interval(
    scales: Scales, motion: MassState, totals: Totals, duration: FloatArray, velocity: FloatArray
) -> tuple[MassState, Totals, StickRecord, BoolArray]:
    """`cross_interval`, which after the horizon leaves everything as it is, to the last bit."""
    live = ~(motion.t >= scales.t1)
    following, totals, record, tie = cross_interval(scales, motion, totals, duration, velocity)
    return jax.tree.map(lambda new, old: jnp.where(live, new, old), following, motion), totals, record, tie & live


def run_intervals(
    scales: Scales, motion: MassState, durations: Array, velocities: Array
) -> tuple[MassState, Totals, StickRecord, MassState, BoolArray]:
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


def status_of(motion: MassState, t1: FloatArray) -> IntArray:
    """The `Status` of a trajectory that ended in the state `motion`."""
    finite = jnp.isfinite(motion.t + t1) & jnp.isfinite(motion.x) & jnp.isfinite(motion.v)
    code = jnp.where(motion.t < t1, Status.BASE_TOO_SHORT, Status.FINISHED)
    # Only a duration that is NaN makes the time NaN: that of an interval that cannot be.
    failed = jnp.where(jnp.isnan(motion.t) & jnp.isfinite(t1), Status.BASE_INVALID, Status.NOT_FINITE)
    return jnp.where(finite, code, failed).astype(jnp.int8)


# Whether round-off decided about an event in an interval of the base (`near_grazing_count`).
#
# Found from the state in which the interval began, beside the motion. With H, the distance from the centre at which an
# arc meets the base velocity, the last digits decide
#
# - on an arc that is nearly tangent to the base velocity, whether it meets it;
# - at ``H = 2 alpha``, whether friction holds the mass, and at ``H = 0`` whether it does so for more than an instant;
# - where an arrival or a release falls on the end of the interval, whether there is one. A stick between the two would
#   have no length: it is none (`IntervalPassage.tie`, which ensembles count too);
# - where an arrival falls on its beginning, whether there was a slip before.


LAST_LEFT = "slip_displacement"  # the quantity of a stick that remembers where the last one ended


def is_tie(scales: Scales, began: MassState, duration: FloatArray, velocity: FloatArray) -> BoolArray:
    """Whether round-off decided about an event in the interval of the base that began so. No derivative."""
    scales, began, duration, velocity = lax.stop_gradient((scales, began, duration, velocity))
    alpha, t1, omega, w2 = scales.deceleration, scales.t1, scales.spring.omega, scales.spring.squared
    span = jnp.where(began.t + duration >= t1, t1 - began.t, duration)
    # The first arc, in accelerations (`arcs.py`): its velocity v and the base speed q are times omega.
    _, x, v, speed, q, span = mirrored(began.x, began.v, velocity, scales, span)
    side, A, v, excess, first_H, first_time, _, _, _ = first_arc(x, v, speed, q, scales, span)
    meets = excess > jnp.where(v < speed, touch(A, q, scales), 0)
    A, begins = jnp.abs(A), v == speed
    # The errors of positions times w2, of velocities (m/s), and of H.
    of_v = few(x) * (jnp.abs(v) + speed + (A + alpha) * scales.clock)
    v = omega * v
    size = A + jnp.abs(v) + q + alpha
    of_x, of_state = few(x) * (A + 2 * alpha), few(x) * size
    # H^2 = A^2 + v^2 - q^2 has the error of its terms; a mass that has the base's velocity exactly meets it at H = A.
    of_H = jnp.where(begins, of_x, of_state * size / jnp.where(meets, first_H, 1))

    # Ties of the first arc: of the place where the mass begins on the base, of tangency, of the edge of the band. After
    # a release at this velocity the arc is tangent to it in exact numbers, which the threshold knows.
    threshold, left_at = touch(A, q, scales), w2 * jnp.abs(began.remembered[LAST_LEFT])
    released = (jnp.abs(left_at - alpha) <= few(alpha) * alpha) & (began.t > 0)
    returns = released & (jnp.abs(excess) <= threshold)
    tangent = (v < q) & (jnp.abs(excess) <= 2 * threshold) & ~returns
    at_edge = meets & (jnp.abs(first_H - 2 * alpha) <= of_H)
    at_first = ((first_time < span) & (tangent | at_edge)) | (begins & (of_x >= A))

    # The first meeting with the base velocity that friction can hold or that lies after the interval, at the distance H
    # from the centre; all before it are crossings.
    def crosses(state):
        _, H, arrival = state
        return is_crossed(H, alpha) & (arrival < span)

    def cross(state):
        side, H, arrival = state
        return -side, H - 2 * alpha, arrival + time_of_arc(H - 2 * alpha, -side, q, scales.spring)

    state = side, jnp.where(meets, first_H, 0), first_time
    state = jax.tree.map(lambda new, old: jnp.where(crosses(state), new, old), cross(state), state)
    side, H, arrival = lax.while_loop(crosses, cross, state)

    # Ties after crossings, and of arrivals and releases with the ends of the interval.
    arrived, crossed = meets & (arrival < span), meets & (first_H > H)
    holds = crossed & ((arrived & (jnp.abs(H - 2 * alpha) <= of_H)) | (of_H >= H))
    # The relative velocity changes at the rate H where it passes zero: times H, times are velocities.
    eps, rate = float(jnp.finfo(H.dtype).eps), w2 * speed
    when = of_v + H * (few(H) * span + CLOCK_ULPS * eps * began.t)
    at_end = meets & (2 * alpha + of_H >= H) & (jnp.abs(arrival - span) * H <= when)
    at_start = arrived & ~crossed & ~begins & (arrival * H <= of_v)
    beyond = side * (alpha - H) + rate * (span - arrival) - alpha
    at_release = arrived & (rate > 0) & (jnp.abs(beyond) * H <= (of_H + of_x) * H + rate * when)
    has_events = (span > 0) & (alpha > 0)  # without friction there is none
    return has_events & (at_first | (holds | at_end | at_start | at_release))


def starts_at_edge(scales: Scales, start: MassState, velocity: FloatArray) -> BoolArray:
    """Whether a trajectory starts with its base's `velocity` at an edge of the stick band: one of the ties of `is_tie`,
    which alone costs nearly nothing.
    """
    pull, alpha = scales.spring.squared * jnp.abs(start.x), scales.deceleration
    return (jnp.abs(pull - alpha) <= few(pull) * (pull + alpha)) & (start.v == velocity) & (alpha > 0)


# Largest position and velocity while the base velocity is constant, in closed form.
#
# Every slip is an arc of a circle (`arcs.py`): its position is extreme where the velocity is zero, and its velocity
# where the mass passes the centre. Where arcs cross the base velocity one after the other, each has a smaller radius
# than the one before: only the first on each side can hold an extreme that is not at the beginning of an interval.


def largest_in_interval(
    scales: Scales, motion: MassState, duration: FloatArray, velocity: FloatArray, *, of_velocity: bool, sign: Scalar
) -> FloatArray:
    """The largest value of `sign` times the position (m), or the velocity (m/s), in an interval.

    It begins with `motion`; its end is not included. Base `velocity` in m/s.
    """
    left = scales.t1 - motion.t
    span = jnp.clip(jnp.where(duration < left, duration, left), 0)
    mirror, x, v, q, turned, span = mirrored(motion.x, motion.v, velocity, scales, span)
    passage = carry_across(x, v, q, scales, span, motion.t)
    upwards = sign * mirror
    start, stick = (v, q) if of_velocity else (x, passage.position)
    # A stick moves at the base's velocity, from where it begins.
    found = [upwards * start, jnp.where(passage.stuck, upwards * stick, upwards * start)]
    # Arcs: whether each exists, its position, velocity and deceleration at its beginning, and how long it lasts. The
    # first one of the interval, the first two after crossings of the base velocity, and the one after a stick.
    alpha, spring = scales.deceleration, scales.spring
    first = first_arc(x, v, q, turned, scales, span)
    begun = jnp.where(first.arrives, first.time, span)
    arcs = [(jnp.ones((), bool), x, first.v, first.side * first.A, begun)]
    crosses, side, H = first.arrives & is_crossed(first.H, alpha), first.side, first.H
    for _ in range(2):
        side, H = -side, jnp.where(crosses, H - 2 * alpha, 1)
        time = time_of_arc(H, side, turned, spring)
        arrives = begun + time < span
        time = jnp.where(arrives, time, span - begun)
        arcs.append((crosses, side * quotient(alpha + H, crosses, spring), q, side * H, time))
        crosses, begun = crosses & arrives & is_crossed(H, alpha), begun + time
    arcs.append((passage.released, passage.left_at, q, jnp.zeros_like(q), span - passage.left))
    for exists, x, v, A, time in arcs:
        # Clockwise from its beginning to the largest value, or half a turn further to the smallest. By the signs of the
        # components, for on a soft spring the angle is too small to be added to another. No derivative passes through
        # when that is: there the value does not change with time.
        across, along = (-A, spring.omega * v) if of_velocity else (spring.omega * v, A)
        ahead = jnp.arctan2(*lax.stop_gradient((upwards * across, upwards * along)))
        when = jnp.mod(ahead, 2 * jnp.pi) * spring.inverse_omega
        reached = exists & ((A != 0) | (v != 0)) & (when <= time)
        position, velocity = swung(x, v, A, jnp.where(reached, when, 0), spring)
        found.append(jnp.where(reached, upwards * (velocity if of_velocity else position), upwards * start))
    return jnp.max(jnp.stack(found))
