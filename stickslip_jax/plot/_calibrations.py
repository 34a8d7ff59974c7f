"""A calibration: what was measured, what was fitted, and what is left."""

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._calibration.result import Calibration
from . import _parts, _style
from ._legends import legend_above
from ._trajectory import check_window
from ._types import SeveralAxes, Window

_FEW = 400  # points: of more, the marks are small


def calibration(
    result: Calibration,
    *,
    channel: str | None = None,
    window: Window | None = None,
    axes: SeveralAxes | None = None,
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
        raise _checks.refused("result", "be a Calibration, the result of calibrate", result)
    names = list(result.channels)
    row = 0 if channel is None else names.index(_checks.chosen("channel", channel, names))
    shown = check_window(window, float(result.times[-1]))
    upper, lower = _style.axes_below_or_new(axes, ("motion", "residuals"), (6.4, 4.8))
    inside = (result.times >= shown[0]) & (result.times <= shown[1]) & np.isfinite(result.measured[row])
    times, measured, fitted = result.times[inside], result.measured[row, inside], result.fitted[row, inside]
    size = 3 if len(times) <= _FEW else 1.2
    upper.plot(times, measured, ".", ms=size, color=_style.FORWARD, label="measured")
    parts = np.split(np.arange(len(times)), np.searchsorted(times, result.start_times[1:]))
    for part in parts:
        upper.plot(times[part], fitted[part], lw=_style.SLIP_WIDTH, color=_style.BASE, label="fitted")
    upper.set_ylabel(_parts.quantity_label(names[row], result.units[row] or "1"))
    lower.axhspan(-1.96, 1.96, color=_style.BAND, alpha=0.25, lw=0, label="95 % of white noise")
    lower.plot(times, (measured - fitted) / result.noise[names[row]], ".", ms=size, color=_style.MASS)
    lower.set_ylabel("residual over noise")
    for ax in (upper, lower):
        _style.time_axis(ax, shown)
        legend_above(ax, columns=3)
    return upper, lower
