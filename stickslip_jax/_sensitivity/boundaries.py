"""Signed distances to the boundaries at which sticks appear and vanish, and the kernels that weigh them."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, PyTree

from .._dynamics.interval.arcs import Scales, carry_across, excess_of, touch
from .._dynamics.interval.crossing import MassState, cross_interval
from .._dynamics.sticks import StickRecord, Totals
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._foundation.types import BoolArray, DType, Ending, FloatArray, IntArray
from .._numerics.elementary import angle_of

# Signed distances to the boundaries at which sticks, or slips between two sticks, appear and vanish.
#
# A boundary is the set of samples in which a stick has zero length: a small change of a parameter makes it last for
# some time, or leaves none. The signed distance of a sample is positive while the stick exists, and zero on the
# boundary. Here the distances are found for a base of piecewise-constant velocity, from the closed forms: at most one
# stick begins in each interval, when the mass arrives at the base velocity q inside the stick band.
# `step_boundaries.py` does the same for any system.


class SignedDistance(NamedTuple):
    """Positive while a stick or slip exists, 0 on the boundary; `is_active`: whether its existence depends on it."""

    value: FloatArray
    is_active: BoolArray


class BoundaryDistances(NamedTuple):
    """The signed distances of one interval or step.

    - `time`: when the stick or slip begins, or would begin, s. `exists`: whether there is one. `is_slip`: whether it is
      a slip between two sticks, and not a stick.
    - Known on both sides of the boundary: `grazing`, how far an arc goes beyond the base velocity, or the friction that
      a stick needs beyond what it can hold; `switch`, time from the arrival to the next change of the base motion, s;
      `horizon`, time from it to `t1`, s; `crossing`, how far friction is from being unable to hold an arrival.
    - Known only while positive: `crossing_held`, how far an arrival that is held is from the edge of the stick band.

    Each engine gives one of `crossing` and `crossing_held`; the other is None.
    """

    time: FloatArray
    exists: BoolArray
    is_slip: BoolArray
    grazing: SignedDistance
    switch: SignedDistance
    horizon: SignedDistance
    crossing: SignedDistance | None = None
    crossing_held: SignedDistance | None = None

    @property
    def two_sided(self) -> tuple[SignedDistance, ...]:
        """All distances that are known on both sides of the boundary."""
        known = (self.grazing, self.switch, self.horizon, self.crossing)
        return tuple(distance for distance in known if distance is not None)

    @property
    def one_sided(self) -> tuple[SignedDistance, ...]:
        """All distances that are known only while positive."""
        return () if self.crossing_held is None else (self.crossing_held,)

    @property
    def any_active(self) -> BoolArray:
        """Whether any distance is active."""
        found = jnp.zeros_like(self.exists)
        for distance in self.two_sided + self.one_sided:
            found = found | distance.is_active
        return found

    def only(self, where: BoolArray, switch_where: BoolArray) -> "BoundaryDistances":
        """The same distances, active only `where` that is true; that to the switch only `switch_where` is."""
        limited = {
            name: distance._replace(is_active=distance.is_active & (switch_where if name == "switch" else where))
            for name, distance in self._asdict().items()
            if isinstance(distance, SignedDistance)
        }
        return self._replace(**limited)

    def after(self, deterministic_until: FloatArray, where: BoolArray) -> "BoundaryDistances":
        """The same distances, active only `where` that is true and they have a density.

        Before anything random happens (`deterministic_until`, s) none has, except that to the base's first change.
        """
        return self.only(where & (self.time >= deterministic_until), where)


class IntervalLane(NamedTuple):
    """One lane between two intervals; `memory`: the state of the base's law.

    `cut_velocity`: base velocity during the last interval if a switch of the base cut a stick short there, else 0, m/s.
    """

    memory: PyTree
    motion: MassState
    totals: Totals
    cut_velocity: FloatArray


def cross_with_distances(
    law: PiecewiseConstantLaw, scales: Scales, lane: IntervalLane, drawn: PyTree
) -> tuple[IntervalLane, StickRecord, BoundaryDistances, FloatArray]:
    """Cross the next interval: the lane after it, its stick, its signed distances, its length (s)."""
    memory, motion, totals, cut_velocity = lane
    duration, velocity, memory = law.next_interval(memory, drawn, motion.t.dtype)
    duration = jnp.where(duration >= scales.t1, scales.t1, duration)  # no infinity enters the arithmetic
    moved, totals, stick, _ = cross_interval(scales, motion, totals, duration, velocity)
    cut = jnp.where(stick.ending == Ending.BASE_SWITCHED, velocity, 0)
    stuck, moving = stick.ending >= 0, velocity != 0
    arc = _first_arc(scales, motion, cut_velocity, duration, velocity)
    # When the mass would have arrived, crossings included, had the interval lasted a little longer: the distance to the
    # switch is then known also where the switch came first. One revolution more, or the horizon again where the spring
    # is softer, is beyond the width of any kernel.
    more = 2 * np.pi * scales.spring.inverse_omega
    more = jnp.where(scales.spring.omega * scales.t1 > 2 * np.pi, more, lax.stop_gradient(scales.t1))
    span = jnp.minimum(motion.t + duration, scales.t1) - motion.t + more
    longer = carry_across(motion.x, motion.v, velocity, scales, span, motion.t)
    arrival = jnp.where(stuck, stick.start - motion.t, longer.entered)
    end, to_switch, to_horizon = motion.t + duration, duration - arrival, scales.t1 - (motion.t + arrival)
    # An arc from below ends in a stick that lasts, or grazes. Only one from above, or from a crossing, may arrive at
    # the edge of the band where sticks are released: a little beyond it the mass crosses, and the stick is gone.
    may_cross = stuck & moving & ~arc.sticks_from_below
    to_edge = scales.deceleration - scales.spring.squared * jnp.sign(velocity) * stick.position
    # A missed arrival counts for the end that came first; if both came before it, a small change brings no stick.
    misses = longer.stuck & ~stuck & (motion.t < scales.t1)
    # (A stick of no length is missed too, with the distance 0 but for round-off.)
    after_switch = misses & (to_switch < to_horizon) & (to_horizon > 0)
    after_horizon = misses & (to_horizon < to_switch) & (to_switch > 0)
    missed = jnp.where(after_switch, end, jnp.where(after_horizon, scales.t1, motion.t + arc.top))
    distances = BoundaryDistances(
        time=jnp.where(stuck, stick.start, missed),
        exists=stuck,
        is_slip=jnp.zeros_like(stuck),
        grazing=SignedDistance(arc.excess, arc.has_top),
        switch=SignedDistance(to_switch, stuck | after_switch),
        horizon=SignedDistance(to_horizon, stuck | after_horizon),
        crossing_held=SignedDistance(to_edge, may_cross),
    )
    return IntervalLane(memory, moved, totals, cut), stick, distances, duration


class _MovingArc(NamedTuple):
    """The first arc of an interval on a moving base."""

    excess: FloatArray  # R^2 - w2 q^2 in (m/s^2)^2 (`_dynamics/interval/arcs.py`); where positive it reaches q
    top: FloatArray  # when it comes nearest to q, s from its beginning
    is_below: BoolArray
    has_top: BoolArray  # whether the interval holds its top: a change of the excess's sign then adds or removes a stick
    sticks_from_below: BoolArray  # whether it meets q inside the band from below, if the interval lasts long enough


def _first_arc(
    scales: Scales, motion: MassState, cut_velocity: FloatArray, duration: FloatArray, velocity: FloatArray
) -> _MovingArc:
    forward = jnp.where(velocity < 0, -1, 1)
    v, q, alpha, spring = forward * motion.v, jnp.abs(velocity), scales.deceleration, scales.spring
    A = spring.squared * (forward * motion.x) - alpha
    is_below = v < q
    excess = excess_of(A + jnp.where(is_below, 0, 2 * alpha), v, q, spring)  # the centre of an arc from above is -alpha
    # Clockwise from (A, omega v) to the top, (0, R). It decides whether the interval holds the top; no derivative needs
    # it. Without a spring there is no top: the velocity grows until it is q.
    back, up = lax.stop_gradient(A), spring.omega * lax.stop_gradient(v)
    angle = angle_of(jnp.abs(back), up)
    top = jnp.where(back <= 0, angle, 2 * np.pi - angle) * spring.inverse_omega
    # After a stick cut short by a reversal of the base, R >= q always (the excess is a square): no stick can appear.
    is_reversed = cut_velocity == -velocity
    # Back on the circle on which it left a stick, R = q for all parameters: the sign of the excess is round-off there.
    not_tangent = (jnp.abs(excess) > touch(A, spring.omega * q, scales)) & (spring.squared > 0)
    has_top = (q > 0) & is_below & ~is_reversed & not_tangent & (top < duration) & (motion.t + top < scales.t1)
    return _MovingArc(excess, top, is_below, has_top, is_below & (excess > 0) & (excess <= (2 * alpha) ** 2))


def relative_excess(scales: Scales, motion: MassState, velocity: Array) -> Array:
    """``R^2 - w2 q^2`` of the first arc on a base of this velocity, relative to its terms; 1 for an arc from above."""
    nothing = jnp.zeros_like(motion.x)
    arc = _first_arc(scales, motion, nothing, jnp.full_like(nothing, jnp.inf), velocity)
    size = scales.spring.squared * velocity * velocity + scales.deceleration**2
    return jnp.where(arc.is_below & (velocity != 0), arc.excess / lax.stop_gradient(size), 1)


# Kernel weights that turn sticks about to appear or vanish into derivatives of expectations.
#
# Let the signed distance ``g`` be positive while a stick exists and 0 where it vanishes, with density ``f(0)`` there.
# Sticks that appear and vanish add ``f(0) E[dg/dtheta | g = 0]`` times its jump to the derivative of the mean of a
# functional. A kernel ``K`` of width ``h`` estimates that as the mean of the sum of ``K(g / h) / h * dg/dtheta`` times
# the jump. With ``int K = 1`` and ``int u K = 0`` its bias is of order ``h^2`` (one-sided kernels: Jones 1993, "Simple
# boundary correction for kernel density estimation"; derivatives of expectations: Liu and Hong 2011, "Kernel estimation
# of the Greeks for options with discontinuous payoffs").


Kernel: TypeAlias = Callable[[FloatArray, FloatArray, BoolArray], FloatArray]
"""A function of distance, bandwidth and where the distance is active."""


def _kernel(slope: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]) -> Kernel:
    """Zero, whose derivative is ``slope(u, sign(d distance), bandwidth)`` where the distance is active and |u| < 1."""

    @jax.custom_jvp
    def zero(distance, bandwidth, where):
        return 0 * distance

    @zero.defjvp
    def _(primals, tangents):
        distance, bandwidth, where = primals
        change = jnp.abs(tangents[0])
        inside = where & (jnp.abs(distance) < bandwidth * change)
        u = distance / jnp.where(inside, bandwidth * change, 1)
        return 0 * distance, jnp.where(inside, slope(u, jnp.sign(tangents[0]), bandwidth), 0)

    return zero


two_sided_kernel = _kernel(lambda u, sign, bandwidth: sign * 0.75 * (1 - u * u) / bandwidth)
"""Zero, whose derivative estimates that of the expected count of positive `distance`, known on both sides of 0.

The kernel is as wide as `distance` moves, to first order, when the parameters move `bandwidth` times the direction of
differentiation: ``u = distance / (bandwidth |d distance|)``, and the derivative is ``sign(d distance) K(u) /
bandwidth`` with Epanechnikov's ``K(u) = 3/4 (1 - u^2)`` for -1 < u < 1. So every weight is bounded, distances that do
not move have none, and the result is, to first order, that of a central difference of this step. It is linear in the
direction only in expectation: use forward mode only.
"""

one_sided_kernel = _kernel(lambda u, sign, bandwidth: jnp.where(u > 0, sign * (4 - 6 * u) / bandwidth, 0))
"""Like `two_sided_kernel`, for a `distance` known only while positive, with ``K(u) = 4 - 6 u`` for 0 < u < 1."""

inside_window = _kernel(lambda u, sign, bandwidth: jnp.ones_like(u))
"""Zero, whose derivative is 1 inside the window of the other two: counts the distances that they rest on."""


def zero_with_derivative(weight: FloatArray, distance: FloatArray, where: BoolArray) -> FloatArray:
    """Zero, whose derivative is ``weight * d distance`` where `where` is true.

    Added to a count, it makes the count's derivative an unbiased estimate of that of its expectation, if `weight` is
    the density of `distance` at 0.
    """
    distance = jnp.where(where, distance, 0)
    return jnp.where(where, lax.stop_gradient(weight), 0) * (distance - lax.stop_gradient(distance))


class BoundarySums(NamedTuple):
    """Sums over boundaries for each window: zeros whose derivatives are event parts, or count distances inside it."""

    event_parts: tuple[FloatArray, ...]
    in_window: tuple[FloatArray, ...]

    @classmethod
    def none(cls, windows: int, dtype: DType) -> "BoundarySums":
        """The sums over no boundaries."""
        zeros = (jnp.zeros((), dtype),) * windows
        return cls(zeros, zeros)

    @classmethod
    def over(cls, distances: BoundaryDistances, bandwidths: FloatArray) -> "BoundarySums":
        """The sums over distances known on both sides of 0, and over those known only while positive."""
        pairs = [(distance, two_sided_kernel) for distance in distances.two_sided]
        pairs += [(distance, one_sided_kernel) for distance in distances.one_sided]
        return cls._weighed(pairs, bandwidths)

    @classmethod
    def over_vanishing(
        cls, start: FloatArray, duration: FloatArray, ending: IntArray, deterministic_until: FloatArray,
        bandwidths: FloatArray,
    ) -> "BoundarySums":  # fmt: skip
        """The sums over a stick of a record, if it begins at t = 0 and may vanish, as its duration falls to 0.

        `deterministic_until`: when the first random thing happens in the sample, s. A stick that ended before, but for
        the first change of the base itself, has the same duration in all samples; one that lasts until `t1` is not
        short.
        """
        is_random = (deterministic_until == 0) | (ending == Ending.BASE_SWITCHED)
        may_vanish = (ending >= 0) & (start == 0) & (ending != Ending.HORIZON) & is_random
        return cls._weighed([(SignedDistance(duration, may_vanish), one_sided_kernel)], bandwidths)

    @classmethod
    def _weighed(cls, distances: list[tuple[SignedDistance, Kernel]], bandwidths: FloatArray) -> "BoundarySums":
        """The sums over distances by their kernels, and how many are inside the windows of these."""

        def of(bandwidth: FloatArray, counted: bool) -> FloatArray:
            kernels = [(inside_window if counted else kernel, *distance) for distance, kernel in distances]
            found = [kernel(value, bandwidth, is_active) for kernel, value, is_active in kernels]
            return sum(found[1:], found[0])

        # A Python loop: jax 0.10.2 cannot vmap over the windows where this is differentiated inside a loop.
        return cls(*(tuple(of(bandwidth, counted) for bandwidth in bandwidths) for counted in (False, True)))
