"""Checks of all points of a sweep at once: arrays of values in place of the numbers of one point."""

from collections.abc import Callable

import numpy as np

from .._fields import Checked, Quantity, described, modules_in, varies
from .._uncertainty.numbers import Path, number_at, with_numbers
from .points import Points
from .setting import Setter, Setting

_POINTS_AT_ONCE = 1 << 16


def check_points(setter: Setter, points: Points, setting_at: Callable[[int], Setting]) -> None:
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
        if not isinstance(module, Checked):
            wrong |= _refused(number_at(setter.setting, depth), inside)
            continue
        abouts = described(type(module))
        for path, column in inside.items():
            about = abouts.get(str(path[0]))
            if len(path) == 1 and isinstance(about, Quantity):
                wrong |= about.outside(column)
        wrong |= _unrelated(module, number_at(setter.setting, depth), inside)
    return wrong


def _unrelated(module: Checked, single: Checked, inside: dict[Path, np.ndarray]) -> np.ndarray:
    """For which points the numbers of `module` do not fit together; `single`: the module of the setting."""
    kind = type(module)
    if kind.__check_init__ is not Checked.__check_init__:
        return _refused(single, inside)
    # What is drawn anew for every sample is checked when it is drawn.
    if not any(varies(getattr(single, name), about) for name, about in described(kind).items()):
        try:
            with np.errstate(all="ignore"):
                kind.check_relations(module)  # made for single numbers, but comparisons may hold for arrays
        except (TypeError, ValueError):
            return _refused(single, inside)
    return np.zeros(len(next(iter(inside.values()))), bool)


def _refused(module: object, inside: dict[Path, np.ndarray]) -> np.ndarray:
    """For which points the constructor of `module` refuses these numbers: each different row is tried once."""
    check = getattr(type(module), "__check_init__", lambda _: None)
    rows, which = np.unique(np.stack(list(inside.values()), axis=1), axis=0, return_inverse=True)
    refused = np.zeros(len(rows), bool)
    for number, row in enumerate(rows):
        one = with_numbers(module, tuple(inside), row.tolist())
        try:
            check(one)
        except ValueError:
            refused[number] = True
    return refused[which.reshape(-1)]
