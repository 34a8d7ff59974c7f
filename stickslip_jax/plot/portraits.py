"""The path of the mass in the plane of position and velocity."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ..simulate import Simulation
from . import _style
from ._trajectory import Piece, check_simulation, check_window, joined, pieces_of

_POSITION, _SCALED = "position", "position_times_omega"


def _slip(sign: int) -> Callable[[Piece], bool]:
    return lambda piece: not piece.sticks and np.sign(piece.base_velocity) == sign


_GROUPS: tuple[tuple[str, Callable[[Piece], bool], dict[str, Any]], ...] = (
    ("slip, base forward", _slip(1), {"color": _style.FORWARD, "lw": _style.SLIP_WIDTH}),
    ("slip, base backward", _slip(-1), {"color": _style.BACKWARD, "lw": _style.SLIP_WIDTH}),
    ("slip, base at rest", _slip(0), {"color": _style.AT_REST, "lw": _style.SLIP_WIDTH}),
    # On a base at rest a stick is a point: a marker as wide as the line makes it seen.
    (
        "stick",
        lambda piece: piece.sticks,
        {"color": _style.STICK, "lw": _style.STICK_WIDTH, "marker": "o", "ms": _style.STICK_WIDTH, "mew": 0},
    ),
)


def phase_portrait(
    one: Simulation,
    ax: Axes | None = None,
    *,
    window: tuple[float, float] | None = None,
    abscissa: str = _POSITION,
) -> Axes:
    """Draw velocity against position, as in Lima and Sampaio (conference paper), figures 3 to 5.

    Slip is gray where the base moves forward, black where it moves backward (pale blue where it rests); sticks are
    thick and coloured. Crosses mark the two centres of the slip arcs, ``x = +- mu n / k`` at rest.

    - `one`: a finished result of `simulate`, one trajectory.
    - `ax`: where to draw; by default the axes of a new figure.
    - `window`: first and last time to draw, s, for instance the last period only; all of ``[0, t1]`` by default.
    - `abscissa`: "position" (m), or "position_times_omega" (m/s), in which slip arcs are circles, as in the paper.

    Returns the axes. Raises ValueError for anything else than the above.
    """
    check_simulation(one)
    window = check_window(one, window)
    if abscissa not in (_POSITION, _SCALED):
        raise ValueError(f"Argument abscissa must be {_POSITION!r} or {_SCALED!r}, but {abscissa!r} was given.")
    ax = _style.axes_or_new(ax, (5.0, 4.6))
    scale = float(one.system.angular_frequency) if abscissa == _SCALED else 1.0
    pieces = pieces_of(one, window)

    for label, belongs, look in _GROUPS:
        chosen = [piece for piece in pieces if belongs(piece)]
        if chosen:
            ax.plot(scale * joined(chosen, "position"), joined(chosen, "velocity"), label=label, **look)
    centres = scale * float(one.system.stick_half_width) * np.array([-1, 1])
    ax.plot(centres, [0, 0], ls="none", marker="x", ms=8, mew=2, color=_style.BASE, label=r"centres, $x = \pm \mu n/k$")
    ax.set_xlabel(r"position times frequency $\omega x$ (m/s)" if abscissa == _SCALED else "position $x$ (m)")
    ax.set_ylabel(r"velocity $\dot x$ (m/s)")
    if abscissa == _SCALED:
        ax.set_aspect("equal", adjustable="datalim")
    _style.legend_above(ax, columns=2)
    return ax
