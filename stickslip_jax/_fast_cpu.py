"""The XLA options that make simulations fast on the CPU.

The first compiles a whole simulation loop into one native function, where XLA otherwise launches each operation of
each interval separately, at about a microsecond each. The second computes all results of an interval in one pass,
where XLA otherwise repeats for each result whatever it shares with others. Together they are worth a factor of three
(``benchmarks/README.md``). They are process-wide and read when JAX starts, so importing the package never sets
them: `enable_fast_cpu` does, once, before anything is computed; the ``stickslip`` command calls it for itself.
"""

import os
from functools import cache

import jax
import jax.numpy as jnp
from jax import lax

FLAG = (
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000,xla_cpu_use_multi_output_fusion=true"
)
_NAME = "xla_cpu_small_while_loop_byte_threshold"


def enable_fast_cpu() -> None:
    """Make simulations in this process faster on the CPU; call it before any JAX computation.

    It changes how XLA compiles every loop of the process, which can slow scans over large matrix products.
    It does nothing where JAX runs on something else than the CPU. Raises RuntimeError if JAX has started already, and
    leaves everything as it was.
    """
    before = os.environ.get("XLA_FLAGS")
    if before is None or _NAME not in before:
        os.environ["XLA_FLAGS"] = FLAG if not before else f"{before} {FLAG}"
    fast_cpu_enabled.cache_clear()
    if fast_cpu_enabled() or jax.default_backend() != "cpu":
        return
    if before is None:
        del os.environ["XLA_FLAGS"]
    else:
        os.environ["XLA_FLAGS"] = before
    raise RuntimeError(
        "enable_fast_cpu() had no effect: JAX has already started in this process and no longer reads its flags, or "
        f"XLA_FLAGS, {before!r}, holds other values for them. "
        f'Call it before any JAX computation, or start Python with XLA_FLAGS="{FLAG}".'
    )


@cache
def fast_cpu_enabled() -> bool:
    """Whether small loops are compiled into native functions in this process (starts JAX to find out, once)."""
    if jax.default_backend() != "cpu":
        return False
    loop = jax.jit(lambda x: lax.fori_loop(0, 1000, lambda _, y: jnp.sin(y) * y, x))
    compiled = loop.lower(jax.ShapeDtypeStruct((1 << 16,), jnp.float32)).compile()
    return "xla_cpu_small_call" in (compiled.as_text() or "")


def cores() -> int:
    """How many threads can work at once."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
