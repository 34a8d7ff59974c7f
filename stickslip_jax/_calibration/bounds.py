"""Bounds of numbers by the profile of the likelihood: of those on which the fitted motion does not depend, those near
their own bound, and those whose standard error does not tell how far they can go.
"""

from typing import NamedTuple

import numpy as np
from scipy import optimize, stats

from .fit import Fit, Free, Point, Problem, chi_squared
from .information import Information

LEVEL = 0.95
_FARTHEST_FIRST = np.log(2) / 2  # first step in the coordinate, at most
_DOUBLINGS = 6  # of the step: a factor of 4,000,000,000 of a number that is searched by its logarithm
_RESOLUTION = 1e-4  # of the first step
_NO_MOTION = 1e3  # in place of infinity


SHARE = 0.05  # of a direction, below which a number has no part in it
_NEAR = 3.0  # standard errors from a bound: farther away the estimate is normal
_NEAR_KINETIC = 10.0  # of static from kinetic friction, on whose square the motion depends there
_AS_NORMAL = 5.0  # times its largest distance that a number can go, up to which its standard error is believed
_AS_STRAIGHT = 1.1  # times the growth that the standard error promises, or one over it


class Bounds(NamedTuple):
    """The smallest and largest value that the record allows, each at 95 % confidence; None where there is none."""

    low: float | None
    high: float | None

    @property
    def in_words(self) -> str:
        """Such as "at least 1 and at most 2"; "" without any."""
        ends = zip(("at least", "at most"), self, strict=True)
        return " and ".join(f"{word} {one:.3g}" for word, one in ends if one is not None)


def all_bounds(
    problem: Problem, sigma: np.ndarray, fit: Fit, free: Free, told: Information, freedom: float
) -> tuple[dict[int, Bounds], np.ndarray]:
    """The bounds by the record of the numbers, by place, that it does not tell, each by itself, of those near a bound
    that they may have, and of those around which chi-squared is no parabola; and which numbers the record tells,
    (parameters,). `freedom`: degrees of freedom of the noise, infinite where it is known: chi-squared may grow by the
    square of the 95 % quantile of Student's t with so many.

    Near its bound a number need not be known to 30 % to be told: the record only has to say how far away it can be.
    """
    at, transform, is_told = fit.point, problem.model.transform, ~told.untold
    errors = np.sqrt(np.diag(told.covariance))
    slopes, own = np.diag(transform.slopes(transform.numbers(at.x))), transform.own(at.x)
    from_low, from_high = (
        np.where(np.isfinite(end), np.abs(own - np.asarray(bound)), np.inf)
        for end, bound in zip(transform.box, (transform.low, transform.high), strict=True)
    )
    far = np.where(np.any(np.asarray(transform.added) > 0, axis=1), _NEAR_KINETIC, _NEAR)
    is_near = np.minimum(from_low, from_high) < far * slopes * errors
    is_tied = np.any(np.abs(told.tied) > SHARE, axis=0)
    limit = float(stats.t.ppf(LEVEL, freedom))
    bounds = {}
    for i in np.flatnonzero(~is_tied):
        if not (told.untold[i] or is_near[i]):
            change = limit * told.covariance[i] / errors[i]
            if not fit.converged or not _is_bent(problem, sigma, fit, free, int(i), slopes[i] * errors[i], change):
                continue
        bounds[int(i)] = _bounds_of(problem, sigma, at, free, int(i), errors[i], limit)
        end = bounds[int(i)][int(from_low[i] <= from_high[i])]
        if is_near[i] and end is not None:
            is_told[i] = slopes[i] * errors[i] < _AS_NORMAL * abs(end - own[i])
    return bounds, is_told


def _is_bent(
    problem: Problem, sigma: np.ndarray, fit: Fit, free: Free, which: int, error: float, change: np.ndarray
) -> bool:
    """Whether the root of what chi-squared grows by is another one than the standard `error` of a number promises.

    So it is where a slip or a stick appears within the error, or where this is large. Looked at on both sides of the
    number `which`, where the coordinates `change` so, to first order to keep chi-squared least; the starts too.
    """
    at, seen, transform = fit.point, fit.seen.over(sigma), problem.model.transform
    number, least = len(at.x), chi_squared(seen)
    slopes = seen.slopes.reshape(len(at.s), -1, seen.slopes.shape[-1])
    starts = np.zeros_like(at.s)
    if free.s:
        starts = np.stack([-np.linalg.lstsq(one[:, number:], one[:, :number] @ change)[0] for one in slopes])
    for sign in (1.0, -1.0):
        beside = Point(np.clip(at.x + sign * change, *transform.box), at.s + sign * starts)
        promised = abs(transform.own(beside.x)[which] - transform.own(at.x)[which]) / error
        grown = np.sqrt(max(chi_squared(problem.seen(beside).over(sigma)) - least, 0))
        if not promised / _AS_STRAIGHT < grown < promised * _AS_STRAIGHT:
            return True
    return False


def _bounds_of(
    problem: Problem, sigma: np.ndarray, at: Point, free: Free, which: int, error: float, limit: float
) -> Bounds:
    """How far the number `which`, or how much it is above the one it is counted from, can go down and up until the
    record contradicts it, all others fitted again.

    One-sided: chi-squared has then grown by the square of `limit`. `error`: about the standard error of the coordinate.
    """
    others = Free(free.x & (np.arange(len(free.x)) != which), free.s)
    least = chi_squared(problem.search(sigma, at, others).seen.over(sigma))
    first = min(2 * error, _FARTHEST_FIRST)
    ends = [float(end[which]) for end in problem.model.transform.box]

    def edge(direction: float) -> float | None:
        point = at

        def beyond(to: float) -> float:
            """How far the root of what chi-squared has grown by is beyond the limit."""
            nonlocal point
            x = point.x.copy()
            x[which] = to
            try:
                fit = problem.search(sigma, Point(x, point.s), others)
            except ValueError:  # no motion there reaches the end of its window
                return _NO_MOTION
            over = np.sqrt(max(chi_squared(fit.seen.over(sigma)) - least, 0)) - limit
            point = fit.point if over <= 0 else point
            return float(over) if np.isfinite(over) else _NO_MOTION

        inside = at.x[which]
        for doubling in range(_DOUBLINGS + int(np.log2(_FARTHEST_FIRST / first))):
            to = float(np.clip(at.x[which] + direction * 2.0**doubling * first, ends[0], ends[1]))
            if to == inside:  # the number's own bound is allowed
                return None
            if beyond(to) > 0:
                break
            inside = to
        else:
            return None
        x = at.x.copy()
        x[which] = optimize.brentq(beyond, inside, to, xtol=_RESOLUTION * first)
        return float(problem.model.transform.own(x)[which])

    return Bounds(edge(-1.0), edge(1.0))
