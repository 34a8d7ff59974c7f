"""How a system is drawn in motion: bodies, springs, rods, disks and belts whose places follow from its states.

Plain data, which ``plot.animate`` draws. Lengths are those of the horizontal axis of the drawing, usually m. A number
that changes from frame to frame is an array (frames,), one that does not may be a float.
"""

from typing import NamedTuple, TypeAlias

import numpy as np

OverTime: TypeAlias = np.ndarray | float
Point: TypeAlias = tuple[OverTime, OverTime]
"""Its horizontal and its vertical place."""


class Body(NamedTuple):
    """A rectangle, coloured as a stick while any of its contacts sticks.

    Args:
        center: Of the rectangle.
        width: Horizontal.
        height: Vertical.
        contacts: Numbers of its contacts, from 0; of a system with one contact ``(0,)``.
        label: Written on it.
        fixed: Whether it is part of the surroundings, such as a wall.
    """

    center: Point
    width: OverTime
    height: OverTime
    contacts: tuple[int, ...] = ()
    label: str = ""
    fixed: bool = False


class Spring(NamedTuple):
    """A zig-zag line that stretches.

    Args:
        start: One end.
        end: The other.
    """

    start: Point
    end: Point


class Rod(NamedTuple):
    """A straight line.

    Args:
        start: One end.
        end: The other.
        contacts: As those of a `Body`.
    """

    start: Point
    end: Point
    contacts: tuple[int, ...] = ()


class Disk(NamedTuple):
    """A disk that turns, with a mark from its centre to its rim.

    Args:
        center: Of the disk.
        radius: Of the disk.
        angle: From the horizontal axis to the mark, counterclockwise, rad; None without a mark.
        contacts: As those of a `Body`.
        label: Written under it.
        is_base: Whether it is the base: a ring with marks, in the colour of bases.
    """

    center: Point
    radius: float
    angle: OverTime | None = None
    contacts: tuple[int, ...] = ()
    label: str = ""
    is_base: bool = False


class Belt(NamedTuple):
    """The base: a horizontal line with marks that move with it, one of them longer than the others.

    Args:
        y: Its height in the drawing.
        displacement: How far it has run; the marks stand at this place, and at multiples of `spacing` from it.
        ends: Between which it is drawn: a mark that leaves at one end comes in again at the other.
        marks: How many there are between the ends.
    """

    y: float
    displacement: OverTime
    ends: tuple[float, float]
    marks: int = 8

    @property
    def spacing(self) -> float:
        """From one mark to the next."""
        return (self.ends[1] - self.ends[0]) / self.marks

    @property
    def mark_places(self) -> np.ndarray:
        """Where the marks stand, (frames, marks); the first is the long one."""
        low, high = self.ends
        run = np.asarray(self.displacement, float)[..., None] + self.spacing * np.arange(self.marks)
        return low + np.mod(run - low, high - low)


Part: TypeAlias = Body | Spring | Rod | Disk | Belt


class Mechanism(NamedTuple):
    """What `System.mechanism` returns.

    Args:
        parts: In the order in which they are drawn, the last above the others.
        x_range: The part of the horizontal axis that is shown.
        y_range: That of the vertical one.
        x_label: Of the horizontal axis; without one its numbers are not shown.
        x_names: Places on the horizontal axis and what to write there, in place of numbers.
        equal: Whether lengths are drawn alike in both directions, so that circles are round.
        note: What must be known to read the drawing.
    """

    parts: tuple[Part, ...]
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    x_label: str = ""
    x_names: tuple[tuple[float, str], ...] = ()
    equal: bool = False
    note: str = ""


def bars(
    coordinates: tuple[tuple[str, str], ...], state: tuple[np.ndarray, ...], on: tuple[tuple[int, ...], ...]
) -> Mechanism:
    """The numbers of a state as bars, each over its largest size.

    - `coordinates`: name and unit of each number of the `state`.
    - `on`: of each of them, the contacts that colour its bar.
    """
    parts, names = [], []
    for number, ((name, unit), values, contacts) in enumerate(zip(coordinates, state, on, strict=True)):
        largest = float(np.max(np.abs(values)))
        shares = values / largest if largest > 0 else values
        parts.append(Body((float(number), shares / 2), 0.6, np.abs(shares), contacts))
        in_unit = "" if unit == "1" else f" {unit}"
        names.append((float(number), f"{name}\n±{largest:.3g}{in_unit}"))
    last = len(coordinates) - 0.5
    parts.append(Rod((-0.5, 0.0), (last, 0.0)))
    return Mechanism(tuple(parts), (-0.5, last), (-1.1, 1.5), x_names=tuple(names))
