"""What a record says about each number: its error, the bounds of what it does not tell, and what may be wrong with
the record where the residuals are not white.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy import linalg, optimize, stats

from .._dynamics.common.method import Arguments
from .._dynamics.simulate import simulate
from .record import Record, Windows
from .search import LOOSE, FoundFit, Free, Residuals, SearchPoint

# What a record says about each number: covariances, and numbers that it does not tell.


_NO_INFLUENCE = 1e-9  # of all that the residuals depend on
_UNTOLD = 0.3  # standard error of what is searched: beyond it, that of a positive number says little
_ALONE = 0.05  # share of other numbers in a direction that is that of one number
_BLOCKS = 40  # parts of the record that are taken as independent


class Information(NamedTuple):
    """Covariance of the numbers searched, (numbers, numbers), for white noise and by blocks of the record.

    `untold`: which those are, (numbers,). `tied`: directions among several of them along which nothing changes,
    (directions, numbers); the other ones are untold each by itself. `lost`: how many states at starts, and directions
    among the numbers, nothing depends on.
    """

    covariance: np.ndarray
    by_blocks: np.ndarray
    untold: np.ndarray
    tied: np.ndarray
    lost: int


def information_of(seen: Residuals, number: int) -> Information:
    """What standardised residuals and their derivatives say of the first `number` numbers.

    The other ones, the states at the windows' starts, are taken out: each window's derivatives are projected on what
    its own state cannot explain. All numbers are loosely held where they are, as in the search.
    """
    matrix, lost = without_states(seen.slopes, number)
    inverse = np.linalg.inv(matrix.T @ matrix + LOOSE**2 * np.eye(number))
    variances, directions = np.linalg.eigh(inverse)
    untold, loose = np.diag(inverse) > _UNTOLD**2, directions.T[variances > _UNTOLD**2]
    tied = loose if len(loose) < np.count_nonzero(untold) else loose[:0]
    alone = np.sum(np.abs(tied) > _ALONE * np.max(np.abs(tied), axis=1, initial=0, keepdims=True), axis=1) == 1
    # The covariance of the gradient, from its parts by blocks of the record that are taken as independent.
    blocks = min(_BLOCKS, max(len(matrix) // 10, 2))
    along = matrix * seen.residuals.ravel()[:, None]
    parts = np.stack([part.sum(axis=0) for part in np.array_split(along, blocks)])
    scores = parts.T @ parts * blocks / max(blocks - 1, 1)
    return Information(inverse, inverse @ scores @ inverse, untold, tied[~alone], lost + len(loose))


def without_states(slopes: np.ndarray, number: int) -> tuple[np.ndarray, int]:
    """The part of the first `number` columns that the others, states at starts, cannot explain in their own window,
    (residuals, number), and how many of the others nothing depends on. `slopes` (windows, channels, times, columns).
    """
    columns = slopes.reshape(len(slopes), -1, slopes.shape[-1])
    of_numbers, lost = np.empty((*columns.shape[:2], number)), 0
    for window, both in enumerate(columns):
        own = orthonormal(both[:, number:])
        lost += both.shape[1] - number - own.shape[1]
        of_numbers[window] = both[:, :number] - own @ (own.T @ both[:, :number])
    return of_numbers.reshape(-1, number), lost


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of what the columns span, (residuals, rank)."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > _NO_INFLUENCE] / size[size > _NO_INFLUENCE]
    return linalg.orth(columns, rcond=_NO_INFLUENCE) if columns.shape[1] else columns


# Bounds of numbers by the profile of the likelihood: of those on which the fitted motion does not depend, those near
# their own bound, and those whose standard error does not tell how far they can go.


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


def all_bounds(found: FoundFit, told: Information, freedom: float) -> tuple[dict[int, Bounds], np.ndarray]:
    """The bounds by the record of the numbers, by place, that it does not tell, each by itself, of those near a bound
    that they may have, and of those around which chi-squared is no parabola; and which numbers the record tells,
    (parameters,). `freedom`: degrees of freedom of the noise, infinite where it is known: chi-squared may grow by the
    square of the 95 % quantile of Student's t with so many.

    Near its bound a number need not be known to 30 % to be told: the record only has to say how far away it can be.
    """
    at, transform, is_told = found.point, found.problem.model.transform, ~told.untold
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
            if not found.converged or not _is_bent(found, int(i), slopes[i] * errors[i], change):
                continue
        bounds[int(i)] = _bounds_of(found, int(i), errors[i], limit)
        end = bounds[int(i)][int(from_low[i] <= from_high[i])]
        if is_near[i] and end is not None:
            is_told[i] = slopes[i] * errors[i] < _AS_NORMAL * abs(end - own[i])
    return bounds, is_told


def _is_bent(found: FoundFit, which: int, error: float, change: np.ndarray) -> bool:
    """Whether the root of what chi-squared grows by is another one than the standard `error` of a number promises.

    So it is where a slip or a stick appears within the error, or where this is large. Looked at on both sides of the
    number `which`, where the coordinates `change` so, to first order to keep chi-squared least; the starts too.
    """
    at, seen, transform = found.point, found.seen, found.problem.model.transform
    number = len(at.x)
    slopes = seen.slopes.reshape(len(at.s), -1, seen.slopes.shape[-1])
    starts = np.zeros_like(at.s)
    if found.free.s:
        starts = np.stack([-np.linalg.lstsq(one[:, number:], one[:, :number] @ change)[0] for one in slopes])
    for sign in (1.0, -1.0):
        beside = SearchPoint(np.clip(at.x + sign * change, *transform.box), at.s + sign * starts)
        promised = abs(transform.own(beside.x)[which] - transform.own(at.x)[which]) / error
        grown = np.sqrt(max(found.problem.seen(beside).over(found.sigma).chi_squared - seen.chi_squared, 0))
        if not promised / _AS_STRAIGHT < grown < promised * _AS_STRAIGHT:
            return True
    return False


def _bounds_of(found: FoundFit, which: int, error: float, limit: float) -> Bounds:
    """How far the number `which`, or how much it is above the one it is counted from, can go down and up until the
    record contradicts it, all others fitted again.

    One-sided: chi-squared has then grown by the square of `limit`. `error`: about the standard error of the coordinate.
    """
    problem, free, sigma, at = found.problem, found.free, found.sigma, found.point
    others = Free(free.x & (np.arange(len(free.x)) != which), free.s)
    least = problem.search(sigma, at, others).seen.chi_squared
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
                fit = problem.search(sigma, SearchPoint(x, point.s), others)
            except ValueError:  # no motion there reaches the end of its window
                return _NO_MOTION
            over = np.sqrt(max(fit.seen.chi_squared - least, 0)) - limit
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


# What may be wrong where residuals are not white: a clock, a zero, a unit.


_CLEAR = 0.2  # of chi-squared: what another number must explain to be named
_OTHER_UNIT = 30.0  # times as large as the first guesses move, or as small


def explanations(record: Record, windows: Windows, seen: Residuals, sigma: np.ndarray, number: int) -> list[str]:
    """What another number that is not searched would do to chi-squared, to first order, the best one; if any does.

    `seen`: standardised, with derivatives by the `number` parameters and the states at starts.
    """
    kinds = ["clock.delay", *(f"{one.name}.{kind}" for one in record.channels for kind in ("delay", "offset"))]
    units = ["s", *(unit for one in record.channels for unit in ("s", one.unit))]
    columns = np.zeros((*seen.residuals.shape, len(kinds)))
    predicted = seen.residuals + windows.values / sigma[:, None]
    for window, channel in np.ndindex(*seen.residuals.shape[:2]):
        there = windows.is_measured[window, channel]
        if np.count_nonzero(there) > 2:
            rate = -np.gradient(predicted[window, channel, there], windows.times[window, there])
            columns[window, channel, there, 0] = columns[window, channel, there, 1 + 2 * channel] = rate
        columns[window, channel, there, 2 + 2 * channel] = 1 / sigma[channel]
    free, _ = without_states(np.concatenate([columns, seen.slopes], axis=-1), len(kinds) + number)
    searched = orthonormal(free[:, len(kinds) :])
    own = free[:, : len(kinds)] - searched @ (searched.T @ free[:, : len(kinds)])
    size = np.sum(own**2, axis=0)
    known = size > 1e-6 * np.sum(columns**2, axis=(0, 1, 2))
    along = own.T @ seen.residuals.ravel()
    gains = np.where(known, along**2 / np.where(known, size, 1), 0)
    best, total = int(np.argmax(gains)), float(np.sum(seen.residuals**2))
    if gains[best] < _CLEAR * total:
        return []
    return [
        f"{kinds[best]}, about {-along[best] / size[best]:.2g} {units[best]}, would lower chi-squared by about "
        f"{gains[best]:.3g}: search it too, by its name in wrt."
    ]


def other_units(record: Record, arguments: Arguments, start: np.ndarray) -> list[str]:
    """Channels whose measurements are by far larger, or smaller, than the motion with the first guesses."""
    system, base, method, t1 = arguments
    motion = simulate(system, base, t1=t1, y0=tuple(map(float, start)), method=method)
    said = []
    for channel, row in zip(record.channels, record.values, strict=True):
        shown = np.asarray(channel.observe(motion, jnp.asarray(record.times)))
        spread, moves = float(np.nanstd(row)), float(np.nanstd(shown))
        if moves > 0 and np.isfinite(moves) and not 1 / _OTHER_UNIT < spread / moves < _OTHER_UNIT:
            unit = f" {channel.unit}" if channel.unit else ""
            said.append(
                f"What was measured of {channel.name} scatters by {spread:.2g}{unit}, the motion with the first "
                f"guesses by {moves:.2g}: is its unit, and that of the base, the right one?"
            )
    return said
