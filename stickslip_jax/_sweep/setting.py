"""What a sweep simulates at a point: the setting with the values of its parameters."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from .. import _checks
from .._excitation.excitation import excitation_of, law_of
from .._excitation.smooth import SIGNAL_UNIT
from .._fields import Quantity, described
from .._systems.system import checked_system, require_system
from .._uncertainty.inputs import Model
from .._uncertainty.numbers import Path, check_numbers, matching, number_at, paths_of_numbers, shown, with_numbers
from .._uncertainty.random_number import RandomNumber
from .._uncertainty.sampled_law import SampledLaw
from .groups import GROUPS


class Setting(NamedTuple):
    """A system, the law of its excitation, its initial state, and the method."""

    system: Any
    law: Any
    y0: Any
    method: Any

    @property
    def model(self) -> Model:
        """What an ensemble simulates."""
        return Model(self.system, self.law, self.y0)


def setting_of(system: Any, law: Any, y0: Any, method: Any) -> Setting:
    """The setting; with the initial values that are zero by default. Raises ValueError for what is no system, and for
    a start that is none.
    """
    names = [coordinate.meaning for coordinate in checked_system(system).coordinates]
    if y0 is None:
        y0 = (0.0,) * len(names)
    elif _checks.dimensions(y0) != 2 or isinstance(y0, (tuple, list)):  # else a row for each sample
        y0 = _checks.entries("y0", y0, tuple(names))
    law = law_of(law)
    if not isinstance(law, SampledLaw):
        excitation_of(law, "law")
    return Setting(system, law, y0, method)


class Setter(NamedTuple):
    """Gives a setting with values of the `parameters`.

    `paths`: where those stand that are numbers of the setting. `groups`: the names of the others.
    """

    setting: Setting
    parameters: tuple[str, ...]
    paths: dict[str, Path]
    groups: tuple[str, ...]

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

    def _changed(self, by_name: Mapping[str, Any]) -> tuple[dict[Path, Any], Setting]:
        found = {path: by_name[name] for name, path in self.paths.items()}
        changed = with_numbers(self.setting, tuple(found), list(found.values()))
        for name in self.groups:
            path, value = GROUPS[name].apply(changed, by_name[name])
            found[path] = value
            changed = with_numbers(changed, (path,), [value])
        return found, changed


def setter_of(setting: Setting, parameters: tuple[str, ...]) -> Setter:
    """What gives the setting with values of the `parameters`, in their order.

    Raises ValueError for a name that fits no number, or several.
    """
    known = list(paths_of_numbers(setting._asdict()))
    numbers = [name for name in parameters if name not in GROUPS or _fits(name, known)]
    paths = {name: known[matching("over", name, known)] for name in numbers}
    _check_different(paths)
    return Setter(setting, parameters, paths, tuple(name for name in parameters if name not in paths))


def _fits(name: str, known: list[Path]) -> bool:
    return any(shown(path) == name or shown(path).endswith(f".{name}") for path in known)


def _check_different(paths: dict[str, Path]) -> None:
    by_path: dict[Path, str] = {}
    for name, path in paths.items():
        other = by_path.setdefault(path, name)
        if other != name:
            raise ValueError(
                f"Argument over must name every parameter once, but {other!r} and {name!r} are both {shown(path)}."
            )


def label_of(setting: Setting, name: str) -> str:
    """What figures call a parameter, in words: "friction coefficient", "initial position"."""
    path = _path_of(setting, name)
    if path is None:
        return name
    *above, last = path
    if above[0] == "y0":
        return f"initial {require_system(setting.system).coordinates[int(last)].name}"
    if isinstance(number_at(setting, tuple(above)), RandomNumber):
        return f"{_in_words(last)} of {_in_words(above[-1])}"
    return _in_words(last)


def _in_words(field: Any) -> str:
    return _SYMBOLS.get(str(field), str(field).replace("_", " "))


_SYMBOLS = {"mu": "friction coefficient", "mu_static": "static friction coefficient"}


def unit_of(setting: Setting, name: str) -> str:
    """The unit of a parameter; "1" where it has none, or none is known."""
    path = _path_of(setting, name)
    if path is None:
        return "1"
    *above, last = path
    if above[0] == "y0":
        return require_system(setting.system).coordinates[int(last)].unit
    about = described(type(number_at(setting, tuple(above)))).get(str(last))
    unit = about.unit if isinstance(about, Quantity) else ""
    return "m/s" if unit == SIGNAL_UNIT and above[0] == "law" else unit or "1"


def _path_of(setting: Setting, name: str) -> Path | None:
    """Where the parameter stands; None for one that is no number of `setting`, such as a dimensionless group."""
    known = list(paths_of_numbers(setting._asdict()))
    return known[matching("over", name, known)] if _fits(name, known) else None
