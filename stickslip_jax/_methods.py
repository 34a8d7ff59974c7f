"""Methods of modules that ``help`` shows like methods.

Equinox makes a module of every bound method, so that methods are PyTrees like the modules that they belong to. As such
`help` opens with all numbers of the module, and where a method inherits its docstring, shows that of Equinox's class.
"""

import inspect
import types
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import equinox as eqx

from ._forks import require_threads_of_jax


class Method(eqx.Module):
    # A bound method of a module: a PyTree that holds the module. Its docstring is that of the method.

    __func__: Callable = eqx.field(static=True)
    __self__: eqx.Module

    def __post_init__(self):
        for name in ("__module__", "__name__", "__qualname__"):
            object.__setattr__(self, name, getattr(self.__func__, name, ""))

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        require_threads_of_jax()  # what it computes would wait for them for ever
        return self.__func__(self.__self__, *args, **kwargs)

    def __get__(self, instance: object, owner: type | None = None) -> "Method":
        return self  # with this, inspect takes it for a routine, and shows its signature and docstring

    @property
    def __wrapped__(self) -> types.MethodType:
        return types.MethodType(self.__func__, self.__self__)

    if not TYPE_CHECKING:
        __doc__ = property(lambda self: inspect.getdoc(self.__wrapped__))

    def __repr__(self) -> str:
        return f"<bound method {self.__func__.__qualname__} of a {type(self.__self__).__name__}>"


class _Function:
    # A function in a class: a module of the class that is asked for it gives a `Method`, the class the function.

    def __init__(self, function: types.FunctionType):
        self.function = function

    def __get__(self, instance: eqx.Module | None, owner: type | None = None) -> Callable:
        return self.function if instance is None else Method(self.function, instance)


class WithMethods(eqx.Module):
    """A module with such methods."""

    if not TYPE_CHECKING:
        # Python's own in C, since Equinox's runs in Python whatever attribute is asked for.
        __getattribute__ = object.__getattribute__

    def __init_subclass__(cls, **kwargs: object):
        super().__init_subclass__(**kwargs)
        for name, value in list(vars(cls).items()):
            if type(value) is types.FunctionType and not (
                name.startswith("__") or getattr(value, "__isabstractmethod__", False)
            ):
                setattr(cls, name, _Function(value))
