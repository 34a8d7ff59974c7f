"""The library diffrax, imported when something of it is first used: ``from .. import _diffrax as diffrax``.

Its import takes most of a second, and what follows closed forms needs nothing of it.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # all names of diffrax, which `__getattr__` gives when the program runs
    from diffrax import *  # noqa: F403  # pyright: ignore[reportWildcardImportFromLibrary]
else:

    def __getattr__(name: str) -> object:
        return getattr(import_module("diffrax"), name)
