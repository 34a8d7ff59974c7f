"""What the package asks of the compiler beyond ``jax.jit``, for speed alone; ``STICKSLIP_PLAIN_JAX=1`` turns it off.

- `native_loop`, `CompiledNatively`: a loop over small arrays as one native function of the CPU.
- `computed_once`, `sharing`: values that several results need are computed once.
- `packed`, `unpacked`, `Layout`: few arrays in place of many, for calls of compiled functions.
- `of_moving`, `flattened`: a function of those of its arguments that have a tangent, or that are arrays.
- `WIDE_VECTORS`, `COMPILED_QUICKLY`: options of the compiler.

docs/compiler.md says which weakness of JAX or XLA each is for, and when it can go.
"""

from .native_loops import COMPILED_QUICKLY as COMPILED_QUICKLY
from .native_loops import WIDE_VECTORS as WIDE_VECTORS
from .native_loops import CompiledNatively as CompiledNatively
from .native_loops import computed_once as computed_once
from .native_loops import native_loop as native_loop
from .native_loops import native_loops_work as native_loops_work
from .native_loops import of_moving as of_moving
from .recomputation import Layout as Layout
from .recomputation import flattened as flattened
from .recomputation import packed as packed
from .recomputation import sharing as sharing
from .recomputation import unpacked as unpacked
