"""A simulated trajectory cut into pieces at its events, so that sticks are drawn exactly where they happen."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._status import Status
from ..simulate import Simulation

_POINTS_PER_TURN = 180  # two degrees of a slip arc: its chord leaves the circle by 0.02 % of the radius
_MOST_POINTS = 100_000

_evaluate = jax.jit(Simulation.evaluate)


class Piece(NamedTuple):
    """The trajectory between two neighbouring events: all slip or all stick, on one base velocity.

    Arrays (points,): `times` in s, `position` in m, `velocity` in m/s. `base_velocity` in m/s.
    """

    times: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    base_velocity: float
    sticks: bool


def check_simulation(one: Any) -> None:
    """Check that `one` is a single finished simulation with known numbers; raises ValueError otherwise."""
    if not isinstance(one, Simulation):
        raise ValueError(f"Argument one must be a result of simulate, but {one!r} was given.")
    if any(_checks.is_traced(leaf) for leaf in jax.tree.leaves(one)):
        raise ValueError("Argument one must hold numbers, but one traced by a JAX transformation was given.")
    if np.ndim(one.status) > 0:
        raise ValueError(
            f"Argument one must hold one trajectory, but a batch of shape {np.shape(one.status)} was given; "
            "take one out with jax.tree.map(lambda values: values[i], batch)."
        )
    if one.status != Status.FINISHED:
        raise ValueError(
            f"Argument one must have reached t1, but one with this status was given: {Status(int(one.status)).meaning}."
        )


def check_window(one: Simulation, window: Any) -> tuple[float, float]:
    """The window to draw, s; all of ``[0, t1]`` if `window` is None. Raises ValueError if it is not part of that."""
    t1 = float(one.t1)
    if window is None:
        return 0.0, t1
    try:
        begin, end = (float(time) for time in window)
        inside = 0 <= begin < end <= t1
    except (TypeError, ValueError):
        inside = False
    if not inside:
        raise ValueError(
            f"Argument window must be two times (in s) with 0 <= t_a < t_b <= t1 = {t1:g}, but {window!r} was given."
        )
    return begin, end


def pieces_of(one: Simulation, window: tuple[float, float]) -> list[Piece]:
    """The pieces of the trajectory inside the window (s), in order of time."""
    mask = np.asarray(one.sticks.mask)
    starts, ends = (np.asarray(times)[mask] for times in (one.sticks.start, one.sticks.end))
    # As the simulation counted time: a jump that ends a stick is the same instant as its end, to the last bit.
    switches = np.asarray(one.switching_times)
    cuts = _cuts(window, np.concatenate([starts, ends, switches]))
    middles = (cuts[:-1] + cuts[1:]) / 2
    sticks = np.searchsorted(starts, middles, side="right") > np.searchsorted(ends, middles, side="right")
    base_velocities = np.asarray(one.base.velocities)[np.searchsorted(switches, middles, side="right") - 1]
    grids = _grids(cuts, sticks, float(one.system.angular_frequency))
    position, velocity = _states(one, np.concatenate(grids))
    splits = np.cumsum([len(grid) for grid in grids])[:-1]
    rows = zip(grids, np.split(position, splits), np.split(velocity, splits), base_velocities, sticks, strict=True)
    return [Piece(times, x, v, float(base), bool(stuck)) for times, x, v, base, stuck in rows]


def joined(pieces: list[Piece], name: str) -> np.ndarray:
    """The values `name` of all pieces one after the other, with a NaN between them where the line is to break."""
    if not pieces:
        return np.zeros(0)
    return np.concatenate([values for piece in pieces for values in (getattr(piece, name), [np.nan])])[:-1]


def _cuts(window: tuple[float, float], events: np.ndarray) -> np.ndarray:
    """The window's ends and the events between them, s; events on an end but for round-off are left out."""
    begin, end = window
    round_off = min(256 * float(np.finfo(events.dtype).eps) * end, (end - begin) / 4)
    inside = events[(events > begin + round_off) & (events < end - round_off)]
    return np.unique(np.concatenate([window, inside]))


def _grids(cuts: np.ndarray, sticks: np.ndarray, omega: float) -> list[np.ndarray]:
    """Times (s) at which to evaluate each piece, both ends included; a stick is a straight line between its ends."""
    step = max(2 * np.pi / _POINTS_PER_TURN, omega * (cuts[-1] - cuts[0]) / _MOST_POINTS)
    numbers = np.where(sticks, 2, np.ceil(omega * np.diff(cuts) / step).astype(int) + 1)
    return [np.linspace(a, b, max(2, n)) for a, b, n in zip(cuts[:-1], cuts[1:], numbers, strict=True)]


def _states(one: Simulation, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (m) and velocity (m/s) at `times` (s). Filled up to a power of two, so that few sizes are compiled."""
    room = 1 << int(np.ceil(np.log2(len(times))))
    filled = np.concatenate([times, np.full(room - len(times), times[-1])])
    position, velocity = _evaluate(one, jnp.asarray(filled, one.sticks.start.dtype))
    return np.asarray(position)[: len(times)], np.asarray(velocity)[: len(times)]
