"""The units of numbers by their paths."""

from typing import Any

from .._excitation.smooth import SIGNAL_UNIT
from .._uncertainty.numbers import Path, number_at, quantity_at
from .._uncertainty.random_number import RandomNumber


def unit_at(setting: Any, path: Path) -> str:
    """The unit of the number at `path` in a `setting`, which has a system; "1" where it has none, or none is known.

    The numbers of a distribution have the unit of what is random, but for those that only give its shape.
    """
    *above, last = path
    if above == ["y0"]:
        return setting.system.coordinates[int(last)].unit
    holder = number_at(setting, tuple(above))
    if isinstance(holder, RandomNumber):
        return "1" if last in holder.shape_numbers else unit_at(setting, tuple(above))
    unit = quantity_at(setting, path).unit
    if unit == SIGNAL_UNIT:  # the base's own, or a force of the system
        return "N" if path[0] == "system" else "m/s"
    return unit or "1"
