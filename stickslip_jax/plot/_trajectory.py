"""Figures of one trajectory, cut into phases at its events, so that sticks are drawn exactly where they are."""

import math
import re
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes

from .._compiler.programs import kept_jit
from .._dynamics.common.method import Exact
from .._dynamics.simulation import Simulation
from .._excitation.motion import SourceVoltage
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._excitation.recorded import GroundMotion
from .._foundation import checks
from .._foundation.types import Ending, Status
from . import _style
from ._style import SeveralAxes, Window, legend_above

# A simulated trajectory cut into phases at its events, so that sticks are drawn exactly where they happen.


_POINTS_PER_REVOLUTION = 180  # two degrees of a slip arc: its chord leaves the circle by 0.02 % of the radius
_POINTS_PER_KNOT = 6  # at least; a time step of the simulation is 1/16 of the shortest period or less
_MOST_POINTS = 100_000


class Phase(NamedTuple):
    """The trajectory between two neighbouring events: all slip or all stick, without a jump of the base velocity.

    `values`, arrays (points,): "times" in s; the coordinates of the system by their numbers, in their units;
    "base_velocity" in m/s; "lowest" and "highest" value at which friction can hold a stick (`Look.stick_band`). At
    inner knots a time stands twice.
    """

    values: dict[str | int, np.ndarray]
    sticks: bool


TRACED = (
    "Argument result must hold numbers, but one traced by a JAX transformation was given; draw the figure outside jit, "
    "vmap and grad."
)


def check_simulation(result: Simulation, *, of_one_contact: bool = True) -> None:
    """Raise ValueError unless `result` is a single simulation with a motion to draw, and not traced by JAX.

    `of_one_contact`: whether its sticks must be those of one contact.
    """
    checks.require_threads_of_jax()
    if not isinstance(result, Simulation):
        hint = "sample i of an ensemble is simulated with its base motion and initial state, ensemble.realization(i)"
        raise checks.refused("result", "be a result of simulate", result, hint)
    if checks.holds_traced(result):
        raise ValueError(TRACED)
    if np.ndim(result.status) > 0:
        raise ValueError(
            f"Argument result must hold one trajectory, but a batch of shape {np.shape(result.status)} was given; "
            "take one out with jax.tree.map(lambda values: values[i], batch)."
        )
    if not float(result.time_reached) > 0 or result.status == Status.REDUNDANT_CONTACTS:
        raise ValueError(
            "Argument result must hold a motion to draw, but one with this status was given: "
            f"{Status(int(result.status)).meaning}."
        )
    if of_one_contact:
        require_one_contact(result)


def require_one_contact(result: Simulation) -> None:
    """Raise ValueError for a simulation with the sticks of several contacts."""
    if result.sticks.contact is not None:
        hint = "take result.of_contact(number) or result.of_all_contacts()"
        raise checks.refused("result", "have the sticks of one contact", result, hint)


def check_window(window: Window | None, last: float) -> Window:
    """The window to draw, s; all of ``[0, last]`` if `window` is None. Raises ValueError if it is not part of that."""
    if window is None:
        return 0.0, last
    begin = end = math.nan
    with suppress(TypeError, ValueError):
        begin, end = (float(time) for time in window)
    if not 0 <= begin < end <= last:
        demand = f"be two times (in s) with 0 <= t_a < t_b <= {last:g}, the end of the motion"
        raise checks.refused("window", demand, window)
    return begin, end


def has_steady_base(one: Simulation) -> bool:
    """Whether the mass rubs on a base whose velocity is constant between jumps."""
    return one.system.look.second_is_base_velocity and isinstance(one.base, PiecewiseConstantLaw)


Stuck: TypeAlias = tuple[np.ndarray, np.ndarray]
"""When sticks start and end, s, (sticks,) each; those that the horizon cut have no end."""


def sticks_in(one: Simulation, window: Window = (-math.inf, math.inf)) -> Stuck:
    """The sticks that last at some time inside the window, s."""
    mask = np.asarray(one.sticks.mask)
    start, end, ending = (np.asarray(of)[mask] for of in (one.sticks.start, one.sticks.end, one.sticks.ending))
    end = np.where(ending == Ending.HORIZON, math.inf, end)
    shown = (end > window[0]) & (start < window[1])
    return start[shown], end[shown]


def lasts_at(sticks: Stuck, times: np.ndarray) -> np.ndarray:
    """Whether a stick lasts at these times (s), from its start until just before its end; `sticks`: starts and ends."""
    started, ended = (np.searchsorted(events, times, side="right") for events in sticks)
    return started > ended


def phases_of(one: Simulation, window: Window) -> list[Phase]:
    """The phases of the trajectory inside the window (s), in order of time."""
    starts, ends = sticks_in(one)
    knots, round_off = _knots(one, window, np.concatenate([starts, ends]))
    middles = (knots[:-1] + knots[1:]) / 2
    sticks = lasts_at((starts, ends), middles)
    times, numbers = _grid(one, knots, sticks)
    lasts = np.cumsum(numbers + 1) - 1
    firsts = lasts - numbers
    # At the end of a phase the base velocity is that just before a jump. At the ends of the window it is that inside,
    # in case the base jumps there within the round-off.
    base_times = times.copy()
    base_times[lasts] = np.nextafter(times[lasts], times.dtype.type(0))
    base_times[[0, -1]] = times[0] + round_off, times[-1] - round_off
    state = one.evaluate(times)
    bases = one._at(partial(_follow_base, one), jax.device_put(base_times), *state)
    state, others = jax.tree.map(np.asarray, (state, bases))
    velocity = others[0]

    # Cut where the mode changes, where a stick ends and another begins, and where the base velocity jumps.
    jumps = np.abs(velocity[firsts[1:]] - velocity[lasts[:-1]])
    jumped = jumps > 1024 * np.finfo(velocity.dtype).eps * np.max(np.abs(velocity))
    begins = np.concatenate([[True], (sticks[1:] != sticks[:-1]) | np.isin(knots[1:-1], starts) | jumped])
    columns = {"times": times, **dict(enumerate(state))}
    columns |= zip(("base_velocity", "lowest", "highest"), others, strict=True)
    rows = zip(*(np.split(values, firsts[begins][1:]) for values in columns.values()), strict=True)
    return list(map(Phase, (dict(zip(columns, row, strict=True)) for row in rows), sticks[begins].tolist()))


def whole(phases: list[Phase], name: str | int) -> np.ndarray:
    """The values called `name` of all phases, one after the other."""
    return np.concatenate([phase.values[name] for phase in phases])


def joined(phases: list[Phase], name: str | int) -> np.ndarray:
    """The values of all phases one after the other, with a NaN between two, where the line is to break."""
    if not phases:
        return np.zeros(0)
    return np.concatenate([values for phase in phases for values in (phase.values[name], [np.nan])])[:-1]


def _knots(one: Simulation, window: Window, events: np.ndarray) -> tuple[np.ndarray, float]:
    """The window's ends with the events and the starts of time steps between them (s), each once; and the round-off.

    Left out are those that differ from an end only by round-off, and some of the time steps where there are very many.
    """
    # In the simulation's own floating-point type: a jump that ends a stick equals its end to the last bit.
    steps = np.asarray(one.step_starts)
    begin, end = (steps.dtype.type(time) for time in window)
    round_off = float(min(256 * np.finfo(steps.dtype).eps * end, (end - begin) / 4))
    steps, events = (
        np.unique(times[(times > begin + round_off) & (times < end - round_off)]) for times in (steps, events)
    )
    if not has_steady_base(one) and len(steps) > _MOST_POINTS:
        # One of each group of equal size, at a varying place in it, against aliasing of fast oscillations.
        groups = np.arange(_MOST_POINTS)
        steps = steps[((groups + np.modf(groups * 0.618034)[0]) * (len(steps) / _MOST_POINTS)).astype(int)]
    return np.unique(np.concatenate([[begin, end], steps, events]).astype(steps.dtype)), round_off


def _grid(one: Simulation, knots: np.ndarray, sticks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) from each knot to the next in equal parts, and the numbers of these.

    Inner knots stand twice, as an end and a start. `sticks`: whether there is a stick between neighbouring knots.
    """
    numbers = np.full(len(sticks), _POINTS_PER_KNOT)
    if one.system.natural_frequency is not None:
        revolutions = float(one.system.natural_frequency) * np.diff(knots).astype(float) / (2 * np.pi)
        points = np.ceil(np.minimum(_POINTS_PER_REVOLUTION * revolutions, _MOST_POINTS)).astype(int)
        numbers = np.maximum(numbers, points)
    if has_steady_base(one):
        numbers = np.where(sticks, 1, numbers)  # a straight line
    share = _MOST_POINTS / numbers.sum()
    if share < 1:
        numbers = np.maximum(1, (numbers * share).astype(int))
    offsets = np.repeat(np.cumsum(numbers + 1) - (numbers + 1), numbers + 1)
    parts = (np.arange(len(offsets)) - offsets) / np.repeat(numbers, numbers + 1)
    begins, ends = np.repeat(knots[:-1], numbers + 1), np.repeat(knots[1:], numbers + 1)
    return np.where(parts == 1, ends, begins + (ends - begins) * parts).astype(knots.dtype), numbers


@kept_jit
def _follow_base(one: Simulation, times: jax.Array, *state: jax.Array) -> tuple[jax.Array, ...]:
    """The base velocity (m/s), and the ends of the stick band: NaN for a system without one."""
    velocity, acceleration = jax.jvp(one.base_velocity, (times,), (jnp.ones_like(times),))
    ground = 0.0
    if isinstance(one.base, GroundMotion):  # not all know the acceleration of the ground
        shaken = getattr(one.base, "acceleration", None)
        ground = jnp.nan if shaken is None else shaken(times)
    band, nowhere = one.system.look.stick_band, jnp.full_like(times, jnp.nan)
    return velocity, *((nowhere, nowhere) if band is None else band(times, state, velocity, acceleration, ground))


# How much of a long trajectory is drawn, so that its oscillations can be distinguished.


_MOST_TURNS = 80  # of a line across the axes: more make it a black band
_FIRST_TURNS = 40  # are drawn of such a line
_LARGE = 0.25  # of the range of the line: the least way back that counts


def phases_in(one: Simulation, window: Window | None) -> tuple[list[Phase], Window]:
    """The phases to draw, and the window that they are in (s), which is the one given.

    Without one it is all of ``[0, t1]``, or of a motion that turns more than 80 times its beginning.

    Raises:
        ValueError: For a window that is none.
    """
    all_of_it = check_window(window, float(one.time_reached))
    phases = phases_of(one, all_of_it)
    if window is not None:
        return phases, all_of_it
    times, end = whole(phases, "times"), all_of_it[1]
    for coordinate in range(len(one.system.coordinates)):
        values = whole(phases, coordinate)
        turns = times[turns_of(values, _LARGE * float(np.ptp(values)))]
        if len(turns) > _MOST_TURNS:
            # The largest of 1, 2 and 5 times a power of ten that is not after the last turn to draw.
            last = float(turns[_FIRST_TURNS])
            power = 10.0 ** math.floor(math.log10(last))
            end = min(end, next(number * power for number in (5.0, 2.0, 1.0) if number * power <= last * (1 + 1e-12)))
    return (phases, all_of_it) if end == all_of_it[1] else (phases_of(one, (0.0, end)), (0.0, end))


def turns_of(values: np.ndarray, least: float) -> np.ndarray:
    """The numbers of the values (points,) at which a line turns and then goes back by more than `least`."""
    rising = np.sign(np.diff(values))
    moving = np.flatnonzero(rising != 0)
    extremes = moving[1:][rising[moving[1:]] != rising[moving[:-1]]]
    found: list[int] = []
    best, way = 0, 0  # the farthest point since the last turn, and which way the line went
    for place in [*extremes.tolist(), len(values) - 1]:
        change = values[place] - values[best]
        if way * change >= 0 and (way or abs(change) > least):
            best, way = place, way or int(np.sign(change))
        elif way and abs(change) > least:
            found.append(best)
            best, way = place, -way
    return np.array(found, int)


# A motion with several contacts: all coordinates against time, and a row of sticks for each contact.


_POINTS = 4000  # on the whole window, besides events and time steps
_FEW = 4  # lines that have a colour and a name each; of more, the first and the last are named


def contact_rows(ax: Axes, one: Simulation, window: Window) -> None:
    """Draw each stick as a bar, in a row for each contact, and in the last row the times in which all stick."""
    contacts = one.system.tracks.contacts or 1
    rows = [*(one.of_contact(number) for number in range(contacts)), one.of_all_contacts()]
    found = 0
    for row, part in enumerate(rows):
        start, end = sticks_in(part, window)
        found += len(start)
        label = {0: "stick", contacts: "all closed contacts stick"}.get(row)
        corners = _style.sticks_in_rows(np.full(len(start), float(row)), start, np.minimum(end, window[1]))
        color = _style.MASS if row == contacts else _style.STICK
        _style.draw_polygons(ax, corners, facecolor=color, label=label)
    if not found:
        _style.note(ax, "no sticks")
    ax.set_ylim(contacts + 0.5, -0.5)
    numbers = range(0, contacts, -(-contacts // 12))
    ax.set_yticks([*numbers, contacts], [*map(str, numbers), "all"])
    ax.set_ylabel("contact")
    _style.time_axis(ax, window)


def contact_history(one: Simulation, window: Window | None, axes: SeveralAxes | None) -> tuple[Axes, ...]:
    """The figure `time_history` of a simulation with several contacts.

    One panel for the coordinates of each unit, with the base velocity among those of its unit, and one for the sticks.
    """
    shown = check_window(window, float(one.time_reached))
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
            panel.plot(times, base, label="base", **_style.BASE_LINE)
        kinds = {re.sub(r"\s*\d+$", "", name) for name in named}  # "position 0", "position 1", ...
        panel.set_ylabel(_style.quantity_label(kinds.pop() if len(kinds) == 1 else "coordinates", unit))
        _style.time_axis(panel, shown)
    contact_rows(panels[-1], one, shown)
    _style.mark_unfinished(panels[0], one)
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


# The state and what drives it against time.


_VELOCITIES = {"m/s", "rad/s"}
_MOST_SWINGS = 40  # of the band by more than its width: more are needles without a meaning to the eye
_LONG = 12  # letters: after a longer name the symbol goes into a second line


def time_history(
    result: Simulation, *, window: Window | None = None, axes: SeveralAxes | None = None
) -> tuple[Axes, ...]:
    """Draw the state against time, and below it what drives it; sticks are thick and coloured.

    The shaded band shows where friction can hold a stick; it is left out where it moves to and fro too quickly to be
    seen. For a mass and spring without damping and force, on a base of piecewise-constant velocity, it holds the
    positions ``|x| <= mu n / k`` (static friction coefficient mu, normal force n, stiffness k); with them it moves, as
    it does with the base's acceleration. For a `MotorCart` it holds the currents
    ``|motor_constant c| <= mu m g d |sin alpha|``, at which the motor's torque is no larger than that of friction.

    States are as exact as the simulation, at every event and on a fine grid between events.

    Args:
        result: A result of `simulate`, one trajectory. For a mass and spring, the position and the
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
        ValueError: For arguments of another kind.
    """
    check_simulation(result, of_one_contact=False)
    if result._of_all_contacts is not None:
        return contact_history(result, window, axes)
    phases, shown = phases_in(result, window)
    coordinates, on_ground = result.system.coordinates, isinstance(result.base, GroundMotion)
    names, (drive_label, drive) = tuple(coordinate.name for coordinate in coordinates), _drive_of(result)
    base_panel = _base_panel(result)
    if (drive is not None or base_panel == len(names)) and (
        axes is None or len(_style.axes_in(axes)) == len(names) + 1
    ):
        names = (*names, "excitation")
    panels = _style.axes_below_or_new(axes, names, (6.4, 4.6 if len(names) == 2 else 1.8 * len(names) + 0.4))
    _draw_band(panels, result, phases)
    times = whole(phases, "times")
    if base_panel is not None and base_panel < len(panels):
        # Two points are enough where it is constant; at its jumps the line is vertical.
        kept = [slice(None) if np.ptp(phase.values["base_velocity"]) > 0 else [0, -1] for phase in phases]
        base_times, velocities = (
            np.concatenate([phase.values[key][points] for phase, points in zip(phases, kept, strict=True)])
            for key in ("times", "base_velocity")
        )
        panels[base_panel].plot(base_times, velocities, label="ground" if on_ground else "base", **_style.BASE_LINE)
    sticks, look = [phase for phase in phases if phase.sticks], result.system.look
    for number, (panel, coordinate) in enumerate(zip(panels, coordinates, strict=False)):
        panel.plot(times, whole(phases, number), label=look.body_name, **_style.MASS_LINE)
        panel.plot(
            joined(sticks, "times"), joined(sticks, number), label=f"{look.body_name}, stick", **_style.STICK_LINE
        )
        holds_base = look.second_is_base_velocity and number == 1  # which has no symbol then
        label = coordinate._replace(symbol="" if holds_base else coordinate.symbol).label
        label = label.replace(" $", "\n$", 1) if len(coordinate.name) > _LONG else label
        panel.set_ylabel(label + ("\nrelative to ground" if on_ground else ""))
    if base_panel == len(coordinates) < len(panels):
        units = {coordinate.unit for coordinate in coordinates} & _VELOCITIES
        panels[-1].set_ylabel(_style.quantity_label("base velocity", units.pop() if len(units) == 1 else "1"))
    elif drive is not None and len(panels) > len(coordinates):
        panels[-1].plot(times, np.asarray(drive(jnp.asarray(times))), color=_style.BASE, lw=_style.SLIP_WIDTH)
        panels[-1].set_ylabel(drive_label)
    for panel in panels:
        _style.time_axis(panel, shown, float(result.time_reached) if window is None else None)
    _style.mark_unfinished(panels[0], result)
    legend_above(*panels, columns=4)
    return panels


def _drive_of(one: Simulation) -> tuple[str, Callable[[jax.Array], jax.Array] | None]:
    """What drives the system besides the velocity of its base: the name of its axis, and its value; None if nothing."""
    if isinstance(one.base, SourceVoltage):
        return "voltage (V)", one.base.value
    if isinstance(one.base, GroundMotion) and (acceleration := getattr(one.base, "acceleration", None)) is not None:
        return "ground\nacceleration (m/s$^2$)", acceleration
    return "force (N)", getattr(getattr(one.system, "force", None), "value", None)


def _base_panel(one: Simulation) -> int | None:
    """The number of the panel that the base velocity stands in; None where no base moves.

    Of a system of the user's own that is with its only velocity, or else a panel after those of the coordinates.
    """
    if one.system.look.second_is_base_velocity:
        return 1
    if isinstance(one.base, (GroundMotion, SourceVoltage)):
        return None
    units = [coordinate.unit for coordinate in one.system.coordinates]
    velocities = [number for number, unit in enumerate(units) if unit in _VELOCITIES]
    return velocities[0] if len(velocities) == 1 else len(units)


def _draw_band(panels: tuple[Axes, ...], result: Simulation, phases: list[Phase]) -> None:
    """The values at which friction can hold a stick: a band that may change in time."""
    number, symbols = result.system.look.band_coordinate, result.system.look.band_symbols
    times, lowest, highest, state = (whole(phases, name) for name in ("times", "lowest", "highest", number))
    if not np.all(np.isfinite(lowest)) or len(turns_of(lowest, float(np.max(highest - lowest)))) > _MOST_SWINGS:
        return
    panel, look = panels[number], {"color": _style.BAND, "alpha": 0.3, "lw": 0}
    if symbols and np.ptp(lowest) == np.ptp(highest) == lowest[0] + highest[0] == 0:
        panel.axhspan(lowest[0], highest[0], label=rf"stick possible, ${symbols}$", **look)
        return
    limits = panel.dataLim.frozen()
    panel.fill_between(times, lowest, highest, label="stick possible", **look)
    # Of a band much wider than the motion, only the part near the motion is shown.
    panel.dataLim.set(limits)
    width = np.max(highest - lowest)
    shown = max(np.min(lowest), np.min(state) - width), min(np.max(highest), np.max(state) + width)
    panel.update_datalim([(times[0], shown[0]), (times[-1], shown[1])])


# Energies against time: what is stored, supplied and dissipated.


_ENERGY_POINTS = 2000
_SUPPLIED, _DISSIPATED = ("-", "-."), ("--", ":", (0, (3, 1, 1, 1, 1, 1)))


def energies(result: Simulation, *, window: Window | None = None, axes: SeveralAxes | None = None) -> tuple[Axes, Axes]:
    """Draw the stored energies, and what was supplied and dissipated since the start, against time; sticks are shaded.

    Energies that are zero all the time, such as the damping of a system without a damper, are left out.

    Args:
        result: A result of `simulate`, one trajectory, whose `Simulation.energies` are known.
        window: First and last time to draw, s; by default as in `time_history`.
        axes: Two, for the stored energies and for those supplied and dissipated; by default those of a new figure, one
            below the other.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind, and as `Simulation.energies`.
    """
    check_simulation(result)
    _, (begin, end) = phases_in(result, window)
    upper, lower = _style.axes_below_or_new(axes, ("stored", "supplied and dissipated"), (6.4, 5.2))
    starts, ends = sticks_in(result, (begin, end))
    events = np.clip(np.concatenate([starts, ends]), begin, end)
    times = np.union1d(np.linspace(begin, end, _ENERGY_POINTS), events)
    found = result.energies(times)
    for number, (name, values) in enumerate(found.stored.items()):
        look = {"color": _style.SERIES[number], "ls": ("-", "-.")[number % 2], "lw": _style.SLIP_WIDTH}
        upper.plot(times, values, label=name, **look)
    total = np.sum([np.asarray(values) for values in found.stored.values()], axis=0)
    upper.plot(times, total, label="sum", **_style.REFERENCE)
    # What the load consists of: an external force, the inertia of a mass on moving ground, or both.
    parts = ["force"] * (getattr(result.system, "force", None) is not None)
    parts += ["ground motion"] * isinstance(result.base, GroundMotion)
    kinds = {"supplied by": (found.supplied, _SUPPLIED), "dissipated by": (found.dissipated, _DISSIPATED)}
    colors = iter(_style.SERIES)
    for words, (terms, styles) in kinds.items():
        left = iter(styles)
        for name, values in terms.items():
            if np.any(np.asarray(values) != 0):
                label = f"{words} {(' and '.join(parts) or name) if name == 'load' else name}"
                look = {"color": next(colors), "ls": next(left), "lw": 1.5 * _style.SLIP_WIDTH}
                lower.plot(times, values, label=label, **look)
    upper.set_ylabel("stored energy (J)")
    lower.set_ylabel("energy since the start (J)")
    for panel in (upper, lower):
        for first, last in zip(starts, ends, strict=True):
            panel.axvspan(max(first, begin), min(last, end), color=_style.STICK, alpha=0.25, lw=0, label="stick")
        _style.time_axis(panel, (begin, end), float(result.time_reached) if window is None else None)
        legend_above(panel, columns=4)
    _style.mark_unfinished(upper, result)
    return upper, lower


# The friction force over time, over the relative velocity, and over the slip: a hysteresis loop.


_OVER = {"time": "", "relative velocity": "m/s", "slip": "m"}


def friction_force(
    result: Simulation, *, over: str = "time", window: Window | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the friction force over time, over the relative velocity, or over the slip; sticks are thick and coloured.

    Over the slip it makes hysteresis loops, whose area is the energy that friction dissipates; the legend gives it, for
    the part of the motion that is drawn.

    Args:
        result: A result of `simulate`, one trajectory whose `Simulation.friction_force` is known.
        over: "time"; "relative velocity" (m/s), which shows the friction law as the motion runs through it; or "slip"
            (m), the way of the mass relative to the base since the first time that is drawn.
        window: First and last time to draw, s, for instance the last period only; by default, over time as in
            `time_history`, else all of ``[0, t1]``.
        ax: Where to draw; by default the axes of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: For arguments of another kind, and as `Simulation.friction_force`.
    """
    check_simulation(result)
    checks.chosen("over", over, list(_OVER))
    all_of_it = check_window(window, float(result.time_reached))
    phases, shown = phases_in(result, window) if over == "time" else (phases_of(result, all_of_it), all_of_it)
    times, numbers = whole(phases, "times"), [len(phase.values["times"]) for phase in phases]
    before, last = times.copy(), np.cumsum(numbers) - 1
    before[last] = np.nextafter(times[last], times.dtype.type(0))  # just before a jump of the force at an event
    # Simpson's rule from each point to the next: the middles follow the points.
    lengths = np.diff(times)
    instants = np.concatenate([before, times[:-1] + lengths / 2])
    force, velocity = (np.asarray(at(instants), float) for at in (result.friction_force, result.relative_velocity))

    def steps(values: np.ndarray) -> np.ndarray:
        ends, middles = values[: len(times)], values[len(times) :]
        return lengths * (ends[:-1] + 4 * middles + ends[1:]) / 6

    slip, lost = np.concatenate([[0.0], np.cumsum(steps(velocity))]), -np.sum(steps(force * velocity))
    force, velocity = force[: len(times)], velocity[: len(times)]
    x = {"time": times, "relative velocity": velocity, "slip": slip}[over]
    ax = _style.axes_or_new(ax, (6.4, 3.2) if over == "time" else (5.0, 4.2))
    # Whole, so that jumps of the force are seen, sticks over it; but no line goes where the relative velocity jumps.
    leaps = np.abs(np.diff(velocity)) > 1e-6 * float(np.ptp(velocity))
    breaks = last[:-1][leaps[last[:-1]]] + 1 if over == "relative velocity" else []
    ax.plot(*(np.insert(values, breaks, np.nan) for values in (x, force)), label="slip", **_style.MASS_LINE)
    sticks = np.repeat([phase.sticks for phase in phases], numbers)
    gaps = np.flatnonzero(sticks[1:] & ~sticks[:-1]) + 1
    drawn = (np.insert(np.where(sticks, values, np.nan), gaps, np.nan) for values in (x, force))
    if np.any(sticks):
        ax.plot(*drawn, label="stick", marker="o", ms=_style.STICK_WIDTH, mew=0, **_style.STICK_LINE)
    if over == "slip":
        ax.fill(x, force, color=_style.BAND, alpha=0.25, lw=0, zorder=0)
        if isinstance(result.method, Exact):
            with suppress(ValueError):  # energies of a `MotorCart` with the printed equation are not known
                lost = float(np.diff(result.energies(np.array(all_of_it)).dissipated["friction"])[0])
        ax.plot([], [], ls="none", label=f"energy lost: {lost:.4g} J")
    ax.set_ylabel("friction force (N)")
    if over == "time":
        _style.time_axis(ax, shown, float(result.time_reached) if window is None else None)
    else:
        ax.set_xlabel(_style.quantity_label(over, _OVER[over]))
    _style.mark_unfinished(ax, result)
    legend_above(ax)
    return ax


# Phase portraits: velocity against position, or angular velocity against angle.


_POSITION, _SCALED = "position", "position_times_omega"
_SLIPS = {1: "slip, base forward", -1: "slip, base backward", 0: "slip, base at rest"}
# On a base at rest a stick is a point, which is visible by markers at its ends, as wide as the line.
_LOOKS: dict[str, dict[str, Any]] = {
    _SLIPS[1]: {"color": _style.FORWARD, "lw": _style.SLIP_WIDTH},
    _SLIPS[-1]: {"color": _style.BACKWARD, "lw": _style.SLIP_WIDTH},
    _SLIPS[0]: {"color": _style.AT_REST, "lw": _style.SLIP_WIDTH},
    "slip": {"color": _style.EITHER_WAY, "lw": _style.SLIP_WIDTH},
    "stick": {"color": _style.STICK, "lw": _style.STICK_WIDTH, "marker": "o", "ms": _style.STICK_WIDTH, "mew": 0},
}


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
        result: A result of `simulate`, one trajectory.
        window: First and last time to draw, s, for instance the last period only; all of ``[0, t1]`` by default.
        x: Name of the coordinate on the abscissa, such as "angle", or "position 1" of a structure; by
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
        ValueError: For arguments of another kind.
    """
    check_simulation(result)
    window = check_window(window, float(result.time_reached))
    chosen = _chosen(result, x, y)
    first, second = (result.system.coordinates[number] for number in chosen)
    has_circles = chosen == (0, 1) and not first.period and result.system.natural_frequency is not None
    choices = (_POSITION, _SCALED) if has_circles else (_POSITION,)
    if abscissa not in choices:
        demand = f"be {' or '.join(map(repr, choices))} for a {type(result.system).__name__}"
        raise checks.refused("abscissa", demand, abscissa)
    checks.truth("energy_regions", energy_regions)
    if energy_regions and not (has_steady_base(result) and chosen == (0, 1)):
        raise ValueError(
            "Argument energy_regions must be False unless a mass and spring moves on a base of piecewise-constant "
            "velocity and its velocity is drawn against its position, but True was given for a "
            f"{type(result.system).__name__} on {checks.show(result.base)}, {second.name} against {first.name}."
        )
    ax = _style.axes_or_new(ax, (5.0, 4.6))
    phases = phases_of(result, window)
    if energy_regions:
        for velocity in set(np.unique([phase.values["base_velocity"][0] for phase in phases])) - {0}:
            ax.axhspan(0, velocity, color=_style.FED, alpha=0.25, lw=0, label="friction feeds energy in")
    scale = float(result.system.natural_frequency) if abscissa == _SCALED and result.system.natural_frequency else 1.0
    _draw_phases(ax, result, phases, chosen, scale)
    whose = " relative to ground" if isinstance(result.base, GroundMotion) and not first.period else ""
    if abscissa == _SCALED:
        ax.set_xlabel(f"{first.name}{whose} times frequency $\\omega {first.symbol}$ (m/s)")
        ax.set_aspect("equal", adjustable="datalim")
    elif first.period:
        ax.set_xlabel(first.labeled(f" modulo {_style.angle_axis(ax, first.period)}"))
    else:
        ax.set_xlabel(first.labeled(whose))
    ax.set_ylabel(second.labeled(whose))
    _style.mark_unfinished(ax, result)
    legend_above(ax, columns=2)
    return ax


def _chosen(one: Simulation, x: str | None, y: str | None) -> tuple[int, int]:
    """The numbers of the coordinates called `x` and `y`, by default the first two."""
    names = [coordinate.name for coordinate in one.system.coordinates]
    for argument, name in (("x", x), ("y", y)):
        if name is not None and name not in names:
            demand = f"be the name of a coordinate of the {type(one.system).__name__}, one of "
            raise checks.refused(argument, demand + ", ".join(map(repr, names)), name)
    chosen = 0 if x is None else names.index(x), 1 if y is None else names.index(y)
    if chosen[0] == chosen[1]:
        given = f"x={checks.show(x)}" if y is None else f"y={checks.show(y)}"
        raise ValueError(
            f"Arguments x and y must be two different coordinates, but {names[chosen[0]]!r} is both with {given}; "
            f"give both, of {', '.join(map(repr, names))}."
        )
    return chosen


def _draw_phases(ax: Axes, one: Simulation, phases: list[Phase], pair: tuple[int, int], scale: float) -> None:
    """One coordinate, times `scale` or modulo its period, against the other."""
    period, steady = one.system.coordinates[pair[0]].period, has_steady_base(one)
    kinds: dict[str, list[Phase]] = {}
    for phase in phases:
        slip = _SLIPS.get(np.sign(phase.values["base_velocity"][0]), "") if steady and not period else "slip"
        # Of an angle, sticks in which neither changes are points.
        is_point = period and phase.sticks and all(np.ptp(phase.values[number]) == 0 for number in pair)
        kinds.setdefault("point" if is_point else "stick" if phase.sticks else slip, []).append(phase)
    for label, look in _LOOKS.items():
        if label in kinds:
            x, y = (joined(kinds[label], number) for number in pair)
            sizes = np.array([len(phase.values["times"]) for phase in kinds[label]])
            ends = np.cumsum(sizes + 1) - 2
            starts = ends + 1 - sizes
            marked = None if period else np.union1d(starts, ends).tolist()
            ax.plot(*(_wrapped(x, y, period) if period else (scale * x, y)), label=label, markevery=marked, **look)
    if period and "point" in kinds:
        angles, speeds = np.transpose([[phase.values[number][0] for number in pair] for phase in kinds["point"]])
        look = {"ls": "none", "marker": "o", "ms": 5, "mew": 0, "color": _style.STICK, "clip_on": False}
        ax.plot(np.mod(angles, period), speeds, label="stick", **look)
    center = one.system.look.slip_center
    if center is not None and not period and not isinstance(one.base, GroundMotion) and pair == (0, 1):
        ways = {np.sign(phase.values["base_velocity"][0]) for phase in phases} if steady else set()
        directions = np.array(list(ways) if len(ways) == 1 and 0 not in ways else [-1.0, 1.0])
        label = r"centres, $x = \pm \mu n/k$" if len(directions) > 1 else r"centre, $x = \mu n/k\,\mathrm{sgn}\,v$"
        look = {"ls": "none", "marker": "x", "ms": 8, "mew": 2, "color": _style.BASE}
        ax.plot(scale * float(center) * directions, 0 * directions, label=label, **look)


def _wrapped(angle: np.ndarray, speed: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """A line with its angle modulo `period`; where the angle leaves a period, the line goes to the edge and breaks."""
    count = np.floor(angle / period)
    at = np.flatnonzero(np.abs(np.diff(count)) > 0)  # NaN, where the line is broken already, compares false
    edge = period * np.maximum(count[at], count[at + 1])
    part = (edge - angle[at]) / (angle[at + 1] - angle[at])
    between = speed[at] + part * (speed[at + 1] - speed[at])
    forward = count[at + 1] > count[at]
    leaving, entering = np.where(forward, period, 0), np.where(forward, 0, period)
    places, gap = np.repeat(at + 1, 3), np.full(len(at), np.nan)
    x = np.insert(angle - period * count, places, np.ravel([leaving, gap, entering], "F"))
    return x, np.insert(speed, places, np.ravel([between, gap, between], "F"))
