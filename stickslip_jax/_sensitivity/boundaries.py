"""Signed distances to the boundaries at which sticks appear and vanish, and the kernels that weigh them."""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, PyTree

from .._compiler.native import sharing
from .._dynamics.common.path import StepsShared, following_segments
from .._dynamics.interval.arcs import MassState, Scales, carry_across, cross_interval, excess_of, start_motion, touch
from .._dynamics.interval.engine import IntervalEngine
from .._dynamics.sticks import StickRecord, Totals
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._excitation.segments import SegmentState
from .._foundation.types import BoolArray, DType, Ending, FloatArray, IntArray
from .._numerics.derivatives import without_derivatives
from .._numerics.elementary import angle_of
from .._numerics.steps import steepest_fall
from .._systems.contacts_model import ContactsModel
from .._systems.switched_model import Forcing, OneContactModel, Segments, State

# Signed distances to the boundaries at which sticks, or slips between two sticks, appear and vanish.
#
# A boundary is the set of samples in which a stick has zero length: a small change of a parameter makes it last for
# some time, or leaves none. The signed distance of a sample is positive while the stick exists, and zero on the
# boundary. Here the distances are found for a base of piecewise-constant velocity, from the closed forms: at most one
# stick begins in each interval, when the mass arrives at the base velocity q inside the stick band. For any system
# they are found below, one time step at a time.


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

    @classmethod
    def only(cls, time: FloatArray, exists: BoolArray, is_slip: bool, **known: SignedDistance) -> "BoundaryDistances":
        """Those `known` by name; no other is active."""
        nothing = SignedDistance(jnp.zeros_like(time), jnp.zeros_like(exists))
        others = dict.fromkeys(("grazing", "switch", "horizon", "crossing"), nothing)
        return cls(lax.stop_gradient(time), exists, jnp.full_like(exists, is_slip), **(others | known))

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

    def after(self, deterministic_until: FloatArray, where: BoolArray) -> "BoundaryDistances":
        """The same distances, active only `where` that is true and they have a density: not before
        `deterministic_until` (s, `FirstSegment`), except that to a change of the excitation then.

        That to an earlier change counts where it is zero: windows then tell that there is no derivative.
        """
        is_random, digits = self.time >= deterministic_until, 4 * float(jnp.finfo(self.time.dtype).eps)
        change, off = self.time + jnp.maximum(self.switch.value, 0), jnp.abs(self.switch.value)
        may_switch = is_random | (change >= deterministic_until * (1 - digits)) | (off <= digits * change)
        limited = {
            name: distance._replace(
                is_active=distance.is_active & where & (may_switch if name == "switch" else is_random)
            )
            for name, distance in self._asdict().items()
            if isinstance(distance, SignedDistance)
        }
        return self._replace(**limited)


class FirstSegment(NamedTuple):
    """What is the same in all samples, or one of a few values, so that it has no density: the motion until the base's
    first segment ends, and when that is.
    """

    is_fixed: bool
    end_is_fixed: bool

    def deterministic_until(self, end: FloatArray) -> FloatArray:
        """From when on something has a density, s; just after the `end` of the segment if that has none itself."""
        if not self.is_fixed:
            return jnp.zeros_like(end)
        return end * (1 + 16 * float(jnp.finfo(end.dtype).eps)) if self.end_is_fixed else end


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
    (A, v, q), is_below, excess = _first_arc(scales, motion, velocity)
    # Clockwise from (A, omega v) to the top, (0, R), when the arc comes nearest to q. It decides whether the interval
    # holds the top; no derivative needs it. Without a spring there is no top: the velocity grows until it is q.
    spring = scales.spring
    back, up = lax.stop_gradient(A), spring.omega * lax.stop_gradient(v)
    angle = angle_of(jnp.abs(back), up)
    top = jnp.where(back <= 0, angle, 2 * np.pi - angle) * spring.inverse_omega
    # After a stick cut short by a reversal of the base, R >= q always (the excess is a square): no stick can appear.
    is_reversed = cut_velocity == -velocity
    # Back on the circle on which it left a stick, R = q for all parameters: the sign of the excess is round-off there.
    not_tangent = (jnp.abs(excess) > touch(A, spring.omega * q, scales)) & (spring.squared > 0)
    # If the interval holds the top, a change of the excess's sign adds or removes a stick.
    has_top = (q > 0) & is_below & ~is_reversed & not_tangent & (top < duration) & (motion.t + top < scales.t1)
    sticks_from_below = is_below & (excess > 0) & (excess <= (2 * scales.deceleration) ** 2)  # if there is time to
    # When the mass would have arrived, crossings included, had the interval lasted a little longer: the distance to the
    # switch is then known also where the switch came first. One revolution more, or the horizon again where the spring
    # is softer, is beyond the width of any kernel.
    more = 2 * np.pi * spring.inverse_omega
    more = jnp.where(spring.omega * scales.t1 > 2 * np.pi, more, lax.stop_gradient(scales.t1))
    span = jnp.minimum(motion.t + duration, scales.t1) - motion.t + more
    longer = carry_across(motion.x, motion.v, velocity, scales, span, motion.t)
    arrival = jnp.where(stuck, stick.start - motion.t, longer.entered)
    end, to_switch, to_horizon = motion.t + duration, duration - arrival, scales.t1 - (motion.t + arrival)
    # An arc from below ends in a stick that lasts, or grazes. Only one from above, or from a crossing, may arrive at
    # the edge of the band where sticks are released: a little beyond it the mass crosses, and the stick is gone.
    may_cross = stuck & moving & ~sticks_from_below
    to_edge = scales.deceleration - spring.squared * jnp.sign(velocity) * stick.position
    # A missed arrival counts for the end that came first; if both came before it, a small change brings no stick.
    misses = longer.stuck & ~stuck & (motion.t < scales.t1)
    # (A stick of no length is missed too, with the distance 0 but for round-off.)
    after_switch = misses & (to_switch < to_horizon) & (to_horizon > 0)
    after_horizon = misses & (to_horizon < to_switch) & (to_switch > 0)
    missed = jnp.where(after_switch, end, jnp.where(after_horizon, scales.t1, motion.t + top))
    distances = BoundaryDistances(
        time=jnp.where(stuck, stick.start, missed),
        exists=stuck,
        is_slip=jnp.zeros_like(stuck),
        grazing=SignedDistance(excess, has_top),
        switch=SignedDistance(to_switch, stuck | after_switch),
        horizon=SignedDistance(to_horizon, stuck | after_horizon),
        crossing_held=SignedDistance(to_edge, may_cross),
    )
    return IntervalLane(memory, moved, totals, cut), stick, distances, duration


def _first_arc(
    scales: Scales, motion: MassState, velocity: FloatArray
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], BoolArray, FloatArray]:
    """The first arc on a base of this velocity: A, v and q in the direction of the base, whether it is from below, and
    its excess ``R^2 - w2 q^2`` in (m/s^2)^2 (`_dynamics/interval/arcs.py`); where positive it reaches q.
    """
    forward = jnp.where(velocity < 0, -1, 1)
    v, q, alpha = forward * motion.v, jnp.abs(velocity), scales.deceleration
    A = scales.spring.squared * (forward * motion.x) - alpha
    is_below = v < q
    # The centre of an arc from above is -alpha.
    return (A, v, q), is_below, excess_of(A + jnp.where(is_below, 0, 2 * alpha), v, q, scales.spring)


def relative_excess(engine: IntervalEngine, scales: Scales, velocities: FloatArray) -> FloatArray:
    """``R^2 - w2 q^2`` of the first arc on a base of each of these velocities, relative to its terms; 1 from above."""
    motion = start_motion(scales, (engine.y0[0], engine.y0[1]))

    def of(velocity):
        _, is_below, excess = _first_arc(scales, motion, velocity)
        size = scales.spring.squared * velocity * velocity + scales.deceleration**2
        return jnp.where(is_below & (velocity != 0), excess / lax.stop_gradient(size), 1)

    return jax.vmap(of)(velocities)


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

        `deterministic_until`: see `FirstSegment`. A stick that ended before, but for the first change of the base
        itself, has the same duration in all samples; one that lasts until `t1` is not short.
        """
        digits = 4 * float(jnp.finfo(duration.dtype).eps)
        switched = (ending == Ending.BASE_SWITCHED) & (duration >= deterministic_until * (1 - digits))
        is_random = (deterministic_until == 0) | switched
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


# Signed distances for any system, one step of the switched engine at a time.
#
# While a mode lasts its guard is positive (`_dynamics/switched/engine.py`). Where it falls and rises again, its
# minimum tells how far the arc is from an event; where it falls through zero, the flow continued beyond the event has
# that minimum too, with the other sign. So the minimum is smooth through 0 and known on both sides.
#
# Its instant is searched for without derivatives (`_search`); the derivatives come from one evaluation there.


_ROUND_OFF = {8: 1e-9, 4: 1e-3}  # of the guard's scale: a minimum closer to 0 is exactly 0 but for round-off
_FAR = 0.5  # of the guard's scale: beyond the width of any kernel
# Search along a flow: increments in time steps, then a number of refinements between the last two instants.
_INCREMENTS, _REFINEMENTS = np.linspace(0.5, 1.5, 12), 5
_JUST_AFTER, _SOON = 0.05, 4.0  # time steps; beyond the width of any kernel
_LANDED = 1e-6  # of the guard's scale: a mode that ends there has ended by itself

_Tree = TypeVar("_Tree")
_Start: TypeAlias = tuple[FloatArray, State, FloatArray]
"""Time, state and sign at the beginning of a flow; a first axis of two for both flows of a step (`_search`)."""


class EngineStep(NamedTuple):
    """A step of the engine: time, state, sign and segment states at its start; time, state and sign at its end.

    `crossed`: when the slip began, if it began as the mass crossed the base velocity, s; else negative. `since`, of
    several contacts: when the mode began, if it did so by itself; else negative.
    """

    t: FloatArray
    y: State
    sign: FloatArray
    segment_states: tuple[SegmentState, ...]
    end: FloatArray
    y_end: State
    sign_end: FloatArray
    crossed: FloatArray
    since: FloatArray | None = None

    def of_contact(self, own: BoolArray) -> "EngineStep":
        """That of the contact which is its `own` among several."""
        return self._replace(
            **{name: _own(own, getattr(self, name)) for name in ("sign", "sign_end", "crossed", "since")}
        )


def _own(own: BoolArray, of_contacts: Array) -> Array:
    """The number of one contact among several."""
    return jnp.sum(jnp.where(own, of_contacts, 0))


class AtContact(eqx.Module):
    """One contact among several, as `OneContactModel` has one: the others stay in their `modes`.

    A mode is a number, of the contact, or an array, of all.
    """

    model: ContactsModel
    own: BoolArray
    modes: FloatArray
    steps_may_be_long: ClassVar[bool] = False

    def of_all(self, sign: FloatArray) -> FloatArray:
        """The modes of all contacts."""
        return sign if sign.ndim else jnp.where(self.own, sign, self.modes)

    def forcing(self, t: FloatArray, segments: Segments) -> Forcing:
        return self.model.forcing(t, segments)

    def flow(self, forcing: Forcing, y: State, h: FloatArray, sign: FloatArray) -> State:
        return self.model.flow(forcing, y, h, self.of_all(sign))

    def guard(self, forcing: Forcing, tau: FloatArray, y: State, sign: FloatArray) -> tuple[FloatArray, FloatArray]:
        guard, rate = self.model.guard(forcing, tau, y, self.of_all(sign))
        return _own(self.own, guard), _own(self.own, rate)

    def guard_scale(self, forcing: Forcing, y: State, sign: FloatArray) -> FloatArray:
        return _own(self.own, self.model.guard_scale(forcing, y, self.of_all(sign)))

    def step_limit(self, age: FloatArray, step: FloatArray, y: State, sign: FloatArray) -> FloatArray:
        return self.model.step_limit(age, step, y, self.of_all(sign))

    def on_base(self, forcing: Forcing, y: State) -> State:
        return self.model.at_base_velocity(forcing, y, self.own | (self.modes == 0))

    def can_stick(self, forcing: Forcing, y: State) -> BoolArray:
        none = jnp.zeros((), y[0].dtype)
        return self.guard(forcing, none, y, none)[0] >= 0

    def release_sign(self, forcing: Forcing, y: State) -> FloatArray:
        none = jnp.zeros((), y[0].dtype)
        needed = self.model.in_mode(forcing, none, y, self.of_all(none))[0].force
        return jnp.where(_own(self.own, needed) > 0, 1, -1).astype(needed.dtype)


_Model: TypeAlias = OneContactModel[Any] | AtContact


class _Outcome(NamedTuple):
    """What happened in a step of length `tau`; `stop`: end of the current excitation segment, or t1 if earlier (s)."""

    tau: FloatArray
    stop: FloatArray
    has_event: BoolArray  # the mode switched, not because of a jump of the excitation
    crosses: BoolArray  # the mass crossed the base velocity, and friction could hold it or nearly could
    dips: BoolArray  # the grazing measure (`_measure`) fell and rose again
    fall: FloatArray  # where it fell most steeply, as a fraction of the step
    falls: BoolArray  # the guard was falling when the segment ended, and about to reach zero
    rise: FloatArray  # slope of the grazing measure at the end of the step


class _Root(NamedTuple):
    """Result of a search along a flow: time `tau` from its start (s); whether it succeeded; the residual's slope."""

    tau: FloatArray
    found: BoolArray
    rate: FloatArray


class _AtRoot(NamedTuple):
    """Time and state at a root, and the guard with its slope there."""

    t: FloatArray
    y: State
    value: FloatArray
    slope: FloatArray


def crossed_after(shared: StepsShared, step: EngineStep) -> FloatArray:
    """`EngineStep.crossed` for the step after `step`."""
    laws_and_states = zip(shared.segment_laws.all, step.segment_states, strict=True)
    ends = [segment_state.segment.end for law, segment_state in laws_and_states if law.jumps]
    crosses = (step.sign != 0) & (step.sign_end == -step.sign) & (step.end < stop_of(shared.t1, step))
    # Once the base velocity has jumped, the slip does not count as begun at the base velocity any more.
    jumped = jnp.any(jnp.stack([jnp.zeros((), bool), *(step.end >= end for end in ends)]))
    goes_on = (step.sign_end == step.sign) & ~jumped
    return jnp.where(crosses, step.end, jnp.where(goes_on, step.crossed, -1))


def since_after(shared: StepsShared, step: EngineStep) -> FloatArray:
    """`EngineStep.since` for the step after `step`."""
    assert step.since is not None
    by_itself = step.end < stop_of(shared.t1, step)
    return jnp.where(step.sign_end == step.sign, step.since, jnp.where(by_itself, step.end, -1))


@sharing
def is_candidate(model: _Model, shared: StepsShared, step: EngineStep, later: _Model) -> BoolArray:
    """Whether the step may be close to a boundary; no other step is. `later`: as of `distances_of_step`."""
    outcome = _outcome_of(*without_derivatives((model, shared, step, later)))
    return outcome.has_event | outcome.crosses | outcome.dips | outcome.falls


@sharing
def distances_of_step(model: _Model, shared: StepsShared, step: EngineStep, later: _Model) -> BoundaryDistances:
    """The signed distances of a step for which `is_candidate` is true.

    `later`: the model after the step, where other contacts may be in other modes; of one contact the same.
    """
    # What has no derivatives decides and searches; the rest is evaluated once, at the instants found.
    known = without_derivatives((model, shared, step, later))
    still, (still_laws, _, still_length), fixed, still_later = known
    outcome, sticking = _outcome_of(*known), step.sign == 0
    t1, segments = shared.t1, shared.segment_laws.segments(step.segment_states)
    still_segments = still_laws.segments(fixed.segment_states)
    nothing, stop = jnp.zeros_like(step.end), outcome.stop
    # Two flows: that of the step, and that of a mass which crosses the base velocity at the step's end.
    start = stacked((step.t, step.y, _of_all(model, step.sign)), (step.end, step.y_end, _of_all(later, -step.sign)))
    roots = _search(still, still_segments, without_derivatives(start), fixed, outcome, still_length)

    # Time, state and guard at these instants, with their derivatives. A solver must not be given steps longer than its
    # limit.
    parts = 1 if model.steps_may_be_long else len(_INCREMENTS)

    def at(t0, y0, sign, tau):
        length = tau / parts

        @sharing
        def go_on(carry, _):
            t, y = carry
            return (t + length, model.flow(model.forcing(t, segments), y, length, sign)), None

        (t, y), _ = lax.scan(go_on, (t0, y0), None, length=parts)
        return _AtRoot(t, y, *model.guard(model.forcing(t, segments), jnp.zeros_like(t), y, sign))

    at_roots = jax.vmap(at)(*start, lax.stop_gradient(roots.tau))
    (here, then), (across, then_across) = (
        jax.tree.map(lambda leaf, flow=flow: leaf[flow], (roots, at_roots)) for flow in (0, 1)
    )

    # The grazing distance, minus the minimum of the measure, and when that is reached. One more Newton step, along a
    # parabola; to first order the minimum does not depend on its instant.
    is_ratio, bend = _after_crossing(fixed), jnp.where(here.rate > 0, here.rate, 1)
    shift = jnp.where(is_ratio, 0, -lax.stop_gradient(then.slope) / bend)
    lowest = then.value + then.slope * shift + 0.5 * bend * shift * shift
    nearest = lax.stop_gradient(then.t) + shift
    scale = model.guard_scale(model.forcing(fixed.t, lax.stop_gradient(segments)), fixed.y, fixed.sign)
    # A minimum that is 0 but for round-off stays so, as after a release; one of half the scale is out of reach.
    size = jnp.abs(lowest)
    is_close = (size > _ROUND_OFF[size.dtype.itemsize] * scale) & (size < _FAR * scale)
    is_minimum = (outcome.dips | outcome.has_event) & here.found & (here.rate > 0)
    age = jnp.where(is_ratio & here.found, then.t - step.crossed, 1)
    # Beyond the stop the motion is another one.
    grazing = SignedDistance(-lowest / age, is_minimum & is_close & (nearest < stop))

    # When the mode would have switched, had the segment not ended, and whether it would. The Newton step carries the
    # derivative.
    falls = outcome.falls & here.found & (then.slope < 0)
    would_switch = then.t - then.value / lax.stop_gradient(jnp.where(falls, then.slope, -1))
    there = model.forcing(lax.stop_gradient(would_switch), lax.stop_gradient(segments))
    # A slip's end is a stick only if friction can hold the mass there; a stick's end is a slip in any case.
    is_late = falls & (sticking | model.can_stick(there, model.on_base(there, lax.stop_gradient(then.y))))
    switch = jnp.where(outcome.has_event, step.end, would_switch)

    # Whether the excitation's next segment undoes a switch of mode just before it.
    is_undone = jnp.zeros_like(outcome.falls)
    if still_laws.all:
        following, jumped = following_segments(still_laws, fixed.segment_states, stop, jnp.ones((), bool))
        now = jnp.where(outcome.has_event, fixed.end, stop)
        inputs = still.forcing(now, still_laws.segments(following))
        y = still_later.on_base(inputs, fixed.y_end)
        _, rate = still_later.guard(inputs, nothing, y, nothing)
        # A release is undone where the force needed falls back; an arrival, where the base velocity jumps or friction
        # can hold the mass no more.
        is_undone = jnp.where(sticking, ~jumped & (rate > 0), jumped | ~still_later.can_stick(inputs, y))
    # Ends of segments depend on the parameters; `stop` has no derivatives.
    at_horizon = stop >= t1
    before_stop = SignedDistance(stop_of(t1, step) - switch, (outcome.has_event | is_late) & is_undone & ~at_horizon)
    # No stick begins after t1; a slip after t1 splits none.
    horizon = SignedDistance(t1 - switch, (outcome.has_event | (is_late & at_horizon)) & ~sticking)

    # How far friction is from being unable to hold an arrival, near the edge of the band beyond which it would cross.
    # Where the friction needed grows, the distance is the guard of the stick. Where it falls, a mass that is not held
    # crosses, and may soon come back to stick: the distance of an arrival that is held is the grazing distance of the
    # slip that it would begin. Arrivals that are not held have that distance in their own slips.
    inputs = model.forcing(step.end, segments)
    guard, rate = later.guard(inputs, nothing, step.y_end, nothing)
    # At this edge a released mass goes on in the other direction: it crosses the base velocity.
    other = later.release_sign(lax.stop_gradient(inputs), fixed.y_end) == -fixed.sign
    is_near = (outcome.has_event | outcome.crosses) & ~sticking & other & (jnp.abs(guard) < _FAR)
    returns, down = rate > 0, -then_across.value / jnp.where(across.found, across.tau, 1)
    is_known = ~returns | (outcome.has_event & across.found)

    time = jnp.where(outcome.has_event | outcome.crosses, fixed.end, jnp.where(is_late, stop, nearest))
    return BoundaryDistances(
        time=lax.stop_gradient(time),
        exists=outcome.has_event,
        is_slip=sticking,
        grazing=grazing,
        switch=before_stop,
        horizon=horizon,
        crossing=SignedDistance(jnp.where(returns, down, guard), is_near & is_known),
    )


def _of_all(model: _Model, sign: FloatArray) -> FloatArray:
    return model.of_all(sign) if isinstance(model, AtContact) else sign


def _outcome_of(model: _Model, shared: StepsShared, step: EngineStep, later: _Model) -> _Outcome:
    segment_laws, t1, step_length = shared
    sticking, tau, stop = step.sign == 0, step.end - step.t, stop_of(t1, step)
    segments = segment_laws.segments(step.segment_states)
    inputs = model.forcing(step.t, segments)

    def measured(tau, y):
        s, d = model.guard(inputs, tau, y, step.sign)
        return s, d, *_measure(s, d, tau + _lag(step), _after_crossing(step))

    s, d, q, dq = jax.vmap(measured)(*stacked((jnp.zeros_like(tau), step.y), (tau, step.y_end)))
    # A minimum lies where the measure falls and then rises. From values and slopes at both ends of the step alone, a
    # cubic tells where it falls most steeply, if it does at all; a ratio has no value at the crossing itself.
    fall = steepest_fall(q[0], dq[0] * tau, q[1], dq[1] * tau)
    fall = jnp.where(_after_crossing(step) & (step.t <= step.crossed), _JUST_AFTER, fall)
    taken = (step.t < t1) & (tau > 0)  # else the step was only tried
    inside = taken & (step.end < stop)
    has_event = inside & ((step.sign_end == 0) != sticking)
    if isinstance(model, AtContact):  # else another contact's event ended the mode (`counting.py`)
        has_event = has_event & (jnp.abs(s[1]) < _LANDED * model.guard_scale(inputs, step.y_end, step.sign))
    crosses = inside & ~sticking & (step.sign_end == -step.sign)
    # Far from the edge of the stick band a crossing stays one whatever the parameter's change.
    held, _ = later.guard(later.forcing(step.end, segments), 0 * tau, step.y_end, 0 * tau)
    crosses = crosses & (jnp.abs(held) < _FAR)
    dips = taken & ~has_event & ~crosses & (fall < 1) & (dq[1] > 0)
    # Would the mode have switched soon, had the segment gone on? Along the tangent of the guard, within a few steps.
    falls = taken & (step.end >= stop) & (s[1] > 0) & (s[1] < -_SOON * step_length * d[1])
    return _Outcome(tau, stop, has_event, crosses, dips, fall, falls, dq[1])


def stop_of(t1: FloatArray, step: EngineStep) -> FloatArray:
    return jnp.min(jnp.stack([t1, *(segment_state.segment.end for segment_state in step.segment_states)]), axis=0)


def _after_crossing(step: EngineStep) -> BoolArray:
    """Whether the step belongs to a slip that began as the mass crossed the base velocity."""
    return (step.crossed >= 0) & (step.sign != 0)


def _lag(step: EngineStep) -> FloatArray:
    """Time from that crossing to the start of the step, s; 0 without one."""
    return jnp.where(_after_crossing(step), step.t - step.crossed, 0)


def _measure(s: FloatArray, d: FloatArray, age: FloatArray, is_ratio: BoolArray) -> tuple[FloatArray, FloatArray]:
    """The measure whose minimum is the grazing distance, and its slope: the guard `s` (slope `d`), or ``s / age``.

    In a slip that began as the mass crossed the base velocity, a small change of parameters can turn the guard's first
    minimum into an inflection. The ratio ``s / age``, of slope ``(d age - s) / age^2``, keeps its minimum; both minima
    pass zero together.
    """
    age = jnp.where(is_ratio & (age > 0), age, 1)
    return jnp.where(is_ratio, s / age, s), jnp.where(is_ratio, (d * age - s) / (age * age), d)


def _search(
    model: _Model, segments: Segments, start: _Start, step: EngineStep, outcome: _Outcome,
    step_length: FloatArray,
) -> _Root:  # fmt: skip
    """The instants (2,) at which the distances are evaluated, one on each flow: roots of a residual.

    On the flow of the step: the minimum of the measure (`_measure`), in the step or beyond the event that ended it; for
    a step cut short by the end of a segment, where the guard would have reached zero. On the flow of a mass which
    crosses the base velocity: the minimum for the slip that begins there.
    """

    def search(t0, y0, sign, is_across):
        lag, is_ratio = jnp.where(is_across, 0, _lag(step)), is_across | _after_crossing(step)

        def residual(tau, s, d):
            """Negative before the root, positive after it: minus the guard, or the slope of the measure."""
            return jnp.where(outcome.falls & ~is_across, -s, _measure(s, d, lag + tau, is_ratio)[1])

        # A minimum inside the step lies after the steepest fall; one beyond the step's event, after its end. Right at
        # the crossing the ratio is not defined.
        first = jnp.where(is_across, _JUST_AFTER * step_length, jnp.where(outcome.dips, outcome.fall, 1) * outcome.tau)
        longest = jnp.where(
            step.sign == 0, step_length, model.step_limit(jnp.full_like(step_length, jnp.inf), step_length, y0, sign)
        )

        @sharing
        def go_on(carry, share):
            before, after, y = carry
            # One side known: go further. Both known: where the line through their values is zero (regula falsi).
            to = before.tau + jnp.where(after.found, _between(before, after), jnp.nan_to_num(share) * longest)
            to = jnp.where(jnp.isnan(share), first, to)
            # The flow goes on from the last instant before the root, not from its beginning.
            inputs = model.forcing(t0 + before.tau, segments)
            ahead = model.flow(inputs, y, to - before.tau, sign)
            value = residual(to, *model.guard(inputs, to - before.tau, ahead, sign))
            # A residual that is positive at the first instant has no root after it: `before` is then never found.
            new, is_before = _RootBracket(to, value, jnp.ones_like(to), jnp.isnan(share) | before.found), value < 0
            before, after = _replaced(before, new, is_before), _replaced(after, new, ~is_before)
            return (before, after, _either(is_before, ahead, y)), None

        none, no, yes = jnp.zeros_like(step_length), jnp.zeros((), bool), jnp.ones((), bool)
        # Of a minimum inside the step, the step's end is a known instant after it.
        inside = outcome.dips & ~is_across
        ends = (
            _RootBracket(none, -(none + 1), none + 1, no),
            _RootBracket(outcome.tau, outcome.rise, none + 1, inside & yes),
        )
        # NaN stands for the first instant; zeros, once the root is bracketed, for refinements alone.
        shares = jnp.asarray([np.nan, *_INCREMENTS, *[0.0] * _REFINEMENTS], step_length.dtype)
        (before, after, _), _ = lax.scan(go_on, (*ends, y0), shares)
        length = after.tau - before.tau
        rate = (after.value - before.value) / jnp.where(length > 0, length, 1)
        found = before.found & after.found & (length > 0)
        return _Root(jnp.where(found, before.tau + _between(before, after), before.tau), found, rate)

    t0, y0, sign = start
    return jax.vmap(search)(t0, y0, sign, jnp.array([False, True]))


class _RootBracket(NamedTuple):
    """One end of the bracket of a root: its instant, the residual there, and its weight in the Illinois rule."""

    tau: FloatArray
    value: FloatArray
    weight: FloatArray
    found: BoolArray


def _between(before: _RootBracket, after: _RootBracket) -> FloatArray:
    """Time from `before` to the zero of the line through both weighted values: ``a / (a - b)`` of their distance."""
    a, b = before.value * before.weight, after.value * after.weight
    return jnp.clip(a / jnp.where(a == b, 1, a - b), 0, 1) * (after.tau - before.tau)


def _replaced(end: _RootBracket, new: _RootBracket, by_new: BoolArray) -> _RootBracket:
    """An end, replaced by `new` where `by_new`; an end that stays has its weight halved (Illinois rule)."""
    return _either(by_new, new, end._replace(weight=end.weight / 2))


def stacked(*trees: _Tree) -> _Tree:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _either(first: BoolArray, one: _Tree, other: _Tree) -> _Tree:
    return jax.tree.map(lambda a, b: jnp.where(first, a, b), one, other)
