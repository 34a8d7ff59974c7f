"""Branches of periodic orbits."""

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from . import _parts, _style
from ._legends import legend_above

if TYPE_CHECKING:
    from ..nonlinear import OrbitBranch

_MARKERS = {
    "fold": "s", "flip": "D", "Neimark-Sacker": "^", "branch point": "P", "stick appears": "o", "stick vanishes": "o",
    "slip appears": "p", "slip vanishes": "p", "grazing": "v", "Hopf": "*", "end": "X",
}  # fmt: skip


def orbit_branch(result: "OrbitBranch", name: str = "period", *, ax: Axes | None = None) -> Axes:
    """Draw a number of periodic orbits along a branch: lines where they are stable, dashes where they are not.

    Args:
        result: The branch, of `nonlinear.continue_orbit`.
        name: Of the variable of ``result.points`` to draw.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a mark and a name for each event on the way.

    Raises:
        ValueError: For anything else, and for a name that is not among the variables.
    """
    points: Any = getattr(result, "points", None)
    if not hasattr(points, "data_vars") or "is_stable" not in points:
        raise ValueError(f"Argument result must be that of continue_orbit, but {_checks.show(result)} was given.")
    known = [str(one) for one, values in points.data_vars.items() if values.dims == ("point",) and one != "modes"]
    _checks.chosen("name", name, known)
    ax = _style.axes_or_new(ax, (5.6, 4.2))
    (parameter,) = points.coords
    x, y = np.asarray(points[parameter], float), np.asarray(points[name], float)
    stable = np.asarray(points["is_stable"], bool)
    edges = [0, *(np.flatnonzero(stable[1:] != stable[:-1]) + 1), len(x)]
    for begin, end in pairwise(edges):
        last = min(end + 1, len(x))  # up to the next, so that no gap is left
        style, label = ("-", "stable") if stable[begin] else ("--", "unstable")
        new = label not in ax.get_legend_handles_labels()[1]
        ax.plot(x[begin:last], y[begin:last], style, color=_style.MASS, lw=1.3, label=label if new else None)
    for event in result.events:
        near = min(event.point + 1, len(x) - 1)
        color = _style.STICK if event.kind.startswith("stick") else _style.BASE
        ax.plot(event.parameter, y[near], ls="none", marker=_MARKERS[event.kind], ms=6, color=color, label=event.kind)
    ax.set_xlabel(_parts.label_of(points[parameter]))
    ax.set_ylabel(_parts.wrapped(_parts.label_of(points[name])))
    legend_above(ax)
    return ax
