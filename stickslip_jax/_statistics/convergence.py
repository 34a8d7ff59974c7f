"""How an estimate settles with the number of samples, and how many samples a wanted accuracy takes."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from .. import _checks
from .._numerics.moments import Moments
from .estimate import Estimate, check_level
from .source import require_ensemble, require_statistic


@dataclasses.dataclass(frozen=True, eq=False)
class Convergence:
    """An estimate from the first ``numbers`` samples, for growing numbers.

    - `numbers`: of samples, (points,). `values`, `errors`: estimate and standard error from so many, in `unit`; NaN
      where they are not defined.
    - `final`: the estimate from all samples.
    """

    name: str
    unit: str
    numbers: np.ndarray
    values: np.ndarray
    errors: np.ndarray
    final: Estimate

    def band(self, level: float = 0.9) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end of the confidence intervals at `level`, (points,) each, by Student's t.

        Raises ValueError unless ``0 < level < 1``.
        """
        check_level(level)
        from scipy import special  # noqa: PLC0415 - adds a filter of warnings

        reach = special.stdtrit(np.maximum(self.numbers - 1, 1), (1 + level) / 2) * self.errors
        return self.values - reach, self.values + reach

    def samples_for(self, relative_error: float) -> int | None:
        """How many samples bring the standard error down to so small a share of the value.

        From the spread over all samples, as errors fall with the root of the number. None where the value is 0 or
        the spread is not known. Raises ValueError unless `relative_error` is positive.
        """
        _checks.positive("relative_error", relative_error)
        spread = self.final.standard_error * math.sqrt(self.final.samples)
        if not (math.isfinite(spread) and math.isfinite(self.final.value)) or self.final.value == 0:
            return None
        return max(1, math.ceil((spread / (relative_error * abs(self.final.value))) ** 2))

    def __repr__(self) -> str:
        return f"Convergence of the {self.final}, over {self.numbers[0]} to {self.numbers[-1]} samples"


def convergence(ensemble: Any, statistic: Callable[[Any], Estimate], points: int = 40) -> Convergence:
    """How `statistic` settles as the number of samples grows.

    - `ensemble`: with ``keep="statistics"`` or ``"sticks"``; the growing numbers are those of its retained samples.
    - `statistic`: a function of an ensemble's totals such as `stick_fraction` or `mean_stick_duration`.
    - `points`: numbers of samples at most, evenly spread on a logarithmic scale from 2 on.

    Raises ValueError for other arguments and for an ensemble of fewer than 2 retained samples.
    """
    require_ensemble(ensemble).finished_sticks()  # refuses an ensemble that has none
    require_statistic(statistic)
    features = ensemble.retained.features
    if len(features) < 2:
        raise ValueError(f"Argument ensemble must hold 2 finished samples or more, but it has {len(features)}.")
    _checks.whole_number("points", points, minimum=2)
    numbers = np.unique(np.geomspace(2, len(features), points).round().astype(int))
    estimates, moments, done = [], Moments.of(features[:0]), 0
    for number in numbers:
        moments, done = moments.merge(Moments.of(features[done:number])), number
        estimates.append(statistic(dataclasses.replace(ensemble, moments=moments)))
    values, errors = (np.array([getattr(one, what) for one in estimates]) for what in ("value", "standard_error"))
    final = statistic(ensemble)
    return Convergence(final.name, final.unit, numbers, values, errors, final)


@dataclasses.dataclass(frozen=True, eq=False)
class HistogramConvergence:
    """How far the joint histogram of the first ``numbers`` samples is from that of as many others.

    - `distances`: half the sum of the absolute differences of the shares of all cells (total variation: 0 equal, 1
      without overlap), (points,).
    - `cells`: how many cells hold a pair.
    - `slope`: of the logarithm of the distance against that of the number; -1/2 once every cell is filled often.
    """

    numbers: np.ndarray
    distances: np.ndarray
    cells: int
    slope: float

    def samples_for(self, distance: float) -> int | None:
        """How many samples bring the distance down to `distance`, if it goes on falling with the root of the number.

        None where no distance could be told. Raises ValueError unless `distance` is positive.
        """
        _checks.positive("distance", distance)
        if len(self.distances) == 0 or not math.isfinite(self.distances[-1]):
            return None
        return max(1, math.ceil(self.numbers[-1] * (self.distances[-1] / distance) ** 2))


def histogram_convergence(
    ensemble: Any, x: str = "duration", y: str = "position", bins: int = 20, points: int = 12
) -> HistogramConvergence:
    """How the joint histogram of two quantities settles as the number of samples grows.

    The retained samples are split in halves; the histogram of the first n of one half is compared with that of the
    first n of the other, so that the two are independent.

    - `x`, `y`: as in ``ensemble.statistics.joint``. `bins`: along each axis. `points`: numbers of samples.

    Raises ValueError for arguments that these refuse, and for an ensemble of fewer than 4 retained samples.
    """
    joint = require_ensemble(ensemble).statistics.joint(x, y)
    realisations = joint.x.realisations
    if realisations < 4:
        raise ValueError(f"Argument ensemble must hold 4 finished samples or more, but it has {realisations}.")
    _checks.whole_number("points", points, minimum=2)
    cell, number = joint.cells_of_retained(bins)
    owner = joint.x.owner
    numbers = np.unique(np.geomspace(1, realisations // 2, points).round().astype(int))
    distances = np.full(len(numbers), math.nan)
    for index, half in enumerate(numbers):
        one, other = (np.bincount(cell[(owner % 2 == side) & (owner < 2 * half)], minlength=number) for side in (0, 1))
        if one.sum() and other.sum():
            distances[index] = np.abs(one / one.sum() - other / other.sum()).sum() / 2
    told = np.isfinite(distances) & (distances > 0)
    late = told & (numbers >= numbers[-1] / 30)
    slope = float(np.polyfit(np.log(numbers[late]), np.log(distances[late]), 1)[0]) if late.sum() > 1 else math.nan
    return HistogramConvergence(numbers, distances, int(np.count_nonzero(np.bincount(cell, minlength=1))), slope)
