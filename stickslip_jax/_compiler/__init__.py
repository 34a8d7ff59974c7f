"""What the package asks of the compiler beyond ``jax.jit``, for speed alone; ``STICKSLIP_PLAIN_JAX=1`` turns it off.

- `native_loop`, `CompiledNatively`: a loop over small arrays as one native function of the CPU.
- `computed_once`, `sharing`: values that several results need are computed once.
- `packed`, `unpacked`, `Layout`: few arrays in place of many, for calls of compiled functions.
- `WIDE_VECTORS`, `COMPILED_QUICKLY`: options of the compiler.

docs/compiler.md says which weakness of JAX or XLA each is for, and when it can go.
"""

from .native_loops import (
    COMPILED_QUICKLY,
    WIDE_VECTORS,
    CompiledNatively,
    computed_once,
    native_loop,
    native_loops_work,
)
from .recomputation import Layout, packed, sharing, unpacked

__all__ = [
    "COMPILED_QUICKLY",
    "WIDE_VECTORS",
    "CompiledNatively",
    "Layout",
    "computed_once",
    "native_loop",
    "native_loops_work",
    "packed",
    "sharing",
    "unpacked",
]
