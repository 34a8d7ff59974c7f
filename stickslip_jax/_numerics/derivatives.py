"""Derivatives: functions with one of their own that holds to every order, slopes along long loops, values without
them.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from .._compiler.native import flattened, native_loop, of_moving, sharing
from .._foundation import checks
from .._foundation.types import DType, FloatArray, PyTreeDef

# Functions with a derivative of their own that holds to every order, in every mode, inside loops too.
#
# ``jax.custom_jvp`` gives a function a rule for its first derivative; where the rule calls the function again, it holds
# to every order. But reverse mode through ``lax.scan`` replaces the call in the rule by the function's own operations
# (JAX 0.10), and where their derivatives differ from the rule, the second derivative is wrong without a word. A
# primitive stays one operation, with its rule.


_Leaf: TypeAlias = Any  # an array, traced or not, or a tangent: an array or ``ad.Zero``
_Axis: TypeAlias = int | None
_Rule: TypeAlias = Callable[[tuple[Any, ...], tuple[Any, ...]], tuple[tuple[_Leaf, ...], tuple[_Leaf, ...]]]
_call = Primitive("call_with_own_derivative")
_tangent = Primitive("tangent_of_call")
_call.multiple_results = _tangent.multiple_results = True


class _Level(NamedTuple):
    """A ``jax.vmap``: its size, and its axis in each argument."""

    size: int
    axes: tuple[_Axis, ...]


_Levels = tuple[_Level, ...]


class OwnDerivative:
    """`function`, a tuple of arrays, whose derivative is given by `def_jvp`, as for ``equinox.filter_custom_jvp``.

    The rule takes the arguments and their tangents (None where zero), and returns results and tangents, all arrays. To
    hold to every order it must build the tangents from the function's results, not from their values found otherwise.
    """

    def __init__(self, function: Callable[..., tuple[_Leaf, ...]]):
        self.function = function
        self.rule: _Rule | None = None

    def def_jvp(self, rule: _Rule) -> _Rule:
        """Set the rule."""
        self.rule = rule
        return rule

    def __call__(self, *args: Any) -> tuple[_Leaf, ...]:
        arrays, rest = eqx.partition(args, eqx.is_array)
        leaves, tree = jax.tree.flatten(arrays)
        return tuple(_call.bind(*leaves, call=_Call(self, tree, rest), levels=()))


class _Call:
    """One call of a function: the structure of its arguments, and those that are no arrays."""

    def __init__(self, of: OwnDerivative, tree: PyTreeDef, rest: tuple[Any, ...]):
        self.of, self.tree, self.rest = of, tree, rest

    def results(self, *leaves: _Leaf) -> list[_Leaf]:
        """The results."""
        return list(self.of.function(*eqx.combine(jax.tree.unflatten(self.tree, leaves), self.rest)))

    def tangents(self, moved: tuple[bool, ...], *both: _Leaf) -> list[_Leaf]:
        """The tangents of the results, given the arrays and the tangents of those that are `moved`."""
        leaves, given = both[: len(moved)], iter(both[len(moved) :])
        args = eqx.combine(jax.tree.unflatten(self.tree, leaves), self.rest)
        directions = jax.tree.unflatten(self.tree, [next(given) if m else None for m in moved])
        assert self.of.rule is not None
        return list(self.of.rule(args, directions)[1])

    def cotangents(self, moved: tuple[bool, ...], *both: _Leaf) -> list[_Leaf]:
        """The cotangents of the arrays that are `moved`, given all arrays and the cotangents of the results."""
        leaves, given = both[: len(moved)], both[len(moved) :]
        still = [jnp.zeros_like(leaf) for leaf, m in zip(leaves, moved, strict=True) if m]
        _, back = jax.vjp(lambda *directions: self.tangents(moved, *leaves, *directions), *still)
        return list(back(list(given)))


def _mapped(function: Callable[..., list[_Leaf]], levels: Sequence[_Level]) -> Callable[..., list[_Leaf]]:
    """`function`, cut, under ``jax.vmap`` with these axes of its arguments, the innermost first."""
    function = sharing(function)
    for size, axes in levels:
        function = jax.vmap(function, axes, axis_size=size)
    return function


def _mapped_back(
    function: Callable[..., list[_Leaf]], levels: Sequence[_Level], number: int
) -> Callable[..., list[_Leaf]]:
    """`function` of `number` arrays and of cotangents of results, cut, under the ``jax.vmap`` of these axes of the
    arrays and of the tangents; the cotangents of a tangent without the axis are summed.
    """
    function = sharing(function)
    for level in levels:
        function = partial(_level_back, function, level, number)
    return function


def _level_back(function: Callable[..., list[_Leaf]], level: _Level, number: int, *both: _Leaf) -> list[_Leaf]:
    axes = (*level.axes[:number], *[0] * (len(both) - number))
    results = jax.vmap(function, axes, axis_size=level.size)(*both)
    return [
        jnp.sum(result, 0) if axis is None else jnp.moveaxis(result, 0, axis)
        for result, axis in zip(results, level.axes[number:], strict=True)
    ]


def _level(args: Sequence[_Leaf], axes: Sequence[_Axis]) -> _Level:
    return _Level(next(arg.shape[axis] for arg, axis in zip(args, axes, strict=True) if axis is not None), tuple(axes))


@_call.def_impl
def _run(*leaves: _Leaf, call: _Call, levels: _Levels) -> list[_Leaf]:
    return _mapped(call.results, levels)(*leaves)


@_call.def_abstract_eval
def _shapes(*leaves: _Leaf, call: _Call, levels: _Levels) -> list[_Leaf]:
    return list(jax.make_jaxpr(_mapped(call.results, levels))(*leaves).out_avals)


def _jvp(primals: Sequence[_Leaf], tangents: Sequence[_Leaf], *, call: _Call, levels: _Levels):
    moved = tuple(type(tangent) is not ad.Zero for tangent in tangents)
    given = [tangent for tangent, m in zip(tangents, moved, strict=True) if m]
    results = _call.bind(*primals, call=call, levels=levels)
    both = tuple(_Level(n, (*axes, *(axis for axis, m in zip(axes, moved, strict=True) if m))) for n, axes in levels)
    return results, _tangent.bind(*primals, *given, call=call, levels=both, moved=moved)


def _batch(args: Sequence[_Leaf], axes: Sequence[_Axis], *, call: _Call, levels: _Levels):
    results = _call.bind(*args, call=call, levels=(*levels, _level(args, axes)))
    return results, [0] * len(results)


@_tangent.def_impl
def _run_tangent(*both: _Leaf, call: _Call, levels: _Levels, moved: tuple[bool, ...]) -> list[_Leaf]:
    return _mapped(partial(call.tangents, moved), levels)(*both)


@_tangent.def_abstract_eval
def _tangent_shapes(*both: _Leaf, call: _Call, levels: _Levels, moved: tuple[bool, ...]) -> list[_Leaf]:
    results = _shapes(
        *both[: len(moved)], call=call, levels=tuple(_Level(size, axes[: len(moved)]) for size, axes in levels)
    )
    return [result.to_tangent_aval() for result in results]


def _jvp_of_tangent(primals: Sequence[_Leaf], tangents: Sequence[_Leaf], **params: Any):
    moved = [not isinstance(tangent, ad.Zero) for tangent in tangents]
    points, of = of_moving(partial(_run_tangent, **params), primals, moved)
    return jax.jvp(of, points, [tangent for tangent, m in zip(tangents, moved, strict=True) if m])


def _transposed(cotangents: Sequence[_Leaf], *both: _Leaf, call: _Call, levels: _Levels, moved: tuple[bool, ...]):
    leaves, wanted = both[: len(moved)], both[len(moved) :]
    given = [ad.instantiate_zeros(cotangent) for cotangent in cotangents]
    found = _mapped_back(partial(call.cotangents, moved), levels, len(moved))(*leaves, *given)
    found = [new if ad.is_undefined_primal(old) else None for new, old in zip(found, wanted, strict=True)]
    return [*[None] * len(moved), *found]


def _batch_tangent(both: Sequence[_Leaf], axes: Sequence[_Axis], *, levels: _Levels, **params: Any):
    results = _tangent.bind(*both, levels=(*levels, _level(both, axes)), **params)
    return results, [0] * len(results)


ad.primitive_jvps[_call], ad.primitive_jvps[_tangent] = _jvp, _jvp_of_tangent
ad.primitive_transposes[_tangent] = _transposed
batching.primitive_batchers[_call], batching.primitive_batchers[_tangent] = _batch, _batch_tangent
mlir.register_lowering(_call, mlir.lower_fun(_run, multiple_results=True))
mlir.register_lowering(_tangent, mlir.lower_fun(_run_tangent, multiple_results=True))


# Roots of equations, with derivatives by the implicit function theorem.


def root_of(residual: Callable[..., FloatArray], changed: Callable[..., FloatArray]) -> OwnDerivative:
    """A function of numbers and of the root of ``residual(*numbers, root) = 0`` that returns (root,), with its
    derivatives of every order.

    `changed`: the change of the root, from the numbers, the root and the change of the residual at this root.
    """
    found = OwnDerivative(lambda *args: args[-1:])

    @found.def_jvp
    def _(primals: Any, tangents: Any) -> Any:
        *given, root = primals
        (root,) = found(*given, lax.stop_gradient(root))
        _, change = eqx.filter_jvp(lambda *given: residual(*given, root), tuple(given), tuple(tangents[:-1]))
        return (root,), (changed(*given, root, change),)

    return found


def with_slope(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The value of a function and its slope."""
    return jax.jvp(function, (at,), (jnp.ones_like(at),))


# Derivatives by a few numbers, computed in forward mode along with a long loop, for reverse mode too.
#
# Reverse mode through a loop goes back over every step: it keeps states on the way or computes them again, and takes
# several times as long as the loop. Most derivatives that are asked for are by one number or a few (a friction
# coefficient, say). Their slopes, computed along with the loop in forward mode, cost less each; reverse mode then only
# multiplies by them.


def with_slopes(function: Callable[..., Any], *args: Any, most: int, lanes: int = 1) -> Any:
    """``function(*args)``, arrays in any structure, whose derivatives by at most so many scalars are computed along
    with it; derivatives by more, or by arrays, go back over the steps.

    They are the derivatives of JAX, of every order and in every mode; only the way to the first one differs. Under
    ``jax.vmap`` so many `lanes` are followed side by side in a native loop, if that is more than 1.
    """
    # Whole numbers too: what is enclosed here and traced would be a constant, which JAX cannot lower.
    flat, leaves, restored = flattened(function, args, {}, eqx.is_array)
    # What `function` encloses may carry derivatives too: friction curves are functions that users write.
    closed, enclosed = jax.closure_convert(flat, *leaves)
    return restored(_with_rule(closed, most, lanes)(*leaves, *enclosed))


def _with_rule(function: Callable[..., Any], most: int, lanes: int = 1) -> Callable[..., Any]:
    """`function` with the rule for its derivatives; both are native loops, but for the way back over the steps.

    `most`: by how many numbers derivatives are computed by their slopes, and not as JAX does by itself. `lanes`, as in
    `with_slopes`, are for the function alone: XLA may divide an operation with slopes among threads.
    """
    call = jax.custom_jvp(native_loop(function, known_only=True, most=lanes))

    def rule(primals, tangents):
        moves = [not isinstance(tangent, SymbolicZero) for tangent in tangents]
        changes = [tangent for tangent, m in zip(tangents, moves, strict=True) if m]
        points, of = of_moving(function, primals, moves)
        if len(points) > most or any(np.ndim(point) for point in points):
            return jax.jvp(of, points, changes)

        def with_slopes(*primals):
            points, of = of_moving(function, primals, moves)
            return _slopes(of, points)

        results, slopes = _with_rule(with_slopes, most=0)(*primals)
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


# Bounds of numbers that JAX traces: under jvp, grad and vmap (outside jit) their values are known.
#
# Sizes of arrays must be Python numbers; where they depend on traced numbers, they are computed from these bounds.
# Nothing else may use them: a result would depend on numbers without JAX knowing it.


class NotKnown(Exception):
    """Raised for a traced number whose value is not known before the compiled function is called."""


def primal_of(value: Any) -> Any:
    """A number without its derivatives: no tracer any more under jvp and grad alone. Others stay as they are."""
    return lax.stop_gradient(value) if checks.is_traced(value) else value


def values_of(value: Any) -> np.ndarray:
    """All values that a number stands for, those of a batch under vmap. Raises NotKnown under jit."""
    value = primal_of(value)
    if not checks.is_traced(value):
        return np.asarray(value)
    found = []

    # Under vmap, the rule of a function is handed the whole batch.
    @jax.custom_batching.custom_vmap
    def look(number):
        return number

    @look.def_vmap
    def _(size, is_batched, batch):
        found.append(batch)
        return batch, is_batched[0]

    look(value)
    if not found:
        raise NotKnown
    return values_of(found[0])


def bounds_of(value: Any) -> tuple[float, float]:
    """The smallest and the largest of the values that a number stands for. Raises NotKnown under jit."""
    values = values_of(value)
    return float(np.min(values)), float(np.max(values))


def largest(value: Any) -> float:
    """The largest value that a number stands for. Raises NotKnown under jit."""
    return bounds_of(value)[1]


def smallest(value: Any) -> float:
    """The smallest value that a number stands for. Raises NotKnown under jit."""
    return bounds_of(value)[0]


# Values without their derivatives.


_Tree = TypeVar("_Tree")


def without_derivatives(tree: _Tree) -> _Tree:
    """`tree`, its numbers without derivatives."""
    return jax.tree.map(lambda leaf: lax.stop_gradient(leaf) if eqx.is_array_like(leaf) else leaf, tree)


# Numbers in a tree as arrays.


T = TypeVar("T")


def as_arrays(tree: T, dtype: DType) -> T:
    """`tree` with arrays in place of its numbers, but whole ones: what differs in them only is compiled once."""

    def converted(leaf: Any) -> Any:
        is_array = isinstance(leaf, (jax.Array, np.ndarray)) and jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.asarray(leaf, dtype) if isinstance(leaf, float) or is_array else leaf

    return jax.tree.map(converted, tree)
