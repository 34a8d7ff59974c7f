"""Figures of many samples: when their sticks happen, one stick after the other, and how estimates converge."""

import numpy as np
from matplotlib.axes import Axes

from .._dynamics.simulation import Simulation
from .._ensemble.result import Ensemble
from .._foundation import checks
from .._statistics.estimate import DEFAULT_LEVEL, check_level
from .._statistics.quantities import SLIP_QUANTITIES, STICK_QUANTITIES
from .._statistics.totals import Convergence, HistogramConvergence
from . import _style
from ._style import Window, legend_above
from ._trajectory import check_simulation, check_window, contact_rows

# When the sticks of many realisations happen.


def stick_raster(
    result: Ensemble | Simulation, *, samples: int = 100, window: Window | None = None, ax: Axes | None = None
) -> Axes:
    """Draw each stick of the first realisations as a bar: time to the right, a row for each realisation.

    Rows are the realisations that reached ``t1``, counted from 0 at the top. Sticks cut by the horizon end there.

    Args:
        result: An `Ensemble` with ``keep="statistics"`` or ``"sticks"``. Or a simulation with several contacts: a row
            for each contact, and one for the times in which all closed contacts stick.
        samples: How many realisations to draw, at most.
        window: First and last time to draw, s; all of ``[0, t1]`` by default.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if there is no stick in the window.

    Raises:
        ValueError: For an ensemble with ``keep="totals"``, and for arguments of another kind.
    """
    if isinstance(result, Simulation) and result.sticks.contact is not None:
        check_simulation(result, of_one_contact=False)
        shown = check_window(window, float(result.t1))
        ax = _style.axes_or_new(ax, (6.4, 1.4 + 0.3 * min(result.totals.sticks.shape[-1], 16)))
        contact_rows(ax, result, shown)
        legend_above(ax)
        return ax
    result = require_ensemble(result)
    checks.whole_number("samples", samples)
    begin, end = check_window(window, result.t1)
    every = result.finished_sticks()
    sticks = every.head(min(samples, len(every.count)))
    rows = len(sticks.count)
    shown = (sticks.end > begin) & (sticks.start < end)
    ax = _style.axes_or_new(ax, (6.4, 4.4))
    number = int(np.count_nonzero(shown))
    if number:
        corners = _style.sticks_in_rows(sticks.sample[shown], sticks.start[shown], sticks.end[shown])
        label = f"{_style.counted(number, 'stick')} in {rows:,} of {_style.counted(result.samples, 'realisation')}"
        _style.draw_polygons(ax, corners, facecolor=_style.STICK, rasterized=number > _style.MANY, label=label)
    else:
        _style.note(ax, "no sticks")
    ax.set_xlim(begin, end)
    ax.set_ylim(max(rows, 1) - 0.5, -0.5)
    _style.whole_numbers(ax.yaxis)
    ax.set_xlabel("time $t$ (s)")
    ax.set_ylabel("realisation" if result.finished == result.samples else "realisation (of those that finished)")
    legend_above(ax, columns=1)
    return ax


def require_ensemble(result: Ensemble | Simulation) -> Ensemble:
    """`result` itself. Raises ValueError unless it is an ensemble."""
    if not isinstance(result, Ensemble):
        raise checks.refused("result", "be an Ensemble", result, "give the result of simulate_ensemble")
    return result


# The mean of a quantity over the first sticks of all samples, over their second sticks, and so on.


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
    checks.chosen("quantity", quantity, [*(one.name for one in STICK_QUANTITIES), *of_slips])
    check_level(level)
    body = "slip" if quantity in of_slips else "stick"
    statistics = result.statistics.slips if body == "slip" else result.statistics
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    orders = [statistics.order(number) for number in range(1, result.statistics.orders + 1)]
    present = [order for order in orders if order.share.value > 0]
    name = quantity.removeprefix("slip_")
    ylabel = _style.quantity_label(f"mean {name} of the $i$-th {body}", getattr(statistics, name).unit)
    ax.set(xlabel=f"order $i$ of the {body} in its sample", ylabel=ylabel)
    if not present:
        _style.note(ax, f"no {body}s")
        return ax
    numbers = np.array([order.number for order in present])
    means = [order.distributions[quantity].mean for order in present]
    values = np.array([mean.value for mean in means])
    low, high = np.array([mean.interval(level) for mean in means]).T
    look = {"color": _style.STICK if body == "stick" else _style.MASS, "lw": _style.SLIP_WIDTH, "marker": "o", "ms": 4}
    known, label = np.isfinite(low), "mean (no interval from one sample)"
    if np.any(known):
        errors = (values - low)[known], (high - values)[known]
        named = f"mean; bars: {_style.interval_name(level)}"
        ax.errorbar(numbers[known], values[known], errors, ls="none", capsize=3, label=named, **look)
        label = "_mean"
    ax.plot(numbers, values, ls="none", label=label, **look)
    _style.whole_numbers(ax.xaxis)
    ax.set_xlim(numbers[0] - 0.5, numbers[-1] + 0.5)
    shares, panels = np.array([order.share.value for order in present]), [ax]
    if not np.all(shares == 1):  # bars at the bottom, below all that is shown so far, on axes of their own
        bottom, top = ax.get_ylim()
        ax.set_yticks([tick for tick in ax.get_yticks() if bottom <= tick <= top])
        ax.set_ylim(top - (top - bottom) / (1 - _BOTTOM), top)
        below = ax.twinx()
        below.bar(numbers, 100 * shares, width=0.8, color=_style.FORWARD, alpha=0.5, lw=0, label="share of samples")
        below.set_ylim(0, 100 / (_BOTTOM - 0.06))
        below.set_yticks([0, 50, 100])
        below.set_ylabel(f"samples that have an $i$-th {body} (%)", loc="bottom", fontsize="small")
        panels.append(below)
    legend_above(*panels, columns=2)
    return ax


# How estimates converge as the number of samples grows.


_FEWEST = 10  # samples: intervals from fewer are so wide that the others could not be seen beside them


def convergence(
    result: Convergence | HistogramConvergence, *, level: float = DEFAULT_LEVEL, ax: Axes | None = None
) -> Axes:
    """Draw an estimate, or the distance between two joint histograms, against the number of samples.

    Args:
        result: Of `stickslip_jax.convergence`: the estimate with its confidence interval over a logarithmic axis of the
            number of samples, and a line at the estimate from all samples. Intervals from fewer than 10 samples may
            leave the axes. Or of `stickslip_jax.histogram_convergence`: the total-variation distance between two
            histograms with independent samples, both axes logarithmic, and the slope -1/2 that it approaches once every
            cell holds many pairs; distances of 0 are left out.
        level: Of the confidence intervals, by Student's t.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if no estimate or distance is defined.

    Raises:
        ValueError: For arguments of another kind.
    """
    if not isinstance(result, (Convergence, HistogramConvergence)):
        hint = "give the result of convergence or of histogram_convergence"
        raise checks.refused("result", "be a Convergence or a HistogramConvergence", result, hint)
    check_level(level)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    ax.set_xscale("log")
    look = {"color": _style.SERIES[0], "lw": _style.SLIP_WIDTH, "marker": "o"}
    if isinstance(result, Convergence):
        ax.set(xlabel="number of samples", ylabel=_style.quantity_label(result.name, result.unit))
        known, nothing = np.isfinite(result.values), f"not defined in {result.numbers[-1]:,} samples"
    else:
        ax.set_yscale("log")
        xlabel = "number of samples of each of the two histograms"
        ax.set(xlabel=xlabel, ylabel="distance of the histograms\n(total variation)")
        known, nothing = np.isfinite(result.distances) & (result.distances > 0), "no distance is known"
    numbers = result.numbers[known]
    if not np.any(known):
        _style.note(ax, nothing)
    elif isinstance(result, Convergence):
        values = result.values[known]
        low, high = (ends[known] for ends in result.band(level))
        label = f"from all {result.final.samples:,} samples: {_style.with_error(result.final)}"
        ax.axhline(result.final.value, label=label, **_style.REFERENCE)
        _style.shade_between(ax, numbers, low, high, _style.SERIES[0], _style.interval_name(level))
        ax.plot(numbers, values, ms=3, label="from the first samples", **look)
        resolved = np.isfinite(low) & (numbers >= min(_FEWEST, numbers[-1]))
        shown = np.concatenate([values, low[resolved], high[resolved], [result.final.value]])
        margin = 0.05 * np.ptp(shown) or 0.05 * abs(shown[0]) or 0.05
        ax.set_ylim(shown.min() - margin, shown.max() + margin)
    else:
        distances = result.distances[known]
        fitted = f", slope {result.slope:.2f}" if np.isfinite(result.slope) else ""
        ax.plot(numbers, distances, ms=4, label=f"distance in {result.cells:,} cells with pairs{fitted}", **look)
        # The line begins at a distance of 1, the largest that there is.
        ends = np.array([max(numbers[0], numbers[-1] * distances[-1] ** 2), numbers[-1]])
        line = distances[-1] * np.sqrt(numbers[-1] / ends)
        ax.plot(ends, line, label="slope -1/2 through the last", **_style.REFERENCE)
    if ax.has_data():
        for axis in (ax.xaxis, ax.yaxis)[: 1 if isinstance(result, Convergence) else 2]:
            _style.log_axis(axis)
    legend_above(ax, columns=1)
    return ax
