"""Sections of motions, bifurcation diagrams, basins of attraction, and branches of orbits."""

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap

from .._foundation import checks
from . import _style
from ._parameters import is_labeled
from ._style import legend_above

if TYPE_CHECKING:
    import xarray

    from ..nonlinear import OrbitBranch


# Sections of motions, and bifurcation diagrams.


_RETURNS = ("cycle", "event")
_DOTS = (6.0, 0.8), (1.5, 0.4)  # area (square points) and opacity of points: of few, of many


def section(results: "xarray.Dataset", x: str | None = None, y: str | None = None, *, ax: Axes | None = None) -> Axes:
    """Draw the states of a section, one number of the state against another, a point for each return.

    Args:
        results: Of `stroboscopic_section` or `event_section`, at one point of the parameters:
            ``results.sel(mu=0.3)``. Starts have colours of their own, up to five.
        x: The name of a variable; by default the first number of the state.
        y: The name of another one; by default the second number of the state.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For results of another kind, and for names that are not in them.
    """
    names, returns = _states(results)
    columns = [
        results[checks.chosen("name", name, map(str, results.data_vars))] for name in (x or names[0], y or names[1])
    ]
    more = [str(one) for one in columns[0].dims if one not in (returns, "start")]
    if more:
        raise ValueError(
            f"Argument results must be at one point of the parameters, but they have the dimensions {', '.join(more)}; "
            f"choose with results.isel({more[0]}=0)."
        )
    ax = _style.axes_or_new(ax, (5.6, 4.2))
    several = "start" in columns[0].dims and columns[0].sizes["start"] <= len(_style.SERIES)
    points = [np.asarray(column.transpose(..., returns)).reshape(-1, column.sizes[returns]) for column in columns]
    if several:
        for number, (left, right) in enumerate(zip(*points, strict=True)):
            _dots(ax, left, right, _style.SERIES[number], f"start {number + 1}" if len(points[0]) > 1 else None)
        legend_above(ax)
    else:
        _dots(ax, points[0].ravel(), points[1].ravel(), _style.MASS, None)
    ax.set(xlabel=_style.label_of(columns[0]), ylabel=_style.label_of(columns[1]))
    return ax


def bifurcation_diagram(
    results: "xarray.Dataset", name: str | None = None, *, along: str | None = None, ax: Axes | None = None
) -> Axes:
    """Draw what motions settle on over one parameter: a point for each return kept.

    Args:
        results: Of `bifurcation_diagram` or of a section over one parameter, from one or several starts. With the
            dimension "direction" the two are drawn in two colours.
        name: Of the variable to draw; by default the first number of the state. Of variables without returns, such as
            ``recurrence``, there is one point for each case.
        along: The parameter on the abscissa; by default the only one.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For results of another kind, and for names that are not in them.
    """
    names, _ = _states(results)
    values: Any = results[checks.chosen("name", name or names[0], map(str, results.data_vars))]
    parameters = [str(one) for one in values.dims if one not in (*_RETURNS, "start", "direction", "contact")]
    along = along or (parameters[0] if len(parameters) == 1 else None)
    if along not in parameters or len(parameters) > 1:
        raise ValueError(
            f"Argument results must have one parameter, but {', '.join(parameters) or 'none'} was given; choose of the "
            "others with results.isel(...)."
        )
    ax = _style.axes_or_new(ax, (6.4, 4.2))
    labels = [str(one) for one in np.asarray(results["direction"])] if "direction" in values.dims else [None]
    colors = (_style.MASS,) if len(labels) == 1 else (_style.SERIES[0], _style.SERIES[2])
    for label, color in zip(labels, colors, strict=True):
        own = values if label is None else values.sel(direction=label)
        rows = np.asarray(own.transpose(along, ...)).reshape(own.sizes[along], -1)
        abscissas = np.repeat(np.asarray(results[along], float), rows.shape[1])
        _dots(ax, abscissas, rows.ravel(), color, None if label is None else f"followed {label}")
    ax.set(xlabel=_style.label_of(results[along]), ylabel=_style.wrapped(_style.label_of(values)))
    legend_above(ax)
    return ax


def _dots(ax: Axes, x: np.ndarray, y: np.ndarray, color: str, label: str | None) -> None:
    known = np.isfinite(x) & np.isfinite(y)
    _style.draw_dots(ax, x[known], y[known], _DOTS, color, label)


def _states(results: Any) -> tuple[list[str], str | None]:
    """The names of the numbers of the state, and of the dimension of returns."""
    demand = "be a Dataset of a section or a bifurcation diagram"
    if not is_labeled(results) or not hasattr(results, "data_vars"):
        raise checks.refused("results", demand, results)
    returns = next((one for one in _RETURNS if one in results.dims), None)
    where = ("at the end of the period", "at the event")
    named = {str(name): str(values.attrs.get("long_name", "")) for name, values in results.data_vars.items()}
    names = [name for name, meaning in named.items() if meaning.endswith(where)]
    if returns is None or len(names) < 2:
        raise ValueError(f"Argument results must {demand}, but one with {', '.join(named) or 'nothing'} was given.")
    return names, returns


# Basins of attraction.


_COLORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#999999")
_NONE = "#FFFFFF"


def basins(results: "xarray.Dataset", *, ax: Axes | None = None) -> Axes:
    """Draw which starts end on which attractor, and the attractors.

    Args:
        results: Of `nonlinear.basins`: on a grid of two coordinates, or starts of a system with two.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes. Basins beyond the eighth share a colour; starts on no attractor are white.

    Raises:
        ValueError: For results of another kind.
    """
    if not is_labeled(results) or "basin" not in getattr(results, "data_vars", {}):
        raise checks.refused("results", "be a Dataset of basins", results)
    basin = results["basin"]
    ax = _style.axes_or_new(ax, (5.6, 4.6))
    shown = min(results.sizes["attractor"], len(_COLORS))
    names = [str(one) for one in basin.dims]
    if basin.ndim == 1:
        names = [str(one) for one in results.coords if str(one).startswith("initial_")]
    if len(names) != 2:
        raise ValueError(
            "Argument results must have starts in two coordinates, but those given differ in "
            f"{', '.join(names) or 'none'}; choose of the others with results.isel(...)."
        )
    x, y = (results[name] for name in names)
    colors = ListedColormap([_NONE, *_COLORS[:shown]])
    look: dict[str, Any] = {"cmap": colors, "norm": BoundaryNorm(np.arange(-0.5, shown + 1), shown + 1)}
    labels = np.minimum(np.asarray(basin), shown)
    if basin.ndim == 2:
        ax.pcolormesh(np.asarray(x), np.asarray(y), labels.T, rasterized=True, **look)
    else:
        ax.scatter(x, y, c=labels, s=6, lw=0, rasterized=True, **look)
        names = [name.removeprefix("initial_") for name in names]
    shares = np.asarray(results["share"])
    for row in range(shown):
        points = [np.asarray(results[f"attractor_{name}"])[row] for name in names if f"attractor_{name}" in results]
        if len(points) == 2 and not bool(results["is_stuck"][row]):
            ax.plot(*points, ls="none", marker=".", ms=2.5, color="black", zorder=3)
        ax.fill([], [], color=_COLORS[row], label=f"attractor {row + 1}: {shares[row]:.1%}")
    ax.plot([], [], ls="none", marker=".", color="black", label="points of attractors")
    ax.set(xlabel=_style.label_of(x), ylabel=_style.label_of(y))
    legend_above(ax)
    return ax


# Branches of periodic orbits.


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
        raise checks.refused("result", "be that of continue_orbit", result)
    known = [str(one) for one, values in points.data_vars.items() if values.dims == ("point",) and one != "modes"]
    checks.chosen("name", name, known)
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
    ax.set(xlabel=_style.label_of(points[parameter]), ylabel=_style.wrapped(_style.label_of(points[name])))
    legend_above(ax)
    return ax
