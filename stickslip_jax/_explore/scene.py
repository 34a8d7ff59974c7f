"""What the explorer shows: a system, what drives it, where it starts, and the numbers in all of them."""

import math
from typing import Any, NamedTuple

import numpy as np

from .. import _checks
from .._dynamics.common.method import EXACT, Exact, Regularized
from .._excitation.random import RandomPhase
from .._fields import Quantity
from .._systems.system import System
from .._systems.units import unit_at
from .._uncertainty.numbers import Path, check_numbers, number_at, numbers_in, quantity_at, shown, with_numbers

_STEPS = 400  # of a slider
_DURATION = Quantity("s", meaning="of each realisation", above=0)
_NAMES = {"mu": "friction coefficient", "mu_static": "static friction coefficient", "t1": "duration of a realisation"}
_NOT_SAID = ("friction", "signal", "jumps", "motion")  # of the way to a number


class Scene(NamedTuple):
    """What is simulated, as for `simulate_ensemble`: `t1` in s, so many `samples`, `seed` of the random numbers."""

    system: System
    law: Any
    y0: tuple[Any, ...]
    t1: float
    samples: int = 2000
    seed: int = 0
    method: Exact | Regularized = EXACT

    def with_number(self, path: Path, value: float) -> "Scene":
        """The scene with another number at `path`. Raises ValueError for one that a constructor refuses."""
        quantity_of(self, path).check(shown(path), value)
        changed = with_numbers(self, [path], [value])
        check_numbers(changed)
        return changed


class MovableNumber(NamedTuple):
    """A number that can be moved.

    - `name`: as `sensitivity` takes it, "system.mass".
    - `label`: what it is, with its unit.
    - `low`, `high`, `step`: of its slider.
    """

    path: Path
    name: str
    label: str
    value: float
    low: float
    high: float
    step: float

    def at(self, value: float) -> "MovableNumber":
        """The same at another value, which its slider reaches."""
        return self._replace(value=value, low=min(self.low, value), high=max(self.high, value))


def quantity_of(scene: Scene, path: Path) -> Quantity:
    """Unit and bounds of the number at `path`."""
    return _DURATION if path == ("t1",) else quantity_at(scene, path)


def numbers_of(scene: Scene) -> list[MovableNumber]:
    """The numbers that can be moved: of the system, of what drives it, of the start, and the duration."""
    where = {"system": scene.system, "law": scene.law, "y0": scene.y0}
    found = [path for path, value in numbers_in(where) if value is not None or _may_be_set(scene, path)]
    if isinstance(scene.law, RandomPhase):  # which draws it
        found = [path for path in found if path != ("law", "signal", "phase")]
    return [_movable(scene, path) for path in [*found, ("t1",)]]


def read_number(text: str) -> float:
    """The number that someone wrote. Raises ValueError for anything but a finite one."""
    try:
        value = float(text.strip().replace("\N{MINUS SIGN}", "-"))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{_checks.show(text)} is not a number; write one such as 0.25 or 1e-3.")
    return value


def _may_be_set(scene: Scene, path: Path) -> bool:
    """Whether a number that is not set counts as zero, as the damping of a mass does."""
    return path[-1] == "damping" and quantity_at(scene, path) != Quantity()


def _movable(scene: Scene, path: Path) -> MovableNumber:
    value = float(number_at(scene, path) or 0.0)  # no damping is none
    return MovableNumber(path, shown(path), _label(scene, path), value, *_slider(quantity_of(scene, path), value))


def _label(scene: Scene, path: Path) -> str:
    unit = "s" if path == ("t1",) else unit_at(scene, path)
    if path[0] == "y0":
        ends = {"low": "initial {}, lowest", "high": "initial {}, highest"}
        coordinate = scene.system.coordinates[int(path[1])]
        text = ends.get(str(path[-1]), "initial {}").format(coordinate.name)
    else:
        words: list[str] = []
        for part in path[1:] or path:
            if isinstance(part, int):
                words[-1] = f"{words[-1].removesuffix('s')} {part}"
            elif part not in _NOT_SAID or part == path[-1]:
                words.append(_NAMES.get(part, part.replace("_", " ")))
        text = ", ".join(words[::-1])
    return f"{text} ({unit})" if unit not in ("", "1") else text


def _slider(about: Quantity, value: float) -> tuple[float, float, float]:
    """Ends and step of a slider: the bounds where there are some, else a range about the value."""
    bounds = [float(one) for one in (about.above, about.at_least) if one is not None]
    low = max(bounds, default=-math.inf)
    high = math.inf if about.below is None else float(about.below)
    if math.isinf(low) and math.isinf(high):
        reach = _round_up(2 * abs(value) or 1.0)
        low, high = -reach, reach
    elif math.isinf(high):
        high = low + _round_up(2 * (value - low) or 1.0)
    elif math.isinf(low):
        low = high - _round_up(2 * (high - value) or 1.0)
    step = (high - low) / _STEPS
    if about.above is not None and low == about.above:
        low += step
    if about.below is not None and high == about.below:
        high -= step
    return min(low, value), max(high, value), step


def _round_up(value: float) -> float:
    """The next of 1, 2, 4 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(float(np.round(power * one, 12)) for one in (1, 2, 4, 5, 10) if one * power >= value * (1 - 1e-12))
