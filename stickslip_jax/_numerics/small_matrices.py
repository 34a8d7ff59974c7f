"""Products of small matrices, solutions of their linear equations and what of their eigenvalues is needed: in lanes.

Nothing here calls LAPACK: with jaxlib 0.10, a program for the CPU in which several of its functions may run at once,
each on thousands of matrices, waits for itself for ever (`test_small_matrices.py`).
"""

from functools import reduce
from operator import add

import jax.numpy as jnp
from jax import lax

from .._types import BoolScalar, FloatArray, FloatScalar, IntArray
from .primal import without_derivatives

WRITTEN_OUT = 8
"""Sizes of matrices, up to which their algebra is written out: vectorised over lanes, unlike a call of a library."""


def times(matrix: FloatArray, values: FloatArray) -> FloatArray:
    """The product with `values` (columns, ...)."""
    if len(values) > WRITTEN_OUT:
        return matrix @ values
    # XLA fuses sums of few terms with what surrounds them.
    if values.ndim == 1:
        return reduce(add, (matrix[:, j] * values[j] for j in range(len(values))))
    return reduce(add, (matrix[:, j, None] * values[None, j] for j in range(len(values))))


def linear_solve(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """The solution of ``matrix x = target``, for a matrix with a positive definite symmetric part: no pivots.

    `target`: (size,), or (size, sides) for as many solutions.
    """
    size = len(target)
    if size > WRITTEN_OUT:
        return _solution_of_many(matrix, target)
    rows = [[matrix[i, j] for j in range(size)] + [target[i]] for i in range(size)]
    for k in range(size):
        for i in range(k + 1, size):
            factor = rows[i][k] / rows[k][k]
            rows[i][k + 1 :] = [a - factor * b for a, b in zip(rows[i][k + 1 :], rows[k][k + 1 :], strict=True)]
    solution: list[FloatArray] = []
    for k in reversed(range(size)):
        known = sum((rows[k][k + 1 + j] * value for j, value in enumerate(solution)), jnp.zeros_like(target[0]))
        solution.insert(0, (rows[k][size] - known) / rows[k][k])
    return jnp.stack(solution)


def largest_eigenvalue(matrix: FloatArray) -> FloatScalar:
    """The largest size of an eigenvalue, where all are real: Gelfand's formula.

    The size of ``matrix**n`` to the power 1/n, n = 2^40: off by the logarithm of the condition of the eigenvectors
    over n.
    """

    def square(
        _: IntArray, state: tuple[FloatArray, FloatScalar, FloatScalar]
    ) -> tuple[FloatArray, FloatScalar, FloatScalar]:
        power, logarithm, weight = state
        size = jnp.max(jnp.abs(power))
        scaled = power / jnp.where(size > 0, size, 1)
        return scaled @ scaled, logarithm + weight * jnp.log(jnp.where(size > 0, size, 1)), weight / 2

    one = jnp.ones((), matrix.dtype)
    _, logarithm, _ = lax.fori_loop(0, 41, square, (matrix, jnp.zeros_like(one), one))
    return jnp.where(jnp.any(matrix != 0), jnp.exp(logarithm), 0)


def is_positive_definite(matrix: FloatArray) -> BoolScalar:
    """Whether a symmetric matrix is: all pivots are positive."""
    pivots = jnp.diagonal(_cleared(matrix))
    return jnp.all(pivots > 0)


def _solution_of_many(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """The derivative is that of the solution, not of the elimination, of which reverse mode would store each step."""

    def solve(_: object, side: FloatArray) -> FloatArray:
        return _eliminated(without_derivatives(matrix), side)

    def transposed(_: object, side: FloatArray) -> FloatArray:
        return _eliminated(without_derivatives(matrix).T, side)

    return lax.custom_linear_solve(lambda x: matrix @ x, target, solve, transposed)


def _eliminated(matrix: FloatArray, target: FloatArray) -> FloatArray:
    size = len(target)
    rows = _cleared(jnp.concatenate([matrix, target.reshape(size, -1)], axis=1))
    return (rows[:, size:] / jnp.diagonal(rows)[:, None]).reshape(target.shape)


def _cleared(matrix: FloatArray) -> FloatArray:
    """`matrix` (rows, columns), all but the diagonal of its first columns cleared: Gauss-Jordan elimination."""

    def clear(k: IntArray, rows: FloatArray) -> FloatArray:
        factors = jnp.where(jnp.arange(len(rows)) == k, 0, rows[:, k] / rows[k, k])
        return rows - factors[:, None] * rows[None, k]

    return lax.fori_loop(0, len(matrix), clear, matrix)
