"""Methods of modules that ``help`` shows like methods.

Equinox makes a module of every bound method, so that methods are PyTrees like the modules that they belong to. As such
`help` opens with all numbers of the module, and where a method inherits its docstring, shows that of Equinox's class.
"""

import inspect
import types
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import equinox as eqx


class Method(eqx.Module):
    # A bound method of a module: a PyTree that holds the module. Its docstring is that of the method.

    __func__: Callable = eqx.field(static=True)
    __self__: eqx.Module

    def __post_init__(self):
        for name in ("__module__", "__name__", "__qualname__"):
            object.__setattr__(self, name, getattr(self.__func__, name, ""))

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        return self.__func__(self.__self__, *args, **kwargs)

    def __get__(self, instance: Any, owner: Any = None) -> "Method":
        return self  # with this, inspect takes it for a routine, and shows its signature and docstring

    @property
    def __wrapped__(self) -> Any:
        return types.MethodType(self.__func__, self.__self__)

    if not TYPE_CHECKING:
        __doc__ = property(lambda self: inspect.getdoc(self.__wrapped__))

    def __repr__(self) -> str:
        return f"<bound method {self.__func__.__qualname__} of a {type(self.__self__).__name__}>"


class WithMethods(eqx.Module):
    """A module with such methods."""

    if not TYPE_CHECKING:  # which knows the attributes otherwise

        def __getattribute__(self, name: str) -> Any:
            found = object.__getattribute__(self, name)
            if type(found) is types.MethodType and found.__self__ is self and not name.startswith("__"):
                return Method(found.__func__, self)
            return found
