"""A call that stays one call under every transformation of JAX, compiled into one native function of the CPU.

XLA (jaxlib 0.10.2) aborts the process if a native function does not read one of its arguments. That can happen to any
function under ``jax.jit``: JAX removes unused results, which every derivative of a derivative has, and what only they
needed. This primitive has no rule for removing anything, so that after all transformations every argument is read and
every result kept.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from .known_operations import compilable

NATIVE = {"inlineable": "false", "xla_cpu_small_call": "true"}

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


@lru_cache(_KEPT)
def _with_tangents(closed: ClosedJaxpr, moved: tuple[bool, ...]) -> tuple[ClosedJaxpr, tuple[bool, ...]]:
    """The function of all arguments and the tangents of those that are `moved`; its results are those of `closed` and
    the tangents of the real ones, and which these are.
    """
    real = tuple(jnp.issubdtype(aval.dtype, jnp.inexact) for aval in closed.out_avals)

    def both(args, tangents):
        def of(*changed):
            changed = iter(changed)
            return jaxpr_as_fun(closed)(*(next(changed) if m else arg for arg, m in zip(args, moved, strict=True)))

        out, slopes = jax.jvp(of, [arg for arg, m in zip(args, moved, strict=True) if m], tangents)
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
