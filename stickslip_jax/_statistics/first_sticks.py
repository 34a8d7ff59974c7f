"""The first stick of every sample."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from .. import _checks
from .source import EnsembleLike, require_ensemble


@dataclasses.dataclass(frozen=True, eq=False)
class FirstSticks:
    """The first stick of every sample; arrays (samples,), NaN (ending: -1) where `mask` is False: no stick.

    - `start`, `duration`: s. `position`: of the mass, m; of a motor its angle, rad.
    - `ending`: an `Ending` code. HORIZON marks a duration cut short by the end of the simulation.
    - `mask`: whether the sample has a stick.
    """

    start: Float[np.ndarray, " samples"]
    duration: Float[np.ndarray, " samples"]
    position: Float[np.ndarray, " samples"]
    ending: Int[np.ndarray, " samples"]
    mask: Bool[np.ndarray, " samples"]

    @property
    def count(self) -> int:
        """Number of samples that have a first stick."""
        return int(self.mask.sum())

    def __repr__(self) -> str:
        return f"FirstSticks({self.count} in {len(self.mask)} samples)"


def first_stick(ensemble: EnsembleLike, *, count_initial_rest: bool = False) -> FirstSticks:
    """The first stick of every sample.

    Args:
        ensemble: An `Ensemble` with ``keep="sticks"``.
        count_initial_rest: Whether a stick that begins at t = 0, because the mass starts at rest, counts as the first.
            By default it does not, and the next one is the first. Lima and Sampaio (2022) count it, since they call any
            interval without motion a stick.

    Raises:
        ValueError: For an ensemble that kept no sticks, and if `count_initial_rest` is not True or False.
    """
    _checks.truth("count_initial_rest", count_initial_rest)
    sticks = require_ensemble(ensemble).require_sticks()
    if not count_initial_rest:
        sticks = sticks.without_initial_rest()
    mask = sticks.count > 0
    at = sticks.first[mask]

    def fill(values, padding):
        filled = np.full(len(mask), padding, values.dtype)
        filled[mask] = values[at]
        return filled

    start, duration, position = (fill(values, np.nan) for values in (sticks.start, sticks.duration, sticks.position))
    return FirstSticks(start, duration, position, fill(sticks.ending, -1), mask)
