"""Statistics of totals, ratios of means over the samples; and how estimates converge with their number."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._foundation import checks
from .._numerics.sums import Moments
from . import estimate
from .estimate import DEFAULT_LEVEL, EnsembleLike, Estimate, RatioOfMeans, Statistic
from .quantities import StickValue

# Statistics of totals: ratios of means over the samples, of stick time and of the numbers of sticks and slips.
#
# Each is defined here, once. It has an estimate (`StatisticOfTotals`) and, by `sensitivity`, a derivative.


_IN_ONE = 1e-9  # relative round-off of a variance
TOTALS = ("stick_time", "stick_count", "slip_count", "rest_time", "rest_count")
"""The totals of each sample whose means and covariances an ensemble holds: stick time (s), sticks, slips; and of the
first two the part that is the initial rest: a stick that begins at t = 0, unless it counts (`Numbering`), else 0."""


class Linear(NamedTuple):
    """A linear function of a sample's `TOTALS`: their coefficients, a constant, and the coefficient of ``t1``."""

    stick_time: float = 0
    stick_count: float = 0
    slip_count: float = 0
    rest_time: float = 0
    rest_count: float = 0
    constant: float = 0
    t1: float = 0

    @property
    def is_constant(self) -> bool:
        """Whether it depends on no total."""
        return not any(self[: len(TOTALS)])


@dataclasses.dataclass(frozen=True, repr=False)
class StatisticOfTotals:
    """A statistic of an ensemble: the mean over samples of one linear function of their totals, over that of another.

    Call it with an `Ensemble` to get the `Estimate`.

    - `name`: in code and in files. `label`, `unit`: in tables and figures. `meaning`: its docstring.
    - `numerator`, `denominator`: the linear functions.
    """

    name: str
    label: str
    unit: str
    numerator: Linear
    denominator: Linear
    meaning: str

    def __post_init__(self):
        object.__setattr__(self, "__doc__", self.meaning)
        object.__setattr__(self, "__name__", self.name)

    @property
    def is_of_sticks(self) -> bool:
        """Whether it depends on no number of slips."""
        return self.numerator.slip_count == self.denominator.slip_count == 0

    def weights(self, t1: float) -> Float[np.ndarray, "2 terms"]:
        """Coefficients of `TOTALS` and the constant, of numerator and denominator, (2, 6); a constant denominator is 1.

        Args:
            t1: Duration of the samples, s.
        """
        rows = np.array([(*one[:-2], one.constant + one.t1 * t1) for one in (self.numerator, self.denominator)], float)
        return rows / rows[1, -1] if self.denominator.is_constant else rows

    def __call__(self, ensemble: EnsembleLike) -> Estimate:
        """The estimate from the samples of `ensemble` that finished, with its standard error over samples.

        Samples are independent, the sticks of one sample are not; so the error comes from the covariance of the totals
        over samples. For the ratio ``r = n / d`` of two means its gradient is ``(grad n - r grad d) / d`` (delta
        method; Cochran, Sampling Techniques, 1977, chapter 6). NaN where the denominator is 0; the error also where all
        of the events are in one sample, which tells nothing of their spread.

        Raises ValueError if `ensemble` is not the result of `simulate_ensemble`.
        """
        moments = estimate.require_ensemble(ensemble).moments
        above, below = self.weights(ensemble.t1)
        denominator = below[-1] + float(below[:-1] @ moments.mean)
        if moments.number == 0 or not denominator > 0:
            return Estimate(self.label, math.nan, math.nan, self.unit, moments.number, estimate.origin_of(ensemble))
        value = float(above[-1] + float(above[:-1] @ moments.mean)) / float(denominator)
        gradient = (above[:-1] - value * below[:-1]) / denominator
        covariance = moments.covariance_of_mean
        error = math.sqrt(max(float(gradient @ covariance @ gradient), 0.0))
        of_denominator = covariance @ below[:-1] / denominator
        kind = RatioOfMeans(float(below[:-1] @ of_denominator) / denominator, float(gradient @ of_denominator))
        if self.denominator.is_constant:
            kind = None
        elif kind.variance > (1 - _IN_ONE):  # as large as can be: one sample has all of the events
            error = math.nan
        return Estimate(self.label, value, error, self.unit, moments.number, estimate.origin_of(ensemble), kind)

    def __repr__(self) -> str:
        return self.name


stick_fraction = StatisticOfTotals(
    "stick_fraction", "stick fraction", "1", Linear(stick_time=1), Linear(t1=1),
    "Mean share of ``[0, t1]`` spent sticking, ``E[total stick time] / t1``.",
)  # fmt: skip
mean_stick_count = StatisticOfTotals(
    "mean_stick_count", "mean number of sticks", "1", Linear(stick_count=1), Linear(constant=1),
    "Mean number of sticks that begin in ``[0, t1]``, those cut by the end included.",
)  # fmt: skip
mean_slip_count = StatisticOfTotals(
    "mean_slip_count", "mean number of slips", "1", Linear(slip_count=1), Linear(constant=1),
    "Mean number of slips in ``[0, t1]``, those cut by the end included.",
)  # fmt: skip
mean_stick_duration = StatisticOfTotals(
    "mean_stick_duration", "mean stick duration (pooled)", "s",
    Linear(stick_time=1, rest_time=-1), Linear(stick_count=1, rest_count=-1),
    "Mean duration of all sticks of all samples, ``E[total stick time] / E[number of sticks]``, s.\n\n"
    "A stick that begins at t = 0 is left out of both, unless the ensemble was simulated with "
    "``count_initial_rest=True``, or with ``keep=\"totals\"``, which cannot tell it from the others. "
    "A stick cut by the end counts with the part before it. NaN if there was no stick.",
)  # fmt: skip
mean_slip_duration = StatisticOfTotals(
    "mean_slip_duration", "mean slip duration (pooled)", "s", Linear(t1=1, stick_time=-1), Linear(slip_count=1),
    "Mean duration of all slips of all samples, ``(t1 - E[total stick time]) / E[number of slips]``, s.\n\n"
    "A slip cut by the end counts with the part before it. NaN if there was no slip.",
)  # fmt: skip
mean_total_stick_time = StatisticOfTotals(
    "mean_total_stick_time", "mean total stick time", "s", Linear(stick_time=1), Linear(constant=1),
    "Mean total stick time in ``[0, t1]``, s: ``t1`` times the stick fraction.",
)  # fmt: skip

STATISTICS = {
    statistic.name: statistic
    for statistic in (stick_fraction, mean_stick_count, mean_slip_count, mean_stick_duration, mean_slip_duration)
}
"""What studies and sweeps estimate, by name; the mean total stick time would only repeat the stick fraction."""

DIFFERENTIABLE = (*STATISTICS.values(), mean_total_stick_time)
"""The statistics that `sensitivity` takes."""


# How an estimate converges with the number of samples, and how many samples a given accuracy needs.


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
        estimate.check_level(level)
        half_width = estimate.quantile_of_t(np.maximum(self.numbers - 1, 1), level) * self.errors
        return self.values - half_width, self.values + half_width

    def samples_for(self, relative_error: float) -> int | None:
        """Number of samples at which the standard error is `relative_error` times the value.

        From the spread over all samples, since errors fall with the square root of the number. None where the value is
        0 or the spread is not known.

        Raises:
            ValueError: Unless `relative_error` is positive.
        """
        checks.positive("relative_error", relative_error)
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
    totals, final, estimate_from = estimate.by_totals(statistic, ensemble)
    if len(totals) < 2:
        raise ValueError(f"Argument ensemble must hold 2 finished samples or more, but it has {len(totals)}.")
    checks.whole_number("points", points, minimum=2, maximum=10**6)
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
        checks.positive("distance", distance)
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
        x: The first quantity of a stick: "start", "duration", "position" ..., one that ``ensemble.statistics.joint``
            takes.
        y: The second one.
        bins: Largest number along each axis.
        points: Largest number of distances.

    Raises:
        ValueError: For arguments outside these bounds, and for an ensemble of fewer than 4 retained samples.
    """
    joint = estimate.require_ensemble(ensemble).statistics.joint(x, y)
    realizations = joint.x.realizations
    if realizations < 4:
        raise ValueError(f"Argument ensemble must hold 4 finished samples or more, but it has {realizations}.")
    checks.whole_number("points", points, minimum=2, maximum=10**6)
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
