"""Shapes and types in annotations are checked while the tests run, never for users.

jaxtyping writes two functions for each one that it checks, and beartype another two: of the whole package in half a
minute, in each process. Here they are written when a function is first called.
"""

import functools
import pkgutil
import sys
import threading
import types
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import jaxtyping

# `_compiler` goes through every operation of every program in small functions: checking them took a fifth of the time.
UNCHECKED = {"_compiler"}
# A warning names the first line that is not of this package, jaxtyping or beartype.
__name__ = "jaxtyping.when_first_called"
# beartype catches warnings while it writes: two threads that do would leave each other's filters behind.
_writing = threading.RLock()
_jaxtyped: Callable[..., Any] = jaxtyping.jaxtyped


def check_annotations(package: str) -> None:
    """Check those of a package, in this process. Raises RuntimeError where it was imported before."""
    if package in sys.modules:
        raise RuntimeError(f"{package} was imported before its annotation checks could be switched on")
    parts = [part.name for part in pkgutil.iter_modules(find_spec(package).submodule_search_locations)]
    # Where the hook finds it, and where it finds itself again, for classes and what they wrap.
    jaxtyping.jaxtyped = jaxtyping._decorator.jaxtyped = _checked
    jaxtyping.install_import_hook([f"{package}.{part}" for part in parts if part not in UNCHECKED], "beartype.beartype")


def _checked(function: Any = None, *, typechecker: Any) -> Any:
    """`jaxtyping.jaxtyped`, whose work is done when the function is first called."""
    if function is None:
        return functools.partial(_checked, typechecker=typechecker)
    if not isinstance(function, types.FunctionType):
        return _jaxtyped(function, typechecker=typechecker)
    if hasattr(function, "written"):  # the __init__ that a class has from another
        return function

    @functools.wraps(function)
    def checked(*args: Any, **named: Any) -> Any:
        __tracebackhide__ = True
        if checked.written is None:
            with _writing:
                checked.written = checked.written or _jaxtyped(function, typechecker=typechecker)
        return checked.written(*args, **named)

    checked.written = None
    return checked
