"""Bounds of numbers on which the fitted motion does not depend, by the profile of the likelihood."""

from typing import NamedTuple

import numpy as np
from scipy import stats

from .fit import Free, Point, Problem, chi_squared

LEVEL = 0.95
_DOUBLINGS = 6  # of the step in the logarithm: a factor of 65,000 in the end
_HALVINGS = 14


class Bounds(NamedTuple):
    """The smallest and largest value that the record allows, each at 95 % confidence; None where there is none."""

    low: float | None
    high: float | None


def bounds_of(problem: Problem, sigma: np.ndarray, at: Point, free: Free, which: int) -> Bounds:
    """How far the number `which` can go down and up until the record contradicts it, all others fitted again.

    One-sided: chi-squared has then grown by the 90 % quantile of one degree of freedom.
    """
    others = Free(free.x & (np.arange(len(free.x)) != which), free.s)
    least = chi_squared(problem.search(sigma, at, others).seen.over(sigma))
    limit = least + float(stats.chi2.ppf(2 * LEVEL - 1, 1))

    def moved(to: float, start: Point) -> tuple[bool, Point]:
        x = start.x.copy()
        x[which] = to
        try:
            fit = problem.search(sigma, Point(x, start.s), others)
        except ValueError:  # no motion there reaches the end of its window
            return False, start
        return chi_squared(fit.seen.over(sigma)) <= limit, fit.point

    def edge(direction: float) -> float | None:
        inside, point, far = at.x[which], at, None
        for doubling in range(_DOUBLINGS):
            to = at.x[which] + direction * 2.0**doubling * np.log(2) / 2
            allowed, reached = moved(to, point)
            if not allowed:
                far = to
                break
            inside, point = to, reached
        if far is None:
            return None
        for _ in range(_HALVINGS):
            middle = (inside + far) / 2
            allowed, reached = moved(middle, point)
            inside, far = (middle, far) if allowed else (inside, middle)
            point = reached if allowed else point
        x = at.x.copy()
        x[which] = inside
        return float(problem.model.transform.numbers(x)[which])

    return Bounds(edge(-1.0), edge(1.0))
