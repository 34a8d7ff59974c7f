"""The state and what drives it against time."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes

from .._excitation.ground import GroundMotion
from .._excitation.voltage import SourceVoltage
from .._simulation.result import Simulation
from .._systems.system import Coordinate
from . import _parts, _style
from ._contacts import contact_history
from ._legends import legend_above
from ._trajectory import Phase, check_simulation, ground_acceleration, joined, values_of
from ._types import SeveralAxes, Window
from ._windows import phases_in, turns_of

_VELOCITIES = {"m/s", "rad/s"}
_MOST_SWINGS = 40  # of the band by more than its width: more are needles without a meaning to the eye
_LONG = 12  # letters: after a longer name the symbol goes into a second line


def time_history(
    result: Simulation,
    *,
    window: Window | None = None,
    axes: SeveralAxes | None = None,
) -> tuple[Axes, ...]:
    """Draw the state against time, and below it what drives it; sticks are thick and coloured.

    The shaded band shows where friction can hold a stick; it is left out where it moves to and fro too quickly to be
    seen. For a mass and spring without damping and force, on a base of piecewise-constant velocity, it holds the
    positions ``|x| <= mu n / k`` (static friction coefficient mu, normal force n, stiffness k); with them it moves, as
    it does with the base's acceleration. For a `MotorCart` it holds the currents
    ``|motor_constant c| <= mu m g d |sin alpha|``, at which the motor's torque is no larger than that of friction.

    States are as exact as the simulation, at every event and on a fine grid between events.

    Args:
        result: A result of `simulate`, one trajectory that reached ``t1``. For a mass and spring, the position and the
            velocities of mass and base are drawn; for a `MotorCart` its angle, angular velocity and current; for a
            system of your own each coordinate. What else drives it has axes of its own: the voltage of a motor, the
            acceleration of the ground, or a force; for a system of your own with several
            velocities that of the base. With several contacts: a panel for the coordinates of each unit, and one with a
            row of sticks for each contact.
        window: First and last time to draw, s. By default all of ``[0, t1]``, or of a motion that turns so often (more
            than 80 times by a quarter of its range) that its line would be a black band, the beginning; the name of the
            axis says so then.
        axes: As many as there are coordinates, and if the excitation is to be drawn, one more; by default those of a
            new figure, one below the other.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind, and for a simulation that did not reach ``t1``.
    """
    check_simulation(result, of_one_contact=False)
    if result.sticks.contact is not None:
        return contact_history(result, window, axes)
    phases, shown = phases_in(result, window)
    coordinates = result.system.coordinates
    whose = "\nrelative to ground" if isinstance(result.base, GroundMotion) else ""
    names, (drive_label, drive) = tuple(coordinate.name for coordinate in coordinates), _drive_of(result)
    base_panel = _base_panel(result)
    if (drive is not None or base_panel == len(names)) and (
        axes is None or len(_style.axes_in(axes)) == len(names) + 1
    ):
        names = (*names, "excitation")
    panels = _style.axes_below_or_new(axes, names, (6.4, 4.6 if len(names) == 2 else 1.8 * len(names) + 0.4))
    _draw_band(panels, result, phases)
    if base_panel is not None and base_panel < len(panels):
        _draw_base(panels[base_panel], phases, "ground" if isinstance(result.base, GroundMotion) else "base")
    for number, coordinate in enumerate(coordinates):
        _draw_state(panels[number], phases, number, result.system.body_name)
        panels[number].set_ylabel(_label(coordinate, result.system.sticks_at_base_velocity and number == 1) + whose)
    if base_panel == len(coordinates) < len(panels):
        panels[-1].set_ylabel(_base_label(coordinates))
    elif drive is not None and len(panels) > len(coordinates):
        times = np.concatenate([phase.times for phase in phases])
        panels[-1].plot(times, np.asarray(drive(jnp.asarray(times))), color=_style.BASE, lw=_style.SLIP_WIDTH)
        panels[-1].set_ylabel(drive_label)
    for panel in panels:
        _style.time_axis(panel, shown, float(result.t1) if window is None else None)
    legend_above(*panels, columns=4)
    return panels


def _drive_of(one: Simulation) -> tuple[str, Callable[[jax.Array], jax.Array] | None]:
    """What drives the system besides the velocity of its base: the name of its axis, and its value; None if nothing."""
    if isinstance(one.base, SourceVoltage):
        return "voltage (V)", one.base.value
    if isinstance(one.base, GroundMotion) and (acceleration := ground_acceleration(one.base)) is not None:
        return "ground\nacceleration (m/s$^2$)", acceleration
    return "force (N)", getattr(getattr(one.system, "force", None), "value", None)


def _base_panel(one: Simulation) -> int | None:
    """The number of the panel that the base velocity stands in; None where no base moves.

    Of a system of the user's own that is with its only velocity, or else a panel after those of the coordinates.
    """
    if one.system.sticks_at_base_velocity:
        return 1
    if isinstance(one.base, (GroundMotion, SourceVoltage)):
        return None
    units = [coordinate.unit for coordinate in one.system.coordinates]
    velocities = [number for number, unit in enumerate(units) if unit in _VELOCITIES]
    return velocities[0] if len(velocities) == 1 else len(units)


def _base_label(coordinates: tuple[Coordinate, ...]) -> str:
    """The name of the base velocity, with its unit where there is only one unit of velocities among the coordinates."""
    units = {coordinate.unit for coordinate in coordinates} & _VELOCITIES
    return _parts.quantity_label("base velocity", units.pop() if len(units) == 1 else "1")


def _label(coordinate: Coordinate, holds_base: bool) -> str:
    """The name of an axis, in two lines if it is long; without the symbol if the base velocity is drawn there too."""
    label = coordinate._replace(symbol="" if holds_base else coordinate.symbol).label
    return label.replace(" $", "\n$", 1) if len(coordinate.name) > _LONG else label


def _draw_state(panel: Axes, phases: list[Phase], number: int, name: str) -> None:
    """Coordinate `number` as a line, sticks thick and coloured."""
    sticks = [phase for phase in phases if phase.sticks]
    times, values = (np.concatenate([values_of(phase, key) for phase in phases]) for key in ("times", number))
    panel.plot(times, values, color=_style.MASS, lw=_style.SLIP_WIDTH, label=name)
    stuck = (joined(sticks, "times"), joined(sticks, number))
    panel.plot(*stuck, color=_style.STICK, lw=_style.STICK_WIDTH, solid_capstyle="butt", label=f"{name}, stick")


def _draw_base(panel: Axes, phases: list[Phase], name: str) -> None:
    """The base velocity as a line with vertical jumps; two points are enough where it is constant."""
    kept = [slice(None) if np.ptp(phase.base_velocity) > 0 else [0, -1] for phase in phases]
    times, velocities = (
        np.concatenate([values_of(phase, key)[points] for phase, points in zip(phases, kept, strict=True)])
        for key in ("times", "base_velocity")
    )
    panel.plot(times, velocities, color=_style.BASE, lw=_style.SLIP_WIDTH, ls="--", label=name)


def _draw_band(panels: tuple[Axes, ...], result: Simulation, phases: list[Phase]) -> None:
    """The values at which friction can hold a stick: a band that may change in time."""
    number = result.system.band_coordinate
    times, lowest, highest, state = (
        np.concatenate([values_of(phase, key) for phase in phases]) for key in ("times", "lowest", "highest", number)
    )
    if not np.all(np.isfinite(lowest)) or len(turns_of(lowest, float(np.max(highest - lowest)))) > _MOST_SWINGS:
        return
    panel, look = panels[number], {"color": _style.BAND, "alpha": 0.3, "lw": 0}
    if result.system.band_symbols and np.ptp(lowest) == np.ptp(highest) == lowest[0] + highest[0] == 0:
        panel.axhspan(lowest[0], highest[0], label=rf"stick possible, ${result.system.band_symbols}$", **look)
        return
    limits = panel.dataLim.frozen()
    panel.fill_between(times, lowest, highest, label="stick possible", **look)
    # Of a band much wider than the motion, only the part near the motion is shown.
    panel.dataLim.set(limits)
    width = np.max(highest - lowest)
    shown = max(np.min(lowest), np.min(state) - width), min(np.max(highest), np.max(state) + width)
    panel.update_datalim([(times[0], shown[0]), (times[-1], shown[1])])
