"""Derivatives of stick statistics: against a parameter, and side by side."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._sensitivity.estimate import Sensitivity
from . import _style

_INTERVAL = 1.96  # standard errors: 95 % of a normal distribution


def sensitivity_curve(results: Any, ax: Axes | None = None, *, pathwise: bool = True) -> Axes:
    """Draw derivatives of one statistic against the parameter's value, with 95 % bands.

    - `results`: several `Sensitivity` of the same statistic and parameter, at different values of it, in any order.
    - `ax`: where to draw; by default the axes of a new figure.
    - `pathwise`: whether to draw beside them the pathwise part alone, which leaves out sticks born and lost.

    Returns the axes. Raises ValueError for anything else, and where statistics or parameters differ.
    """
    points = _checked_curve(results)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    values = np.array([point.parameter_value for point in points])
    order = np.argsort(values, kind="stable")
    derivatives, errors, paths = (
        np.array([getattr(point, name) for point in points])[order]
        for name in ("derivative", "standard_error", "pathwise")
    )
    values, relative_bandwidth = values[order], _INTERVAL * errors
    color = _style.SERIES[0]
    ax.fill_between(
        values,
        derivatives - relative_bandwidth,
        derivatives + relative_bandwidth,
        color=color,
        alpha=0.25,
        lw=0,
        label="95 % band",
    )
    ax.plot(values, derivatives, color=color, lw=_style.SLIP_WIDTH, marker="o", ms=3.5, label="corrected")
    if pathwise and np.any(np.isfinite(paths)):
        ax.plot(values, paths, color=_style.SERIES[4], lw=_style.SLIP_WIDTH, ls="--", label="pathwise part alone")
    ax.axhline(0, color="0.8", lw=0.8, zorder=0)
    first = points[0]
    ax.set_xlabel(first.parameter)
    ax.set_ylabel(_title(first))
    _style.legend_above(ax)
    return ax


def tornado(results: Any, ax: Axes | None = None) -> Axes:
    """Draw sensitivities of one statistic to several parameters as bars, the largest on top, with 95 % intervals.

    - `results`: what `sensitivity` returned for several parameters, best with ``elasticity=True``, so that they can be
      compared; or several `Sensitivity` of one statistic.
    - `ax`: where to draw; by default the axes of a new figure.

    Returns the axes. Raises ValueError for anything else.
    """
    bars = _several(list(results.values()) if isinstance(results, Mapping) else results)
    ax = _style.axes_or_new(ax, (5.6, 0.45 * len(bars) + 1.4))
    bars = sorted(bars, key=lambda bar: abs(bar.derivative))
    heights = np.arange(len(bars))
    sizes = np.array([bar.derivative for bar in bars])
    errors = np.array([_INTERVAL * bar.standard_error for bar in bars])
    colors = [_style.SERIES[0] if size >= 0 else _style.SERIES[4] for size in sizes]
    ax.barh(heights, sizes, xerr=errors, color=colors, height=0.62, capsize=2.5, ecolor="black")
    ax.axvline(0, color="black", lw=0.8)
    ax.set_yticks(heights, [bar.parameter for bar in bars])
    ax.set_xlabel(_title(bars[0]))
    return ax


def _several(results: Any) -> list[Sensitivity]:
    found = list(results) if isinstance(results, Sequence) and not isinstance(results, str) else []
    if not found or not all(isinstance(one, Sensitivity) for one in found):
        raise ValueError(
            f"Argument results must hold one or more Sensitivity results, but {_checks.show(results)} was given."
        )
    if len({(one.statistic, one.is_elasticity) for one in found}) > 1:
        raise ValueError("Argument results must be of one statistic, and all elasticities or none, but they differ.")
    return found


def _checked_curve(results: Any) -> list[Sensitivity]:
    points = _several(results)
    if len({point.parameter for point in points}) > 1:
        raise ValueError(
            "Argument results must be of one parameter, but those of "
            f"{', '.join(sorted({point.parameter for point in points}))} were given."
        )
    return points


def _title(one: Sensitivity) -> str:
    if one.is_elasticity:
        return f"elasticity of the\n{one.statistic}"
    unit = "" if one.unit == "1" else f"\n({one.unit} by the parameter's unit)"
    return f"derivative of the\n{one.statistic}{unit}"
