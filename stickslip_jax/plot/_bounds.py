"""The longest possible stick of a motor against the angle at which it stops."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._systems.motor_cart import MotorCart, stick_duration_bound
from .._systems.system import unphased
from . import _parts, _style
from ._legends import legend_above
from ._types import Voltage

_POINTS = 1441  # every quarter of a degree
_LONG = 20  # letters: three columns of longer labels are wider than the axes


def stick_bounds(
    system: MotorCart,
    voltage: Voltage,
    *,
    mu: Sequence[float] | np.ndarray | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the longest possible duration of a stick of a `MotorCart` against its angle, a curve for each `mu`.

    This is Lima and Sampaio (2022), figure 3; see `stick_duration_bound`. A curve is interrupted where the bound is
    infinite; the legend gives the share of such angles, and says so where no angle allows a stick.

    Args:
        system: A `MotorCart`.
        voltage: A `SourceVoltage`, or a `RandomPhase` of one, which has the same bound.
        mu: Friction coefficients in place of that of `system`, zero or positive.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind.
    """
    signal: Any = unphased(voltage)
    stick_duration_bound(system, signal, 0.0)  # refuses arguments of another kind
    systems = _by_label(system, mu)
    ax = _style.axes_or_new(ax, (5.6, 4.0))
    period = system.coordinates[0].period
    assert period is not None
    angles = np.linspace(0, period, _POINTS)
    for name, one in systems.items():
        longest = np.asarray(stick_duration_bound(one, signal, angles), float)
        endless = np.isinf(longest)
        color, line = _style.free_look(ax)
        none = not np.any(longest > 0)
        label = f"{name}, no limit at {100 * endless.mean():.0f} % of the angles" if endless.any() else name
        # A curve that is zero throughout lies on the axis, below the ends of the others.
        look: dict[str, Any] = {"lw": (2.5 if none else 1) * _style.SLIP_WIDTH, "zorder": 3 if none else 2}
        label += ": no stick" if none else ""
        ax.plot(angles, np.where(endless, np.nan, longest), color=color, ls=line, label=label, clip_on=not none, **look)
    _style.angle_axis(ax, period)
    ax.set_xlabel(system.coordinates[0].labeled(" of the stick"))
    ax.set_ylabel(_parts.quantity_label("longest possible stick duration", "s"))
    ax.autoscale(axis="y")  # to all curves that have been drawn, also in axes that share this one's scale
    ax.set_ylim(bottom=0)
    longest_label = max(map(len, ax.get_legend_handles_labels()[1]))
    legend_above(ax, columns=2 if longest_label > _LONG else 3)
    return ax


def _by_label(system: MotorCart, mu: Sequence[float] | np.ndarray | None) -> dict[str, MotorCart]:
    """The systems of which to draw the bound, by what legends call them."""
    if mu is None and system.friction is not None:
        return {type(system.friction).__name__: system}
    given = np.atleast_1d(np.asarray(system.mu if mu is None else mu, float))
    _checks.numeric("mu", given, ndim=1)
    return {rf"$\mu$ = {one:g}": dataclasses.replace(system, mu=float(one), friction=None) for one in given}
