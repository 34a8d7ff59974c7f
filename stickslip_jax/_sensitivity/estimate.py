"""Sensitivities and their errors from means over realisations, with the window that they are seen through."""

import dataclasses
import math
from collections.abc import Hashable, Iterator, Mapping
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float

from .._numerics.sums import Moments
from .._statistics.estimate import (
    Computable,
    Estimate,
    SharedErrors,
    format_with_error,
    shared_estimate,
    unit_of_product,
)
from .._systems.system import unit_at
from .estimators import Accumulator, Windows
from .problem import SensitivityProblem

# Sensitivities and their standard errors from means over realisations (delta method).


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


def gradient_of_ratio(moments: Moments, window: int, elasticity_at: float | None) -> tuple[Gradient, np.ndarray]:
    """The derivative of ``a / b`` by a parameter, as a window shows it, from moments as in `Windows`; and its own
    derivative by the means of all columns.

    `elasticity_at`: the parameter's value, for elasticities. Undefined results are NaN.
    """
    mean, covariance = moments.mean, moments.covariance_of_mean
    (a, b), unknown = mean[:2], np.full(len(mean), math.nan)
    if moments.number == 0 or not b > 0:
        return Gradient(*[math.nan] * 5), unknown
    value = float(a / b)
    of_value = np.zeros(len(mean))
    of_value[:2] = 1 / b, -value / b
    value_error = _error(of_value, covariance)
    (derivative, slope), (pathwise, _) = (_ratio_derivative(mean, at) for at in (2 + 2 * window, len(mean) - 2))
    if elasticity_at is not None:
        if value == 0:
            return Gradient(0.0, value_error, math.nan, math.nan, math.nan), unknown
        slope = elasticity_at / value * (slope - derivative / value * of_value)
        derivative, pathwise = (elasticity_at / value * one for one in (derivative, pathwise))
    return Gradient(value, value_error, derivative, _error(slope, covariance), pathwise), slope


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


# Choice among several windows: the widest that agrees with all narrower ones (Lepski's rule).
#
# The standard error of an estimate whose window is chosen from the same samples is too small. So each half of the
# samples chooses for the other: given the choice, the error is that of a fixed window.


COUNTED, PAIRED, RECORDED = (1.0, 0.25), (1.0, 0.25), (1.0, 0.5, 0.25, 0.125)  # relative widths to choose from
OUTPUT = (1.0, 0.25, 0.0625)
FEW = 100  # sticks: a narrower window with fewer is too noisy to judge others by
_AGREE = 2.0  # standard errors
_DISAGREE = 4.0  # standard errors: by chance alone two windows differ so much once in 16,000 times
_ROUND_OFF = 1e-12  # relative


def estimate_by_windows(
    seen: Windows, elasticity_at: float | None
) -> tuple[Gradient, int, tuple[np.ndarray, np.ndarray]]:
    """The derivative by one parameter; the index of its window, the narrower one where the halves differ; and the
    derivative of the first by the mean of every column in the first and in the second half.

    `elasticity_at`: the parameter's value, for elasticities. Where no two windows agree (`windows_disagree`), the error
    is NaN: that of the narrowest window says nothing of its bias.
    """
    whole, (first, second) = seen.moments, seen.halves
    if windows_disagree(seen):
        narrowest, unknown = _usable(seen.in_window)[-1], np.full_like(whole.mean, math.nan)
        found, _ = gradient_of_ratio(whole, narrowest, elasticity_at)
        return found._replace(standard_error=math.nan), narrowest, (unknown, unknown)
    for_second, for_first = (_widest(half, seen, _AGREE) for half in seen.halves)
    window, share = max(for_first, for_second), first.number / max(whole.number, 1)
    found, slope = gradient_of_ratio(whole, window, elasticity_at)
    if for_first == for_second:
        return found, window, (share * slope, (1 - share) * slope)
    one, by_first = gradient_of_ratio(first, for_first, elasticity_at)
    other, by_second = gradient_of_ratio(second, for_second, elasticity_at)
    mixed = share * one.derivative + (1 - share) * other.derivative
    error = math.hypot(share * one.standard_error, (1 - share) * other.standard_error)
    by_means = share * by_first, (1 - share) * by_second
    return found._replace(derivative=mixed, standard_error=error), window, by_means


def windows_disagree(seen: Windows) -> bool:
    """Whether even the two narrowest windows with enough sticks disagree by more than chance explains."""
    usable = _usable(seen.in_window)
    return len(usable) > 1 and _widest(seen.moments, seen, _DISAGREE) == usable[-1]


def _usable(in_window: Float[np.ndarray, " windows"]) -> list[int]:
    """Indices of the widest window and of all others with enough sticks."""
    return [window for window, sticks in enumerate(in_window) if window == 0 or sticks >= FEW]


def _widest(moments: Moments, seen: Windows, agree: float) -> int:
    """Index of the widest window whose derivative is within `agree` standard errors of those of all narrower ones.

    By the `moments` of all samples, or of a half. Standard errors of their difference; and besides it may be off by a
    `tolerance`, in standard errors of the derivative.
    """
    usable = _usable(seen.in_window)
    mean, covariance = moments.mean, moments.covariance_of_mean
    a, b = mean[:2]
    if moments.number < 2 or not b > 0:
        return usable[0]

    def weights(window: int) -> Float[np.ndarray, " columns"]:
        # Of the derivative (da - (a / b) db) / b, linear in the means of its two columns.
        of = np.zeros(len(mean))
        of[2 + 2 * window : 4 + 2 * window] = 1 / b, -a / b**2
        return of

    for number, window in enumerate(usable):
        slack = seen.tolerance * math.sqrt(max(weights(window) @ covariance @ weights(window), 0.0))
        differences = [weights(window) - weights(narrower) for narrower in usable[number + 1 :]]
        # Windows that give the same, as by the likelihood of the switches, differ by round-off only.
        limits = [agree * math.sqrt(max(of @ covariance @ of, 0.0)) + _ROUND_OFF * (abs(of) @ abs(mean)) + slack
                  for of in differences]  # fmt: skip
        if all(abs(of @ mean) <= most for of, most in zip(differences, limits, strict=True)):
            return window
    return usable[-1]


# The results of `sensitivity`: derivatives, their errors, and how the errors of different ones are correlated.


def results_of(
    problem: SensitivityProblem,
    accumulated: Accumulator,
    widths: list[np.ndarray],
    elasticity: bool,
    estimator: Estimator,
    without_derivative: tuple[str, ...],
) -> list[dict[str, Sensitivity]]:
    """The results of each statistic by the names of the parameters; NaN by those `without_derivative`.

    They know how their errors are correlated: that follows from the derivative of each result by the means of all
    columns, in both halves of the samples (delta method). The errors themselves are those of each alone.
    """
    found: list[Sensitivity] = []
    slopes = []
    for number, statistic in enumerate(problem.statistics):
        for place, parameter in enumerate(problem.parameters):
            seen = accumulated.single(number, place)
            gradient, window, by_means = estimate_by_windows(seen, parameter.value if elasticity else None)
            if parameter.name in without_derivative:
                gradient = gradient._replace(derivative=math.nan, standard_error=math.nan)
            if estimator != "corrected":
                gradient = gradient._replace(pathwise=math.nan)
            result = Sensitivity(
                statistic=statistic.name,
                parameter=parameter.name,
                parameter_value=parameter.value,
                unit=statistic.unit,
                **gradient._asdict(),
                event=gradient.derivative - gradient.pathwise,
                is_elasticity=elasticity,
                estimator=estimator,
                samples=seen.moments.number,
                asked=problem.samples,
                sticks_in_window=int(seen.in_window[window]),
                relative_bandwidth=float(widths[number][window]),
                parameter_unit=unit_at(problem.model, parameter.path),
                origin=tuple(int(word) for word in np.asarray(problem.key_data)),
            )
            found.append(result)
            whole = np.zeros((2, len(accumulated.halves[0].mean)))
            whole[:, accumulated.columns(number, place)] = by_means
            slopes.append(whole)
    each_half = zip(accumulated.halves, np.stack(slopes, axis=1), strict=True)
    covariance = np.sum([of @ moments.covariance_of_mean @ of.T for moments, of in each_half], axis=0)
    spread, errors = np.sqrt(np.diag(covariance)), np.array([one.standard_error for one in found])
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where(spread > 0, errors / spread, 0)
    covariance = covariance * scale[:, None] * scale
    np.fill_diagonal(covariance, errors**2)
    shared = SharedErrors(covariance)
    found = [dataclasses.replace(one, _shared=(shared, place)) for place, one in enumerate(found)]
    each = len(problem.parameters)
    by_statistic = [found[first : first + each] for first in range(0, len(found), each)]
    return [{one.parameter: one for one in of_statistic} for of_statistic in by_statistic]
