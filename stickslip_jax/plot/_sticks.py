"""The sticks that figures of many show: those that were seen to their end, in samples that finished."""

from typing import Any, NamedTuple

import numpy as np

from .. import _checks
from .._ensemble.result import Ensemble
from .._simulation.result import Simulation
from .._statistics.first_sticks import FirstSticks
from .._status import Ending, Status


class CompleteSticks(NamedTuple):
    """`duration` (s) and `position` (m; of a motor its angle, rad) of each; how many more the horizon `cut`.

    `part`: of which samples, where they are not those of all.
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


def complete_sticks(result: Any) -> CompleteSticks:
    """The complete sticks of an `Ensemble`, those that it kept, of `FirstSticks`, or of a `Simulation`, one or a batch.

    Raises ValueError for anything else.
    """
    part = ""
    if isinstance(result, Ensemble):
        sticks = result.finished_sticks()
        used, duration = np.ones(len(sticks.start), bool), sticks.duration
        part = f" of the first {len(sticks.count):,} samples" if len(sticks.count) < result.finished else ""
    elif isinstance(result, FirstSticks):
        sticks, used, duration = result, result.mask, result.duration
    elif isinstance(result, Simulation):
        sticks = result.sticks
        if any(_checks.is_traced(leaf) for leaf in (sticks.mask, result.status)):
            raise ValueError("Argument result must hold numbers, but one traced by a JAX transformation was given.")
        used = np.asarray(sticks.mask) & (np.asarray(result.status) == Status.FINISHED)[..., None]
        duration = np.asarray(sticks.duration)
    else:
        raise ValueError(
            "Argument result must be a result of simulate_ensemble or of simulate, or of first_stick, but "
            f"{_checks.show(result)} was given."
        )
    cut = np.asarray(sticks.ending) == Ending.HORIZON
    kept = used & ~cut
    duration, position = (np.asarray(values, float)[kept] for values in (duration, sticks.position))
    return CompleteSticks(duration, position, int(np.sum(used & cut)), part)


def edges_of_bins(name: str, bins: Any, span: tuple[float, float], unit: str) -> np.ndarray:
    """Edges of the `bins`, an argument called `name`: so many equal ones over `span`, or the edges themselves."""
    if np.ndim(bins) == 0:
        return np.linspace(*span, _checks.whole_number(name, bins) + 1)
    _checks.numeric(name, bins, ndim=1)
    edges = np.asarray(bins, float)
    if len(edges) < 2 or np.any(np.diff(edges) <= 0):
        raise ValueError(
            f"Argument {name} must be a whole number or increasing edges (in {unit}), but {bins!r} was given."
        )
    return edges
