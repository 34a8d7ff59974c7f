"""Whether residuals are white noise."""

import numpy as np
from scipy import stats

from .._statistics.verdicts import HypothesisTest

_MOST_LAGS = 20
_FEWEST = 20  # residuals


def whiteness(name: str, residuals: np.ndarray) -> HypothesisTest:
    """Test of Ljung and Box (1978, Biometrika 65, 297): whether residuals in the order of time are uncorrelated.

    Args:
        name: Of the channel.
        residuals: (times,); NaN, where nothing was measured, is left out.

    Returns:
        The test; its effect is the largest autocorrelation.
    """
    there = residuals[np.isfinite(residuals)]
    number = len(there)
    if number < _FEWEST or not np.any(there):
        return HypothesisTest(f"Ljung-Box, {name}", sizes=(number,), reason=f"fewer than {_FEWEST} residuals")
    lags = min(_MOST_LAGS, number // 5)
    centred = there - there.mean()
    power = centred @ centred
    correlation = np.array([centred[lag:] @ centred[:-lag] for lag in range(1, lags + 1)]) / power
    statistic = number * (number + 2) * np.sum(correlation**2 / (number - np.arange(1, lags + 1)))
    largest = correlation[np.argmax(np.abs(correlation))]
    p_value = float(stats.chi2.sf(statistic, lags))
    title = f"Ljung-Box over {lags} lags, {name}"
    return HypothesisTest(title, float(statistic), p_value, float(largest), "largest autocorrelation", sizes=(number,))
