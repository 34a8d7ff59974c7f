"""Share of time spent sticking, against the frequency of the base."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from . import _style


def stick_share(
    ratios: Any,
    shares: Any,
    errors: Any = None,
    ax: Axes | None = None,
    *,
    label: str | None = None,
    errors_label: str | None = None,
) -> Axes:
    """Draw the share of time spent sticking against ``r = f_b / (omega / 2 pi)``.

    As in Lima and Sampaio (conference paper), figure 6 (square wave, one steady period) and, with `errors`, figure 7
    (random steps, mean and interval). Call it again with the same `ax` to compare.

    - `ratios`: r, dimensionless and positive, (points,), in any order.
    - `shares`: fractions in [0, 1], (points,); they are drawn in percent.
    - `errors`: how far a band reaches below and above the share, fractions: (points,), or (2, points) with the lower
      side first. By default no band.
    - `ax`: where to draw; by default the axes of a new figure.
    - `label`, `errors_label`: what to call line and band in the legend; there is none without them.

    Returns the axes. Raises ValueError for arrays of other shapes and numbers outside these bounds.
    """
    ratios, shares, errors = _checked(ratios, shares, errors)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    color = _style.SERIES[len(ax.lines) % len(_style.SERIES)]
    order = np.argsort(ratios, kind="stable")
    if errors is not None:
        low, high = shares - errors[0], shares + errors[1]
        ax.fill_between(
            ratios[order], 100 * low[order], 100 * high[order], color=color, alpha=0.25, lw=0, label=errors_label
        )
    marker = "o" if len(ratios) <= 60 else None
    ax.plot(ratios[order], 100 * shares[order], color=color, lw=_style.SLIP_WIDTH, marker=marker, ms=3.5, label=label)
    ax.set_xlabel(r"frequency ratio $r = f_\mathrm{b}\,/\,(\omega/2\pi)$ (dimensionless)")
    ax.set_ylabel("stick share of the time (%)")
    if ax.get_legend_handles_labels()[1]:
        _style.legend_above(ax, columns=2)
    return ax


def _checked(ratios: Any, shares: Any, errors: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """The arguments as float arrays, `errors` with shape (2, points)."""
    _checks.numeric("ratios", ratios, ndim=1)
    _checks.numeric("shares", shares, ndim=1)
    ratios, shares = np.asarray(ratios, float), np.asarray(shares, float)
    if len(ratios) == 0 or np.any(ratios <= 0):
        raise ValueError(f"Argument ratios must hold one or more positive numbers, but {ratios} was given.")
    if shares.shape != ratios.shape:
        raise ValueError(f"Argument shares must have the length {len(ratios)} of ratios, but it has {len(shares)}.")
    if np.any((shares < 0) | (shares > 1)):
        raise ValueError(f"Argument shares must hold fractions between 0 and 1, but {shares} was given.")
    if errors is None:
        return ratios, shares, None
    _checks.numeric("errors", errors, ndim=None)
    errors = np.asarray(errors, float)
    if errors.shape not in ((len(ratios),), (2, len(ratios))) or np.any(errors < 0):
        raise ValueError(
            f"Argument errors must hold numbers of zero or more, in the shape ({len(ratios)},) or (2, {len(ratios)}), "
            f"but an array of shape {errors.shape} with smallest entry {errors.min(initial=np.inf):g} was given."
        )
    return ratios, shares, np.broadcast_to(errors, (2, len(ratios)))
