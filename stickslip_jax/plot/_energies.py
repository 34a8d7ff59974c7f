"""Energies against time: what is stored, supplied and dissipated."""

import numpy as np
from matplotlib.axes import Axes

from .._simulation.result import Simulation
from . import _style
from ._trajectory import check_simulation, check_window
from ._types import SeveralAxes, Window

_POINTS = 2000


def energies(
    result: Simulation,
    *,
    window: Window | None = None,
    axes: SeveralAxes | None = None,
) -> tuple[Axes, Axes]:
    """Draw the stored energies, and what was supplied and dissipated since the start, against time; sticks are shaded.

    Energies that are zero all the time, such as the damping of a system without a damper, are left out.

    Args:
        result: A result of `simulate`, one trajectory that reached ``t1``, whose `Simulation.energies` are known.
        window: First and last time to draw, s; all of ``[0, t1]`` by default.
        axes: Two, for the stored energies and for those supplied and dissipated; by default those of a new figure, one
            below the other.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind, for a simulation that did not reach ``t1``, and as
            `Simulation.energies`.
    """
    check_simulation(result)
    begin, end = window = check_window(window, float(result.t1))
    upper, lower = _style.axes_below_or_new(axes, ("stored", "supplied and dissipated"), (6.4, 5.2))
    mask = np.asarray(result.sticks.mask)
    starts, ends = (np.asarray(times)[mask] for times in (result.sticks.start, result.sticks.end))
    inside = (ends > begin) & (starts < end)
    events = np.concatenate([starts[inside], ends[inside]])
    times = np.union1d(np.linspace(begin, end, _POINTS), np.clip(events, begin, end))
    found = result.energies(times)
    for number, (name, values) in enumerate(found.stored.items()):
        upper.plot(times, values, color=_style.SERIES[number], lw=_style.SLIP_WIDTH, label=name)
    total = np.sum([np.asarray(values) for values in found.stored.values()], axis=0)
    upper.plot(times, total, color=_style.MASS, lw=_style.SLIP_WIDTH, ls="--", label="sum")
    kinds = {"supplied by": (found.supplied, "-"), "dissipated by": (found.dissipated, "--")}
    number = 0
    for words, (terms, style) in kinds.items():
        for name, values in terms.items():
            if np.any(np.asarray(values) != 0):
                color = _style.SERIES[number % len(_style.SERIES)]
                lower.plot(times, values, color=color, ls=style, lw=1.5 * _style.SLIP_WIDTH, label=f"{words} {name}")
                number += 1
    upper.set_ylabel("stored energy (J)")
    lower.set_ylabel("energy since the start (J)")
    for panel in (upper, lower):
        for first, last in zip(starts[inside], ends[inside], strict=True):
            panel.axvspan(max(first, begin), min(last, end), color=_style.STICK, alpha=0.25, lw=0, label="stick")
        _style.time_axis(panel, window)
        _style.legend_above(panel, columns=4)
    return upper, lower
