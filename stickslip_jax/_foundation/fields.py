"""What stands once at the classes of systems and laws: unit, bounds and meaning of their fields, in the annotation of
each, and what they state about their own methods, which ``help`` shows like methods.

The constructors check their arguments by the fields, and a study's file takes its keys from them.
"""

import dataclasses
import inspect
import types
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, get_type_hints

import equinox as eqx
import jax
import numpy as np
import numpy.typing as npt

from . import checks

PACKAGE = __name__.partition(".")[0]

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
        checks.require_threads_of_jax()  # what it computes would wait for them for ever
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
        """A module whose constructor takes no arguments that JAX cannot go through, printed on one line."""

        def __repr__(self) -> str:
            parts = []
            for field in dataclasses.fields(self):
                value = getattr(self, field.name, None)
                if field.repr and not field.name.startswith("_") and value is not field.default:
                    parts.append(f"{field.name}={in_one_line(value)}")
            return f"{type(self).__name__}({', '.join(parts)})"


_FEW = 4  # numbers that are printed one by one


def in_one_line(value: object) -> str:
    """A value of a field as it is printed: numbers as such, of many how many there are and from what to what."""
    if isinstance(value, (tuple, list)):
        inside = ", ".join(map(in_one_line, value[:_FEW])) + (", ..." if len(value) > _FEW else "")
        return f"({inside}{',' * (len(value) == 1)})" if isinstance(value, tuple) else f"[{inside}]"
    is_array = isinstance(value, (np.generic, np.ndarray, jax.Array))
    if not is_array or checks.is_traced(value) or value.dtype.kind not in "biuf":
        return " ".join(repr(value).split())
    array = np.asarray(value)
    if array.ndim == 0 or array.size <= _FEW:
        return " ".join(np.array2string(array, separator=", ", precision=6).split())
    shape = f"{len(array)} numbers" if array.ndim == 1 else f"numbers {array.shape}"
    return f"<{shape} from {np.min(array):.6g} to {np.max(array):.6g}>"


@cache
def _parameters(kind: Any) -> list[str]:
    return list(inspect.signature(kind).parameters)


@cache
def _options(kind: Any) -> frozenset[str]:
    """The arguments of a class of the package that hold no numbers, and are not converted."""
    if not kind.__module__.startswith(f"{PACKAGE}."):
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


# Unit, bounds and meaning of fields.


@dataclasses.dataclass(frozen=True)
class Quantity:
    """Unit, bounds and meaning of a field that holds numbers.

    It is part of the field's annotation::

        class Pendulum(ss.SwitchedSystem):
            length: Annotated[float, ss.Quantity("m", above=0)]

    ``Pendulum(length=-1.0)`` then raises ValueError: "Argument length must be positive (in m), but -1.0 was given."
    Numbers that JAX traces pass unchecked. A field whose default is None may be None. For `simulate_ensemble` a single
    number may also be an array with one for each sample, or a distribution, whose draws are checked there.

    - `unit`: the SI unit; "" for a number without one.
    - `meaning`: what the field's name does not say by itself, one line.
    - `above`, `at_least`, `below`: the bounds; None for no bound.
    - `ndim`: 0 for a single number, 1 for a sequence of numbers.
    - `hint`: what to do about a number outside the bounds, the end of the error's message.
    """

    unit: str = ""
    meaning: str = ""
    above: int | float | None = None
    at_least: int | float | None = None
    below: int | float | None = None
    ndim: int = 0
    hint: str = ""

    def __repr__(self) -> str:
        """What was given only: signatures show it."""
        values = [(field.name, getattr(self, field.name), field.default) for field in dataclasses.fields(self)]
        given = [f"{name}={value!r}" for name, value, default in values if value != default]
        return f"Quantity({', '.join(given)})"

    @property
    def description(self) -> str:
        """Meaning and unit: "of the pin on the disk, m". The unit ends the first part of a meaning with semicolons."""
        first, *more = self.meaning.split("; ", 1)
        return "; ".join([", ".join(part for part in (first, self.unit) if part), *more])

    def is_function(self, value: object) -> bool:
        """Whether `value` is a function of time, of fields that may hold one in place of a number."""
        return False

    def check(self, name: str, value: object) -> None:
        """Check `value`, the argument `name`. Raises ValueError for anything but a finite number within the bounds."""
        if self.is_function(value) or (not self.ndim and is_distribution(value)):
            return
        # Of many numbers, one for each sample, name the first that does not fit.
        if not self.ndim and not checks.is_traced(value) and checks.dimensions(value) == 1:
            values = checks.numbers(name, value)
            wrong = self.outside(values)
            if not len(values):
                raise checks.refused(name, "be a single real number", value)
            if np.any(wrong):
                at = int(np.argmax(wrong))
                self.check(f"{name}[{at}]", values[at].item())
            return
        checks.bounded(
            name, value, self.unit, above=self.above, at_least=self.at_least, below=self.below, ndim=self.ndim,
            hint=self.hint,
        )  # fmt: skip

    def outside(self, values: npt.ArrayLike) -> np.ndarray:
        """Which of the numbers `values` are not finite, or outside the bounds, (values,)."""
        demands = checks.out_of_bounds(np.asarray(values, float), self.above, self.at_least, self.below, sized=True)
        return np.any([wrong for wrong, _, _ in demands], axis=0)


@dataclasses.dataclass(frozen=True)
class Choice:
    """The words that a field may hold, and its meaning."""

    options: tuple[str, ...]
    meaning: str = ""

    @property
    def description(self) -> str:
        """The meaning."""
        return self.meaning

    def check(self, name: str, value: object) -> None:
        """Check `value`, the argument `name`. Raises ValueError for anything but one of the options."""
        if not isinstance(value, str) or value not in self.options:
            options = checks.one_of(map(repr, self.options))
            raise checks.refused(name, f"be {options}", value)


class Option:
    """Of a field that holds no number, and what it may hold."""

    def check(self, name: str, value: object) -> None:
        """Check `value`, the argument `name`. Raises ValueError for what it may not hold."""


class Truth(Option):
    """An option that is True or False."""

    def check(self, name: str, value: object) -> None:
        checks.truth(name, value)


def is_distribution(value: object) -> bool:
    """Whether `value` is a distribution: of stickslip_jax, frozen of scipy.stats, or with a method ``sample(key)``."""
    if isinstance(value, type):  # the class of a distribution is none yet
        return False
    return any(callable(getattr(value, name, None)) for name in ("icdf", "ppf", "sample"))


def varies(value: object, about: "Quantity | Choice | Option") -> bool:
    """Whether the field `about` holds more than one number: a distribution, or an array with one for each sample."""
    if not isinstance(about, Quantity) or about.ndim or checks.is_traced(value) or about.is_function(value):
        return False
    return is_distribution(value) or checks.dimensions(value) == 1


@cache
def described(kind: type) -> dict[str, Quantity | Choice]:
    """The `Quantity` or `Choice` of each field of the dataclass `kind` that has one, by name and in order.

    A field that is a plain `float` is a number of which no more is known.
    """
    hints = {field.name: field.type for field in dataclasses.fields(kind)}
    if any(isinstance(hint, str) for hint in hints.values()):  # from __future__ import annotations
        try:
            resolved = get_type_hints(kind, include_extras=True)
        except NameError:  # a name known to the type checker only
            resolved = {}
        hints = {name: resolved.get(name, hint) for name, hint in hints.items()}
    found = {
        name: [part for part in getattr(hint, "__metadata__", ()) if isinstance(part, (Quantity, Choice))]
        for name, hint in hints.items()
    }
    return {name: (*parts, Quantity())[0] for name, parts in found.items() if parts or hints[name] is float}


@cache
def _to_check(kind: type) -> tuple[tuple[str, Quantity | Choice | Option, bool, bool], ...]:
    """Name, `Quantity` or `Choice` of each described field and `Option` of each that has one, whether it may be None,
    and whether it may be random.
    """
    found = []
    for field in dataclasses.fields(kind):
        is_static, about = field.metadata.get("static", False), described(kind).get(field.name)
        if is_static:
            options = [part for part in getattr(field.type, "__metadata__", ()) if isinstance(part, Option)]
            options += [Truth()] if field.type in (bool, bool | None) else []
            about = (*options, about)[0]
        if about is not None:
            found.append((field.name, about, field.default is None, kind.may_be_random and not is_static))
    return tuple(found)


M = TypeVar("M", bound=eqx.Module)


def with_fields(module: eqx.Module, kind: type[M], **fields: object) -> M:
    """A copy of `module` as a `kind`, with other values of these fields, made without its constructor.

    For fields that it need not check: a user's class may have another constructor, and a batch has other shapes.
    """
    new = object.__new__(kind)
    for name, value in {**vars(module), **fields}.items():
        object.__setattr__(new, name, value)
    return new


def modules_in(tree: object) -> Iterator[eqx.Module]:
    """All modules in `tree`: it, those in its fields, and so on."""
    if isinstance(tree, eqx.Module):
        yield tree
        for field in dataclasses.fields(tree):
            yield from modules_in(getattr(tree, field.name, None))
    elif isinstance(tree, (tuple, list)):
        for entry in tree:
            yield from modules_in(entry)


def _varying_in(tree: object) -> Iterator[tuple[eqx.Module, str]]:
    """The modules in `tree` with a number that `varies`, each with the name of its field."""
    for module in modules_in(tree):
        for name, about in described(type(module)).items():
            if varies(getattr(module, name), about):
                yield module, name


def varies_within(tree: object) -> bool:
    """Whether a number of a module in `tree` `varies`."""
    return any(True for _ in _varying_in(tree))


def require_single(**arguments: object) -> None:
    """Raises ValueError where a number of a module in the arguments `varies`, though one is needed."""
    for name, tree in arguments.items():
        for module, field in _varying_in(tree):
            raise ValueError(
                f"Argument {field} of {type(module).__name__} in {name} must be one number here, but "
                f"{checks.show(getattr(module, field))} was given; simulate_ensemble takes distributions, and arrays "
                "with one number for each sample."
            )


def check_again(module: object) -> None:
    """Run the constructor's checks of `module` again, each class's own, as equinox does. Raises their ValueError."""
    for kind in type(module).__mro__:
        vars(kind).get("__check_init__", lambda _: None)(module)


def is_of_package(tree: object) -> bool:
    """Whether the class of every module in `tree` is the package's own, and not a user's."""
    return all(type(module).__module__.startswith(f"{PACKAGE}.") for module in modules_in(tree))


class Checked(WithClaims, WithMethods):
    """A module whose constructor checks every field against its `Quantity` or `Choice`.

    - `may_be_random`: whether its single numbers may differ from sample to sample.
    - `own_distributions`: fields whose distributions it draws from itself, again and again, as the gaps between the
      switches of a base; other distributions stand for a number that is drawn once for every sample.
    """

    may_be_random: ClassVar[bool] = True
    own_distributions: ClassVar[tuple[str, ...]] = ()

    def __check_init__(self):
        vary = False
        for name, about, may_be_none, may_be_random in _to_check(type(self)):
            value = getattr(self, name)
            if value is None and may_be_none:
                continue
            if varies(value, about):
                vary = True
                if not may_be_random:
                    checks.numeric(name, value)
            about.check(name, value)
        type(self).check_parts(self)
        # What several fields must satisfy together is checked for what is drawn.
        if not (vary or type(self).has_varying_parts(self)):
            type(self).check_relations(self)  # `self.check_relations` would make a module of the method

    def check_parts(self) -> None:
        """Check fields of other kinds than numbers. Raises ValueError otherwise."""

    def has_varying_parts(self) -> bool:
        """Whether what `check_relations` looks into, besides its own fields, differs from sample to sample."""
        return False

    def check_relations(self) -> None:
        """Check what several fields must satisfy together. Raises ValueError otherwise."""
