"""When the sticks of many realisations happen."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from .. import _checks
from .._ensemble.result import Ensemble
from . import _parts, _style

_HEIGHT = 0.8  # of a bar, in rows
_MANY = 2000  # bars: more are kept as an image in vector formats


def stick_raster(
    source: Ensemble, ax: Axes | None = None, *, samples: int = 100, t0: float = 0.0, t1: float | None = None
) -> Axes:
    """Draw each stick of the first realisations as a bar, time across, realisation down.

    Of the realisations that finished, numbered from 0; sticks cut by the horizon end there.

    - `source`: an `Ensemble` with ``keep="statistics"`` or ``"sticks"``.
    - `ax`: where to draw; by default the axes of a new figure.
    - `samples`: how many realisations to draw, at most.
    - `t0`, `t1`: the window of time, s, ``0 <= t0 < t1``; by default all of ``[0, t1]`` of the ensemble.

    Returns the axes, with a note in them if there is no stick in the window. Raises ValueError for an ensemble that
    kept only totals, and for anything else than the above.
    """
    _parts.require("source", source, Ensemble, "the result of simulate_ensemble")
    _checks.whole_number("samples", samples)
    window = _window(t0, t1, source.t1)
    every = source.finished_sticks()
    sticks = every.head(min(samples, len(every.count)))
    rows = len(sticks.count)
    shown = (sticks.end > window[0]) & (sticks.start < window[1])
    ax = _style.axes_or_new(ax, (6.4, 4.4))
    number = int(np.count_nonzero(shown))
    if number:
        row = sticks.sample[shown]
        corners = _parts.rectangles(sticks.start[shown], sticks.end[shown], row - _HEIGHT / 2, row + _HEIGHT / 2)
        label = f"{_parts.counted(number, 'stick')} in {rows:,} of {_parts.counted(source.samples, 'realisation')}"
        ax.add_collection(
            PolyCollection(corners, facecolor=_style.STICK, lw=0, rasterized=number > _MANY, label=label), autolim=False
        )
    else:
        _parts.note(ax, "no sticks")
    ax.set_xlim(*window)
    ax.set_ylim(max(rows, 1) - 0.5, -0.5)
    _parts.whole_numbers(ax.yaxis)
    ax.set_xlabel("time $t$ (s)")
    ax.set_ylabel("realisation" if source.finished == source.samples else "realisation (of those that finished)")
    if number:
        _style.legend_above(ax, columns=1)
    return ax


def _window(t0: Any, t1: Any, end: float) -> tuple[float, float]:
    """The window, checked; `end`: of the simulation."""
    last = end if t1 is None else t1
    _checks.numeric("t0", t0)
    _checks.numeric("t1", last)
    if not 0 <= t0 < last <= end:
        raise ValueError(
            f"Arguments t0 and t1 must be times (in s) with 0 <= t0 < t1 <= {end:g}, but {t0} and {last} were given."
        )
    return float(t0), float(last)
