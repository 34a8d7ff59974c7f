"""Basins of attraction: which starts end on which attractor."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.stats import binomtest

from .._dynamics.common.method import EXACT, Exact
from .._dynamics.simulate import simulate
from .._excitation.excitation import BaseMotion
from .._foundation import checks
from .._foundation.extras import Dataset, Entries, flags, variable
from .._foundation.types import Scalar, Status
from .._systems.system import System, checked_system
from ._cases import START, Cases, Turns, cases_of, within_turn
from ._following import RECURS, Folder, checked_periods, follow, kept_in, settled

# Attractors matched across many motions: which of them end on the same one.


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
    periods: Turns,
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
    # The attractors that most cases end on first.
    order = np.argsort(-np.bincount(labels[labels >= 0], minlength=len(attractors)), kind="stable")
    new = np.append(np.argsort(order), -1)
    return new[labels], [attractors[number] for number in order]


def _turned(states: np.ndarray, periods: Turns) -> np.ndarray:
    """The states with a sine and a cosine in place of each coordinate that turns: what is near is near there."""
    columns = []
    for number, period in enumerate(periods):
        column = states[..., number]
        if period is None:
            columns.append(column)
        else:
            columns += [np.cos(2 * np.pi * column / period), np.sin(2 * np.pi * column / period)]
    return np.stack(columns, axis=-1)


def _scale(turned: np.ndarray, sizes: np.ndarray, periods: Turns) -> np.ndarray:
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


def dense(curve: np.ndarray, tolerance: float) -> np.ndarray:
    """A `curve` (points, coordinates) with more points, so that neighbours are nearer than the tolerance."""
    ranges = np.ptp(curve, axis=0)
    steps = np.abs(np.diff(curve, axis=0)) / np.where(ranges > 0, ranges, 1)
    parts = np.maximum(1, np.ceil(np.max(steps, axis=1) / (_SPACING * tolerance)))
    parts = np.minimum(parts, max(1, _MOST_POINTS // max(len(curve), 1)))
    whole = np.append(0, np.cumsum(parts))
    at = np.arange(int(whole[-1]) + 1)
    return np.stack([np.interp(at, whole, column) for column in curve.T], axis=1)


# Basins of attraction: which starts end on which attractor.


ATTRACTOR, POINT = "attractor", "point"
_TOLERANCE = 1e-3
_MOST = 50
_LEVEL = 0.95
_IRREGULAR = 2000  # returns of an irregular motion, by which others are known
_SEEN = 4096  # instants of a motion that nothing drives
_SHOWN = 2048  # points of an attractor in the result, at most


def basins(
    system: System,
    base: BaseMotion,
    *,
    y0: Any,
    transient: int = 200,
    kept: int = 32,
    longest_transient: int | None = None,
    period: Scalar | None = None,
    tolerance: float = _TOLERANCE,
    most: int = _MOST,
    level: float = _LEVEL,
    method: Exact = EXACT,
    progress: bool | None = None,
    folder: Folder | None = None,
) -> Dataset:
    """Which starts end on which attractor, and the share of each basin.

    Each start is followed for `transient` periods and seen at the ends of `kept` more. Motions that stick all that time
    count as one attractor, "stuck", wherever they rest. Of the others, those that come within the tolerance of the same
    points are on the same attractor; irregular ones (without a recurrence in the periods kept), those that share a
    region.

    Args:
        system: A `MassSpring`, a `MotorCart`, a `LinearStructure` or one of your own, with any number of contacts.
        base: A motion that repeats itself, such as `Constant`, `SquareWave` or `Harmonic`.
        y0: The starts: an array (starts, coordinates); or a grid, a dict from the names of coordinates ("position",
            "velocity") to their values, others being 0.
        transient: Number of periods before the first that is kept, at least; attractors must be reached in it.
        kept: Number of periods kept.
        longest_transient: Number of periods before the first that is kept, at most; by default 16 times `transient`:
            motions that still come nearer to an orbit or to rest go on.
        period: s; by default that after which all motions that drive the system repeat themselves together. Where
            nothing drives the system, a time after which the state is looked at; an attractor is then the whole curve
            of its motion.
        tolerance: How near states of one attractor come to each other, relative to the ranges of the state.
        most: The number of attractors that are looked for, at most.
        level: Of the confidence intervals of the shares.
        method: `Exact`.
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.
        folder: Where what is done is kept, block after block, for the same call to go on from there; without it nothing
            is kept.

    Returns:
        ``basin``: the number of the attractor that each start ends on, from 1, the largest basin first, 0 if none was
        found; with the dimensions of the grid, or "start". Of each attractor ``share`` with ``share_low`` and
        ``share_high``, an interval of Wilson for starts that are a random sample; ``recurrence`` (periods; 0: none was
        found, as of cycles that nothing drives; -1: not settled), ``is_stuck``, and points of it,
        ``attractor_position`` and so on, NaN where it has fewer. Also ``status`` of each start. Warns (RuntimeWarning)
        of starts that were not followed to the end, have not settled, or belong to no attractor.

    Raises:
        ValueError: For arguments that do not fit; for a base that is random or has no period.
        SweepError: For a folder that holds something else or cannot be written.
        ImportError: Without the extra ``study``.
    """
    lasted = transient, kept, _ = checked_periods(transient, kept, longest_transient, tolerance)
    most = checks.whole_number("most", most)
    checks.bounded("level", level, above=0, below=1)
    grid, starts = _starts(system, y0)
    cases = cases_of(system, base, starts, None, period, method)
    with kept_in(folder, cases, {"function": "basins", "transient": transient, "kept": kept}) as stored:
        seen, found, _ = settled(cases, lasted, RECURS, progress, stored)
        states, finished = np.asarray(seen.states), seen.status == int(Status.FINISHED)
        times = seen.stick_time.reshape(len(states), kept, -1)
        lasting = np.asarray(cases.cycle.duration)[:, None, None]
        stuck = np.all(times >= lasting * (1 - 1e-9), axis=(1, 2))

        def points_of(case: int) -> np.ndarray:
            if not cases.driven:
                return _curve(cases, states[case, 0], kept, tolerance)
            if found[case]:
                return states[case]
            # Many returns of an irregular motion: the region in which it stays.
            own = cases.of(np.array([case]), states[case, None, -1])
            return np.asarray(follow(own, 0, _IRREGULAR, False, stored, name=f"irregular-{case:06}").states)[0]

        sizes = np.asarray(seen.sizes)
        labels, attractors = matched(states, sizes, found, stuck, points_of, cases.turns, tolerance, most)
    none = np.sum((labels < 0) & finished)
    if none:
        checks.warn(
            f"{none} of {len(labels)} starts belong to none of the {most} attractors that were looked for: basin is 0 "
            "there. Their motions may need a longer transient, or a larger tolerance or most."
        )

    dims = (START,) if grid is None else tuple(name.replace(" ", "_") for name in grid)
    shape = (len(labels),) if grid is None else tuple(map(len, grid.values()))
    status = seen.status.astype(np.int8).reshape(shape)
    number = int(np.sum(finished))
    counts = np.bincount(labels[labels >= 0], minlength=len(attractors))
    intervals = [binomtest(int(count), number).proportion_ci(level, "wilson") for count in counts]
    low, high = ([float(getattr(one, name)) for one in intervals] for name in ("low", "high"))
    recurrences, at_rest = ([getattr(one, name) for one in attractors] for name in ("recurrence", "is_stuck"))
    variables: Entries = {
        "basin": variable(dims, (labels + 1).reshape(shape), "number of the attractor", "1"),
        "status": variable(dims, status, "whether the start was followed to the end", **flags(Status)),
        "share": variable(ATTRACTOR, counts / max(number, 1), "share of the starts that end on the attractor"),
        "share_low": variable(ATTRACTOR, low, f"lower end of the interval of confidence {level:g} of the share"),
        "share_high": variable(ATTRACTOR, high, f"upper end of the interval of confidence {level:g} of the share"),
        "recurrence": variable(ATTRACTOR, recurrences, "number of periods after which it repeats itself"),
        "is_stuck": variable(ATTRACTOR, at_rest, "whether its motions stick all the time"),
    }
    longest = min(max((len(one.points) for one in attractors), default=0), _SHOWN)
    for place, coordinate in enumerate(cases.system.coordinates):
        shown = np.full((len(attractors), longest), np.nan)
        for row, one in zip(shown, attractors, strict=True):
            points = one.points[:: max(1, -(-len(one.points) // longest)), place]
            row[: len(points)] = within_turn(points, coordinate.period)
        label = f"{coordinate.name} of the attractor"
        variables[f"attractor_{coordinate.variable}"] = variable((ATTRACTOR, POINT), shown, label, coordinate.unit)
    coordinates: Entries = {
        ATTRACTOR: (ATTRACTOR, np.arange(1, len(attractors) + 1), {"long_name": "number of the attractor"})
    }
    units = {coordinate.name: coordinate.unit for coordinate in cases.system.coordinates}
    for name, values in (grid or {}).items():
        column = name.replace(" ", "_")
        coordinates[column] = variable(column, values, f"initial {name}", units[name])
    # A grid has its own dimensions in place of that of the starts.
    return (cases if grid is None else cases._replace(shape=())).dataset(variables, coordinates)


def _starts(system: System, y0: Any) -> tuple[dict[str, np.ndarray] | None, np.ndarray]:
    """The values along each axis of a grid of starts, and all starts (starts, coordinates)."""
    if not isinstance(y0, Mapping):
        if checks.dimensions(y0) != 2:
            demand = "be starts, an array (starts, coordinates), or a dict of values by coordinate"
            raise checks.refused("y0", demand, y0)
        return None, checks.numbers("y0", y0, ndim=2)
    names = [coordinate.name for coordinate in checked_system(system).coordinates]
    for name in y0:
        if name not in names:
            raise ValueError(
                f"Argument y0 must have values by the names of coordinates, {', '.join(map(repr, names))}, but "
                f"{checks.show(name)} was given."
            )
    grid = {str(name): checks.numbers(f"y0[{name!r}]", values, ndim=1) for name, values in y0.items()}
    if not grid or any(not len(values) for values in grid.values()):
        raise checks.refused("y0", "have values of at least one coordinate", y0)
    mesh = dict(zip(grid, np.meshgrid(*grid.values(), indexing="ij"), strict=True))
    zeros = np.zeros(next(iter(mesh.values())).shape)
    return grid, np.stack([mesh.get(name, zeros).reshape(-1) for name in names], axis=1)


def _curve(cases: Cases, state: np.ndarray, kept: int, tolerance: float) -> np.ndarray:
    """The motion from one `state` on, over as long as was kept, with neighbours nearer than the tolerance."""
    t1, setting = kept * float(np.asarray(cases.cycle.duration)[0]), cases.setter.setting
    one = simulate(cases.system, setting.law, t1=t1, y0=tuple(map(float, state)), method=setting.method)
    times = np.unique(np.concatenate([np.linspace(0, t1, _SEEN), np.asarray(one.step_starts)]))
    return dense(np.stack([np.asarray(column) for column in one.evaluate(times)], axis=1), tolerance)
