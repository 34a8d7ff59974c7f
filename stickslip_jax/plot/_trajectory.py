"""A simulated trajectory cut into phases at its events, so that sticks are drawn exactly where they happen."""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._excitation.ground import GroundMotion
from .._excitation.piecewise_constant import PiecewiseConstantLaw, VelocitySteps
from .._forks import require_threads_of_jax
from .._simulation.result import Simulation
from .._status import Status
from ._types import Window

_POINTS_PER_REVOLUTION = 180  # two degrees of a slip arc: its chord leaves the circle by 0.02 % of the radius
_POINTS_PER_KNOT = 6  # at least; a time step of the simulation is 1/16 of the shortest period or less
_MOST_POINTS = 100_000
_SMALLEST_BUFFER = 8192


class Phase(NamedTuple):
    """The trajectory between two neighbouring events: all slip or all stick, without a jump of the base velocity.

    Arrays (points,): `times` in s; `state` in the units of the system's coordinates; `base_velocity` in m/s; `lowest`
    and `highest` value at which friction can hold a stick (`System.stick_band`). At inner knots a time stands twice.
    """

    times: np.ndarray
    state: tuple[np.ndarray, ...]
    base_velocity: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    sticks: bool


def check_simulation(result: Simulation, *, of_one_contact: bool = True) -> None:
    """Raise ValueError unless `result` is a single simulation that reached ``t1``, and not traced by JAX.

    `of_one_contact`: whether its sticks must be those of one contact.
    """
    require_threads_of_jax()
    if not isinstance(result, Simulation):
        raise ValueError(
            f"Argument result must be a result of simulate, but {_checks.show(result)} was given; sample i of an "
            "ensemble is simulated with its base motion and initial state, ensemble.realization(i)."
        )
    if _checks.holds_traced(result):
        raise ValueError(
            "Argument result must hold numbers, but one traced by a JAX transformation was given; draw the figure "
            "outside jit, vmap and grad."
        )
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
        raise ValueError(
            f"Argument result must have the sticks of one contact, but {_checks.show(result)} was given; take "
            "result.of_contact(number) or result.of_all_contacts()."
        )


def check_window(window: Window | None, t1: float) -> Window:
    """The window to draw, s; all of ``[0, t1]`` if `window` is None. Raises ValueError if it is not part of that."""
    if window is None:
        return 0.0, t1
    begin = end = math.nan
    with suppress(TypeError, ValueError):
        begin, end = (float(time) for time in window)
    if not 0 <= begin < end <= t1:
        raise ValueError(
            f"Argument window must be two times (in s) with 0 <= t_a < t_b <= t1 = {t1:g}, but {_checks.show(window)} "
            "was given."
        )
    return begin, end


def ground_acceleration(base: GroundMotion) -> Callable[[jax.Array], jax.Array] | None:
    """The acceleration of the ground to which the coordinates are relative, m/s^2; None where it is not known."""
    return getattr(base, "acceleration", None)


def has_steady_base(one: Simulation) -> bool:
    """Whether the mass rubs on a base whose velocity is constant between jumps."""
    return one.system.sticks_at_base_velocity and isinstance(one.base, (VelocitySteps, PiecewiseConstantLaw))


def phases_of(one: Simulation, window: Window) -> list[Phase]:
    """The phases of the trajectory inside the window (s), in order of time."""
    mask = np.asarray(one.sticks.mask)
    starts, ends = (np.asarray(times)[mask] for times in (one.sticks.start, one.sticks.end))
    knots, round_off = _knots(one, window, np.concatenate([starts, ends]))
    middles = (knots[:-1] + knots[1:]) / 2
    sticks = np.searchsorted(starts, middles, side="right") > np.searchsorted(ends, middles, side="right")
    numbers = _numbers(one, np.diff(knots), sticks)
    times = _grid(knots, numbers)
    lasts = np.cumsum(numbers + 1) - 1
    firsts = lasts - numbers
    # At the end of a phase the base velocity is that just before a jump. At the ends of the window it is that inside,
    # in case the base jumps there within the round-off.
    base_times = times.copy()
    base_times[lasts] = np.nextafter(times[lasts], times.dtype.type(0))
    base_times[[0, -1]] = times[0] + round_off, times[-1] - round_off
    state, *others = _follow(one, times, base_times)
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


def _numbers(one: Simulation, lengths: np.ndarray, sticks: np.ndarray) -> np.ndarray:
    """How many parts to divide the time between neighbouring knots into, which lasts `lengths` (s)."""
    numbers = np.full(len(lengths), _POINTS_PER_KNOT)
    if one.system.natural_frequency is not None:
        revolutions = float(one.system.natural_frequency) * lengths.astype(float) / (2 * np.pi)
        numbers = np.maximum(
            numbers, np.ceil(np.minimum(_POINTS_PER_REVOLUTION * revolutions, _MOST_POINTS)).astype(int)
        )
    if has_steady_base(one):
        numbers = np.where(sticks, 1, numbers)  # a straight line
    share = _MOST_POINTS / numbers.sum()
    return numbers if share >= 1 else np.maximum(1, (numbers * share).astype(int))


def _grid(knots: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Times (s) from each knot to the next in `numbers` equal parts; inner knots stand twice, as an end and a start."""
    offsets = np.repeat(np.cumsum(numbers + 1) - (numbers + 1), numbers + 1)
    parts = (np.arange(len(offsets)) - offsets) / np.repeat(numbers, numbers + 1)
    begins, ends = np.repeat(knots[:-1], numbers + 1), np.repeat(knots[1:], numbers + 1)
    return np.where(parts == 1, ends, begins + (ends - begins) * parts).astype(knots.dtype)


def _follow(one: Simulation, times: np.ndarray, base_times: np.ndarray) -> tuple[Any, ...]:
    """The state at `times` (s); at `base_times` the base velocity (m/s) and the ends of the stick band."""
    filled, base_filled = padded(one, times), padded(one, base_times)
    state = one.evaluate(filled)
    followed = (state, *_follow_base(one, base_filled, state))
    return jax.tree.map(lambda values: np.asarray(values)[: len(times)], followed)


def padded(one: Simulation, times: np.ndarray) -> jax.Array:
    """`times` (s), the last one repeated until their number is a power of two, so that few sizes are compiled."""
    buffer = max(_SMALLEST_BUFFER, 1 << int(np.ceil(np.log2(len(times)))))
    return jnp.asarray(np.concatenate([times, np.full(buffer - len(times), times[-1])]), one.sticks.start.dtype)


@jax.jit
def _follow_base(one: Simulation, times: jax.Array, state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
    """The base velocity (m/s), and the ends of the stick band: NaN for a system without one."""
    velocity, acceleration = jax.jvp(one.base_velocity, (times,), (jnp.ones_like(times),))
    ground = 0.0
    if isinstance(one.base, GroundMotion):
        shaken = ground_acceleration(one.base)
        ground = jnp.nan if shaken is None else shaken(times)
    return velocity, *one.system.stick_band(times, state, velocity, acceleration, ground)
