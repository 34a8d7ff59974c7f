"""Basins of attraction: which starts end on which attractor."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np
from scipy.stats import binomtest

from .. import _checks
from .._conventions import Entries, flags, variable
from .._dynamics.common.method import EXACT, Exact
from .._excitation.excitation import BaseMotion
from .._simulation.call import simulate
from .._status import Status
from .._systems.system import System, checked_system
from .._types import Scalar
from ._attractors import Attractor, dense, matched
from ._cases import Cases, cases_of
from ._following import follow
from ._labeled import START, dataset_of, names_of
from ._recurrence import RECURS
from ._settling import checked_periods, settled
from ._stored import Folder, kept_in
from ._warnings import warn_of_none, warn_of_unfinished

if TYPE_CHECKING:
    import xarray

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
) -> "xarray.Dataset":
    """Which starts end on which attractor, and the share of each basin.

    Each start is followed for `transient` periods and seen at the ends of `kept` more. Motions that stick all that time
    count as one attractor, "stuck", wherever they rest. Of the others, those that come within the tolerance of the same
    points are on the same attractor; irregular ones (without a recurrence in the periods kept), those that share a
    region.

    Args:
        system: As in `stroboscopic_section`.
        base: As in `stroboscopic_section`.
        y0: The starts: an array (starts, coordinates); or a grid, a dict from the names of coordinates ("position",
            "velocity") to their values, others being 0.
        transient: Number of periods before the first that is kept, at least; attractors must be reached in it.
        kept: Number of periods kept.
        longest_transient: As in `stroboscopic_section`: motions that still come nearer to an orbit or to rest go on.
        period: As in `stroboscopic_section`. Where nothing drives the system, a time after which the state is looked
            at; an attractor is then the whole curve of its motion.
        tolerance: How near states of one attractor come to each other, relative to the ranges of the state.
        most: The number of attractors that are looked for, at most.
        level: Of the confidence intervals of the shares.
        method: `Exact`.
        progress: As in `simulate_ensemble`.
        folder: As in `stroboscopic_section`.

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
    lasted = transient, kept, _ = checked_periods(transient, kept, longest_transient)
    _checks.positive("tolerance", tolerance)
    most = _checks.whole_number("most", most)
    _checks.bounded("level", level, above=0, below=1)
    grid, starts = _starts(system, y0)
    cases = cases_of(system, base, starts, None, period, method)
    with kept_in(folder, cases, {"function": "basins", "transient": transient, "kept": kept}) as stored:
        seen = follow(cases, transient, kept, progress, stored)
        seen, found, _ = settled(cases, seen, lasted, RECURS, progress, stored, stacklevel=3)
    warn_of_unfinished(seen.status, stacklevel=3)
    states = np.asarray(seen.states)
    periods = tuple(coordinate.period for coordinate in cases.system.coordinates)
    times = np.asarray(seen.sticks.time).reshape(len(states), kept, -1)
    lasting = np.asarray(cases.cycle.duration)[:, None, None]
    stuck = np.all(times >= lasting * (1 - 1e-9), axis=(1, 2))

    def points_of(case: int) -> np.ndarray:
        if not cases.driven:
            return _curve(cases, states[case, 0], kept, tolerance)
        return states[case] if found[case] else _region(cases, case, states[case, -1])

    labels, attractors = matched(states, np.asarray(seen.sizes), found, stuck, points_of, periods, tolerance, most)
    none = int(np.sum((labels < 0) & (seen.status == int(Status.FINISHED))))
    warn_of_none(none, len(labels), most, stacklevel=3)
    return _labeled(cases, grid, labels, attractors, np.asarray(seen.status), level)


def _starts(system: System, y0: Any) -> tuple[dict[str, np.ndarray] | None, np.ndarray]:
    """The values along each axis of a grid of starts, and all starts (starts, coordinates)."""
    if not isinstance(y0, Mapping):
        if _checks.dimensions(y0) != 2:
            raise _checks.refused(
                "y0", "be starts, an array (starts, coordinates), or a dict of values by coordinate", y0
            )
        return None, _checks.numbers("y0", y0, ndim=2)
    names = [coordinate.name for coordinate in checked_system(system).coordinates]
    for name in y0:
        if name not in names:
            raise ValueError(
                f"Argument y0 must have values by the names of coordinates, {', '.join(map(repr, names))}, but "
                f"{_checks.show(name)} was given."
            )
    grid = {str(name): _checks.numbers(f"y0[{name!r}]", values, ndim=1) for name, values in y0.items()}
    if not grid or any(not len(values) for values in grid.values()):
        raise _checks.refused("y0", "have values of at least one coordinate", y0)
    mesh = dict(zip(grid, np.meshgrid(*grid.values(), indexing="ij"), strict=True))
    zeros = np.zeros(next(iter(mesh.values())).shape)
    return grid, np.stack([mesh.get(name, zeros).reshape(-1) for name in names], axis=1)


def _region(cases: Cases, case: int, state: np.ndarray) -> np.ndarray:
    """Many returns of an irregular motion from one `state` on: the region in which it stays."""
    own = jax.tree.map(lambda leaf: leaf[case : case + 1] if eqx.is_array(leaf) else leaf, cases.cycle)
    seen = follow(cases._replace(cycle=own, starts=state[None], shape=()), 0, _IRREGULAR, progress=False)
    return np.asarray(seen.states)[0]


def _curve(cases: Cases, state: np.ndarray, kept: int, tolerance: float) -> np.ndarray:
    """The motion from one `state` on, over as long as was kept, with neighbours nearer than the tolerance."""
    cycle = cases.cycle
    t1 = kept * float(np.asarray(cycle.duration)[0])
    setting = cases.setter.setting
    one = simulate(cases.system, setting.law, t1=t1, y0=tuple(map(float, state)), method=setting.method)
    times = np.unique(np.concatenate([np.linspace(0, t1, _SEEN), np.asarray(one.step_starts)]))
    # Compiled, since a batch of instants is evaluated for each attractor.
    columns = eqx.filter_jit(lambda one, times: one.evaluate(times))(one, np.resize(times, max(len(times), _SEEN)))
    curve = np.stack([np.asarray(column)[: len(times)] for column in columns], axis=1)
    return dense(curve, tolerance)


def _labeled(
    cases: Cases,
    grid: dict[str, np.ndarray] | None,
    labels: np.ndarray,
    attractors: list[Attractor],
    status: np.ndarray,
    level: float,
) -> "xarray.Dataset":
    dims = (START,) if grid is None else tuple(name.replace(" ", "_") for name in grid)
    shape = (len(labels),) if grid is None else tuple(map(len, grid.values()))
    finished = int(np.sum(status == int(Status.FINISHED)))
    counts = np.bincount(labels[labels >= 0], minlength=len(attractors))
    intervals = [binomtest(int(count), finished).proportion_ci(level, "wilson") for count in counts]
    low, high = ([float(getattr(one, name)) for one in intervals] for name in ("low", "high"))
    variables: Entries = {
        "basin": variable(dims, (labels + 1).reshape(shape), "number of the attractor", "1"),
        "status": variable(
            dims, status.astype(np.int8).reshape(shape), "whether the start was followed to the end", **flags(Status)
        ),
        "share": variable(ATTRACTOR, counts / max(finished, 1), "share of the starts that end on the attractor"),
        "share_low": variable(ATTRACTOR, low, f"lower end of the interval of confidence {level:g} of the share"),
        "share_high": variable(ATTRACTOR, high, f"upper end of the interval of confidence {level:g} of the share"),
        "recurrence": variable(
            ATTRACTOR, [one.recurrence for one in attractors], "number of periods after which it repeats itself"
        ),
        "is_stuck": variable(ATTRACTOR, [one.is_stuck for one in attractors], "whether its motions stick all the time"),
    }
    longest = min(max((len(one.points) for one in attractors), default=0), _SHOWN)
    for number, (name, coordinate) in enumerate(zip(names_of(cases), cases.system.coordinates, strict=True)):
        shown = np.full((len(attractors), longest), np.nan)
        for row, one in zip(shown, attractors, strict=True):
            every = max(1, -(-len(one.points) // longest))
            points = one.points[::every, number]
            row[: len(points)] = points if coordinate.period is None else np.mod(points, coordinate.period)
        label = f"{coordinate.name} of the attractor"
        variables[f"attractor_{name}"] = variable((ATTRACTOR, POINT), shown, label, coordinate.unit)
    coordinates: Entries = {
        ATTRACTOR: (ATTRACTOR, np.arange(1, len(attractors) + 1), {"long_name": "number of the attractor"})
    }
    units = {coordinate.name: coordinate.unit for coordinate in cases.system.coordinates}
    for name, values in (grid or {}).items():
        column = name.replace(" ", "_")
        coordinates[column] = variable(column, values, f"initial {name}", units[name])
    # A grid has its own dimensions in place of that of the starts.
    return dataset_of(cases if grid is None else cases._replace(shape=()), variables, coordinates)
