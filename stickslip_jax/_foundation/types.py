"""Names of types for annotations: shapes are in the annotations, units in the docstrings; integer codes in results."""

from collections.abc import Hashable, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Any, ForwardRef, TypeAlias

import numpy as np
from jaxtyping import Array, Bool, Float, Int, Real, UInt32

# Names of types for annotations: shapes are in the annotations, units in the docstrings.


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
else:  # names alone, for nothing of diffrax is imported before it is used (`lazy_diffrax.py`)
    Solver = ForwardRef("AbstractSolver", module="diffrax")
    ExplicitSolver = ForwardRef("AbstractERK", module="diffrax")
    """An explicit Runge-Kutta method, such as ``diffrax.Dopri8()``."""


# Integer codes in result arrays: how a stick ended, and whether a trajectory reached its end.


class Ending(IntEnum):
    """Why a stick ended."""

    RELEASED = 0
    """The force needed to hold the mass reached the friction limit: the mass slips."""
    BASE_SWITCHED = 1
    """The base velocity jumped; the mass cannot follow a jump."""
    HORIZON = 2
    """The simulation ended first: the duration is censored, the true one is longer."""


class Status(IntEnum):
    """Whether one trajectory (one sample of a batch) reached ``t1``, or why not."""

    FINISHED = 0
    """The trajectory reached ``t1``."""
    BASE_TOO_SHORT = 1
    """The base motion ran out of intervals before ``t1``: nothing after that instant was simulated."""
    NOT_FINITE = 2
    """The state became NaN or infinite, or one base interval was longer than 2^30 rad of the free oscillation."""
    OUT_OF_STEPS = 3
    """All time steps allowed were used before ``t1``: nothing after that instant was simulated."""
    SOLVER_FAILED = 4
    """The adaptive solver of regularised dynamics gave up before ``t1``: nothing after that instant was simulated."""
    BASE_INVALID = 5
    """An interval of the base motion (or of a ground motion or force) had a negative duration or a number that is not
    finite: nothing after it was simulated."""
    REDUNDANT_CONTACTS = 6
    """The relative velocity of one contact of a structure is implied by those of others, so that no motion is the only
    one: where JAX traces the masses or directions, this is found when they are known. What was simulated means nothing.
    """

    @property
    def meaning(self) -> str:
        """One plain sentence, for tables and messages."""
        return _MEANINGS[self]


_MEANINGS = {
    Status.FINISHED: "reached t1",
    Status.BASE_TOO_SHORT: "the base motion had too few intervals to reach t1 (one of duration 0 is the last)",
    Status.NOT_FINITE: "the state became NaN or infinite, or a base interval spans more than 2^30 rad",
    Status.OUT_OF_STEPS: "all time steps allowed were used before t1 (leave max_steps out of method=, or raise it)",
    Status.SOLVER_FAILED: "the adaptive solver gave up (try another solver, or other tolerances)",
    Status.BASE_INVALID: (
        "an interval of the base motion had a negative duration or a number that is not finite (the law must give "
        "durations above 0, 0 after the last interval only, and finite velocities; times must increase from 0)"
    ),
    Status.REDUNDANT_CONTACTS: (
        "the relative velocity of one contact is implied by those of others (join contacts of the same direction)"
    ),
}
