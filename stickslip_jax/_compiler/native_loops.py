"""Native loops of the XLA compiler, asked for function by function and without process-wide flags."""

import math
import os
import warnings
from collections.abc import Callable, Hashable, Iterator, Sequence
from functools import cache, lru_cache, partial, wraps
from typing import Any, Generic, ParamSpec, TypeAlias, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend import core
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

# The switch that turns all of this folder off.


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
_INSIDE = "cond custom_jvp_call jit pjit closed_call core_call remat2 checkpoint scan while".split()  # noqa: SIM905
_OF_OWN = ("call_with_own_derivative", "tangent_of_call")  # `_numerics/derivatives.py`
_LARGEST = 64
"""Numbers in an array that is computed with. The usual kernels are faster with more, as where many trajectories advance
side by side; and XLA cannot put sums over thousands into a native loop."""


def compilable(jaxpr: core.Jaxpr) -> bool:
    """Whether XLA is known to compile `jaxpr` into a native loop."""
    return all(map(_is_known, jaxpr.eqns))


def _is_known(equation: core.JaxprEqn) -> bool:
    name = equation.primitive.name
    if name in _INSIDE:
        return all(map(compilable, _jaxprs_in(list(equation.params.values()))))
    if name in _OF_OWN:
        run = partial(equation.primitive.impl, **equation.params)
        return compilable(jax.make_jaxpr(run)(*(atom.aval for atom in equation.invars)).jaxpr)
    if name in _MOVING:
        return True
    sizes = [math.prod(getattr(atom.aval, "shape", ())) for atom in (*equation.invars, *equation.outvars)]
    return name in _ARITHMETIC and max(sizes) <= _LARGEST


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
# needed. This primitive has no rule for removing anything, so that after all transformations every argument is read and
# every result kept.


NATIVE = {"inlineable": "false", "xla_cpu_small_call": "true"}

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

_call = Primitive("native_call")
_call.multiple_results = True
_Leaf: TypeAlias = Any  # a number or an array, traced or not; or ``ad.Zero`` as a tangent
_Axis: TypeAlias = int | None
_KEPT = 512  # functions and their derivatives, so that those called outside ``jax.jit`` are not compiled again


def native_call(closed: ClosedJaxpr, args: Sequence[_Leaf], known_only: bool = False) -> list[_Leaf]:
    """The results of `closed`. Works under jit, vmap and jvp, not in reverse mode, as the loops inside.

    `known_only`: compiled as usual where it, or a derivative of it, holds an operation that is not known to be
    `compilable`.
    """
    return _call.bind(*args, closed=closed, known_only=known_only)


def _as_native(*args: _Leaf, closed: ClosedJaxpr, known_only: bool) -> list[_Leaf]:
    if known_only and not compilable(closed.jaxpr):
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
def _compiled(closed: ClosedJaxpr, known_only: bool) -> Callable[..., list[_Leaf]]:
    return jax.jit(lambda *args: native_call(closed, args, known_only))


@_call.def_impl
def _run(*args: _Leaf, closed: ClosedJaxpr, known_only: bool) -> list[_Leaf]:
    return _compiled(closed, known_only)(*args)


@_call.def_abstract_eval
def _shapes(*_: _Leaf, closed: ClosedJaxpr, known_only: bool) -> list[_Leaf]:
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
    primals: Sequence[_Leaf], tangents: Sequence[_Leaf], *, closed: ClosedJaxpr, known_only: bool
) -> tuple[list[_Leaf], list[_Leaf]]:
    moved = tuple(type(tangent) is not ad.Zero for tangent in tangents)
    both, real = _with_tangents(closed, moved)
    moving = [tangent for tangent, m in zip(tangents, moved, strict=True) if m]
    results = native_call(both, [*primals, *moving], known_only)
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
    args: Sequence[_Leaf], axes: Sequence[_Axis], *, closed: ClosedJaxpr, known_only: bool
) -> tuple[list[_Leaf], tuple[_Axis, ...]]:
    size = next(arg.shape[axis] for arg, axis in zip(args, axes, strict=True) if axis is not None)
    batched, out_axes = _batched(closed, tuple(axes), size)
    return native_call(batched, args, known_only), out_axes


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
    function: Callable[_Arguments, _Result], static_argnames: tuple[str, ...] = (), *, known_only: bool = False
) -> Callable[_Arguments, _Result]:
    """`function`, a loop over small arrays, compiled into one native function of the CPU.

    One thread runs it. Works under jit, vmap and jvp, not in reverse mode; `static_argnames` as in ``jax.jit``, to be
    given by name. `known_only`: for functions that hold a user's, see `native_call`.
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
        return jax.tree.unflatten(jax.tree.structure(traced.out_info), native_call(traced.jaxpr, arrays, known_only))

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
        self.native = jax.jit(native_loop(function, static_argnames), static_argnames=static_argnames, **options)
        self.usual = jax.jit(function, static_argnames=static_argnames, **options)
        self._refused: set[Hashable] = set()

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
