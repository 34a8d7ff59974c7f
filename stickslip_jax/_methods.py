"""Methods of modules that ``help`` shows like methods.

Equinox makes a module of every bound method, so that methods are PyTrees like the modules that they belong to. As such
`help` opens with all numbers of the module, and where a method inherits its docstring, shows that of Equinox's class.
"""

import dataclasses
import inspect
import types
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np

from . import _checks
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


class _Constructor(type(eqx.Module)):
    """The class of classes whose constructors refuse in words what Equinox would stumble over before they see it."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        kind: Any = cls
        names = _parameters(kind)
        for place, value in enumerate(args):
            _checks.tree(names[min(place, len(names) - 1)], value)
        for name, value in kwargs.items():
            _checks.tree(name, value)
        for place, name in _options(kind):
            is_by_name = name in kwargs
            if not is_by_name and place >= len(args):
                continue
            value = kwargs[name] if is_by_name else args[place]
            is_number = isinstance(value, (np.generic, np.ndarray, jax.Array)) and not value.ndim
            plain = (
                value.item()
                if is_number and getattr(value.dtype, "kind", "O") in "biuf" and not _checks.is_traced(value)
                else value
            )
            if not isinstance(plain, np.generic) and plain is not value:  # Equinox would warn of a number of NumPy
                if is_by_name:
                    kwargs[name] = plain
                else:
                    args = (*args[:place], plain, *args[place + 1 :])
            elif any(isinstance(leaf, (np.ndarray, np.generic, jax.Array)) for leaf in jax.tree.leaves(value)):
                raise _checks.refused(name, "be no array", value)
        return super().__call__(*args, **kwargs)


if TYPE_CHECKING:  # for which constructors keep their signatures
    Module = eqx.Module
else:

    class Module(eqx.Module, metaclass=_Constructor):
        """A module whose constructor takes no arguments that JAX cannot go through."""


@cache
def _parameters(kind: Any) -> list[str]:
    return list(inspect.signature(kind).parameters)


@cache
def _options(kind: Any) -> tuple[tuple[int, str], ...]:
    """Place and name of the arguments of a class of the package that hold no numbers, and are not converted."""
    if not kind.__module__.startswith(f"{__name__.partition('.')[0]}."):
        return ()
    fields = dataclasses.fields(kind)
    names = {one.name for one in fields if one.metadata.get("static") and "converter" not in one.metadata}
    return tuple((place, name) for place, name in enumerate(_parameters(kind)) if name in names)


class WithMethods(Module):
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
