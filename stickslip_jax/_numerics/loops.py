"""Loops over sticks and numbers that would take NumPy many passes, compiled by Numba.

They run without Python's lock, so that threads do not wait for one another. `compiled` returns them; their callers
compute the same in NumPy where Numba is not installed. Indices are unsigned where speed matters, since Numba tests
signed ones for being negative.
"""

from functools import cache
from types import ModuleType

import numpy as np


@cache
def compiled() -> ModuleType | None:
    """The module of the compiled loops; None where Numba is not installed. They compile when first called."""
    try:
        from . import numba_loops  # noqa: PLC0415 - importing Numba takes half a second
    except ImportError:
        return None
    return numba_loops


def read_only(array: np.ndarray, dtype: type | None = None) -> np.ndarray:
    """The same numbers, contiguous and read-only: the loops are then compiled for one kind of array only."""
    array = np.ascontiguousarray(array, dtype).view()
    array.flags.writeable = False
    return array
