"""Orthogonal bases by Gram and Schmidt, without LAPACK, which batches of many cannot call (`small_matrices.py`)."""

import jax.numpy as jnp
from jax import lax

from .._types import FloatArray, IntArray


def orthogonal_factors(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``matrix = q r`` (rows, columns) with orthonormal columns of `q` and `r` upper triangular, its diagonal >= 0.

    Each column is made orthogonal to those before it twice, which is enough for all digits (Giraud and others 2005).
    Where nothing but round-off is left of one, ``r`` holds how little that is, and the column of `q` is any direction
    orthogonal to those before.
    """
    rows, columns = matrix.shape
    eps = jnp.finfo(matrix.dtype).eps

    def without(q: FloatArray, column: FloatArray) -> tuple[FloatArray, FloatArray]:
        shares = jnp.sum(q * column[:, None], axis=0)
        return column - jnp.sum(q * shares[None, :], axis=1), shares

    def next_column(k: IntArray, found: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
        q, r = found
        column = matrix[:, k]
        rest, first = without(q, column)
        rest, second = without(q, rest)
        length = jnp.sqrt(jnp.sum(rest * rest))
        # The unit vector that those before leave most of: at least one over the root of the number of rows.
        free = jnp.argmin(jnp.sum(q * q, axis=1))
        spare, _ = without(q, jnp.zeros(rows, matrix.dtype).at[free].set(1))
        spare, _ = without(q, spare)
        spare = spare / jnp.sqrt(jnp.sum(spare * spare))
        vanishes = length <= 4 * eps * jnp.sqrt(jnp.sum(column * column))
        unit = jnp.where(vanishes, spare, rest / jnp.where(vanishes, 1, length))
        shares = (first + second).at[k].set(length)
        return q.at[:, k].set(unit), r.at[:, k].set(shares)

    return lax.fori_loop(0, columns, next_column, (jnp.zeros_like(matrix), jnp.zeros((columns, columns), matrix.dtype)))


def solution(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """The solution of ``matrix x = target`` (size,), any regular matrix."""
    q, r = orthogonal_factors(matrix)
    size = len(target)
    sides = jnp.sum(q * target[:, None], axis=0)

    def back(i: IntArray, x: FloatArray) -> FloatArray:
        k = size - 1 - i
        return x.at[k].set((sides[k] - jnp.sum(r[k] * x)) / r[k, k])

    return lax.fori_loop(0, size, back, jnp.zeros_like(target))
