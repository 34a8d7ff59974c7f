"""Numba where there is one."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any


def compiled(function: Any) -> Any:
    """`function` compiled by Numba; where there is none, for the newest Python, it runs slowly as it is written."""
    if find_spec("numba") is None:
        return function
    compile_with = import_module("numba").njit
    try:
        return compile_with(cache=True, error_model="numpy")(function)
    except RuntimeError:  # no cache folder is writable
        return compile_with(error_model="numpy")(function)
