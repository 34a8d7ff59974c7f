"""A deprecated option that does nothing, and the number of CPU cores."""

import os
import warnings
from functools import cache


@cache
def enable_fast_cpu() -> None:
    """Deprecated; does nothing. The package's loops ask for fast compilation themselves (`_numerics/compiling.py`)."""
    warnings.warn(
        "enable_fast_cpu() does nothing any more and can be left out: simulations are fast without it.",
        DeprecationWarning,
        stacklevel=2,
    )


def cores() -> int:
    """Number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
