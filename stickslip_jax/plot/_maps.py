"""Quantities over two parameters as maps, and parameter sweeps as maps or curves."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.contour import ContourSet
from matplotlib.path import Path
from matplotlib.patheffects import AbstractPathEffect, withStroke

from .._foundation import checks
from .._statistics.estimate import DEFAULT_LEVEL
from .._sweep.dataset import shown_statistics
from . import _style
from ._curves import curve, is_labeled, labeled
from ._style import LabeledData, Numbers, SeveralAxes, legend_above

if TYPE_CHECKING:
    import xarray


# Labelled lines of equal values in a map of colours.


_SHORTEST = 0.12  # of the height of the axes: shorter lines are left out
_FLAT_PART = 0.5  # of a line: where more than that is chance, all of it is left out
_LABEL = (0.028, 0.075)  # width of a letter and height of a label, in widths and heights of the axes
_PLANE = np.array([[1, x, y] for x in (-1, 0, 1) for y in (-1, 0, 1)], float)  # over a cell and those around it
_SURE = 4  # standard errors of a slope: chance exceeds them in one of 3000 cells (Rayleigh's distribution, exp(-8))


def draw_contours(
    ax: Axes,
    centers: tuple[np.ndarray, np.ndarray],
    values: np.ndarray,
    errors: np.ndarray | None,
    levels: list[float],
    texts: list[str],
) -> None:
    """Draw lines of equal values, interpolated between the centres of the cells, and label them.

    Short lines are left out, and those that run through flat regions, where their course is chance. Labels do not lie
    on each other. The scales and limits of `ax` must be set.

    - `centers` (nx,) and (ny,). `values`: (nx, ny), NaN where unknown, and their standard `errors`, if known.
    - `levels` of the lines, with their `texts`.
    """
    halo: list[AbstractPathEffect] = [withStroke(linewidth=2, foreground="white")]
    known = np.ma.masked_invalid(values).T
    lines = ax.contour(*centers, known, levels=levels, colors=_style.MASS, linewidths=0.8)
    lines.set_path_effects(halo)
    flat = _flat(values, errors)
    kept = [[piece for piece in _pieces(path) if _is_drawn(ax, centers, piece, flat)] for path in lines.get_paths()]
    lines.set_paths([Path.make_compound_path(*pieces) if pieces else Path(np.zeros((0, 2))) for pieces in kept])
    for text in _place_labels(ax, lines, kept, texts):
        text.set_path_effects(halo)


def _flat(values: np.ndarray, errors: np.ndarray | None) -> np.ndarray:
    """Where the values around a cell hardly change, so that the course of lines would be chance, (nx, ny).

    The slope is that of a plane through the known ones of the three by three cells around, by least squares. It is
    compared with its standard error: from the `errors` of the values, or else from their scatter about the plane.
    """
    wide = np.pad(values, 1, constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(wide, (3, 3)).reshape(*values.shape, 9)
    known = np.isfinite(around)
    filled = np.where(known, around, 0.0)
    inverse = np.linalg.pinv(np.einsum("ap,xya,aq->xypq", _PLANE, known, _PLANE), hermitian=True)
    plane = np.einsum("xypq,aq,xya->xyp", inverse, _PLANE, filled)
    spread = errors
    if spread is None:
        squares = np.sum(np.where(known, filled - plane @ _PLANE.T, 0.0) ** 2, axis=-1)
        spread = np.sqrt(squares / np.maximum(known.sum(axis=-1) - 3, 1))
    error = np.nan_to_num(spread, nan=np.inf) * np.sqrt(np.maximum(inverse[..., 1, 1], inverse[..., 2, 2]))
    return np.hypot(plane[..., 1], plane[..., 2]) < _SURE * error


def _pieces(path: Path) -> list[Path]:
    """The connected lines of a path."""
    return [Path(vertices) for vertices in path.to_polygons(closed_only=False)] if len(_vertices(path)) else []


def _vertices(path: Path) -> np.ndarray:
    """The points of a path, (points, 2)."""
    return np.asarray(path.vertices, float)


def _in_axes(ax: Axes, vertices: np.ndarray) -> np.ndarray:
    """Points in the coordinates of the axes, 0 to 1; these do not change with the layout of the figure."""
    return ax.transAxes.inverted().transform(ax.transData.transform(vertices))


def _is_drawn(ax: Axes, centers: tuple[np.ndarray, np.ndarray], line: Path, flat: np.ndarray) -> bool:
    """Whether a line is long enough, and mostly where values change."""
    points = _in_axes(ax, _vertices(line))
    lengths = np.hypot(*np.diff(points, axis=0).T)
    if lengths.sum() < _SHORTEST:
        return False
    middles = (_vertices(line)[1:] + _vertices(line)[:-1]) / 2
    cells = [np.interp(place, one, np.arange(len(one))) for place, one in zip(middles.T, centers, strict=True)]
    inside = flat[tuple(np.rint(cell).astype(int) for cell in cells)]
    return bool(lengths[inside].sum() <= _FLAT_PART * lengths.sum())


def _place_labels(ax: Axes, lines: ContourSet, kept: list[list[Path]], texts: list[str]) -> list:
    """Label the longest line of each level near its middle, where no other label is; none where there is no room."""
    placed: list[tuple[np.ndarray, np.ndarray]] = []
    labels = []
    for level, text, pieces in zip(lines.levels, texts, kept, strict=True):
        half = np.array([_LABEL[0] * len(text) + 0.01, _LABEL[1]]) / 2
        for line in sorted(pieces, key=lambda one: -_length(_in_axes(ax, _vertices(one)))):
            points = _in_axes(ax, _vertices(line))
            place = next((one for one in _from_middle(points) if _is_free(points[one], half, placed)), None)
            if place is not None:
                placed.append((points[place], half))
                labels.append((float(level), text, _vertices(line)[place]))
                break
    made = []
    for level, text, at in labels:
        made += lines.clabel([level], fontsize="small", fmt={level: text}, manual=[tuple(at)])
    return made


def _length(points: np.ndarray) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _from_middle(points: np.ndarray) -> np.ndarray:
    """The numbers of the points of a line, from its middle outward, without its ends."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    order = np.argsort(np.abs(along - along[-1] / 2), kind="stable")
    return order[(order > 0) & (order < len(points) - 1)]


def _is_free(point: np.ndarray, half: np.ndarray, placed: list[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Whether a label of that half width and height, upright or along its line, fits in the axes beside the others."""
    most = half.max()
    if np.any(point < most) or np.any(point > 1 - most):
        return False
    return all(np.any(np.abs(point - other) > half.max() + size.max()) for other, size in placed)


# A quantity over two parameters, as a map.


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
        checks.truth(name, truth)
    checks.positive("error_share", error_share)
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
                f"{checks.show(values)} was given."
            )
        values, errors, (x, y), axis_labels, label, _ = labeled(x, y, errors, (2,))
        names = tuple(one if own is None else own for own, one in zip(given, (*axis_labels, label), strict=True))
    for name, text in zip(("xlabel", "ylabel", "label"), names, strict=True):
        checks.text(name, text)
    across, up, array = _checked(x, y, values)
    for name, centers, is_log in (("x", across, logs[0]), ("y", up, logs[1])):
        if is_log and centers[0] <= 0:
            raise ValueError(
                f"Argument {name} must hold positive numbers on a logarithmic axis, but {centers[0]:g} is the first."
            )
    spread = None if errors is None else _style.checked_errors(errors, array)
    xlabel, ylabel, label = map(str, names)
    edges = _edges(across, logs[0]), _edges(up, logs[1])
    return _Map((across, up), edges, logs, array, spread, (xlabel, ylabel, label))


def _norm(limits: tuple[float | int, float | int] | None, log: bool) -> Normalize:
    """How values become colours."""
    kind = LogNorm if log else Normalize
    if limits is None:
        return kind()
    checks.numeric("limits", limits, ndim=1)
    if len(limits) != 2 or not limits[0] < limits[1] or (log and limits[0] <= 0):
        which = "two increasing positive numbers" if log else "two increasing numbers"
        raise ValueError(f"Argument limits must be {which}, but {checks.show(limits)} was given.")
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
        _style.note(ax, "no values")
    else:
        _draw_values(ax, grid, norm, contours)
    if grid.errors is not None:
        _draw_uncertain(ax, grid, grid.errors, error_share)
    ax.set_xlabel(_style.wrapped(grid.names[0]))
    ax.set_ylabel(_style.wrapped(grid.names[1]))
    legend_above(ax, columns=1)


def _draw_values(ax: Axes, grid: _Map, norm: Normalize, contours: bool) -> None:
    """The colours, their scale, and lines of equal values."""
    cells = np.ma.masked_invalid(grid.values).T
    mesh = ax.pcolormesh(*grid.edges, cells, cmap=_style.SHADES, norm=norm, rasterized=True)
    known = cells.compressed()
    sides = (known.min() < norm.vmin, known.max() > norm.vmax)
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}.get(sides, "neither")
    bar = _style.figure_of(ax).colorbar(mesh, ax=ax, label=_style.wrapped(grid.names[2]), extend=extend)
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
        checks.numeric(name, given, ndim=1)
        steps = np.diff(np.asarray(given, float))
        if not len(steps) or np.any(steps <= 0):
            raise ValueError(
                f"Argument {name} must hold two or more increasing numbers, but {checks.show(given)} was given."
            )
    across, up = np.asarray(x, float), np.asarray(y, float)
    array = _style.numbers_or_gaps("values", values, 2)
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
    corners = _style.rectangles(x_edges[across], x_edges[across + 1], y_edges[up], y_edges[up + 1])
    look = {"facecolor": _GRAY, "edgecolor": _style.FORWARD, "hatch": "////", "lw": 0}
    ax.add_collection(PolyCollection(corners, label=label, **look), autolim=False)


def _draw_uncertain(ax: Axes, grid: _Map, errors: np.ndarray, share: float) -> None:
    """Dots over the cells whose values are uncertain."""
    across, up = np.nonzero(~(errors <= share * np.abs(grid.values)) & np.isfinite(grid.values))
    if not len(across):
        return
    x, y = grid.edges
    corners = _style.rectangles(x[across], x[across + 1], y[up], y[up + 1])
    label = f"standard error above {100 * share:.4g} % of the value"
    if np.any(np.isnan(errors[across, up])):
        label += ", or not known"
    look = {"facecolor": "none", "edgecolor": _style.SERIES[2], "hatch": "...", "lw": 0}
    ax.add_collection(PolyCollection(corners, label=label, **look), autolim=False)


# The statistics of a parameter sweep: curves, or maps.


_MOST_CURVES = 4  # of several values of a parameter; more make a map
_PANEL = (5.6, 4.2)  # inches


def parameter_sweep(
    results: "xarray.Dataset",
    names: Sequence[str] | None = None,
    *,
    level: float | None = DEFAULT_LEVEL,
    axes: SeveralAxes | None = None,
) -> tuple[Axes, ...]:
    """Draw statistics of a parameter sweep, each in axes of its own.

    Along one parameter a curve with error bars; along two, of which one has at most four values, curves with bands;
    else a map. Parameters that are spaced geometrically have logarithmic axes. Points that are not there yet are gaps.

    Args:
        results: As `Sweep.run` returns it, with one or two dimensions of points; ``results.isel(...)`` chooses of more.
        names: Of the variables to draw, such as ``["mean_stick_duration"]``; by default those that ``stickslip show``
            prints: the statistics of totals, and derivatives.
        level: Of the confidence intervals, as in `curve`.
        axes: Where to draw, one for each name; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For results of other dimensions, and for names that are not in them.
    """
    if not is_labeled(results) or not hasattr(results, "data_vars"):
        raise ValueError(f"Argument results must be a Dataset of a Sweep, but {checks.show(results)} was given.")
    if names is None:
        dataset: Any = results
        names = shown_statistics(dataset) if "samples" in dataset else ()
    if not isinstance(names, (list, tuple)) or not names or not all(name in results for name in names):
        known = ", ".join(map(str, results.data_vars))
        raise ValueError(
            f"Argument names must be a list of variables of the results, some of {known}, but {checks.show(names)} "
            "was given."
        )
    found = _new_axes(len(names)) if axes is None else _style.axes_below_or_new(axes, tuple(names), _PANEL)
    for ax, name in zip(found, names, strict=True):
        _draw_sweep(ax, results, name, level)
    return tuple(found)


def _new_axes(number: int) -> list[Axes]:
    columns = 1 if number == 1 else 2
    rows = math.ceil(number / columns)
    size = (columns * _PANEL[0], rows * _PANEL[1])
    _, axes = plt.subplots(rows, columns, squeeze=False, figsize=size, layout="constrained")
    found = list(axes.flat)
    for spare in found[number:]:
        spare.remove()
    return found[:number]


def _draw_sweep(ax: Axes, results: Any, name: str, level: float | None) -> None:
    dimensions = [str(one) for one in results[name].dims]
    if len(dimensions) not in (1, 2):
        raise ValueError(
            f"Argument results must have one or two dimensions of points, but {name} has {len(dimensions)} "
            f"({', '.join(dimensions) or 'none'}); choose of the others with results.isel(...)."
        )
    logs = {one: _is_geometric(np.asarray(results[one])) for one in dimensions}
    few = min(dimensions, key=lambda one: results.sizes[one])
    if len(dimensions) == 2 and results.sizes[few] > _MOST_CURVES:
        errors = np.asarray(results.get(f"{name}_error", np.nan))
        # A single sample of each point has no errors at all, which needs no mark.
        data, variable = (results[name], None) if np.all(np.isnan(errors)) else (results, name)
        values = results[name]
        label = _style.quantity_label(str(values.attrs.get("long_name", name)), values.attrs.get("units") or "1")
        # Lines between cells of which many are not there yet would be scraps.
        complete = not np.any(np.isnan(np.asarray(values)))
        xlog, ylog = (logs[one] for one in dimensions)
        parameter_map(data, variable, xlog=xlog, ylog=ylog, label=label, contours=complete, ax=ax)
    else:
        along = next((one for one in dimensions if one != few), few)
        bands = "bars" if len(dimensions) == 1 else "band"
        curve(results, name, along=along, xlog=logs[along], uncertainty=bands, level=level, ax=ax)


def _is_geometric(values: np.ndarray) -> bool:
    """Whether neighbouring values have the same ratio, and not the same difference."""
    if len(values) < 3 or values.dtype.kind != "f" or np.any(values <= 0):
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) < 1e-6 * np.abs(ratios).max() and np.ptp(steps) > 1e-6 * np.abs(steps).max())
