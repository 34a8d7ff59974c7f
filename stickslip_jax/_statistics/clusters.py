"""Standard errors of statistics of pooled sticks: realisations are independent, the sticks of one are not.

A statistic is a function of averages over all sticks; to first order its error is the average of one influence value
for each stick. The influence values of one realisation are summed, and the spread of these sums over realisations is
the error (the linearised, "sandwich" error of a ratio of totals; Cochran, Sampling Techniques, 1977, chapter 6).
"""

import math

import numpy as np
from jaxtyping import Float, Int

from .estimate import RatioOfMeans


class Clusters:
    """Values of the retained realisations of an ensemble.

    - `values`: (number,). `owner`: the realisation of each value, (number,).
    - `realizations`: number of retained ones, those without any value included.
    - `of_all`: number of realisations that the statistic is from. Errors are measured on the retained ones and scaled.
    """

    def __init__(self, values: np.ndarray, owner: Int[np.ndarray, " number"], realizations: int, of_all: int):
        self.values = np.asarray(values, np.float64)
        self.owner, self.realizations, self.of_all = owner, realizations, of_all

    @property
    def scale(self) -> float:
        """Factor from the standard deviation of sums over realisations to a standard error.

        NaN for fewer than two realisations with values.
        """
        if self.realizations < 2 or len(self.values) < 2 or self.owner.min() == self.owner.max():
            return math.nan
        return self.realizations / len(self.values) / math.sqrt(self.of_all)

    def error(self, influence: Float[np.ndarray, " number"]) -> float:
        """The standard error of a statistic with these influence values."""
        if math.isnan(self.scale):
            return math.nan
        sums = np.bincount(self.owner, weights=influence, minlength=self.realizations)
        return float(sums.std(ddof=1)) * self.scale

    def of_mean(self, mean: float) -> RatioOfMeans:
        """What the interval of the `mean` needs, which is the ratio of the sum of all values to their number."""
        if math.isnan(self.scale):
            return RatioOfMeans(math.nan, math.nan)
        each, sums = (np.bincount(self.owner, weights, self.realizations) for weights in (None, self.values - mean))
        together = np.cov(each, sums) * self.scale**2
        return RatioOfMeans(float(together[0, 0]), float(together[0, 1]))

    def errors_of_shares(self, bins: Int[np.ndarray, " values"], number: int) -> Float[np.ndarray, " bins"]:
        """The standard errors of the shares of values in bins 0, 1, ..., `number` - 1.

        `bins`: the bin of each value; below 0 for none.
        """
        if math.isnan(self.scale):
            return np.full(number, math.nan)
        each = np.bincount(self.owner, minlength=self.realizations).astype(float)
        inside = bins >= 0
        cells, counts = np.unique(self.owner[inside] * number + bins[inside], return_counts=True)
        cell, owner = cells % number, cells // number
        # Sums over realisations of the count in a bin c, of c^2 and of c times the count in all bins n.
        total, square, product = (
            np.bincount(cell, weights=weights, minlength=number)
            for weights in (counts, counts.astype(float) ** 2, counts * each[owner])
        )
        share = total / len(self.values)
        spread = square - 2 * share * product + share**2 * (each @ each)  # sum of (c - share n)^2, whose mean is 0
        return np.sqrt(np.maximum(spread, 0) / (self.realizations - 1)) * self.scale
