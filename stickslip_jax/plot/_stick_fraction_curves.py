"""The stick fraction against a parameter."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._statistics.distribution import Distribution
from .._statistics.estimate import DEFAULT_LEVEL, Estimate, check_level
from . import _parts, _style
from ._legends import legend_above
from ._types import Numbers

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
    values = _checked_values(parameter_values, xlabel)
    curve = _curve(fractions, len(values), errors, level)
    for name, text in (("xlabel", xlabel), ("label", label), ("band_label", band_label)):
        _checks.text(name, text, or_none=True)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    color, style = _style.free_look(ax)
    order = np.argsort(values, kind="stable")
    values, mean, low, high = (column[order] for column in (values, *100 * curve.points))
    if np.any(np.isfinite(low)):
        band_label = curve.band_label if band_label is None else band_label
        ax.fill_between(values, low, high, color=color, alpha=0.25, lw=0, label=band_label)
    known = np.isfinite(mean)
    label = curve.label if label is None else label
    marker = _style.marker_of(values)
    look = {"color": color, "ls": style, "lw": _style.SLIP_WIDTH, "marker": marker, "ms": 3.5}
    ax.plot(values[known], mean[known], label=label, **look)
    ax.set_xlabel(_FREQUENCY_RATIO if xlabel is None else xlabel)
    ax.set_ylabel("stick fraction $T_s$ (%)")
    legend_above(ax, columns=2, lines_first=True)
    return ax


class _Curve(NamedTuple):
    """Stick fractions with the ends of their band, NaN if not known, (3, points); and their default labels."""

    points: np.ndarray
    label: str | None = None
    band_label: str | None = None


def _checked_values(values: Numbers, xlabel: str | None) -> np.ndarray:
    """The parameter's values as an array."""
    _checks.numeric("parameter_values", values, ndim=1)
    array = np.asarray(values, float)
    if len(array) == 0:
        raise ValueError("Argument parameter_values must hold one or more numbers, but it holds none.")
    if xlabel is None and np.any(array <= 0):
        raise ValueError(
            f"Argument parameter_values must hold positive frequency ratios, but {_checks.show(values)} was given; "
            "xlabel names another parameter."
        )
    return array


def _curve(
    fractions: Sequence[Distribution] | Sequence[Estimate] | Numbers,
    number: int,
    errors: Numbers | Sequence[Numbers] | None,
    level: float,
) -> _Curve:
    """The points of the curve, one for each of `number` values of the parameter. Raises ValueError for bad input."""
    check_level(level)
    given = list(fractions) if isinstance(fractions, (tuple, list)) else []
    distributions = [one for one in given if isinstance(one, Distribution) and one.unit == "1"]
    estimates = [one for one in given if isinstance(one, Estimate) and one.unit == "1"]
    if not any(isinstance(one, (Distribution, Estimate)) for one in given):
        return _curve_of_numbers(fractions, number, errors)
    if len(given) not in (len(distributions), len(estimates)):
        raise ValueError(
            "Argument fractions must hold stick fractions, either all ensemble.statistics.stick_fraction, or all "
            "Estimates such as stick_fraction(ensemble), or all numbers, but "
            f"{_checks.show(fractions)} was given."
        )
    _check_length(len(given), number)
    if errors is not None:
        raise ValueError(
            "Argument errors must be left out with distributions and estimates, which have a band of their own, but "
            f"{_checks.show(errors)} was given; choose its level instead."
        )
    if estimates:
        points = [(one.value, *one.interval(level)) for one in estimates]
        name = f"{_parts.interval_name(level)} of the mean"
    else:
        rest = (1 - level) / 2
        points = [(one.mean.value, one.quantile(rest).value, one.quantile(1 - rest).value) for one in distributions]
        name = f"{100 * level:.4g} % of the realisations"
    return _Curve(np.array(points).T, "mean", name)


def _curve_of_numbers(fractions: object, number: int, errors: Numbers | Sequence[Numbers] | None) -> _Curve:
    _checks.numeric("fractions", fractions, ndim=1)
    values = np.asarray(fractions, float)
    _check_length(len(values), number)
    if np.any((values < 0) | (values > 1)):
        raise ValueError(
            f"Argument fractions must hold fractions between 0 and 1, but {_checks.show(fractions)} was given."
        )
    if errors is None:
        return _Curve(np.stack([values, *np.full((2, number), np.nan)]))
    _checks.numeric("errors", errors, ndim=None)
    sides = np.asarray(errors, float)
    if sides.shape not in ((number,), (2, number)) or np.any(sides < 0):
        raise ValueError(
            f"Argument errors must hold numbers of zero or more, in the shape ({number},) or (2, {number}), but an "
            f"array of shape {sides.shape} with smallest entry {sides.min(initial=np.inf):g} was given."
        )
    below, above = np.broadcast_to(sides, (2, number))
    return _Curve(np.stack([values, values - below, values + above]))


def _check_length(length: int, number: int) -> None:
    if length != number:
        raise ValueError(f"Argument fractions must have the length {number} of parameter_values, but it has {length}.")
