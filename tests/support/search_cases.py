"""Random set-ups of the search, by kind (what program follows them) and family (what is special in their numbers)."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from support.switched import Case, Jumping, Line, Shaking, Steps, Tones, coulomb, random_case


def _rescaled(part: Any, factor: float) -> Any:
    """A motion or force of `factor` times the size."""
    if part is None or factor == 1:
        return part
    if isinstance(part, Tones):
        return part._replace(amplitudes=tuple(factor * a for a in part.amplitudes), offset=factor * part.offset)
    if isinstance(part, Steps):
        return part._replace(velocities=tuple(factor * v for v in part.velocities))
    if isinstance(part, Jumping):
        return Jumping(_rescaled(part.motion, factor), _rescaled(part.steps, factor))
    return part._replace(values=tuple(factor * value for value in part.values))


def _base_start(case: Case) -> float:
    return case.base.value(0.0, 1e-9 * case.t1)


def everyday(source: np.random.Generator, case: Case) -> Case:
    """As `random_case` draws them."""
    return case


def damped(source: np.random.Generator, case: Case) -> Case:
    """Damping ratios of 0.01 to 10,000; half of the time with friction and force as large as the damping force."""
    ratio = 10 ** source.uniform(-2, 4)
    grown = max(1.0, ratio / 3) if source.random() < 0.5 else 1.0
    base = _rescaled(case.base, grown) if isinstance(case.base, Shaking) else case.base
    damping = 2 * math.sqrt(case.mass * case.stiffness) * ratio
    force = _rescaled(case.force, grown)
    return case._replace(damping=damping, normal_force=case.normal_force * grown, base=base, force=force)


def _quiet(part: Any) -> Any:
    """The motion or force changed so that it begins without a rate, and a force or ground acceleration with zero."""
    if isinstance(part, Tones):
        return part._replace(phases=(0.0,) * len(part.phases))
    if isinstance(part, Jumping):
        return Jumping(_quiet(part.motion), part.steps)
    if isinstance(part, Shaking):
        return part._replace(values=(0.0, *part.values[1:]))
    return part._replace(values=(part.values[1], *part.values[1:])) if isinstance(part, Line) else part


def frictionless(source: np.random.Generator, case: Case) -> Case:
    """Friction coefficients of zero; starts with the velocity of the base, some where no force is needed, or any."""
    static = None
    if case.rub.law.mu_static is not None:
        static = float(source.choice([0.0, float(case.rub.law.mu_static)]))
    case = case._replace(rub=coulomb(0.0, static))
    start = source.integers(3)
    if start == 0:
        return case
    if start == 1:
        return case._replace(y0=(case.y0[0], _base_start(case)))
    case = case._replace(base=_quiet(case.base), force=_rescaled(case.force, 0.0), damping=0.0)
    return case._replace(y0=(0.0, _base_start(case)))


def clinging(source: np.random.Generator, case: Case) -> Case:
    """Static friction up to 1000 times kinetic friction; the drive is up to as strong as the static one."""
    ratio = 10 ** source.uniform(0, 3)
    mu = float(case.rub.law.mu)
    grown = ratio ** source.uniform(0, 1)
    base, force = _rescaled(case.base, grown), _rescaled(case.force, grown)
    return case._replace(rub=coulomb(mu, mu * ratio), base=base, force=force)


def _on(value: float, unit: float) -> float:
    return round(value / unit) * unit


def _different(values: list[float], unit: float) -> tuple[float, ...]:
    """Neighbours that are equal moved apart by `unit`: `VelocitySteps` takes no others."""
    for i in range(1, len(values)):
        values[i] += unit * (values[i] == values[i - 1])
    return tuple(values)


def _lattice_line(source: np.random.Generator, line: Line, unit: float, tick: float) -> Line:
    """A record whose times and values lie on lattices, with flat, triangular or random pieces."""
    count, largest = len(line.times), max(*map(abs, line.values), unit)
    times = np.cumsum(np.concatenate([[0], np.maximum(np.round(np.diff(line.times) / tick), 1)])) * tick
    top = _on(largest * source.uniform(0.3, 1), unit) or unit
    pattern = source.integers(3)
    values = np.array(line.values)
    if pattern == 0:
        values = np.resize([0.0, top, 0.0, -top], count)
    elif pattern == 1:
        values = np.repeat(values, 2)[:count]
    # The record must last as long as before.
    times[-1] = max(times[-1], _on(line.times[-1], tick) + tick, times[-2] + tick)
    return line._replace(times=tuple(times.tolist()), values=tuple((np.round(values / unit) * unit).tolist()))


def lattice(source: np.random.Generator, case: Case) -> Case:
    """All numbers are multiples of 2^-2 to 2^-6; records are flat or triangular in part; half of the starts at rest."""
    unit = tick = 2.0 ** -int(source.integers(2, 7))

    def whole(part: Any) -> Any:
        if part is None:
            return None
        if isinstance(part, Tones):
            on = lambda values, least: tuple(max(_on(v, unit), least) for v in values)  # noqa: E731
            return Tones(
                on(part.amplitudes, 0.0), on(part.frequencies, unit), on(part.phases, 0.0), _on(part.offset, unit)
            )
        if isinstance(part, Steps):
            durations = tuple(max(_on(d, tick), tick) for d in part.durations)
            last = max(durations[-1], tick * math.ceil((case.t1 * 1.05 - sum(durations[:-1])) / tick))
            return Steps((*durations[:-1], last), _different([_on(v, unit) for v in part.velocities], unit))
        if isinstance(part, Jumping):
            return Jumping(whole(part.motion), whole(part.steps))
        return _lattice_line(source, part, unit, tick)

    mass, stiffness, normal = (max(_on(v, unit), unit) for v in (case.mass, case.stiffness, case.normal_force))
    mu = max(_on(float(case.rub.law.mu), unit), unit)
    static = case.rub.law.mu_static
    rub = coulomb(mu, None if static is None else mu + unit * int(source.integers(0, 4)))
    damping = case.damping if case.damping is None else _on(case.damping, unit)
    base, force, t1 = whole(case.base), whole(case.force), max(_on(case.t1, tick) - tick, tick)
    made = Case(mass, stiffness, normal, rub, base, t1, (_on(case.y0[0], unit), _on(case.y0[1], unit)), damping, force)
    if source.random() < 0.5:
        made = made._replace(y0=(made.y0[0], _base_start(made)))
    if source.random() < 0.25:  # on an edge of the band
        made = made._replace(y0=(float(source.choice([-1, 1])) * made.half_width, made.y0[1]))
    return made


def slow(source: np.random.Generator, case: Case) -> Case:
    """Base and forces of 2^-12 to 2^6 of the usual size."""
    size = 2.0 ** source.uniform(-12, 6)
    return case._replace(base=_rescaled(case.base, size), force=_rescaled(case.force, min(size, 1.0)))


FAMILIES: dict[str, Callable[[np.random.Generator, Case], Case]] = {
    family.__name__: family for family in (everyday, damped, frictionless, clinging, lattice, slow)
}


def drawn(kind: str, family: str, number: int, first: int = 0) -> list[Case]:
    """`number` set-ups of a kind and family. Damping is a number, zero where there is none: all share a program."""
    cases = []
    for seed in range(first, first + number):
        source = np.random.default_rng([seed, *kind.encode(), *family.encode()])
        case = FAMILIES[family](source, random_case(kind, seed + 10_000))
        cases.append(case._replace(damping=case.damping or 0.0))
    return cases


def switching(family: str, number: int) -> list[Case]:
    """Set-ups whose base switches between constant velocities, for the engine of whole intervals."""
    return [case._replace(damping=None, force=None, rub=coulomb(case.rub.law.mu))
            for case in drawn("steps", family, number)]  # fmt: skip
