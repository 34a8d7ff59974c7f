"""Position and velocity against time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ..simulate import Simulation
from . import _style
from ._trajectory import Piece, check_simulation, check_window, joined, pieces_of


def time_history(
    one: Simulation,
    ax: Sequence[Axes] | np.ndarray | None = None,
    *,
    window: tuple[float, float] | None = None,
) -> tuple[Axes, Axes]:
    """Draw the position, and the velocity of mass and base, against time; sticks are thick and coloured.

    - `one`: a finished result of `simulate`, one trajectory.
    - `ax`: two axes, for position and velocity; by default those of a new figure, one below the other.
    - `window`: first and last time to draw, s; all of ``[0, t1]`` by default.

    The shaded band holds the positions at which the mass can stick, ``|x| <= mu n / k``. States are exact at every
    event and on a fine grid between them. Returns both axes. Raises ValueError for anything else than the above.
    """
    check_simulation(one)
    window = check_window(one, window)
    upper, lower = _style.two_axes_or_new(ax, (6.4, 4.6))
    pieces = pieces_of(one, window)
    sticks = [piece for piece in pieces if piece.sticks]

    half_width = float(one.system.stick_half_width)
    upper.axhspan(
        -half_width, half_width, color=_style.BAND, alpha=0.3, lw=0, label=r"stick possible, $|x| \leq \mu n/k$"
    )
    _draw_base(lower, pieces)
    for panel, name in ((upper, "position"), (lower, "velocity")):
        times, values = (np.concatenate([getattr(piece, key) for piece in pieces]) for key in ("times", name))
        panel.plot(times, values, color=_style.MASS, lw=_style.SLIP_WIDTH, label="mass")
        stuck = (joined(sticks, "times"), joined(sticks, name))
        panel.plot(*stuck, color=_style.STICK, lw=_style.STICK_WIDTH, solid_capstyle="butt", label="mass, stick")
    upper.set_ylabel("position $x$ (m)")
    lower.set_ylabel("velocity (m/s)")
    for panel in (upper, lower):
        panel.set_xlim(window)
        if panel.xaxis.get_tick_params().get("labelbottom", True):
            panel.set_xlabel("time $t$ (s)")
    _style.legend_above(upper, lower, columns=4)
    return upper, lower


def _draw_base(panel: Axes, pieces: list[Piece]) -> None:
    """The base velocity as a line with upright jumps."""
    times = np.concatenate([piece.times[[0, -1]] for piece in pieces])
    velocities = np.repeat([piece.base_velocity for piece in pieces], 2)
    panel.plot(times, velocities, color=_style.BASE, lw=_style.SLIP_WIDTH, ls="--", label="base")
