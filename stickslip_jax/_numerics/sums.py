"""Histograms, moments and sums that are merged exactly, and the compiled loops that fill them."""

import math
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

# Histograms with dyadic bins, which merge exactly and hold every number.
#
# Bins have the width ``2**exponent`` and begin at multiples of it. The exponent is the least at which the range of the
# numbers takes no more than a given number of bins. So it depends on the smallest and the largest number only, not on
# the order of merging, and two bins of one exponent make one of the next.


_BINNED_AT_ONCE = 1 << 15

_FINEST = 30  # bits below the leading bit of the largest number: no bin is narrower than 1e-9 of that number
_LEAST = -200  # exponent of the narrowest bins, so that products of widths do not underflow


def exponent_for(low: float, high: float, bins: int, finest: int | None = None) -> int:
    """The least exponent, at least `finest`, at which ``[low, high]`` takes at most `bins` bins (2 or more)."""
    largest = max(abs(low), abs(high))
    least = max(math.frexp(largest)[1] - _FINEST, _LEAST) if largest > 0 else _LEAST
    exponent = least if finest is None else max(least, finest)
    if high > low:
        exponent = max(exponent, math.frexp((high - low) / bins)[1] - 1)
    while _floor(high, exponent) - _floor(low, exponent) >= bins:
        exponent += 1
    return exponent


def joined_bins(number: int, most: int) -> int:
    """How many of `number` bins to join into one, so that at most `most` are left and the last is nearly full.

    A last bin that extends far beyond the numbers would show too low a density.
    """
    least = -(-number // most)
    # The least number of which less than a tenth of the last bin is empty, or else that of which least is.
    return min(range(least, least + least // 8 + 1), key=lambda together: max(-number % together / together, 0.1))


def places(values: np.ndarray, low: float, exponent: int) -> np.ndarray:
    """The bin of each number, as an integer: bin i begins at ``i * 2**exponent``. `low`: the smallest number."""
    scaled = values * math.ldexp(1.0, -exponent)
    return (np.floor(scaled) if low < 0 else scaled).astype(np.int64)


class CommonBins(NamedTuple):
    """The bins of numbers from `low` to `high` along one axis, which several histograms may share.

    There are `number` of them, of width ``2**exponent``, from bin `first` on.
    """

    low: float
    high: float
    exponent: int
    first: int
    number: int

    @classmethod
    def within(cls, low: float, high: float, most: int, finest: int | None = None) -> "CommonBins":
        """At most `most` bins."""
        return cls.of_width(low, high, exponent_for(low, high, most, finest))

    @classmethod
    def of_width(cls, low: float, high: float, exponent: int) -> "CommonBins":
        """Bins of a given width."""
        first = _floor(low, exponent)
        return cls(low, high, exponent, first, _floor(high, exponent) - first + 1)

    @classmethod
    def of(cls, histograms: Iterable["DyadicCounts"], most: int) -> "CommonBins | None":
        """At most `most` bins for all numbers of some histograms of one axis; None if there are no numbers."""
        held = [one for one in histograms if one.low[0] <= one.high[0]]
        if not held:
            return None
        low, high = min(one.low[0] for one in held), max(one.high[0] for one in held)
        exponent = max([exponent_for(low, high, most, held[0].finest), *(one.exponent[0] for one in held)])
        return cls.of_width(low, high, exponent)

    def hold(self, histogram: "DyadicCounts") -> bool:
        """Whether all numbers of a histogram lie in these bins, and its own are no wider."""
        if histogram.low[0] > histogram.high[0]:
            return True
        places = [_floor(end[0], self.exponent) - self.first for end in (histogram.low, histogram.high)]
        return self.exponent >= histogram.exponent[0] and places[0] >= 0 and places[1] < self.number

    @property
    def edges(self) -> np.ndarray:
        """The edges of the bins, (number + 1,)."""
        return (self.first + np.arange(self.number + 1)) * math.ldexp(1.0, self.exponent)


class DyadicCounts(NamedTuple):
    """Counts of numbers, or of pairs of numbers, in dyadic bins; tuples have one entry for each axis (one or two).

    - `low`, `high`: the smallest and the largest number. `exponent`: that of the bin width. `first`: number of the
      first bin.
    - `counts`: (bins,) or (bins, bins), or with a leading axis where several histograms share their bins.
    - `most`: the largest number of bins. `finest`: the least exponent.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    exponent: tuple[int, ...]
    first: tuple[int, ...]
    counts: np.ndarray
    most: int
    finest: int | None = None

    @classmethod
    def of(cls, values: np.ndarray, most: int, finest: int | None = None) -> "DyadicCounts":
        """The histogram of `values`, (number,)."""
        return cls.of_columns((values,), most, finest)

    @classmethod
    def of_columns(cls, columns: tuple[np.ndarray, ...], most: int, finest: int | None = None) -> "DyadicCounts":
        """The joint histogram of `columns`, each (number,)."""
        if len(columns[0]) == 0:
            return cls.none(len(columns), most, finest)
        axes = [CommonBins.within(float(one.min()), float(one.max()), most, finest) for one in columns]
        shape = tuple(axis.number for axis in axes)
        counts = np.zeros(math.prod(shape), np.int64)
        for block in range(0, len(columns[0]), _BINNED_AT_ONCE):  # intermediate results stay in the cache
            flat = 0
            for values, axis in zip(columns, axes, strict=True):
                place = places(values[block : block + _BINNED_AT_ONCE], axis.low, axis.exponent)
                flat = flat * axis.number + (place - axis.first)
            counts += np.bincount(flat, minlength=len(counts))
        return cls.with_counts(axes, counts.reshape(shape), most, finest)

    @classmethod
    def with_counts(cls, axes: Sequence[CommonBins], counts: np.ndarray, most: int, finest: int | None = None):
        """The histogram with these `counts` on given `axes`."""
        lows, highs, exponents, firsts = zip(*(axis[:4] for axis in axes), strict=True)
        return cls(lows, highs, exponents, firsts, counts, most, finest)

    @classmethod
    def none(cls, axes: int, most: int, finest: int | None = None, groups: int = 0) -> "DyadicCounts":
        """The empty histogram."""
        shape = (groups,) * bool(groups) + (0,) * axes
        infinite = (math.inf,) * axes
        return cls(infinite, (-math.inf,) * axes, (0,) * axes, (0,) * axes, np.zeros(shape, np.int64), most, finest)

    def merge(self, other: "DyadicCounts") -> "DyadicCounts":
        """The histogram of both sets of numbers together."""
        if other.low[0] > other.high[0]:
            return self
        if self.low[0] > self.high[0]:
            return other
        low, high = tuple(map(min, self.low, other.low)), tuple(map(max, self.high, other.high))
        if (low, high) == (self.low, self.high):  # as nearly always where parts are added: its bins hold all
            sizes = self.counts.shape[-len(low) :]
            axes = [CommonBins(*axis) for axis in zip(low, high, self.exponent, self.first, sizes, strict=True)]
            return self._replace(counts=self.counts + other._on(axes))
        axes = [CommonBins.within(*pair, self.most, self.finest) for pair in zip(low, high, strict=True)]
        return self.with_counts(axes, self._on(axes) + other._on(axes), self.most, self.finest)

    def in_bins(self, bins: CommonBins) -> np.ndarray:
        """The counts of a histogram of one axis in `bins`, which must hold all its numbers and be no narrower.

        (bins,).
        """
        return np.zeros(bins.number, np.int64) if self.low[0] > self.high[0] else self._on([bins])

    def _on(self, axes: Sequence[CommonBins]) -> np.ndarray:
        """The counts in the bins of the `axes`, which are no narrower."""
        counts, lead = self.counts, self.counts.ndim - len(axes)
        for axis, (_, _, coarse, begin, size) in enumerate(axes):
            at = lead + axis
            old, first, shift = counts.shape[at], self.first[axis], coarse - self.exponent[axis]
            if shift == 0 and (first, old) == (begin, size):
                continue
            place = np.arange(first, first + old) >> shift
            starts = np.flatnonzero(np.diff(place, prepend=place[0] - 1))  # of the groups of bins that become one
            wide = np.zeros((*counts.shape[:at], size, *counts.shape[at + 1 :]), counts.dtype)
            before: tuple[Any, ...] = (slice(None),) * at
            into = slice(place[0] - begin, place[0] - begin + len(starts))  # neighbours stay neighbours
            wide[(*before, into)] = np.add.reduceat(counts, starts, axis=at) if shift else counts
            counts = wide
        return counts

    def edges(self, axis: int = 0) -> np.ndarray:
        """Edges of the bins along an axis, (bins + 1,)."""
        numbers = self.first[axis] + np.arange(self.counts.shape[self.counts.ndim - len(self.low) + axis] + 1)
        return numbers * math.ldexp(1.0, self.exponent[axis])


def _floor(value: float, exponent: int) -> int:
    return math.floor(math.ldexp(value, -exponent))


# Means and covariances of streams of vectors, merged exactly (Chan, Golub and LeVeque 1983).


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
        # By BLAS, the last digits of an entry would depend on how many other features there are.
        return cls(len(rows), mean, np.einsum("ni,nj->ij", centered, centered))

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


# Number, mean, covariance, third central moment and extremes of vectors, merged exactly (Pebay 2008).


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
        return PowerSums(*(column[index] for column in self))

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
        return PowerSums(
            number,
            # Weights of 0 and 1 keep the mean of the other side to the last bit.
            np.where(ours == 0, other.mean, self.mean + step * (theirs / whole)),
            self.scatter + other.scatter + spread[..., None] * step[..., :, None] * step[..., None, :],
            self.third
            + other.third
            + spread * ((ours - theirs) / whole) * step**3
            + 3 * step * (ours * other.squares - theirs * self.squares) / whole,
            np.minimum(self.smallest, other.smallest),
            np.maximum(self.largest, other.largest),
        )

    @property
    def squares(self) -> np.ndarray:
        """Sums of squares of deviations, (..., d)."""
        return np.diagonal(self.scatter, axis1=-2, axis2=-1)

    @property
    def variance(self) -> np.ndarray:
        """Unbiased variances, (..., d); NaN for fewer than two vectors."""
        number = self.number[..., None]
        return np.where(number > 1, self.squares / np.maximum(number - 1, 1), np.nan)

    @property
    def skewness(self) -> np.ndarray:
        """Third central moments over cubes of standard deviations (both over ``number``), (..., d); NaN where all are
        equal.
        """
        varies = self.squares > 0
        scale = np.where(varies, self.squares, 1.0) ** 1.5
        return np.where(varies, np.sqrt(self.number[..., None].astype(float)) * self.third / scale, np.nan)

    @property
    def correlation(self) -> np.ndarray:
        """Pearson correlations, (..., d, d); NaN where one of the two does not vary."""
        norm = np.sqrt(self.squares[..., :, None] * self.squares[..., None, :])
        return np.where(norm > 0, self.scatter / np.where(norm > 0, norm, 1.0), np.nan)


# Loops over sticks that would take NumPy many passes, compiled by Numba.
#
# They run without Python's lock, so that threads do not wait for one another. Indices are unsigned where speed matters,
# since Numba tests signed ones for being negative.


def compiled() -> ModuleType:
    """The module of the loops, imported on the first call: Numba takes half a second. Each compiles on its first call.

    For a Python that is newer than Numba the same loops run uncompiled, some hundred times slower.
    """
    from . import numba_loops  # noqa: PLC0415

    return numba_loops


def read_only(array: np.ndarray, dtype: type | None = None) -> np.ndarray:
    """The same numbers, contiguous and read-only: the loops are then compiled for one kind of array only."""
    array = np.ascontiguousarray(array, dtype).view()
    array.flags.writeable = False
    return array
