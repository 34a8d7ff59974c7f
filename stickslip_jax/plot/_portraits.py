"""Phase portraits: velocity against position, or angular velocity against angle."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from .. import _checks
from .._excitation.ground import GroundMotion
from .._simulation.result import Simulation
from . import _style
from ._legends import legend_above
from ._trajectory import Phase, check_simulation, check_window, has_steady_base, joined, phases_of
from ._types import Window

_POSITION, _SCALED = "position", "position_times_omega"

Group = tuple[str, Callable[[Phase], bool], dict[str, Any]]
"""How to draw a kind of phase: its label, which phases are of that kind, and how they look."""


def _slip(sign: int) -> Callable[[Phase], bool]:
    return lambda phase: not phase.sticks and np.sign(phase.base_velocity[0]) == sign


# On a base at rest a stick is a point, which is visible by markers at its ends, as wide as the line.
_STICK: Group = (
    "stick",
    lambda phase: phase.sticks,
    {"color": _style.STICK, "lw": _style.STICK_WIDTH, "marker": "o", "ms": _style.STICK_WIDTH, "mew": 0},
)
_BY_BASE: tuple[Group, ...] = (
    ("slip, base forward", _slip(1), {"color": _style.FORWARD, "lw": _style.SLIP_WIDTH}),
    ("slip, base backward", _slip(-1), {"color": _style.BACKWARD, "lw": _style.SLIP_WIDTH}),
    ("slip, base at rest", _slip(0), {"color": _style.AT_REST, "lw": _style.SLIP_WIDTH}),
    _STICK,
)
_ALIKE: tuple[Group, ...] = (
    ("slip", lambda phase: not phase.sticks, {"color": _style.EITHER_WAY, "lw": _style.SLIP_WIDTH}),
    _STICK,
)


def phase_portrait(
    result: Simulation,
    *,
    window: Window | None = None,
    x: str | None = None,
    y: str | None = None,
    abscissa: str = _POSITION,
    energy_regions: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw velocity against position, as in Lima and Sampaio (conference paper), figures 3 to 5.

    Sticks are thick and coloured. On a base of piecewise-constant velocity, slip is gray while the base moves forward,
    black while it moves backward, and pale blue while it is at rest; on other bases slip is purple. Crosses mark the
    centres of the slip arcs, ``(x, velocity) = (+- mu n / k, 0)`` (conference paper, equation 3), if the friction
    coefficient is constant and there is no force and no ground motion; on a base that moves in one direction only, the
    centre for a mass slower than the base: its only equilibrium. For a `MotorCart`, the angular velocity is drawn
    against the angle modulo 2 pi; its sticks are points. For your own system, the second coordinate against the first,
    or any other two.

    Args:
        result: A result of `simulate`, one trajectory that reached ``t1``.
        window: First and last time to draw, s, for instance the last period only; all of ``[0, t1]`` by default.
        x: Name of the coordinate on the abscissa, such as "angle", or "position 2" of `SwitchedSystem.state_names`; by
            default the first one.
        y: Name of that on the ordinate, likewise; by default the second one.
        abscissa: "position" (m; of a `MotorCart` the angle), or for a mass and spring "position_times_omega" (m/s), in
            which undamped slip arcs are circles, as in the paper.
        energy_regions: Whether to shade where a slip takes energy from the base: where the mass moves in its direction
            and is slower, ``0 < x' < v`` (Lima and Sampaio 2015, section 2). For a mass and spring on a base of
            piecewise-constant velocity; each of its velocities has one such region.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind, and for a simulation that did not reach ``t1``.
    """
    check_simulation(result)
    window = check_window(window, float(result.t1))
    chosen = _chosen(result, x, y)
    first, second = (result.system.coordinates[number] for number in chosen)
    choices = (_POSITION,) if first.period or result.system.natural_frequency is None else (_POSITION, _SCALED)
    if chosen != (0, 1):
        choices = (_POSITION,)
    if abscissa not in choices:
        names = " or ".join(map(repr, choices))
        raise ValueError(
            f"Argument abscissa must be {names} for a {type(result.system).__name__}, but {_checks.show(abscissa)} was "
            "given."
        )
    _checks.truth("energy_regions", energy_regions)
    if energy_regions and not (has_steady_base(result) and chosen == (0, 1)):
        raise ValueError(
            "Argument energy_regions must be False unless a mass and spring moves on a base of piecewise-constant "
            "velocity and its velocity is drawn against its position, but True was given for a "
            f"{type(result.system).__name__} on {_checks.show(result.base)}, {second.name} against {first.name}."
        )
    ax = _style.axes_or_new(ax, (5.0, 4.6))
    phases = phases_of(result, window)
    if energy_regions:
        for velocity in set(np.unique([phase.base_velocity[0] for phase in phases])) - {0}:
            ax.axhspan(0, velocity, color=_style.FED, alpha=0.25, lw=0, label="friction feeds energy in")
    if first.period:
        _draw_periodic(ax, phases, result, chosen)
    else:
        _draw_plane(ax, result, phases, chosen, abscissa)
    legend_above(ax, columns=2)
    return ax


def _chosen(one: Simulation, x: str | None, y: str | None) -> tuple[int, int]:
    """The numbers of the coordinates called `x` and `y`, by default the first two."""
    names = [coordinate.name for coordinate in one.system.coordinates]
    for argument, name in (("x", x), ("y", y)):
        if name is not None and name not in names:
            raise ValueError(
                f"Argument {argument} must be the name of a coordinate of the {type(one.system).__name__}, one of "
                f"{', '.join(map(repr, names))}, but {_checks.show(name)} was given."
            )
    chosen = 0 if x is None else names.index(x), 1 if y is None else names.index(y)
    if chosen[0] == chosen[1]:
        given = f"x={_checks.show(x)}" if y is None else f"y={_checks.show(y)}"
        raise ValueError(
            f"Arguments x and y must be two different coordinates, but {names[chosen[0]]!r} is both with {given}; "
            f"give both, of {', '.join(map(repr, names))}."
        )
    return chosen


def _draw_plane(ax: Axes, one: Simulation, phases: list[Phase], pair: tuple[int, int], abscissa: str) -> None:
    """One coordinate against the other, or against it times the natural angular frequency."""
    first, second = (one.system.coordinates[number] for number in pair)
    scale = float(one.system.natural_frequency) if abscissa == _SCALED and one.system.natural_frequency else 1.0
    for label, belongs, look in _BY_BASE if has_steady_base(one) else _ALIKE:
        chosen = [phase for phase in phases if belongs(phase)]
        if chosen:
            ends = np.cumsum([len(phase.times) + 1 for phase in chosen]) - 2
            starts = ends + 1 - [len(phase.times) for phase in chosen]
            marked = np.union1d(starts, ends).tolist()
            x, y = (joined(chosen, number) for number in pair)
            ax.plot(scale * x, y, label=label, markevery=marked, **look)
    center = one.system.slip_center
    if center is not None and not isinstance(one.base, GroundMotion) and pair == (0, 1):
        look = {"ls": "none", "marker": "x", "ms": 8, "mew": 2, "color": _style.BASE}
        directions = _directions(one, phases)
        label = r"centres, $x = \pm \mu n/k$" if len(directions) > 1 else r"centre, $x = \mu n/k\,\mathrm{sgn}\,v$"
        ax.plot(scale * float(center) * directions, 0 * directions, label=label, **look)
    whose = " relative to ground" if isinstance(one.base, GroundMotion) else ""
    scaled = f"{first.name}{whose} times frequency $\\omega {first.symbol}$ (m/s)"
    ax.set_xlabel(scaled if abscissa == _SCALED else first.labeled(whose))
    ax.set_ylabel(second.labeled(whose))
    if abscissa == _SCALED:
        ax.set_aspect("equal", adjustable="datalim")


def _directions(one: Simulation, phases: list[Phase]) -> np.ndarray:
    """-1 and 1; or the only one of them in which the base moves in all `phases`."""
    if has_steady_base(one):
        signs = {np.sign(phase.base_velocity[0]) for phase in phases}
        if len(signs) == 1 and 0 not in signs:
            return np.array(list(signs))
    return np.array([-1.0, 1.0])


def _draw_periodic(ax: Axes, phases: list[Phase], one: Simulation, pair: tuple[int, int]) -> None:
    """One coordinate against the other modulo its period; sticks in which neither changes are points."""
    first, second = (one.system.coordinates[number] for number in pair)
    assert first.period is not None
    period = first.period
    still = [phase for phase in phases if phase.sticks and all(np.ptp(phase.state[number]) == 0 for number in pair)]
    points = set(map(id, still))
    for label, belongs, look in _ALIKE:
        chosen = [phase for phase in phases if belongs(phase) and id(phase) not in points]
        if chosen:
            x, y = (joined(chosen, number) for number in pair)
            ax.plot(*_wrapped(x, y, period), label=label, **look)
    if still:
        angles, speeds = np.transpose([[phase.state[number][0] for number in pair] for phase in still])
        look = {"ls": "none", "marker": "o", "ms": 5, "mew": 0, "color": _style.STICK, "clip_on": False}
        ax.plot(np.mod(angles, period), speeds, label="stick", **look)
    name = _style.angle_axis(ax, period)
    ax.set_xlabel(first.labeled(f" modulo {name}"))
    ax.set_ylabel(second.label)


def _wrapped(angle: np.ndarray, speed: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """A line with its angle modulo `period`; where the angle leaves a period, the line goes to the edge and breaks."""
    count = np.floor(angle / period)
    at = np.flatnonzero(np.abs(np.diff(count)) > 0)  # NaN, where the line is broken already, compares false
    edge = period * np.maximum(count[at], count[at + 1])
    part = (edge - angle[at]) / (angle[at + 1] - angle[at])
    between = speed[at] + part * (speed[at + 1] - speed[at])
    forward = count[at + 1] > count[at]
    leaving, entering = np.where(forward, period, 0), np.where(forward, 0, period)
    x = np.insert(
        angle - period * count, np.repeat(at + 1, 3), np.ravel([leaving, np.full(len(at), np.nan), entering], "F")
    )
    y = np.insert(speed, np.repeat(at + 1, 3), np.ravel([between, np.full(len(at), np.nan), between], "F"))
    return x, y
