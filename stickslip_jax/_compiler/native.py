"""What the package asks of the compiler beyond ``jax.jit``, for speed alone; ``STICKSLIP_PLAIN_JAX=1`` turns it off.

- `native_loop`, `CompiledNatively`: a loop over small arrays as one native function of the CPU.
- `computed_once`, `sharing`: values that several results need are computed once.
- `neighbours`: two numbers of a long array.
- `packed`, `unpacked`, `Layout`: few arrays in place of many, for calls of compiled functions.
- `of_moving`, `flattened`: a function of those of its arguments that have a tangent, or that are arrays.
- `WIDE_VECTORS`, `COMPILED_QUICKLY`: options of the compiler.

docs/compiler.md says which weakness of JAX or XLA each is for, and when it can go.
"""

import math
import os
import threading
import warnings
from collections.abc import Callable, Hashable, Iterator, Sequence
from functools import cache, lru_cache, partial, wraps
from typing import Any, Generic, NamedTuple, ParamSpec, TypeAlias, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend import core
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jax.interpreters import partial_eval as pe

from .programs import kept_jit

# The switch that turns all of this off.


VARIABLE = "STICKSLIP_PLAIN_JAX"
"""The environment variable; it is read once, when the package is imported."""
PLAIN = os.environ.get(VARIABLE, "0") not in ("", "0")
"""Whether the package uses ``jax.jit`` and nothing beyond it: slower, and equal but for round-off."""


# Operations of JAX: what each costs, and those that XLA is known to compile into native loops, and rightly.
#
# Others are refused by it (sorting, linear algebra, calls of Python), and some end the process: functions that hold
# what users write are compiled natively only where all of their operations stand here.


_FREE = """
    abs bitcast_convert_type broadcast_in_dim convert_element_type copy is_finite neg not reshape slice squeeze
    stop_gradient
""".split()  # noqa: SIM905
_CHEAP = """
    add add_any and clamp dynamic_slice eq floor gather ge gt integer_pow le lt max min mul ne or reduce_and reduce_max
    reduce_min reduce_or reduce_sum round select_n shift_left shift_right_arithmetic shift_right_logical sign square sub
    xor
""".split()  # noqa: SIM905
_COSTLY = """
    acos asin atan atan2 cos div exp exp2 expm1 log log1p nextafter pow rem rsqrt sin sqrt tan tanh
""".split()  # noqa: SIM905
COSTS = {name: cost for names, cost in ((_FREE, 0), (_CHEAP, 1), (_COSTLY, 10)) for name in names}
"""The costs of operations, in additions. Others are opaque: nobody looks into them."""

_MOVING = """
    bitcast_convert_type broadcast_in_dim concatenate convert_element_type copy dynamic_slice dynamic_update_slice
    expand_dims gather iota optimization_barrier pad reshape rev slice split squeeze stack stop_gradient transpose
    xla_metadata_value
""".split()  # noqa: SIM905
_ARITHMETIC = {
    *COSTS,
    *"""
    acosh argmax argmin asinh atanh bessel_i0e bessel_i1e cbrt ceil cosh cumlogsumexp cummax cummin cumprod cumsum
    digamma dot_general erf erf_inv erfc le_to lgamma logistic lt_to polygamma reduce_prod sinh unvmap_all unvmap_any
    unvmap_max
    """.split(),  # noqa: SIM905
}
_INSIDE = "cond custom_jvp_call custom_vmap_call jit pjit closed_call core_call remat2 checkpoint scan while".split()  # noqa: SIM905
_OF_OWN = ("call_with_own_derivative", "tangent_of_call")  # `_numerics/derivatives.py`
_LARGEST = 64
"""Numbers of one trajectory in an array that is computed with; XLA cannot put sums over thousands into a native loop.
"""
LANES = 256
"""Trajectories that advance side by side in a native loop: their arrays stay in the cache."""


def compilable(jaxpr: core.Jaxpr) -> bool:
    """Whether XLA is known to compile `jaxpr`, of one trajectory, into a native loop."""
    return _largest(jaxpr) <= _LARGEST


def _largest(jaxpr: core.Jaxpr) -> float:
    """Numbers in the largest array that is computed with; infinity where some operation is not known."""
    return max(map(_size, jaxpr.eqns), default=1)


def _size(equation: core.JaxprEqn) -> float:
    name = equation.primitive.name
    if name in _INSIDE:
        return max(map(_largest, _jaxprs_in(list(equation.params.values()))), default=1)
    if name in _OF_OWN:
        run = partial(equation.primitive.impl, **equation.params)
        return _largest(jax.make_jaxpr(run)(*(atom.aval for atom in equation.invars)).jaxpr)
    if name in _MOVING:
        return 1
    sizes = [math.prod(getattr(atom.aval, "shape", ())) for atom in (*equation.invars, *equation.outvars)]
    return max(sizes) if name in _ARITHMETIC else math.inf


def _jaxprs_in(params: Any) -> Iterator[core.Jaxpr]:
    """The functions among the parameters of an equation."""
    for param in params:
        if isinstance(param, (tuple, list)):
            yield from _jaxprs_in(param)
        elif isinstance(param, core.ClosedJaxpr):
            yield param.jaxpr
        elif isinstance(param, core.Jaxpr):
            yield param


# A call that stays one call under every transformation of JAX, compiled into one native function of the CPU.
#
# XLA (jaxlib 0.10.2) aborts the process if a native function does not read one of its arguments. That can happen to any
# function under ``jax.jit``: JAX removes unused results, which every derivative of a derivative has, and what only they
# needed. The rule of this primitive removes results but no arguments, and all of these are read (`reading_all`).


NATIVE = {"inlineable": "false", "xla_cpu_small_call": "true"}

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_Arrays = TypeVar("_Arrays")

_call = Primitive("native_call")
_call.multiple_results = True
_Leaf: TypeAlias = Any  # a number or an array, traced or not; or ``ad.Zero`` as a tangent
_Axis: TypeAlias = int | None
_KEPT = 512  # functions and their derivatives, so that those called outside ``jax.jit`` are not compiled again


def native_call(closed: ClosedJaxpr, args: Sequence[_Leaf], lanes: int = 0, most: int = 1) -> list[_Leaf]:
    """The results of `closed`. Works under jit, vmap and jvp, not in reverse mode, as the loops inside.

    `lanes`: 0 for what is known to be compilable. Else the number of trajectories that it follows side by side, and it
    is compiled as usual where it, or a derivative of it, holds an operation that is not known to be `compilable`.
    ``jax.vmap`` makes blocks of `most` of them, if that is more than 1; else one call, which is then compiled as usual.
    """
    return _call.bind(*args, closed=closed, lanes=lanes, most=most)


def _as_native(*args: _Leaf, closed: ClosedJaxpr, lanes: int, most: int) -> list[_Leaf]:
    if lanes and _largest(closed.jaxpr) > _LARGEST * lanes:
        return jaxpr_as_fun(closed)(*args)

    def reading_all(*args):
        firsts = [jnp.ravel(jnp.asarray(array))[0].astype(float) for array in args if jnp.size(array)]
        return jaxpr_as_fun(closed)(*args), sum(firsts)

    # No argument may be a constant to XLA: beside others that are none, it aborts the process (jaxlib 0.10.2).
    args = lax.optimization_barrier(args)
    # Tagging the results tags the call that they come from. (The context manager of the same name would tag every
    # operation inside it too, and none of those would then be fused.)
    return lax.optimization_barrier(set_xla_metadata(jax.jit(reading_all)(*args), **NATIVE))[0]


@lru_cache(_KEPT)
def _compiled(closed: ClosedJaxpr, lanes: int, most: int) -> Callable[..., list[_Leaf]]:
    return jax.jit(lambda *args: native_call(closed, args, lanes, most))


@_call.def_impl
def _run(*args: _Leaf, closed: ClosedJaxpr, **options: int) -> list[_Leaf]:
    return _compiled(closed, **options)(*args)


@_call.def_abstract_eval
def _shapes(*_: _Leaf, closed: ClosedJaxpr, **options: int) -> list[_Leaf]:
    return list(closed.out_avals)


def of_moving(
    function: Callable[..., _Result], args: Sequence[_Leaf], moved: Sequence[bool]
) -> tuple[list[_Leaf], Callable[..., _Result]]:
    """The arguments that are `moved`, and `function` of those alone."""

    def of(*changed: _Leaf) -> _Result:
        given = iter(changed)
        return function(*(next(given) if m else arg for arg, m in zip(args, moved, strict=True)))

    return [arg for arg, m in zip(args, moved, strict=True) if m], of


@lru_cache(_KEPT)
def _with_tangents(closed: ClosedJaxpr, moved: tuple[bool, ...]) -> tuple[ClosedJaxpr, tuple[bool, ...]]:
    """The function of all arguments and the tangents of those that are `moved`; its results are those of `closed` and
    the tangents of the real ones, and which these are.
    """
    real = tuple(jnp.issubdtype(aval.dtype, jnp.inexact) for aval in closed.out_avals)

    def both(args, tangents):
        points, of = of_moving(jaxpr_as_fun(closed), args, moved)
        out, slopes = jax.jvp(of, points, tangents)
        return out, [slope for slope, is_real in zip(slopes, real, strict=True) if is_real]

    tangents = [aval for aval, m in zip(closed.in_avals, moved, strict=True) if m]
    return jax.make_jaxpr(both)(list(closed.in_avals), tangents), real


def _jvp(
    primals: Sequence[_Leaf], tangents: Sequence[_Leaf], *, closed: ClosedJaxpr, **options: int
) -> tuple[list[_Leaf], list[_Leaf]]:
    moved = tuple(type(tangent) is not ad.Zero for tangent in tangents)
    both, real = _with_tangents(closed, moved)
    moving = [tangent for tangent, m in zip(tangents, moved, strict=True) if m]
    results = native_call(both, [*primals, *moving], **options)
    out, slopes = results[: len(real)], iter(results[len(real) :])
    return out, [
        next(slopes) if is_real else ad.Zero(aval.to_tangent_aval())
        for aval, is_real in zip(closed.out_avals, real, strict=True)
    ]


@lru_cache(_KEPT)
def _batched(closed: ClosedJaxpr, axes: tuple[_Axis, ...], size: int) -> tuple[ClosedJaxpr, tuple[_Axis, ...]]:
    """The function of batched arguments, and the axes of its results (None: without one)."""

    def with_axis(aval, axis):
        shape = aval.shape if axis is None else (*aval.shape[:axis], size, *aval.shape[axis:])
        return jax.ShapeDtypeStruct(shape, aval.dtype, weak_type=aval.weak_type)

    found = []

    def look(*args):
        results = jaxpr_as_fun(closed)(*args)
        # A result that depends on no batched argument has no batch axis, and must not be computed for each element.
        found[:] = [None if getattr(result, "batch_dim", None) is None else 0 for result in results]
        return results

    args = [with_axis(aval, axis) for aval, axis in zip(closed.in_avals, axes, strict=True)]
    jax.eval_shape(jax.vmap(look, axes), *args)
    out_axes = tuple(found)
    return jax.make_jaxpr(jax.vmap(jaxpr_as_fun(closed), axes, list(out_axes)))(*args), out_axes


def _batch(
    args: Sequence[_Leaf], axes: Sequence[_Axis], *, closed: ClosedJaxpr, lanes: int, most: int
) -> tuple[list[_Leaf], tuple[_Axis, ...]]:
    mapped = [axis is not None for axis in axes]
    args = [jnp.moveaxis(arg, axis, 0) if axis else arg for arg, axis in zip(args, axes, strict=True)]
    size = next(arg.shape[0] for arg, m in zip(args, mapped, strict=True) if m)
    width = size
    if most > 1 and _largest(closed.jaxpr) <= _LARGEST * lanes:
        width = block_width(size, max(1, most // lanes))
        lanes *= width
    batched, out_axes = _batched(closed, tuple(0 if m else None for m in mapped), width)
    moved, run = of_moving(lambda *part: native_call(batched, part, lanes, most), args, mapped)
    if width >= size:
        return run(*moved), out_axes
    has_lanes = [axis is not None for axis in out_axes]
    each = iter(in_blocks(lambda part: [new for new, m in zip(run(*part), has_lanes, strict=True) if m], moved, width))
    others = [None] * len(out_axes) if all(has_lanes) else run(*(arg[:width] for arg in moved))
    return [next(each) if m else one for m, one in zip(has_lanes, others, strict=True)], out_axes


def block_width(size: int, most: int) -> int:
    """The number of lanes in blocks of `size` lanes that have at most so many: about the same in each."""
    blocks = -(-size // most)
    return size if blocks <= 1 else min(most, 8 * -(-size // (8 * blocks)))


def in_blocks(run: Callable[[_Arrays], Any], arrays: _Arrays, width: int) -> Any:
    """`run`, from arrays (lanes, ...) to arrays (lanes, ...), block by block of `width` lanes."""
    lanes = jax.tree.leaves(arrays)[0].shape[0]

    def add_block(number, results):
        # The last block starts among lanes of the block before, whose results come out the same again.
        first = jnp.minimum(number * width, lanes - width)
        block = run(jax.tree.map(lambda leaf: lax.dynamic_slice_in_dim(leaf, first, width), arrays))
        return jax.tree.map(lambda old, new: lax.dynamic_update_slice_in_dim(old, new, first, 0), results, block)

    shapes = jax.eval_shape(
        run, jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((width, *leaf.shape[1:]), leaf.dtype), arrays)
    )
    buffer = jax.tree.map(lambda leaf: jnp.zeros((lanes, *leaf.shape[1:]), leaf.dtype), shapes)
    return lax.fori_loop(0, -(-lanes // width), add_block, buffer) if lanes else buffer


@lru_cache(_KEPT)
def _of_used(closed: ClosedJaxpr, used: tuple[bool, ...]) -> ClosedJaxpr:
    return ClosedJaxpr(pe.dce_jaxpr(closed.jaxpr, used, instantiate=True)[0], closed.consts)


def _without_unused(used: list[bool], equation: core.JaxprEqn) -> tuple[list[bool], core.JaxprEqn | None]:
    """Results that nobody uses are not computed, but every argument is still one."""
    if not any(used):
        return [False] * len(equation.invars), None
    closed = _of_used(equation.params["closed"], tuple(used))
    outvars = [variable for variable, u in zip(equation.outvars, used, strict=True) if u]
    return [True] * len(equation.invars), equation.replace(
        outvars=outvars, params={**equation.params, "closed": closed}
    )


pe.dce_rules[_call] = _without_unused
ad.primitive_jvps[_call] = _jvp
batching.primitive_batchers[_call] = _batch
mlir.register_lowering(_call, mlir.lower_fun(_as_native, multiple_results=True))


# Native loops of the XLA compiler, asked for function by function and without process-wide options.
#
# XLA's CPU back end launches each operation of a loop separately, at about a microsecond each, and where several
# results share an intermediate value it computes that value again for each. Both can be turned off for one function by
# frontend attributes on its call, which these wrappers set. On other devices, and for versions of JAX that do not know
# them, the attributes mean nothing and the function is compiled as usual.


_OWN_CALL = {"inlineable": "false"}

WIDE_VECTORS: dict[str, Any] = {} if PLAIN else {"xla_cpu_prefer_vector_width": 512}
"""Option of ``jax.jit``: vectors of 512 bits halve the run time on CPUs that have them, and change nothing on others.

With them jaxlib 0.10.2 computes ``jnp.arctan`` wrong, by up to pi/2; the package's own functions do not use it.
"""
COMPILED_QUICKLY: dict[str, Any] = {} if PLAIN else {"xla_llvm_disable_expensive_passes": True}
"""Option of ``jax.jit``: without passes of LLVM that do not speed up these loops, and take a quarter of the time."""


def native_loop(
    function: Callable[_Arguments, _Result],
    static_argnames: tuple[str, ...] = (),
    *,
    known_only: bool = False,
    most: int = 1,
) -> Callable[_Arguments, _Result]:
    """`function`, a loop over small arrays, compiled into one native function of the CPU.

    One thread runs it. Works under jit, vmap and jvp, not in reverse mode; `static_argnames` as in ``jax.jit``, to be
    given by name. `known_only`: for functions that hold a user's; it and `most` as in `native_call`.
    """
    compiled = jax.jit(function, static_argnames=static_argnames)

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        if not native_loops_work():
            return function(*args, **options)
        traced = compiled.trace(*args, **options)
        arrays = jax.tree.leaves((args, {name: option for name, option in options.items() if name not in fixed}))
        if len(arrays) != len(traced.jaxpr.in_avals):  # it encloses what JAX traces
            return function(*args, **options)
        return jax.tree.unflatten(
            jax.tree.structure(traced.out_info), native_call(traced.jaxpr, arrays, int(known_only), most)
        )

    fixed = frozenset(static_argnames)
    return call


def computed_once(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """`function`, its results stored, so that no use of them computes them again."""
    compiled = jax.jit(function)

    @wraps(function)
    def call(*args: _Arguments.args, **options: _Arguments.kwargs) -> _Result:
        if not native_loops_work():
            return function(*args, **options)
        return cast(_Result, set_xla_metadata(compiled(*args, **options), **_OWN_CALL))

    return call


class CompiledNatively(Generic[_Arguments, _Result]):
    """`function` under ``jax.jit`` with these `options`, as a native loop where XLA can make one of it.

    XLA does not accept all operations there (sorting, say); the first call shows whether it does.
    """

    def __init__(self, function: Callable[_Arguments, _Result], static_argnames: tuple[str, ...] = (), **options: Any):
        self.native = kept_jit(native_loop(function, static_argnames), static_argnames=static_argnames, **options)
        self.usual = kept_jit(function, static_argnames=static_argnames, **options)
        self._refused: set[Hashable] = set()

    def bound(self, arrays: tuple[Any, ...], static: dict[str, Any]) -> Callable[..., Any]:
        """As `KeptJit.bound`, after a first call with such arguments."""
        refused = jax.tree.structure((arrays, static)) in self._refused
        return (self.usual if refused else self.native).bound(arrays, static)

    def __call__(self, *args: _Arguments.args, **named: _Arguments.kwargs) -> _Result:
        kind = jax.tree.structure((args, named))
        if kind in self._refused:
            return self.usual(*args, **named)
        try:
            return self.native(*args, **named)
        except jax.errors.JaxRuntimeError as error:
            result = self.usual(*args, **named)  # fails likewise if native compilation was not the reason
            self._refused.add(kind)
            warnings.warn(
                "This version of XLA does not compile the simulation into a native loop; it runs more slowly, and as "
                f"exactly. XLA said: {str(error).splitlines()[0]}",
                RuntimeWarning,
                stacklevel=2,
            )
            return result


@cache
def native_loops_work() -> bool:
    """Whether this version of JAX compiles a tagged loop for the CPU, and correctly, and is asked to."""
    if PLAIN or jax.default_backend() != "cpu":
        return False

    def loop(x):
        return lax.fori_loop(0, 3, lambda _, y: 2 * y, x)

    try:
        # Compiled ahead of the call: a plain call would be traced where this is asked for under the user's jit.
        ones = np.ones(1 << 12, np.float32)  # smaller loops become native without being asked to
        compiled = jax.jit(lambda x: set_xla_metadata(jax.jit(loop)(x), **NATIVE)).lower(ones).compile()
        text, right = compiled.as_text() or "", np.array_equal(np.asarray(compiled(ones)), 8 * ones)
    except Exception:  # a probe: whatever goes wrong, plain compilation works
        return False
    return right and "xla_cpu_small_call" in text


# Look-up in a long array.


@jax.custom_batching.custom_vmap
def neighbours(array: jax.Array, at: jax.Array) -> jax.Array:
    """``array[at : at + 2]`` of a long array (numbers,), which no sample has of its own; (2,).

    For many samples at once JAX makes a gather of it. XLA counts all of the array as read by that, divides the work
    among threads, and cannot put it into a native loop. So the CPU looks one up after the other there.
    """
    return lax.dynamic_slice(array, (at,), (2,))


@neighbours.def_vmap
def _neighbours_of_each(size: int, batched: Sequence[bool], array: jax.Array, at: jax.Array) -> tuple[jax.Array, bool]:
    def one(array: jax.Array, at: jax.Array) -> jax.Array:
        return lax.dynamic_slice(array, (at,), (2,))

    def look_up(number: jax.Array, found: jax.Array) -> jax.Array:
        return lax.dynamic_update_slice(found, one(array, at[number])[None], (number, jnp.zeros_like(number)))

    if batched[0] or not native_loops_work():
        return jax.vmap(one, tuple(0 if each else None for each in batched))(array, at), True
    return lax.fori_loop(0, size, look_up, jnp.zeros((size, 2), array.dtype)), True


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


_Atom: TypeAlias = core.Var | core.Literal
_Known: TypeAlias = tuple[list[_Leaf], list[_Leaf]]  # the results of an operation, and its operands

_WITH_RULE = "custom_jvp_call"

_WORTH = 4  # cheaper values are computed again


def sharing(function: Callable[_Arguments, _Result], *, whole: bool = False) -> Callable[_Arguments, _Result]:
    """`function` of scalars (pytrees of them), cut so that no costly value is computed twice, in any transformation.

    `whole`: those that it calls are not cut by themselves, so that nothing in them is computed twice either.
    """
    if PLAIN:
        return function

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        if getattr(_cutting, "whole", False):
            return function(*args, **options)
        flat, leaves, restored = flattened(cast(Callable[..., Any], function), args, options, eqx.is_array_like)
        _cutting.whole = whole
        try:
            closed = jax.make_jaxpr(flat)(*leaves)
        finally:
            _cutting.whole = False
        return restored(_shared(closed, leaves))

    return call


_cutting = threading.local()  # whether this thread traces what is cut as a whole


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
    jaxpr, values = closed.jaxpr, _started(closed, leaves)
    for equation in jaxpr.eqns:
        given = _of(values, equation.invars)
        if equation.primitive.name in ("jit", "pjit", "closed_call"):
            results = _inlined(equation.params["jaxpr"], given, known)
        else:
            name = (equation.primitive.name, _details(equation), *map(_name, given))
            if name not in known:
                cut = _with_sharing(equation) if equation.primitive.name == _WITH_RULE else equation
                # The operands are kept alive, so that their names stay unique.
                known[name] = _bound(cut, given), given
            results, _ = known[name]
        values.update(zip(equation.outvars, results, strict=True))
    return _of(values, jaxpr.outvars)


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


def _started(closed: core.ClosedJaxpr, leaves: Sequence[_Leaf]) -> dict[core.Var, _Leaf]:
    """The values of the constants and of the arguments of `closed`, by variable."""
    return dict(zip([*closed.jaxpr.constvars, *closed.jaxpr.invars], [*closed.consts, *leaves], strict=True))


def _of(values: dict[core.Var, _Leaf], atoms: Sequence[_Atom]) -> list[_Leaf]:
    """The values of some variables or literals."""
    return [atom.val if isinstance(atom, core.Literal) else values[atom] for atom in atoms]


def _bound(equation: core.JaxprEqn, given: Sequence[_Leaf]) -> list[_Leaf]:
    """The results of one equation."""
    how = equation.primitive.get_bind_params(equation.params)
    functions, params = how if isinstance(how, tuple) else ((), how)  # versions of JAX differ
    results = equation.primitive.bind(*functions, *given, **params)
    return list(results) if equation.primitive.multiple_results else [results]


def _evaluated(closed: core.ClosedJaxpr, leaves: Sequence[_Leaf]) -> list[_Leaf]:
    """The results of `closed`, each stored variable computed by a call of its own."""
    jaxpr, values = closed.jaxpr, _started(closed, leaves)
    kept = _kept(jaxpr)
    used = {atom for equation in jaxpr.eqns for atom in _variables(equation)}
    made_by = {variable: equation for equation in jaxpr.eqns for variable in equation.outvars}
    for equation in jaxpr.eqns:
        if equation.primitive.name not in COSTS:
            values.update(zip(equation.outvars, _bound(equation, _of(values, equation.invars)), strict=True))
        elif equation.outvars[0] in kept:
            cone = _cone(equation, made_by, kept)
            own = {part.outvars[0] for part in cone}
            inputs = list(dict.fromkeys(atom for part in cone for atom in _variables(part) if atom not in own))
            compute = partial(_computed, cone, inputs)
            is_free = all(COSTS[part.primitive.name] == 0 for part in cone)
            # A result that nothing else uses is not computed twice.
            compute = compute if is_free or equation.outvars[0] not in used else computed_once(compute)
            values[equation.outvars[0]] = compute(*_of(values, inputs))
    return _of(values, jaxpr.outvars)


def _computed(cone: list[core.JaxprEqn], inputs: list[core.Var], *given: _Leaf) -> _Leaf:
    """The result of the last equation of a cone."""
    values = dict(zip(inputs, given, strict=True))
    for part in cone:
        values.update(zip(part.outvars, _bound(part, _of(values, part.invars)), strict=True))
    return values[cone[-1].outvars[0]]


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
