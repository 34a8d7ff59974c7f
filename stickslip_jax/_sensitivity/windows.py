"""Choice among several windows: the widest that agrees with all narrower ones (Lepski's rule).

The standard error of an estimate whose window is chosen from the same samples is too small. So each half of the samples
chooses for the other: given the choice, the error is that of a fixed window.
"""

import math

import numpy as np

from .._numerics.moments import Moments
from .estimate import Gradient, gradient_of_ratio
from .estimators import Columns
from .runs import Accumulator

FEW = 100  # sticks: a narrower window with fewer is too noisy to judge others by
_AGREE = 2.0  # standard errors
_ROUND_OFF = 1e-12  # relative
_TORN = 4.0  # standard errors: by chance alone two windows differ so much once in 16,000 times


def estimate(accumulator: Accumulator, where: Columns, near: np.ndarray, log_by: float | None) -> tuple[Gradient, int]:
    """The derivative by one parameter, and the index of its window, the narrower one where the halves differ.

    `near` (windows,): how many sticks each window reached. `log_by`: the parameter's value, for elasticities. Where no
    two windows agree (`is_torn`), the error is NaN: that of the narrowest window says nothing of what it misses.
    """

    def derivative(moments: Moments, window: int) -> Gradient:
        return gradient_of_ratio(moments, where.derivative[window], where.pathwise, log_by)

    if is_torn(accumulator, where, near):
        narrowest = _usable(where, near)[-1]
        return derivative(accumulator.moments, narrowest)._replace(standard_error=math.nan), narrowest
    halves = accumulator.halves
    for_second, for_first = (_widest(half, where, near, _AGREE) for half in halves)
    whole = derivative(accumulator.moments, max(for_first, for_second))
    if for_first == for_second:
        return whole, for_first
    first, second = derivative(halves[0], for_first), derivative(halves[1], for_second)
    share = halves[0].number / accumulator.moments.number
    mixed = share * first.derivative + (1 - share) * second.derivative
    error = math.hypot(share * first.standard_error, (1 - share) * second.standard_error)
    return whole._replace(derivative=mixed, standard_error=error), max(for_first, for_second)


def is_torn(accumulator: Accumulator, where: Columns, near: np.ndarray) -> bool:
    """Whether even the two narrowest windows with enough sticks disagree by more than chance explains."""
    usable = _usable(where, near)
    return len(usable) > 1 and _widest(accumulator.moments, where, near, _TORN) == usable[-1]


def _usable(where: Columns, near: np.ndarray) -> list[int]:
    """Indices of the widest window and of all others with enough sticks."""
    return [window for window in range(len(where.derivative)) if window == 0 or near[window] >= FEW]


def _widest(moments: Moments, where: Columns, near: np.ndarray, agree: float) -> int:
    """Index of the widest window whose derivative is within `agree` standard errors of those of all narrower ones."""
    usable = _usable(where, near)
    mean, covariance = moments.mean, moments.covariance_of_mean
    a, b = mean[:2]
    if moments.number < 2 or not b > 0:
        return usable[0]

    def weights(window: int) -> np.ndarray:
        of, column = np.zeros(len(mean)), where.derivative[window]
        of[column : column + 2] = 1 / b, -a / b**2
        return of

    for number, window in enumerate(usable):
        differences = [weights(window) - weights(narrower) for narrower in usable[number + 1 :]]
        # Windows that give the same, as by the likelihood of the switches, differ by round-off only.
        limits = [agree * math.sqrt(max(of @ covariance @ of, 0.0)) + _ROUND_OFF * (abs(of) @ abs(mean))
                  for of in differences]  # fmt: skip
        if all(abs(of @ mean) <= most for of, most in zip(differences, limits, strict=True)):
            return window
    return usable[-1]
