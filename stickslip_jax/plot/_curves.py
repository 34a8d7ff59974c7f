"""Any statistic against a parameter, and the longest possible stick."""

import dataclasses
import sys
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, TypeAlias, TypeGuard, get_args
from weakref import WeakKeyDictionary

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from .._foundation import checks
from .._statistics.distribution import Distribution
from .._statistics.estimate import DEFAULT_LEVEL, Estimate, check_level
from .._systems.motor_cart import MotorCart, stick_duration_bound
from .._systems.system import unphased
from . import _style
from ._style import LabeledData, Numbers, Voltage, legend_above

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
    if xlog:
        ax.set_xscale("log")
    elif np.all(places == np.round(places)):
        _style.whole_numbers(ax.xaxis)
    if ylog:
        ax.set_yscale("log")
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


# The longest possible stick of a motor against the angle at which it stops.


_POINTS = 1441  # every quarter of a degree
_LONG = 20  # letters: three columns of longer labels are wider than the axes


def stick_bounds(
    system: MotorCart, voltage: Voltage, *, mu: Sequence[float] | np.ndarray | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the longest possible duration of a stick of a `MotorCart` against its angle, a curve for each `mu`.

    This is Lima and Sampaio (2022), figure 3; see `stick_duration_bound`. A curve is interrupted where the bound is
    infinite; the legend gives the share of such angles, and says so where no angle allows a stick.

    Args:
        system: A `MotorCart`.
        voltage: A `SourceVoltage`, or a `RandomPhase` of one, which has the same bound.
        mu: Friction coefficients in place of that of `system`, zero or positive.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind.
    """
    signal: Any = unphased(voltage)
    stick_duration_bound(system, signal, 0.0)  # refuses arguments of another kind
    if mu is None and system.friction is not None:
        systems = {type(system.friction).__name__: system}
    else:
        given = np.atleast_1d(np.asarray(system.mu if mu is None else mu, float))
        checks.numeric("mu", given, ndim=1)
        systems = {rf"$\mu$ = {one:g}": dataclasses.replace(system, mu=float(one), friction=None) for one in given}
    ax = _style.axes_or_new(ax, (5.6, 4.0))
    period = system.coordinates[0].period
    assert period is not None
    angles = np.linspace(0, period, _POINTS)
    for name, one in systems.items():
        longest = np.asarray(stick_duration_bound(one, signal, angles), float)
        endless = np.isinf(longest)
        none = not np.any(longest > 0)
        label = f"{name}, no limit at {100 * endless.mean():.0f} % of the angles" if endless.any() else name
        look = _style.next_look(ax, angles)
        if none:  # a curve that is zero throughout lies on the axis, below the ends of the others
            label, look = f"{label}: no stick", look | {"lw": 2.5 * _style.SLIP_WIDTH, "zorder": 3, "clip_on": False}
        ax.plot(angles, np.where(endless, np.nan, longest), label=label, **look)
    _style.angle_axis(ax, period)
    ax.set_xlabel(system.coordinates[0].labeled(" of the stick"))
    ax.set_ylabel(_style.quantity_label("longest possible stick duration", "s"))
    ax.autoscale(axis="y")  # to all curves that have been drawn, also in axes that share this one's scale
    ax.set_ylim(bottom=0)
    longest_label = max(map(len, ax.get_legend_handles_labels()[1]))
    legend_above(ax, columns=2 if longest_label > _LONG else 3)
    return ax
