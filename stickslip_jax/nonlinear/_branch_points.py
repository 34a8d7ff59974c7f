"""The points of a branch of periodic orbits, and what changes between two of them."""

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ._branch_function import Evaluated
from ._modes import Mode, sequence, slip_count, stick_count
from ._orbit_parts import multipliers_of, without_trivial

_FAR = 0.05  # of the period, from the begin of an orbit to the next event
_SIGNS = {1: "+", -1: "-", 0: "0"}


class BranchEvent(NamedTuple):
    """What happens on a branch: its `kind`, the value of the `parameter` there, the point after which, and in words.

    Kinds: "fold", "flip", "Neimark-Sacker", "branch point", "stick appears", "stick vanishes", "slip appears", "slip
    vanishes", "grazing"; of ends also "Hopf", and "end" where none of these was found.
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
    def is_at_rest(self) -> bool:
        """Whether all contacts stick all the time."""
        return not any(any(mode.signs) for mode in self.found.modes)

    @property
    def order(self) -> tuple[object, ...]:
        """The sequence of modes, and that with which the period begins: where it changes, the branch has a corner."""
        return sequence(self.found.modes), self.found.modes[0].signs

    @property
    def sequence_text(self) -> str:
        """The sequence of modes: "-0" is a slip with negative relative velocity and a stick."""
        return " ".join(text_of(signs) for signs in sequence(self.found.modes))

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


def text_of(signs: tuple[int, ...]) -> str:
    """The signs of the relative velocities of all contacts as text."""
    return "".join(_SIGNS[sign] for sign in signs)


def change_of_modes(last: Point, found: Point) -> Change | None:
    """The change of the sequence of modes between two neighbouring points; None where it is the same."""
    order = sequence(last.found.modes)
    if order == sequence(found.found.modes):
        return None
    text = f"the sequence of modes {last.sequence_text} becomes {found.sequence_text}"
    kind = kind_of(last.found.modes, found.found.modes)
    return Change(kind, text, lambda point: sequence(point.found.modes) == order)


def kind_of(before: tuple[Mode, ...], after: tuple[Mode, ...]) -> str:
    """What a change of the sequence of modes is called, by the numbers of sticks and slips. Where one less of both is
    left, a slip vanished in a stick or a stick in a slip: which of them is shorter.
    """
    if not any(any(mode.signs) for mode in after):
        return "slip vanishes"
    sticks, slips = stick_count(after) - stick_count(before), slip_count(after) - slip_count(before)
    if not sticks:
        return "grazing"
    shortest = min(before if sticks < 0 else after, key=lambda mode: mode.end - mode.start)
    thing = "slip" if sticks * slips > 0 and all(shortest.signs) else "stick"
    return f"{thing} {'appears' if sticks > 0 else 'vanishes'}"


def end_of(before: tuple[Mode, ...], beyond: tuple[Mode, ...]) -> tuple[str, str]:
    """What the end of a branch is called, and in words, by the modes of its last orbit, and of the motion that was
    followed from just `beyond` it: what comes first that is not as before counts, as the rest may follow from that.
    """
    shown = (" ".join(text_of(mode.signs) for mode in modes) for modes in (before, beyond))
    kind = kind_of(before, beyond)
    for number, mode in enumerate(before):
        there = beyond[number].signs if number < len(beyond) else beyond[-1].signs
        if there == mode.signs:
            continue
        contact = next(
            contact for contact, pair in enumerate(zip(mode.signs, there, strict=True)) if pair[0] != pair[1]
        )
        until = before[number - 1].signs[contact] if number else 0
        if mode.signs[contact] and not there[contact]:
            kind = "slip vanishes" if until == 0 else "stick appears"
        elif there[contact] and not mode.signs[contact]:
            kind = "slip appears" if until == 0 and number else "stick vanishes"
        break
    return kind, "a motion with the modes {} becomes one with {}".format(*shown)


def description(modes: tuple[Mode, ...]) -> str:
    """The shortest mode of an orbit, in words."""
    shortest = min(modes, key=lambda mode: mode.end - mode.start)
    kind = "slip" if all(shortest.signs) else "stick"
    return f"the shortest {kind} lasts {shortest.end - shortest.start:.3g} s"
