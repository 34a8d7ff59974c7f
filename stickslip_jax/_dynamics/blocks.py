"""A scan of fixed length that stops early, for trajectories whose number of steps is not known in advance."""

from collections.abc import Callable
from typing import Any

import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jax import lax

from .._types import BoolArray, IntArray

BLOCK = 32  # steps between two checks whether all lanes of a batch have ended

_StepSeen = Callable[[Any, IntArray], tuple[Any, Any]]


def scan_in_blocks(
    one_step: _StepSeen,
    start: Any,
    number: int,
    is_over: Callable[[Any, IntArray], BoolArray],
    idle: Callable[[Any], Any],
) -> tuple[Any, Any]:
    """``lax.scan(one_step, start, arange(number))``, idle once ``is_over(carry, index)`` holds in all lanes of a batch.

    `number` is rounded up to whole blocks. An idle step leaves the carry unchanged and records ``idle(carry)``.
    """

    def run(carry, first):
        return lax.scan(one_step, carry, first + jnp.arange(BLOCK, dtype=jnp.int32))

    def rest(carry, _):
        record = idle(carry)
        return carry, jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (BLOCK, *jnp.shape(leaf))), record)

    def block(carry, first):
        # One condition for the whole batch: with one per lane, vmap would always compute both branches.
        over = eqxi.unvmap_all(lax.stop_gradient(is_over(carry, first)))
        # Reverse mode keeps only the start of a block and computes the block again: that takes less time and far less
        # memory than keeping every intermediate value.
        return lax.cond(over, rest, jax.checkpoint(run), carry, first)

    blocks = -(-number // BLOCK)
    firsts = jnp.arange(blocks, dtype=jnp.int32) * BLOCK
    carry, records = lax.scan(block, start, firsts)
    return carry, jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), records)


def few_sizes(number: int) -> int:
    """`number` rounded up to ``2^k`` or ``1.5 * 2^k``, at least `BLOCK`, so that few sizes are compiled."""
    size = max(BLOCK, 1 << (number - 1).bit_length())
    return size * 3 // 4 if size * 3 // 4 >= max(number, BLOCK) else size
