"""What the yardsticks share: result types and argument checks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Totals(NamedTuple):
    """Sums over an ensemble. The squares are of each trajectory's number of sticks and total stick time."""

    samples: int
    intervals: int
    sticks: int
    stick_time: float
    sticks_squared: float
    stick_time_squared: float


class GivenResult(NamedTuple):
    """Per trajectory: base intervals, sticks, total stick time, and the state at `t1` in the fixed frame."""

    intervals: np.ndarray
    sticks: np.ndarray
    stick_time: np.ndarray
    z: np.ndarray
    u: np.ndarray


class Trajectory(NamedTuple):
    """One trajectory: stick starts and ends, number of base intervals, state at `t1` in the fixed frame."""

    start: np.ndarray
    end: np.ndarray
    intervals: int
    z: float
    u: float


def check_case(w, t1, rate=1.0, initial_sign=1) -> None:
    """Refuses what the yardsticks are not written for."""
    if not w > 0.0:
        raise ValueError(f"w must be positive, got {w}: the yardsticks leave out a base at rest")
    if not (t1 > 0.0 and rate > 0.0):
        raise ValueError(f"t1 and rate must be positive, got {t1} and {rate}")
    if initial_sign not in (-1, 0, 1):
        raise ValueError(f"initial_sign must be +1, -1 or 0 (fair coin), got {initial_sign}")


def split_samples(samples: int, threads: int) -> list[int]:
    """Nearly equal shares of the samples, one for each thread."""
    return [samples // threads + (i < samples % threads) for i in range(threads)]


def given_arrays(gaps, y0, initial_sign):
    """Gaps as `(trajectories, n)` float64, and `z0`, `u0`, `initial_sign` broadcast to `(trajectories,)`."""
    gaps = np.ascontiguousarray(np.atleast_2d(np.asarray(gaps, dtype=float)))
    if gaps.ndim != 2 or (gaps.size and not (gaps > 0.0).all()):
        raise ValueError("gaps must be positive, of shape (n,) or (trajectories, n)")
    z0, u0 = y0
    given = (z0, u0, initial_sign)
    lanes = [np.broadcast_to(np.asarray(value, dtype=float), gaps.shape[:1]) for value in given]
    if not (np.abs(lanes[2]) == 1.0).all():
        raise ValueError("initial_sign must be +1 or -1 for given gaps")
    return gaps, *(np.ascontiguousarray(lane) for lane in lanes)
