"""A quantity over two parameters, as a map."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colorbar import Colorbar
from matplotlib.patheffects import AbstractPathEffect, withStroke

from .. import _checks
from . import _parts, _style
from ._types import Numbers

_GRAY = "#DDDDDD"


def parameter_map(
    x: Numbers,
    y: Numbers,
    values: Numbers | Sequence[Numbers],
    *,
    xlabel: str,
    ylabel: str,
    label: str,
    contours: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Draw a quantity over two parameters as a map of colours.

    Cells end half way between neighbouring values of the parameters; hatched gray cells hold no value.

    - `x`, `y`: values of the parameters, increasing, evenly spaced or not; (nx,) and (ny,), each two or more.
    - `values`: of the quantity, (nx, ny); NaN where it is not defined or was not computed.
    - `xlabel`, `ylabel`, `label`: names of the parameters and of the quantity, with their units.
    - `contours`: whether to draw lines of equal values, too.
    - `ax`: where to draw; by default the axes of a new figure.

    Returns the axes, with a note in them if no value is known. Raises ValueError for arrays of other shapes, infinite
    numbers, parameters that do not increase, and arguments of another kind.
    """
    x, y, values = _checked(x, y, values)
    for name, text in (("xlabel", xlabel), ("ylabel", ylabel), ("label", label)):
        if not isinstance(text, str):
            raise ValueError(f"Argument {name} must be a string, but {_checks.show(text)} was given.")
    _checks.truth("contours", contours)
    ax = _style.axes_or_new(ax, (5.6, 4.2))
    edges = _edges(x), _edges(y)
    unknown = np.isnan(values)
    if np.any(unknown):
        _draw_unknown(ax, *edges, unknown)
    if not np.all(unknown):
        mesh = ax.pcolormesh(*edges, np.ma.masked_array(values, unknown).T, cmap="viridis_r", rasterized=True)
        figure = ax.get_figure(root=True)
        assert figure is not None
        bar = figure.colorbar(mesh, ax=ax, label=label)
        if contours and np.nanmin(values) < np.nanmax(values):
            _draw_contours(ax, bar, x, y, values)
    else:
        _parts.note(ax, "no values")
    ax.set_xlim(edges[0][0], edges[0][-1])
    ax.set_ylim(edges[1][0], edges[1][-1])
    ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    if _parts.has_labels(ax):
        _style.legend_above(ax, columns=1)
    return ax


def _checked(x: Numbers, y: Numbers, values: Numbers | Sequence[Numbers]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The three arrays as floats. Raises ValueError for unsuitable ones."""
    for name, given in (("x", x), ("y", y)):
        _checks.numeric(name, given, ndim=1)
        if len(given) < 2 or np.any(np.diff(np.asarray(given, float)) <= 0):
            raise ValueError(
                f"Argument {name} must hold two or more increasing numbers, but {_checks.show(given)} was given."
            )
    _checks.numeric("values", np.nan_to_num(np.asarray(values, float), nan=0.0, posinf=np.inf, neginf=-np.inf), ndim=2)
    array = np.asarray(values, float)
    if array.shape != (len(x), len(y)):
        raise ValueError(
            f"Argument values must have the shape (len(x), len(y)) = ({len(x)}, {len(y)}), but an array of shape "
            f"{array.shape} was given."
        )
    return np.asarray(x, float), np.asarray(y, float), array


def _edges(centers: np.ndarray) -> np.ndarray:
    """The edges of cells: half way between neighbouring centres, and as far beyond the first and the last."""
    middle = (centers[1:] + centers[:-1]) / 2
    return np.concatenate([[2 * centers[0] - middle[0]], middle, [2 * centers[-1] - middle[-1]]])


def _draw_unknown(ax: Axes, x_edges: np.ndarray, y_edges: np.ndarray, unknown: np.ndarray) -> None:
    across, up = np.nonzero(unknown)
    corners = _parts.rectangles(x_edges[across], x_edges[across + 1], y_edges[up], y_edges[up + 1])
    look = {"facecolor": _GRAY, "edgecolor": _style.FORWARD, "hatch": "////", "lw": 0}
    ax.add_collection(PolyCollection(corners, label="no value", **look), autolim=False)


def _draw_contours(ax: Axes, bar: Colorbar, x: np.ndarray, y: np.ndarray, values: np.ndarray) -> None:
    """Labelled lines of equal values, at the ticks of the colour bar, interpolated between the centres of the cells."""
    levels = [level for level in bar.get_ticks() if np.nanmin(values) < level < np.nanmax(values)]
    if not levels:
        return
    known = np.ma.masked_invalid(values).T
    halo: list[AbstractPathEffect] = [withStroke(linewidth=2, foreground="white")]
    lines = ax.contour(x, y, known, levels=levels, colors=_style.MASS, linewidths=0.8)
    lines.set_path_effects(halo)
    for text in ax.clabel(lines, fontsize="small", fmt="%g"):
        text.set_path_effects(halo)
