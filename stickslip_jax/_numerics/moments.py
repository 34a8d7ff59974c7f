"""Means and covariances of streams of vectors, merged exactly (Chan, Golub and LeVeque 1983)."""

from typing import NamedTuple

import numpy as np


class Moments(NamedTuple):
    """Number, mean vector and matrix of summed products of deviations of the vectors seen so far (float64)."""

    number: int
    mean: np.ndarray
    scatter: np.ndarray

    @classmethod
    def of(cls, rows: np.ndarray) -> "Moments":
        """Moments of the rows of an array (number, features)."""
        rows = np.asarray(rows, np.float64)
        if len(rows) == 0:
            return cls(0, np.zeros(rows.shape[1]), np.zeros((rows.shape[1],) * 2))
        mean = rows.mean(axis=0)
        centered = rows - mean
        return cls(len(rows), mean, centered.T @ centered)

    def merge(self, other: "Moments") -> "Moments":
        """Moments of both sets of vectors together."""
        number = self.number + other.number
        if number == 0 or other.number == 0:
            return self
        step = other.mean - self.mean
        share = other.number / number
        return Moments(
            number,
            self.mean + share * step,
            self.scatter + other.scatter + self.number * share * np.outer(step, step),
        )

    @property
    def covariance_of_mean(self) -> np.ndarray:
        """Covariance matrix of the mean vector; NaN for fewer than two vectors."""
        if self.number < 2:
            return np.full_like(self.scatter, np.nan)
        return self.scatter / (self.number - 1) / self.number
