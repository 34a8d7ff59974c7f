"""The points of a branch of periodic orbits, and what changes between two of them."""

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ._branch_function import Evaluated
from ._modes import Mode, sequence, stick_count
from ._orbit_parts import multipliers_of, without_trivial

_FAR = 0.05  # of the period, from the begin of an orbit to the next event
_SIGNS = {1: "+", -1: "-", 0: "0"}


class BranchEvent(NamedTuple):
    """What happens on a branch: its `kind`, the value of the `parameter` there, the point after which, and in words.

    Kinds: "fold", "flip", "Neimark-Sacker", "branch point", "stick appears", "stick vanishes", "grazing", "end".
    """

    kind: str
    parameter: float
    point: int
    text: str


class Point:
    """A point of the branch: the `unknowns`, the equations `found` there, the `tangent` (scaled), and the number of
    iterations that it took.
    """

    def __init__(self, unknowns: np.ndarray, found: Evaluated, tangent: np.ndarray, iterations: int):
        self.unknowns, self.found, self.tangent, self.iterations = unknowns, found, tangent, iterations

    def turned(self) -> "Point":
        """The same, its tangent the other way."""
        return Point(self.unknowns, self.found, -self.tangent, self.iterations)

    @cached_property
    def multipliers(self) -> np.ndarray:
        """The Floquet multipliers, the largest first."""
        size = self.found.coordinates
        return multipliers_of(self.found.matrix[:size, :size] + np.eye(size))

    def is_stable(self, driven: bool) -> bool:
        """Whether all multipliers but the one that is 1 without a drive are inside the unit circle."""
        return bool(np.all(np.abs(self.own_multipliers(driven)) < 1))

    def own_multipliers(self, driven: bool) -> np.ndarray:
        """The multipliers without the one that is 1 where nothing drives the system."""
        return self.multipliers if driven else without_trivial(self.multipliers)

    @property
    def stick_fraction(self) -> float:
        """The share of the period in sticks, mean over the contacts."""
        modes = self.found.modes
        stuck = sum((mode.end - mode.start) * np.mean([sign == 0 for sign in mode.signs]) for mode in modes)
        return float(stuck / self.found.duration)

    @property
    def order(self) -> tuple[object, ...]:
        """The sequence of modes, and that with which the period begins: where it changes, the branch has a corner."""
        return sequence(self.found.modes), self.found.modes[0].signs

    @property
    def sequence_text(self) -> str:
        """The sequence of modes: "-0" is a slip with negative relative velocity and a stick."""
        return " ".join("".join(_SIGNS[sign] for sign in signs) for signs in sequence(self.found.modes))

    @property
    def is_far_from_events(self) -> bool:
        """Whether the orbit begins in the midst of a mode."""
        modes, duration = self.found.modes, self.found.duration
        if len(modes) == 1:
            return True
        return modes[0].end > _FAR * duration and modes[-1].end - modes[-1].start > _FAR * duration


class Change(NamedTuple):
    """What changed between two points, and whether a point in between `is_before` it."""

    kind: str
    text: str
    is_before: Callable[[Point], bool]


def changes(last: Point, found: Point, driven: bool) -> Iterator[Change]:
    """What changed between two neighbouring points with the same sequence of modes."""
    turned = last.tangent[-1] * found.tangent[-1] < 0
    if turned:
        yield Change("fold", "the branch turns round", lambda point: point.tangent[-1] * last.tangent[-1] > 0)
    for kind, text, test in _TESTS:
        if kind == "branch point" and turned:
            continue

        def sign(point: Point, test: Callable[[np.ndarray], float] = test) -> float:
            return test(point.own_multipliers(driven))

        if sign(last) * sign(found) < 0:
            yield Change(kind, text, lambda point, sign=sign: sign(point) * sign(last) > 0)


def _flip(multipliers: np.ndarray) -> float:
    return float(np.prod(multipliers + 1).real)


def _unit(multipliers: np.ndarray) -> float:
    return float(np.prod(multipliers - 1).real)


def _rotation(multipliers: np.ndarray) -> float:
    """Changes its sign where a complex pair passes the unit circle; NaN where there is none."""
    pairs = multipliers[np.imag(multipliers) > 1e-9]
    return float(np.prod(np.abs(pairs) - 1)) if len(pairs) else float("nan")


_TESTS = (
    ("flip", "a multiplier passes -1: an orbit of twice the period branches off", _flip),
    ("Neimark-Sacker", "a pair of multipliers passes the unit circle: motion on a torus branches off", _rotation),
    ("branch point", "a multiplier passes 1: another branch crosses", _unit),
)


def change_of_modes(last: Point, found: Point) -> Change | None:
    """The change of the sequence of modes between two neighbouring points; None where it is the same."""
    order = sequence(last.found.modes)
    if order == sequence(found.found.modes):
        return None
    before, after = stick_count(last.found.modes), stick_count(found.found.modes)
    kind = "grazing" if after == before else "stick appears" if after > before else "stick vanishes"
    text = f"the sequence of modes {last.sequence_text} becomes {found.sequence_text}"
    return Change(kind, text, lambda point: sequence(point.found.modes) == order)


def description(modes: tuple[Mode, ...]) -> str:
    """The shortest mode of an orbit, in words."""
    shortest = min(modes, key=lambda mode: mode.end - mode.start)
    kind = "slip" if all(shortest.signs) else "stick"
    return f"the shortest {kind} lasts {shortest.end - shortest.start:.3g} s"
