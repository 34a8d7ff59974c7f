"""What the search for a periodic orbit begins with, and what is read from what it found."""

from typing import Any

import numpy as np

from .. import _checks
from .._dynamics.common.method import Exact
from .._dynamics.common.time_scales import slowest_time
from .._excitation.excitation import BaseMotion
from .._simulation.call import simulate
from .._systems.system import System

_SPAN = 50  # time scales, in which a motion is looked at; again from its end, so many times
_MOST_SPANS = 20
_SEEN = 8001


def multipliers_of(matrix: np.ndarray) -> np.ndarray:
    """The eigenvalues of a real matrix, the largest first, exact zeros for what it lacks in rank.

    The eigenvalues of ``q r`` that are not zero are those of ``r q``, which is smaller.
    """
    size = len(matrix)
    while len(matrix):
        left, sizes, right = np.linalg.svd(matrix)
        rank = int(np.sum(sizes > 1e3 * np.finfo(matrix.dtype).eps * max(sizes[0], np.finfo(matrix.dtype).tiny)))
        if rank == len(matrix):
            break
        matrix = (sizes[:rank, None] * right[:rank]) @ left[:, :rank]
    found = np.zeros(size, complex)
    found[: len(matrix)] = np.linalg.eigvals(matrix) if len(matrix) else []
    return found[np.argsort(-np.abs(found), kind="stable")]


def without_trivial(multipliers: np.ndarray) -> np.ndarray:
    """Without the multiplier that is nearest to 1: that along the motion, where nothing drives the system."""
    return np.delete(multipliers, np.argmin(np.abs(multipliers - 1)))


def guessed_period(system: System, base: BaseMotion, start: Any, method: Exact) -> float:
    """The time in which a motion that begins at `start` last came back to where it then was."""
    if _checks.holds_traced(system, base, start):
        raise ValueError(
            "Argument period must be given under jax.jit, vmap and grad, where nothing changes with time: a guess of "
            "the orbit's period, s."
        )
    span, y0 = _SPAN * slowest_time(system, base), tuple(map(float, start))
    times = np.linspace(0, span, _SEEN)
    for _ in range(_MOST_SPANS):
        one = simulate(system, base, t1=span, y0=y0, method=method)
        states = np.stack([np.asarray(column) for column in one.evaluate(times)], axis=1)
        found = _last_return(times, states)
        if found is not None:
            return found
        y0 = tuple(map(float, one.final_state))
    raise ValueError(
        "Argument period must be given: a guess of the orbit's period (s), because no motion from y0 was found that "
        f"comes back to where it was {_MOST_SPANS * span:.4g} s later; does it come to rest?"
    )


def _last_return(times: np.ndarray, states: np.ndarray) -> float | None:
    """The time between the end and when the motion last passed there, None if it never came near."""
    scale = np.ptp(states, axis=0)
    if not np.all(np.isfinite(states)) or np.max(scale) <= 1e-9 * max(np.max(np.abs(states)), 1e-300):
        return None
    scaled = states / np.where(scale > 0, scale, 1)
    distance = np.linalg.norm(scaled - scaled[-1], axis=1)
    away = np.flatnonzero(distance > 0.2)
    if not len(away):
        return None
    before = distance[: away[-1]]
    near = np.flatnonzero((before[1:-1] <= before[:-2]) & (before[1:-1] <= before[2:]) & (before[1:-1] < 0.05)) + 1
    return float(times[-1] - times[near[-1]]) if len(near) else None
