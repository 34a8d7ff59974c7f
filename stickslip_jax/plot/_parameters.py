"""Statistics over one parameter or two: as curves, as maps, and those of a parameter sweep."""

import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, TypeGuard, get_args
from weakref import WeakKeyDictionary

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.lines import Line2D
from matplotlib.path import Path
from matplotlib.patheffects import AbstractPathEffect, withStroke

from .._foundation import checks
from .._statistics.distribution import Distribution
from .._statistics.estimate import DEFAULT_LEVEL, Estimate, check_level
from .._sweep.dataset import shown_statistics
from . import _style
from ._style import LabeledData, Numbers, SeveralAxes, legend_above

if TYPE_CHECKING:
    import xarray

# What figures read from labelled arrays of xarray: values, their standard errors, coordinates, names and units.


class Labeled(NamedTuple):
    """A labelled array, ready to draw, with coordinates that increase.

    - `values`, `errors` (standard errors, or None), both with a dimension for each of `coordinates`.
    - `axis_labels`: of the coordinates, with units. `label`: of the values. `units`: of the coordinates.
    """

    values: np.ndarray
    errors: np.ndarray | None
    coordinates: tuple[np.ndarray, ...]
    axis_labels: tuple[str, ...]
    label: str
    units: tuple[str, ...]


def is_labeled(value: object) -> TypeGuard[LabeledData]:
    """Whether `value` is a DataArray or Dataset of xarray, which need not be installed."""
    xarray = sys.modules.get("xarray")
    return xarray is not None and isinstance(value, (xarray.DataArray, xarray.Dataset))


def labeled(
    data: LabeledData, name: object, errors: object, dimensions: tuple[int, ...], along: str | None = None
) -> Labeled:
    """Read a DataArray, or the variable `name` of a Dataset.

    - `errors`: its standard errors, an array of its shape; of a Dataset the name of a variable, by default that named
      by the attribute ``ancillary_variables`` of the values, or by their name and ``_error`` or ``_standard_error``.
    - `dimensions`: how many it may have. `along`: which is to be the first.

    Raises ValueError for anything else.
    """
    values: Any = data
    if not hasattr(data, "data_vars"):
        if name is not None:
            hint = "of a Dataset it is the name of a variable"
            raise checks.refused("y", "be left out with a DataArray", name, hint)
    elif not (isinstance(name, str) and name in data.data_vars):
        known = ", ".join(map(str, data.data_vars))
        raise checks.refused("y", f"be the name of a variable of the Dataset, one of {known}", name)
    else:
        values = data[name]
        if errors is None:
            named = str(values.attrs.get("ancillary_variables", "")).split()
            errors = next((one for one in (*named, f"{name}_error", f"{name}_standard_error") if one in data), None)
        elif isinstance(errors, str) and errors not in data:
            raise checks.refused("errors", "be the name of a variable of the Dataset", errors)
        errors = data[errors] if isinstance(errors, str) else errors
    dims = ", ".join(map(str, values.dims))
    if values.ndim not in dimensions:
        allowed = " or ".join(map(str, dimensions))
        raise ValueError(
            f"Argument x must have {allowed} dimensions, but an array with {values.ndim} was given "
            f"({dims or 'none'}); choose values of the others with .sel(...)."
        )
    if along is not None:
        if along not in values.dims:
            raise checks.refused("along", f"be one of the dimensions {dims}", along)
        values = values.transpose(along, ...)
    coordinates = [values[dimension] for dimension in values.dims]
    for one in coordinates:
        if one.dtype.kind not in "iuf":
            raise ValueError(f"Argument x must have numbers as coordinates, but {one.name} holds {checks.show(one)}.")
    if errors is not None:
        errors = np.asarray(errors.transpose(*values.dims) if is_labeled(errors) else errors, float)
    order = [np.argsort(np.asarray(one), kind="stable") for one in coordinates]
    array = np.asarray(values, float)
    return Labeled(
        array[np.ix_(*order)],
        errors[np.ix_(*order)] if errors is not None and errors.shape == array.shape else errors,
        tuple(np.asarray(one, float)[place] for one, place in zip(coordinates, order, strict=True)),
        tuple(map(_style.label_of, coordinates)),
        _style.label_of(values),
        tuple(map(_style.unit_of, coordinates)),
    )


# Any statistic against a parameter.


Uncertainty: TypeAlias = Literal["bars", "band"]


def curve(
    x: Numbers | LabeledData,
    y: Sequence[Estimate] | Numbers | str | None = None,
    *,
    errors: Numbers | LabeledData | str | None = None,
    level: float | None = DEFAULT_LEVEL,
    uncertainty: Uncertainty = "bars",
    along: str | None = None,
    xlabel: str | None = None,
    ylabel: str | None = None,
    label: str | None = None,
    xlog: bool = False,
    ylog: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw a statistic against a parameter, with error bars or a band. Call it again with the same `ax` to compare.

    Args:
        x: Values of the parameter, (points,) in any order. Or, without `y`, an ``xarray.DataArray`` with one dimension,
            or two, for several curves; or an ``xarray.Dataset``. Their attributes ``long_name`` and ``units`` name the
            axes.
        y: For each of these values an `Estimate`, such as ``ss.mean_stick_duration(ensemble)`` or
            ``ensemble.statistics.duration.median``, or a number, NaN for a gap. Of a Dataset the name of a variable.
        errors: Standard errors of numbers, in their shape; of a Dataset the name of a variable, by default that which
            the attribute ``ancillary_variables`` names, or that called like `y` and ``_error`` or ``_standard_error``.
        level: Of the confidence intervals that are drawn, by Student's t for estimates, else by the normal
            distribution. None: one standard error to both sides.
        uncertainty: How these are drawn, "bars" or "band".
        along: Of an array with two dimensions, which is on the abscissa; by default the first.
        xlabel: Name of the abscissa, with its unit, where nothing else says it.
        ylabel: Name of the ordinate, likewise. By default all quantities whose names are known.
        label: Name of the curve in the legend; of several, before the value of the other coordinate. By default the
            quantity, where curves of several are in the same axes.
        xlog: Whether the abscissa is logarithmic.
        ylog: Whether the ordinate is logarithmic. Values of zero or less are left out then, and counted.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if there is nothing to draw.

    Raises:
        ValueError: For arguments of another kind, length or unit.
    """
    if level is not None:
        check_level(level)
    checks.chosen("uncertainty", uncertainty, get_args(Uncertainty))
    checks.truth("xlog", xlog)
    checks.truth("ylog", ylog)
    for name, text in (("xlabel", xlabel), ("ylabel", ylabel), ("label", label)):
        checks.text(name, text, or_none=True)
    if is_labeled(x):
        found = _of_labeled(labeled(x, y, errors, (1, 2), along), level, label)
    else:
        found = _of_numbers(x, y, errors, level, label)
    places, curves, own_xlabel, own_ylabel = found
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    # The ordinate is named after all quantities, unless it has a name that the user gave.
    before, there, known = _quantities(ax), ax.get_ylabel(), None
    if own_ylabel is not None and (not there or there == _style.wrapped(",\n".join(before))):
        known = ",\n".join(dict.fromkeys([*before, own_ylabel]))
    ax.set_xlabel(_named("xlabel", xlabel or ax.get_xlabel() or own_xlabel))
    ax.set_ylabel(_named("ylabel", ylabel or known or there))
    if xlog and np.any(places <= 0):
        raise checks.refused("x", "hold positive numbers on a logarithmic axis", places)
    if not xlog and np.all(places == np.round(places)):
        _style.whole_numbers(ax.xaxis)
    drawn = [_draw(ax, places, one, uncertainty, ylog, own_ylabel) for one in curves]
    if not any(drawn) and not any(np.size(line.get_xdata(orig=False)) for line in ax.lines):
        _style.note(ax, "no values")
    for axis in (ax.xaxis,) * xlog + (ax.yaxis,) * ylog:
        _style.log_axis(axis)
    _legend(ax, uncertainty, level, any(np.any(np.isfinite(one.low)) for one in curves))
    return ax


_QUANTITIES: WeakKeyDictionary[Line2D, str] = WeakKeyDictionary()
"""What the curves that have been drawn show, with units."""


def _quantities(ax: Axes) -> list[str]:
    """What the curves in `ax` show, each once."""
    return list(dict.fromkeys(_QUANTITIES[line] for line in ax.lines if line in _QUANTITIES))


class _Curve(NamedTuple):
    """Values with the ends of their intervals, NaN where not known, (points,) each."""

    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    label: str | None


_Curves: TypeAlias = tuple[np.ndarray, list[_Curve], str | None, str | None]
"""The abscissas of curves, (points,) and increasing, the curves, and the names of the axes where they are known."""


def _of_labeled(data: Labeled, level: float | None, label: str | None) -> _Curves:
    """One curve of a labelled array with one dimension, or one for each index of its second."""
    values = data.values.reshape(len(data.coordinates[0]), -1)
    low, high = (ends.reshape(values.shape) for ends in _ends(data.values, data.errors, level))
    labels = [label]
    if data.values.ndim == 2:
        name = data.axis_labels[1].removesuffix(f" ({data.units[1]})")
        unit = "" if data.units[1] == "1" else f" {data.units[1]}"
        own = [f"{name} = {value:.4g}{unit}" for value in data.coordinates[1]]
        labels = own if label is None else [f"{label}, {text}" for text in own]
    curves = list(map(_Curve, values.T, low.T, high.T, labels))
    return data.coordinates[0], curves, data.axis_labels[0], data.label


def _of_numbers(x: object, y: object, errors: object, level: float | None, label: str | None) -> _Curves:
    checks.numeric("x", x, ndim=1)
    places = np.asarray(x, float)
    order = np.argsort(places, kind="stable")
    estimates = list(y) if isinstance(y, (list, tuple)) and any(isinstance(one, Estimate) for one in y) else []
    if not estimates:
        values, name = _style.numbers_or_gaps("y", y, 1), None
        low, high = _ends(values, errors, level)
    else:
        if not all(isinstance(one, Estimate) for one in estimates):
            raise checks.refused("y", "hold estimates or numbers only", estimates)
        units, names = {one.unit for one in estimates}, {one.name for one in estimates}
        if len(units) > 1:
            raise ValueError(f"Argument y must hold estimates of one unit, but {', '.join(sorted(units))} were given.")
        name = _style.quantity_label(*names, *units) if len(names) == 1 else None
        if errors is not None:
            raise checks.refused("errors", "be left out with estimates", errors, "estimates have their own")
        values, sides = np.array([(one.value, one.standard_error) for one in estimates], float).T
        low, high = values - sides, values + sides
        if level is not None:
            low, high = np.array([one.interval(level) for one in estimates], float).T
    if len(values) != len(places):
        raise ValueError(f"Argument y must have the length {len(places)} of x, but it has {len(values)}.")
    return places[order], [_Curve(values[order], low[order], high[order], label)], None, name


def _ends(values: np.ndarray, errors: object, level: float | None) -> tuple[np.ndarray, np.ndarray]:
    """The ends of the intervals about `values`, NaN without errors."""
    if errors is None:
        return np.full(values.shape, np.nan), np.full(values.shape, np.nan)
    sides = _style.checked_errors(errors, values)
    if level is not None:
        sides = sides * _style.errors_in_half(level)
    return values - sides, values + sides


def _named(argument: str, name: str | None) -> str:
    """The name of an axis, which must be known."""
    if not name:
        what = "the name of the axis with its unit, because what is drawn does not say it"
        raise ValueError(f"Argument {argument} must be given, {what}.")
    return _style.wrapped(name)


def _legend(ax: Axes, uncertainty: Uncertainty, level: float | None, has_errors: bool) -> None:
    """The legend: what curves show where they show several quantities, and at its end what bars or bands are."""
    if len(_quantities(ax)) > 1:
        for line in ax.lines:
            if line in _QUANTITIES and str(line.get_label()).startswith("_"):
                line.set_label(_QUANTITIES[line])
    if has_errors:
        text = f"{uncertainty}: {'one standard error' if level is None else _style.interval_name(level)}"
        for line in [line for line in ax.lines if line.get_label() == text]:
            line.remove()
        marker = "|" if uncertainty == "bars" else "s"
        ax.plot([], [], ls="none", marker=marker, ms=9, color=_style.FORWARD, mew=1.5, label=text)
    legend_above(ax, columns=2)


def _draw(ax: Axes, x: np.ndarray, one: _Curve, uncertainty: Uncertainty, ylog: bool, quantity: str | None) -> bool:
    """Draw a curve with its uncertainty; whether there was anything to draw."""
    values, low, high, label = one
    left_out = ylog & (values <= 0)
    if np.any(left_out):
        values = np.where(left_out, np.nan, values)
        lost = f"{_style.counted(int(left_out.sum()), 'value')} of zero or less left out"
        label = lost if label is None else f"{label} ({lost})"
    if ylog and uncertainty == "band":
        low = np.where(low <= 0, values * 1e-12, low)
    if not np.any(np.isfinite(values)):
        return False
    look = _style.next_look(ax, x)
    known = np.isfinite(low) & np.isfinite(values)
    if np.any(known) and uncertainty == "band":
        limits = ax.dataLim.frozen()
        _style.shade_between(ax, x, low, high, look["color"], where=known)
        if ylog:  # the axis need not reach down to where the band ends for want of a logarithm
            ax.dataLim.set(limits)
            ax.update_datalim(np.column_stack([x, np.where(low > 1e-6 * values, low, values)])[known])
            ax.update_datalim(np.column_stack([x, high])[known])
    elif np.any(known):
        sides = np.stack([values - low, high - values])[:, known]
        ax.errorbar(x[known], values[known], sides, ls="none", ecolor=look["color"], elinewidth=1.0, capsize=2.0)
    (line,) = ax.plot(x, values, label=label, **look)
    if quantity is not None:
        _QUANTITIES[line] = quantity
    return True


# The stick fraction against a parameter.


_FREQUENCY_RATIO = r"frequency ratio $r = f_\mathrm{b}\,/\,(\omega/2\pi)$ (dimensionless)"


def stick_fraction_curve(
    parameter_values: Numbers,
    fractions: Sequence[Distribution] | Sequence[Estimate] | Numbers,
    *,
    errors: Numbers | Sequence[Numbers] | None = None,
    level: float = DEFAULT_LEVEL,
    xlabel: str | None = None,
    label: str | None = None,
    band_label: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the stick fraction T_s, the share of time spent sticking in percent, against a parameter.

    As in Lima and Sampaio (conference paper), figure 6 (square wave: one steady period, given as numbers) and figure 7
    (random steps: mean and band, given as distributions). Call it again with the same `ax` to compare.

    Args:
        parameter_values: (points,), in any order.
        fractions: One for each value, all of one kind:

            - ``ensemble.statistics.stick_fraction``: the mean is drawn, with a band between two quantiles that holds
              the share `level` of the realisations.
            - an `Estimate`, such as ``stick_fraction(ensemble)``: the band is the confidence interval of the mean.
            - a number between 0 and 1, such as the stick fraction of one simulation: the band is that of `errors`.
        errors: With numbers only, how far the band reaches below and above them, as fractions: (points,), or
            (2, points) with the lower side first. By default there is no band.
        level: Of the band of distributions and estimates.
        xlabel: Name of the parameter, with its unit. By default it is the frequency ratio of the paper, base frequency
            over natural frequency, which is positive.
        label: Name of the line in the legend; by default "mean" for distributions and estimates, none for numbers.
        band_label: Name of the band; by default what it holds for distributions and estimates, none for numbers.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes. Points without a finished sample are left out, and so is the band of estimates from one sample.

    Raises:
        ValueError: For arguments of another kind or length.
    """
    checks.numeric("parameter_values", parameter_values, ndim=1)
    values = np.asarray(parameter_values, float)
    if len(values) == 0:
        raise ValueError("Argument parameter_values must hold one or more numbers, but it holds none.")
    if xlabel is None and np.any(values <= 0):
        hint = "xlabel names another parameter"
        raise checks.refused("parameter_values", "hold positive frequency ratios", parameter_values, hint)
    points, own_label, own_band_label = _fractions_of(fractions, len(values), errors, level)
    for name, text in (("xlabel", xlabel), ("label", label), ("band_label", band_label)):
        checks.text(name, text, or_none=True)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    order = np.argsort(values, kind="stable")
    values, mean, low, high = (column[order] for column in (values, *100 * points))
    look = _style.next_look(ax, values)
    if np.any(np.isfinite(low)):
        band_label = own_band_label if band_label is None else band_label
        _style.shade_between(ax, values, low, high, look["color"], band_label)
    known = np.isfinite(mean)
    ax.plot(values[known], mean[known], label=own_label if label is None else label, **look)
    ax.set_xlabel(_FREQUENCY_RATIO if xlabel is None else xlabel)
    ax.set_ylabel("stick fraction $T_s$ (%)")
    legend_above(ax, columns=2, lines_first=True)
    return ax


def _fractions_of(
    fractions: Sequence[Distribution] | Sequence[Estimate] | Numbers, number: int,
    errors: Numbers | Sequence[Numbers] | None, level: float,
) -> tuple[np.ndarray, str | None, str | None]:  # fmt: skip
    """Stick fractions with the ends of their band, NaN if not known, (3, `number`); their label, and that of the band.

    Raises ValueError for bad input.
    """
    check_level(level)
    given = list(fractions) if isinstance(fractions, (tuple, list)) else []
    distributions = [one for one in given if isinstance(one, Distribution) and one.unit == "1"]
    estimates = [one for one in given if isinstance(one, Estimate) and one.unit == "1"]
    of_numbers = not any(isinstance(one, (Distribution, Estimate)) for one in given)
    if of_numbers:
        checks.numeric("fractions", fractions, ndim=1)
    elif len(given) not in (len(distributions), len(estimates)):
        kinds = "all ensemble.statistics.stick_fraction, or all Estimates such as stick_fraction(ensemble)"
        raise checks.refused("fractions", f"hold stick fractions, either {kinds}, or all numbers", fractions)
    if (length := len(fractions)) != number:
        raise ValueError(f"Argument fractions must have the length {number} of parameter_values, but it has {length}.")
    if not of_numbers and errors is not None:
        demand, hint = "be left out with distributions and estimates", "choose its level instead"
        raise checks.refused("errors", f"{demand}, which have a band of their own", errors, hint)
    if estimates:
        points = [(one.value, *one.interval(level)) for one in estimates]
        return np.array(points).T, "mean", f"{_style.interval_name(level)} of the mean"
    if distributions:
        rest = (1 - level) / 2
        points = [(one.mean.value, one.quantile(rest).value, one.quantile(1 - rest).value) for one in distributions]
        return np.array(points).T, "mean", f"{100 * level:.4g} % of the realisations"
    values = np.asarray(fractions, float)
    if np.any((values < 0) | (values > 1)):
        raise checks.refused("fractions", "hold fractions between 0 and 1", fractions)
    if errors is not None:
        checks.numeric("errors", errors, ndim=None)
    sides = np.asarray(np.full(number, np.nan) if errors is None else errors, float)
    if sides.shape not in ((number,), (2, number)) or np.any(sides < 0):
        raise ValueError(
            f"Argument errors must hold numbers of zero or more, in the shape ({number},) or (2, {number}), but an "
            f"array of shape {sides.shape} with smallest entry {sides.min(initial=np.inf):g} was given."
        )
    below, above = np.broadcast_to(sides, (2, number))
    return np.stack([values, values - below, values + above]), None, None


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
    for axis in (ax.xaxis,) * xlog + (ax.yaxis,) * ylog:
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
    for name, given, is_log in (("x", x, logs[0]), ("y", y, logs[1])):
        checks.numeric(name, given, ndim=1)
        centers = np.asarray(given, float)
        if len(centers) < 2 or np.any(np.diff(centers) <= 0):
            raise checks.refused(name, "hold two or more increasing numbers", given)
        if is_log and centers[0] <= 0:
            demand = "hold positive numbers on a logarithmic axis"
            raise ValueError(f"Argument {name} must {demand}, but {centers[0]:g} is the first.")
    across, up = np.asarray(x, float), np.asarray(y, float)
    array = _style.numbers_or_gaps("values", values, 2)
    if array.shape != (len(across), len(up)):
        shape = f"the shape (len(x), len(y)) = ({len(across)}, {len(up)})"
        raise ValueError(f"Argument values must have {shape}, but an array of shape {array.shape} was given.")
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


def histograms(
    results: "xarray.Dataset", name: str = "duration", *, most: int = 5, log: bool = False, ax: Axes | None = None
) -> Axes:
    """Histograms of a quantity at several values of a parameter, in the bins that all points of a sweep share.

    Args:
        results: The result of `Sweep.run`, along one parameter: select the values of others first,
            ``results.sel(rate=1.0, method="nearest")``.
        name: A quantity whose histogram the sweep has: "duration", "slip_duration", "position", "stick_count".
        most: The largest number of histograms, from the first to the last value of the parameter.
        log: Whether the axis of densities is logarithmic.
        ax: Axes to draw into; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For a Dataset without this histogram, and along none or several parameters.
    """
    most = checks.whole_number("most", most, maximum=len(_style.SERIES))
    checks.truth("log", log)
    names = map(str, getattr(results, "data_vars", ()))
    known = [one.removesuffix("_density") for one in names if one.endswith("_density")]
    if not known:
        raise checks.refused("results", "be the result of Sweep.run, with histograms", results)
    density: Any = results[checks.chosen("name", name, known) + "_density"]
    along = [one for one in density.dims if one != f"{name}_bin"]
    if len(along) != 1:
        hint = "select one of each other, results.sel(rate=1.0, method='nearest')" if along else "leave one unselected"
        raise checks.refused("results", f"vary along one parameter, but it does along {len(along)}", along, hint)
    values, bins = density[along[0]], results[f"{name}_bin"]
    edges = np.append(results[f"{name}_bin_low"].values, results[f"{name}_bin_high"].values[-1])
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    chosen = np.unique(np.linspace(0, len(values) - 1, min(most, len(values))).round().astype(int))
    for color, at in zip(_style.SERIES, chosen, strict=False):
        label = f"{along[0]} = {float(values[at]):.4g} {_style.unit_of(values)}".removesuffix(" 1").rstrip()
        ax.stairs(density.isel({along[0]: at}).values, edges, color=color, lw=1.5, label=label)
    unit = _style.unit_of(bins)
    ax.set_xlabel(_style.label_of(bins))
    ax.set_ylabel("probability" if unit == "1" else _style.density_label(unit))
    if log:
        ax.set_yscale("log")
    ax.legend(fontsize="small")
    return ax


def _is_geometric(values: np.ndarray) -> bool:
    """Whether neighbouring values have the same ratio, and not the same difference."""
    if len(values) < 3 or values.dtype.kind != "f" or np.any(values <= 0):
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) < 1e-6 * np.abs(ratios).max() and np.ptp(steps) > 1e-6 * np.abs(steps).max())
