"""Quantities over two parameters as maps, and parameter sweeps as maps or curves."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
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
    ax: Axes, centers: tuple[np.ndarray, np.ndarray], values: np.ndarray, errors: np.ndarray | None,
    levels: list[float], texts: list[str],
) -> None:  # fmt: skip
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
    # Of each level its lines: the points, where these are in the axes (0 to 1, which does not change with the layout of
    # the figure), and the lengths there between neighbours.
    kept: list[list[tuple[np.ndarray, ...]]] = []
    for path in lines.get_paths():
        kept.append([])
        for line in path.to_polygons(closed_only=False):
            vertices = np.asarray(line, float)
            points = ax.transAxes.inverted().transform(ax.transData.transform(vertices))
            lengths = np.hypot(*np.diff(points, axis=0).T)
            middles = ((vertices[1:] + vertices[:-1]) / 2).T
            cells = [np.interp(place, one, np.arange(len(one))) for place, one in zip(middles, centers, strict=True)]
            by_chance = lengths[flat[tuple(np.rint(cell).astype(int) for cell in cells)]].sum()
            if lengths.sum() >= _SHORTEST and by_chance <= _FLAT_PART * lengths.sum():
                kept[-1].append((vertices, points, lengths))
    compound = [[Path(vertices) for vertices, *_ in pieces] for pieces in kept]
    lines.set_paths([Path.make_compound_path(*pieces) if pieces else Path(np.zeros((0, 2))) for pieces in compound])
    # The longest line of each level that has room is labelled near its middle, but not at its ends, where the label,
    # upright or along the line, is in the axes and beside the others.
    placed: list[tuple[np.ndarray, float]] = []
    for level, text, pieces in zip(lines.levels, texts, kept, strict=True):
        half = max(_LABEL[0] * len(text) + 0.01, _LABEL[1]) / 2
        for vertices, points, lengths in sorted(pieces, key=lambda piece: -piece[2].sum()):
            along = np.concatenate([[0.0], np.cumsum(lengths)])
            free = np.all((points >= half) & (points <= 1 - half), axis=1)
            free[[0, -1]] = False
            for other, size in placed:
                free &= np.any(np.abs(points - other) > half + size, axis=1)
            if np.any(free):
                place = min(np.flatnonzero(free), key=lambda one: abs(along[one] - along[-1] / 2))
                placed.append((points[place], half))
                fmt, at = {float(level): text}, [tuple(vertices[place])]
                for drawn in lines.clabel([float(level)], fontsize="small", fmt=fmt, manual=at):
                    drawn.set_path_effects(halo)
                break


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
    norm = LogNorm() if log else Normalize()
    if limits is not None:
        checks.numeric("limits", limits, ndim=1)
        if len(limits) != 2 or not limits[0] < limits[1] or (log and limits[0] <= 0):
            raise checks.refused("limits", f"be two increasing {'positive ' if log else ''}numbers", limits)
        norm.vmin, norm.vmax = limits
    names: list[str | None] = [xlabel, ylabel, label]
    if is_labeled(x):
        if values is not None:
            raise checks.refused("values", "be left out with a labelled array, which holds them", values)
        values, errors, (x, y), axis_labels, own_label, _ = labeled(x, y, errors, (2,))
        names = [own if given is None else given for own, given in zip((*axis_labels, own_label), names, strict=True)]
    for name, text in zip(("xlabel", "ylabel", "label"), names, strict=True):
        checks.text(name, text)
    centers, array, spread = _checked(x, y, values, errors, (xlog, ylog))
    ax = _style.axes_or_new(ax, (5.6, 4.2))
    edges = _edges(centers[0], xlog), _edges(centers[1], ylog)
    ax.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]])
    for axis, set_scale in ((ax.xaxis, ax.set_xscale),) * xlog + ((ax.yaxis, ax.set_yscale),) * ylog:
        set_scale("log")
        _style.log_axis(axis)
    array = np.where(array > 0, array, np.nan) if log else array
    unknown = np.isnan(array)
    look = {"facecolor": _GRAY, "edgecolor": _style.FORWARD, "hatch": "////"}
    _hatch(ax, edges, unknown, "no positive value" if log else "no value", look)
    if np.all(unknown):
        _style.note(ax, "no values")
    else:
        bar = _style.draw_cells(ax, edges, np.ma.masked_invalid(array), norm, _style.wrapped(str(names[2])), ax)
        lowest, highest = np.nanmin(array), np.nanmax(array)
        levels = np.array([level for level in bar.get_ticks() if lowest < level < highest] if contours else [])
        if len(levels):
            texts = [f"{level:g}" for level in levels]
            heights, sides = (np.log(array), None if spread is None else spread / array) if log else (array, spread)
            draw_contours(ax, centers, heights, sides, list(np.log(levels) if log else levels), texts)
    if spread is not None:
        uncertain = ~(spread <= error_share * np.abs(array)) & ~unknown
        text = f"standard error above {100 * error_share:.4g} % of the value"
        text += ", or not known" if np.any(np.isnan(spread[uncertain])) else ""
        _hatch(ax, edges, uncertain, text, {"facecolor": "none", "edgecolor": _style.SERIES[2], "hatch": "..."})
    ax.set(xlabel=_style.wrapped(str(names[0])), ylabel=_style.wrapped(str(names[1])))
    legend_above(ax, columns=1)
    return ax


_Pair: TypeAlias = tuple[np.ndarray, np.ndarray]
"""What belongs to the abscissa, (nx,), and to the ordinate, (ny,)."""


def _checked(
    x: object, y: object, values: object, errors: object, logs: tuple[bool, bool]
) -> tuple[_Pair, np.ndarray, np.ndarray | None]:
    """The centres of the cells, the values in them, and their errors if there are any. Raises ValueError for others."""
    for name, given in (("x", x), ("y", y)):
        checks.numeric(name, given, ndim=1)
        steps = np.diff(np.asarray(given, float))
        if not len(steps) or np.any(steps <= 0):
            raise checks.refused(name, "hold two or more increasing numbers", given)
    across, up = np.asarray(x, float), np.asarray(y, float)
    array = _style.numbers_or_gaps("values", values, 2)
    if array.shape != (len(across), len(up)):
        shape = f"the shape (len(x), len(y)) = ({len(across)}, {len(up)})"
        raise ValueError(f"Argument values must have {shape}, but an array of shape {array.shape} was given.")
    for name, centers, is_log in (("x", across, logs[0]), ("y", up, logs[1])):
        if is_log and centers[0] <= 0:
            demand = "hold positive numbers on a logarithmic axis"
            raise ValueError(f"Argument {name} must {demand}, but {centers[0]:g} is the first.")
    return (across, up), array, None if errors is None else _style.checked_errors(errors, array)


def _edges(centers: np.ndarray, is_log: bool) -> np.ndarray:
    """The edges of cells: half way between neighbouring centres, and as far beyond the first and the last."""
    if is_log:
        return np.exp(_edges(np.log(centers), False))
    middle = (centers[1:] + centers[:-1]) / 2
    return np.concatenate([[2 * centers[0] - middle[0]], middle, [2 * centers[-1] - middle[-1]]])


def _hatch(ax: Axes, edges: _Pair, chosen: np.ndarray, label: str, look: dict[str, Any]) -> None:
    """Mark the `chosen` cells, if there are any."""
    across, up = np.nonzero(chosen)
    if len(across):
        x, y = edges
        corners = _style.rectangles(x[across], x[across + 1], y[up], y[up + 1])
        _style.draw_polygons(ax, corners, label=label, **look)


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
        raise checks.refused("results", "be a Dataset of a Sweep", results)
    if names is None:
        dataset: Any = results
        names = shown_statistics(dataset) if "samples" in dataset else ()
    if not isinstance(names, (list, tuple)) or not names or not all(name in results for name in names):
        known = ", ".join(map(str, results.data_vars))
        raise checks.refused("names", f"be a list of variables of the results, some of {known}", names)
    if axes is None:
        columns, rows = min(len(names), 2), math.ceil(len(names) / 2)
        size = (columns * _PANEL[0], rows * _PANEL[1])
        _, grid = plt.subplots(rows, columns, squeeze=False, figsize=size, layout="constrained")
        for spare in grid.flat[len(names) :]:
            spare.remove()
        found = tuple(grid.flat)[: len(names)]
    else:
        found = _style.axes_below_or_new(axes, tuple(names), _PANEL)
    for ax, name in zip(found, names, strict=True):
        values: Any = results[name]
        dimensions = [str(one) for one in values.dims]
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
            data, variable = (values, None) if np.all(np.isnan(errors)) else (results, name)
            # Lines between cells of which many are not there yet would be scraps.
            complete = not np.any(np.isnan(np.asarray(values)))
            xlog, ylog = (logs[one] for one in dimensions)
            label = _style.label_of(values)
            parameter_map(data, variable, xlog=xlog, ylog=ylog, label=label, contours=complete, ax=ax)
        else:
            along = next((one for one in dimensions if one != few), few)
            bands = "bars" if len(dimensions) == 1 else "band"
            curve(results, name, along=along, xlog=logs[along], uncertainty=bands, level=level, ax=ax)
    return found


def _is_geometric(values: np.ndarray) -> bool:
    """Whether neighbouring values have the same ratio, and not the same difference."""
    if len(values) < 3 or values.dtype.kind != "f" or np.any(values <= 0):
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) < 1e-6 * np.abs(ratios).max() and np.ptp(steps) > 1e-6 * np.abs(steps).max())
