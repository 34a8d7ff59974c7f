"""Confidence intervals by resampling whole samples, for skewed statistics where Student's t is too crude."""

import math

import numpy as np

from .. import _checks
from .._numerics.moments import Moments
from .estimate import DEFAULT_LEVEL, check_level
from .source import EnsembleLike, Statistic, by_totals

_AT_ONCE = 2**22  # random weights: 32 MB


def bootstrap_interval(
    statistic: Statistic,
    ensemble: EnsembleLike,
    *,
    level: float = DEFAULT_LEVEL,
    resamples: int = 2000,
    seed: int = 0,
) -> tuple[float, float]:
    """The bootstrap-t confidence interval of a statistic at `level` (Efron and Tibshirani 1993, section 12.5).

    Whole samples are drawn with replacement, never single sticks, because the sticks of one sample are dependent. The
    deviation of each resample is divided by the resample's own standard error, which accounts for skewness.

    Args:
        statistic: A function of an ensemble's totals such as `stick_fraction` or `mean_stick_duration`.
        ensemble: An `Ensemble` with ``keep="statistics"`` or ``"sticks"``. The draws are from its retained samples; the
            interval is for all its samples.
        level: The probability that the interval holds the true value.
        resamples: Their number.
        seed: Of the draws.

    Returns:
        The two ends, in the unit of the statistic; NaN, NaN where the statistic or its error is not defined.

    Raises:
        ValueError: For other arguments.
    """
    check_level(level)
    _checks.whole_number("resamples", resamples, minimum=100, maximum=10**7)
    totals, whole, estimate_from = by_totals(statistic, ensemble)
    number = len(totals)
    if number < 2 or not whole.standard_error > 0:
        return math.nan, math.nan
    center = estimate_from(Moments.of(totals)).value
    rng = np.random.default_rng(_checks.whole_number("seed", seed, minimum=0))
    at_once = max(1, _AT_ONCE // number)
    scores = np.empty(resamples)
    for first in range(0, resamples, at_once):
        weights = rng.multinomial(number, np.full(number, 1 / number), size=min(at_once, resamples - first))
        for index, moments in enumerate(_weighted_moments(totals, weights), first):
            one = estimate_from(moments)
            scores[index] = (one.value - center) / one.standard_error if one.standard_error > 0 else math.nan
    if not np.any(np.isfinite(scores)):  # all samples are the same
        return math.nan, math.nan
    low, high = np.nanquantile(scores, ((1 + level) / 2, (1 - level) / 2))
    return whole.value - float(low) * whole.standard_error, whole.value - float(high) * whole.standard_error


def _weighted_moments(totals: np.ndarray, weights: np.ndarray) -> list[Moments]:
    """`Moments` of resamples of the rows of `totals` (samples, d).

    `weights` (resamples, samples): how often each resample holds each row.
    """
    number, center = len(totals), totals.mean(axis=0)
    rows = totals - center
    products = (rows[:, :, None] * rows[:, None, :]).reshape(number, -1)
    means, squares = weights @ rows / number, weights @ products
    return [
        Moments(number, center + mean, square.reshape(len(mean), -1) - number * np.outer(mean, mean))
        for mean, square in zip(means, squares, strict=True)
    ]
