"""A simulated trajectory cut into phases at its events, so that sticks are drawn exactly where they are."""

import math
from contextlib import suppress
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._dynamics.simulation import Simulation
from .._ensemble.result import Ensemble
from .._excitation.piecewise_constant import PiecewiseConstantLaw
from .._excitation.recorded import GroundMotion
from .._foundation import checks
from .._foundation.processes import require_threads_of_jax
from .._foundation.types import Ending, Status
from .._statistics.quantities import FirstSticks
from ._style import Bins, SimulatedSticks, Window

# A simulated trajectory cut into phases at its events, so that sticks are drawn exactly where they happen.


_POINTS_PER_REVOLUTION = 180  # two degrees of a slip arc: its chord leaves the circle by 0.02 % of the radius
_POINTS_PER_KNOT = 6  # at least; a time step of the simulation is 1/16 of the shortest period or less
_MOST_POINTS = 100_000
_SMALLEST_BUFFER = 8192


class Phase(NamedTuple):
    """The trajectory between two neighbouring events: all slip or all stick, without a jump of the base velocity.

    Arrays (points,): `times` in s; `state` in the units of the system's coordinates; `base_velocity` in m/s; `lowest`
    and `highest` value at which friction can hold a stick (`Look.stick_band`). At inner knots a time stands twice.
    """

    times: np.ndarray
    state: tuple[np.ndarray, ...]
    base_velocity: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    sticks: bool


_TRACED = (
    "Argument result must hold numbers, but one traced by a JAX transformation was given; draw the figure outside jit, "
    "vmap and grad."
)


def check_simulation(result: Simulation, *, of_one_contact: bool = True) -> None:
    """Raise ValueError unless `result` is a single simulation that reached ``t1``, and not traced by JAX.

    `of_one_contact`: whether its sticks must be those of one contact.
    """
    require_threads_of_jax()
    if not isinstance(result, Simulation):
        hint = "sample i of an ensemble is simulated with its base motion and initial state, ensemble.realization(i)"
        raise checks.refused("result", "be a result of simulate", result, hint)
    if checks.holds_traced(result):
        raise ValueError(_TRACED)
    if np.ndim(result.status) > 0:
        raise ValueError(
            f"Argument result must hold one trajectory, but a batch of shape {np.shape(result.status)} was given; "
            "take one out with jax.tree.map(lambda values: values[i], batch)."
        )
    if result.status != Status.FINISHED:
        raise ValueError(
            "Argument result must have reached t1, but one with this status was given: "
            f"{Status(int(result.status)).meaning}."
        )
    if of_one_contact:
        require_one_contact(result)


def require_one_contact(result: Simulation) -> None:
    """Raise ValueError for a simulation with the sticks of several contacts."""
    if result.sticks.contact is not None:
        hint = "take result.of_contact(number) or result.of_all_contacts()"
        raise checks.refused("result", "have the sticks of one contact", result, hint)


def check_window(window: Window | None, t1: float) -> Window:
    """The window to draw, s; all of ``[0, t1]`` if `window` is None. Raises ValueError if it is not part of that."""
    if window is None:
        return 0.0, t1
    begin = end = math.nan
    with suppress(TypeError, ValueError):
        begin, end = (float(time) for time in window)
    if not 0 <= begin < end <= t1:
        raise checks.refused("window", f"be two times (in s) with 0 <= t_a < t_b <= t1 = {t1:g}", window)
    return begin, end


def has_steady_base(one: Simulation) -> bool:
    """Whether the mass rubs on a base whose velocity is constant between jumps."""
    return one.system.look.second_is_base_velocity and isinstance(one.base, PiecewiseConstantLaw)


def sticks_in(one: Simulation, window: Window) -> tuple[np.ndarray, np.ndarray]:
    """When the sticks start and end that last at some time inside the window, s."""
    mask = np.asarray(one.sticks.mask)
    start, end = (np.asarray(times)[mask] for times in (one.sticks.start, one.sticks.end))
    shown = (end > window[0]) & (start < window[1])
    return start[shown], end[shown]


def phases_of(one: Simulation, window: Window) -> list[Phase]:
    """The phases of the trajectory inside the window (s), in order of time."""
    starts, ends = sticks_in(one, (-math.inf, math.inf))
    knots, round_off = _knots(one, window, np.concatenate([starts, ends]))
    middles = (knots[:-1] + knots[1:]) / 2
    sticks = np.searchsorted(starts, middles, side="right") > np.searchsorted(ends, middles, side="right")
    times, numbers = _grid(one, knots, sticks)
    lasts = np.cumsum(numbers + 1) - 1
    firsts = lasts - numbers
    # At the end of a phase the base velocity is that just before a jump. At the ends of the window it is that inside,
    # in case the base jumps there within the round-off.
    base_times = times.copy()
    base_times[lasts] = np.nextafter(times[lasts], times.dtype.type(0))
    base_times[[0, -1]] = times[0] + round_off, times[-1] - round_off
    followed = one.evaluate(padded(one, times))
    bases = _follow_base(one, padded(one, base_times), followed)
    state, others = jax.tree.map(lambda values: np.asarray(values)[: len(times)], (followed, bases))
    velocity = others[0]

    # Cut where the mode changes, where a stick ends and another begins, and where the base velocity jumps.
    jumps = np.abs(velocity[firsts[1:]] - velocity[lasts[:-1]])
    jumped = jumps > 1024 * np.finfo(velocity.dtype).eps * np.max(np.abs(velocity))
    begins = np.concatenate([[True], (sticks[1:] != sticks[:-1]) | np.isin(knots[1:-1], starts) | jumped])
    parts = [np.split(values, firsts[begins][1:]) for values in (times, *state, *others)]
    rows = zip(*parts, sticks[begins], strict=True)
    size = len(state)
    return [Phase(row[0], row[1 : 1 + size], *row[1 + size : -1], sticks=bool(row[-1])) for row in rows]


def values_of(phase: Phase, name: str | int) -> np.ndarray:
    """The values of a phase called `name`, or of the coordinate with that number; (points,)."""
    return phase.state[name] if isinstance(name, int) else getattr(phase, name)


def joined(phases: list[Phase], name: str | int) -> np.ndarray:
    """The values of all phases one after the other, with a NaN between two, where the line is to break."""
    if not phases:
        return np.zeros(0)
    return np.concatenate([values for phase in phases for values in (values_of(phase, name), [np.nan])])[:-1]


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


def padded(one: Simulation, times: np.ndarray) -> jax.Array:
    """`times` (s), the last one repeated until their number is a power of two, so that few sizes are compiled."""
    buffer = max(_SMALLEST_BUFFER, 1 << int(np.ceil(np.log2(len(times)))))
    return jnp.asarray(np.concatenate([times, np.full(buffer - len(times), times[-1])]), one.sticks.start.dtype)


@jax.jit
def _follow_base(one: Simulation, times: jax.Array, state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
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
    whole = check_window(window, float(one.t1))
    phases = phases_of(one, whole)
    if window is not None:
        return phases, whole
    times = np.concatenate([phase.times for phase in phases])
    end = whole[1]
    for coordinate in range(len(phases[0].state)):
        values = np.concatenate([values_of(phase, coordinate) for phase in phases])
        turns = times[turns_of(values, _LARGE * float(np.ptp(values)))]
        if len(turns) > _MOST_TURNS:
            # The largest of 1, 2 and 5 times a power of ten that is not after the last turn to draw.
            last = float(turns[_FIRST_TURNS])
            power = 10.0 ** math.floor(math.log10(last))
            end = min(end, next(number * power for number in (5.0, 2.0, 1.0) if number * power <= last * (1 + 1e-12)))
    return (phases, whole) if end == whole[1] else (phases_of(one, (0.0, end)), (0.0, end))


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


# The complete sticks of a result, one by one: their durations and the positions at which they begin.


class CompleteSticks(NamedTuple):
    """Sticks whose end was seen, in samples that reached ``t1``; arrays (sticks,).

    - `duration`: s. `position`: where they begin, m (of a motor its angle, rad).
    - `cut`: how many more the horizon cut short.
    - `part`: for legends, of which samples the sticks are, where not of all.
    """

    duration: np.ndarray
    position: np.ndarray
    cut: int
    part: str = ""

    @property
    def label(self) -> str:
        """How many there are, for legends."""
        more = f" ({self.cut:,} more, cut by the horizon, left out)" if self.cut else ""
        return (f"{len(self.duration):,} sticks" if len(self.duration) else "no sticks") + self.part + more


def require_ensemble(result: Ensemble | Simulation) -> Ensemble:
    """`result` itself. Raises ValueError unless it is an ensemble."""
    if not isinstance(result, Ensemble):
        raise checks.refused("result", "be an Ensemble", result, "give the result of simulate_ensemble")
    return result


def complete_sticks(result: SimulatedSticks, *, also: str = "") -> CompleteSticks:
    """The complete sticks of a `Simulation`, one or a batch, of an `Ensemble`, those that it kept, or of `FirstSticks`.

    `also`: what else the figure takes, for the message.

    Raises:
        ValueError: For anything else, and for an ensemble with ``keep="totals"``.
    """
    part = ""
    if isinstance(result, Ensemble):
        sticks = result.numbered_sticks()
        used, duration = np.ones(len(sticks.start), bool), sticks.duration
        part = f" of the first {len(sticks.count):,} samples" if len(sticks.count) < result.finished else ""
    elif isinstance(result, FirstSticks):
        sticks, used, duration = result, result.mask, result.duration
    elif isinstance(result, Simulation):
        require_one_contact(result)
        sticks = result.sticks
        if any(checks.is_traced(leaf) for leaf in (sticks.mask, result.status)):
            raise ValueError(_TRACED)
        used = np.asarray(sticks.mask) & (np.asarray(result.status) == Status.FINISHED)[..., None]
        duration = np.asarray(sticks.duration)
    else:
        demand = f"be a result of simulate_ensemble or of simulate, or of first_stick{also}"
        raise checks.refused("result", demand, result)
    cut = np.asarray(sticks.ending) == Ending.HORIZON
    kept = used & ~cut
    duration, position = (np.asarray(values, float)[kept] for values in (duration, sticks.position))
    return CompleteSticks(duration, position, int(np.sum(used & cut)), part)


def edges_of_bins(name: str, bins: Bins, span: tuple[float, float], unit: str) -> np.ndarray:
    """The edges of `bins`, (bins + 1,): so many of equal width over `span`, or the increasing edges given.

    `name` of the argument and `unit` are for the message.

    Raises:
        ValueError: For anything else.
    """
    if np.ndim(bins) == 0:
        return np.linspace(*span, checks.whole_number(name, bins) + 1)
    checks.numeric(name, bins, ndim=1)
    edges = np.asarray(bins, float)
    if len(edges) < 2 or np.any(np.diff(edges) <= 0):
        raise checks.refused(name, f"be a whole number or increasing edges (in {unit})", bins)
    return edges


def outside(label: str, number: int) -> str:
    """`label` with a line on how many sticks lie outside the bins, if any do."""
    return f"{label}\n{number:,} of them outside the bins" if number else label
