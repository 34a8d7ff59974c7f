"""How a function asks the XLA compiler for native loops, one function at a time and without process-wide options.

XLA's CPU back end launches each operation of a loop separately, at about a microsecond each, and where several results
share an intermediate value it computes that value again for each. Both can be turned off for one function by frontend
attributes on its call, which these wrappers set. On other devices, and for versions of JAX that do not know them, the
attributes mean nothing and the function is compiled as usual.
"""

from collections.abc import Callable
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import jax
import numpy as np
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

_OWN_CALL = {"inlineable": "false"}
_NATIVE = {"inlineable": "false", "xla_cpu_small_call": "true"}


def native_loop(
    function: Callable[_Arguments, _Result], static_argnames: tuple[str, ...] = ()
) -> Callable[_Arguments, _Result]:
    """`function`, a loop over small arrays, compiled into one native function of the CPU.

    One thread runs it. Works under jit, vmap, jvp and grad; `static_argnames` as in ``jax.jit``.
    """
    return _tagged(function, static_argnames, _NATIVE)


def computed_once(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """`function`, its results stored: whatever uses them does not compute them again."""
    return _tagged(function, (), _OWN_CALL)


def _tagged(function: Callable, static_argnames: tuple[str, ...], tags: dict[str, str]) -> Callable:
    compiled = jax.jit(function, static_argnames=static_argnames)

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        if not native_loops_work():
            return function(*args, **options)
        # Tagging the results tags the call that they come from. (The context manager of the same name would tag every
        # operation inside it too, and none of those would then be fused.)
        return set_xla_metadata(compiled(*args, **options), **tags)

    return call


@cache
def native_loops_work() -> bool:
    """Whether this JAX compiles a tagged loop for the CPU, and computes the right thing."""
    if jax.default_backend() != "cpu":
        return False

    def loop(x):
        return lax.fori_loop(0, 3, lambda _, y: 2 * y, x)

    try:
        # Compiled ahead of the call: a plain call would be traced where this is asked for under the user's jit.
        ones = np.ones(2, np.float32)
        compiled = jax.jit(lambda x: set_xla_metadata(jax.jit(loop)(x), **_NATIVE)).lower(ones).compile()
        text, right = compiled.as_text() or "", np.array_equal(np.asarray(compiled(ones)), [8, 8])
    except Exception:  # a probe: whatever goes wrong, plain compilation works
        return False
    return right and "xla_cpu_small_call" in text
