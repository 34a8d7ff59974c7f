"""Derivatives by a few numbers, computed in forward mode along with a long loop, for reverse mode too.

Reverse mode through a loop goes back over every step: it keeps states on the way or computes them again, and takes
several times as long as the loop. Most derivatives that are asked for are by one number or a few (a friction
coefficient, say). Their slopes, computed along with the loop in forward mode, cost less each; reverse mode then only
multiplies by them.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from .._compiler import native_loop


def with_slopes(function: Callable[..., Any], *args: Any, most: int) -> Any:
    """``function(*args)``, arrays in any structure, whose derivatives by at most so many scalars are computed along
    with it; derivatives by more, or by arrays, go back over the steps.

    They are the derivatives of JAX, of every order and in every mode; only the way to the first one differs.
    """
    # Whole numbers too: what is enclosed here and traced would be a constant, which JAX cannot lower.
    numbers, rest = eqx.partition(args, eqx.is_array)
    leaves, tree = jax.tree.flatten(numbers)
    structure = []

    def flat(*leaves):
        results, others = eqx.partition(function(*eqx.combine(jax.tree.unflatten(tree, leaves), rest)), eqx.is_array)
        results, shape = jax.tree.flatten(results)
        structure.append((shape, others))
        return results

    # What `function` encloses may carry derivatives too: friction curves are functions that users write.
    closed, enclosed = jax.closure_convert(flat, *leaves)
    results = _with_rule(closed, most)(*leaves, *enclosed)
    shape, others = structure[0]
    return eqx.combine(jax.tree.unflatten(shape, results), others)


def _with_rule(function: Callable[..., list[Any]], most: int) -> Callable[..., list[Any]]:
    """`function` with the rule for its derivatives; both are native loops, but for the way back over the steps."""
    call = jax.custom_jvp(native_loop(function, known_only=True))

    def rule(primals, tangents):
        points, changes, of = _moved(function, primals, tangents)
        if len(points) > most or any(np.ndim(point) for point in points):
            return jax.jvp(of, points, changes)
        moves = tuple(not isinstance(tangent, SymbolicZero) for tangent in tangents)
        results, slopes = _slopes_of(function, moves)(*primals)
        return results, [_times(changes, result, slope) for result, slope in zip(results, slopes, strict=True)]

    call.defjvp(rule, symbolic_zeros=True)
    return call


def _slopes_of(function: Callable[..., list[Any]], moves: tuple[bool, ...]) -> Callable[..., Any]:
    """The results of `function`, and their slopes by the arguments that move; the derivatives of both are JAX's."""

    def slopes(*primals):
        points, of = _of_those(function, primals, moves)
        return _slopes(of, points)

    call = jax.custom_jvp(native_loop(slopes, known_only=True))

    def rule(primals, tangents):
        points, changes, of = _moved(slopes, primals, tangents)
        return jax.jvp(of, points, changes)

    call.defjvp(rule, symbolic_zeros=True)
    return call


def _moved(
    function: Callable[..., Any], primals: Any, tangents: Any
) -> tuple[list[Any], list[Any], Callable[..., Any]]:
    """The arguments that have a tangent, these tangents, and `function` of those arguments alone."""
    moves = [not isinstance(tangent, SymbolicZero) for tangent in tangents]
    points, of = _of_those(function, primals, moves)
    return points, [tangent for tangent, m in zip(tangents, moves, strict=True) if m], of


def _of_those(
    function: Callable[..., Any], primals: Any, moves: Sequence[bool]
) -> tuple[list[Any], Callable[..., Any]]:
    """The arguments that move, and `function` of those alone."""

    def of(*some):
        given = iter(some)
        return function(*(next(given) if m else value for value, m in zip(primals, moves, strict=True)))

    return [value for value, m in zip(primals, moves, strict=True) if m], of


def _slopes(function: Callable[..., list[Any]], points: list[Any]) -> tuple[list[Any], list[Any]]:
    """The results, and the slopes of each by every number: (numbers, ...)."""
    directions = [jnp.eye(len(points), dtype=jnp.result_type(point))[k] for k, point in enumerate(points)]
    if len(points) == 1:
        results, slopes = jax.jvp(function, points, [direction[0] for direction in directions])
        return results, [slope[None] for slope in slopes]
    results, slopes = jax.vmap(lambda *directions: jax.jvp(function, points, list(directions)))(*directions)
    return [result[0] for result in results], slopes


def _times(changes: list[Any], result: Any, slopes: Any) -> Any:
    if not jnp.issubdtype(result.dtype, jnp.inexact):
        return np.zeros(result.shape, jax.dtypes.float0)
    return sum((change * slope for change, slope in zip(changes, slopes, strict=True)), jnp.zeros_like(result))
