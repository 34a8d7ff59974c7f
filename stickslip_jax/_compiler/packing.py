"""Many small arrays packed into a few: JAX takes microseconds for each array that a compiled function is given.

Arrays of the same type and shape are stacked.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .._types import PyTreeDef
from .switch import PLAIN


class Layout(NamedTuple):
    """How to unpack a pytree; may be a static argument of ``jax.jit``."""

    structure: PyTreeDef
    kinds: tuple[tuple[jnp.dtype, tuple[int, ...]], ...]  # type and shape of each leaf

    @classmethod
    def of(cls, tree: Any) -> "Layout":
        """The layout of a pytree of arrays, or of their shapes."""
        leaves, structure = jax.tree.flatten(tree)
        return cls(structure, tuple((leaf.dtype, leaf.shape) for leaf in leaves))


def packed(tree: Any) -> tuple[jax.Array, ...]:
    """The arrays of a pytree, those of the same type and shape stacked."""
    if PLAIN:
        return tuple(map(jnp.asarray, jax.tree.leaves(tree)))
    together: dict[tuple[jnp.dtype, tuple[int, ...]], list[jax.Array]] = {}
    for leaf in jax.tree.leaves(tree):
        together.setdefault((leaf.dtype, leaf.shape), []).append(leaf)
    return tuple(jnp.stack(leaves) for leaves in together.values())


def unpacked(arrays: tuple[jax.Array, ...], layout: Layout) -> Any:
    """The pytree that was `packed`."""
    if PLAIN:
        return jax.tree.unflatten(layout.structure, arrays)
    together = {kind: iter(array) for kind, array in zip(dict.fromkeys(layout.kinds), arrays, strict=True)}
    return jax.tree.unflatten(layout.structure, [next(together[kind]) for kind in layout.kinds])
