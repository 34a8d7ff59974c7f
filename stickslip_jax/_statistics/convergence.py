"""How an estimate converges with the number of samples, and how many samples a given accuracy needs."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float, Int

from .. import _checks
from .._numerics.moments import Moments
from .estimate import DEFAULT_LEVEL, Estimate, check_level
from .quantities import StickValue
from .source import EnsembleLike, Statistic, by_totals, require_ensemble


@dataclasses.dataclass(frozen=True, eq=False)
class Convergence:
    """An estimate from the first ``numbers[i]`` samples, for i = 0, 1, ...

    - `name`, `unit`: of the estimate. `numbers`: of samples, increasing, (points,).
    - `values`, `errors`: estimate and standard error from that many samples, in `unit`; NaN where not defined;
      (points,).
    - `final`: the estimate from all samples.
    """

    name: str
    unit: str
    numbers: Int[np.ndarray, " points"]
    values: Float[np.ndarray, " points"]
    errors: Float[np.ndarray, " points"]
    final: Estimate

    def band(self, level: float = DEFAULT_LEVEL) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
        """Lower and upper end of the confidence intervals at `level`, by Student's t.

        Raises:
            ValueError: Unless ``0 < level < 1``.
        """
        check_level(level)
        from scipy import special  # noqa: PLC0415 - adds a filter of warnings

        half_width = special.stdtrit(np.maximum(self.numbers - 1, 1), (1 + level) / 2) * self.errors
        return self.values - half_width, self.values + half_width

    def samples_for(self, relative_error: float) -> int | None:
        """Number of samples at which the standard error is `relative_error` times the value.

        From the spread over all samples, since errors fall with the square root of the number. None where the value is
        0 or the spread is not known.

        Raises:
            ValueError: Unless `relative_error` is positive.
        """
        _checks.positive("relative_error", relative_error)
        spread = self.final.standard_error * math.sqrt(self.final.samples)
        if not (math.isfinite(spread) and math.isfinite(self.final.value)) or self.final.value == 0:
            return None
        return max(1, math.ceil((spread / (relative_error * abs(self.final.value))) ** 2))

    def __repr__(self) -> str:
        return f"Convergence of the {self.final}, over {self.numbers[0]} to {self.numbers[-1]} samples"


def convergence(statistic: Statistic, ensemble: EnsembleLike, points: int = 40) -> Convergence:
    """How the estimate of `statistic` converges as the number of samples grows.

    Args:
        statistic: A function of an ensemble's totals such as `stick_fraction` or `mean_stick_duration`.
        ensemble: An `Ensemble` with ``keep="statistics"`` or ``"sticks"``; the estimates use its first retained
            samples.
        points: The largest number of estimates; their numbers of samples are spread evenly on a logarithmic scale, from
            2 to all retained samples.

    Raises:
        ValueError: For other arguments and for an ensemble of fewer than 2 retained samples.
    """
    totals, final, estimate_from = by_totals(statistic, ensemble)
    if len(totals) < 2:
        raise ValueError(f"Argument ensemble must hold 2 finished samples or more, but it has {len(totals)}.")
    _checks.whole_number("points", points, minimum=2, maximum=10**6)
    numbers = np.unique(np.geomspace(2, len(totals), points).round().astype(int))
    estimates, moments, done = [], Moments.of(totals[:0]), 0
    for number in numbers:
        moments, done = moments.merge(Moments.of(totals[done:number])), number
        estimates.append(estimate_from(moments))
    values, errors = (np.array([getattr(one, what) for one in estimates]) for what in ("value", "standard_error"))
    return Convergence(final.name, final.unit, numbers, values, errors, final)


@dataclasses.dataclass(frozen=True, eq=False)
class HistogramConvergence:
    """Distance of the joint histogram of ``numbers[i]`` samples from that of as many others, for i = 0, 1, ...

    - `numbers`: of samples, increasing, (points,).
    - `distances`: total variation, half the sum over cells of the absolute differences of shares (0: equal, 1: without
      overlap), (points,). NaN where one of the histograms is empty.
    - `cells`: number of cells that hold a pair.
    - `slope`: of the logarithm of the distance against that of the number; -1/2 once every cell holds many pairs.
    """

    numbers: Int[np.ndarray, " points"]
    distances: Float[np.ndarray, " points"]
    cells: int
    slope: float

    def samples_for(self, distance: float) -> int | None:
        """Number of samples at which the distance is `distance`, if it goes on falling with the square root of it.

        None where the last distance is not known.

        Raises:
            ValueError: Unless `distance` is positive.
        """
        _checks.positive("distance", distance)
        if len(self.distances) == 0 or not math.isfinite(self.distances[-1]):
            return None
        return max(1, math.ceil(self.numbers[-1] * (self.distances[-1] / distance) ** 2))


def histogram_convergence(
    ensemble: EnsembleLike, x: StickValue = "duration", y: StickValue = "position", bins: int = 20, points: int = 12
) -> HistogramConvergence:
    """How the joint histogram of two quantities converges as the number of samples grows.

    The retained samples are split into two halves. The histogram of the first n samples of one half is compared with
    that of the first n of the other, so the two are independent.

    Args:
        ensemble: An `Ensemble` with ``keep="statistics"`` or ``"sticks"``.
        x: As in ``ensemble.statistics.joint``.
        y: As in ``ensemble.statistics.joint``.
        bins: Largest number along each axis.
        points: Largest number of distances.

    Raises:
        ValueError: For arguments outside these bounds, and for an ensemble of fewer than 4 retained samples.
    """
    joint = require_ensemble(ensemble).statistics.joint(x, y)
    realizations = joint.x.realizations
    if realizations < 4:
        raise ValueError(f"Argument ensemble must hold 4 finished samples or more, but it has {realizations}.")
    _checks.whole_number("points", points, minimum=2, maximum=10**6)
    cell, number = joint.cells_of_retained(bins)
    owner = joint.x.owner
    numbers = np.unique(np.geomspace(1, realizations // 2, points).round().astype(int))
    distances = np.full(len(numbers), math.nan)
    for index, half in enumerate(numbers):
        one, other = (np.bincount(cell[(owner % 2 == side) & (owner < 2 * half)], minlength=number) for side in (0, 1))
        if one.sum() and other.sum():
            distances[index] = np.abs(one / one.sum() - other / other.sum()).sum() / 2
    late = np.isfinite(distances) & (distances > 0) & (numbers >= numbers[-1] / 30)
    slope = float(np.polyfit(np.log(numbers[late]), np.log(distances[late]), 1)[0]) if late.sum() > 1 else math.nan
    return HistogramConvergence(numbers, distances, int(np.count_nonzero(np.bincount(cell, minlength=1))), slope)
