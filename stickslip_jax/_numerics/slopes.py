"""Derivatives by a few numbers, computed in forward mode along with a long loop, for reverse mode too.

Reverse mode through a loop goes back over every step: it keeps states on the way or computes them again, and takes
several times as long as the loop. Most derivatives that are asked for are by one number or a few (a friction
coefficient, say). Their slopes, computed along with the loop in forward mode, cost less each; reverse mode then only
multiplies by them.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero


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
    call = jax.custom_jvp(function)

    def rule(primals, tangents):
        moved = [not isinstance(tangent, SymbolicZero) for tangent in tangents]
        changes = [tangent for tangent, m in zip(tangents, moved, strict=True) if m]

        def of(*some):
            given = iter(some)
            return function(*(next(given) if m else value for value, m in zip(primals, moved, strict=True)))

        points = [value for value, m in zip(primals, moved, strict=True) if m]
        if len(points) > most or any(np.ndim(point) for point in points):
            return jax.jvp(of, points, changes)

        results, slopes = _slopes(of, points)
        return results, [_times(changes, result, slope) for result, slope in zip(results, slopes, strict=True)]

    call.defjvp(rule, symbolic_zeros=True)
    return call


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
