"""Event-by-event reference for the mass-spring Coulomb oscillator on a switching base, at 40 digits.

The system, in SI units and never made dimensionless, is::

    m x'' + k x = f,    f = mu n sgn(v - x') while slipping,    v(t) piecewise constant.

Every slip arc is written as ``x(t) = c + A cos(omega t) + B sin(omega t)``, its velocity as one cosine,
``x'(t) = P cos(omega t + phase)``; the arc ends at the first ``t > 0`` with ``x'(t) = v``. The base velocity
is met from below where that cosine rises and from above where it falls, which names the root and leaves out
the trivial zero that an arc starting on ``x' = v`` has at ``t = 0``. The root is polished by Newton steps and
its residual is checked. An arc that only touches ``x' = v`` (``P = |v|``, as the arc of a released mass does)
has no event.

At ``x' = v``, with ``a = mu n / k``, the mass

- sticks when the spring force lies in the friction band and the base does not carry it out at once:
  ``-a <= x < a`` for ``v > 0``, ``-a < x <= a`` for ``v < 0``, ``|x| <= a`` for ``v = 0``;
- otherwise slips on: to the lower side (``x' < v``) when ``x > 0``, to the upper side when ``x < 0``.

Conventions: a stick has positive length; consecutive intervals of equal velocity are one interval, intervals
of zero length do not exist; an event exactly on the end of an interval gives way to that end; a base jump at
``t1`` or later is not seen (``HORIZON``). Without friction (``mu = 0``) nothing sticks, not even a mass
at rest at ``x = 0`` on a base at rest.

Inputs may be ``float``, ``int``, ``mpf`` or decimal strings (``"0.1"`` is then exact). Results carry guard
digits: do arithmetic on them inside ``mp.workdps(40)``, since mpmath rounds to the ambient precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpmath import mp, mpf

Number = float | int | str | mpf

GUARD_DIGITS = 15
RELEASED = "RELEASED"
BASE_SWITCHED = "BASE_SWITCHED"
HORIZON = "HORIZON"
STUCK = "STUCK"
CROSSED = "CROSSED"


class EventSequenceChangedError(RuntimeError):
    """The two perturbed runs of a finite difference do not go through the same events."""


@dataclass(frozen=True)
class ReferenceStick:
    """One stick: its start and end instants, ``x`` at its start, and what ended it.

    ``ending`` is ``"RELEASED"``, ``"BASE_SWITCHED"`` or ``"HORIZON"``.
    """

    start: mpf
    end: mpf
    position: mpf
    ending: str


@dataclass(frozen=True)
class ReferenceRun:
    """The sticks in order, the state at ``t1``, and the number of pass-throughs.

    A pass-through (crossing) is an arrival of ``x'`` at the base velocity along a slip arc that does not
    start a stick. A jump of the base velocity past ``x'`` is not one.
    """

    sticks: list[ReferenceStick]
    final_position: mpf
    final_velocity: mpf
    crossings: int


@dataclass(frozen=True)
class ReferenceSegment:
    """One stick or one slip arc, with the states at both ends.

    ``side`` is 0 in a stick, +1 in a slip below the base velocity (``x' < v``, friction ``+mu n``), -1 in a
    slip above it. ``ending`` of a slip is ``"STUCK"``, ``"CROSSED"``, ``"BASE_SWITCHED"`` or ``"HORIZON"``.
    ``interval`` counts the merged intervals of the base velocity.
    """

    side: int
    interval: int
    base_velocity: mpf
    start: mpf
    end: mpf
    start_position: mpf
    start_velocity: mpf
    end_position: mpf
    end_velocity: mpf
    ending: str


@dataclass(frozen=True)
class ReferenceDerivatives:
    """Derivatives of every stick's start, end and position, and of the state at ``t1``."""

    starts: list[mpf]
    ends: list[mpf]
    positions: list[mpf]
    final_position: mpf
    final_velocity: mpf


@dataclass(frozen=True)
class _Oscillator:
    """Angular frequency, half-width ``mu n / k`` of the stick band, and the digits asked for."""

    omega: mpf
    half_width: mpf
    digits: int


@dataclass(frozen=True)
class _Interval:
    """A stretch of constant base velocity; ``ending`` says whether a jump or the horizon closes it."""

    velocity: mpf
    end: mpf
    ending: str


def simulate_reference(**arguments) -> ReferenceRun:
    """Simulate on ``[0, t1]`` one event at a time; keyword arguments as in :func:`trace_reference`."""
    return _summarize(trace_reference(**arguments))


def trace_reference(
    *,
    mass: Number,
    stiffness: Number,
    normal_force: Number,
    mu: Number,
    durations: Sequence[Number],
    velocities: Sequence[Number],
    t1: Number,
    position0: Number,
    velocity0: Number,
    digits: int = 40,
) -> list[ReferenceSegment]:
    """The whole trajectory on ``[0, t1]`` as a list of segments, correct to about ``digits`` digits.

    ``velocities[i]`` is the base velocity over ``durations[i]``; the durations must reach ``t1`` (a shortfall
    of 1e-12 of ``t1``, left by summing floats, is filled with the last velocity).
    """
    with mp.workdps(digits + GUARD_DIGITS):
        mass, stiffness, load = mpf(mass), mpf(stiffness), mpf(mu) * mpf(normal_force)
        if mass <= 0 or stiffness <= 0 or load < 0:
            raise ValueError("mass and stiffness must be positive, mu * normal_force not negative")
        oscillator = _Oscillator(mp.sqrt(stiffness / mass), load / stiffness, digits)
        now, position, velocity = mpf(0), mpf(position0), mpf(velocity0)
        segments: list[ReferenceSegment] = []
        for index, interval in enumerate(_merge_intervals(durations, velocities, mpf(t1))):
            segments += _run_interval(oscillator, index, interval, now, position, velocity)
            now, position, velocity = interval.end, segments[-1].end_position, segments[-1].end_velocity
        return segments


def event_time_derivatives(
    parameter: str,
    *,
    mass: Number,
    stiffness: Number,
    normal_force: Number,
    mu: Number,
    durations: Sequence[Number],
    velocities: Sequence[Number],
    t1: Number,
    position0: Number,
    velocity0: Number,
    digits: int = 40,
    relative_step: Number = "1e-12",
) -> ReferenceDerivatives:
    """Central differences of all stick starts, ends, positions and of the final state.

    ``parameter`` is ``"mu"``, ``"speed"``, ``"stiffness"``, ``"mass"`` or ``"position0"``. The speed is
    ``max |velocities|`` and scales all of them, ``velocities = speed * signs``; the switching times stay. The
    step is ``relative_step`` times the parameter, or ``relative_step`` itself where the parameter is 0; the
    error of a derivative is its third derivative times the step squared over 6.

    Raises :class:`EventSequenceChangedError` when the perturbed runs differ in their sequence of segments.
    """
    with mp.workdps(digits + GUARD_DIGITS):
        velocities = [mpf(value) for value in velocities]
        speed = max(abs(value) for value in velocities)
        arguments = {"mass": mass, "stiffness": stiffness, "mu": mu, "position0": position0, "speed": speed}
        if parameter not in arguments:
            raise ValueError(f"unknown parameter {parameter!r}; choose from {sorted(arguments)}")
        signs = [value / speed if speed else mpf(0) for value in velocities]
        center = mpf(arguments[parameter])
        step = mpf(relative_step) * (abs(center) or 1)
        if parameter in ("mu", "speed") and center == 0:
            raise ValueError(f"no central difference exists at {parameter} = 0")

        def run(value: mpf) -> list[ReferenceSegment]:
            changed = {**arguments, parameter: value}
            scale = changed.pop("speed")
            moved = [scale * sign for sign in signs] if parameter == "speed" else velocities
            fixed = {"normal_force": normal_force, "velocity0": velocity0, "t1": t1, "digits": digits}
            return trace_reference(durations=durations, velocities=moved, **fixed, **changed)

        return _central_difference(run(center - step), run(center + step), step)


def _central_difference(
    before: list[ReferenceSegment], after: list[ReferenceSegment], step: mpf
) -> ReferenceDerivatives:
    """Difference quotient of two runs a distance ``2 step`` apart, which must share their event sequence."""

    def sequence(segments: list[ReferenceSegment]) -> list[tuple[int, int, str]]:
        return [(item.interval, item.side, item.ending) for item in segments]

    if sequence(before) != sequence(after):
        raise EventSequenceChangedError("the perturbed runs go through different events")
    low, high = _summarize(before), _summarize(after)

    def quotient(one: mpf, two: mpf) -> mpf:
        return (two - one) / (2 * step)

    pairs = list(zip(low.sticks, high.sticks, strict=True))
    return ReferenceDerivatives(
        starts=[quotient(one.start, two.start) for one, two in pairs],
        ends=[quotient(one.end, two.end) for one, two in pairs],
        positions=[quotient(one.position, two.position) for one, two in pairs],
        final_position=quotient(low.final_position, high.final_position),
        final_velocity=quotient(low.final_velocity, high.final_velocity),
    )


def _summarize(segments: list[ReferenceSegment]) -> ReferenceRun:
    """Pick the sticks, the final state and the number of pass-throughs out of a trajectory."""
    return ReferenceRun(
        sticks=[
            ReferenceStick(item.start, item.end, item.start_position, item.ending)
            for item in segments
            if item.side == 0
        ],
        final_position=segments[-1].end_position,
        final_velocity=segments[-1].end_velocity,
        crossings=sum(item.ending == CROSSED for item in segments),
    )


def _merge_intervals(durations: Sequence[Number], velocities: Sequence[Number], t1: mpf) -> list[_Interval]:
    """Join neighbours of equal velocity, drop empty intervals and cut the last one at ``t1``."""
    durations, velocities = [mpf(value) for value in durations], [mpf(value) for value in velocities]
    if len(durations) != len(velocities) or not durations:
        raise ValueError("durations and velocities must be equally many, and at least one")
    if min(durations) < 0 or not 0 < t1 < mp.inf:
        raise ValueError("durations must not be negative, t1 must be positive and finite")
    if sum(durations) < t1 * (1 - mpf("1e-12")):
        raise ValueError("the durations do not reach t1")
    ends: list[mpf] = []
    levels: list[mpf] = []
    now = mpf(0)
    for duration, level in zip(durations, velocities, strict=True):
        if duration == 0:
            continue
        if now >= t1:
            break
        now += duration
        if levels and levels[-1] == level:
            ends[-1] = now
        else:
            ends.append(now)
            levels.append(level)
    ends[-1] = t1
    last = len(ends) - 1
    return [
        _Interval(level, end, HORIZON if index == last else BASE_SWITCHED)
        for index, (level, end) in enumerate(zip(levels, ends, strict=True))
    ]


def _run_interval(
    oscillator: _Oscillator, index: int, interval: _Interval, now: mpf, position: mpf, velocity: mpf
) -> list[ReferenceSegment]:
    """All segments of one interval of constant base velocity, from time ``now`` to its end."""
    base = interval.velocity
    tiny = mpf(10) ** (-oscillator.digits)
    # Exact ties are seen as ties: a mass that has the base's velocity, and an event on the end of the interval.
    if abs(velocity - base) <= tiny * (abs(base) + oscillator.omega * oscillator.half_width):
        position, velocity = _snap_to_band_edge(oscillator, position), base
    side = _side_on_base(oscillator, position, base) if velocity == base else _sign(base - velocity)
    segments: list[ReferenceSegment] = []
    tangent = _is_release_point(oscillator, position, base) and velocity == base
    while now < interval.end:
        remaining = interval.end - now
        if side == 0:
            elapsed = _time_to_release(oscillator, position, base)
        elif tangent:
            elapsed = mp.inf
        else:
            elapsed = _time_to_base_velocity(oscillator, side, position, velocity, base)
        cut = elapsed >= remaining - tiny * (interval.end + 1 / oscillator.omega)
        elapsed = remaining if cut else elapsed
        new_position, new_velocity = _move(oscillator, side, position, velocity, elapsed)
        if cut:
            end, new_side, ending = interval.end, side, interval.ending
        elif side == 0:
            end, new_side, ending, tangent = now + elapsed, _sign(base), RELEASED, True
            new_position = _sign(base) * oscillator.half_width
        else:
            new_position = _snap_to_band_edge(oscillator, new_position)
            tangent = _is_release_point(oscillator, new_position, base)
            end, new_velocity = now + elapsed, base
            new_side = _side_on_base(oscillator, new_position, base)
            ending = CROSSED if new_side else STUCK
        segments.append(
            ReferenceSegment(side, index, base, now, end, position, velocity, new_position, new_velocity, ending)
        )
        now, position, velocity, side = end, new_position, new_velocity, new_side
    return segments


def _sign(value: mpf) -> int:
    """-1, 0 or +1."""
    return int(value > 0) - int(value < 0)


def _side_on_base(oscillator: _Oscillator, position: mpf, base: mpf) -> int:
    """Say what follows a state on ``x' = v``: 0 for a stick of positive length, else the side of the slip.

    Outside the band either sign of the friction accelerates the mass the same way, away from ``v``. On the
    edge that the base moves towards, the mass leaves tangentially: below for ``v > 0``, above for ``v < 0``.
    """
    if _is_release_point(oscillator, position, base):
        return _sign(base) or 1
    return 0 if abs(position) <= oscillator.half_width else _sign(position)


def _is_release_point(oscillator: _Oscillator, position: mpf, base: mpf) -> bool:
    """Whether a mass on ``x' = v`` sits on the band edge that the moving base carries it towards.

    Without friction there is no band on a base at rest either: the mass stays, on a circle without radius.
    """
    return position == _sign(base) * oscillator.half_width and (base != 0 or oscillator.half_width == 0)


def _snap_to_band_edge(oscillator: _Oscillator, position: mpf) -> mpf:
    """Replace a position within round-off of a band edge by the edge, so that exact ties are seen as ties.

    Half of the digits: an arc from that close to the edge differs by the square from one that touches ``x' = v``.
    """
    width = oscillator.half_width
    if abs(abs(position) - width) <= width * mpf(10) ** (-oscillator.digits // 2):
        return width if position > 0 else -width
    return position


def _time_to_release(oscillator: _Oscillator, position: mpf, base: mpf) -> mpf:
    """Time a stick needs to carry the mass to the edge of the band; infinite on a base at rest."""
    if base == 0:
        return mp.inf
    return (_sign(base) * oscillator.half_width - position) / base


def _move(oscillator: _Oscillator, side: int, position: mpf, velocity: mpf, elapsed: mpf) -> tuple[mpf, mpf]:
    """State after ``elapsed`` in a stick (``side`` 0) or on a slip arc."""
    if side == 0:
        return position + velocity * elapsed, velocity
    omega, center = oscillator.omega, side * oscillator.half_width
    cosine, sine = mp.cos_sin(omega * elapsed)
    a, b = position - center, velocity / omega
    return center + a * cosine + b * sine, omega * (b * cosine - a * sine)


def _time_to_base_velocity(oscillator: _Oscillator, side: int, position: mpf, velocity: mpf, base: mpf) -> mpf:
    """First ``t > 0`` with ``x'(t) = v`` on a slip arc; infinite when there is none or it only touches.

    With ``x'(t) = P cos(theta)``, ``theta = omega t + phase``, an arc below the base meets it where this
    rises (``theta = -acos(v / P)`` modulo a turn), an arc above it where it falls (``+acos(v / P)``).
    """
    omega, center = oscillator.omega, side * oscillator.half_width
    across = omega * (position - center)
    peak = mp.hypot(velocity, across)
    tiny = mpf(10) ** (-oscillator.digits - GUARD_DIGITS // 2)
    if peak - abs(base) <= tiny * peak:
        return mp.inf
    phase = mp.atan2(across, velocity)
    turn = 2 * mp.pi
    angle = (-side * mp.acos(base / peak) - phase) % turn
    time = (angle or turn) / omega

    tolerance = mpf(10) ** (5 - oscillator.digits) * peak
    for _ in range(3):
        x, speed = _move(oscillator, side, position, velocity, time)
        residual = speed - base
        if abs(residual) <= tiny * peak:
            break
        time -= residual / (-omega * omega * (x - center))
    halfway = _move(oscillator, side, position, velocity, time / 2)[1]
    residual = _move(oscillator, side, position, velocity, time)[1] - base
    if not (time > 0 and abs(residual) < tolerance and side * (base - halfway) > 0):
        raise ArithmeticError("the time of arrival at the base velocity could not be confirmed")
    return time
