"""Names of types for annotations: shapes are in the annotations, units in the docstrings."""

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, Any, ForwardRef, TypeAlias

import numpy as np
from jaxtyping import Array, Bool, Float, Int, Real, UInt32

Scalar: TypeAlias = Real[Array, ""] | float | int
"""A single real number: of Python, or a zero-dimensional array (traced or not)."""

Number: TypeAlias = Any
"""A real number; for `simulate_ensemble` also an array with one for each sample, or a distribution."""

AnyArray: TypeAlias = Array | np.ndarray
"""An array of JAX or, in results that have left JAX, of NumPy."""

DType: TypeAlias = np.dtype | type
"""A floating-point type, as NumPy and JAX name them."""

AnyInteger: TypeAlias = Array | np.integer
"""A whole number of JAX or NumPy, traced or not."""

FloatArray: TypeAlias = Float[Array, "..."]
BoolArray: TypeAlias = Bool[Array, "..."]
IntArray: TypeAlias = Int[Array, "..."]
FloatScalar: TypeAlias = Float[Array, ""]
BoolScalar: TypeAlias = Bool[Array, ""]
KeyData: TypeAlias = UInt32[Array | np.ndarray, "2"] | tuple[UInt32[Array, "..."], UInt32[Array, "..."]]
"""The two 32-bit words of a threefry key, as one array or as two."""

InitialState: TypeAlias = Sequence[Number] | AnyArray
"""An initial state: a number for each coordinate of the system; in ensembles also an array (samples,) or a distribution
of it, or an array (samples, coordinates) of all.
"""

Word: TypeAlias = UInt32[Array, ""]
"""32 random bits, or the number of a segment, of which there are at most 2^32."""

State: TypeAlias = tuple[FloatArray, ...]
"""The state of a system: one array for each of its coordinates, all of one shape."""

PyTreeDef: TypeAlias = Hashable
"""The structure of a pytree, ``jax.tree_util.PyTreeDef``, which type checkers take for a variable."""

if TYPE_CHECKING:
    from diffrax import AbstractERK as ExplicitSolver
    from diffrax import AbstractSolver as Solver
else:  # names alone, for nothing of diffrax is imported before it is used (`_diffrax.py`)
    Solver = ForwardRef("AbstractSolver", module="diffrax")
    ExplicitSolver = ForwardRef("AbstractERK", module="diffrax")
    """An explicit Runge-Kutta method, such as ``diffrax.Dopri8()``."""
