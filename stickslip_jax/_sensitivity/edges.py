"""Signed margins of existence: how close a motion is to gaining or losing a stick, or a slip between two sticks.

A margin is positive while the stick or slip exists and passes zero where its length is zero. Here the margins are found
for a base of piecewise-constant velocity, from the closed forms: at most one stick begins in each interval, when the
mass arrives at the base velocity q inside the stick band. `step_edges.py` does the same for any system.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from .._dynamics.interval.arcs import carry_across
from .._dynamics.interval.engine import Motion, Scales, cross_interval
from .._events.sticks import StickRecord, Totals
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._numerics.elementary import angle_of
from .._status import Ending
from .._types import Array, BoolArray, FloatArray

_TOUCH_ULPS = {8: 4096, 4: 64}  # R and q closer than so many units in the last place count as equal


class Number(NamedTuple):
    """Signed margin, positive while a stick or slip exists; `decides`: whether that depends on it here."""

    value: FloatArray
    decides: BoolArray


class Edges(NamedTuple):
    """The margins of one interval or step.

    - `time`: when the stick or slip begins, or would begin, s. `exists`: whether there is one. `is_slip`: whether it is
      a slip between two sticks, and not a stick.
    - Known on both sides of 0: `grazing`, how far an arc goes beyond the base velocity, or the friction that a stick
      needs beyond what it can hold; `race`, time from the arrival to the next change of the base motion, s; `horizon`,
      time to `t1`, s; `crossing`, how far friction is from being unable to hold an arrival.
    - Known only while positive: `leaving`, how far an arrival in the band is from the edge where it would cross.

    Each engine gives one of `crossing` and `leaving`; the other is None.
    """

    time: FloatArray
    exists: BoolArray
    is_slip: BoolArray
    grazing: Number
    race: Number
    horizon: Number
    crossing: Number | None = None
    leaving: Number | None = None

    @property
    def both_sides(self) -> tuple[Number, ...]:
        """All margins that are known on both sides of 0."""
        known = (self.grazing, self.race, self.horizon, self.crossing)
        return tuple(number for number in known if number is not None)

    @property
    def one_side(self) -> tuple[Number, ...]:
        """All margins that are known only while positive."""
        return () if self.leaving is None else (self.leaving,)

    @property
    def any(self) -> BoolArray:
        """Whether any margin decides here."""
        found = jnp.zeros_like(self.exists)
        for number in self.both_sides + self.one_side:
            found = found | number.decides
        return found

    def only(self, where: BoolArray, races: BoolArray) -> "Edges":
        """The same margins, deciding only `where` that is true; the race only where `races` is."""
        limited = {
            name: number._replace(decides=number.decides & (races if name == "race" else where))
            for name, number in self._asdict().items()
            if isinstance(number, Number)
        }
        return self._replace(**limited)


class IntervalLane(NamedTuple):
    """One lane between two intervals.

    `cut_velocity`: base velocity during the last interval if a switch of the base cut a stick short there, else 0, m/s.
    """

    memory: Any
    motion: Motion
    totals: Totals
    cut_velocity: FloatArray


def cross_with_edges(
    law: PiecewiseConstantLaw, scales: Scales, lane: IntervalLane, drawn: Any
) -> tuple[IntervalLane, StickRecord, Edges, FloatArray]:
    """Cross the next interval: the lane after it, its stick, its margins, its length (s)."""
    memory, motion, totals, cut_velocity = lane
    duration, velocity, memory = law.next_interval(memory, drawn, motion.t.dtype)
    duration = jnp.where(duration >= scales.t1, scales.t1, duration)  # no infinity enters the arithmetic
    moved, totals, stick = cross_interval(scales, motion, totals, duration, velocity)
    edges = _edges(scales, motion, cut_velocity, stick, duration, velocity)
    cut = jnp.where(stick.ending == Ending.BASE_SWITCHED, velocity, 0)
    return IntervalLane(memory, moved, totals, cut), stick, edges, duration


def _edges(
    scales: Scales,
    motion: Motion,
    cut_velocity: FloatArray,
    stick: StickRecord,
    duration: FloatArray,
    velocity: FloatArray,
) -> Edges:
    """The margins of one interval."""
    stuck, moving = stick.ending >= 0, velocity != 0
    arc = _first_arc(scales, motion, cut_velocity, duration, velocity)
    speed = jnp.abs(jnp.where(moving, velocity, 1))
    # When the mass would have arrived, crossings included, had the interval lasted a little longer.
    span = (jnp.minimum(motion.t + duration, scales.t1) - motion.t) * scales.omega + 2 * np.pi
    longer = carry_across(motion.x, motion.p, velocity * scales.inverse_omega, scales.half_width, span)
    arrival = jnp.where(stuck, stick.start - motion.t, longer.entered * scales.inverse_omega)
    end, spare, left = motion.t + duration, duration - arrival, scales.t1 - (motion.t + arrival)
    # An arc from below ends in a stick that lasts, or grazes; one from above may arrive at the release edge, where
    # it crosses.
    leaves = stuck & moving & ~(arc.is_below & arc.would_stick)
    to_edge = (scales.half_width - jnp.sign(velocity) * stick.position) / speed
    misses = longer.stuck & ~stuck & (motion.t < scales.t1)
    is_late, is_beyond = misses & (spare <= 0) & (left > 0), misses & (left <= 0) & (spare > 0)
    missed = jnp.where(is_late, end, jnp.where(is_beyond, scales.t1, motion.t + arc.top))
    return Edges(
        time=jnp.where(stuck, stick.start, missed),
        exists=stuck,
        is_slip=jnp.zeros_like(stuck),
        grazing=Number(arc.excess, arc.meets),
        race=Number(spare, stuck | is_late),
        horizon=Number(left, stuck | is_beyond),
        leaving=Number(to_edge, leaves),
    )


class _Arc(NamedTuple):
    """The first arc of an interval on a moving base."""

    excess: FloatArray  # R^2 - q^2 in (m/s)^2, R the arc's radius; where positive the arc reaches the base velocity q
    top: FloatArray  # when it comes nearest to q, s from its beginning
    is_below: BoolArray
    meets: BoolArray  # whether the interval holds its top: a change of the excess's sign then adds or removes a stick
    would_stick: BoolArray  # whether it meets the base velocity inside the band, if the interval lasts long enough


def _first_arc(
    scales: Scales, motion: Motion, cut_velocity: FloatArray, duration: FloatArray, velocity: FloatArray
) -> _Arc:
    forward = jnp.where(velocity < 0, -1, 1)
    p, q = forward * motion.p * scales.omega, jnp.abs(velocity)
    D = (forward * motion.x - scales.half_width) * scales.omega
    is_below = p < q
    center = jnp.where(is_below, 0, 2 * scales.half_width * scales.omega)  # from +a to the arc's
    offset = D + center
    excess = offset * offset + (p - q) * (p + q)
    # Clockwise from (D, p) to the top, (0, R).
    back, up = lax.stop_gradient(D), lax.stop_gradient(p)
    angle = angle_of(jnp.abs(back), up)
    top = jnp.where(back <= 0, angle, 2 * np.pi - angle) * scales.inverse_omega
    # After a stick cut short by a reversal of the base, R >= q always (the excess is a square): no stick can appear.
    is_reversed = cut_velocity == -velocity
    # Back on the circle on which it left a stick, R = q for all parameters: see `_dynamics/interval/arcs.py`.
    roundoff = _TOUCH_ULPS[p.dtype.itemsize] * jnp.finfo(p.dtype).eps * (D * D + q * q)
    meets = (q > 0) & is_below & ~is_reversed & (jnp.abs(excess) > roundoff)
    meets = meets & (top < duration) & (motion.t + top < scales.t1)
    inside = (excess > 0) & (excess <= (2 * scales.half_width * scales.omega) ** 2)
    return _Arc(excess, top, is_below, meets, inside)


def relative_excess(scales: Scales, motion: Motion, velocity: Array) -> Array:
    """``R^2 - q^2`` of the first arc on a base of this velocity, relative to its terms; 1 for an arc from above."""
    nothing = jnp.zeros_like(motion.x)
    arc = _first_arc(scales, motion, nothing, jnp.full_like(nothing, jnp.inf), velocity)
    size = velocity * velocity + (scales.half_width * scales.omega) ** 2
    return jnp.where(arc.is_below & (velocity != 0), arc.excess / lax.stop_gradient(size), 1)
