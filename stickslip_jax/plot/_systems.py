"""Figures of what is simulated: the mechanism of a system, the characteristic of a friction law, slopes that slide."""

import math
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes

from .._dynamics.common.method import check_fixed, state_of
from .._ensemble.sliding_blocks import NewmarkDisplacements
from .._foundation import checks
from .._foundation.types import InitialState
from .._systems.friction import FrictionLaw, require_law
from .._systems.places import FrictionByPlace
from .._systems.system import System, require_system
from . import _style
from ._animations import draw_mechanism, make_equal, mechanism_of

_SCALES = 6.0  # of the speed over which a coefficient changes
_POINTS = 400


def mechanism(system: System, y0: InitialState | None = None, *, ax: Axes | None = None) -> Axes:
    """A drawing of a system: bodies, springs and what they rub on, as `animate` draws them, at rest.

    Args:
        system: A `MassSpring`, a `MotorCart`, a structure, or a system of your own whose `look` has a mechanism; of any
            other each coordinate is a bar.
        y0: The state that is drawn; zeros by default.
        ax: Axes to draw into; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For what is no system, and a state of another length.
    """
    require_system(system)
    state = tuple(np.atleast_1d(np.asarray(value, float)) for value in state_of(system, y0))
    drawn = mechanism_of(system, state, np.zeros(1))
    ax = _style.axes_or_new(ax, (6.4, 2.6))
    moves = draw_mechanism(ax, drawn, np.zeros((1, system.tracks.contacts or 1), bool), "base")
    for _ in range(2):  # the second time springs know where the axes are
        for move in moves:
            move(0)
        _style.figure_of(ax).draw_without_rendering()
        if drawn.equal:
            make_equal(ax, drawn)
    return ax


def friction_law(
    law: FrictionLaw, *, speed: float | None = None, label: str | None = None, ax: Axes | None = None
) -> Axes:
    """The characteristic of a friction law: the friction coefficient against the relative velocity, of both signs.

    At rest friction takes any value up to its limit, the vertical line. The force is this times the normal force,
    against the relative velocity. Draw several laws into the same axes to compare them.

    Args:
        law: Such as ``Coulomb(0.3)`` or ``Stribeck(...)``. Of one with an inner state, the coefficient of steady slips;
            of one that differs by place, a curve for each region.
        speed: The largest relative speed, m/s, positive; by default six times that over which the coefficient changes,
            or 1.
        label: In the legend; by default how the law is written, and where it holds.
        ax: Axes to draw into; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For what is no friction law, one whose numbers are uncertain, and a speed that is not positive.
    """
    require_law("law", law, may_differ_by_place=True)
    check_fixed(law=law)
    if speed is None:
        scale = law.speed_scale
        known = scale is not None and math.isfinite(scale) and scale > 0
        speed = _SCALES * float(cast(Any, scale)) if known else 1.0
    checks.positive("speed", speed, "m/s")
    ax = _style.axes_or_new(ax, (5.6, 3.6))
    if isinstance(law, FrictionByPlace):
        for number, own in enumerate(law.laws):
            low, high = (f"{float(end):.6g}" for end in law.ends_of(jnp.asarray(float(number))))
            where = f"below {high}" if low == "-inf" else f"above {low}" if high == "inf" else f"{low} to {high}"
            every = "" if law.period is None else f", every {float(law.period):.6g} m"
            friction_law(own, speed=speed, label=f"{label or repr(own)}, {where} m{every}", ax=ax)
        _style.legend_above(ax, columns=1)  # one label is as long as the axes
        return ax
    x, y = [], []
    for sign in (-1.0, 1.0):
        own = law.in_direction(jnp.asarray(sign))
        velocity = sign * np.linspace(0, float(speed), _POINTS)
        values = sign * np.asarray(jax.vmap(lambda v, own=own: jnp.asarray(own.kinetic(jnp.abs(v)), float))(velocity))
        limit = sign * float(own.static)
        branch = np.concatenate([[0.0], velocity]), np.concatenate([[limit], values])
        x.append(branch[0][:: int(sign)])
        y.append(branch[1][:: int(sign)])
    look = _style.next_look(ax, np.concatenate(x))
    ax.plot(np.concatenate(x), np.concatenate(y), label=repr(law) if label is None else label, **look)
    ax.axhline(0, color="0.6", lw=0.6, zorder=0)
    ax.set_xlabel("relative velocity (m/s)")
    ax.set_ylabel("friction coefficient")
    if ax.get_legend() is not None or label is not None or len(ax.get_lines()) > 2:
        ax.legend(fontsize="small", loc="upper left")
    return ax


def newmark_displacements(result: NewmarkDisplacements, *, scale: int = 0, ax: Axes | None = None) -> Axes:
    """Displacements of sliding blocks against their yield coefficient: a thin curve for each record, and the median.

    Displacements of zero or less are left out of the logarithmic axis.

    Args:
        result: Of `stickslip_jax.newmark_displacements`.
        scale: The number of the factor by which the records are scaled, from 0.
        ax: Axes to draw into; by default those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For another `result`, and a `scale` that it does not have.
    """
    if not isinstance(result, NewmarkDisplacements):
        raise checks.refused("result", "be what newmark_displacements returns", result)
    chosen = checks.whole_number("scale", scale, minimum=0, maximum=len(result.scales) - 1)
    ax = _style.axes_or_new(ax, (5.6, 3.8))
    order = np.argsort(result.yield_coefficients)
    of_records = np.where(result.values > 0, result.values, np.nan)[:, chosen, order]
    lines = ax.plot(result.yield_coefficients[order], of_records.T, color="0.6", lw=0.8)
    lines[0].set_label(f"{len(lines)} records")
    median = np.where(result.median > 0, result.median, np.nan)[chosen, order]
    ax.plot(result.yield_coefficients[order], median, color=_style.SERIES[0], marker="o", label="median")
    ax.set(xlabel="yield coefficient (yield acceleration / g)", ylabel="permanent displacement (m)", yscale="log")
    _style.legend_above(ax, columns=2)
    return ax
