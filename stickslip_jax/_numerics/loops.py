"""Loops over sticks that would take NumPy many passes, compiled by Numba.

They run without Python's lock, so that threads do not wait for one another. Indices are unsigned where speed matters,
since Numba tests signed ones for being negative.
"""

from functools import cache
from types import ModuleType

import numpy as np


@cache
def compiled() -> ModuleType:
    """The module of the loops, imported on the first call: Numba takes half a second. Each compiles on its first call.

    For a Python that is newer than Numba the same loops run uncompiled, some hundred times slower.
    """
    from . import numba_loops  # noqa: PLC0415

    return numba_loops


def read_only(array: np.ndarray, dtype: type | None = None) -> np.ndarray:
    """The same numbers, contiguous and read-only: the loops are then compiled for one kind of array only."""
    array = np.ascontiguousarray(array, dtype).view()
    array.flags.writeable = False
    return array
