"""Unit, bounds and meaning of the fields of systems and laws, stated once, in the annotation of each field.

The constructors check their arguments by them, and a study's file takes its keys from them.
"""

import dataclasses
from collections.abc import Iterator
from functools import cache
from typing import ClassVar, TypeVar, get_type_hints

import equinox as eqx
import numpy as np
import numpy.typing as npt

from . import checks
from .methods import WithClaims, WithMethods

PACKAGE = __name__.partition(".")[0]


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
