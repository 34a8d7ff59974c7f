"""Any statistic against a parameter."""

from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias, get_args
from weakref import WeakKeyDictionary

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from .. import _checks
from .._statistics.estimate import DEFAULT_LEVEL, Estimate, check_level
from . import _parts, _style
from ._labeled import Labeled, is_labeled, labeled
from ._legends import legend_above
from ._types import LabeledData, Numbers

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
    _check_options(level, uncertainty, xlog, ylog, {"xlabel": xlabel, "ylabel": ylabel, "label": label})
    if is_labeled(x):
        curves = _of_labeled(labeled(x, y, errors, (1, 2), along), level, label)
    else:
        curves = _of_numbers(x, y, errors, level, label)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    ax.set_xlabel(_name("xlabel", xlabel, None if ax.get_xlabel() else curves.xlabel, ax.get_xlabel()))
    ax.set_ylabel(_name("ylabel", ylabel, _ylabel(ax, curves.ylabel), ax.get_ylabel()))
    _draw_all(ax, curves, uncertainty, level, (xlog, ylog))
    return ax


_QUANTITIES: WeakKeyDictionary[Line2D, str] = WeakKeyDictionary()
"""What the curves that have been drawn show, with units."""


def _quantities(ax: Axes) -> list[str]:
    """What the curves in `ax` show, each once."""
    return list(dict.fromkeys(_QUANTITIES[line] for line in ax.lines if line in _QUANTITIES))


def _ylabel(ax: Axes, known: str | None) -> str | None:
    """The name of the ordinate with another curve, of the `known` quantity; None for the name that there is."""
    before, there = _quantities(ax), ax.get_ylabel()
    if known is None or (there and there != _parts.wrapped(",\n".join(before))):
        return None
    return ",\n".join(dict.fromkeys([*before, known]))


class _Curve(NamedTuple):
    """Values with the ends of their intervals, NaN where not known, (points,) each."""

    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    label: str | None


class _Curves(NamedTuple):
    """Curves over the same `x`, (points,) and increasing, and the names of the axes where they are known."""

    x: np.ndarray
    curves: list[_Curve]
    xlabel: str | None = None
    ylabel: str | None = None


def _check_options(level: float | None, uncertainty: str, xlog: bool, ylog: bool, texts: dict[str, str | None]) -> None:
    if level is not None:
        check_level(level)
    if uncertainty not in get_args(Uncertainty):
        raise ValueError(f'Argument uncertainty must be "bars" or "band", but {_checks.show(uncertainty)} was given.')
    _checks.truth("xlog", xlog)
    _checks.truth("ylog", ylog)
    for name, text in texts.items():
        _checks.text(name, text, or_none=True)


def _of_labeled(data: Labeled, level: float | None, label: str | None) -> _Curves:
    """One curve of a labelled array with one dimension, or one for each index of its second."""
    values = data.values.reshape(len(data.coordinates[0]), -1)
    low, high = (ends.reshape(values.shape) for ends in _ends(data.values, data.errors, level))
    labels = [label]
    if data.values.ndim == 2:
        name, unit = data.axis_labels[1].removesuffix(f" ({data.units[1]})"), _parts.unit_after(data.units[1])
        own = [f"{name} = {value:.4g}{unit}" for value in data.coordinates[1]]
        labels = own if label is None else [f"{label}, {text}" for text in own]
    columns = zip(values.T, low.T, high.T, labels, strict=True)
    curves = [_Curve(one, its_low, its_high, text) for one, its_low, its_high, text in columns]
    return _Curves(data.coordinates[0], curves, data.axis_labels[0], data.label)


def _of_numbers(x: object, y: object, errors: object, level: float | None, label: str | None) -> _Curves:
    _checks.numeric("x", x, ndim=1)
    places = np.asarray(x, float)
    order = np.argsort(places, kind="stable")
    estimates = list(y) if isinstance(y, (list, tuple)) and any(isinstance(one, Estimate) for one in y) else []
    if not estimates:
        values, name = _parts.numbers_or_gaps("y", y, 1), None
        low, high = _ends(values, errors, level)
    else:
        name = _name_of(estimates)
        if errors is not None:
            raise ValueError(
                f"Argument errors must be left out with estimates, but {_checks.show(errors)} was given; estimates "
                "have their own."
            )
        values = np.array([one.value for one in estimates], float)
        ends = [_interval(one, level) for one in estimates]
        low, high = np.array(ends, float).reshape(-1, 2).T
    if len(values) != len(places):
        raise ValueError(f"Argument y must have the length {len(places)} of x, but it has {len(values)}.")
    return _Curves(places[order], [_Curve(values[order], low[order], high[order], label)], ylabel=name)


def _name_of(estimates: list[Estimate]) -> str | None:
    """The name and unit of all estimates; None if they have several names."""
    if not all(isinstance(one, Estimate) for one in estimates):
        raise ValueError(f"Argument y must hold estimates or numbers only, but {_checks.show(estimates)} was given.")
    units, names = {one.unit for one in estimates}, {one.name for one in estimates}
    if len(units) > 1:
        raise ValueError(f"Argument y must hold estimates of one unit, but {', '.join(sorted(units))} were given.")
    return _parts.quantity_label(*names, *units) if len(names) == 1 else None


def _interval(one: Estimate, level: float | None) -> tuple[float, float]:
    if level is not None:
        return one.interval(level)
    return one.value - one.standard_error, one.value + one.standard_error


def _ends(values: np.ndarray, errors: object, level: float | None) -> tuple[np.ndarray, np.ndarray]:
    """The ends of the intervals about `values`, NaN without errors."""
    if errors is None:
        return np.full(values.shape, np.nan), np.full(values.shape, np.nan)
    sides = _parts.checked_errors(errors, values)
    if level is not None:
        from scipy import special  # noqa: PLC0415 - adds a filter of warnings

        sides = sides * special.ndtri((1 + level) / 2)
    return values - sides, values + sides


def _name(argument: str, given: str | None, known: str | None, before: str) -> str:
    """The name of an axis: what is given, else what is known, else what it has already."""
    name = given or known or before
    if not name:
        raise ValueError(
            f"Argument {argument} must be given, the name of the axis with its unit, because what is drawn does not "
            "say it."
        )
    return _parts.wrapped(name)


def _draw_all(
    ax: Axes, curves: _Curves, uncertainty: Uncertainty, level: float | None, logs: tuple[bool, bool]
) -> None:
    """Draw the curves, and set the scales and the legend."""
    xlog, ylog = logs
    if xlog and np.any(curves.x <= 0):
        raise ValueError(
            f"Argument x must hold positive numbers on a logarithmic axis, but {_checks.show(curves.x)} was given."
        )
    if xlog:
        ax.set_xscale("log")
    elif np.all(curves.x == np.round(curves.x)):
        _parts.whole_numbers(ax.xaxis)
    if ylog:
        ax.set_yscale("log")
    drawn = [_draw(ax, curves.x, one, uncertainty, ylog, curves.ylabel) for one in curves.curves]
    if len(_quantities(ax)) > 1:
        for line in ax.lines:
            if line in _QUANTITIES and str(line.get_label()).startswith("_"):
                line.set_label(_QUANTITIES[line])
    if not any(drawn) and not any(np.size(line.get_xdata(orig=False)) for line in ax.lines):
        _parts.note(ax, "no values")
    for axis in (ax.xaxis,) * xlog + (ax.yaxis,) * ylog:
        _style.log_axis(axis)
    if any(np.any(np.isfinite(one.low)) for one in curves.curves):
        _explain(ax, uncertainty, level)
    legend_above(ax, columns=2)


def _draw(ax: Axes, x: np.ndarray, one: _Curve, uncertainty: Uncertainty, ylog: bool, quantity: str | None) -> bool:
    """Draw a curve with its uncertainty; whether there was anything to draw."""
    values, low, high, label = one
    left_out = ylog & (values <= 0)
    if np.any(left_out):
        values = np.where(left_out, np.nan, values)
        lost = f"{_parts.counted(int(left_out.sum()), 'value')} of zero or less left out"
        label = lost if label is None else f"{label} ({lost})"
    if ylog and uncertainty == "band":
        low = np.where(low <= 0, values * 1e-12, low)
    if not np.any(np.isfinite(values)):
        return False
    color, style = _style.free_look(ax)
    known = np.isfinite(low) & np.isfinite(values)
    if np.any(known) and uncertainty == "band":
        limits = ax.dataLim.frozen()
        ax.fill_between(x, low, high, where=known, color=color, alpha=0.25, lw=0)
        if ylog:  # the axis need not reach down to where the band ends for want of a logarithm
            ax.dataLim.set(limits)
            ax.update_datalim(np.column_stack([x, np.where(low > 1e-6 * values, low, values)])[known])
            ax.update_datalim(np.column_stack([x, high])[known])
    elif np.any(known):
        sides = np.stack([values - low, high - values])[:, known]
        ax.errorbar(x[known], values[known], sides, ls="none", ecolor=color, elinewidth=1.0, capsize=2.0)
    look = {"color": color, "ls": style, "lw": _style.SLIP_WIDTH, "marker": _style.marker_of(x), "ms": 3.5}
    (line,) = ax.plot(x, values, label=label, **look)
    if quantity is not None:
        _QUANTITIES[line] = quantity
    return True


def _explain(ax: Axes, uncertainty: Uncertainty, level: float | None) -> None:
    """Say at the end of the legend what bars or bands are."""
    text = "one standard error" if level is None else _parts.interval_name(level)
    text, marker = f"{uncertainty}: {text}", "|" if uncertainty == "bars" else "s"
    for line in list(ax.lines):
        if line.get_label() == text:
            line.remove()
    ax.plot([], [], ls="none", marker=marker, ms=9, color=_style.FORWARD, mew=1.5, label=text)
