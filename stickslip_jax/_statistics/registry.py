"""All quantities and statistics: each is defined here, once, and every other module reads it from here.

A quantity is a number of each stick, of each slip or of each sample; its distribution is estimated. A statistic of
totals is a ratio of means over the samples; it has an estimate (`StatisticOfTotals`) and, by `sensitivity`, a
derivative.
"""

import dataclasses
import math
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from .estimate import Estimate
from .source import EnsembleLike, origin_of, require_ensemble


@dataclasses.dataclass(frozen=True)
class SampledQuantity:
    """A number that each stick, each slip or each sample has.

    - `name`: in code and in files. `label`: in tables and figures, in the singular; that of a stick's quantity says
      "stick" once.
    - `unit`: "1" for a number without one; None for a position, whose unit the system gives (m, of a motor rad).
    - `is_whole`: whether the values are whole numbers.
    """

    name: str
    label: str
    unit: str | None
    is_whole: bool = False

    @property
    def short_label(self) -> str:
        """The name as words: "duration"."""
        return self.name.replace("_", " ")

    def label_of_order(self, number: int) -> str:
        """The label where it is the `number`-th stick's: "1st stick duration"; or slip's: "1st slip duration"."""
        word = "stick" if "stick" in self.label else "slip"
        return self.label.replace(word, f"{ordinal(number)} {word}")

    def axis_label(self, number: int | None) -> str:
        """The label on an axis: "stick duration"; with the `number` of the stick: "duration of stick 1"."""
        if number is None:
            return self.label
        if self.label.endswith(" the stick"):
            return self.label.replace("the stick", f"stick {number}")
        return f"{self.label.removeprefix('stick ')} of stick {number}"


def ordinal(number: int) -> str:
    """1st, 2nd, 3rd, 4th, ..."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"


START = SampledQuantity("start", "stick start", "s")
DURATION = SampledQuantity("duration", "stick duration", "s")
POSITION = SampledQuantity("position", "stick position", None)
SLIP_BEFORE = SampledQuantity("slip_before", "slip before the stick", "s")
SLIP_AFTER = SampledQuantity("slip_duration", "slip after the stick", "s")
SLIP_AFTER_START = SampledQuantity("slip_start", "start of the slip after the stick", "s")
SLIP_START = SampledQuantity("slip_start", "slip start", "s")
SLIP_DURATION = SampledQuantity("slip_duration", "slip duration", "s")
STICK_COUNT = SampledQuantity("stick_count", "number of sticks", "1", is_whole=True)
SLIP_COUNT = SampledQuantity("slip_count", "number of slips", "1", is_whole=True)
STICK_FRACTION = SampledQuantity("stick_fraction", "stick fraction", "1")
OWN_MEAN_DURATION = SampledQuantity("own_mean_duration", "mean stick duration of a sample", "s")

STICK_QUANTITIES = (START, DURATION, POSITION)
"""Quantities of each stick that are summed over all sticks, and by order, while the sticks stream by.

A new one goes to the end. Its values are the field of its name in `StickStream` and `FlatSticks`, (sticks,). The
compiled loops sum the first three; with more, NumPy sums all, more slowly (`accumulator.py`).
"""

StickQuantity: TypeAlias = Literal["start", "duration", "position", "slip_before", "slip_start", "slip_duration"]
"""The names of a stick's quantities: the `STICK_QUANTITIES`, the duration of the slip before the stick, and when the
slip after it begins and how long it lasts."""

StickValue: TypeAlias = StickQuantity | tuple[StickQuantity, int]
"""A quantity of any stick, "duration", or of the i-th stick of each sample, ("duration", 1)."""

BY_NAME = {quantity.name: quantity for quantity in (*STICK_QUANTITIES, SLIP_BEFORE, SLIP_AFTER_START, SLIP_AFTER)}
"""The quantities of a stick by their names, as in `StickQuantity`."""

SAMPLE_QUANTITIES = (STICK_COUNT, SLIP_COUNT, STICK_FRACTION)
"""Quantities of each sample, with the columns that `StickAccumulator.samples` has."""

DISTRIBUTIONS = (
    *SAMPLE_QUANTITIES, DURATION, OWN_MEAN_DURATION, SLIP_DURATION, START, POSITION, *STICK_QUANTITIES[3:],
)  # fmt: skip
"""All quantities whose distributions are estimated from all samples, in the order of tables."""

SLIP_QUANTITIES = (SLIP_START, SLIP_DURATION)
"""Quantities of each slip, of the retained samples. Without "slip_", they are the fields of `FlatSlips`."""

TestedQuantity: TypeAlias = Literal["start", "duration", "position", "slip_start", "slip_duration"]
"""The names of the quantities that tests of independence and of identical distribution take."""

TESTED = {quantity.name: quantity for quantity in (*STICK_QUANTITIES, *SLIP_QUANTITIES)}
"""The same quantities by their names."""

IN_A_CYCLE: tuple[TestedQuantity, ...] = ("start", "position", "duration", "slip_start", "slip_duration")
"""In which order the quantities of a stick and the slip after it come to be known."""

STREAMED_PAIRS: tuple[tuple[StickQuantity, StickQuantity], ...] = (("duration", "position"), ("start", "duration"))
"""Pairs of quantities of the same stick whose joint histograms are summed over all sticks."""

FIRST_TWO: tuple[StickValue, StickValue] = (("duration", 1), ("duration", 2))
"""The pair of two sticks of a sample whose joint histogram is summed over all samples."""


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

    def weights(self, t1: float) -> np.ndarray:
        """Coefficients of `TOTALS` and the constant, of numerator and denominator, (2, 6); a constant denominator is 1.

        - `t1`: s.
        """
        rows = np.array([(*one[:-2], one.constant + one.t1 * t1) for one in (self.numerator, self.denominator)], float)
        return rows / rows[1, -1] if self.denominator.is_constant else rows

    def __call__(self, ensemble: EnsembleLike) -> Estimate:
        """The estimate from the samples of `ensemble` that finished, with its standard error over samples.

        Samples are independent, the sticks of one sample are not; so the error comes from the covariance of the totals
        over samples. For the ratio ``r = n / d`` of two means its gradient is ``(grad n - r grad d) / d`` (delta
        method; Cochran, Sampling Techniques, 1977, chapter 6). NaN where the denominator is 0.

        Raises ValueError if `ensemble` is not the result of `simulate_ensemble`.
        """
        moments = require_ensemble(ensemble).moments
        above, below = self.weights(ensemble.t1)
        denominator = below[-1] + float(below[:-1] @ moments.mean)
        if moments.number == 0 or not denominator > 0:
            return Estimate(self.label, math.nan, math.nan, self.unit, moments.number, origin_of(ensemble))
        value = float(above[-1] + float(above[:-1] @ moments.mean)) / float(denominator)
        gradient = (above[:-1] - value * below[:-1]) / denominator
        variance = float(gradient @ moments.covariance_of_mean @ gradient)
        error = math.sqrt(max(variance, 0.0))
        return Estimate(self.label, value, error, self.unit, moments.number, origin_of(ensemble))

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
"""What a study estimates, by name; without the mean total stick time, which only repeats the stick fraction."""

DIFFERENTIABLE = tuple(one for one in (*STATISTICS.values(), mean_total_stick_time) if one.is_of_sticks)
"""The statistics that `sensitivity` takes: the lanes that follow derivatives count sticks, not slips."""
