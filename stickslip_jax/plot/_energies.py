"""Energies against time: what is stored, supplied and dissipated."""

import numpy as np
from matplotlib.axes import Axes

from .._excitation.ground import GroundMotion
from .._simulation.result import Simulation
from . import _style
from ._legends import legend_above
from ._trajectory import check_simulation
from ._types import SeveralAxes, Window
from ._windows import phases_in

_POINTS = 2000
_SUPPLIED, _DISSIPATED = ("-", "-."), ("--", ":", (0, (3, 1, 1, 1, 1, 1)))


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
        window: First and last time to draw, s; by default as in `time_history`.
        axes: Two, for the stored energies and for those supplied and dissipated; by default those of a new figure, one
            below the other.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind, for a simulation that did not reach ``t1``, and as
            `Simulation.energies`.
    """
    check_simulation(result)
    _, (begin, end) = phases_in(result, window)
    upper, lower = _style.axes_below_or_new(axes, ("stored", "supplied and dissipated"), (6.4, 5.2))
    mask = np.asarray(result.sticks.mask)
    starts, ends = (np.asarray(times)[mask] for times in (result.sticks.start, result.sticks.end))
    inside = (ends > begin) & (starts < end)
    events = np.concatenate([starts[inside], ends[inside]])
    times = np.union1d(np.linspace(begin, end, _POINTS), np.clip(events, begin, end))
    found = result.energies(times)
    for number, (name, values) in enumerate(found.stored.items()):
        look = {"color": _style.SERIES[number], "ls": ("-", "-.")[number % 2], "lw": _style.SLIP_WIDTH}
        upper.plot(times, values, label=name, **look)
    total = np.sum([np.asarray(values) for values in found.stored.values()], axis=0)
    upper.plot(times, total, color=_style.MASS, lw=_style.SLIP_WIDTH, ls="--", label="sum")
    kinds = {"supplied by": (found.supplied, _SUPPLIED), "dissipated by": (found.dissipated, _DISSIPATED)}
    number = 0
    for words, (terms, styles) in kinds.items():
        left = iter(styles)
        for name, values in terms.items():
            if np.any(np.asarray(values) != 0):
                look = {"color": _style.SERIES[number], "ls": next(left), "lw": 1.5 * _style.SLIP_WIDTH}
                lower.plot(times, values, label=f"{words} {_load(result) if name == 'load' else name}", **look)
                number += 1
    upper.set_ylabel("stored energy (J)")
    lower.set_ylabel("energy since the start (J)")
    for panel in (upper, lower):
        for first, last in zip(starts[inside], ends[inside], strict=True):
            panel.axvspan(max(first, begin), min(last, end), color=_style.STICK, alpha=0.25, lw=0, label="stick")
        _style.time_axis(panel, (begin, end), float(result.t1) if window is None else None)
        legend_above(panel, columns=4)
    return upper, lower


def _load(one: Simulation) -> str:
    """What the load consists of: an external force, the inertia of a mass on moving ground, or both."""
    parts = ["force"] if getattr(one.system, "force", None) is not None else []
    if isinstance(one.base, GroundMotion):
        parts.append("ground motion")
    return " and ".join(parts) or "load"
