"""What parameters set in a system, its law, its initial state and method: points, setters, and their checks."""

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple, TypeAlias

import numpy as np

from .._dynamics.common.method import Exact, Regularized, check_method, entries_of
from .._excitation.excitation import BaseMotion, excitation_of, law_of
from .._foundation import checks
from .._foundation.fields import Checked, Quantity, check_again, described, modules_in, varies
from .._foundation.types import InitialState
from .._systems.system import System, checked_system, require_system, unit_at
from .._uncertainty.design import Design, given_twice
from .._uncertainty.families import RandomNumber
from .._uncertainty.inputs import SampledLaw, StochasticModel
from .._uncertainty.numbers import NumberPath, check_numbers, matching, number_at, paths_of_numbers, shown, with_numbers

# The points of a parameter sweep: values of some parameters, on a grid, zipped, or from a design.


POINT = "point"
"""The name of the dimension of a design's points."""
MOST_POINTS = 10_000_000
"""Of a sweep, at most: each has a file of its own."""


class Dimension(NamedTuple):
    """One dimension of the points: parameters that change together. `values`: (length, parameters)."""

    name: str
    parameters: tuple[str, ...]
    values: np.ndarray

    def __len__(self) -> int:
        return len(self.values)


class Points(NamedTuple):
    """All points: every combination of an entry of each dimension, the last dimension running fastest."""

    dimensions: tuple[Dimension, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of all parameters."""
        return tuple(name for one in self.dimensions for name in one.parameters)

    @property
    def shape(self) -> tuple[int, ...]:
        """The length of each dimension."""
        return tuple(map(len, self.dimensions))

    @property
    def number(self) -> int:
        """The number of points."""
        return math.prod(self.shape)

    def values(self, number: int) -> tuple[float, ...]:
        """The values of all parameters at point `number`."""
        return tuple(self._rows(number).tolist())

    def _rows(self, numbers: int | np.ndarray) -> np.ndarray:
        """The values at points with these numbers, (..., parameters)."""
        indices = np.unravel_index(numbers, self.shape)
        rows = [one.values[index] for one, index in zip(self.dimensions, indices, strict=True)]
        return np.concatenate(rows, axis=-1, dtype=np.float64)

    def blocks(self, size: int) -> Iterator[tuple[int, np.ndarray]]:
        """The values at all points, `size` at a time: the number of the first, and an array (points, parameters)."""
        for first in range(0, self.number, size):
            yield first, self._rows(np.arange(first, min(first + size, self.number)))

    def number_of(self, values: Mapping[str, float]) -> int | None:
        """The first point with these values of all parameters, equal but for round-off; None if there is none."""
        indices = []
        for one in self.dimensions:
            wanted = np.array([[values[name] for name in one.parameters]])
            round_off = 1e-9 * np.maximum(np.abs(one.values), np.abs(wanted))  # of how they were written
            fits = np.flatnonzero(np.all(np.abs(one.values - wanted) <= round_off, axis=1))
            if not len(fits):
                return None
            indices.append(int(fits[0]))
        return int(np.ravel_multi_index(indices, self.shape))

    def named(self, number: int) -> dict[str, float]:
        """The values at point `number` by parameter."""
        return dict(zip(self.parameters, self.values(number), strict=True))

    def described(self, number: int) -> str:
        """Point `number` as text: "mu = 0.5, rate = 2"."""
        return in_words(self.named(number))

    def identity(self, number: int) -> str:
        """A name of point `number` that depends on its values only, whatever their order, 16 hexadecimal digits."""
        text = ";".join(f"{name}={float(value).hex()}" for name, value in sorted(self.named(number).items()))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def in_words(values: Mapping[str, float]) -> str:
    """Values of parameters as text: "mu = 0.5, rate = 2"."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in values.items())


def points_of(over: object) -> Points:
    """The points that `over` describes; see `Sweep`. Raises ValueError for anything else."""
    if isinstance(over, Design):
        if over.values is None or over.names is None:
            raise ValueError(
                "Argument over must be a design with the values of named parameters, such as design.table or "
                f"design.grid, but {over!r} was given, which has uniform numbers; make values of them first."
            )
        _check_number("over", len(over))
        return Points((_distinct(Dimension(POINT, over.names, np.asarray(over.values)), "over"),))
    if not isinstance(over, Mapping) or not over:
        such = "be a dict from names of parameters to their values, such as {'mu': [0.5, 1.0]}"
        raise checks.refused("over", f"{such}, or a design with values", over)
    points = Points(tuple(_dimension(names, values) for names, values in over.items()))
    twice = given_twice(points.parameters)
    if twice is not None:
        raise ValueError(f"Argument over must name every parameter once, but {twice!r} was given twice.")
    _check_number("over", points.number)
    return points


def _check_number(label: str, number: int) -> None:
    if number > MOST_POINTS:
        raise ValueError(
            f"Argument {label} must have at most {MOST_POINTS} points, but has {number}; take fewer values, or a "
            "design that spreads them."
        )


def _dimension(names: object, values: object) -> Dimension:
    several = isinstance(names, tuple)
    given = names if isinstance(names, tuple) else (names,)
    parameters = tuple(name for name in given if isinstance(name, str) and name)
    if not given or len(parameters) < len(given):
        raise checks.refused("over", "have names of parameters as keys, or tuples of names that change together", names)
    label = f"over[{names!r}]"
    if isinstance(values, range):  # which has no numbers yet
        _check_number(label, len(values))
    array = checks.numbers(label, values, ndim=2 if several else 1).astype(np.float64)
    if not array.size or (several and array.shape[1] != len(parameters)):
        wanted = f"rows of {len(parameters)} numbers, one row for each point" if several else "at least one number"
        raise checks.refused(label, f"hold {wanted}", values)
    if not np.all(np.isfinite(array)):
        wrong = array[~np.isfinite(array)][0]
        raise ValueError(f"Argument {label} must hold finite numbers, but {wrong} was given.")
    return _distinct(Dimension("_and_".join(parameters), parameters, array.reshape(len(array), -1)), label)


def _distinct(dimension: Dimension, label: str) -> Dimension:
    """`dimension`. Raises ValueError if two of its entries are the same point."""
    _check_number(label, len(dimension))
    order = np.lexsort(dimension.values.T[::-1])  # stable: of equal entries the first comes first
    repeats = np.zeros(len(dimension), bool)
    repeats[1:] = np.all(dimension.values[order[1:]] == dimension.values[order[:-1]], axis=1)
    if np.any(repeats):
        again = int(np.min(order[repeats]))
        row = dimension.values[again]
        first = int(np.argmax(np.all(dimension.values == row[None], axis=1)))
        shown = float(row[0]) if len(row) == 1 else tuple(row.tolist())
        raise ValueError(
            f"Argument {label} must hold every point once, but entries {first} and {again} are both {shown}."
        )
    return dimension


# What a sweep simulates at a point: the setting with the values of its parameters.
#
# A parameter is a number of the setting, or a dimensionless group that the papers vary.


_Value: TypeAlias = float | np.ndarray
"""Of a parameter at one point, or at many."""


class SweepSetting(NamedTuple):
    """A system, the law of its excitation, its initial state, and the method."""

    system: System
    law: BaseMotion | SampledLaw
    y0: InitialState
    method: Exact | Regularized

    @property
    def model(self) -> StochasticModel:
        """What an ensemble simulates."""
        return StochasticModel(self.system, self.law, self.y0)


def setting_of(system: object, law: BaseMotion, y0: InitialState | None, method: Exact | Regularized) -> SweepSetting:
    """The setting; with the initial values that are zero by default. Raises ValueError for what is no system, and for
    a start or a method that is none.
    """
    check_method(method)
    system = checked_system(system)
    if y0 is None or checks.dimensions(y0) != 2 or isinstance(y0, (tuple, list)):  # else a row for each sample
        y0 = entries_of(system, y0)
    known = law_of(law)
    if not isinstance(known, SampledLaw):
        excitation_of(known, "law")
    return SweepSetting(system, known, y0, method)


# --- dimensionless groups


class _Group(NamedTuple):
    """A dimensionless group: its meaning, and what gives the number of a setting that it decides, with its place there.

    The value, and with it numbers of the setting, may be arrays with an entry for each of many points.
    """

    meaning: str
    apply: Callable[[SweepSetting, _Value], tuple[NumberPath, _Value]]


_FREQUENCIES: dict[str, Callable[[_Value], _Value]] = {
    "period": lambda frequency: 1 / frequency,
    "interval": lambda frequency: 1 / frequency,
    "angular_frequency": lambda frequency: 2 * math.pi * frequency,
}
"""What a law's field of this name is at a frequency in Hz."""


def _by_frequency_ratio(setting: SweepSetting, ratio: _Value) -> tuple[NumberPath, _Value]:
    """``r = f_b / (omega / 2 pi)`` (Lima and Sampaio's conference paper, section 3), both in Hz."""
    if not np.ndim(ratio):
        checks.positive("over['r']", ratio)
    omega = _number_of(setting.system, "natural_frequency", "r", "a natural frequency, as that of a MassSpring", ratio)
    path = _path_in_law(setting, tuple(_FREQUENCIES), "r", "a frequency")
    return path, _FREQUENCIES[str(path[-1])](ratio * omega / (2 * math.pi))


def _by_dimensionless_speed(setting: SweepSetting, w: _Value) -> tuple[NumberPath, _Value]:
    """``w = v / (omega a)`` with the half-width ``a = mu n / k`` of the stick band."""
    wanted = "a natural frequency and a stick band, as those of a MassSpring with Coulomb friction"
    omega = _number_of(setting.system, "natural_frequency", "w", wanted, w)
    half_width = _number_of(setting.system, "stick_half_width", "w", wanted, w)
    path = _path_in_law(setting, ("speed", "amplitude"), "w", "a speed")
    return path, w * omega * half_width


_GROUPS = {
    "r": _Group("frequency of the base over the natural frequency", _by_frequency_ratio),
    "w": _Group("speed of the base over natural angular frequency times half-width of the stick band",
                _by_dimensionless_speed),
}  # fmt: skip
"""The groups by name. Each sets a number of the law; the numbers of the system are set before."""


def _number_of(system: System, name: str, group: str, wanted: str, many: _Value) -> _Value:
    """A number of the system; where the group's value `many` is an array, also an array with an entry for each."""
    value = getattr(system, name, None)
    if value is not None and np.ndim(value) and np.shape(value) == np.shape(many):
        return np.asarray(value)
    if value is None or np.ndim(value):
        raise ValueError(
            f"Argument over must not name {group!r} here: it needs a system with {wanted}, but "
            f"{type(system).__name__} was given; name the parameter itself."
        )
    return float(value)


def _path_in_law(setting: SweepSetting, names: tuple[str, ...], group: str, wanted: str) -> NumberPath:
    known = [path for path in paths_of_numbers({"law": setting.law}) if path[-1] in names]
    if len(known) != 1 or number_at(setting, known[0]) is None:
        found = ", ".join(map(shown, known)) or "none"
        raise ValueError(
            f"Argument over must not name {group!r} here: it needs a law with {wanted} ({' or '.join(names)}), but "
            f"{type(setting.law).__name__} has {found}; name the parameter itself."
        )
    return known[0]


# --- values of parameters


class Setter(NamedTuple):
    """Gives a setting with values of the `parameters`.

    `paths`: where those stand that are numbers of the setting; the others are dimensionless groups.
    """

    setting: SweepSetting
    parameters: tuple[str, ...]
    paths: dict[str, NumberPath]

    def __call__(self, values: tuple[float, ...]) -> SweepSetting:
        """The setting with these `values`. Raises ValueError for values that do not fit."""
        by_name = dict(zip(self.parameters, values, strict=True))
        try:
            _, changed = self._changed(by_name)
            for part in changed:
                check_numbers(part)
        except ValueError as error:
            raise ValueError(f"The point {in_words(by_name)} of the sweep cannot be simulated: {error}") from error
        return changed

    def columns(self, values: np.ndarray) -> tuple[dict[NumberPath, np.ndarray], SweepSetting]:
        """Many points at once, (points, parameters): an array (points,) for each number, and the setting that has these
        arrays in place of numbers, unchecked.
        """
        found, changed = self._changed(dict(zip(self.parameters, values.T, strict=True)))
        return {path: np.asarray(column) for path, column in found.items()}, changed

    def _changed(self, by_name: Mapping[str, _Value]) -> tuple[dict[NumberPath, _Value], SweepSetting]:
        found = {path: by_name[name] for name, path in self.paths.items()}
        changed = with_numbers(self.setting, tuple(found), list(found.values()))
        for name in self.parameters:
            if name not in self.paths:
                path, found[path] = _GROUPS[name].apply(changed, by_name[name])
                changed = with_numbers(changed, (path,), [found[path]])
        return found, changed


def setter_of(setting: SweepSetting, parameters: tuple[str, ...]) -> Setter:
    """What gives the setting with values of the `parameters`, in their order.

    Raises ValueError for a name that fits no number, or several.
    """
    known = list(paths_of_numbers(setting._asdict()))
    numbers = [name for name in parameters if name not in _GROUPS or _fits(name, known)]
    paths = {name: known[matching("over", name, known)] for name in numbers}
    by_path: dict[NumberPath, str] = {}
    for name, path in paths.items():
        other = by_path.setdefault(path, name)
        if other != name:
            raise ValueError(
                f"Argument over must name every parameter once, but {other!r} and {name!r} are both {shown(path)}."
            )
    return Setter(setting, parameters, paths)


def _fits(name: str, known: list[NumberPath]) -> bool:
    return any(shown(path) == name or shown(path).endswith(f".{name}") for path in known)


def label_and_unit(setting: SweepSetting, name: str) -> tuple[str, str]:
    """What figures call a parameter, in words ("friction coefficient", "initial position"), and its unit.

    The unit is "1" where it has none, or none is known.
    """
    known = list(paths_of_numbers(setting._asdict()))
    if _fits(name, known):
        path = known[matching("over", name, known)]
        return _label_at(setting, path), unit_at(setting, path)
    return (f"{name}, {_GROUPS[name].meaning}" if name in _GROUPS else name), "1"


_SYMBOLS = {"mu": "friction coefficient", "mu_static": "static friction coefficient"}


def _label_at(setting: SweepSetting, path: NumberPath) -> str:
    *above, last = path
    if above == ["y0"]:
        return f"initial {require_system(setting.system).coordinates[int(last)].name}"
    label = _SYMBOLS.get(str(last), str(last).replace("_", " "))
    is_of_distribution = isinstance(number_at(setting, tuple(above)), RandomNumber)
    return f"{label} of {_label_at(setting, tuple(above))}" if is_of_distribution else label


# Checks of all points of a sweep at once: arrays of values in place of the numbers of one point.


_POINTS_AT_ONCE = 1 << 16


def check_points(setter: Setter, points: Points, setting_at: Callable[[int], SweepSetting]) -> None:
    """Check every point as constructors do. Raises the ValueError of `setting_at` for the first that they refuse.

    Points are checked in arrays first; only those that may be refused are then made one by one.
    """
    setting_at(0)  # what does not fit at any point
    for first, values in points.blocks(_POINTS_AT_ONCE):
        for number in np.flatnonzero(_suspicious(setter, values)):
            setting_at(first + int(number))


def _suspicious(setter: Setter, values: np.ndarray) -> np.ndarray:
    """Which of the points with these `values`, (points, parameters), constructors might refuse, (points,)."""
    try:
        with np.errstate(all="ignore"):
            columns, changed = setter.columns(values)
    except (TypeError, ValueError):  # a group that only single numbers make
        return np.ones(len(values), bool)
    wrong = np.zeros(len(values), bool)
    for depth in sorted({path[:end] for path in columns for end in range(1, len(path))}):
        module = number_at(changed, depth)
        if next(modules_in(module), None) is not module:  # a tuple, such as the initial state
            continue
        inside = {path[len(depth) :]: column for path, column in columns.items() if path[: len(depth)] == depth}
        wrong |= _unfit(module, number_at(setter.setting, depth), inside)
    return wrong


def _unfit(module: object, single: object, inside: dict[NumberPath, np.ndarray]) -> np.ndarray:
    """For which points numbers of `module` are out of bounds, or do not fit together; `single`: that of the setting."""
    if not isinstance(module, Checked):
        return _refused(single, inside)
    kind = type(module)
    wrong, abouts = np.zeros(len(next(iter(inside.values()))), bool), described(kind)
    for (name, *rest), column in inside.items():
        about = abouts.get(str(name))
        if not rest and isinstance(about, Quantity):
            wrong |= about.outside(column)
    if kind.__check_init__ is not Checked.__check_init__:
        return wrong | _refused(single, inside)
    # What is drawn anew for every sample is checked when it is drawn.
    if not any(varies(getattr(single, name), about) for name, about in abouts.items()):
        try:
            with np.errstate(all="ignore"):
                kind.check_relations(module)  # made for single numbers, but comparisons may hold for arrays
        except (TypeError, ValueError):
            wrong |= _refused(single, inside)
    return wrong


def _refused(module: object, inside: dict[NumberPath, np.ndarray]) -> np.ndarray:
    """For which points the constructor of `module` refuses these numbers: each different row is tried once."""
    rows, which = np.unique(np.stack(list(inside.values()), axis=1), axis=0, return_inverse=True)
    refused = np.zeros(len(rows), bool)
    for number, row in enumerate(rows):
        one = with_numbers(module, tuple(inside), row.tolist())
        try:
            check_again(one)
        except ValueError:
            refused[number] = True
    return refused[which.reshape(-1)]
