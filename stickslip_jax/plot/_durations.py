"""How long sticks last."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from .._ensemble.result import Ensemble
from .._simulation.result import Simulation
from .._statistics.first_sticks import FirstSticks
from . import _style
from ._sticks import complete_sticks, edges_of_bins


def stick_durations(
    result: Ensemble | FirstSticks | Simulation,
    ax: Axes | None = None,
    *,
    bins: Any = 50,
) -> Axes:
    """Draw the histogram of stick durations, pooled over all samples, as a probability density.

    Sticks cut by the horizon are left out, because only a part of them was seen; the legend tells how many. So are
    samples that did not reach ``t1``.

    - `result`: an `Ensemble`, for the sticks that it kept (with ``keep="statistics"`` those of the first samples), its
      `FirstSticks`, or a `Simulation` (one, or a batch by ``vmap``).
    - `ax`: where to draw; by default the axes of a new figure.
    - `bins`: number of equal bins from 0 to the longest duration, or their increasing edges, s. Sticks outside the
      edges are drawn nowhere but count: the density times the bin width stays the share of all complete sticks.

    Returns the axes, with a note in them if there is no complete stick. Raises ValueError for an ensemble that kept
    only totals, and for anything else than the above.
    """
    sticks = complete_sticks(result)
    durations, label = sticks.duration, sticks.label
    edges = edges_of_bins("bins", bins, (0.0, durations.max(initial=0) or 1.0), "s")
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    ax.set_xlabel("stick duration (s)")
    ax.set_ylabel("probability density (1/s)")
    if len(durations) == 0:
        ax.text(0.5, 0.5, label, ha="center", va="center", transform=ax.transAxes)
        return ax
    counts, _ = np.histogram(durations, edges)
    if counts.sum() < len(durations):
        label += f"\n{len(durations) - counts.sum():,} of them outside the bins"
    density = counts / (len(durations) * np.diff(edges))
    ax.stairs(density, edges, fill=True, color=_style.STICK, alpha=0.35, lw=0)
    ax.stairs(density, edges, color=_style.STICK, lw=_style.SLIP_WIDTH, label=label)
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylim(bottom=0)
    _style.legend_above(ax, columns=1)
    return ax
