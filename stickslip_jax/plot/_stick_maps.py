"""How long sticks last, against where they happen."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize

from .. import _checks
from .._ensemble.result import Ensemble
from .._excitation.random import RandomPhase
from .._excitation.voltage import SourceVoltage
from .._simulation.result import Simulation
from .._statistics.first_sticks import FirstSticks
from .._systems.system import System, require_system
from . import _style
from ._sticks import complete_sticks, edges_of_bins

_MANY = 2000  # points: more are smaller and paler
_BOUND_POINTS = 1441  # of the bound: quarter degrees of a turn


def stick_map(
    result: Ensemble | FirstSticks | Simulation,
    ax: Axes | None = None,
    *,
    system: System | None = None,
    bound: SourceVoltage | RandomPhase | None = None,
    period: float | None = None,
) -> Axes:
    """Draw the duration of each stick against the position at which it begins, a point for each.

    As in Lima and Sampaio (2022), figures 4 and 5, left, for a `MotorCart`: duration of the first stick against the
    angle. Sticks cut by the horizon are left out, because only a part of them was seen; the legend tells how many. So
    are samples that did not reach ``t1``.

    - `result`: an `Ensemble`, for the sticks that it kept (with ``keep="statistics"`` those of the first samples); the
      first ones of each sample, ``first_stick(ensemble)``; or a `Simulation` (one, or a batch by ``vmap``).
    - `ax`: where to draw; by default the axes of a new figure.
    - `system`: what was simulated. `FirstSticks` do not know it, so it must be given with them: ``ensemble.system``.
    - `bound`: the voltage whose closed-form `stick_duration_bound` to draw (``ensemble.law``, say), for a `MotorCart`.
      By default none. What the current still does when a stick begins can prolong it by about the electrical time
      constant.
    - `period`: angles are drawn modulo this, pi or 2 pi, rad; by default 2 pi. A `MotorCart` repeats itself after pi.

    Returns the axes, with a note in them if there is no complete stick. Raises ValueError for an ensemble that kept
    only totals, and for anything else than the above.
    """
    shown = _shown(result, system, bound, period)
    ax = _style.axes_or_new(ax, (5.6, 4.0))
    if len(shown.duration):
        many = len(shown.duration) > _MANY
        size, alpha = (3, 0.35) if many else (9, 0.6)
        ax.scatter(shown.position, shown.duration, s=size, alpha=alpha, lw=0, color=_style.STICK, rasterized=many)
        ax.plot([], [], ls="none", marker="o", ms=4, mew=0, color=_style.STICK, label=shown.label)
    _finish(ax, shown)
    return ax


def stick_joint_histogram(
    result: Ensemble | FirstSticks | Simulation,
    ax: Axes | None = None,
    *,
    system: System | None = None,
    bound: SourceVoltage | RandomPhase | None = None,
    period: float | None = None,
    bins: Any = 40,
    log: bool = False,
) -> Axes:
    """Draw the joint histogram of the position at which sticks begin and of their duration, as a probability density.

    As in Lima and Sampaio (2022), figures 4 and 5, right; what `stick_map` draws as points. Empty bins are white.

    - `result`, `ax`, `system`, `bound`, `period`: as for `stick_map`.
    - `bins`: number of equal bins each way, or two such numbers, or two sequences of increasing edges: of position (m,
      or angle in rad) first, then of duration (s). By default they reach from the smallest to the largest position (one
      period of the angle) and from 0 to the longest duration. Sticks outside the edges are drawn nowhere but count: the
      density times the bin area stays the share of all complete sticks.
    - `log`: whether colours follow the logarithm of the density, to show rare sticks beside frequent ones.

    Returns the axes, with a note in them if there is no complete stick. Raises ValueError for an ensemble that kept
    only totals, and for anything else than the above.
    """
    shown = _shown(result, system, bound, period)
    if not isinstance(log, bool):
        raise ValueError(f"Argument log must be True or False, but {_checks.show(log)} was given.")
    edges = _edges(bins, shown)
    ax = _style.axes_or_new(ax, (6.4, 4.0))
    number = len(shown.duration)
    if number:
        counts, *_ = np.histogram2d(shown.position, shown.duration, edges)
        density = np.ma.masked_equal(counts, 0) / (number * np.outer(*map(np.diff, edges)))
        label = shown.label
        if counts.sum() < number:
            label += f"\n{number - int(counts.sum()):,} of them outside the bins"
        norm = LogNorm() if log else Normalize(vmin=0)
        mesh = ax.pcolormesh(*edges, density.T, cmap="viridis_r", norm=norm, rasterized=True)
        ax.plot([], [], ls="none", marker="s", color=mesh.cmap(0.5), label=label)
        figure = ax.get_figure(root=True)
        assert figure is not None
        figure.colorbar(mesh, ax=ax, label=f"probability density (1/({shown.system.coordinates[0].unit} s))")
    _finish(ax, shown)
    return ax


class _Shown(NamedTuple):
    """What to draw: `duration` (s) and `position` (m; of a motor its angle in one `period`, rad) of each stick."""

    duration: np.ndarray
    position: np.ndarray
    label: str
    system: Any
    bound: Any
    period: Any


def _shown(result: Any, system: Any, bound: Any, period: Any) -> _Shown:
    """The complete sticks, and what else to draw, checked."""
    sticks = complete_sticks(result)
    system = _checked_system(system, None if isinstance(result, FirstSticks) else result.system)
    turn = system.coordinates[0].period
    voltage = bound.signal if isinstance(bound, RandomPhase) else bound
    if voltage is not None and np.ndim(getattr(system, "mu", 0.0)) > 0:
        raise ValueError(
            "Argument system must be given with the bound, which is that of one MotorCart, but a batch of shape "
            f"{np.shape(system.mu)} was simulated."
        )
    if voltage is not None and not (turn and system.longest_stick(voltage, np.zeros(1)) is not None):
        raise ValueError(
            "Argument bound must be a SourceVoltage, or RandomPhase(SourceVoltage(...)), and be given for a MotorCart "
            f"only, but {_checks.show(bound)} was given for a {type(system).__name__}."
        )
    if period is None:
        period = turn
    else:
        _checks.numeric("period", period)
        if not turn or not np.any(np.isclose(period, (turn / 2, turn), rtol=1e-6)):
            raise ValueError(
                "Argument period must be pi or 2 pi (in rad), and be given for a MotorCart only, but "
                f"{_checks.show(period)} was given for a {type(system).__name__}."
            )
    position = sticks.position if period is None else np.mod(sticks.position, period)
    return _Shown(sticks.duration, position, sticks.label, system, voltage, period)


def _checked_system(system: Any, known: Any) -> System:
    """`system`, or what the result is `known` to be of."""
    if system is None and known is None:
        raise ValueError(
            "Argument system must be given with FirstSticks, in which positions and angles look alike: "
            "system=ensemble.system."
        )
    if system is None:
        system = known
    require_system(system)
    if known is not None and type(known) is not type(system):
        raise ValueError(
            f"Argument system must be the {type(known).__name__} that was simulated, but {_checks.show(system)} was "
            "given."
        )
    return system


def _edges(bins: Any, shown: _Shown) -> list[np.ndarray]:
    """Edges of the bins of position (m or rad) and of duration (s)."""
    pair = (bins, bins) if isinstance(bins, (int, np.integer)) else bins
    if not isinstance(pair, (tuple, list)) or len(pair) != 2:
        raise ValueError(f"Argument bins must be a whole number, or two of them or of edges, but {bins!r} was given.")
    if shown.period is not None:
        span = (0.0, shown.period)
    else:
        low, high = (shown.position.min(), shown.position.max()) if len(shown.position) else (0.0, 0.0)
        span = (low, high) if low < high else (low - 0.5, low + 0.5)
    longest = shown.duration.max(initial=0) or 1.0
    return [
        edges_of_bins("bins[0]", pair[0], span, shown.system.coordinates[0].unit),
        edges_of_bins("bins[1]", pair[1], (0.0, longest), "s"),
    ]


def _finish(ax: Axes, shown: _Shown) -> None:
    """Bound, labels, limits and legend; a note where there are no sticks."""
    if shown.bound is not None:
        _draw_bound(ax, shown)
    if len(shown.duration) == 0:
        ax.text(0.5, 0.5, shown.label, ha="center", va="center", transform=ax.transAxes)
    first = shown.system.coordinates[0]
    if shown.period is None:
        ax.set_xlabel(first.labelled(" where the stick begins"))
    else:
        turn = _style.angle_axis(ax, shown.period)
        ax.set_xlabel(first.labelled(f" of the stick, modulo {turn}"))
    ax.set_ylabel("stick duration (s)")
    ax.set_ylim(bottom=0)
    if ax.get_legend_handles_labels()[1]:
        _style.legend_above(ax, columns=1)


def _draw_bound(ax: Axes, shown: _Shown) -> None:
    """The longest duration at each angle; shaded where a stick can last for ever."""
    angles = np.linspace(0, shown.period, _BOUND_POINTS)
    longest = np.asarray(shown.system.longest_stick(shown.bound, angles), float)
    endless = np.isinf(longest)
    drawn = np.where(endless, np.nan, longest)
    ax.plot(angles, drawn, color=_style.MASS, lw=1.5, label="longest possible, closed form")
    if np.any(endless):
        look = {"color": _style.BAND, "alpha": 0.3, "lw": 0, "zorder": 0, "label": "can stick for ever"}
        ax.fill_between(angles, 0, 1, where=endless, transform=ax.get_xaxis_transform(), **look)
