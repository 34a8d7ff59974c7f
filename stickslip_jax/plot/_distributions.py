"""How one quantity is distributed."""

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._statistics.distribution import Distribution
from . import _parts, _style


def histogram(distribution: Distribution, ax: Axes | None = None, *, bins: int = 50) -> Axes:
    """Draw the histogram of one quantity over all samples, with standard errors and the mean.

    Of every value, those of sticks and slips cut by the horizon included with the part seen. `stick_durations` draws
    the complete sticks of an ensemble that kept them, or of a single simulation, without errors.

    - `distribution`: such as ``ensemble.statistics.duration``, or ``.order(2).start``.
    - `ax`: where to draw; by default the axes of a new figure.
    - `bins`: number of bins of equal width at most, which hold all values. Of whole numbers, each bin is centred on the
      numbers that it holds, and the height is the share of values per whole number; else it is a density, 1/unit.

    Returns the axes, with a note in them if there are no values. From a single sample no errors can be told, and none
    are drawn. Raises ValueError for arguments of another kind.
    """
    _parts.require("distribution", distribution, Distribution, "ensemble.statistics.duration, say")
    _checks.whole_number("bins", bins)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    ax.set_xlabel(_parts.quantity_label(distribution.name, distribution.unit))
    ax.set_ylabel("share per whole number" if distribution.is_whole else _parts.density_label(distribution.unit))
    samples = _parts.counted(distribution.samples, "sample")
    if distribution.number == 0:
        _parts.note(ax, f"no values in {samples}")
        return ax
    drawn = distribution.histogram(bins)
    edges = drawn.edges
    if distribution.is_whole:
        edges = edges - 0.5
        _parts.whole_numbers(ax.xaxis)
    label = f"{_parts.counted(distribution.number, 'value')} in {samples}"
    if np.any(np.isfinite(drawn.error)):
        label += "; bars: standard error"
    _parts.draw_histogram(ax, edges, drawn.density, drawn.error, _parts.color_of(distribution.name), label=label)
    _draw_mean(ax, distribution)
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylim(bottom=0)
    _style.legend_above(ax, columns=1)
    return ax


def _draw_mean(ax: Axes, distribution: Distribution) -> None:
    """The mean, with its standard error to both sides."""
    mean = distribution.mean
    if np.isfinite(mean.standard_error):
        reach = (mean.value - mean.standard_error, mean.value + mean.standard_error)
        ax.axvspan(*reach, color=_style.MASS, alpha=0.25, lw=0)
    ax.axvline(mean.value, color=_style.MASS, lw=_style.SLIP_WIDTH, ls="--", label=f"mean {_parts.told(mean)}")
