"""Numbers in a tree as arrays."""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .._types import DType

T = TypeVar("T")


def as_arrays(tree: T, dtype: DType) -> T:
    """`tree` with arrays in place of its numbers, but whole ones: what differs in them only is compiled once."""

    def converted(leaf: Any) -> Any:
        is_array = isinstance(leaf, (jax.Array, np.ndarray)) and jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.asarray(leaf, dtype) if isinstance(leaf, float) or is_array else leaf

    return jax.tree.map(converted, tree)
