"""Sensitivities and their standard errors from means over realisations (delta method)."""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from .._numerics.moments import Moments
from .._statistics.estimate import format_with_error

Estimator: TypeAlias = Literal["corrected", "finite-difference"]


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """The derivative of one statistic with respect to one parameter.

    Attributes:
        statistic: The statistic's name.
        parameter: The parameter's name.
        parameter_value: The parameter's value.
        unit: The statistic's unit.
        value: The statistic, in `unit`.
        value_error: Its standard error, in `unit`.
        derivative: The derivative of the expectation, in `unit` divided by the parameter's unit; a pure number if
            `is_elasticity`.
        standard_error: That of the derivative. It is NaN where no two windows (or steps) agree.
        pathwise: The part that automatic differentiation of each trajectory gives; NaN with the estimator
            "finite-difference", which does not separate the two parts.
        event: The rest, of sticks that appear and vanish (of a switching rate also what the score function corrects):
            `derivative` less `pathwise`, and NaN where that is.
        is_elasticity: Whether it is ``d log statistic / d log parameter``.
        estimator: "corrected" or "finite-difference".
        samples: Number of samples that reached ``t1``.
        asked: Number of samples asked for.
        sticks_in_window: How many sticks and near misses the event part rests on; where it comes from differences, in
            how many trajectories the number of sticks differs.
        relative_bandwidth: Width of the kernel as a relative change of the parameter; where the event part comes from
            differences, their step.

    >>> system, law = ss.papers.belt_oscillator(0.9), ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> settings = {"t1": 200.0, "samples": 2000, "key": jax.random.key(0), "y0": (0.0, 0.5)}
    >>> found = ss.sensitivity(ss.mean_stick_duration, system, law, wrt="mu", **settings)
    >>> print(found)
    d / d mu of mean stick duration (pooled): 0.2980 +- 0.0053
    """

    statistic: str
    parameter: str
    parameter_value: float
    unit: str
    value: float
    value_error: float
    derivative: float
    standard_error: float
    pathwise: float
    event: float
    is_elasticity: bool
    estimator: Estimator
    samples: int
    asked: int
    sticks_in_window: int
    relative_bandwidth: float

    @property
    def finished_fraction(self) -> float:
        """The share of all trajectories that reached ``t1`` and so entered the estimate."""
        return self.samples / self.asked

    def __str__(self) -> str:
        what = "d log / d log" if self.is_elasticity else "d / d"
        number = format_with_error(self.derivative, self.standard_error)
        differences = f" (central differences of {self.relative_bandwidth:.2g})"
        how = differences if self.estimator == "finite-difference" else ""
        return f"{what} {self.parameter} of {self.statistic}: {number}{how}"


class Sensitivities(Mapping[str, Sensitivity]):
    """The sensitivities of one statistic with respect to several parameters, by name."""

    def __init__(self, results: dict[str, Sensitivity]):
        self._results = dict(results)

    def __getitem__(self, name: str) -> Sensitivity:
        return self._results[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._results)

    def __len__(self) -> int:
        return len(self._results)

    def __repr__(self) -> str:
        return "\n".join(str(result) for result in self._results.values())


class Gradient(NamedTuple):
    """A ratio of means and its derivative by one parameter, with their standard errors and the pathwise part."""

    value: float
    value_error: float
    derivative: float
    standard_error: float
    pathwise: float


def gradient_of_ratio(moments: Moments, column: int, path_column: int, elasticity_at: float | None) -> Gradient:
    """The derivative of ``a / b`` by a parameter, from the `moments` of rows ``[a, b, ...]``.

    Columns `column` and the next hold the derivatives of a and b, `path_column` and the next their pathwise parts.
    `elasticity_at`: the parameter's value, for elasticities. Undefined results are NaN.
    """
    mean, covariance = moments.mean, moments.covariance_of_mean
    a, b = mean[:2]
    if moments.number == 0 or not b > 0:
        return Gradient(*[math.nan] * 5)
    value = float(a / b)
    of_value = np.zeros(len(mean))
    of_value[:2] = 1 / b, -value / b
    derivative, of_derivative = _ratio_derivative(mean, column)
    pathwise, _ = _ratio_derivative(mean, path_column)
    if elasticity_at is not None:
        if value == 0:
            return Gradient(0.0, _error(of_value, covariance), math.nan, math.nan, math.nan)
        factor = elasticity_at / value
        of_derivative = factor * (of_derivative - derivative / value * of_value)
        derivative, pathwise = factor * derivative, factor * pathwise
    return Gradient(value, _error(of_value, covariance), derivative, _error(of_derivative, covariance), pathwise)


def _ratio_derivative(mean: np.ndarray, column: int) -> tuple[float, np.ndarray]:
    """``d (a/b) = (da - (a/b) db) / b`` and its gradient by all means."""
    (a, b), (da, db) = mean[:2], mean[column : column + 2]
    value = a / b
    derivative = (da - value * db) / b
    gradient = np.zeros(len(mean))
    gradient[0] = -db / b**2
    gradient[1] = -derivative / b + value * db / b**2
    gradient[column] = 1 / b
    gradient[column + 1] = -value / b
    return float(derivative), gradient


def _error(gradient: np.ndarray, covariance: np.ndarray) -> float:
    return math.sqrt(max(float(gradient @ covariance @ gradient), 0.0)) if np.all(np.isfinite(covariance)) else math.nan
