"""Reductions over the contacts of a system.

What belongs to each contact is an array (contacts,), and without that axis where there is one contact: a scalar of
each trajectory, which compiles to faster loops.
"""

import jax.numpy as jnp

from .._types import Array, BoolArray, BoolScalar, FloatArray, FloatScalar


def any_of(of_each: BoolArray) -> BoolScalar:
    """Whether it is true of any contact."""
    return of_each if of_each.ndim == 0 else jnp.any(of_each)


def least_of(of_each: FloatArray) -> FloatScalar:
    """The smallest of all contacts."""
    return of_each if of_each.ndim == 0 else jnp.min(of_each)


def largest_of(of_each: FloatArray) -> FloatScalar:
    """The largest of all contacts."""
    return of_each if of_each.ndim == 0 else jnp.max(of_each)


def sum_of(of_each: Array) -> Array:
    """The sum over the contacts."""
    return of_each if of_each.ndim == 0 else jnp.sum(of_each)
