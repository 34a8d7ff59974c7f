"""How estimates converge as the number of samples grows."""

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._statistics.convergence import Convergence, HistogramConvergence
from .._statistics.estimate import DEFAULT_LEVEL, check_level
from . import _parts, _style
from ._legends import legend_above

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
        raise ValueError(
            f"Argument result must be a Convergence or a HistogramConvergence, but {_checks.show(result)} was given; "
            "give the result of convergence or of histogram_convergence."
        )
    check_level(level)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    ax.set_xscale("log")
    if isinstance(result, Convergence):
        _draw_estimates(ax, result, level)
    else:
        _draw_distances(ax, result)
    if ax.has_data():
        for axis in (ax.xaxis, ax.yaxis)[: 1 if isinstance(result, Convergence) else 2]:
            _style.log_axis(axis)
    legend_above(ax, columns=1)
    return ax


def _draw_estimates(ax: Axes, result: Convergence, level: float) -> None:
    ax.set_xlabel("number of samples")
    ax.set_ylabel(_parts.quantity_label(result.name, result.unit))
    known = np.isfinite(result.values)
    if not np.any(known):
        _parts.note(ax, f"not defined in {result.numbers[-1]:,} samples")
        return
    numbers, values = result.numbers[known], result.values[known]
    low, high = (ends[known] for ends in result.band(level))
    ax.axhline(result.final.value, color=_style.MASS, lw=_style.SLIP_WIDTH, ls="--",
               label=f"from all {result.final.samples:,} samples: {_parts.with_error(result.final)}")  # fmt: skip
    ax.fill_between(numbers, low, high, color=_style.SERIES[0], alpha=0.25, lw=0, label=_parts.interval_name(level))
    ax.plot(
        numbers, values, color=_style.SERIES[0], lw=_style.SLIP_WIDTH, marker="o", ms=3, label="from the first samples"
    )
    resolved = np.isfinite(low) & (numbers >= min(_FEWEST, numbers[-1]))
    shown = np.concatenate([values, low[resolved], high[resolved], [result.final.value]])
    margin = 0.05 * np.ptp(shown) or 0.05 * abs(shown[0]) or 0.05
    ax.set_ylim(shown.min() - margin, shown.max() + margin)


def _draw_distances(ax: Axes, result: HistogramConvergence) -> None:
    ax.set_yscale("log")
    ax.set_xlabel("number of samples of each of the two histograms")
    ax.set_ylabel("distance of the histograms\n(total variation)")
    known = np.isfinite(result.distances) & (result.distances > 0)
    if not np.any(known):
        _parts.note(ax, "no distance is known")
        return
    numbers, distances = result.numbers[known], result.distances[known]
    fitted = f", slope {result.slope:.2f}" if np.isfinite(result.slope) else ""
    label = f"distance in {result.cells:,} cells with pairs{fitted}"
    ax.plot(numbers, distances, color=_style.SERIES[0], lw=_style.SLIP_WIDTH, marker="o", ms=4, label=label)
    # The line begins at a distance of 1, the largest that there is.
    ends = np.array([max(numbers[0], numbers[-1] * distances[-1] ** 2), numbers[-1]])
    line = distances[-1] * np.sqrt(numbers[-1] / ends)
    ax.plot(ends, line, color=_style.MASS, lw=_style.SLIP_WIDTH, ls="--", label="slope -1/2 through the last")
