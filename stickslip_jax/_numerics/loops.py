"""Loops over sticks and numbers that NumPy would need many passes for, compiled by Numba.

They run without Python's lock, so that threads do not wait for one another. `compiled` gives them; their callers do the
same in NumPy where Numba is not installed. Indices are unsigned where it matters: Numba would test signed ones for
being negative.
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
    """The same numbers in order of memory and not to be written to, as the loops take them: a kind less to compile."""
    array = np.ascontiguousarray(array, dtype).view()
    array.flags.writeable = False
    return array
