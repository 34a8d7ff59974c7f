"""Statistics of totals: ratios of means over the samples, of stick time and of the numbers of sticks and slips.

Each is defined here, once. It has an estimate (`StatisticOfTotals`) and, by `sensitivity`, a derivative.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .estimate import Estimate, RatioOfMeans
from .source import EnsembleLike, origin_of, require_ensemble

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
        moments = require_ensemble(ensemble).moments
        above, below = self.weights(ensemble.t1)
        denominator = below[-1] + float(below[:-1] @ moments.mean)
        if moments.number == 0 or not denominator > 0:
            return Estimate(self.label, math.nan, math.nan, self.unit, moments.number, origin_of(ensemble))
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
        return Estimate(self.label, value, error, self.unit, moments.number, origin_of(ensemble), kind)

    def __repr__(self) -> str:
        return self.name


stick_fraction = StatisticOfTotals(
    "stick_fraction", "stick fraction", "1", Linear(stick_time=1), Linear(t1=1),
    "Mean share of ``[0, t1]`` spent sticking, ``E[total stick time] / t1``.",
)  # fmt: skip
mean_stick_count = StatisticOfTotals(
    "mean_stick_count", "mean number of sticks", "1", Linear(stick_count=1), Linear(constant=1),
    "Mean number of sticks that begin in ``[0, t1]``, those cut by the horizon included.",
)  # fmt: skip
mean_slip_count = StatisticOfTotals(
    "mean_slip_count", "mean number of slips", "1", Linear(slip_count=1), Linear(constant=1),
    "Mean number of slips in ``[0, t1]``, those cut by the horizon included.",
)  # fmt: skip
mean_stick_duration = StatisticOfTotals(
    "mean_stick_duration", "mean stick duration (pooled)", "s",
    Linear(stick_time=1, rest_time=-1), Linear(stick_count=1, rest_count=-1),
    "Mean duration of all sticks of all samples, ``E[total stick time] / E[number of sticks]``, s.\n\n"
    "A stick that begins at t = 0 is left out of both, unless the ensemble was simulated with "
    "``count_initial_rest=True``, or with ``keep=\"totals\"``, which cannot tell it from the others. "
    "A stick cut by the horizon counts with the part before it. NaN if there was no stick.",
)  # fmt: skip
mean_slip_duration = StatisticOfTotals(
    "mean_slip_duration", "mean slip duration (pooled)", "s", Linear(t1=1, stick_time=-1), Linear(slip_count=1),
    "Mean duration of all slips of all samples, ``(t1 - E[total stick time]) / E[number of slips]``, s.\n\n"
    "A slip cut by the horizon counts with the part before it. NaN if there was no slip.",
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
