"""Functions with a derivative of their own that holds to every order, in every mode, inside loops too.

``jax.custom_jvp`` gives a function a rule for its first derivative; where the rule calls the function again, it holds
to every order. But reverse mode through ``lax.scan`` replaces the call in the rule by the function's own operations
(JAX 0.10), and where their derivatives differ from the rule, the second derivative is wrong without a word. A primitive
stays one operation, with its rule.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

_call = Primitive("call_with_own_derivative")
_call.multiple_results = True

_Axes = tuple[int | None, ...]


class OwnDerivative:
    """`function`, a tuple of arrays, whose derivative is given by `def_jvp`, as for ``equinox.filter_custom_jvp``.

    The rule takes the arguments and their tangents (None where zero), and returns results and tangents, all arrays. To
    hold to every order it must build the tangents from the function's results, not from their values found otherwise.
    """

    def __init__(self, function: Callable[..., tuple[Any, ...]]):
        self.function = function
        self.rule: Callable[..., Any] | None = None

    def def_jvp(self, rule: Callable[..., Any]) -> Callable[..., Any]:
        """Set the rule."""
        self.rule = rule
        return rule

    def __call__(self, *args: Any) -> tuple[Any, ...]:
        arrays, rest = eqx.partition(args, eqx.is_array)
        leaves, tree = jax.tree.flatten(arrays)
        return tuple(_call.bind(*leaves, call=_Call(self, tree, rest), levels=()))


class _Call:
    """One call of a function: the structure of its arguments, and those that are no arrays."""

    def __init__(self, of: OwnDerivative, tree: Any, rest: Any):
        self.of, self.tree, self.rest = of, tree, rest

    def results(self, *leaves: Any) -> list[Any]:
        """The results."""
        return list(self.of.function(*eqx.combine(jax.tree.unflatten(self.tree, leaves), self.rest)))

    def with_tangents(self, moved: tuple[bool, ...], *both: Any) -> list[Any]:
        """The results and their tangents, given the arrays and the tangents of those that are `moved`."""
        leaves, given = both[: len(moved)], iter(both[len(moved) :])
        args = eqx.combine(jax.tree.unflatten(self.tree, leaves), self.rest)
        tangents = jax.tree.unflatten(self.tree, [next(given) if m else None for m in moved])
        assert self.of.rule is not None
        results, slopes = self.of.rule(args, tangents)
        return [*results, *slopes]


def _mapped(function: Callable[..., Any], levels: Sequence[_Axes]) -> Callable[..., Any]:
    """`function` under ``jax.vmap`` with these axes of its arguments, the innermost first."""
    for axes in levels:
        function = jax.vmap(function, axes)
    return function


@_call.def_impl
def _run(*leaves: Any, call: _Call, levels: tuple[_Axes, ...]) -> list[Any]:
    return _mapped(call.results, levels)(*leaves)


@_call.def_abstract_eval
def _shapes(*leaves: Any, call: _Call, levels: tuple[_Axes, ...]) -> list[Any]:
    return list(jax.make_jaxpr(_mapped(call.results, levels))(*leaves).out_avals)


def _jvp(primals: Sequence[Any], tangents: Sequence[Any], *, call: _Call, levels: tuple[_Axes, ...]):
    moved = tuple(type(tangent) is not ad.Zero for tangent in tangents)
    levels = tuple((*axes, *(axis for axis, m in zip(axes, moved, strict=True) if m)) for axes in levels)
    given = [tangent for tangent, m in zip(tangents, moved, strict=True) if m]
    both = _mapped(partial(call.with_tangents, moved), levels)(*primals, *given)
    return both[: len(both) // 2], both[len(both) // 2 :]


def _batch(args: Sequence[Any], axes: Sequence[Any], *, call: _Call, levels: tuple[_Axes, ...]):
    results = _call.bind(*args, call=call, levels=(*levels, tuple(axes)))
    return results, [0] * len(results)


ad.primitive_jvps[_call] = _jvp
batching.primitive_batchers[_call] = _batch
mlir.register_lowering(_call, mlir.lower_fun(_run, multiple_results=True))
