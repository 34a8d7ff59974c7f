"""Bounds of numbers that JAX traces: under jvp, grad and vmap (outside jit) their values are known.

Sizes of arrays must be Python numbers; where they depend on traced numbers, they are computed from these bounds.
Nothing else may use them: a result would depend on numbers without JAX knowing it.
"""

from typing import Any

import jax
import numpy as np
from jax import lax

from .. import _checks


class NotKnown(Exception):
    """Raised for a traced number whose value is not known before the compiled function is called."""


def primal_of(value: Any) -> Any:
    """A number without its derivatives: no tracer any more under jvp and grad alone. Others stay as they are."""
    return lax.stop_gradient(value) if _checks.is_traced(value) else value


def values_of(value: Any) -> np.ndarray:
    """All values that a number stands for, those of a batch under vmap. Raises NotKnown under jit."""
    value = primal_of(value)
    if not _checks.is_traced(value):
        return np.asarray(value)
    found = []

    # Under vmap, the rule of a function is handed the whole batch.
    @jax.custom_batching.custom_vmap
    def look(number):
        return number

    @look.def_vmap
    def _(size, is_batched, batch):
        found.append(batch)
        return batch, is_batched[0]

    look(value)
    if not found:
        raise NotKnown
    return values_of(found[0])


def bounds_of(value: Any) -> tuple[float, float]:
    """The smallest and the largest of the values that a number stands for. Raises NotKnown under jit."""
    values = values_of(value)
    return float(np.min(values)), float(np.max(values))


def largest(value: Any) -> float:
    """The largest value that a number stands for. Raises NotKnown under jit."""
    return bounds_of(value)[1]


def smallest(value: Any) -> float:
    """The smallest value that a number stands for. Raises NotKnown under jit."""
    return bounds_of(value)[0]
