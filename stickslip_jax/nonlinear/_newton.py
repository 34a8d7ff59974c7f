"""Newton's method for return maps, whose roots have the derivatives of what they are roots of."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from .._numerics.orthogonal import solution
from .._types import BoolScalar, FloatArray, FloatScalar, IntArray

_HALVINGS = 8
_LEAST = 0.5  # a smaller gain near the end is round-off


class Found(NamedTuple):
    """Of a root: the derivative of the function there (size, size), and the residuals: of the guess, and after each
    iteration that made it smaller (NaN after the last).
    """

    matrix: FloatArray
    residuals: FloatArray


class _State(NamedTuple):
    """The best point `z` so far, its `residual`, and the `matrix` there; and the point to `try` next, ``z + step`` of a
    Newton step that was halved so many times.
    """

    z: FloatArray
    residual: FloatScalar
    matrix: FloatArray
    step: FloatArray
    halvings: IntArray
    residuals: FloatArray
    number: IntArray
    goes_on: BoolScalar


def root_of(
    function: Callable[[FloatArray], FloatArray],
    size_of: Callable[[FloatArray, FloatArray], FloatScalar],
    guess: FloatArray,
    tolerance: FloatScalar,
    iterations: int,
) -> tuple[FloatArray, Found]:
    """A root of `function` (size,) near `guess`, and how it was found.

    `size_of` a residual at a point: relative, without unit. A step that makes it larger is halved. The derivatives of
    the root are those of the implicit function, of every order, as `lax.custom_root` has them.
    """

    def solve(function, guess):
        unit = jnp.eye(len(guess), dtype=guess.dtype)

        # The function stands here once: it is a whole simulation, which takes seconds to compile.
        def one(state: _State) -> _State:
            z = state.z + state.step
            push = jax.vmap(lambda direction: jax.jvp(function, (z,), (direction,)), out_axes=(None, 1))
            value, matrix = push(unit)
            residual = size_of(z, value)
            better = residual < state.residual
            number = state.number + better
            chosen = jnp.where(better, residual, state.residual)
            goes_on = better & (residual > 0) & ((residual > tolerance) | (residual < _LEAST * state.residual))
            return _State(
                jnp.where(better, z, state.z),
                chosen,
                jnp.where(better, matrix, state.matrix),
                jnp.where(better, solution(matrix, -value), state.step / 2),
                jnp.where(better, 0, state.halvings + 1),
                state.residuals.at[number].set(chosen),
                number,
                goes_on | (~better & (state.residual > tolerance) & (state.halvings < _HALVINGS)),
            )

        none, most = jnp.zeros((), jnp.int32), jnp.full((), jnp.inf, guess.dtype)
        residuals = jnp.full(iterations + 1, jnp.nan, guess.dtype)
        begun = _State(guess, most, jnp.zeros_like(unit), jnp.zeros_like(guess), none, residuals, none - 1, most > 0)
        done = lax.while_loop(lambda state: state.goes_on & (state.number < iterations), one, begun)
        return done.z, Found(done.matrix, done.residuals)

    def tangent(linear, target):
        return solution(jax.vmap(linear, out_axes=1)(jnp.eye(len(target), dtype=target.dtype)), target)

    return lax.custom_root(function, guess, solve, tangent, has_aux=True)
