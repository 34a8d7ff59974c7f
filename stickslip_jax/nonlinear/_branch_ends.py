"""Where branches of periodic orbits end: they would go back over the same orbits half a period later, or the release of
a stick becomes tangent.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import newton

from ._branch_function import Equations, Evaluated, Plane
from ._branch_points import Point
from ._orbit_parts import multipliers_of, without_trivial

_LARGE = (30.0, 3e5)  # multipliers by which it is extrapolated where they become infinite: neither end is exact
_FITTED = 4  # points
_ITERATIONS = 20
_EXACT = 1e-13


def turning_back(
    equations: Equations, plane: Plane | None, scale: np.ndarray, last: Point, found: Point
) -> tuple[str, float, str] | None:
    """The kind of the end between two neighbouring points, the parameter there, and in words; None where there is none.

    A cycle shrinks into an equilibrium at a Hopf point, and an orbit of twice the period into the one that doubles.
    Beyond, the equations have the same orbits again, which begin half a period later: what the orbit moves in half of
    its period changes its sign, and of a cycle around an equilibrium the rates do too. The equations of the orbit are
    singular there; those of the equilibrium, or of the orbit of half the period, are not, and its multipliers tell
    where it is.
    """
    if last.tangent[-1] * found.tangent[-1] >= 0:
        return None
    size = len(equations.names)
    one, two = (equations.half_way(point.unknowns, plane) for point in (last, found))
    if one is None or two is None:
        return None
    axis = (one - two) / scale[:size] ** 2
    before, after = float(np.dot(one, axis)), float(np.dot(two, axis))
    if not before > 0 > after:
        return None
    share = before / (before - after)
    between = last.unknowns + share * (found.unknowns - last.unknowns)
    rates = [point.found.matrix[:size, size] / scale[:size] for point in (last, found)]
    if not equations.driven and np.dot(*rates) < 0:
        # An equilibrium comes back after any time; after a quarter of the period the critical multipliers are +-i.
        between[size] /= 4

        def growth(at: Evaluated) -> float:
            multipliers = multipliers_of(at.matrix[:size, :size] + np.eye(size))
            critical = np.argmin(np.abs(multipliers - 1j))
            return math.log(abs(multipliers[critical]))

        value = _root(equations, plane, between, last.unknowns[-1], size, None, growth)
        return "Hopf", value, "the cycle shrinks into an equilibrium"
    value = halved(equations, plane, between, last.unknowns[-1])
    return "flip", value, "the orbit becomes one of half its period, which doubles there"


def halved(equations: Equations, plane: Plane | None, between: np.ndarray, other: float) -> float:
    """The parameter near that of the unknowns `between` where the orbit of half the period has the multiplier -1."""
    size, free = len(equations.names), 0 if equations.driven else 1
    guess = between.copy()
    if free:
        guess[size] /= 2

    def doubles(at: Evaluated) -> float:
        multipliers = multipliers_of(at.matrix[:size, :size] + np.eye(size))
        return float(np.prod((without_trivial(multipliers) if free else multipliers) + 1).real)

    periods = equations.periods // 2 if equations.driven else None
    return _root(equations, plane, guess, other, size + free, periods, doubles)


def _root(
    equations: Equations, plane: Plane | None, guess: np.ndarray, other: float, number: int, periods: int | None,
    test: Callable[[Evaluated], float],
) -> float:  # fmt: skip
    """The parameter near that of the `guess` where a `test` of what comes back is zero; its first `number` unknowns
    follow from it. That of the guess, where it is not found.
    """
    unknowns = guess.copy()

    def at(parameter: float) -> float:
        unknowns[-1] = parameter
        found = None
        for _ in range(_ITERATIONS):
            found = equations.at(unknowns, plane, periods)
            if found is None:
                break
            # Of contacts that stick all the time the matrix is singular: they stay where they are.
            change = np.linalg.lstsq(found.matrix[:number, :number], -found.value[:number], rcond=1e-10)[0]
            unknowns[:number] += change
            if np.max(np.abs(change)) <= _EXACT * np.max(np.abs(unknowns[:number])):
                break
        return math.nan if found is None else test(found)

    result: Any
    value, result = newton(at, guess[-1], x1=other, tol=1e-12, full_output=True, disp=False)  # pyright: ignore[reportAssignmentType]
    near = abs(value - guess[-1]) <= abs(other - guess[-1]) + 1e-3 * abs(guess[-1])
    return float(value) if result.converged and near else float(guess[-1])


def tangent_release(points: list[Point]) -> float | None:
    """The parameter where the largest multiplier of the last `points` with the same order of modes becomes infinite;
    None where it does not grow so far.

    Static friction larger than the kinetic one holds a stick for ever from where the force no longer reaches it. Before
    that the release is nearly tangent, and its time, and with it the largest multiplier, goes as one over the distance
    of the parameter; where the orbit has two such releases by symmetry, as one over its square.
    """
    same = [point for point in points if point.order == points[-1].order]
    sizes = np.array([np.max(np.abs(point.multipliers)) for point in same])
    values = np.array([point.unknowns[-1] for point in same])
    if sizes[-1] < _LARGE[1]:
        return None
    known = np.flatnonzero((sizes > _LARGE[0]) & (sizes < _LARGE[1]))[-_FITTED:]
    if len(known) < _FITTED or np.any(np.diff(sizes[known]) <= 0):
        return None
    found = []
    for power in (1, 2):
        small = sizes[known] ** (-1 / power)
        ends = [float(BarycentricInterpolator(small[skip:], values[known[skip:]])(0.0)) for skip in (0, 1)]
        found.append((abs(ends[0] - ends[1]), ends[0]))
    return min(found)[1]
