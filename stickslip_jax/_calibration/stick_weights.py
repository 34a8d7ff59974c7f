"""Weights of the misfits of moments: from the recordings' covariance, or from the model (synthetic likelihood).

Both methods compare means over recordings with simulated means. Near the estimate either is a sum of squares of the
misfits: of moments weighted by the inverse of their covariance (Hansen 1982), or of means and mean products weighted by
their Fisher information, if a recording's numbers were jointly normal.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._sensitivity.statistic import StickStatistic
from .stick_moments import Observed, Product
from .stick_simulation import Simulated

_Square = Float[np.ndarray, "parameters parameters"]


class Part(NamedTuple):
    """What one experiment, or several, add to a fit.

    - `value`: half of the weighted sum of squares, or the negative logarithm of the likelihood but for a constant.
    - `gradient`, `hessian`: its derivatives by the parameters; the second by Gauss and Newton.
    - `noise`: what errors of the simulated derivatives add to `hessian`, on average.
    - `scores`: the covariance of `gradient`, from recordings and simulations.
    """

    value: float
    gradient: Float[np.ndarray, " parameters"]
    hessian: _Square
    noise: _Square
    scores: _Square

    @classmethod
    def total(cls, parts: "list[Part]") -> "Part":
        """The sum of independent parts."""
        return cls(*(sum(each) for each in zip(*parts, strict=True)))  # pyright: ignore[reportArgumentType]


def covariance_of_misfit(
    observed: Observed, simulated: Simulated, of_simulation: Float[np.ndarray, "moments moments"] | None = None
) -> Float[np.ndarray, "moments moments"]:
    """The covariance of the difference of observed and simulated means.

    `of_simulation`: that of one realisation's numbers; by default those of the recordings.
    """
    per_sample = observed.covariance if of_simulation is None else of_simulation
    return observed.covariance / observed.recordings + per_sample / simulated.samples


def by_moments(observed: Observed, simulated: Simulated, covariance: Float[np.ndarray, "moments moments"]) -> Part:
    """The weighted sum of squares of an experiment; `covariance` is that of the misfit."""
    weight = np.linalg.inv(covariance)
    misfit = observed.mean - simulated.mean
    weighted = simulated.slope.T @ weight
    hessian = weighted @ simulated.slope
    return Part(
        0.5 * float(misfit @ weight @ misfit), -weighted @ misfit, hessian, simulated.noise(weight), hessian
    )  # fmt: skip


def with_products(statistics: tuple[StickStatistic, ...]) -> tuple[StickStatistic, ...]:
    """The statistics and behind them their products with themselves and each other, as the normal likelihood needs."""
    one, other = np.triu_indices(len(statistics))
    return (*statistics, *(Product(statistics[i], statistics[j]) for i, j in zip(one, other, strict=True)))


def by_likelihood(observed: Observed, simulated: Simulated) -> Part:
    """The synthetic likelihood (Wood 2010) of an experiment: a recording's numbers are taken to be jointly normal.

    `simulated` holds means of the numbers and of their products. With their deviations from the simulated means, in
    units of the simulated standard deviations, the normal distribution has means and covariances as independent
    parameters, whose Fisher information is in closed form. The covariance of the score is that of the simulated numbers
    themselves, so that errors are right for others than normal numbers too.
    """
    number, recordings = observed.values.shape[1], observed.recordings
    one, other = np.triu_indices(number)
    mean = simulated.mean[:number]
    covariance = np.zeros((number, number))
    covariance[one, other] = covariance[other, one] = simulated.mean[number:] - mean[one] * mean[other]
    spread = np.sqrt(np.diag(covariance))
    to_standard = _standardising(mean, spread)
    deviations = (observed.values - mean) / spread
    correlation = covariance / np.outer(spread, spread)
    seen = deviations.T @ deviations / recordings
    inverse = np.linalg.inv(correlation)
    information = _information(correlation, inverse)
    misfit = np.concatenate([deviations.mean(axis=0), (seen - correlation)[one, other]])
    slope = to_standard @ simulated.slope
    weighted = recordings * slope.T @ information
    hessian = weighted @ slope
    of_means = to_standard @ simulated.covariance @ to_standard.T * (1 + simulated.samples / recordings)
    value = np.linalg.slogdet(correlation)[1] + 2 * math.fsum(np.log(spread)) + float(np.sum(inverse * seen))
    noise = simulated.noise(recordings * to_standard.T @ information @ to_standard)
    return Part(0.5 * recordings * value, -weighted @ misfit, hessian, noise, weighted @ of_means @ weighted.T)


def _standardising(mean: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The matrix that makes deviations of means and mean products those of standardised numbers, to first order."""
    number = len(mean)
    one, other = np.triu_indices(number)
    units, rows = np.eye(number), spread[one] * spread[other]
    by_means = -(units[one] * mean[other, None] + units[other] * mean[one, None]) / rows[:, None]
    above = np.hstack([np.diag(1 / spread), np.zeros((number, len(rows)))])
    return np.vstack([above, np.hstack([by_means, np.diag(1 / rows)])])


def _information(correlation: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """The Fisher information of a standardised normal distribution about its means and its covariances."""
    one, other = np.triu_indices(len(correlation))
    products = correlation[np.ix_(one, one)] * correlation[np.ix_(other, other)]
    products += correlation[np.ix_(one, other)] * correlation[np.ix_(other, one)]
    number = len(correlation)
    whole = np.zeros((number + len(one),) * 2)
    whole[:number, :number], whole[number:, number:] = inverse, np.linalg.inv(products)
    return whole
