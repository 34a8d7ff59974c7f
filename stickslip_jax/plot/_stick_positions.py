"""Where complete sticks begin, on the first coordinate of the system, and how long they can last there."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._excitation.smooth import Signal
from .._statistics.first_sticks import FirstSticks
from .._systems.system import System, require_system, unphased
from . import _parts, _style
from ._sticks import complete_sticks
from ._types import SimulatedSticks, Voltage

_BOUND_POINTS = 1441  # of the bound: every quarter of a degree


class PlacedSticks(NamedTuple):
    """Complete sticks to draw over the coordinate at which they begin; arrays (sticks,).

    - `duration`: s. `position`: m; of a motor its angle modulo `period`, rad.
    - `label`: how many there are. `system`: what was simulated.
    - `voltage`: whose bound of durations to draw, or None. `period`: of the angle, or None for a position.
    """

    duration: np.ndarray
    position: np.ndarray
    label: str
    system: System
    voltage: Signal | None
    period: float | None


def placed_sticks(
    result: SimulatedSticks,
    system: System | None,
    bound: Voltage | None,
    period: float | None,
    *,
    also: str = "",
) -> PlacedSticks:
    """The complete sticks of `result`, and what else to draw with them, checked.

    `also`: what else the figure takes, for the message.

    Raises:
        ValueError: For unsuitable arguments.
    """
    sticks = complete_sticks(result, also=also)
    system = _checked_system(system, None if isinstance(result, FirstSticks) else result.system)
    if np.any(np.isnan(sticks.position)):
        raise ValueError(
            "Argument result must hold sticks with positions, but those of these sticks were not measured; draw "
            "histogram(result), their durations."
        )
    whole = system.coordinates[0].period
    voltage: Any = unphased(bound)  # the user's, until it is checked
    if voltage is not None and np.ndim(getattr(system, "mu", 0.0)) > 0:
        raise ValueError(
            "Argument system must be given with the bound, which is that of one MotorCart, but a batch of shape "
            f"{np.shape(getattr(system, 'mu', 0.0))} was simulated."
        )
    if voltage is not None and not (whole and system.longest_stick(voltage, np.zeros(1)) is not None):
        raise ValueError(
            "Argument bound must be a SourceVoltage, or RandomPhase(SourceVoltage(...)), and be given for a MotorCart "
            f"only, but {_checks.show(bound)} was given for a {type(system).__name__}."
        )
    if period is None:
        period = whole
    else:
        _checks.numeric("period", period)
        if not whole or not np.any(np.isclose(period, (whole / 2, whole), rtol=1e-6)):
            raise ValueError(
                "Argument period must be pi or 2 pi (in rad), and be given for a MotorCart only, but "
                f"{_checks.show(period)} was given for a {type(system).__name__}."
            )
    position = sticks.position if period is None else np.mod(sticks.position, period)
    return PlacedSticks(sticks.duration, position, sticks.label, system, voltage, period)


def _checked_system(system: System | None, known: System | None) -> System:
    """`system`, or what the result is `known` to be of."""
    if system is None and known is None:
        raise ValueError(
            "Argument system must be given with FirstSticks, which do not say whether their positions are lengths or "
            "angles: system=ensemble.system."
        )
    if system is None:
        system = known
    require_system(system)
    assert system is not None
    if known is not None and type(known) is not type(system):
        raise ValueError(
            f"Argument system must be the {type(known).__name__} that was simulated, but {_checks.show(system)} was "
            "given."
        )
    return system


def finish(ax: Axes, sticks: PlacedSticks) -> None:
    """Draw the bound, name the axes and set their limits; with a note where there are no sticks."""
    if sticks.voltage is not None:
        _draw_bound(ax, sticks)
    if len(sticks.duration) == 0:
        _parts.note(ax, sticks.label)
    first = sticks.system.coordinates[0]
    if sticks.period is None:
        ax.set_xlabel(first.labeled(" where the stick begins"))
    else:
        name = _style.angle_axis(ax, sticks.period)
        ax.set_xlabel(first.labeled(f" of the stick, modulo {name}"))
    ax.set_ylabel(_parts.quantity_label("stick duration", "s"))
    ax.set_ylim(bottom=0)


def _draw_bound(ax: Axes, sticks: PlacedSticks) -> None:
    """The longest duration at each angle; shaded where there is no limit."""
    assert sticks.period is not None
    assert sticks.voltage is not None
    angles = np.linspace(0, sticks.period, _BOUND_POINTS)
    longest = np.asarray(sticks.system.longest_stick(sticks.voltage, angles), float)
    endless = np.isinf(longest)
    drawn = np.where(endless, np.nan, longest)
    ax.plot(angles, drawn, color=_style.MASS, lw=1.5, label="longest possible, closed form")
    if np.any(endless):
        look = {"color": _style.BAND, "alpha": 0.3, "lw": 0, "zorder": 0, "label": "sticks of any duration"}
        ax.fill_between(angles, 0, 1, where=endless, transform=ax.get_xaxis_transform(), **look)
