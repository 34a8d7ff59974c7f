"""The results of `sensitivity`: derivatives, their errors, and how the errors of different ones are correlated."""

import dataclasses
import math

import numpy as np

from .._statistics.estimate import SharedErrors
from .._systems.units import unit_at
from . import windows
from .chunks import Accumulator, JointAccumulator
from .estimate import Estimator, Sensitivity
from .problem import Problem


def results_of(
    problem: Problem,
    accumulated: JointAccumulator,
    widths: list[np.ndarray],
    elasticity: bool,
    estimator: Estimator,
    without_derivative: tuple[str, ...],
) -> list[dict[str, Sensitivity]]:
    """The results of each statistic by the names of the parameters; NaN by those `without_derivative`."""
    found, slopes = [], []
    for number in range(len(problem.statistics)):
        one, own = accumulated.single(number), accumulated.slice_of(number)
        found.append(_single(problem, number, one, widths[number], elasticity, estimator, without_derivative))
        for parameter, where, in_window in zip(problem.parameters, one.columns, one.in_window, strict=True):
            of_halves = windows.influence(one, where, in_window, parameter.value if elasticity else None)
            whole = [np.zeros(len(half.mean)) for half in accumulated.halves]
            for slope, mine in zip(whole, of_halves, strict=True):
                slope[own] = mine
            slopes.append(whole)
    return _with_shared_errors(found, accumulated, slopes)


def _single(
    problem: Problem, number: int, accumulator: Accumulator, widths: np.ndarray, elasticity: bool,
    estimator: Estimator, without_derivative: tuple[str, ...],
) -> dict[str, Sensitivity]:  # fmt: skip
    """The results of one statistic."""
    results, statistic = {}, problem.statistics[number]
    by_parameter = zip(problem.parameters, accumulator.columns, accumulator.in_window, strict=True)
    for parameter, where, in_window in by_parameter:
        found, chosen = windows.estimate(accumulator, where, in_window, parameter.value if elasticity else None)
        if parameter.name in without_derivative:
            found = found._replace(derivative=math.nan, standard_error=math.nan)
        pathwise = found.pathwise if estimator == "corrected" else math.nan
        results[parameter.name] = Sensitivity(
            statistic=statistic.name,
            parameter=parameter.name,
            parameter_value=parameter.value,
            unit=statistic.unit,
            value=found.value,
            value_error=found.value_error,
            derivative=found.derivative,
            standard_error=found.standard_error,
            pathwise=pathwise,
            event=found.derivative - pathwise,
            is_elasticity=elasticity,
            estimator=estimator,
            samples=accumulator.moments.number,
            asked=problem.samples,
            sticks_in_window=int(in_window[chosen]),
            relative_bandwidth=float(widths[chosen]),
            parameter_unit=unit_at(problem.model, parameter.path),
            origin=tuple(int(word) for word in np.asarray(problem.key_data)),
        )
    return results


def _with_shared_errors(
    found: list[dict[str, Sensitivity]], accumulated: JointAccumulator, slopes: list[list[np.ndarray]]
) -> list[dict[str, Sensitivity]]:
    """The results, which know how their errors are correlated.

    `slopes`: the derivative of each result by the means of all columns, in both halves of the samples. The correlation
    follows from these (delta method); the errors stay as they are.
    """
    covariance = np.zeros((len(slopes), len(slopes)))
    for half, moments in enumerate(accumulated.halves):
        of = np.array([one[half] for one in slopes])
        covariance = covariance + of @ moments.covariance_of_mean @ of.T
    spread = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.where(spread[:, None] * spread > 0, covariance / (spread[:, None] * spread), 0)
    np.fill_diagonal(correlation, 1)
    errors = np.array([one.standard_error for by_name in found for one in by_name.values()])
    shared, places = SharedErrors(correlation * errors[:, None] * errors), iter(range(len(errors)))
    return [
        {name: dataclasses.replace(one, _shared=(shared, next(places))) for name, one in by_name.items()}
        for by_name in found
    ]
