"""What a study simulates at a point: the setting with the values of its parameters."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx

from .._distributions.random_number import RandomNumber
from .._excitation.excitation import law_of
from .._excitation.smooth import SIGNAL_UNIT
from .._fields import Quantity, described
from .._inputs.inputs import Model
from .._inputs.numbers import Path, check_numbers, matching, number_at, paths_of_numbers, shown
from .._systems.system import require_system
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
    """The setting; with the initial values that are zero by default."""
    if y0 is None:
        y0 = (0.0,) * len(require_system(system).coordinates)
    if isinstance(y0, list):
        y0 = tuple(y0)
    return Setting(system, law_of(law), y0, method)


def setter_of(setting: Setting, parameters: tuple[str, ...]) -> Callable[[tuple[float, ...]], Setting]:
    """The function that gives the setting with values of the `parameters`, in their order.

    Raises ValueError for a name that fits no number, or several; the function for values that do not fit.
    """
    known = list(paths_of_numbers(setting._asdict()))
    plain = [name for name in parameters if name not in GROUPS or _fits(name, known)]
    paths = {name: known[matching("over", name, known)] for name in plain}
    _check_different(paths)
    groups = [name for name in parameters if name not in paths]

    def with_values(values: tuple[float, ...]) -> Setting:
        by_name = dict(zip(parameters, values, strict=True))
        try:
            changed = _replaced(setting, list(paths.values()), [by_name[name] for name in paths])
            for name in groups:
                changed = GROUPS[name].applied(changed, by_name[name])
            for part in changed:
                check_numbers(part)
        except ValueError as error:
            point = ", ".join(f"{name} = {value:.6g}" for name, value in by_name.items())
            raise ValueError(f"The point {point} of the study cannot be simulated: {error}") from error
        return changed

    return with_values


def _fits(name: str, known: list[Path]) -> bool:
    return any(shown(path) == name or shown(path).endswith(f".{name}") for path in known)


def _check_different(paths: dict[str, Path]) -> None:
    for name, path in paths.items():
        others = [other for other in paths if other != name and paths[other] == path]
        if others:
            raise ValueError(
                f"Argument over must name every parameter once, but {name!r} and {others[0]!r} are both {shown(path)}."
            )


def _replaced(setting: Setting, paths: list[Path], values: list[float]) -> Setting:
    """`setting` with the numbers at `paths` replaced, also those that were None."""
    if not paths:
        return setting
    return eqx.tree_at(
        lambda tree: [number_at(tree, path) for path in paths], setting, values, is_leaf=lambda leaf: leaf is None
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
