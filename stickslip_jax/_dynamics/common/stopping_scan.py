"""A scan of fixed length that stops early, for trajectories whose number of steps is not known in advance."""

from collections.abc import Callable
from typing import TypeVar

import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jax import lax

from ..._types import BoolArray, IntArray

CHECK_EVERY = 32
"""Steps between two checks whether all lanes of a batch have ended."""

_Carry = TypeVar("_Carry")
_Record = TypeVar("_Record")


def stopping_scan(
    step: Callable[[_Carry, IntArray], tuple[_Carry, _Record]],
    start: _Carry,
    number: int,
    is_over: Callable[[_Carry, IntArray], BoolArray],
    idle_record: Callable[[_Carry], _Record],
) -> tuple[_Carry, _Record]:
    """``lax.scan(step, start, arange(number))``, idle once ``is_over(carry, index)`` holds in all lanes of a batch.

    `number` is rounded up to a multiple of `CHECK_EVERY`. An idle step leaves the carry unchanged and records
    ``idle_record(carry)``.
    """

    def run(carry, first):
        return lax.scan(step, carry, first + jnp.arange(CHECK_EVERY, dtype=jnp.int32))

    def rest(carry, _):
        record = idle_record(carry)
        return carry, jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (CHECK_EVERY, *jnp.shape(leaf))), record)

    def run_or_rest(carry, first):
        # One condition for the whole batch: with one per lane, vmap would always compute both branches.
        over = eqxi.unvmap_all(lax.stop_gradient(is_over(carry, first)))
        # Reverse mode keeps only the start of these steps and computes them again: that takes less time and far less
        # memory than keeping every intermediate value.
        return lax.cond(over, rest, jax.checkpoint(run), carry, first)

    firsts = jnp.arange(-(-number // CHECK_EVERY), dtype=jnp.int32) * CHECK_EVERY
    carry, records = lax.scan(run_or_rest, start, firsts)
    return carry, jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), records)


def padded_length(number: int) -> int:
    """`number` rounded up to ``2^k`` or ``1.5 * 2^k``, at least `CHECK_EVERY`: few lengths are compiled."""
    size = max(CHECK_EVERY, 1 << (number - 1).bit_length())
    return size * 3 // 4 if size * 3 // 4 >= max(number, CHECK_EVERY) else size
