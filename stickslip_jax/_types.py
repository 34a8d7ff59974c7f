"""Array aliases used in annotations: the shape is in the annotation, the unit in the docstring."""

from typing import TypeAlias

import numpy as np
from jaxtyping import Array, Bool, Float, Int, Real, UInt32

Scalar: TypeAlias = Real[Array, ""] | float
"""A single real number: a Python float or a zero-dimensional array (traced or not)."""

AnyArray: TypeAlias = Array | np.ndarray
"""An array of JAX or, in results that have left JAX, of NumPy."""

AnyInteger: TypeAlias = Array | np.integer
"""A whole number of fixed size, traced or not."""

FloatArray: TypeAlias = Float[Array, "..."]
BoolArray: TypeAlias = Bool[Array, "..."]
IntArray: TypeAlias = Int[Array, "..."]
KeyData: TypeAlias = UInt32[Array, "2"] | tuple[UInt32[Array, "..."], UInt32[Array, "..."]]
"""The two 32-bit words of a threefry key, as one array or apart."""

__all__ = [
    "AnyArray",
    "AnyInteger",
    "Array",
    "Bool",
    "BoolArray",
    "Float",
    "FloatArray",
    "Int",
    "IntArray",
    "KeyData",
    "Scalar",
]
