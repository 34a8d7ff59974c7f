"""What a record says about each number: covariances, and numbers that it cannot tell."""

from typing import NamedTuple

import numpy as np
from scipy import linalg

from .fit import Seen

_NO_INFLUENCE = 1e-9  # of all that the residuals depend on, or of a direction among the numbers
_BLOCKS = 40  # parts of the record that are taken as independent


class Information(NamedTuple):
    """Covariance of the numbers searched, (numbers, numbers), for white noise and by blocks of the record; infinite
    for those that the record does not tell.

    `silent`: numbers that nothing depends on. `tied`: directions along which nothing changes, (directions, numbers).
    `lost`: how many states at starts nothing depends on.
    """

    covariance: np.ndarray
    by_blocks: np.ndarray
    silent: np.ndarray
    tied: np.ndarray
    lost: int


def information_of(seen: Seen, number: int) -> Information:
    """What standardised residuals and their derivatives say of the first `number` numbers.

    The other ones, the states at the windows' starts, are taken out: each window's derivatives are projected on what
    its own state cannot explain.
    """
    windows = len(seen.slopes)
    slopes = seen.slopes.reshape(windows, -1, seen.slopes.shape[-1])
    residuals = seen.residuals.reshape(windows, -1)
    of_x, lost = np.empty((*slopes.shape[:2], number)), 0
    for window, both in enumerate(slopes):
        own = _orthonormal(both[:, number:])
        lost += both.shape[1] - number - own.shape[1]
        of_x[window] = both[:, :number] - own @ (own.T @ both[:, :number])
    matrix, whole = of_x.reshape(-1, number), slopes[..., :number].reshape(-1, number)
    size, before = np.linalg.norm(matrix, axis=0), np.linalg.norm(whole, axis=0)
    silent = size <= _NO_INFLUENCE * np.maximum(before, 1)
    heard = np.flatnonzero(~silent)
    covariance, by_blocks = np.full((number, number), np.inf), np.full((number, number), np.inf)
    tied = np.zeros((0, number))
    if len(heard):
        scaled = matrix[:, heard] / size[heard]
        _, singular, directions = linalg.svd(scaled, full_matrices=False)
        good = singular > _NO_INFLUENCE**0.5 * singular[0]
        tied = np.zeros((np.count_nonzero(~good), number))
        tied[:, heard] = directions[~good] / size[heard]
        inverse = (directions[good].T / singular[good] ** 2) @ directions[good]
        scores = _scores(scaled, residuals.ravel())
        tells = ~np.any(np.abs(directions[~good]) > 1e-4, axis=0)
        for into, middle in ((covariance, None), (by_blocks, scores)):
            found = inverse if middle is None else inverse @ middle @ inverse
            found = found / (size[heard][:, None] * size[heard])
            found[~tells], found[:, ~tells] = np.inf, np.inf
            into[np.ix_(heard, heard)] = found
    return Information(covariance, by_blocks, silent, tied, lost)


def _scores(matrix: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """The covariance of the gradient, from its parts by blocks of the record that are taken as independent."""
    blocks = min(_BLOCKS, max(len(residuals) // 10, 2))
    parts = np.stack([part.sum(axis=0) for part in np.array_split(matrix * residuals[:, None], blocks)])
    return parts.T @ parts * blocks / max(blocks - 1, 1)


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of what the columns span, (residuals, rank)."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > _NO_INFLUENCE] / size[size > _NO_INFLUENCE]
    if not columns.shape[1]:
        return columns
    basis, singular, _ = linalg.svd(columns, full_matrices=False)
    return basis[:, singular > _NO_INFLUENCE * singular[0]]
