"""How long sticks last."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._status import Ending, Status
from ..ensemble_result import Ensemble
from ..simulate import Simulation
from . import _style


def stick_durations(
    result: Ensemble | Simulation,
    ax: Axes | None = None,
    *,
    bins: Any = 50,
) -> Axes:
    """Draw the histogram of stick durations, pooled over all samples, as a probability density.

    Sticks cut by the horizon are left out, because only a part of them was seen; the legend tells how many. So are
    samples that did not reach ``t1``.

    - `result`: an `Ensemble` that kept its sticks (``keep="sticks"``), or a `Simulation` (one, or a batch by ``vmap``).
    - `ax`: where to draw; by default the axes of a new figure.
    - `bins`: number of equal bins from 0 to the longest duration, or their increasing edges, s. Sticks outside the
      edges are drawn nowhere but count: the density times the bin width stays the share of all complete sticks.

    Returns the axes, with a note in them if there is no complete stick. Raises ValueError for an ensemble that kept
    only statistics, and for anything else than the above.
    """
    durations, censored = _complete_durations(result)
    edges = _edges(bins, durations)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    ax.set_xlabel("stick duration (s)")
    ax.set_ylabel("probability density (1/s)")
    label = f"{len(durations):,} sticks" + (f" ({censored:,} more, cut by the horizon, left out)" if censored else "")
    if len(durations) == 0:
        ax.text(0.5, 0.5, label.replace("0 sticks", "no sticks", 1), ha="center", va="center", transform=ax.transAxes)
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


def _complete_durations(result: Any) -> tuple[np.ndarray, int]:
    """Durations (s) of the sticks that were seen to their end, in finished samples; how many the horizon cut."""
    if isinstance(result, Ensemble):
        sticks, totals = result.require_sticks(), result.totals
        assert totals is not None
        used = np.repeat(totals.status == Status.FINISHED, sticks.count)
        ending, duration = sticks.ending, sticks.end - sticks.start
    elif isinstance(result, Simulation):
        if any(_checks.is_traced(leaf) for leaf in (result.sticks.mask, result.status)):
            raise ValueError("Argument result must hold numbers, but one traced by a JAX transformation was given.")
        finished = np.asarray(result.status) == Status.FINISHED
        used = np.asarray(result.sticks.mask) & finished[..., None]
        ending, duration = np.asarray(result.sticks.ending), np.asarray(result.sticks.duration)
    else:
        raise ValueError(
            f"Argument result must be a result of simulate_ensemble or of simulate, but {result!r} was given."
        )
    cut = ending == Ending.HORIZON
    return duration[used & ~cut], int(np.sum(used & cut))


def _edges(bins: Any, durations: np.ndarray) -> np.ndarray:
    """Edges of the bins, s."""
    if np.ndim(bins) == 0:
        number = _checks.whole_number("bins", bins)
        return np.linspace(0, durations.max(initial=0) or 1, number + 1)
    _checks.numeric("bins", bins, ndim=1)
    edges = np.asarray(bins, float)
    if len(edges) < 2 or np.any(np.diff(edges) <= 0):
        raise ValueError(f"Argument bins must be a whole number or increasing edges (in s), but {bins!r} was given.")
    return edges
