"""Number, mean, covariance, third central moment and extremes of vectors, merged exactly (Pebay 2008)."""

from typing import NamedTuple

import numpy as np

_BLOCK = 1 << 15


class PowerSums(NamedTuple):
    """Power sums and extremes of vectors of d numbers; leading axes (...) hold separate sums.

    The sums are of deviations from the mean, so that merging loses no digits. Without any vector the mean is 0, and the
    smallest and largest numbers are infinity and minus infinity.
    """

    number: np.ndarray  # (...)
    mean: np.ndarray  # (..., d)
    scatter: np.ndarray  # (..., d, d): sums of products of deviations
    third: np.ndarray  # (..., d): sums of cubes of deviations
    smallest: np.ndarray  # (..., d)
    largest: np.ndarray  # (..., d)

    @classmethod
    def of(cls, *columns: np.ndarray) -> "PowerSums":
        """The sums of vectors whose components are the `columns`, each (number,)."""
        number, d = len(columns[0]), len(columns)
        if number == 0:
            return cls.none(d)
        mean = np.array([column.mean() for column in columns], np.float64)
        scatter, third = np.zeros((d, d)), np.zeros(d)
        # In blocks, so that intermediate results stay in the cache; without matrix products, whose threads would
        # compete with those of the simulation.
        for first in range(0, number, _BLOCK):
            rows = [column[first : first + _BLOCK] - center for column, center in zip(columns, mean, strict=True)]
            for a, row in enumerate(rows):
                square = row * row
                scatter[a, a] += square.sum()
                square *= row
                third[a] += square.sum()
                for b in range(a):
                    scatter[a, b] += (row * rows[b]).sum()
        scatter += np.tril(scatter, -1).T
        ends = ([float(getattr(column, end)()) for column in columns] for end in ("min", "max"))
        return cls(np.array(number), mean, scatter, third, *map(np.array, ends))

    @classmethod
    def stacked(cls, sums: "list[PowerSums]") -> "PowerSums":
        """Separate sums along a new leading axis."""
        return cls(*(np.stack(column) for column in zip(*sums, strict=True)))

    def one(self, index: int) -> "PowerSums":
        """The sums at one `index` of the leading axis."""
        return PowerSums(
            self.number[index], self.mean[index], self.scatter[index], self.third[index], self.smallest[index],
            self.largest[index],
        )  # fmt: skip

    @classmethod
    def none(cls, d: int) -> "PowerSums":
        """Sums of no vectors of `d` numbers."""
        zeros = np.zeros(d)
        return cls(np.array(0), zeros, np.zeros((d, d)), zeros, np.full(d, np.inf), np.full(d, -np.inf))

    def merge(self, other: "PowerSums") -> "PowerSums":
        """Sums of both sets of vectors together."""
        number = self.number + other.number
        whole = np.maximum(number, 1).astype(float)[..., None]
        ours, theirs = self.number[..., None], other.number[..., None]
        step = other.mean - self.mean
        spread = ours * (theirs / whole)
        square = np.diagonal(self.scatter, axis1=-2, axis2=-1), np.diagonal(other.scatter, axis1=-2, axis2=-1)
        return PowerSums(
            number,
            # Weights of 0 and 1 keep the mean of the other side to the last bit.
            np.where(ours == 0, other.mean, self.mean + step * (theirs / whole)),
            self.scatter + other.scatter + spread[..., None] * step[..., :, None] * step[..., None, :],
            self.third
            + other.third
            + spread * ((ours - theirs) / whole) * step**3
            + 3 * step * (ours * square[1] - theirs * square[0]) / whole,
            np.minimum(self.smallest, other.smallest),
            np.maximum(self.largest, other.largest),
        )

    @property
    def variance(self) -> np.ndarray:
        """Unbiased variances, (..., d); NaN for fewer than two vectors."""
        square = np.diagonal(self.scatter, axis1=-2, axis2=-1)
        number = self.number[..., None]
        return np.where(number > 1, square / np.maximum(number - 1, 1), np.nan)

    @property
    def skewness(self) -> np.ndarray:
        """Third central moments over cubes of standard deviations (both over ``number``), (..., d); NaN where all are
        equal.
        """
        square = np.diagonal(self.scatter, axis1=-2, axis2=-1)
        varies = square > 0
        scale = np.where(varies, square, 1.0) ** 1.5
        return np.where(varies, np.sqrt(self.number[..., None].astype(float)) * self.third / scale, np.nan)

    @property
    def correlation(self) -> np.ndarray:
        """Pearson correlations, (..., d, d); NaN where one of the two does not vary."""
        square = np.diagonal(self.scatter, axis1=-2, axis2=-1)
        norm = np.sqrt(square[..., :, None] * square[..., None, :])
        return np.where(norm > 0, self.scatter / np.where(norm > 0, norm, 1.0), np.nan)
