"""The state against time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from .._excitation.ground import GroundMotion
from .._simulation.result import Simulation
from .._systems.system import Coordinate
from . import _style
from ._trajectory import Segment, check_simulation, check_window, joined, segments_of, values_of

_LONG = 12  # letters of a name that leave no room for a symbol in the same line


def time_history(
    one: Simulation,
    ax: Sequence[Axes] | np.ndarray | None = None,
    *,
    window: tuple[float, float] | None = None,
) -> tuple[Axes, ...]:
    """Draw the state against time; sticks are thick and coloured.

    - `one`: a finished result of `simulate`, one trajectory. Of a mass and spring the position, and the velocity of
      mass and base are drawn; of a `MotorCart` its angle, angular velocity and current; of a system of your own each
      number of its state.
    - `ax`: as many axes as there are numbers in the state; by default those of a new figure, one below the other.
    - `window`: first and last time to draw, s; all of ``[0, t1]`` by default.

    The shaded band holds the positions at which the mass can stick: ``|x| <= mu n / k`` on a base of constant
    velocities without damping and force, elsewhere it moves with them and with the base's acceleration. Of a
    `MotorCart` it holds the currents ``|motor_constant c| <= mu m g d |sin alpha|``.

    States are as exact as the simulation, at every event and on a fine grid between them. Returns the axes. Raises
    ValueError for anything else than the above.
    """
    check_simulation(one)
    window = check_window(one, window)
    coordinates = one.system.coordinates
    whose = "\nrelative to ground" if isinstance(one.base, GroundMotion) else ""
    height = 4.6 if len(coordinates) == 2 else 2.0 * len(coordinates) + 0.2
    axes = _style.axes_below_or_new(ax, tuple(coordinate.name for coordinate in coordinates), (6.4, height))
    segments = segments_of(one, window)
    _draw_band(axes, one, segments)
    if one.system.rides_base:
        _draw_base(axes[1], segments, "ground" if isinstance(one.base, GroundMotion) else "base")
    for number, panel in enumerate(axes):
        _draw_state(panel, segments, number, one.system.body_name)
        panel.set_ylabel(_label(coordinates[number], one.system.rides_base and number == 1) + whose)
        panel.set_xlim(window)
        if panel.xaxis.get_tick_params().get("labelbottom", True):
            panel.set_xlabel("time $t$ (s)")
    _style.legend_above(*axes, columns=4)
    return axes


def _label(coordinate: Coordinate, holds_base: bool) -> str:
    """The name of an axis, in two lines if it is long; without the symbol where the base's velocity is drawn too."""
    label = coordinate._replace(symbol="" if holds_base else coordinate.symbol).label
    return label.replace(" $", "\n$", 1) if len(coordinate.name) > _LONG else label


def _draw_state(panel: Axes, segments: list[Segment], number: int, name: str) -> None:
    """Part `number` of the state as a line, sticks thick and coloured."""
    sticks = [segment for segment in segments if segment.sticks]
    times, values = (np.concatenate([values_of(segment, key) for segment in segments]) for key in ("times", number))
    panel.plot(times, values, color=_style.MASS, lw=_style.SLIP_WIDTH, label=name)
    stuck = (joined(sticks, "times"), joined(sticks, number))
    panel.plot(*stuck, color=_style.STICK, lw=_style.STICK_WIDTH, solid_capstyle="butt", label=f"{name}, stick")


def _draw_base(panel: Axes, segments: list[Segment], name: str) -> None:
    """The base velocity as a line with upright jumps; where it is constant, from end to end."""
    kept = [slice(None) if np.ptp(segment.base_velocity) > 0 else [0, -1] for segment in segments]
    times, velocities = (
        np.concatenate([values_of(segment, key)[points] for segment, points in zip(segments, kept, strict=True)])
        for key in ("times", "base_velocity")
    )
    panel.plot(times, velocities, color=_style.BASE, lw=_style.SLIP_WIDTH, ls="--", label=name)


def _draw_band(axes: tuple[Axes, ...], one: Simulation, segments: list[Segment]) -> None:
    """The values at which a stick is possible, as they change in time, if they do."""
    number = one.system.band_coordinate
    times, lowest, highest, state = (
        np.concatenate([values_of(segment, key) for segment in segments])
        for key in ("times", "lowest", "highest", number)
    )
    if not np.all(np.isfinite(lowest)):
        return
    panel, look = axes[number], {"color": _style.BAND, "alpha": 0.3, "lw": 0}
    if one.system.band_symbols and np.ptp(lowest) == np.ptp(highest) == lowest[0] + highest[0] == 0:
        panel.axhspan(lowest[0], highest[0], label=rf"stick possible, ${one.system.band_symbols}$", **look)
        return
    limits = panel.dataLim.frozen()
    panel.fill_between(times, lowest, highest, label="stick possible", **look)
    # A band that goes far beyond the state is not shown to its ends.
    panel.dataLim.set(limits)
    width = np.max(highest - lowest)
    shown = max(np.min(lowest), np.min(state) - width), min(np.max(highest), np.max(state) + width)
    panel.update_datalim([(times[0], shown[0]), (times[-1], shown[1])])
