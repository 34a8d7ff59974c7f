"""Dimensionless groups that the papers vary, as parameters of a sweep."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from .. import _checks
from .._uncertainty.numbers import Path, number_at, paths_of_numbers, shown

_Value: TypeAlias = float | np.ndarray
"""Of a parameter at one point, or at many."""


class Group(NamedTuple):
    """A dimensionless group: its meaning, and what gives the number of a setting that it decides, with its place there.

    The value, and with it numbers of the setting, may be arrays with an entry for each of many points.
    """

    meaning: str
    apply: Callable[[Any, _Value], tuple[Path, _Value]]


_FREQUENCIES: dict[str, Callable[[_Value], _Value]] = {
    "period": lambda frequency: 1 / frequency,
    "interval": lambda frequency: 1 / frequency,
    "angular_frequency": lambda frequency: 2 * math.pi * frequency,
}
"""What a law's field of this name is at a frequency in Hz."""


def _by_frequency_ratio(setting: Any, ratio: _Value) -> tuple[Path, _Value]:
    """``r = f_b / (omega / 2 pi)`` (Lima and Sampaio's conference paper, section 3), both in Hz."""
    if not np.ndim(ratio):
        _checks.positive("over['r']", ratio)
    omega = _number_of(setting.system, "natural_frequency", "r", "a natural frequency, as that of a MassSpring", ratio)
    path = _path_in_law(setting, tuple(_FREQUENCIES), "r", "a frequency")
    return path, _FREQUENCIES[str(path[-1])](ratio * omega / (2 * math.pi))


def _by_dimensionless_speed(setting: Any, w: _Value) -> tuple[Path, _Value]:
    """``w = v / (omega a)`` with the half-width ``a = mu n / k`` of the stick band."""
    wanted = "a natural frequency and a stick band, as those of a MassSpring with Coulomb friction"
    omega = _number_of(setting.system, "natural_frequency", "w", wanted, w)
    half_width = _number_of(setting.system, "stick_half_width", "w", wanted, w)
    path = _path_in_law(setting, ("speed", "amplitude"), "w", "a speed")
    return path, w * omega * half_width


GROUPS = {
    "r": Group("frequency of the base over the natural frequency", _by_frequency_ratio),
    "w": Group("speed of the base over natural angular frequency times half-width of the stick band",
               _by_dimensionless_speed),
}  # fmt: skip
"""The groups by name. Each sets a number of the law; the numbers of the system are set before."""


def _number_of(system: Any, name: str, group: str, wanted: str, many: _Value) -> _Value:
    """A number of the system; where the group's value `many` is an array, also an array with an entry for each."""
    value = getattr(system, name, None)
    if value is not None and np.shape(value) == np.shape(many):
        return np.asarray(value) if np.ndim(many) else float(value)
    if value is None or np.ndim(value):
        raise ValueError(
            f"Argument over must not name {group!r} here: it needs a system with {wanted}, but "
            f"{type(system).__name__} was given; name the parameter itself."
        )
    return float(value)


def _path_in_law(setting: Any, names: tuple[str, ...], group: str, wanted: str) -> Path:
    known = [path for path in paths_of_numbers({"law": setting.law}) if path[-1] in names]
    if len(known) != 1 or number_at(setting, known[0]) is None:
        found = ", ".join(map(shown, known)) or "none"
        raise ValueError(
            f"Argument over must not name {group!r} here: it needs a law with {wanted} ({' or '.join(names)}), but "
            f"{type(setting.law).__name__} has {found}; name the parameter itself."
        )
    return known[0]
