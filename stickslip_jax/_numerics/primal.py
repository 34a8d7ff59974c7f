"""Values without their derivatives."""

from typing import TypeVar

import equinox as eqx
import jax
from jax import lax

_Tree = TypeVar("_Tree")


def without_derivatives(tree: _Tree) -> _Tree:
    """`tree`, its numbers without derivatives."""
    return jax.tree.map(lambda leaf: lax.stop_gradient(leaf) if eqx.is_array_like(leaf) else leaf, tree)
