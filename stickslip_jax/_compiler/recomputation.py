"""Less work around loops: common subexpressions computed once, and many small arrays packed into a few."""

import math
from collections.abc import Callable, Hashable, Sequence
from functools import partial, wraps
from typing import Any, NamedTuple, ParamSpec, TypeAlias, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.extend import core

from .native_loops import COSTS, PLAIN, computed_once

# Many small arrays packed into a few: JAX takes microseconds for each array that a compiled function is given.
#
# Arrays of the same type and shape are stacked.


class Layout(NamedTuple):
    """How to unpack a pytree; may be a static argument of ``jax.jit``."""

    structure: Hashable  # a `PyTreeDef`
    kinds: tuple[tuple[jnp.dtype, tuple[int, ...]], ...]  # type and shape of each leaf

    @classmethod
    def of(cls, tree: Any) -> "Layout":
        """The layout of a pytree of arrays, or of their shapes."""
        leaves, structure = jax.tree.flatten(tree)
        return cls(structure, tuple((leaf.dtype, leaf.shape) for leaf in leaves))


def packed(tree: Any) -> tuple[jax.Array, ...]:
    """The arrays of a pytree, those of the same type and shape stacked."""
    if PLAIN:
        return tuple(map(jnp.asarray, jax.tree.leaves(tree)))
    together: dict[tuple[jnp.dtype, tuple[int, ...]], list[jax.Array]] = {}
    for leaf in jax.tree.leaves(tree):
        together.setdefault((leaf.dtype, leaf.shape), []).append(leaf)
    return tuple(jnp.stack(leaves) for leaves in together.values())


def unpacked(arrays: tuple[jax.Array, ...], layout: Layout) -> Any:
    """The pytree that was `packed`."""
    if PLAIN:
        return jax.tree.unflatten(layout.structure, arrays)
    together = {kind: iter(array) for kind, array in zip(dict.fromkeys(layout.kinds), arrays, strict=True)}
    return jax.tree.unflatten(layout.structure, [next(together[kind]) for kind in layout.kinds])


# Common subexpressions of several results, computed only once.
#
# XLA's CPU back end compiles every result of a large function into a loop of its own, and repeats in it all that the
# result depends on, even if other results need the same. `sharing` cuts a function where that happens: a value
# that is used more than once, and costs more than storing it, becomes the result of a call that the compiler
# does not inline.


_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

_Atom: TypeAlias = core.Var | core.Literal
_Leaf: TypeAlias = Any  # a number or an array, traced or not
_Known: TypeAlias = tuple[list[_Leaf], list[_Leaf]]  # the results of an operation, and its operands

_WITH_RULE = "custom_jvp_call"

_WORTH = 4  # cheaper values are computed again


def sharing(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """`function` of scalars (pytrees of them), cut so that no costly value is computed twice, in any transformation."""
    if PLAIN:
        return function

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        flat, leaves, restored = flattened(cast(Callable[..., Any], function), args, options, eqx.is_array_like)
        return restored(_shared(jax.make_jaxpr(flat)(*leaves), leaves))

    return call


def flattened(
    function: Callable[..., Any], args: tuple[Any, ...], options: dict[str, Any], is_leaf: Callable[[Any], bool]
) -> tuple[Callable[..., list[_Leaf]], list[_Leaf], Callable[[Sequence[_Leaf]], Any]]:
    """`function` of the leaves of its arguments alone, from leaves to leaves; these leaves; and what makes the results
    of `function` of those that it has found.
    """
    taken, rest = eqx.partition((args, options), is_leaf)
    leaves, tree = jax.tree.flatten(taken)
    shape = []

    def flat(*leaves: _Leaf) -> list[_Leaf]:
        args, options = eqx.combine(jax.tree.unflatten(tree, leaves), rest)
        results, others = eqx.partition(function(*args, **options), is_leaf)
        results, structure = jax.tree.flatten(results)
        shape[:] = structure, others
        return results

    def restored(results: Sequence[_Leaf]) -> Any:
        structure, others = shape
        return eqx.combine(jax.tree.unflatten(structure, results), others)

    return flat, leaves, restored


def _shared(closed: core.ClosedJaxpr, leaves: Sequence[_Leaf]) -> list[_Leaf]:
    """The results of `closed`, cut."""
    return _evaluated(jax.make_jaxpr(lambda *leaves: _inlined(closed, leaves, {}))(*leaves), leaves)


def _inlined(closed: core.ClosedJaxpr, leaves: Sequence[_Leaf], known: dict[Hashable, _Known]) -> list[_Leaf]:
    """The results of `closed`, calls inside it inlined, values that are `known` not computed again."""
    jaxpr, values = closed.jaxpr, _values_in(closed, leaves)
    for equation in jaxpr.eqns:
        given = values.of(equation.invars)
        if equation.primitive.name in ("jit", "pjit", "closed_call"):
            results = _inlined(equation.params["jaxpr"], given, known)
        else:
            name = (equation.primitive.name, _details(equation), *map(_name, given))
            if name not in known:
                cut = _with_sharing(equation) if equation.primitive.name == _WITH_RULE else equation
                # The operands are kept alive, so that their names stay unique.
                known[name] = _bound(cut, given), given
            results, _ = known[name]
        values.update(equation.outvars, results)
    return values.of(jaxpr.outvars)


def _name(value: _Leaf) -> Hashable:
    """Identity of an operand: of a tracer the object, of a number its value."""
    return id(value) if isinstance(value, Tracer) else (str(jax.typeof(value)), np.asarray(value).tobytes())


def _details(equation: core.JaxprEqn) -> Hashable:
    """Identity of the operation of an equation: its parameters; of an opaque one the equation itself, which is the same
    object in a function that jit has traced once.
    """
    return str(equation.params) if equation.primitive.name in COSTS else id(equation)


def _with_sharing(equation: core.JaxprEqn) -> core.JaxprEqn:
    """The call of a function with a custom derivative, its value cut."""
    closed = equation.params["call_jaxpr"]
    call = jax.make_jaxpr(lambda *leaves: _shared(closed, leaves))(*closed.in_avals)
    return equation.replace(params={**equation.params, "call_jaxpr": call})


class _Values:
    """The values of the variables of a jaxpr."""

    def __init__(self, variables: Sequence[core.Var], values: Sequence[_Leaf]):
        self._known: dict[core.Var, _Leaf] = dict(zip(variables, values, strict=True))

    def of(self, atoms: Sequence[_Atom]) -> list[_Leaf]:
        """The values of some variables or literals."""
        return [atom.val if isinstance(atom, core.Literal) else self._known[atom] for atom in atoms]

    def update(self, variables: Sequence[core.Var], values: Sequence[_Leaf]) -> None:
        """Set the values of some variables."""
        self._known.update(zip(variables, values, strict=True))


def _values_in(closed: core.ClosedJaxpr, leaves: Sequence[_Leaf]) -> _Values:
    return _Values([*closed.jaxpr.constvars, *closed.jaxpr.invars], [*closed.consts, *leaves])


def _bound(equation: core.JaxprEqn, given: Sequence[_Leaf]) -> list[_Leaf]:
    """The results of one equation."""
    how = equation.primitive.get_bind_params(equation.params)
    functions, params = how if isinstance(how, tuple) else ((), how)  # versions of JAX differ
    results = equation.primitive.bind(*functions, *given, **params)
    return list(results) if equation.primitive.multiple_results else [results]


def _evaluated(closed: core.ClosedJaxpr, leaves: Sequence[_Leaf]) -> list[_Leaf]:
    """The results of `closed`, each stored variable computed by a call of its own."""
    jaxpr, values = closed.jaxpr, _values_in(closed, leaves)
    kept = _kept(jaxpr)
    used = {atom for equation in jaxpr.eqns for atom in _variables(equation)}
    made_by = {variable: equation for equation in jaxpr.eqns for variable in equation.outvars}
    for equation in jaxpr.eqns:
        if equation.primitive.name not in COSTS:
            values.update(equation.outvars, _bound(equation, values.of(equation.invars)))
        elif equation.outvars[0] in kept:
            cone = _cone(equation, made_by, kept)
            own = {part.outvars[0] for part in cone}
            inputs = list(dict.fromkeys(atom for part in cone for atom in _variables(part) if atom not in own))
            compute = partial(_computed, cone, inputs)
            is_free = all(COSTS[part.primitive.name] == 0 for part in cone)
            # A result that nothing else uses is not computed twice.
            compute = compute if is_free or equation.outvars[0] not in used else computed_once(compute)
            values.update(equation.outvars, [compute(*values.of(inputs))])
    return values.of(jaxpr.outvars)


def _computed(cone: list[core.JaxprEqn], inputs: list[core.Var], *given: _Leaf) -> _Leaf:
    """The result of the last equation of a cone."""
    values = _Values(inputs, given)
    for part in cone:
        values.update(part.outvars, _bound(part, values.of(part.invars)))
    return values.of(cone[-1].outvars)[0]


def _variables(equation: core.JaxprEqn) -> list[core.Var]:
    """The variables that an equation takes, each once."""
    return list(dict.fromkeys(atom for atom in equation.invars if not isinstance(atom, core.Literal)))


def _kept(jaxpr: core.Jaxpr) -> set[core.Var]:
    """The variables whose values are stored: results, operands of opaque operations, and costly values used again."""
    uses: dict[core.Var, int] = {}
    kept = {atom for atom in jaxpr.outvars if not isinstance(atom, core.Literal)}
    for equation in jaxpr.eqns:
        for atom in _variables(equation):
            uses[atom] = uses.get(atom, 0) + _repeats(equation, atom)
            if equation.primitive.name not in COSTS:
                kept.add(atom)
    costs: dict[core.Var, float] = {}
    for equation in jaxpr.eqns:
        own = COSTS.get(equation.primitive.name)
        if own is not None:
            (variable,) = equation.outvars
            cost = own + sum(costs.get(atom, 0) for atom in _variables(equation))
            if uses.get(variable, 0) > 1 and cost >= _WORTH:
                kept.add(variable)
            costs[variable] = 0 if variable in kept else cost
    return kept


def _repeats(equation: core.JaxprEqn, atom: core.Var) -> int:
    """How often an element of the operand is computed where the result is, unless it is stored."""
    if equation.primitive.name != "broadcast_in_dim":
        return 1
    size, results = (math.prod(getattr(of.aval, "shape", ())) for of in (atom, equation.outvars[0]))
    return max(results // size, 1) if size > 1 else 1


def _cone(equation: core.JaxprEqn, made_by: dict[core.Var, core.JaxprEqn], kept: set[core.Var]) -> list[core.JaxprEqn]:
    """The equations behind a variable, back to those whose results are stored, in order."""
    found: dict[int, core.JaxprEqn] = {}

    def visit(part: core.JaxprEqn) -> None:
        if id(part) in found:
            return
        for atom in _variables(part):
            if atom in made_by and atom not in kept and made_by[atom].primitive.name in COSTS:
                visit(made_by[atom])
        found[id(part)] = part

    visit(equation)
    return list(found.values())
