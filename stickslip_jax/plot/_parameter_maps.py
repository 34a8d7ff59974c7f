"""A quantity over two parameters, as a map."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm, Normalize

from .. import _checks
from . import _parts, _style
from ._contours import draw_contours
from ._labeled import is_labeled, labeled
from ._legends import legend_above
from ._types import LabeledData, Numbers

_GRAY = "#DDDDDD"


def parameter_map(
    x: Numbers | LabeledData,
    y: Numbers | str | None = None,
    values: Numbers | Sequence[Numbers] | None = None,
    *,
    errors: Numbers | Sequence[Numbers] | LabeledData | str | None = None,
    error_share: float = 0.1,
    xlabel: str | None = None,
    ylabel: str | None = None,
    label: str | None = None,
    xlog: bool = False,
    ylog: bool = False,
    log: bool = False,
    contours: bool = True,
    limits: tuple[float | int, float | int] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a quantity over two parameters as a map of colours.

    Cells end half way between neighbouring values of the parameters; hatched gray cells hold no value.

    Args:
        x: Two or more increasing values of a parameter, evenly spaced or not, (nx,). Or, without `values`, an
            ``xarray.DataArray``, whose first dimension is on the abscissa; or an ``xarray.Dataset``. Their attributes
            ``long_name`` and ``units`` name axes and colours.
        y: Values of the other parameter, likewise, (ny,). Of a Dataset the name of a variable.
        values: Of the quantity, (nx, ny); NaN where it is not defined or was not computed.
        errors: Standard errors of the values, (nx, ny); of a Dataset the name of a variable, by default as in `curve`.
            Dots mark cells where the error is large, or not known.
        error_share: Errors above this share of the value are large.
        xlabel: Name of the abscissa, with its unit, where nothing else says it.
        ylabel: Name of the ordinate, likewise.
        label: Name of the quantity, likewise.
        xlog: Whether the abscissa is logarithmic.
        ylog: Whether the ordinate is logarithmic.
        log: Whether the colours are logarithmic. Values that are not positive are drawn like missing ones then.
        contours: Whether to draw lines of equal values, too. Left out are short ones and those in flat regions, where
            their course is chance: where the slope is below four of its standard errors, which follow from `errors`,
            or without them from the scatter of neighbouring values about a plane.
        limits: Values of the first and the last colour, such as ``(0, 1)`` for shares, so that maps can be compared; by
            default the smallest and the largest value.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if no value is known.

    Raises:
        ValueError: For arrays of other shapes, infinite numbers, parameters that do not increase, and arguments of
            another kind.
    """
    for name, truth in (("xlog", xlog), ("ylog", ylog), ("log", log), ("contours", contours)):
        _checks.truth(name, truth)
    _checks.positive("error_share", error_share)
    norm = _norm(limits, log)
    grid = _map_of(x, y, values, errors, (xlabel, ylabel, label), (xlog, ylog))
    ax = _style.axes_or_new(ax, (5.6, 4.2))
    _draw(ax, grid, norm, contours, error_share)
    return ax


class _Map(NamedTuple):
    """A map with cells (nx, ny).

    - `centers`, `edges` of the cells along both axes; `logs`: whether these are logarithmic.
    - `values`, NaN where unknown; `errors`: their standard errors, or None. `names`: of the axes and of the values.
    """

    centers: tuple[np.ndarray, np.ndarray]
    edges: tuple[np.ndarray, np.ndarray]
    logs: tuple[bool, bool]
    values: np.ndarray
    errors: np.ndarray | None
    names: tuple[str, str, str]


def _map_of(
    x: object, y: object, values: object, errors: object, given: tuple[str | None, ...], logs: tuple[bool, bool]
) -> _Map:
    """The map to draw, checked; `given`: names of the axes and of the values."""
    names = given
    if is_labeled(x):
        if values is not None:
            raise ValueError(
                "Argument values must be left out with a labelled array, which holds them, but "
                f"{_checks.show(values)} was given."
            )
        values, errors, (x, y), axis_labels, label, _ = labeled(x, y, errors, (2,))
        names = tuple(one if own is None else own for own, one in zip(given, (*axis_labels, label), strict=True))
    for name, text in zip(("xlabel", "ylabel", "label"), names, strict=True):
        _checks.text(name, text)
    across, up, array = _checked(x, y, values)
    for name, centers, is_log in (("x", across, logs[0]), ("y", up, logs[1])):
        if is_log and centers[0] <= 0:
            raise ValueError(
                f"Argument {name} must hold positive numbers on a logarithmic axis, but {centers[0]:g} is the first."
            )
    spread = None if errors is None else _parts.checked_errors(errors, array)
    xlabel, ylabel, label = map(str, names)
    edges = _edges(across, logs[0]), _edges(up, logs[1])
    return _Map((across, up), edges, logs, array, spread, (xlabel, ylabel, label))


def _norm(limits: tuple[float | int, float | int] | None, log: bool) -> Normalize:
    """How values become colours."""
    kind = LogNorm if log else Normalize
    if limits is None:
        return kind()
    _checks.numeric("limits", limits, ndim=1)
    if len(limits) != 2 or not limits[0] < limits[1] or (log and limits[0] <= 0):
        which = "two increasing positive numbers" if log else "two increasing numbers"
        raise ValueError(f"Argument limits must be {which}, but {_checks.show(limits)} was given.")
    return kind(*limits)


def _draw(ax: Axes, grid: _Map, norm: Normalize, contours: bool, error_share: float) -> None:
    """The cells, what is said of them in the legend, and the axes."""
    log = isinstance(norm, LogNorm)
    for axis, edges, is_log in zip((ax.xaxis, ax.yaxis), grid.edges, grid.logs, strict=True):
        _set_axis(axis, edges, is_log)
    if log:
        grid = grid._replace(values=np.where(grid.values > 0, grid.values, np.nan))
    unknown = np.isnan(grid.values)
    if np.any(unknown):
        _draw_unknown(ax, *grid.edges, unknown, "no positive value" if log else "no value")
    if np.all(unknown):
        _parts.note(ax, "no values")
    else:
        _draw_values(ax, grid, norm, contours)
    if grid.errors is not None:
        _draw_uncertain(ax, grid, grid.errors, error_share)
    ax.set_xlabel(_parts.wrapped(grid.names[0]))
    ax.set_ylabel(_parts.wrapped(grid.names[1]))
    legend_above(ax, columns=1)


def _draw_values(ax: Axes, grid: _Map, norm: Normalize, contours: bool) -> None:
    """The colours, their scale, and lines of equal values."""
    cells = np.ma.masked_invalid(grid.values).T
    mesh = ax.pcolormesh(*grid.edges, cells, cmap=_style.SHADES, norm=norm, rasterized=True)
    known = cells.compressed()
    sides = (known.min() < norm.vmin, known.max() > norm.vmax)
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}.get(sides, "neither")
    bar = _style.figure_of(ax).colorbar(mesh, ax=ax, label=_parts.wrapped(grid.names[2]), extend=extend)
    if contours and np.nanmin(grid.values) < np.nanmax(grid.values):
        values, errors = grid.values, grid.errors
        if isinstance(norm, LogNorm):
            values, errors = np.log(values), None if errors is None else errors / values
        lowest, highest = np.nanmin(grid.values), np.nanmax(grid.values)
        levels = [level for level in bar.get_ticks() if lowest < level < highest]
        if levels:
            scaled = np.log(levels) if isinstance(norm, LogNorm) else levels
            draw_contours(ax, grid.centers, values, errors, list(scaled), [f"{level:g}" for level in levels])


def _set_axis(axis: Axis, edges: np.ndarray, is_log: bool) -> None:
    """The limits and the scale of an axis."""
    ax = axis.axes
    (ax.set_xlim if axis is ax.xaxis else ax.set_ylim)(edges[0], edges[-1])
    if is_log:
        (ax.set_xscale if axis is ax.xaxis else ax.set_yscale)("log")
        _style.log_axis(axis)


def _checked(x: object, y: object, values: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The three arrays as floats. Raises ValueError for unsuitable ones."""
    for name, given in (("x", x), ("y", y)):
        _checks.numeric(name, given, ndim=1)
        steps = np.diff(np.asarray(given, float))
        if not len(steps) or np.any(steps <= 0):
            raise ValueError(
                f"Argument {name} must hold two or more increasing numbers, but {_checks.show(given)} was given."
            )
    across, up = np.asarray(x, float), np.asarray(y, float)
    array = _parts.numbers_or_gaps("values", values, 2)
    if array.shape != (len(across), len(up)):
        raise ValueError(
            f"Argument values must have the shape (len(x), len(y)) = ({len(across)}, {len(up)}), but an array of shape "
            f"{array.shape} was given."
        )
    return across, up, array


def _edges(centers: np.ndarray, is_log: bool) -> np.ndarray:
    """The edges of cells: half way between neighbouring centres, and as far beyond the first and the last."""
    if is_log:
        return np.exp(_edges(np.log(centers), False))
    middle = (centers[1:] + centers[:-1]) / 2
    return np.concatenate([[2 * centers[0] - middle[0]], middle, [2 * centers[-1] - middle[-1]]])


def _draw_unknown(ax: Axes, x_edges: np.ndarray, y_edges: np.ndarray, unknown: np.ndarray, label: str) -> None:
    across, up = np.nonzero(unknown)
    corners = _parts.rectangles(x_edges[across], x_edges[across + 1], y_edges[up], y_edges[up + 1])
    look = {"facecolor": _GRAY, "edgecolor": _style.FORWARD, "hatch": "////", "lw": 0}
    ax.add_collection(PolyCollection(corners, label=label, **look), autolim=False)


def _draw_uncertain(ax: Axes, grid: _Map, errors: np.ndarray, share: float) -> None:
    """Dots over the cells whose values are uncertain."""
    across, up = np.nonzero(~(errors <= share * np.abs(grid.values)) & np.isfinite(grid.values))
    if not len(across):
        return
    x, y = grid.edges
    corners = _parts.rectangles(x[across], x[across + 1], y[up], y[up + 1])
    label = f"standard error above {100 * share:.4g} % of the value"
    if np.any(np.isnan(errors[across, up])):
        label += ", or not known"
    look = {"facecolor": "none", "edgecolor": _style.SERIES[2], "hatch": "...", "lw": 0}
    ax.add_collection(PolyCollection(corners, label=label, **look), autolim=False)
