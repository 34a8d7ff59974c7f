"""When the sticks of many realisations happen."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from .. import _checks
from .._ensemble.result import Ensemble
from .._simulation.result import Simulation
from . import _parts, _style
from ._contacts import contact_raster
from ._legends import legend_above
from ._sticks import require_ensemble
from ._trajectory import check_simulation, check_window
from ._types import Window

_HEIGHT = 0.8  # of a bar, in rows
_MANY = 2000  # bars: more are drawn as an image in vector formats


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
        return contact_raster(result, window, ax)
    require_ensemble(result)
    assert isinstance(result, Ensemble)
    _checks.whole_number("samples", samples)
    begin, end = check_window(window, result.t1)
    every = result.finished_sticks()
    sticks = every.head(min(samples, len(every.count)))
    rows = len(sticks.count)
    shown = (sticks.end > begin) & (sticks.start < end)
    ax = _style.axes_or_new(ax, (6.4, 4.4))
    number = int(np.count_nonzero(shown))
    if number:
        row = sticks.sample[shown]
        corners = _parts.rectangles(sticks.start[shown], sticks.end[shown], row - _HEIGHT / 2, row + _HEIGHT / 2)
        label = f"{_parts.counted(number, 'stick')} in {rows:,} of {_parts.counted(result.samples, 'realisation')}"
        ax.add_collection(
            PolyCollection(corners, facecolor=_style.STICK, lw=0, rasterized=number > _MANY, label=label), autolim=False
        )
    else:
        _parts.note(ax, "no sticks")
    ax.set_xlim(begin, end)
    ax.set_ylim(max(rows, 1) - 0.5, -0.5)
    _parts.whole_numbers(ax.yaxis)
    ax.set_xlabel("time $t$ (s)")
    ax.set_ylabel("realisation" if result.finished == result.samples else "realisation (of those that finished)")
    legend_above(ax, columns=1)
    return ax
