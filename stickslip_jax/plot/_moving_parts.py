"""The parts of a mechanism as artists of matplotlib that move from frame to frame."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle

from .. import _checks
from .._systems.mechanism import Belt, Body, Disk, Mechanism, OverTime, Part, Point, Rod, Spring
from . import _style

Move: TypeAlias = Callable[[int], None]
"""Puts what was drawn where it is in the frame with this number."""

_FILL, _FIXED = "#E6E6E6", "#BBBBBB"
_COIL_WIDTH, _COIL_LENGTH, _MOST_COILS = 0.16, 0.2, 7  # inches, from side to side and along the spring
_LEADS = 0.12  # of the length of a spring, straight at each end
_BASE_MARKS = 6


def check_mechanism(mechanism: object, whose: str, frames: int, contacts: int) -> None:
    """Raise ValueError for what a user's `System.mechanism` must not return; `whose`: the class of the system."""
    called = f"The method mechanism of {whose}"
    if not isinstance(mechanism, Mechanism) or not all(isinstance(part, Part) for part in mechanism.parts):
        raise ValueError(
            f"{called} must return a plot.Mechanism of Body, Spring, Rod, Disk and Belt, but {_checks.show(mechanism)} "
            "was returned."
        )
    for part in mechanism.parts:
        for value in _numbers_of(part):
            array = _checks.numbers("mechanism", value)
            if array.shape not in ((), (frames,)) or not np.all(np.isfinite(array)):
                raise ValueError(
                    f"{called} must return finite numbers or arrays of {frames} of them, one for each frame, but a "
                    f"{type(part).__name__} has {_checks.show(value)}."
                )
        touched = () if isinstance(part, (Belt, Spring)) else part.contacts
        if not set(touched) <= set(range(contacts)):
            raise ValueError(
                f"{called} must return numbers of contacts from 0 to {contacts - 1}, but a {type(part).__name__} has "
                f"the contacts {touched}."
            )


def _numbers_of(part: Part) -> tuple[OverTime, ...]:
    """All numbers of a part."""
    if isinstance(part, Body):
        return *part.center, part.width, part.height
    if isinstance(part, Disk):
        return *part.center, part.radius, *(() if part.angle is None else (part.angle,))
    if isinstance(part, Belt):
        return part.y, part.displacement, *part.ends
    return *part.start, *part.end


def draw_parts(ax: Axes, mechanism: Mechanism, sticking: np.ndarray) -> Move:
    """Draw a mechanism into `ax`; returns what moves it.

    `sticking`: whether each contact sticks in each frame, (frames, contacts).
    """
    ax.set(xlim=mechanism.x_range, ylim=mechanism.y_range)
    moves = [_draw(ax, part, sticking, 2 + 0.01 * order) for order, part in enumerate(mechanism.parts)]

    def move(frame: int) -> None:
        for one in moves:
            one(frame)

    return move


def _draw(ax: Axes, part: Part, sticking: np.ndarray, order: float) -> Move:
    """One part, above all of a lower `order`."""
    if isinstance(part, Body):
        return _body(ax, part, sticking, order)
    if isinstance(part, Disk):
        return _disk(ax, part, sticking, order)
    if isinstance(part, Belt):
        return _belt(ax, part, order)
    return _link(ax, part, sticking, order)


def _body(ax: Axes, body: Body, sticking: np.ndarray, order: float) -> Move:
    look = {"hatch": "////", "edgecolor": "0.5", "facecolor": _FIXED, "lw": 0} if body.fixed else {
        "edgecolor": _style.MASS, "facecolor": _FILL, "lw": _style.SLIP_WIDTH
    }  # fmt: skip
    patch = Rectangle((0, 0), 0, 0, zorder=order, **look)
    ax.add_patch(patch)
    text = ax.text(0, 0, body.label, ha="center", va="center", zorder=order, clip_on=True, fontsize="small")
    stuck = _any_of(sticking, body.contacts)

    def move(frame: int) -> None:
        (x, y), width, height = _at(body.center, frame), _number(body.width, frame), _number(body.height, frame)
        patch.set_bounds(x - width / 2, y - height / 2, width, height)
        text.set_position((x, y))
        if not body.fixed:
            patch.set_facecolor(_style.STICK if stuck[frame] else _FILL)

    return move


def _disk(ax: Axes, disk: Disk, sticking: np.ndarray, order: float) -> Move:
    color = _style.BASE if disk.is_base else _style.MASS
    look = {"fill": not disk.is_base, "facecolor": _FILL, "edgecolor": color, "lw": 1.4, "zorder": order}
    circle = Circle((0, 0), disk.radius, **look)
    ax.add_patch(circle)
    marks = LineCollection([], colors=color, lw=1.8, zorder=order)
    ax.add_collection(marks, autolim=False)
    text = ax.text(0, 0, disk.label, ha="center", va="top", fontsize="small", zorder=order)
    stuck = _any_of(sticking, disk.contacts)
    # A ring has short marks all around it, the first a long one.
    turns = 2 * np.pi * np.arange(_BASE_MARKS) / _BASE_MARKS if disk.is_base else np.zeros(1)
    inner = np.where(turns == 0, 0.82, 0.92) if disk.is_base else np.zeros(1)

    def move(frame: int) -> None:
        center = np.array(_at(disk.center, frame))
        circle.set_center((center[0], center[1]))
        text.set_position((center[0], center[1] - 1.35 * disk.radius))
        if not disk.is_base:
            circle.set_facecolor(_style.STICK if stuck[frame] else _FILL)
        if disk.angle is not None:
            angles = _number(disk.angle, frame) + turns
            ways = disk.radius * np.stack([np.cos(angles), np.sin(angles)], -1)
            marks.set_segments(list(np.stack([center + inner[:, None] * ways, center + ways], 1)))

    return move


def _belt(ax: Axes, belt: Belt, order: float) -> Move:
    ax.plot(belt.ends, [belt.y] * 2, color=_style.BASE, lw=2, zorder=order, solid_capstyle="butt")
    marks = LineCollection([], colors=_style.BASE, lw=1.6, zorder=order)
    ax.add_collection(marks, autolim=False)
    places = belt.mark_places
    height = abs(np.diff(ax.get_ylim())[0])
    lengths = np.where(np.arange(belt.marks) == 0, 0.11, 0.05) * height
    below = np.column_stack([np.full(belt.marks, belt.y), belt.y - lengths])

    def move(frame: int) -> None:
        x = places[frame] if places.ndim == 2 else places
        marks.set_segments(list(np.stack([np.stack([x, x], -1), below], -1)))

    return move


def _link(ax: Axes, link: Spring | Rod, sticking: np.ndarray, order: float) -> Move:
    figure = _style.figure_of(ax)
    # Coils have the same width in every direction and on every scale, so they are drawn in inches.
    is_spring = isinstance(link, Spring)
    line = Line2D([], [], color=_style.MASS, lw=_style.SLIP_WIDTH if is_spring else 1.6, zorder=order)
    if is_spring:
        line.set_transform(figure.dpi_scale_trans)
    ax.add_artist(line)
    line.set_clip_path(ax.patch)
    stuck = _any_of(sticking, () if is_spring else link.contacts)
    usual = np.array([[np.mean(place) for place in point] for point in (link.start, link.end)])

    def move(frame: int) -> None:
        ends = np.array([_at(link.start, frame), _at(link.end, frame)])
        if is_spring:
            first, last = ax.transData.transform(usual) / figure.dpi
            coils = int(np.clip(np.hypot(*(last - first)) / _COIL_LENGTH, 2, _MOST_COILS))
            start, end = ax.transData.transform(ends) / figure.dpi
            ends = zigzag(start, end, coils)
        line.set_data(*ends.T)
        line.set_color(_style.STICK if stuck[frame] else _style.MASS)

    return move


def zigzag(start: np.ndarray, end: np.ndarray, coils: int) -> np.ndarray:
    """The corners of a spring from `start` to `end` (2,), (corners, 2); all in inches."""
    way = end - start
    length = np.hypot(*way)
    across = np.array([-way[1], way[0]]) / length if length > 0 else np.zeros(2)
    along = np.concatenate([[0.0], np.linspace(_LEADS, 1 - _LEADS, 2 * coils + 1), [1.0]])
    side = np.zeros(len(along))
    side[2:-2] = np.where(np.arange(2 * coils - 1) % 2, -0.5, 0.5)
    return start + along[:, None] * way + _COIL_WIDTH * side[:, None] * across


def _any_of(sticking: np.ndarray, contacts: Sequence[int]) -> np.ndarray:
    """Whether any of these contacts sticks, in each frame."""
    return np.asarray(sticking[:, list(contacts)].any(axis=1))


def _number(value: OverTime, frame: int) -> float:
    return float(np.asarray(value)[frame]) if np.ndim(value) else float(value)


def _at(point: Point, frame: int) -> tuple[float, float]:
    return _number(point[0], frame), _number(point[1], frame)
