"""Methods of modules that ``help`` shows like methods, and what a class states about its own methods."""

import dataclasses
import inspect
import types
from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import jax
import numpy as np

from . import checks
from .processes import require_threads_of_jax

# What a class states about its own methods, and what becomes of it in a subclass that overrides them.
#
# `Coulomb` states that its friction coefficient does not depend on the speed, and slips then have closed forms. A
# subclass with another `kinetic` would inherit the statement, and move as plain `Coulomb` does. So a statement holds
# for the methods it was made of: where a subclass overrides one of them and does not repeat the statement, it is
# withdrawn.


class WithClaims:
    """A class whose statements about its methods do not outlive them.

    `rests_on`: the methods that each statement is about, by the name of the attribute that states it. A withdrawn one
    is again what the first class says that has it, which must be true of any methods.
    `only_with`: methods that show what others do, and the others: a subclass may not override the first alone.
    """

    rests_on: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    only_with: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    def __init_subclass__(cls, **kwargs: object):
        super().__init_subclass__(**kwargs)
        for claim, methods in cls.rests_on.items():
            above, holders = _above(cls, claim)
            if any(name in vars(kind) for kind in above for name in methods):
                setattr(cls, claim, vars(holders[-1])[claim])
        for name, others in cls.only_with.items():
            if all(name in {method for kind in _above(cls, other)[0] for method in vars(kind)} for other in others):
                needed = " or ".join(others)
                raise TypeError(
                    f"Class {cls.__name__} must override {needed} too where it overrides {name}: what is simulated "
                    f"follows from {needed}, and {name} alone would only show something else."
                )


def _above(cls: type, name: str) -> tuple[list[type], list[type]]:
    """The classes that `cls` looks in before it finds the attribute `name`, and all that have it, in that order."""
    holders = [kind for kind in cls.__mro__ if name in vars(kind)]
    return list(cls.__mro__[: cls.__mro__.index(holders[0])]), holders


def keeps(value: object, kind: type, *methods: str) -> bool:
    """Whether `value` is of this `kind`, or of a subclass that leaves these `methods` as they are."""
    return isinstance(value, kind) and all(getattr(type(value), name) is getattr(kind, name) for name in methods)


# Methods of modules that ``help`` shows like methods.
#
# Equinox makes a module of every bound method, so that methods are PyTrees like the modules that they belong to. As
# such `help` opens with all numbers of the module, and where a method inherits its docstring, shows that of Equinox's
# class.


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
        args = tuple(_taken(kind, names[min(place, len(names) - 1)], value) for place, value in enumerate(args))
        return super().__call__(*args, **{name: _taken(kind, name, value) for name, value in kwargs.items()})


def _taken(kind: Any, name: str, value: Any) -> Any:
    """`value`, the argument `name` of a class of the `kind`, as Equinox takes it."""
    checks.tree(name, value)
    if name not in _options(kind):
        return value
    is_number = isinstance(value, (np.generic, np.ndarray, jax.Array)) and not value.ndim
    if is_number and getattr(value.dtype, "kind", "O") in "biuf" and not checks.is_traced(value):
        plain = value.item()  # Equinox would warn of a number of NumPy
        if not isinstance(plain, np.generic):
            return plain
    if any(isinstance(leaf, (np.ndarray, np.generic, jax.Array)) for leaf in jax.tree.leaves(value)):
        raise checks.refused(name, "be no array", value)
    return value


if TYPE_CHECKING:  # for which constructors keep their signatures
    Module = eqx.Module
else:

    class Module(eqx.Module, metaclass=_Constructor):
        """A module whose constructor takes no arguments that JAX cannot go through."""


@cache
def _parameters(kind: Any) -> list[str]:
    return list(inspect.signature(kind).parameters)


@cache
def _options(kind: Any) -> frozenset[str]:
    """The arguments of a class of the package that hold no numbers, and are not converted."""
    if not kind.__module__.startswith(f"{__name__.partition('.')[0]}."):
        return frozenset()
    fields = dataclasses.fields(kind)
    return frozenset(one.name for one in fields if one.metadata.get("static") and "converter" not in one.metadata)


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
