"""The search for the numbers that explain a record best: nonlinear least squares, by scipy.

Every evaluation gives the residuals with all their derivatives, by one compiled program. So each problem is compiled
once, whatever is searched: all numbers, or some while others stay (`Free`).
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy import optimize, sparse

from .._types import AnyArray, FloatArray
from .problem import Model, with_slopes
from .record import Windows

_MOST_EVALUATIONS = 300
_TOLERANCE = 1e-9  # relative, of chi-squared and of the numbers
_LARGEST_DENSE = 1 << 22  # entries of the matrix of derivatives
_NEAR_BOUND = 0.3  # in coordinates: whether the record rather has the number at the bound itself is tried
LOOSE = 0.1
"""Weight of the distance from the first guess among the standardised residuals: a number that the record does not tell
stays there. One with a standard error of 1 % moves by less than a thousandth of that for it."""


class Point(NamedTuple):
    """Where a search stands: `x` (parameters,) and `s` (windows, coordinates), as the model takes them."""

    x: np.ndarray
    s: np.ndarray


class Free(NamedTuple):
    """Which numbers are searched: of the parameters, (parameters,), and whether the states at starts are."""

    x: np.ndarray
    s: bool


class Seen(NamedTuple):
    """Predictions less measurements (windows, channels, times), 0 where nothing was measured, and their derivatives
    (windows, channels, times, parameters + coordinates).
    """

    residuals: np.ndarray
    slopes: np.ndarray

    def over(self, sigma: np.ndarray) -> "Seen":
        """The same in units of the noise of each channel, (channels,)."""
        return Seen(self.residuals / sigma[:, None], self.slopes / sigma[:, None, None])


class Fit(NamedTuple):
    """The end of a search: where, what is seen there (not standardised), and whether it converged."""

    point: Point
    seen: Seen
    converged: bool


class Problem(NamedTuple):
    """A model and the windows of a record."""

    model: Model
    windows: Windows

    def seen(self, point: Point) -> Seen:
        """Residuals and derivatives at a point; NaN where a motion does not reach its window's end."""
        try:
            seen, slopes = map(np.asarray, _with_slopes(self.model, self.windows, point.x, point.s))
        except eqx.EquinoxRuntimeError:  # an implicit step found no solution
            shape = self.windows.is_measured.shape
            seen, slopes = np.full(shape, np.nan), np.full((*shape, len(point.x) + point.s.shape[1]), np.nan)
        there = self.windows.is_measured
        return Seen(np.where(there, seen - self.windows.values, 0), np.where(there[..., None], slopes, 0))

    def search(self, sigma: np.ndarray, start: Point, free: Free) -> Fit:
        """The least-squares fit from `start`, with the noise `sigma` (channels,)."""
        latest: list[tuple[np.ndarray, Seen]] = []

        def at(vector: np.ndarray) -> Seen:
            if not latest or not np.array_equal(latest[0][0], vector):
                latest[:] = [(vector.copy(), self.seen(_point(vector, start, free)))]
            return latest[0][1].over(sigma)

        begin, number = _vector(start, free), int(np.count_nonzero(free.x))
        rope = LOOSE * np.eye(number, len(begin))

        def residuals(vector: np.ndarray) -> np.ndarray:
            return np.concatenate([at(vector).residuals.ravel(), LOOSE * (vector[:number] - 1)])

        def jacobian(vector: np.ndarray):
            matrix = matrix_of(at(vector), free)
            return (
                np.vstack([matrix, rope]) if isinstance(matrix, np.ndarray) else sparse.vstack([matrix, rope]).tocsr()
            )

        if not len(begin):
            return Fit(start, self.seen(start), True)
        box = self.model.transform.box
        low, high = (
            np.pad(1 + end[free.x], (0, len(begin) - number), constant_values=beyond)
            for end, beyond in zip(box, (-np.inf, np.inf), strict=True)
        )
        options: dict[str, Any] = {"jac": jacobian, "x_scale": "jac", "max_nfev": _MOST_EVALUATIONS}
        tolerances: dict[str, Any] = {"ftol": _TOLERANCE, "xtol": _TOLERANCE, "gtol": None}
        found = optimize.least_squares(residuals, begin, bounds=(low, high), **options, **tolerances)
        fit = self._at(_point(found.x, start, free), found.status > 0)
        # SciPy comes as near to a bound as its tolerance asks, and never there; to some only slowly, as to static
        # friction as large as kinetic one, where nothing depends on the difference to first order.
        x = fit.point.x
        nearest = np.where(x - box[0] < box[1] - x, *box)
        ends = np.where(free.x & (np.abs(x - nearest) < _NEAR_BOUND), nearest, x)
        if np.array_equal(ends, x):
            return fit
        there = self._at(fit.point._replace(x=ends), fit.converged)
        most = chi_squared(fit.seen.over(sigma)) * (1 + _TOLERANCE)
        return there if chi_squared(there.seen.over(sigma)) <= most else fit

    def _at(self, point: Point, converged: bool) -> Fit:
        return Fit(point, self.seen(point), converged)


def matrix_of(seen: Seen, free: Free) -> np.ndarray | sparse.coo_matrix:
    """The derivatives of all residuals by all that is free, parameters first, (residuals, numbers)."""
    number, windows = len(free.x), len(seen.slopes)
    of_x = seen.slopes[..., :number][..., free.x].reshape(seen.residuals.size, np.count_nonzero(free.x))
    if not free.s:
        return of_x
    own = seen.slopes[..., number:].reshape(windows, -1, seen.slopes.shape[-1] - number)
    if of_x.shape[0] * (of_x.shape[1] + windows * own.shape[-1]) <= _LARGEST_DENSE:
        whole = np.zeros((windows, own.shape[1], windows, own.shape[2]))
        whole[np.arange(windows), :, np.arange(windows)] = own
        return np.hstack([of_x, whole.reshape(of_x.shape[0], -1)])
    return sparse.hstack([sparse.coo_matrix(of_x), sparse.block_diag(list(own))])  # pyright: ignore[reportReturnType]


def chi_squared(seen: Seen) -> float:
    """The sum of squares of standardised residuals."""
    return float(np.sum(np.square(seen.residuals)))


def _vector(point: Point, free: Free) -> np.ndarray:
    # SciPy's first step is up to as long as the vector where it begins: of length one in each number from its guess on.
    return np.concatenate([1 + point.x[free.x], point.s.ravel() if free.s else []])


def _point(vector: np.ndarray, start: Point, free: Free) -> Point:
    x, number = start.x.copy(), np.count_nonzero(free.x)
    x[free.x] = vector[:number] - 1
    return Point(x, vector[number:].reshape(start.s.shape) if free.s else start.s)


@eqx.filter_jit
def _with_slopes(model: Model, windows: Windows, x: AnyArray, s: AnyArray) -> tuple[FloatArray, FloatArray]:
    return with_slopes(model, windows, jnp.asarray(x), jnp.asarray(s))
