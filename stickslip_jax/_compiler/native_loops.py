"""Native loops of the XLA compiler, asked for function by function and without process-wide options.

XLA's CPU back end launches each operation of a loop separately, at about a microsecond each, and where several results
share an intermediate value it computes that value again for each. Both can be turned off for one function by frontend
attributes on its call, which these wrappers set. On other devices, and for versions of JAX that do not know them, the
attributes mean nothing and the function is compiled as usual.
"""

import warnings
from collections.abc import Callable
from functools import cache, wraps
from typing import Any, Generic, ParamSpec, TypeVar, cast

import jax
import numpy as np
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata

from .._types import PyTreeDef
from .native_call import NATIVE, native_call
from .switch import PLAIN

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

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
        self._refused: set[PyTreeDef] = set()

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
