"""The public names of a package, read from the stub beside it, each loaded when it is asked for."""

import ast
import pkgutil
import sys
from collections.abc import Callable
from importlib import import_module


def attached(package: str) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package whose ``__init__.pyi`` imports all its public names.

    ``__all__`` leaves out its modules, which ``from package import *`` need not load.
    """
    homes: dict[str, str | None] = {}
    for node in ast.parse(pkgutil.get_data(package, "__init__.pyi") or "").body:
        if isinstance(node, ast.ImportFrom):
            homes |= {alias.name: node.module and "." * node.level + node.module for alias in node.names}

    def __getattr__(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        if home is None:
            return import_module(f"{package}.{name}")
        value = getattr(import_module(home, package), name)
        setattr(sys.modules[package], name, value)  # so that it is looked for once
        return value

    shown = [*homes, *(["__version__"] if "." not in package else [])]
    return __getattr__, lambda: sorted(shown), sorted(name for name, home in homes.items() if home)
