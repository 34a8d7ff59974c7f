"""What a record says about each number: covariances, and numbers that it does not tell."""

from typing import NamedTuple

import numpy as np
from scipy import linalg

from .fit import LOOSE, Seen

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


def information_of(seen: Seen, number: int) -> Information:
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
    scores = _scores(matrix, seen.residuals.ravel())
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


def _scores(matrix: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """The covariance of the gradient, from its parts by blocks of the record that are taken as independent."""
    blocks = min(_BLOCKS, max(len(residuals) // 10, 2))
    parts = np.stack([part.sum(axis=0) for part in np.array_split(matrix * residuals[:, None], blocks)])
    return parts.T @ parts * blocks / max(blocks - 1, 1)


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of what the columns span, (residuals, rank)."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > _NO_INFLUENCE] / size[size > _NO_INFLUENCE]
    if not columns.shape[1]:
        return columns
    basis, singular, _ = linalg.svd(columns, full_matrices=False)
    return basis[:, singular > _NO_INFLUENCE * singular[0]]
