"""First statistics of an ensemble, each with its standard error.

All are functions of the mean of a few totals per sample; samples are independent, the sticks of one sample are not,
so the errors come from the covariance of the totals over samples (for ratios: the delta method).
"""

import dataclasses
import math

import numpy as np

from ..ensemble_result import FEATURES, Ensemble


@dataclasses.dataclass(frozen=True)
class Estimate:
    """An estimated number, its standard error (one standard deviation), both in `unit`, and what it rests on."""

    name: str
    value: float
    standard_error: float
    unit: str
    samples: int

    def __str__(self) -> str:
        if math.isnan(self.value):
            return f"{self.name}: not defined (no such event in {self.samples} samples)"
        unit = "" if self.unit == "1" else f" {self.unit}"
        if math.isnan(self.standard_error):
            return f"{self.name}: {self.value:.6g}{unit} (no error from one sample)"
        return f"{self.name}: {format_with_error(self.value, self.standard_error)}{unit}"


def format_with_error(value: float, error: float) -> str:
    """``value +- error``, the error to two digits and the value to the same decimal place."""
    if not (math.isfinite(error) and error > 0 and math.isfinite(value)):
        return f"{value:.6g} +- {error:.2g}"
    decimals = max(0, 1 - math.floor(math.log10(error)))
    if decimals > 9:
        return f"{value:.6g} +- {error:.2g}"
    return f"{value:.{decimals}f} +- {error:.{decimals}f}"


def stick_fraction(ensemble: Ensemble) -> Estimate:
    """Mean share of ``[0, t1]`` spent sticking, ``E[total stick time] / t1``."""
    return _linear("stick fraction", ensemble, "stick_time", 1 / _require_ensemble(ensemble).t1, "1")


def mean_stick_count(ensemble: Ensemble) -> Estimate:
    """Mean number of sticks that begin in ``[0, t1]``, those cut by the horizon included."""
    return _linear("mean number of sticks", ensemble, "stick_count", 1.0, "1")


def mean_slip_count(ensemble: Ensemble) -> Estimate:
    """Mean number of slips in ``[0, t1]``, those cut by the horizon included."""
    return _linear("mean number of slips", ensemble, "slip_count", 1.0, "1")


def mean_stick_duration(ensemble: Ensemble) -> Estimate:
    """Pooled mean stick duration ``E[total stick time] / E[number of sticks]``, s.

    A stick cut by the horizon counts with the part seen. NaN if there was no stick.
    """
    time, count = _axis("stick_time"), _axis("stick_count")
    return _ratio("mean stick duration (pooled)", ensemble, time, count)


def mean_slip_duration(ensemble: Ensemble) -> Estimate:
    """Pooled mean slip duration ``(t1 - E[total stick time]) / E[number of slips]``, s.

    A slip cut by the horizon counts with the part seen. NaN if there was no slip.
    """
    t1 = _require_ensemble(ensemble).t1
    return _ratio("mean slip duration (pooled)", ensemble, -_axis("stick_time"), _axis("slip_count"), t1)


def _require_ensemble(ensemble: Ensemble) -> Ensemble:
    if not isinstance(ensemble, Ensemble):
        raise ValueError(
            f"Argument ensemble must be the result of simulate_ensemble, but {type(ensemble).__name__} was given; "
            "a single simulation has .stick_fraction, .sticks and .slips itself."
        )
    return ensemble


def _axis(feature: str) -> np.ndarray:
    return np.eye(len(FEATURES))[FEATURES.index(feature)]


def _linear(name: str, ensemble: Ensemble, feature: str, factor: float, unit: str) -> Estimate:
    weights = factor * _axis(feature)
    return _estimate(name, ensemble, float(weights @ _require_ensemble(ensemble).moments.mean), weights, unit)


def _ratio(name: str, ensemble: Ensemble, above: np.ndarray, below: np.ndarray, offset: float = 0.0) -> Estimate:
    """``(offset + above . mean) / (below . mean)`` with the delta method's error."""
    mean = _require_ensemble(ensemble).moments.mean
    denominator = float(below @ mean)
    if not denominator > 0:
        return Estimate(name, math.nan, math.nan, "s", ensemble.moments.number)
    value = (offset + float(above @ mean)) / denominator
    return _estimate(name, ensemble, value, (above - value * below) / denominator, "s")


def _estimate(name: str, ensemble: Ensemble, value: float, gradient: np.ndarray, unit: str) -> Estimate:
    moments = ensemble.moments
    if moments.number == 0:
        return Estimate(name, math.nan, math.nan, unit, 0)
    variance = float(gradient @ moments.covariance_of_mean @ gradient)
    return Estimate(name, value, math.sqrt(max(variance, 0.0)), unit, moments.number)
