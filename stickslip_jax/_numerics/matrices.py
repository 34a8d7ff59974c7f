"""Small matrices without LAPACK: products, solutions, orthogonal bases, reductions over contacts."""

from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from .._compiler.programs import kept_jit
from .._foundation import checks
from .._foundation.types import BoolArray, BoolScalar, DType, FloatArray, FloatScalar, IntArray
from .derivatives import without_derivatives

# Products of small matrices, solutions of their linear equations and what of their eigenvalues is needed: in lanes.
#
# Nothing here calls LAPACK: with jaxlib 0.10, a program for the CPU in which several of its functions may run at once,
# each on thousands of matrices, waits for itself for ever (`test_small_matrices.py`).
#
# What has a loop is compiled by `jax.jit`, and so once: where it is called outside a program, as when an ensemble
# begins, JAX would compile the loop anew in every call.


WRITTEN_OUT = 8
"""Sizes of matrices, up to which their algebra is written out: vectorised over lanes, unlike a call of a library."""
_MOST_BANDS = 5  # of a matrix that is stored by its bands


class Banded(eqx.Module):
    """A matrix (rows, columns) by the diagonals in which it has numbers other than zero.

    `bands`: (offsets, rows), the entries ``(i, i + offset)`` for each of the `offsets`; zero outside the matrix.
    """

    bands: FloatArray
    offsets: tuple[int, ...] = eqx.field(static=True)
    columns: int = eqx.field(static=True)

    def __matmul__(self, values: FloatArray) -> FloatArray:
        """The product with `values` (columns,)."""
        rows = self.bands.shape[1]
        before = max(0, -min(self.offsets))
        behind = max(0, rows + max(self.offsets) - self.columns)
        padded = values
        if before or behind:
            padded = jnp.concatenate([jnp.zeros(before, values.dtype), values, jnp.zeros(behind, values.dtype)])
        starts = [before + offset for offset in self.offsets]
        return reduce(add, (band * padded[at : at + rows] for band, at in zip(self.bands, starts, strict=True)))


Matrix: TypeAlias = FloatArray | Banded


def by_bands(matrix: Matrix) -> Matrix:
    """A large `matrix` with few bands as `Banded`, where its numbers are known; else as it is."""
    if isinstance(matrix, Banded) or checks.is_traced(matrix) or max(matrix.shape) <= WRITTEN_OUT:
        return matrix
    numbers = np.asarray(matrix)
    offsets = np.unique(np.subtract(*np.nonzero(numbers)[::-1]))
    if not 0 < len(offsets) <= _MOST_BANDS:
        return matrix
    row = np.arange(len(numbers))
    column = row + offsets[:, None]
    inside = (column >= 0) & (column < numbers.shape[1])
    bands = np.where(inside, numbers[row, np.where(inside, column, 0)], 0)
    return Banded(jnp.asarray(bands), tuple(map(int, offsets)), numbers.shape[1])


def dense(matrix: Matrix) -> FloatArray:
    """All entries of a matrix, (rows, columns)."""
    if not isinstance(matrix, Banded):
        return matrix
    return jax.vmap(lambda unit: matrix @ unit, out_axes=1)(jnp.eye(matrix.columns, dtype=matrix.bands.dtype))


def magnitudes(matrix: Matrix) -> Matrix:
    """The absolute values of all entries."""
    return jax.tree.map(jnp.abs, matrix)


def times(matrix: Matrix, values: FloatArray) -> FloatArray:
    """The product with `values` (columns, ...)."""
    if isinstance(matrix, Banded) or len(values) > WRITTEN_OUT:
        return matrix @ values
    # XLA fuses sums of few terms with what surrounds them.
    if values.ndim == 1:
        return reduce(add, (matrix[:, j] * values[j] for j in range(len(values))))
    return reduce(add, (matrix[:, j, None] * values[None, j] for j in range(len(values))))


def inner(one: FloatArray, other: FloatArray) -> FloatScalar:
    """The inner product of two vectors."""
    return times(one[None, :], other)[0]


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


def eliminated(matrix: list[list[FloatArray]], sides: list[list[FloatArray]]) -> list[tuple[FloatArray, ...]]:
    """The solutions of small linear systems with numbers as entries, by elimination.

    Without pivoting, which steps shorter than the time scales do not need: the matrix is near the identity, or has a
    large positive diagonal where a state decays fast.
    """
    rows = [[*line, *(side[i] for side in sides)] for i, line in enumerate(matrix)]
    size = len(rows)
    for i in range(size):
        per = 1 / rows[i][i]
        rows[i] = [value * per for value in rows[i]]
        for j in range(size):
            if j != i:
                factor = rows[j][i]
                rows[j] = [a - factor * b for a, b in zip(rows[j], rows[i], strict=True)]
    return [tuple(rows[i][size + k] for i in range(size)) for k in range(len(sides))]


@kept_jit
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
        # Not a dot product, which XLA (jaxlib 0.10.2) refuses in some loops.
        squared = jnp.sum(scaled[:, :, None] * scaled[None, :, :], axis=1)
        return squared, logarithm + weight * jnp.log(jnp.where(size > 0, size, 1)), weight / 2

    one = jnp.ones((), matrix.dtype)
    _, logarithm, _ = lax.fori_loop(0, 41, square, (matrix, jnp.zeros_like(one), one))
    return jnp.where(jnp.any(matrix != 0), jnp.exp(logarithm), 0)


@kept_jit
def is_positive_definite(matrix: FloatArray) -> BoolScalar:
    """Whether a symmetric matrix is: all pivots are positive."""
    pivots = jnp.diagonal(_cleared(matrix))
    return jnp.all(pivots > 0)


@kept_jit
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


MANY = 16
"""Numbers of a state, beyond which they are one array for JAX, not each by itself."""
_GROUP = 64


def stacked(values: Sequence[Any], dtype: DType) -> Array:
    """Numbers, or arrays of a shape, as one array.

    Many are stacked in groups, all by the same program: for a thousand operands XLA takes a minute.
    """
    given = [jnp.asarray(value, dtype) for value in values]
    return jnp.concatenate([jnp.stack(given[first : first + _GROUP]) for first in range(0, len(given), _GROUP)])


# Orthogonal bases by Gram and Schmidt, without LAPACK, which batches of many cannot call.


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


# Reductions over the contacts of a system.
#
# What belongs to each contact is an array (contacts,), and without that axis where there is one contact: a scalar of
# each trajectory, which compiles to faster loops.


def any_of(of_each: BoolArray) -> BoolScalar:
    """Whether it is true of any contact."""
    return of_each if of_each.ndim == 0 else jnp.any(of_each)


def largest_of(of_each: FloatArray) -> FloatScalar:
    """The largest of all contacts."""
    return of_each if of_each.ndim == 0 else jnp.max(of_each)


def sum_of(of_each: Array) -> Array:
    """The sum over the contacts."""
    return of_each if of_each.ndim == 0 else jnp.sum(of_each)
