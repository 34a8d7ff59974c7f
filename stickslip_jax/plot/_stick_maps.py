"""The durations of sticks against the positions at which they begin."""

from matplotlib.axes import Axes

from .._systems.system import System
from . import _style
from ._legends import legend_above
from ._stick_positions import finish, placed_sticks
from ._types import SimulatedSticks, Voltage

_MANY = 2000  # points: more are smaller and paler


def stick_map(
    result: SimulatedSticks,
    *,
    system: System | None = None,
    bound: Voltage | None = None,
    period: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the duration of each complete stick against the position at which it begins, a point for each.

    For a `MotorCart` and first sticks this is Lima and Sampaio (2022), figures 4 and 5, left. Sticks cut by the horizon
    are left out, because only a part of them was seen; the legend gives their number. So are samples that did not reach
    ``t1``.

    Args:
        result: An `Ensemble` (the sticks that it kept; with ``keep="statistics"`` those of the first samples); the
            first stick of each sample, ``first_stick(ensemble)``; or a `Simulation` (one, or a batch by ``vmap``).
        system: What was simulated. It must be given with ``first_stick(ensemble)``, which does not know it:
            ``ensemble.system``.
        bound: The voltage whose closed-form `stick_duration_bound` to draw (``ensemble.law``, say), for a `MotorCart`;
            by default none. The current's transient when a stick begins can prolong it by about the electrical time
            constant, inductance over resistance.
        period: Angles are drawn modulo this, pi or 2 pi, rad; by default 2 pi. The sticks of a `MotorCart` repeat
            themselves after pi.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes, with a note in them if there is no complete stick.

    Raises:
        ValueError: For an ensemble with ``keep="totals"``, and for arguments of another kind.
    """
    sticks = placed_sticks(result, system, bound, period)
    ax = _style.axes_or_new(ax, (5.6, 4.0))
    if len(sticks.duration):
        many = len(sticks.duration) > _MANY
        size, alpha = (3, 0.35) if many else (9, 0.6)
        ax.scatter(sticks.position, sticks.duration, s=size, alpha=alpha, lw=0, color=_style.STICK, rasterized=many)
        ax.plot([], [], ls="none", marker="o", ms=4, mew=0, color=_style.STICK, label=sticks.label)
    finish(ax, sticks)
    legend_above(ax, columns=1)
    return ax
