"""The XLA option that compiles a whole simulation loop into one native function on the CPU.

Without it XLA launches each operation of each interval separately, at about a microsecond each; with it small batches
run two to three times faster. It is a process-wide option, read when JAX starts, so importing the package never sets
it: `enable_fast_cpu` does, once, before anything is computed; the ``stickslip`` command calls it for itself.
"""

import os

import jax
import jax.numpy as jnp
from jax import lax

FLAG = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000"
_NAME = "xla_cpu_small_while_loop_byte_threshold"


def enable_fast_cpu() -> None:
    """Make simulations in this process faster on the CPU; call it before any JAX computation.

    It changes how XLA compiles every loop of the process, which can slow scans over large matrix products.
    Raises RuntimeError if JAX has started already, and leaves everything as it was.
    """
    before = os.environ.get("XLA_FLAGS")
    if before is None or _NAME not in before:
        os.environ["XLA_FLAGS"] = FLAG if not before else f"{before} {FLAG}"
    if fast_cpu_enabled():
        return
    if before is None:
        del os.environ["XLA_FLAGS"]
    else:
        os.environ["XLA_FLAGS"] = before
    raise RuntimeError(
        "enable_fast_cpu() came too late: JAX has already started in this process and no longer reads its flags. "
        f'Call it before any JAX computation, or start Python with XLA_FLAGS="{FLAG}".'
    )


def fast_cpu_enabled() -> bool:
    """Whether small loops are compiled into native functions in this process (starts JAX to find out)."""
    if jax.default_backend() != "cpu":
        return False
    loop = jax.jit(lambda x: lax.fori_loop(0, 1000, lambda _, y: jnp.sin(y) * y, x))
    return "xla_cpu_small_call" in loop.lower(jax.ShapeDtypeStruct((1 << 16,), jnp.float32)).compile().as_text()
