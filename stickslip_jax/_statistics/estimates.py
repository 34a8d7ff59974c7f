"""First statistics of an ensemble, each with its standard error.

All are functions of the mean of a few totals per sample; samples are independent, the sticks of one sample are not,
so the errors come from the covariance of the totals over samples (for ratios: the delta method).
"""

import math
from typing import Any

import numpy as np

from .estimate import Estimate
from .source import FEATURES, require_ensemble


def stick_fraction(ensemble: Any) -> Estimate:
    """Mean share of ``[0, t1]`` spent sticking, ``E[total stick time] / t1``."""
    return _linear("stick fraction", ensemble, "stick_time", 1 / require_ensemble(ensemble).t1, "1")


def mean_stick_count(ensemble: Any) -> Estimate:
    """Mean number of sticks that begin in ``[0, t1]``, those cut by the horizon included."""
    return _linear("mean number of sticks", ensemble, "stick_count", 1.0, "1")


def mean_slip_count(ensemble: Any) -> Estimate:
    """Mean number of slips in ``[0, t1]``, those cut by the horizon included."""
    return _linear("mean number of slips", ensemble, "slip_count", 1.0, "1")


def mean_stick_duration(ensemble: Any) -> Estimate:
    """Pooled mean stick duration ``E[total stick time] / E[number of sticks]``, s.

    A stick cut by the horizon counts with the part seen. NaN if there was no stick.
    """
    time, count = _axis("stick_time"), _axis("stick_count")
    return _ratio("mean stick duration (pooled)", ensemble, time, count)


def mean_slip_duration(ensemble: Any) -> Estimate:
    """Pooled mean slip duration ``(t1 - E[total stick time]) / E[number of slips]``, s.

    A slip cut by the horizon counts with the part seen. NaN if there was no slip.
    """
    t1 = require_ensemble(ensemble).t1
    return _ratio("mean slip duration (pooled)", ensemble, -_axis("stick_time"), _axis("slip_count"), t1)


def _axis(feature: str) -> np.ndarray:
    return np.eye(len(FEATURES))[FEATURES.index(feature)]


def _linear(name: str, ensemble: Any, feature: str, factor: float, unit: str) -> Estimate:
    weights = factor * _axis(feature)
    return _estimate(name, ensemble, float(weights @ require_ensemble(ensemble).moments.mean), weights, unit)


def _ratio(name: str, ensemble: Any, above: np.ndarray, below: np.ndarray, offset: float = 0.0) -> Estimate:
    """``(offset + above . mean) / (below . mean)`` with the delta method's error."""
    mean = require_ensemble(ensemble).moments.mean
    denominator = float(below @ mean)
    if not denominator > 0:
        return Estimate(name, math.nan, math.nan, "s", ensemble.moments.number)
    value = (offset + float(above @ mean)) / denominator
    return _estimate(name, ensemble, value, (above - value * below) / denominator, "s")


def _estimate(name: str, ensemble: Any, value: float, gradient: np.ndarray, unit: str) -> Estimate:
    moments = ensemble.moments
    if moments.number == 0:
        return Estimate(name, math.nan, math.nan, unit, 0)
    variance = float(gradient @ moments.covariance_of_mean @ gradient)
    return Estimate(name, value, math.sqrt(max(variance, 0.0)), unit, moments.number)
