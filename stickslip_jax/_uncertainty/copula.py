"""Correlated random numbers: a Gaussian copula."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.scipy.special import ndtr, ndtri

from .. import _checks
from .._methods import Module
from .._types import AnyArray, FloatArray

_ROUND_OFF = 1e-6
"""How far from symmetric, or from 1 on the diagonal, a matrix may be: correlations that were stored in float32."""


def _as_names(names: object) -> tuple[str, ...]:
    found = tuple(names) if isinstance(names, Sequence) and not isinstance(names, (str, bytes, range)) else ()
    if len(found) < 2 or not all(isinstance(name, str) and name for name in found) or len(set(found)) < len(found):
        raise _checks.refused(
            "names", "hold two or more different names of random numbers, such as ('mu', 'stiffness')", names
        )
    return found


def _as_matrix(name: str, matrix: Any) -> AnyArray:
    if _checks.is_traced(matrix):
        return matrix
    _checks.numeric(name, matrix, ndim=2)
    return np.asarray(matrix, np.float64)


class GaussianCopula(Module):
    """Random numbers that depend on each other: each has its own distribution, their normal scores are correlated.

    The normal score of a number x with distribution function F is ``z = ndtri(F(x))``; the scores are jointly normal
    (Nataf 1962).

    - `names`: of the numbers that are correlated, at least two, such as ``("mu", "stiffness")``.
    - `correlation`: (names, names), Pearson's correlations of their normal scores, in the order of `names`. Of numbers
      that are not normally distributed, Pearson's correlations are a little smaller in size; for rank correlations take
      `from_spearman`.

    Raises ValueError for names that are not distinct, and for a matrix that is not symmetric, has not 1 on its
    diagonal, or is not positive definite.
    """

    names: tuple[str, ...] = eqx.field(converter=_as_names, static=True)
    correlation: AnyArray = eqx.field(converter=lambda matrix: _as_matrix("correlation", matrix))

    def __check_init__(self):
        _check_correlation("correlation", self.correlation, len(self.names))

    @classmethod
    def from_spearman(cls, names: Sequence[str], matrix: npt.ArrayLike) -> "GaussianCopula":
        """The copula whose numbers have these rank correlations, whatever their distributions.

        - `matrix`: (names, names), Spearman's correlations rho; those of the normal scores are ``2 sin(pi rho / 6)``
          (Pearson 1907).

        Raises ValueError for what the constructor refuses, and for rank correlations that no Gaussian copula has.
        """
        names, matrix = _as_names(names), _as_matrix("matrix", matrix)
        _check_correlation("matrix", matrix, len(names))
        module = jnp if _checks.is_traced(matrix) else np
        scores = 2 * module.sin(module.pi / 6 * module.asarray(matrix))
        if not _checks.is_traced(scores):
            _check_definite("matrix", scores, "normal scores with these rank correlations", "2 sin(pi rho / 6)")
        return cls(names, scores)

    def correlated(self, u: FloatArray) -> FloatArray:
        """Uniform numbers with this dependence, made of independent ones.

        - `u`: (..., names), in (0, 1), in the order of `names`.

        Returns an array of the same shape and precision, in (0, 1). The first number stays as it is but for round-off,
        the others move; all change smoothly with `u` and with the correlations. Raises ValueError for another last
        dimension.
        """
        if jnp.ndim(u) == 0 or jnp.shape(u)[-1] != len(self.names):
            raise ValueError(
                f"Argument u must have a last dimension of {len(self.names)}, one number for each of "
                f"{', '.join(self.names)}, but an array of shape {jnp.shape(u)} was given."
            )
        z = ndtri(jnp.asarray(u, jnp.result_type(u, jnp.float32)))
        module = jnp if _checks.is_traced(self.correlation) else np
        root = jnp.asarray(module.linalg.cholesky(self.correlation), z.dtype)[(None,) * (z.ndim - 1)]
        # One term after the other: a product of matrices may round differently for other numbers of samples.
        scores = sum(root[..., index] * z[..., index, None] for index in range(len(self.names)))
        limits = jnp.finfo(z.dtype)
        return jnp.clip(ndtr(scores), limits.tiny, 1 - limits.epsneg)


def _check_correlation(name: str, matrix: AnyArray, number: int) -> None:
    if np.shape(matrix) != (number, number):
        raise ValueError(
            f"Argument {name} must have shape ({number}, {number}), a row and a column for each of the names, but an "
            f"array of shape {np.shape(matrix)} was given."
        )
    if _checks.is_traced(matrix):
        return
    uneven = np.argwhere(np.abs(matrix - matrix.T) > _ROUND_OFF)
    if len(uneven):
        i, j = (int(part) for part in uneven[0])
        raise ValueError(
            f"Argument {name} must be symmetric, but {name}[{i}, {j}] = {matrix[i, j]} and {name}[{j}, {i}] = "
            f"{matrix[j, i]} were given."
        )
    wrong = np.abs(np.diag(matrix) - 1) > _ROUND_OFF
    if wrong.any():
        i = int(np.argmax(wrong))
        raise ValueError(
            f"Argument {name} must have 1 on its diagonal, but {name}[{i}, {i}] = {matrix[i, i]} was given; divide "
            "covariances by both standard deviations."
        )
    _check_definite(name, matrix, "random numbers", "it")


def _check_definite(name: str, matrix: AnyArray, of: str, what: str) -> None:
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if not smallest > _ROUND_OFF:
        raise ValueError(
            f"Argument {name} must be positive definite, or no {of} exist, but the smallest eigenvalue of {what} is "
            f"{smallest:.3g}; make correlations smaller, or leave out a number that others determine."
        )
