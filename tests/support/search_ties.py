"""Ties with the friction limit in exact arithmetic: sticks on records whose numbers are multiples of 2^-k.

In a stick the force that friction must give is a quadratic function of time between two vertices of the record, with
rational coefficients. The limit is put exactly on the largest force that is needed at a vertex up to some instant: so
at that vertex the force touches the limit and turns back, which is no release, or goes through it.
"""

from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from support.switched import POINTS, Case, Line, Shaking, coulomb


class Needed(NamedTuple):
    """The force needed on one segment: ``n0 + n1 s + n2 s^2`` for ``0 <= s <= length``, `t` at its start."""

    t: Fraction
    length: Fraction
    n0: Fraction
    n1: Fraction
    n2: Fraction

    def at(self, s: Fraction) -> Fraction:
        return self.n0 + s * (self.n1 + s * self.n2)


def forces(case: Case) -> list[Needed]:
    """What a stick from the start needs, segment by segment."""
    m, c, k, x = (Fraction(v) for v in (case.mass, case.damping or 0.0, case.stiffness, case.y0[0]))
    of_base, of_force = not isinstance(case.base, Shaking), case.force is not None
    line: Any = case.force if of_force else case.base
    times, values, segments = [*map(Fraction, line.times)], [*map(Fraction, line.values)], []
    for i in range(len(times) - 1):
        length, value = times[i + 1] - times[i], values[i]
        slope = (values[i + 1] - value) / length
        if of_force:
            n0, n1, n2, way = k * x - value, -slope, Fraction(0), Fraction(0)
        elif of_base:
            way = length * (value + slope * length / 2)
            n0, n1, n2 = m * slope + c * value + k * x, c * slope + k * value, k * slope / 2
        else:
            n0, n1, n2, way = m * value + k * x, m * slope, Fraction(0), Fraction(0)
        segments.append(Needed(times[i], length, n0, n1, n2))
        x += way
    return segments


def _passes(one: Needed, limit: Fraction) -> float | None:
    """When the force exceeds `limit`, after the start of the segment; it does not yet at the start."""
    after = one.n1 > 0 or (one.n1 == 0 and one.n2 > 0)
    if one.n0 > limit or (one.n0 == limit and after):
        return 0.0
    top = -one.n1 / (2 * one.n2) if one.n2 < 0 else one.length
    if one.at(min(max(top, Fraction(0)), one.length)) <= limit and one.at(one.length) <= limit:
        return None
    # n2 s^2 + n1 s = gap, the smaller positive root.
    gap, b, a = float(limit - one.n0), float(one.n1), float(one.n2)
    root = max(float(one.n1 * one.n1 + 4 * one.n2 * (limit - one.n0)), 0.0) ** 0.5
    return 2 * gap / (b + root) if b + root > 0 else (-b - root) / (2 * a)


def first_release(case: Case) -> float | None:
    """When the stick at the start ends; None if it lasts to t1; 0 if there is none."""
    limit = Fraction(float(case.rub.law.static)) * Fraction(case.normal_force)
    for one in forces(case):
        mirrored = Needed(one.t, one.length, -one.n0, -one.n1, -one.n2)
        found = [s for s in (_passes(one, limit), _passes(mirrored, limit)) if s is not None]
        if found:
            t = float(one.t) + min(found)
            return t if t < case.t1 else None
    return None


def tie(kind: str, seed: int) -> Case:
    """A stick at the start on a flat, triangular or random record of lattice numbers; `kind`: base, ground or force."""
    source = np.random.default_rng([seed, *kind.encode()])
    unit = 2.0 ** -int(source.integers(1, 6))
    pattern, top = int(source.integers(4)), unit * int(source.integers(1, 9))
    values = {
        0: np.resize([0.0, top, 0.0, -top], POINTS),
        1: np.resize([0.0, top, top, 0.0, 0.0, -top, -top, 0.0], POINTS),
        2: np.resize([top, -top], POINTS),
        3: unit * source.integers(-4, 5, POINTS),
    }[pattern]
    # On a base slopes count, which are numbers that a float holds exactly where the gaps are powers of two.
    choices = unit * np.array([1.0, 2.0, 4.0, 8.0] if kind == "base" else range(1, 9))
    gaps = np.full(POINTS - 1, source.choice(choices))
    if source.random() < 0.5:
        gaps = source.choice(choices, POINTS - 1)
    line = Line(tuple(np.concatenate([[0.0], np.cumsum(gaps)]).tolist()), tuple(map(float, values)))
    mass, stiffness = unit * int(source.integers(1, 33)), unit * int(source.integers(1, 33))
    damping = 0.0 if kind == "ground" else unit * int(source.integers(0, 5))
    x, t1 = unit * int(source.integers(-4, 5)), line.times[-1]
    still = Line(line.times, (0.0,) * POINTS)
    base: Any = {"base": line, "ground": Shaking(*line), "force": still}[kind]
    force = line if kind == "force" else None
    case = Case(mass, stiffness, 1.0, coulomb(1.0), base, t1, (x, base.value(0.0, line.times[1] / 2)), damping, force)
    # The limit: the largest force at the ends of the first segments.
    until = int(source.integers(1, POINTS))
    largest = max(max(abs(one.n0), abs(one.at(one.length))) for one in forces(case)[:until])
    mu = float(largest) or 1.0
    return case._replace(rub=coulomb(mu))
