"""Noise of recorded motions: how it is told from motion, and taken out.

Each point is compared with the straight line between the points before and after it, and between those two before and
two after: differences of the second order, divided by what independent errors of unit variance would make of them. Of
independent errors both mean squares are the variance, their ratio is 1. Of a motion that the points resolve the second
is 16 times the first (a smooth velocity), 6 times (kinks), or twice (jumps; random steps; a random walk, the roughest).

The logarithm of the ratio has, for a random walk of N points, the mean log 2 and the standard deviation 1.87 / sqrt(N):
both differences are moving averages of normal numbers, with autocorrelations -1/2 and 1/4, -1/2, -1/4, whose mean
squares have the relative variances 3 / N and 3.5 / N and the covariance 1.5 / N. With the largest ones cut it is 1.95.
A ratio below ``2 exp(-6 / sqrt(N))`` is three of these away: 1 in 1000 random walks is taken for noise, and fewer of
what is smoother.
"""

import math
import sys
import warnings

import numpy as np
from jaxtyping import Float

from .. import _checks
from .._types import AnyArray

_FEWEST = 50  # points; of fewer the ratio says too little
_RANDOM_WALK, _FALSE_ALARM = math.log(2.0), 6.0
_CUT = 3.0  # standard deviations: jumps of a square wave with noise must not hide the noise
_NORMAL_MEDIAN = 0.67449  # of the absolute value of a standard normal number
_LARGEST = 0.3  # of the root mean square: what is larger is the motion itself
_LEAST = 0.1  # of the root mean square change from point to point: what is smaller does no harm
_COARSEST, _FINEST = 1 / 2, 1 / 2000  # cutoff times the time between points; below, the spline loses digits

_INNER = (__name__.partition(".")[0], "equinox", "jaxtyping", "beartype", "importlib")  # whose lines no user wrote

PerPoint = Float[np.ndarray, " points"]


def warn_of_noise(times: AnyArray, values: AnyArray) -> None:
    """Warn of a record that looks like a motion with independent errors; nothing is asked of traced numbers."""
    if _checks.is_traced(times) or _checks.is_traced(values) or len(times) < _FEWEST:
        return
    times, values = np.asarray(times, float), np.asarray(values, float)
    noise = noise_of(times, values)
    if noise is None:
        return
    rate = math.sqrt(2) * noise / float(np.median(np.diff(times)))
    level, frame = 1, sys._getframe()  # up to the line that made the record: the first outside the package
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _INNER:
        level, frame = level + 1, frame.f_back
    warnings.warn(
        f"The record of {len(times)} points looks noisy: from point to point it jumps by independent errors of about "
        f"{noise:.2g} (standard deviation, in the unit of the values), which as a base velocity in m/s accelerate by "
        f"{rate:.2g} m/s^2 and break sticks into many short ones. Smooth it, Recorded.smoothed(times, values, "
        "cutoff_hz=...) or read_recorded_csv(..., cutoff_hz=...); where every point is meant, call "
        "warnings.filterwarnings('ignore', message='The record of').",
        RuntimeWarning,
        stacklevel=level,
    )


def noise_of(times: PerPoint, values: PerPoint) -> float | None:
    """The standard deviation of the independent errors in a record; None where it does not look noisy."""
    one, two = _mean_square(times, values, 1), _mean_square(times, values, 2)
    if not one > 0:
        return None
    bound = min(_RANDOM_WALK / 2, _RANDOM_WALK - _FALSE_ALARM / math.sqrt(len(times)))
    noise, size = math.sqrt(one), math.sqrt(np.mean(values**2))
    change = math.sqrt(_mean_without_jumps(np.diff(values) ** 2))
    is_noise = two < one * math.exp(bound)
    matters = noise < _LARGEST * size and math.sqrt(2) * noise > _LEAST * change
    return noise if is_noise and matters else None


def _mean_square(times: PerPoint, values: PerPoint, apart: int) -> float:
    """The mean square, with the largest ones cut, of the differences of points from lines between others.

    They are divided by what errors of unit variance make of them; 0 where half of the points lie on the line.
    """
    before, here, after = slice(None, -2 * apart), slice(apart, -apart), slice(2 * apart, None)
    share = (times[after] - times[here]) / (times[after] - times[before])
    away = values[here] - share * values[before] - (1 - share) * values[after]
    return _mean_without_jumps(away**2 / (1 + share**2 + (1 - share) ** 2))


def _mean_without_jumps(squares: Float[np.ndarray, " differences"]) -> float:
    """The mean, with what is far above the median cut."""
    most = (_CUT / _NORMAL_MEDIAN) ** 2 * np.median(squares)
    return float(np.mean(np.minimum(squares, most)))


def smoothed_values(times: AnyArray, values: AnyArray, cutoff_hz: float) -> tuple[PerPoint, str]:
    """The values of a record, smoothed as `Recorded.smoothed` says, and what was done in words.

    The spline minimises ``sum w (value - s)^2 + integral s''^2 / (2 pi cutoff)^4`` with the time that each point stands
    for as its weight w: its response to a frequency f is then ``1 / (1 + (f / cutoff)^4)`` (P. Craven and G. Wahba,
    Numer. Math. 31 (1979)).
    """
    from scipy.interpolate import make_smoothing_spline  # noqa: PLC0415 - loaded when asked for

    if _checks.is_traced(times) or _checks.is_traced(values) or _checks.is_traced(cutoff_hz):
        raise ValueError(
            "Recorded.smoothed needs numbers, but JAX is tracing them; smooth the record outside jit, vmap and grad."
        )
    times, values = np.asarray(times, float), np.asarray(values, float)
    if times.shape != values.shape or len(times) < 5:
        raise ValueError(
            "Arguments times and values must have the same length of at least 5 to be smoothed, but they have shapes "
            f"{times.shape} and {values.shape}."
        )
    _checks.increasing_from_zero("times", times, "subtract it to start the record there")
    _checks.positive("cutoff_hz", cutoff_hz, "Hz")
    apart = np.diff(times)
    usual, cutoff = float(np.median(apart)), float(cutoff_hz)
    if not _FINEST <= cutoff * usual <= _COARSEST:
        hint = "or give every tenth point only, say" if cutoff * usual < _FINEST else "the points resolve no more"
        bounds = f"{_FINEST / usual:.4g} and {_COARSEST / usual:.4g} Hz"
        raise _checks.refused("cutoff_hz", f"be between {bounds} for points {usual:.4g} s apart", cutoff_hz, hint)
    weights = (np.append(apart, 0) + np.append(0, apart)) / 2
    unit = 1 / (2 * math.pi * cutoff)
    spline = make_smoothing_spline(times / unit, values, w=weights / unit, lam=1.0)
    return spline(times / unit), f"cubic smoothing spline, half of the amplitude at {cutoff:g} Hz"
