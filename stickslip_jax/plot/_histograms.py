"""The distribution of one quantity."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.patches import StepPatch

from .. import _checks
from .._statistics.distribution import DEFAULT_BINS, Distribution
from .._statistics.estimate import Estimate
from . import _parts, _style
from ._legends import legend_above
from ._sticks import complete_sticks, edges_of_bins, outside
from ._types import Bins, SimulatedSticks


def histogram(
    result: Distribution | SimulatedSticks,
    *,
    bins: Bins | None = None,
    label: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the histogram of one quantity, or of the durations of complete sticks, as a probability density.

    Call it again with the same `ax` to compare: each histogram has a colour of its own, and all fit into the axes.

    The height is a probability density, 1/unit; of whole numbers it is the probability of each number, averaged over
    the numbers of a bin where these share one.

    Args:
        result: A distribution, such as ``ensemble.statistics.duration`` or ``.order(2).start``. Its histogram is drawn
            over all samples, with bars of one standard error and the mean; sticks and slips cut by the horizon are
            included with the part seen. From a single sample there is no standard error.

            Or the sticks themselves: an `Ensemble` (the sticks that it kept; with ``keep="statistics"`` those of the
            first samples), ``first_stick(ensemble)``, or a `Simulation` (one, or a batch by ``vmap``). The durations of
            complete sticks are drawn; the legend gives the number of those cut by the horizon, which are left out. So
            are samples that did not reach ``t1``.
        bins: Of a distribution, the largest number of bins, which have equal width and hold all values; by default 50,
            of whole numbers one for each number, centred on it. Of sticks, the number of equal bins from 0 to the
            longest duration, by default 50, or their increasing edges, s. Sticks outside the edges are not drawn but
            count: density times bin width stays the share of all complete sticks.
        label: What is drawn, before the number of values in the legend.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if there is nothing to draw.

    Raises:
        ValueError: For an ensemble with ``keep="totals"``, for edges given with a distribution, and for arguments of
            another kind.
    """
    bars = _bars_of_distribution(result, bins) if isinstance(result, Distribution) else _bars_of_sticks(result, bins)
    _checks.text("label", label, or_none=True)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    earlier = _outlines(ax)
    _name_axis(ax.xaxis, bars.xlabel, earlier)
    _name_axis(ax.yaxis, bars.ylabel, earlier)
    text = bars.label if label is None else f"{label}: {bars.label}"
    if bars.empty:
        _say_empty(ax, text, earlier)
        return ax
    if bars.is_whole:
        _parts.whole_numbers(ax.xaxis)
    color = _style.free_color(bars.color, [outline.get_edgecolor() for outline in earlier])
    _parts.draw_histogram(ax, bars.edges, bars.heights, bars.errors, color, label=text)
    if bars.mean is not None:
        _draw_mean(ax, bars.mean, color if earlier or label else _style.MASS)
    edges = np.concatenate([outline.get_data()[1] for outline in _outlines(ax)])
    ax.set_xlim(edges.min(), edges.max())
    ax.autoscale(axis="y")
    ax.set_ylim(bottom=0)
    legend_above(ax, columns=1)
    return ax


def _outlines(ax: Axes) -> list[StepPatch]:
    """The outlines of the histograms in `ax`."""
    return [patch for patch in ax.patches if isinstance(patch, StepPatch) and not patch.get_fill()]


def _name_axis(axis: Axis, name: str, earlier: list[StepPatch]) -> None:
    """Name an axis, after the names that it has from `earlier` histograms."""
    before = axis.get_label_text() if earlier else ""
    if name not in before:
        axis.set_label_text(f"{before}, {name}" if before else name)


def _say_empty(ax: Axes, text: str, earlier: list[StepPatch]) -> None:
    """Say that there is nothing to draw: in empty axes, or in the legend where there are others."""
    if not earlier:
        _parts.note(ax, text)
        return
    ax.plot([], [], ls="none", label=text)
    legend_above(ax, columns=1)


class _Bars(NamedTuple):
    """The histogram to draw: `edges` (bins + 1,), `heights` and their `errors` (bins,), NaN where not known."""

    edges: np.ndarray
    heights: np.ndarray
    errors: np.ndarray
    color: str
    xlabel: str
    ylabel: str
    label: str
    empty: bool = False
    is_whole: bool = False
    mean: Estimate | None = None


def _bars_of_distribution(distribution: Distribution, bins: Bins | None) -> _Bars:
    if bins is not None and np.ndim(bins) > 0:
        raise ValueError(
            "Argument bins must be a whole number for a distribution, whose bins were fixed while it was summed, but "
            f"{_checks.show(bins)} was given; edges of your own go with the sticks: histogram(ensemble, bins=edges)."
        )
    drawn = distribution.histogram(None if bins is None else _checks.whole_number("bins", bins))
    samples = _parts.counted(distribution.samples, "sample")
    empty = distribution.number == 0
    label = f"no values in {samples}" if empty else f"{_parts.counted(distribution.number, 'value')} in {samples}"
    if np.any(np.isfinite(drawn.error)):
        label += "; bars: standard error"
    whole = distribution.is_whole
    return _Bars(
        edges=drawn.edges - 0.5 if whole else drawn.edges,
        heights=drawn.density,
        errors=drawn.error,
        color=_parts.color_of(distribution.name),
        xlabel=_parts.quantity_label(distribution.name, distribution.unit),
        ylabel="probability" if whole else _parts.density_label(distribution.unit),
        label=label,
        empty=empty,
        is_whole=whole,
        mean=None if empty else distribution.mean,
    )


def _bars_of_sticks(result: SimulatedSticks, bins: Bins | None) -> _Bars:
    sticks = complete_sticks(result, also=", or a Distribution such as ensemble.statistics.duration")
    number = len(sticks.duration)
    edges = edges_of_bins(
        "bins", DEFAULT_BINS if bins is None else bins, (0.0, sticks.duration.max(initial=0) or 1.0), "s"
    )
    counts, _ = np.histogram(sticks.duration, edges)
    return _Bars(
        edges=edges,
        heights=counts / (max(number, 1) * np.diff(edges)),
        errors=np.full(len(counts), np.nan),
        color=_style.STICK,
        xlabel=_parts.quantity_label("stick duration", "s"),
        ylabel=_parts.density_label("s"),
        label=outside(sticks.label, number - int(counts.sum())),
        empty=number == 0,
    )


def _draw_mean(ax: Axes, mean: Estimate, color: str) -> None:
    """The mean, with its standard error to both sides."""
    label = f"mean {_parts.with_error(mean)}"
    if np.isfinite(mean.standard_error):
        ends = (mean.value - mean.standard_error, mean.value + mean.standard_error)
        ax.axvspan(*ends, color=color, alpha=0.25, lw=0)
        label += " (shaded: ±)"
    ax.axvline(mean.value, color=color, lw=_style.SLIP_WIDTH, ls="--", label=label)
