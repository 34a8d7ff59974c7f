"""What a sweep simulates at a point: the setting with the values of its parameters.

A parameter is a number of the setting, or a dimensionless group that the papers vary.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeAlias

import numpy as np

from .. import _checks
from .._dynamics.common.method import Exact, Regularized
from .._dynamics.common.validation import entries_of
from .._excitation.excitation import BaseMotion, excitation_of, law_of
from .._systems.system import System, checked_system, require_system
from .._systems.units import unit_at
from .._types import InitialState
from .._uncertainty.inputs import Model
from .._uncertainty.numbers import Path, check_numbers, matching, number_at, paths_of_numbers, shown, with_numbers
from .._uncertainty.random_number import RandomNumber
from .._uncertainty.sampled_law import SampledLaw

_Value: TypeAlias = float | np.ndarray
"""Of a parameter at one point, or at many."""


class Setting(NamedTuple):
    """A system, the law of its excitation, its initial state, and the method."""

    system: System
    law: BaseMotion | SampledLaw
    y0: InitialState
    method: Exact | Regularized

    @property
    def model(self) -> Model:
        """What an ensemble simulates."""
        return Model(self.system, self.law, self.y0)


def setting_of(system: object, law: BaseMotion, y0: InitialState | None, method: Exact | Regularized) -> Setting:
    """The setting; with the initial values that are zero by default. Raises ValueError for what is no system, and for
    a start that is none.
    """
    system = checked_system(system)
    if y0 is None or _checks.dimensions(y0) != 2 or isinstance(y0, (tuple, list)):  # else a row for each sample
        y0 = entries_of(system, y0)
    known = law_of(law)
    if not isinstance(known, SampledLaw):
        excitation_of(known, "law")
    return Setting(system, known, y0, method)


# --- dimensionless groups


class _Group(NamedTuple):
    """A dimensionless group: its meaning, and what gives the number of a setting that it decides, with its place there.

    The value, and with it numbers of the setting, may be arrays with an entry for each of many points.
    """

    meaning: str
    apply: Callable[[Setting, _Value], tuple[Path, _Value]]


_FREQUENCIES: dict[str, Callable[[_Value], _Value]] = {
    "period": lambda frequency: 1 / frequency,
    "interval": lambda frequency: 1 / frequency,
    "angular_frequency": lambda frequency: 2 * math.pi * frequency,
}
"""What a law's field of this name is at a frequency in Hz."""


def _by_frequency_ratio(setting: Setting, ratio: _Value) -> tuple[Path, _Value]:
    """``r = f_b / (omega / 2 pi)`` (Lima and Sampaio's conference paper, section 3), both in Hz."""
    if not np.ndim(ratio):
        _checks.positive("over['r']", ratio)
    omega = _number_of(setting.system, "natural_frequency", "r", "a natural frequency, as that of a MassSpring", ratio)
    path = _path_in_law(setting, tuple(_FREQUENCIES), "r", "a frequency")
    return path, _FREQUENCIES[str(path[-1])](ratio * omega / (2 * math.pi))


def _by_dimensionless_speed(setting: Setting, w: _Value) -> tuple[Path, _Value]:
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


def _path_in_law(setting: Setting, names: tuple[str, ...], group: str, wanted: str) -> Path:
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

    setting: Setting
    parameters: tuple[str, ...]
    paths: dict[str, Path]

    def __call__(self, values: tuple[float, ...]) -> Setting:
        """The setting with these `values`. Raises ValueError for values that do not fit."""
        by_name = dict(zip(self.parameters, values, strict=True))
        try:
            _, changed = self._changed(by_name)
            for part in changed:
                check_numbers(part)
        except ValueError as error:
            point = ", ".join(f"{name} = {value:.6g}" for name, value in by_name.items())
            raise ValueError(f"The point {point} of the sweep cannot be simulated: {error}") from error
        return changed

    def columns(self, values: np.ndarray) -> tuple[dict[Path, np.ndarray], Setting]:
        """Many points at once, (points, parameters): an array (points,) for each number, and the setting that has these
        arrays in place of numbers, unchecked.
        """
        found, changed = self._changed(dict(zip(self.parameters, values.T, strict=True)))
        return {path: np.asarray(column) for path, column in found.items()}, changed

    def _changed(self, by_name: Mapping[str, _Value]) -> tuple[dict[Path, _Value], Setting]:
        found = {path: by_name[name] for name, path in self.paths.items()}
        changed = with_numbers(self.setting, tuple(found), list(found.values()))
        for name in self.parameters:
            if name not in self.paths:
                path, found[path] = _GROUPS[name].apply(changed, by_name[name])
                changed = with_numbers(changed, (path,), [found[path]])
        return found, changed


def setter_of(setting: Setting, parameters: tuple[str, ...]) -> Setter:
    """What gives the setting with values of the `parameters`, in their order.

    Raises ValueError for a name that fits no number, or several.
    """
    known = list(paths_of_numbers(setting._asdict()))
    numbers = [name for name in parameters if name not in _GROUPS or _fits(name, known)]
    paths = {name: known[matching("over", name, known)] for name in numbers}
    by_path: dict[Path, str] = {}
    for name, path in paths.items():
        other = by_path.setdefault(path, name)
        if other != name:
            raise ValueError(
                f"Argument over must name every parameter once, but {other!r} and {name!r} are both {shown(path)}."
            )
    return Setter(setting, parameters, paths)


def _fits(name: str, known: list[Path]) -> bool:
    return any(shown(path) == name or shown(path).endswith(f".{name}") for path in known)


def label_and_unit(setting: Setting, name: str) -> tuple[str, str]:
    """What figures call a parameter, in words ("friction coefficient", "initial position"), and its unit.

    The unit is "1" where it has none, or none is known.
    """
    known = list(paths_of_numbers(setting._asdict()))
    if _fits(name, known):
        path = known[matching("over", name, known)]
        return _label_at(setting, path), unit_at(setting, path)
    return (f"{name}, {_GROUPS[name].meaning}" if name in _GROUPS else name), "1"


_SYMBOLS = {"mu": "friction coefficient", "mu_static": "static friction coefficient"}


def _label_at(setting: Setting, path: Path) -> str:
    *above, last = path
    if above == ["y0"]:
        return f"initial {require_system(setting.system).coordinates[int(last)].name}"
    label = _SYMBOLS.get(str(last), str(last).replace("_", " "))
    is_of_distribution = isinstance(number_at(setting, tuple(above)), RandomNumber)
    return f"{label} of {_label_at(setting, tuple(above))}" if is_of_distribution else label
