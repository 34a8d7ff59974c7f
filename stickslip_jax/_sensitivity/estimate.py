"""Sensitivities and their standard errors from means over realisations (delta method)."""

import dataclasses
import math
from collections.abc import Hashable, Iterator, Mapping
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .._numerics.moments import Moments
from .._statistics.estimate import Computable, Estimate, SharedErrors, format_with_error, shared_estimate
from .._statistics.units import unit_of_product

Estimator: TypeAlias = Literal["corrected", "finite-difference"]


@dataclasses.dataclass(frozen=True)
class Sensitivity(Computable):
    """The derivative of one statistic with respect to one parameter.

    It can be added, subtracted, multiplied and divided, with numbers and with others; what comes out is an `Estimate`,
    and its error takes into account that results of one call of `sensitivity` are from the same samples. (Those of two
    calls with one key are correlated too, but how is not known: their error is NaN. Ask for both in one call.)

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
        parameter_unit: The unit of the parameter, "1" where none is known.
        origin: Of the random numbers, as in `Estimate`.

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
    parameter_unit: str = "1"
    origin: Hashable = dataclasses.field(default_factory=object, compare=False, repr=False)
    _shared: tuple[SharedErrors, int] | None = dataclasses.field(default=None, compare=False, repr=False)

    @property
    def estimate(self) -> Estimate:
        """The derivative as an `Estimate`."""
        unit = "1" if self.is_elasticity else unit_of_product(self.unit, self.parameter_unit, -1)
        log = " log " if self.is_elasticity else ""
        name, error = f"d{log}({self.statistic})/d{log}({self.parameter})", self.standard_error
        return shared_estimate(name, self.derivative, error, unit, self.samples, self.origin, self._shared)

    @property
    def finished_fraction(self) -> float:
        """The share of all trajectories that reached ``t1`` and so entered the estimate."""
        return self.samples / self.asked

    @property
    def _name(self) -> str:
        what = "d log / d log" if self.is_elasticity else "d / d"
        return f"{what} {self.parameter} of {self.statistic}"

    def __str__(self) -> str:
        number = format_with_error(self.derivative, self.standard_error)
        differences = f" (central differences of {self.relative_bandwidth:.2g})"
        how = differences if self.estimator == "finite-difference" else ""
        return f"{self._name}: {number}{how}"


class Sensitivities(Mapping[Any, Any]):
    """The sensitivities of one statistic with respect to several parameters, by name; or of several statistics.

    Of several statistics ``found[ss.stick_fraction]`` is that of one of them, as `sensitivity` was asked for it, or by
    its name, ``found["stick_fraction"]``: a `Sensitivity`, or by several parameters again a mapping.
    """

    def __init__(self, results: Mapping[Any, "Sensitivity | Sensitivities"]):
        self._results = dict(results)
        self._by_name = {getattr(key, "name", key): key for key in self._results}

    def __getitem__(self, name: Any) -> Any:
        return self._results[self._by_name.get(name, name) if isinstance(name, str) else name]

    def __iter__(self) -> Iterator[Any]:
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
    derivative, _ = _ratio_derivative(mean, column)
    of_derivative = slope_by_means(moments, column, elasticity_at)
    pathwise, _ = _ratio_derivative(mean, path_column)
    if elasticity_at is not None:
        if value == 0:
            return Gradient(0.0, _error(of_value, covariance), math.nan, math.nan, math.nan)
        factor = elasticity_at / value
        derivative, pathwise = factor * derivative, factor * pathwise
    return Gradient(value, _error(of_value, covariance), derivative, _error(of_derivative, covariance), pathwise)


def slope_by_means(moments: Moments, column: int, elasticity_at: float | None) -> np.ndarray:
    """The derivative by the means of all columns of what `gradient_of_ratio` returns as the derivative."""
    mean = moments.mean
    a, b = mean[:2]
    if moments.number == 0 or not b > 0 or (elasticity_at is not None and a == 0):
        return np.full(len(mean), math.nan)
    derivative, slope = _ratio_derivative(mean, column)
    if elasticity_at is None:
        return slope
    value, of_value = a / b, np.zeros(len(mean))
    of_value[:2] = 1 / b, -a / b**2
    return elasticity_at / value * (slope - derivative / value * of_value)


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
