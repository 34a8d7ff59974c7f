"""The state against time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ..base_motion.ground import GroundMotion
from ..simulate import Simulation
from ..systems.friction import Coulomb
from ..systems.mass_spring import MassSpring
from ..systems.motor_cart import MotorCart
from . import _style
from ._trajectory import Piece, check_simulation, check_window, has_steady_base, joined, pieces_of, values_of


def time_history(
    one: Simulation,
    ax: Sequence[Axes] | np.ndarray | None = None,
    *,
    window: tuple[float, float] | None = None,
) -> tuple[Axes, ...]:
    """Draw the state against time; sticks are thick and coloured.

    - `one`: a finished result of `simulate`, one trajectory. Of a mass and spring the position, and the velocity of
      mass and base are drawn; of a `MotorCart` its angle, angular velocity and current.
    - `ax`: two axes (of a `MotorCart` three); by default those of a new figure, one below the other.
    - `window`: first and last time to draw, s; all of ``[0, t1]`` by default.

    The shaded band holds the positions at which the mass can stick: ``|x| <= mu n / k`` on a base of constant
    velocities without damping and force, elsewhere it moves with them and with the base's acceleration. Of a
    `MotorCart` it holds the currents ``|motor_constant c| <= mu m g d |sin alpha|``.

    States are as exact as the simulation, at every event and on a fine grid between them. Returns the axes. Raises
    ValueError for anything else than the above.
    """
    check_simulation(one)
    window = check_window(one, window)
    system = one.system
    cart = isinstance(system, MotorCart)
    if cart:
        axes = _style.axes_below_or_new(ax, ("angle", "angular velocity", "current"), (6.4, 6.2))
        labels = (r"angle $\alpha$ (rad)", "angular velocity\n" r"$\dot\alpha$ (rad/s)", "current $c$ (A)")
    else:
        axes = _style.axes_below_or_new(ax, ("position", "velocity"), (6.4, 4.6))
        whose = "\nrelative to ground" if isinstance(one.base, GroundMotion) else ""
        labels = (f"position $x$ (m){whose}", f"velocity (m/s){whose}")
    pieces = pieces_of(one, window)

    if isinstance(system, MassSpring) and has_steady_base(one) and system.damping is None and system.force is None:
        _draw_constant_band(axes[0], system)
    else:
        _draw_band(axes, pieces, number=2 if cart else 0)
    if not cart:
        _draw_base(axes[1], pieces, "ground" if isinstance(one.base, GroundMotion) else "base")
    for number, panel in enumerate(axes):
        _draw_state(panel, pieces, number, "motor" if cart else "mass")
    for panel, label in zip(axes, labels, strict=True):
        panel.set_ylabel(label)
        panel.set_xlim(window)
        if panel.xaxis.get_tick_params().get("labelbottom", True):
            panel.set_xlabel("time $t$ (s)")
    _style.legend_above(*axes, columns=4)
    return axes


def _draw_state(panel: Axes, pieces: list[Piece], number: int, name: str) -> None:
    """Part `number` of the state as a line, sticks thick and coloured."""
    sticks = [piece for piece in pieces if piece.sticks]
    times, values = (np.concatenate([values_of(piece, key) for piece in pieces]) for key in ("times", number))
    panel.plot(times, values, color=_style.MASS, lw=_style.SLIP_WIDTH, label=name)
    stuck = (joined(sticks, "times"), joined(sticks, number))
    panel.plot(*stuck, color=_style.STICK, lw=_style.STICK_WIDTH, solid_capstyle="butt", label=f"{name}, stick")


def _draw_base(panel: Axes, pieces: list[Piece], name: str) -> None:
    """The base velocity as a line with upright jumps; where it is constant, from end to end."""
    kept = [slice(None) if np.ptp(piece.base_velocity) > 0 else [0, -1] for piece in pieces]
    times, velocities = (
        np.concatenate([values_of(piece, key)[points] for piece, points in zip(pieces, kept, strict=True)])
        for key in ("times", "base_velocity")
    )
    panel.plot(times, velocities, color=_style.BASE, lw=_style.SLIP_WIDTH, ls="--", label=name)


def _draw_constant_band(panel: Axes, system: MassSpring) -> None:
    """The positions at which the mass can stick, the same at all times."""
    half_width, friction = float(system.stick_half_width), system.friction
    mu = r"\mu" if isinstance(friction, Coulomb) and friction.mu_static is None else r"\mu_\mathrm{s}"
    label = rf"stick possible, $|x| \leq {mu} n/k$"
    panel.axhspan(-half_width, half_width, color=_style.BAND, alpha=0.3, lw=0, label=label)


def _draw_band(axes: tuple[Axes, ...], pieces: list[Piece], number: int) -> None:
    """The values of part `number` of the state at which a stick is possible, as they change in time."""
    times, lowest, highest, state = (
        np.concatenate([values_of(piece, key) for piece in pieces]) for key in ("times", "lowest", "highest", number)
    )
    if not np.all(np.isfinite(lowest)):
        return
    panel = axes[number]
    limits = panel.dataLim.frozen()
    panel.fill_between(times, lowest, highest, color=_style.BAND, alpha=0.3, lw=0, label="stick possible")
    # A band that goes far beyond the state is not shown to its ends.
    panel.dataLim.set(limits)
    width = np.max(highest - lowest)
    shown = max(np.min(lowest), np.min(state) - width), min(np.max(highest), np.max(state) + width)
    panel.update_datalim([(times[0], shown[0]), (times[-1], shown[1])])
