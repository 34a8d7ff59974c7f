"""Choice among several windows: the widest that agrees with all narrower ones (Lepski's rule).

The standard error of an estimate whose window is chosen from the same samples is too small. So each half of the samples
chooses for the other: given the choice, the error is that of a fixed window.
"""

import math
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from .._numerics.moments import Moments
from .chunks import Accumulator, DerivativeColumns
from .estimate import Gradient, gradient_of_ratio, slope_by_means

_InWindow: TypeAlias = Float[np.ndarray, " windows"]
"""How many sticks each window holds."""

COUNTED, PAIRED, RECORDED = (1.0, 0.25), (1.0, 0.25), (1.0, 0.5, 0.25, 0.125)  # relative widths to choose from
OUTPUT = (1.0, 0.25, 0.0625)
FEW = 100  # sticks: a narrower window with fewer is too noisy to judge others by
_AGREE = 2.0  # standard errors
_DISAGREE = 4.0  # standard errors: by chance alone two windows differ so much once in 16,000 times
_ROUND_OFF = 1e-12  # relative


def estimate(
    accumulator: Accumulator, columns: DerivativeColumns, in_window: _InWindow, elasticity_at: float | None
) -> tuple[Gradient, int]:
    """The derivative by one parameter, and the index of its window, the narrower one where the halves differ.

    `elasticity_at`: the parameter's value, for elasticities. Where no two windows agree (`windows_disagree`), the error
    is NaN: that of the narrowest window says nothing of its bias.
    """

    def derivative(moments: Moments, window: int) -> Gradient:
        return gradient_of_ratio(moments, columns.derivative[window], columns.pathwise, elasticity_at)

    if windows_disagree(accumulator, columns, in_window):
        narrowest = _usable(columns, in_window)[-1]
        return derivative(accumulator.moments, narrowest)._replace(standard_error=math.nan), narrowest
    halves = accumulator.halves
    for_second, for_first = (_widest(half, columns, in_window, _AGREE, accumulator.tolerance) for half in halves)
    whole = derivative(accumulator.moments, max(for_first, for_second))
    if for_first == for_second:
        return whole, for_first
    first, second = derivative(halves[0], for_first), derivative(halves[1], for_second)
    share = halves[0].number / accumulator.moments.number
    mixed = share * first.derivative + (1 - share) * second.derivative
    error = math.hypot(share * first.standard_error, (1 - share) * second.standard_error)
    return whole._replace(derivative=mixed, standard_error=error), max(for_first, for_second)


def influence(
    accumulator: Accumulator, columns: DerivativeColumns, in_window: _InWindow, elasticity_at: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """The derivative of `estimate`'s result by the mean of every column in the first and in the second half."""

    def slope(moments: Moments, window: int) -> np.ndarray:
        return slope_by_means(moments, columns.derivative[window], elasticity_at)

    halves, whole = accumulator.halves, accumulator.moments
    if windows_disagree(accumulator, columns, in_window):
        unknown = np.full_like(whole.mean, math.nan)
        return unknown, unknown
    for_second, for_first = (_widest(half, columns, in_window, _AGREE, accumulator.tolerance) for half in halves)
    share = halves[0].number / max(whole.number, 1)
    if for_first == for_second:
        both = slope(whole, for_first)
        return share * both, (1 - share) * both
    return share * slope(halves[0], for_first), (1 - share) * slope(halves[1], for_second)


def windows_disagree(accumulator: Accumulator, columns: DerivativeColumns, in_window: _InWindow) -> bool:
    """Whether even the two narrowest windows with enough sticks disagree by more than chance explains."""
    usable = _usable(columns, in_window)
    return (
        len(usable) > 1
        and _widest(accumulator.moments, columns, in_window, _DISAGREE, accumulator.tolerance) == usable[-1]
    )


def _usable(columns: DerivativeColumns, in_window: _InWindow) -> list[int]:
    """Indices of the widest window and of all others with enough sticks."""
    return [window for window in range(len(columns.derivative)) if window == 0 or in_window[window] >= FEW]


def _widest(moments: Moments, columns: DerivativeColumns, in_window: _InWindow, agree: float, tolerance: float) -> int:
    """Index of the widest window whose derivative is within `agree` standard errors of those of all narrower ones.

    Standard errors of their difference; and besides it may be off by `tolerance` standard errors of the derivative.
    """
    usable = _usable(columns, in_window)
    mean, covariance = moments.mean, moments.covariance_of_mean
    a, b = mean[:2]
    if moments.number < 2 or not b > 0:
        return usable[0]

    def weights(window: int) -> Float[np.ndarray, " columns"]:
        # Of the derivative (da - (a / b) db) / b, linear in the means of its two columns.
        of, column = np.zeros(len(mean)), columns.derivative[window]
        of[column : column + 2] = 1 / b, -a / b**2
        return of

    for number, window in enumerate(usable):
        slack = tolerance * math.sqrt(max(weights(window) @ covariance @ weights(window), 0.0))
        differences = [weights(window) - weights(narrower) for narrower in usable[number + 1 :]]
        # Windows that give the same, as by the likelihood of the switches, differ by round-off only.
        limits = [agree * math.sqrt(max(of @ covariance @ of, 0.0)) + _ROUND_OFF * (abs(of) @ abs(mean)) + slack
                  for of in differences]  # fmt: skip
        if all(abs(of @ mean) <= most for of, most in zip(differences, limits, strict=True)):
            return window
    return usable[-1]
