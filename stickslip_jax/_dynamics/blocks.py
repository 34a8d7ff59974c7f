"""A loop of fixed length that stops early: what a trajectory of unknown length is followed in."""

from collections.abc import Callable
from typing import Any

import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jax import lax

from .._types import BoolArray, IntArray

BLOCK = 32  # turns of the loop after which to see whether all lanes of a batch have come to their end

_StepSeen = Callable[[Any, IntArray], tuple[Any, Any]]


def scan_in_blocks(
    one_step: _StepSeen,
    start: Any,
    number: int,
    is_over: Callable[[Any, IntArray], BoolArray],
    idle: Callable[[Any], Any],
) -> tuple[Any, Any]:
    """``lax.scan(one_step, start, arange(number))``, idle once ``is_over(carry, index)`` holds in all lanes of a batch.

    `number` is rounded up to whole blocks. An idle turn leaves the carry as it is, and ``idle(carry)`` as its record.
    """

    def run(carry, first):
        return lax.scan(one_step, carry, first + jnp.arange(BLOCK, dtype=jnp.int32))

    def rest(carry, _):
        record = idle(carry)
        return carry, jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (BLOCK, *jnp.shape(leaf))), record)

    def block(carry, first):
        # One answer for a whole batch: asked of each lane, both branches would be computed always.
        over = eqxi.unvmap_all(lax.stop_gradient(is_over(carry, first)))
        # Of a block, reverse mode keeps where it began and follows it again: that takes less time and far less memory
        # than keeping all that was computed in it.
        return lax.cond(over, rest, jax.checkpoint(run), carry, first)

    blocks = -(-number // BLOCK)
    firsts = jnp.arange(blocks, dtype=jnp.int32) * BLOCK
    carry, records = lax.scan(block, start, firsts)
    return carry, jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), records)


def few_sizes(number: int) -> int:
    """`number`, rounded up to a power of two or one and a half times one, at least `BLOCK`."""
    size = max(BLOCK, 1 << (number - 1).bit_length())
    return size * 3 // 4 if size * 3 // 4 >= max(number, BLOCK) else size
