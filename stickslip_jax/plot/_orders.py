"""The mean of a quantity over the first sticks of all samples, over their second sticks, and so on."""

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._ensemble.result import Ensemble
from .._statistics.estimate import DEFAULT_LEVEL, check_level
from .._statistics.quantities import SLIP_QUANTITIES, STICK_QUANTITIES
from . import _parts, _style
from ._legends import legend_above
from ._sticks import require_ensemble

_BOTTOM = 0.3  # of the height of the axes, for the shares


def means_by_order(
    result: Ensemble, quantity: str = "duration", *, level: float = DEFAULT_LEVEL, ax: Axes | None = None
) -> Axes:
    """Draw the mean over the samples of the i-th stick's duration, start or position, or of a slip's, against i.

    Each mean is over the samples that have an i-th one, with its confidence interval. Where not all samples have one,
    gray bars at the bottom show the share of those that do, on the axis at the right. Orders that no sample has are
    left out.

    Args:
        result: An `Ensemble` with ``keep="statistics"`` or ``"sticks"``.
        quantity: "duration" (s), "start" (s) or "position" (m; of a motor its angle, rad) of the stick; "slip_duration"
            or "slip_start" (s) of the slip, from the retained samples.
        level: Of the confidence intervals, by Student's t. There are none from a single sample.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if there are no sticks.

    Raises:
        ValueError: For an ensemble with ``keep="totals"``, and for arguments of another kind.
    """
    require_ensemble(result)
    of_slips = [one.name for one in SLIP_QUANTITIES]
    names = [*(one.name for one in STICK_QUANTITIES), *of_slips]
    if not (isinstance(quantity, str) and quantity in names):
        raise ValueError(
            f"Argument quantity must be one of {', '.join(map(repr, names))}, but {_checks.show(quantity)} was given."
        )
    check_level(level)
    body = "slip" if quantity in of_slips else "stick"
    statistics = result.statistics.slips if body == "slip" else result.statistics
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    orders = [statistics.order(number) for number in range(1, result.statistics.orders + 1)]
    present = [order for order in orders if order.share.value > 0]
    name = quantity.removeprefix("slip_")
    ax.set_xlabel(f"order $i$ of the {body} in its sample")
    ax.set_ylabel(_parts.quantity_label(f"mean {name} of the $i$-th {body}", getattr(statistics, name).unit))
    if not present:
        _parts.note(ax, f"no {body}s")
        return ax
    numbers = np.array([order.number for order in present])
    means = [order.distributions[quantity].mean for order in present]
    values = np.array([mean.value for mean in means])
    low, high = np.array([mean.interval(level) for mean in means]).T
    label = f"mean; bars: {_parts.interval_name(level)}"
    look = {"color": _style.STICK if body == "stick" else _style.MASS, "lw": _style.SLIP_WIDTH}
    known = np.isfinite(low)
    if np.any(known):
        errors = (values - low)[known], (high - values)[known]
        ax.errorbar(numbers[known], values[known], errors, ls="none", marker="o", ms=4, capsize=3, label=label, **look)
    else:
        label = "mean (no interval from one sample)"
    ax.plot(numbers, values, ls="none", marker="o", ms=4, label="_mean" if np.any(known) else label, **look)
    _parts.whole_numbers(ax.xaxis)
    ax.set_xlim(numbers[0] - 0.5, numbers[-1] + 0.5)
    shares = np.array([order.share.value for order in present])
    others = () if np.all(shares == 1) else (_draw_shares(ax, numbers, shares, body),)
    legend_above(ax, *others, columns=2)
    return ax


def _draw_shares(ax: Axes, numbers: np.ndarray, shares: np.ndarray, body: str) -> Axes:
    """Bars at the bottom, below all that `ax` shows so far, on axes of their own, which are returned."""
    low, high = ax.get_ylim()
    ax.set_yticks([tick for tick in ax.get_yticks() if low <= tick <= high])
    ax.set_ylim(high - (high - low) / (1 - _BOTTOM), high)
    below = ax.twinx()
    below.bar(numbers, 100 * shares, width=0.8, color=_style.FORWARD, alpha=0.5, lw=0, label="share of samples")
    below.set_ylim(0, 100 / (_BOTTOM - 0.06))
    below.set_yticks([0, 50, 100])
    below.set_ylabel(f"samples that have an $i$-th {body} (%)", loc="bottom", fontsize="small")
    return below
