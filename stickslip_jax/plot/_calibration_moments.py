"""Moments of sticks as they were observed, and as a fitted model has them."""

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._calibration.stick_result import StickCalibration
from .._statistics.estimate import DEFAULT_LEVEL
from . import _parts, _style
from ._legends import legend_above
from ._sensitivities import width_of


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
        raise _checks.refused("result", "be what calibrate_sticks returned", result)
    width, several = width_of(level), len(result.systems) > 1
    fits = result.moments[::-1]
    ax = _style.axes_or_new(ax, (6.4, 0.45 * len(fits) + 1.6))
    fitted, misfit = np.array([(float(one.fitted), one.observed.value - one.fitted.value) for one in fits]).T
    scale = 100 / np.where(fitted == 0, 1, np.abs(fitted))
    errors = np.array([one.error for one in fits])
    heights = np.arange(len(fits))
    ax.errorbar(
        misfit * scale, heights, xerr=width * errors * scale, fmt="o", ms=4.5, capsize=2.5, color=_style.SERIES[0],
        label=f"observed, {_parts.interval_name(level)}",
    )  # fmt: skip
    ax.axvline(0, color="black", lw=0.8, label="fitted")
    names = [(f"experiment {one.experiment}: " if several else "") + one.observed.name for one in fits]
    ax.set_yticks(heights, names)
    ax.set_ylim(-0.6, len(fits) - 0.4)
    ax.set_xlabel("observed less fitted (% of fitted)")
    legend_above(ax, columns=2)
    return ax
