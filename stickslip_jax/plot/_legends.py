"""The legend above the axes, fitted to the room that there is, and numbers at ticks that do not reach into it."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.ticker import ScalarFormatter

from ._parts import wrapped
from ._style import figure_of

_ROOM = 0.92  # of the width of the figure: twice the way from the middle of the axes to the right edge
_LEAST, _MOST = 1e-3, 1e5  # numbers at ticks beyond these are written with powers of ten


def legend_above(
    ax: Axes, *others: Axes, columns: int = 3, lines_first: bool = False, room: float | None = None
) -> None:
    """Put one legend for `ax` and `others`, if anything has a label, above `ax`, where it hides no data.

    Each label is listed once. There are as many columns as have room, and long labels are wrapped.

    - `columns`: at most. `lines_first`: whether lines come before areas, so that of two columns each holds one kind.
    - `room`: for the legend, a share of the width of the figure; by default that of the axes with their labels.
    """
    handles = {}
    for one in (ax, *others):
        plain_numbers(one.yaxis)
        for handle, label in zip(*one.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if not handles:
        return
    if lines_first:
        handles = dict(sorted(handles.items(), key=lambda item: not isinstance(item[1], Line2D)))
    figure = figure_of(ax)
    # Not the renderer of the figure's own backend: that of SVG measures in other units than the figure.
    measure = RendererAgg(1, 1, figure.dpi)
    most = (_room(ax) if room is None else room) * figure.bbox.width
    width = most
    for number in range(min(columns, len(handles)), 0, -1):
        width = _legend(ax, list(handles), list(handles.values()), number).get_window_extent(measure).width
        if width <= most:
            return
    letters = int(max(map(len, handles)) * most / width) - 6  # the handle is as wide
    _legend(ax, [wrapped(label, letters) for label in handles], list(handles.values()), 1)


def _legend(ax: Axes, labels: list[str], handles: list, columns: int) -> Legend:
    place = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "frameon": False}
    return ax.legend(handles, labels, ncols=columns, **place)


def _room(ax: Axes) -> float:
    """The width of the part of the figure that is for these axes, as a share of the figure."""
    place = ax.get_subplotspec()
    if place is None:
        return max(_ROOM * ax.get_position().width, 0.1)
    grid = place.get_gridspec()
    return _ROOM * len(place.colspan) / grid.ncols


def plain_numbers(axis: Axis) -> None:
    """Write the numbers at linear ticks in full, instead of what is common to them at the end of the axis.

    The legend stands there.
    """
    if type(axis.get_major_formatter()) is ScalarFormatter:
        axis.set_major_formatter(_WholeNumbers())


class _WholeNumbers(ScalarFormatter):
    """Numbers without a common offset or power of ten; each has its own power where they are very small or large."""

    def __init__(self) -> None:
        super().__init__(useOffset=False)
        self.set_scientific(False)
        self._ticks = np.zeros(0)

    def set_locs(self, locs: Any) -> None:
        super().set_locs(locs)
        self._ticks = np.asarray(locs, float)

    def __call__(self, x: Any, pos: int | None = None) -> str:
        largest = np.max(np.abs(self._ticks), initial=0.0)
        if largest == 0 or _LEAST <= largest < _MOST:
            return super().__call__(x, pos)
        if x == 0:
            return "0"
        power = int(np.floor(np.log10(np.abs(x)) + 1e-9))
        step = np.min(np.diff(np.unique(self._ticks)), initial=np.inf)
        digits = max(0, power - int(np.floor(np.log10(step) + 1e-9))) if np.isfinite(step) else 2
        mantissa = f"{x / 10.0**power:.{digits}f}"
        if "." in mantissa:
            mantissa = mantissa.rstrip("0").rstrip(".")
        return self.fix_minus(rf"${mantissa}\times10^{{{power}}}$")
