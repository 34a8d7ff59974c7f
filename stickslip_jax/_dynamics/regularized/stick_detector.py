"""Detection of sticks in fixed steps: the relative velocity stays below a threshold for long enough."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax

from ..._events.stick_quantities import Remembered, StickSpan, begin_quantities, measured
from ..._events.sticks import StickRecord, Totals, ending_of, start_totals, with_stick
from ..._numerics.own_derivative import OwnDerivative
from ..._numerics.roots import look_ahead
from ..._types import AnyArray, BoolArray, FloatArray, Scalar

_AT_LIMIT = 1e-5  # of the largest friction


class Criterion(NamedTuple):
    """Criterion of a stick: ``|v_rel| <= threshold`` (m/s) for at least `minimum_duration` (s).

    Of several contacts one number each, or arrays (contacts,).
    """

    threshold: AnyArray | Scalar
    minimum_duration: AnyArray | Scalar


class StickDetector(NamedTuple):
    """State of the detector after the steps so far.

    - `inside`: whether the relative velocity is below the threshold, since `start` (s) at `position` (m).
    - `crossed`: when it passed through zero in the last step without ending inside, s, infinity if it did not;
      `crossed_at`: the position there. `remembered`: by the quantities of each stick that are asked for.
    """

    inside: BoolArray
    start: FloatArray
    position: FloatArray
    crossed: FloatArray
    crossed_at: FloatArray
    remembered: Remembered
    totals: Totals
    at_start: BoolArray


class NormalForces(NamedTuple):
    """The normal forces of several contacts at both ends of a step, N, and their slopes there, (contacts,) each."""

    n0: FloatArray
    slope0: FloatArray
    n1: FloatArray
    slope1: FloatArray


class Step(NamedTuple):
    """One step from `t` to ``t + h`` as the detector reads it.

    `r0`, `slope0`, `r1`, `slope1`: relative velocity and its slope at both ends (before a jump of the base); `x0`,
    `v0`, `x1`, `v1`: position and velocity; `need0`, `need1`: friction that holds the mass, over the largest friction.
    Of several contacts they are arrays: the positions of each and of all at once, everything else of each, with the
    normal forces.
    """

    t: FloatArray
    h: FloatArray
    r0: FloatArray
    slope0: FloatArray
    r1: FloatArray
    slope1: FloatArray
    x0: FloatArray
    v0: FloatArray
    x1: FloatArray
    v1: FloatArray
    need0: FloatArray
    need1: FloatArray
    normal: NormalForces | None = None


def start_detector(
    criterion: Criterion, speed: FloatArray, position: FloatArray, quantities: tuple[str, ...]
) -> StickDetector:
    """The detector at the beginning of a trajectory with relative velocity `speed` and `position`.

    `quantities` of each stick: those that are asked for.
    """
    dtype = speed.dtype
    inside, zero, never = jnp.abs(speed) <= criterion.threshold, jnp.zeros((), dtype), jnp.full((), jnp.inf, dtype)
    remembered = begin_quantities(position, quantities)
    return StickDetector(inside, zero, position, never, position, remembered, start_totals(dtype), jnp.zeros((), bool))


def detect(
    criterion: Criterion,
    detector: StickDetector,
    step: Step,
    *,
    jumped: BoolArray,
    after: FloatArray,
    last: BoolArray,
) -> tuple[StickDetector, StickRecord]:
    """Update the detector by one step; returns it and the record of the stick that ended in the step, if any.

    The step may end in a jump of the base (`jumped`), to the relative velocity `after`, or be the `last`. It
    need not resolve the width: the relative velocity is taken to fall linearly to zero inside the step in which a stick
    begins, and to leave zero inside the step in which the needed friction exceeds the largest.
    """
    threshold = jnp.asarray(criterion.threshold, step.t.dtype)
    inside = jnp.abs(step.r1) <= threshold
    enters, leaves = ~detector.inside & inside, detector.inside & ~inside
    entry, leave = passages(threshold, step)
    at = position_in(step, entry)
    start = jnp.where(enters, step.t + entry, detector.start)
    position = jnp.where(enters, at, detector.position)
    # A long step in which the mass comes to rest may end a little beyond rest; the next step corrects this.
    late = enters & jnp.isfinite(detector.crossed)
    start, position = jnp.where(late, detector.crossed, start), jnp.where(late, detector.crossed_at, position)
    passes = ~detector.inside & ~inside & (step.r0 * step.r1 < 0) & ~jumped
    crossed, crossed_at = jnp.where(passes, step.t + entry, jnp.inf), jnp.where(passes, at, step.x1)
    time = TimeInside(inside, leaves, start, position, leave, crossed, crossed_at)
    goes_on = jnp.where(jumped, jnp.abs(after) <= threshold, inside)
    end = AtEnd(jumped, goes_on, last, leaves)
    return recorded(criterion.minimum_duration, detector, step, time, end)


class TimeInside(NamedTuple):
    """How a step changes the time in which the relative velocity is below the threshold.

    - `inside`: whether it is at the end of the step, since `start` (s) at `position`. `leaves`: whether that time ends
      in the step, `leave` (s) after the step began.
    - `crossed`, `crossed_at`: see `StickDetector`.
    """

    inside: BoolArray
    leaves: BoolArray
    start: FloatArray
    position: FloatArray
    leave: FloatArray
    crossed: FloatArray
    crossed_at: FloatArray


class AtEnd(NamedTuple):
    """What happens at the very end of a step.

    - `over`: whether the time below the threshold ends there in any case. `goes_on`: whether one goes on or begins
      there. `last`: whether it is the horizon. `released`: whether a stick that ended was released.
    """

    over: BoolArray
    goes_on: BoolArray
    last: BoolArray
    released: BoolArray


def recorded(
    minimum_duration: AnyArray | Scalar, detector: StickDetector, step: Step, time: TimeInside, at_end: AtEnd
) -> tuple[StickDetector, StickRecord]:
    """The `detector` after a step, and the record of the stick that ended in the step, if any."""
    inside, leaves, start, position, leave, crossed, crossed_at = time
    now = step.t + step.h
    cut = at_end.last & inside
    ends = leaves | cut | (at_end.over & inside)
    end = jnp.where(leaves, step.t + leave, now)
    counts = ends & (end - start >= minimum_duration) & (end > start)
    left_at = jnp.where(leaves, position_in(step, leave), step.x1)
    quantities, remembered = measured(detector.remembered, counts, StickSpan(start, end, position, left_at))
    record = StickRecord(start, end, position, quantities, ending_of(counts, at_end.released, cut))
    detector = StickDetector(
        inside=at_end.goes_on,
        start=jnp.where(at_end.over, now, start),
        position=jnp.where(at_end.over, step.x1, position),
        crossed=crossed,
        crossed_at=crossed_at,
        remembered=remembered,
        totals=with_stick(detector.totals, counts, cut, end - start),
        at_start=detector.at_start | (counts & (start <= 0)),
    )
    return detector, record


def passages(threshold: FloatArray, step: Step) -> tuple[FloatArray, FloatArray]:
    """When ``|v_rel|`` falls to the `threshold` in a step and when it rises to it, s after the step began.

    Each is meaningless where it does not.
    """
    return _straight_entry(threshold, step), _late_exit(threshold, step, crossing(threshold, step, entering=False))


def crossing(threshold: FloatArray, step: Step, *, entering: bool) -> FloatArray:
    """When ``|v_rel|`` passes the threshold, s after the step began; meaningless where it does not."""
    sign = _sign(step.r0 if entering else step.r1)
    # Positive before the crossing and negative after it.
    turn = sign if entering else -sign
    shift = threshold if entering else -threshold
    s0, s1 = turn * step.r0 - shift, turn * step.r1 - shift
    return fall_in(step.h, s0, turn * step.slope0, s1, turn * step.slope1)


def fall_in(h: FloatArray, s0: FloatArray, d0: FloatArray, s1: FloatArray, d1: FloatArray) -> FloatArray:
    """When the cubic with these values and slopes at 0 and `h` falls through zero; meaningless where it does not."""
    d0, d1 = d0 * h, d1 * h
    falls = (s0 > 0) & (s1 < 0)
    s0, s1 = jnp.where(falls, s0, 1), jnp.where(falls, s1, -1)
    u = look_ahead(s0, d0, s1, d1, jnp.zeros_like(s0)).where
    # One more Newton step.
    cubic = s0, d0, s1, d1
    value, slope = _of_cubic(u, *cubic), _slope_of_cubic(u, *cubic)
    usable = falls & (slope < 0)
    u = lax.stop_gradient(jnp.clip(u - jnp.where(usable, value / jnp.where(usable, slope, -1), 0), 0, 1))
    return h * _root(cubic, usable, u)[0]


@OwnDerivative
def _root(cubic: tuple[FloatArray, ...], usable: BoolArray, u: FloatArray) -> tuple[FloatArray, ...]:
    """The root `u` of a cubic on [0, 1], with its derivatives of every order; without any where not `usable`."""
    return (u,)


@_root.def_jvp
def _root_jvp(primals, tangents):
    cubic, usable, u = primals
    (u,) = _root(cubic, usable, lax.stop_gradient(u))
    _, change = eqx.filter_jvp(lambda *cubic: _of_cubic(u, *cubic), cubic, tangents[0])
    usable = usable & (u > 0) & (u < 1)
    return (u,), (jnp.where(usable, -change / jnp.where(usable, _slope_of_cubic(u, *cubic), -1), 0),)


def _of_cubic(u: FloatArray, s0: FloatArray, d0: FloatArray, s1: FloatArray, d1: FloatArray) -> FloatArray:
    return hermite(u, jnp.ones_like(u), s0, d0, s1, d1)


def _slope_of_cubic(u: FloatArray, s0: FloatArray, d0: FloatArray, s1: FloatArray, d1: FloatArray) -> FloatArray:
    return 6 * u * (1 - u) * (s1 - s0) + d0 * (1 - u) * (1 - 3 * u) + d1 * u * (3 * u - 2)


def _straight_entry(threshold: FloatArray, step: Step) -> FloatArray:
    """When ``|v_rel|`` falls to the threshold, by its slope at the beginning, or by the chord if it rises there."""
    size, rise = jnp.abs(step.r0), _sign(step.r0) * step.slope0
    above = jnp.maximum(size - threshold, 0)
    total = jnp.maximum(size - _sign(step.r0) * step.r1, threshold)
    where = jnp.where(rise < 0, above / jnp.where(rise < 0, -rise, 1), step.h * above / total)
    return jnp.clip(where, 0, step.h)


def _late_exit(threshold: FloatArray, step: Step, resolved: FloatArray) -> FloatArray:
    """When ``|v_rel|`` rises to the threshold if the mass is released in this step; else the time `resolved`.

    After the release, where the needed friction equals the largest, the excess force grows linearly with time and the
    relative velocity with its square.
    """
    here = (step.need0 < jnp.minimum(step.need1, 1)) & (step.need1 > 1 - _AT_LIMIT)  # a step may end at the release
    gain = jnp.where(here, step.need1 - step.need0, 1)
    released = step.h * jnp.clip((1 - step.need0) / gain, 0, 1)
    rest, rise = step.h - released, _sign(step.r1) * step.slope1
    usable = here & (rise > 0) & (rest > 0)
    while_creeping = jnp.sqrt(jnp.where(usable, 2 * threshold * rest / jnp.where(usable, rise, 1), 1))
    return jnp.where(here, released + jnp.where(usable, jnp.minimum(while_creeping, rest), 0), resolved)


def _sign(value: FloatArray) -> FloatArray:
    return jnp.where(value < 0, -1.0, 1.0).astype(value.dtype)


def position_in(step: Step, tau: FloatArray) -> FloatArray:
    """The position inside the step, by the cubic through its ends."""
    return hermite(tau, step.h, step.x0, step.v0, step.x1, step.v1)


def hermite(
    tau: FloatArray, h: FloatArray, x0: FloatArray, v0: FloatArray, x1: FloatArray, v1: FloatArray
) -> FloatArray:
    """The cubic with these values and slopes at 0 and `h`, evaluated at `tau`; `x0` for a step of no length."""
    u = jnp.where(h > 0, tau / jnp.where(h > 0, h, 1), 0)
    bend = (1 - u) * (1 - u)
    values = x0 * bend * (1 + 2 * u) + x1 * u * u * (3 - 2 * u)
    return values + h * (v0 * u * bend - v1 * u * u * (1 - u))
