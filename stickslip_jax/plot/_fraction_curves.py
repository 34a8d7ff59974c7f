"""The stick fraction of random base motions against a parameter."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._statistics.distribution import Distribution
from .._statistics.estimate import Estimate, check_level
from . import _style


def stick_fraction_curve(
    parameter_values: Any,
    fractions: Sequence[Distribution] | Sequence[Estimate],
    ax: Axes | None = None,
    *,
    level: float = 0.9,
    xlabel: str = r"frequency ratio $r = f_\mathrm{b}\,/\,(\omega/2\pi)$ (dimensionless)",
    label: str = "mean",
) -> Axes:
    """Draw the mean stick fraction T_s of ensembles against the parameter in which they differ, with a band.

    As in Lima and Sampaio (conference paper), figure 7, from distributions. `stick_share` draws shares that are known
    as numbers, such as those of one steady period. Call it again with the same `ax` to compare.

    - `parameter_values`: of each ensemble, (points,), in any order.
    - `fractions`: one for each value. ``ensemble.statistics.stick_fraction``: the band holds the share `level` of the
      realisations, between two quantiles. Or an `Estimate`, such as ``stick_fraction(ensemble)``: the band is the
      confidence interval of the mean, which shrinks as samples are added.
    - `ax`: where to draw; by default the axes of a new figure.
    - `level`: of the band.
    - `xlabel`: the parameter and its unit; by default the frequency ratio of that paper. `label`: of the line in the
      legend.

    Returns the axes. Points without a finished sample are left out, and so is the band of estimates from one sample.
    Raises ValueError for arguments of other kinds and lengths.
    """
    values = _checked(parameter_values, fractions, xlabel, label)
    check_level(level)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    color = _style.SERIES[len(ax.lines) % len(_style.SERIES)]
    order = np.argsort(values, kind="stable")
    points = np.array([_mean_and_band(fractions[index], level) for index in order])
    values, mean, low, high = values[order], *100 * points.T
    if np.any(np.isfinite(low)):
        ax.fill_between(values, low, high, color=color, alpha=0.25, lw=0, label=_name_of_band(fractions[0], level))
    known = np.isfinite(mean)
    marker = "o" if len(values) <= 60 else None
    ax.plot(values[known], mean[known], color=color, lw=_style.SLIP_WIDTH, marker=marker, ms=3.5, label=label)
    ax.set_xlabel(xlabel)
    ax.set_ylabel("stick fraction $T_s$ (%)")
    _style.legend_above(ax, columns=2)
    return ax


def _mean_and_band(fraction: Distribution | Estimate, level: float) -> tuple[float, float, float]:
    if isinstance(fraction, Estimate):
        return fraction.value, *fraction.interval(level)
    rest = (1 - level) / 2
    return fraction.mean.value, fraction.quantile(rest).value, fraction.quantile(1 - rest).value


def _name_of_band(fraction: Distribution | Estimate, level: float) -> str:
    if isinstance(fraction, Estimate):
        return f"{100 * level:.4g} % confidence interval of the mean"
    return f"{100 * level:.4g} % of the realisations"


def _checked(values: Any, fractions: Any, xlabel: Any, label: Any) -> np.ndarray:
    """The parameter's values as an array."""
    _checks.numeric("parameter_values", values, ndim=1)
    values = np.asarray(values, float)
    if len(values) == 0:
        raise ValueError("Argument parameter_values must hold one or more numbers, but it holds none.")
    given = list(fractions) if isinstance(fractions, (tuple, list)) else []
    kinds = {kind for kind in (Distribution, Estimate) for one in given if isinstance(one, kind)}
    if len(kinds) != 1 or not all(isinstance(one, (Distribution, Estimate)) and one.unit == "1" for one in given):
        raise ValueError(
            "Argument fractions must hold stick fractions, either all ensemble.statistics.stick_fraction or all "
            f"Estimates such as stick_fraction(ensemble), but {_checks.show(fractions)} was given."
        )
    if len(given) != len(values):
        raise ValueError(
            f"Argument fractions must have the length {len(values)} of parameter_values, but it has {len(given)}."
        )
    for name, text in (("xlabel", xlabel), ("label", label)):
        if not isinstance(text, str):
            raise ValueError(f"Argument {name} must be a string, but {_checks.show(text)} was given.")
    return values
