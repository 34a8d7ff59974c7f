"""Attractors matched across many motions: which of them end on the same one."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

_COARSE = 0.03  # of the ranges of the state: how near the points of an irregular motion come to those of another
_MOST_COARSE = 0.9  # of its points
_LEAST = 1e-3  # of its size: the range of a number that is nearly the same in all motions
_SPACING = 0.5  # of the tolerance, between neighbours on a curve
_MOST_POINTS = 200_000  # of a curve


class Attractor(NamedTuple):
    """What motions end on: its `points` (points, coordinates), and the number of returns after which it repeats itself,
    0 if none is known.

    `is_stuck`: motions that stick all the time, wherever; their points may all differ.
    """

    points: np.ndarray
    recurrence: int
    is_stuck: bool


def matched(
    states: np.ndarray,
    sizes: np.ndarray,
    recurrences: np.ndarray,
    stuck: np.ndarray,
    points_of: Callable[[int], np.ndarray],
    periods: tuple[float | None, ...],
    tolerance: float,
    most: int,
) -> tuple[np.ndarray, list[Attractor]]:
    """The label of each case, (cases,), and the attractors: case i ends on number ``labels[i]``, counted from 0.

    Cases whose states (cases, returns, coordinates) are not finite have label -1, and so has what is left after the
    `most` attractors. Cases that are `stuck` throughout are on one attractor. The others are compared with one of them
    at a time, by the `points_of` the attractor of that case: a case is on it if all its states are within `tolerance`
    of one of these points, relative to the ranges of the state, or to thousandths of its `sizes` (cases, coordinates)
    if these are larger; if both are irregular (their recurrences are 0), if
    nine tenths of its states are within 3 percent.
    """
    finite = np.all(np.isfinite(states), axis=(1, 2))
    labels = np.full(len(states), -1)
    attractors: list[Attractor] = []
    turned = _turned(states, periods)
    scale = _scale(turned[finite], sizes[finite], periods)
    if np.any(finite & stuck):
        labels[finite & stuck] = 0
        attractors.append(Attractor(states[finite & stuck][:, -1], 1, True))
    open_ = np.flatnonzero(finite & ~stuck)
    while len(open_) and len(attractors) < most:
        first = int(open_[0])
        points = points_of(first)
        tree = KDTree(_turned(points, periods) / scale)
        near, _ = tree.query(turned[open_] / scale, distance_upper_bound=max(tolerance, _COARSE))
        same = np.all(near <= tolerance, axis=1)
        if recurrences[first] == 0:
            same |= (recurrences[open_] == 0) & (np.mean(near <= _COARSE, axis=1) >= _MOST_COARSE)
        same[0] = True
        labels[open_[same]] = len(attractors)
        attractors.append(Attractor(points, int(recurrences[first]), False))
        open_ = open_[~same]
    return _by_size(labels, attractors)


def _turned(states: np.ndarray, periods: tuple[float | None, ...]) -> np.ndarray:
    """The states with a sine and a cosine in place of each coordinate that turns: what is near is near there."""
    columns = []
    for number, period in enumerate(periods):
        column = states[..., number]
        if period is None:
            columns.append(column)
        else:
            columns += [np.cos(2 * np.pi * column / period), np.sin(2 * np.pi * column / period)]
    return np.stack(columns, axis=-1)


def _scale(turned: np.ndarray, sizes: np.ndarray, periods: tuple[float | None, ...]) -> np.ndarray:
    """The range of each column of states (cases, returns, columns), or a thousandth of its median size, `sizes` (cases,
    coordinates), where that is larger: differences of round-off do not count; 1 for sines, cosines, and zeros.

    Without the twentieth of the states at either end, if anything is left: a few motions that run away do not count.
    """
    columns = turned.reshape(-1, turned.shape[-1])
    if not len(columns):
        return np.ones(columns.shape[1])
    inner, whole = np.ptp(np.percentile(columns, [5, 95], axis=0), axis=0), np.ptp(columns, axis=0)
    number_of_columns = [1 if period is None else 2 for period in periods]
    least = _LEAST * np.repeat(np.median(sizes, axis=0), number_of_columns)
    ranges = np.where(inner > least, inner, np.maximum(whole, least))
    turns = np.repeat([period is not None for period in periods], number_of_columns)
    return np.where((ranges > 0) & ~turns, ranges, 1)


def _by_size(labels: np.ndarray, attractors: list[Attractor]) -> tuple[np.ndarray, list[Attractor]]:
    """The same, the attractors that most cases end on first."""
    counts = np.bincount(labels[labels >= 0], minlength=len(attractors))
    order = np.argsort(-counts, kind="stable")
    new = np.append(np.argsort(order), -1)
    return new[labels], [attractors[number] for number in order]


def dense(curve: np.ndarray, tolerance: float) -> np.ndarray:
    """A `curve` (points, coordinates) with more points, so that neighbours are nearer than the tolerance."""
    ranges = np.ptp(curve, axis=0)
    steps = np.abs(np.diff(curve, axis=0)) / np.where(ranges > 0, ranges, 1)
    parts = np.maximum(1, np.ceil(np.max(steps, axis=1) / (_SPACING * tolerance)))
    parts = np.minimum(parts, max(1, _MOST_POINTS // max(len(curve), 1)))
    whole = np.append(0, np.cumsum(parts))
    at = np.arange(int(whole[-1]) + 1)
    return np.stack([np.interp(at, whole, column) for column in curve.T], axis=1)
