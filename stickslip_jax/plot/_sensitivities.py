"""Derivatives of stick statistics, Sobol' indices, and calibrations."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from .._calibration.call import Calibration
from .._calibration.sticks import StickCalibration
from .._foundation import checks
from .._sensitivity.estimate import Sensitivity
from .._statistics.estimate import DEFAULT_LEVEL
from .._statistics.sobol_indices import SobolIndices
from . import _style
from ._style import SeveralAxes, Window, legend_above
from ._trajectory import check_window

# Derivatives of stick statistics: over a parameter, and several parameters compared.


def sensitivity_curve(
    results: Sequence[Sensitivity], *, pathwise: bool = True, level: float = DEFAULT_LEVEL, ax: Axes | None = None
) -> Axes:
    """Draw the derivative of one statistic against the value of the parameter, with a band of confidence.

    Args:
        results: Results of `sensitivity` for one statistic and one parameter at different values, in any order. They
            know the value of the parameter.
        pathwise: Whether to draw the pathwise part alone, too, which leaves out sticks that appear and vanish.
        level: Of the confidence intervals that make the band, by the normal distribution.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind, and if statistics or parameters differ.
    """
    points, width = _checked(results), _style.errors_in_half(level)
    parameters = {point.parameter for point in points}
    if len(parameters) > 1:
        given = ", ".join(sorted(parameters))
        raise ValueError(f"Argument results must be of one parameter, but those of {given} were given.")
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    points.sort(key=lambda point: point.parameter_value)
    values, derivatives, errors, paths = (
        np.array([getattr(point, name) for point in points])
        for name in ("parameter_value", "derivative", "standard_error", "pathwise")
    )
    color, sides = _style.SERIES[0], width * errors
    _style.shade_between(ax, values, derivatives - sides, derivatives + sides, color, _style.interval_name(level))
    ax.plot(values, derivatives, color=color, lw=_style.SLIP_WIDTH, marker="o", ms=3.5, label="corrected")
    if pathwise and np.any(np.isfinite(paths)):
        ax.plot(values, paths, color=_style.SERIES[4], lw=_style.SLIP_WIDTH, ls="--", label="pathwise part alone")
    ax.axhline(0, color="0.8", lw=0.8, zorder=0)
    ax.set(xlabel=points[0].parameter, ylabel=_title(points[0]))
    legend_above(ax)
    return ax


def tornado(
    results: Mapping[str, Sensitivity] | Sequence[Sensitivity], *, level: float = DEFAULT_LEVEL, ax: Axes | None = None
) -> Axes:
    """Draw the sensitivities of one statistic to several parameters as bars, the largest on top.

    Blue bars point to the right: the statistic grows with the parameter. Orange ones, to the left: it shrinks.

    Args:
        results: Of `sensitivity` for one statistic and several parameters, best with ``elasticity=True``, so that the
            parameters can be compared; or several such results for one parameter each.
        level: Of the confidence intervals that are drawn as error bars, by the normal distribution.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind, and if statistics differ.
    """
    bars = _checked(list(results.values()) if isinstance(results, Mapping) else results)
    width = _style.errors_in_half(level)
    ax = _style.axes_or_new(ax, (5.6, 0.45 * len(bars) + 2.0))
    bars = sorted(bars, key=lambda bar: abs(bar.derivative))
    heights = np.arange(len(bars))
    sizes = np.array([bar.derivative for bar in bars])
    errors = np.array([width * bar.standard_error for bar in bars])
    shown = {"height": 0.62, "ecolor": _style.MASS, "capsize": 2.5}
    for chosen, color, label in (
        (~(sizes < 0), _style.SERIES[0], "grows with the parameter"),
        (sizes < 0, _style.SERIES[4], "shrinks with it"),
    ):
        if np.any(chosen):
            ax.barh(heights[chosen], sizes[chosen], xerr=errors[chosen], color=color, label=label, **shown)
    if np.any(np.isfinite(errors)):
        ax.plot([], [], ls="none", marker="_", ms=12, color=_style.MASS, label=f"bars: {_style.interval_name(level)}")
    ax.axvline(0, color="black", lw=0.8)
    ax.set_yticks(heights, [bar.parameter for bar in bars])
    ax.set_xlabel(_title(bars[0]))
    legend_above(ax, columns=2)
    return ax


def sobol_indices(result: SobolIndices, *, output: str | None = None, ax: Axes | None = None) -> Axes:
    """Draw the first-order and total Sobol' indices of each factor as bars with intervals, the largest total on top.

    What the total bar has beyond the first-order one is due to interactions with other factors.

    Args:
        result: Of `stickslip_jax.sobol_indices`.
        output: The name of the output to draw; by default the first.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind.
    """
    if not isinstance(result, SobolIndices):
        raise checks.refused("result", "be a result of sobol_indices", result)
    if output is not None:
        checks.chosen("output", output, list(result.outputs))
    of: Any = (..., result.outputs.index(output) if output else 0) if result.outputs else ...
    ax = _style.axes_or_new(ax, (5.6, 0.6 * len(result.factors) + 1.6))
    order = np.argsort(result.total[of])
    for place, (name, color) in enumerate((("total", _style.BAND), ("first", _style.SERIES[0]))):
        values, ends = getattr(result, name)[of][order], getattr(result, f"{name}_interval")[of][:, order]
        sides = np.maximum([values - ends[0], ends[1] - values], 0)
        look = {"xerr": sides, "ecolor": _style.MASS, "capsize": 2.5, "color": color}
        at, label = np.arange(len(order)) + 0.38 * (place - 0.5), {"first": "first order"}.get(name, name)
        ax.barh(at, values, 0.36, label=label, **look)
    ax.plot([], [], ls="none", marker="_", ms=12, color=_style.MASS, label=f"{100 * result.level:g} % interval")
    ax.axvline(0, color="black", lw=0.8)
    ax.set_yticks(range(len(order)), [result.factors[at] for at in order])
    ax.set_xlabel("Sobol' index" + (f" of {output or result.outputs[0]}" if result.outputs else ""))
    legend_above(ax)
    return ax


def _checked(results: Sequence[Sensitivity]) -> list[Sensitivity]:
    """`results` as a list. Raises ValueError unless they are sensitivities of one statistic."""
    found = list(results) if isinstance(results, Sequence) and not isinstance(results, str) else []
    if not found or not all(isinstance(one, Sensitivity) for one in found):
        raise checks.refused("results", "hold one or more Sensitivity results", results)
    if len({(one.statistic, one.is_elasticity) for one in found}) > 1:
        raise ValueError(
            "Argument results must be of one statistic, and all elasticities or all derivatives, but they differ."
        )
    return found


def _title(one: Sensitivity) -> str:
    if one.is_elasticity:
        return f"elasticity of the\n{one.statistic}\n(% per % of the parameter)"
    unit = "" if one.unit == "1" else f"\n({one.unit} per unit of the parameter)"
    return f"derivative of the\n{one.statistic}{unit}"


# Moments of sticks as they were observed, and as a fitted model has them.


def calibration_moments(result: StickCalibration, *, level: float = DEFAULT_LEVEL, ax: Axes | None = None) -> Axes:
    """Draw how far the observed moments are from those of the fitted model, in percent of these, with error bars.

    Args:
        result: Of `calibrate_sticks`. The first moment of the first experiment is on top.
        level: Of the intervals, by the normal distribution: the bars hold the errors of recordings and simulations.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind.
    """
    if not isinstance(result, StickCalibration):
        raise checks.refused("result", "be what calibrate_sticks returned", result)
    width, several = _style.errors_in_half(level), len(result.systems) > 1
    fits = result.moments[::-1]
    ax = _style.axes_or_new(ax, (6.4, 0.45 * len(fits) + 1.6))
    fitted, misfit = np.array([(float(one.fitted), one.observed.value - one.fitted.value) for one in fits]).T
    scale = 100 / np.where(fitted == 0, 1, np.abs(fitted))
    errors = np.array([one.error for one in fits])
    heights = np.arange(len(fits))
    ax.errorbar(
        misfit * scale, heights, xerr=width * errors * scale, fmt="o", ms=4.5, capsize=2.5, color=_style.SERIES[0],
        label=f"observed, {_style.interval_name(level)}",
    )  # fmt: skip
    ax.axvline(0, color="black", lw=0.8, label="fitted")
    names = [(f"experiment {one.experiment}: " if several else "") + one.observed.name for one in fits]
    ax.set_yticks(heights, names)
    ax.set(xlabel="observed less fitted (% of fitted)", ylim=(-0.6, len(fits) - 0.4))
    legend_above(ax, columns=2)
    return ax


# A calibration: what was measured, what was fitted, and what is left.


_FEW = 400  # points: of more, the marks are small


def calibration(
    result: Calibration, *, channel: str | None = None, window: Window | None = None, axes: SeveralAxes | None = None
) -> tuple[Axes, Axes]:
    """Draw one channel of a record with the motion fitted to it, and below it the residuals.

    Where several windows were fitted, each is a line of its own. The residuals are in units of the noise; about 95 % of
    them should lie in the shaded band, without any pattern.

    Args:
        result: Of `calibrate`.
        channel: Its name; by default the first.
        window: First and last time to draw, s; by default all of the record.
        axes: Two, for the motion and for the residuals; by default those of a new figure, one below the other.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind.
    """
    if not isinstance(result, Calibration):
        raise checks.refused("result", "be a Calibration, the result of calibrate", result)
    names = list(result.channels)
    row = 0 if channel is None else names.index(checks.chosen("channel", channel, names))
    shown = check_window(window, float(result.times[-1]))
    upper, lower = _style.axes_below_or_new(axes, ("motion", "residuals"), (6.4, 4.8))
    inside = (result.times >= shown[0]) & (result.times <= shown[1]) & np.isfinite(result.measured[row])
    times, measured, fitted = result.times[inside], result.measured[row, inside], result.fitted[row, inside]
    size = 3 if len(times) <= _FEW else 1.2
    upper.plot(times, measured, ".", ms=size, color=_style.FORWARD, label="measured")
    for part in np.split(np.arange(len(times)), np.searchsorted(times, result.start_times[1:])):
        upper.plot(times[part], fitted[part], lw=_style.SLIP_WIDTH, color=_style.BASE, label="fitted")
    upper.set_ylabel(_style.quantity_label(names[row], result.units[row] or "1"))
    lower.axhspan(-1.96, 1.96, color=_style.BAND, alpha=0.25, lw=0, label="95 % of white noise")
    lower.plot(times, (measured - fitted) / result.noise[names[row]], ".", ms=size, color=_style.MASS)
    lower.set_ylabel("residual over noise")
    for ax in (upper, lower):
        _style.time_axis(ax, shown)
        legend_above(ax, columns=3)
    return upper, lower
