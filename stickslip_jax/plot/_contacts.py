"""A motion with several contacts: all coordinates against time, and a row of sticks for each contact."""

import re

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from .._simulation.result import Simulation
from . import _parts, _style
from ._legends import legend_above
from ._trajectory import check_window
from ._types import SeveralAxes, Window

_POINTS = 4000  # on the whole window, besides events and time steps
_FEW = 4  # lines that have a colour and a name each; of more, the first and the last are named
_HEIGHT = 0.8  # of a bar, in rows


def contact_rows(ax: Axes, one: Simulation, window: Window) -> None:
    """Draw each stick as a bar, in a row for each contact, and in the last row the times in which all stick."""
    contacts = one.totals.sticks.shape[-1]
    rows = [*(one.of_contact(number) for number in range(contacts)), one.of_all_contacts()]
    found = 0
    for row, part in enumerate(rows):
        mask = np.asarray(part.sticks.mask)
        start, end = (np.asarray(times)[mask] for times in (part.sticks.start, part.sticks.end))
        shown = (end > window[0]) & (start < window[1])
        found += int(np.count_nonzero(shown))
        at = np.full(int(np.count_nonzero(shown)), float(row))
        corners = _parts.rectangles(start[shown], end[shown], at - _HEIGHT / 2, at + _HEIGHT / 2)
        is_all = row == contacts
        look = {"facecolor": _style.MASS if is_all else _style.STICK, "lw": 0}
        ax.add_collection(
            PolyCollection(corners, label={0: "stick", contacts: "all closed contacts stick"}.get(row), **look),
            autolim=False,
        )
    if not found:
        _parts.note(ax, "no sticks")
    ax.set_ylim(contacts + 0.5, -0.5)
    every = -(-contacts // 12)
    numbers = range(0, contacts, every)
    ax.set_yticks([*numbers, contacts], [*map(str, numbers), "all"])
    ax.set_ylabel("contact")


def contact_raster(one: Simulation, window: Window | None, ax: Axes | None) -> Axes:
    """The figure `stick_raster` of one simulation with several contacts."""
    shown = check_window(window, float(one.t1))
    ax = _style.axes_or_new(ax, (6.4, 1.4 + 0.3 * min(one.totals.sticks.shape[-1], 16)))
    contact_rows(ax, one, shown)
    _style.time_axis(ax, shown)
    legend_above(ax)
    return ax


def contact_history(one: Simulation, window: Window | None, axes: SeveralAxes | None) -> tuple[Axes, ...]:
    """The figure `time_history` of a simulation with several contacts.

    One panel for the coordinates of each unit, with the base velocity among those of its unit, and one for the sticks.
    """
    shown = check_window(window, float(one.t1))
    times = line_times(one, shown)
    state, base = one.evaluate(times), np.asarray(one.base_velocity(times))
    units: dict[str, list[int]] = {}
    for number, coordinate in enumerate(one.system.coordinates):
        units.setdefault(coordinate.unit, []).append(number)
    names = (*(f"coordinates in {unit}" for unit in units), "sticks")
    panels = _style.axes_below_or_new(axes, names, (6.4, 1.9 * len(names) + 0.6))
    for panel, (unit, numbers) in zip(panels, units.items(), strict=False):
        named = [one.system.coordinates[number].name for number in numbers]
        for place, number in enumerate(numbers):
            is_named = len(numbers) <= _FEW or place in (0, len(numbers) - 1)
            color = _style.SHADES(place / (len(numbers) - 1)) if len(numbers) > _FEW else _style.SERIES[1 + place]
            label = named[place] if is_named else None
            panel.plot(times, np.asarray(state[number]), color=color, lw=_style.SLIP_WIDTH, label=label)
        if unit in ("m/s", "rad/s") and np.any(base != 0):
            panel.plot(times, base, color=_style.BASE, lw=_style.SLIP_WIDTH, ls="--", label="base")
        kinds = {re.sub(r"\s*\d+$", "", name) for name in named}  # "position 1", "position 2", ...
        panel.set_ylabel(_parts.quantity_label(kinds.pop() if len(kinds) == 1 else "coordinates", unit))
    contact_rows(panels[-1], one, shown)
    for panel in panels:
        _style.time_axis(panel, shown)
    legend_above(*panels, columns=4)
    return panels


def line_times(one: Simulation, window: Window) -> np.ndarray:
    """Times to draw a line at (s): a fine grid, with the beginnings of the time steps, at which events happen.

    Around these the base velocity is taken just before and at a jump.
    """
    steps = np.unique(np.asarray(one.step_starts))
    steps = steps[(steps > window[0]) & (steps < window[1])]
    steps = steps[:: -(-len(steps) // (8 * _POINTS))] if len(steps) else steps
    grid = np.linspace(*window, _POINTS, dtype=steps.dtype)
    return np.unique(np.concatenate([grid, steps, np.nextafter(steps, steps.dtype.type(0))]))
