"""The points of a parameter sweep: values of some parameters, on a grid, zipped, or from a design."""

import hashlib
import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from .. import _checks
from .._uncertainty.design import Design, given_twice

POINT = "point"
"""The name of the dimension of a design's points."""
MOST_POINTS = 10_000_000
"""Of a sweep, at most: each has a file of its own."""


class Dimension(NamedTuple):
    """One dimension of the points: parameters that change together. `values`: (length, parameters)."""

    name: str
    parameters: tuple[str, ...]
    values: np.ndarray

    def __len__(self) -> int:
        return len(self.values)


class Points(NamedTuple):
    """All points: every combination of an entry of each dimension, the last dimension running fastest."""

    dimensions: tuple[Dimension, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of all parameters."""
        return tuple(name for one in self.dimensions for name in one.parameters)

    @property
    def shape(self) -> tuple[int, ...]:
        """The length of each dimension."""
        return tuple(map(len, self.dimensions))

    @property
    def number(self) -> int:
        """The number of points."""
        return math.prod(self.shape)

    def values(self, number: int) -> tuple[float, ...]:
        """The values of all parameters at point `number`."""
        return tuple(self._rows(number).tolist())

    def _rows(self, numbers: int | np.ndarray) -> np.ndarray:
        """The values at points with these numbers, (..., parameters)."""
        indices = np.unravel_index(numbers, self.shape)
        rows = [one.values[index] for one, index in zip(self.dimensions, indices, strict=True)]
        return np.concatenate(rows, axis=-1, dtype=np.float64)

    def blocks(self, size: int) -> Iterator[tuple[int, np.ndarray]]:
        """The values at all points, `size` at a time: the number of the first, and an array (points, parameters)."""
        for first in range(0, self.number, size):
            yield first, self._rows(np.arange(first, min(first + size, self.number)))

    def number_of(self, values: Mapping[str, float]) -> int | None:
        """The first point with these values of all parameters, equal but for round-off; None if there is none."""
        indices = []
        for one in self.dimensions:
            wanted = np.array([values[name] for name in one.parameters])
            fits = np.flatnonzero(np.all(nearly_equal(one.values, wanted[None]), axis=1))
            if not len(fits):
                return None
            indices.append(int(fits[0]))
        return int(np.ravel_multi_index(indices, self.shape))

    def described(self, number: int) -> str:
        """Point `number` as text: "mu = 0.5, rate = 2"."""
        return ", ".join(
            f"{name} = {value:.6g}" for name, value in zip(self.parameters, self.values(number), strict=True)
        )

    def identity(self, number: int) -> str:
        """A name of point `number` that depends on its values only, 16 hexadecimal digits."""
        return identity_of(dict(zip(self.parameters, self.values(number), strict=True)))


def nearly_equal(values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Which numbers are equal but for round-off of how they were written."""
    return np.abs(values - wanted) <= 1e-9 * np.maximum(np.abs(values), np.abs(wanted))


def identity_of(values: Mapping[str, float]) -> str:
    """A name for these values of parameters, whatever their order, 16 hexadecimal digits."""
    text = ";".join(f"{name}={float(value).hex()}" for name, value in sorted(values.items()))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def points_of(over: object) -> Points:
    """The points that `over` describes; see `Sweep`. Raises ValueError for anything else."""
    if isinstance(over, Design):
        return Points((_dimension_of_design(over),))
    if not isinstance(over, Mapping) or not over:
        raise ValueError(
            "Argument over must be a dict from names of parameters to their values, such as {'mu': [0.5, 1.0]}, or a "
            f"design with values, but {_checks.show(over)} was given."
        )
    dimensions = tuple(_dimension(names, values) for names, values in over.items())
    points = Points(dimensions)
    twice = given_twice(points.parameters)
    if twice is not None:
        raise ValueError(f"Argument over must name every parameter once, but {twice!r} was given twice.")
    _check_number("over", points.number)
    return points


def _check_number(label: str, number: int) -> None:
    if number > MOST_POINTS:
        raise ValueError(
            f"Argument {label} must have at most {MOST_POINTS} points, but has {number}; take fewer values, or a "
            "design that spreads them."
        )


def _dimension_of_design(design: Design) -> Dimension:
    if design.values is None or design.names is None:
        raise ValueError(
            "Argument over must be a design with the values of named parameters, such as design.table or design.grid, "
            f"but {design!r} was given, which has uniform numbers; make values of them first."
        )
    _check_number("over", len(design))
    return _distinct(Dimension(POINT, design.names, np.asarray(design.values)), "over")


def _dimension(names: object, values: object) -> Dimension:
    several = isinstance(names, tuple)
    given = names if isinstance(names, tuple) else (names,)
    parameters = tuple(name for name in given if isinstance(name, str) and name)
    if not given or len(parameters) < len(given):
        raise ValueError(
            "Argument over must have names of parameters as keys, or tuples of names that change together, but "
            f"{_checks.show(names)} was given."
        )
    label = f"over[{names!r}]"
    if isinstance(values, range):  # which has no numbers yet
        _check_number(label, len(values))
    array = _checks.numbers(label, values, ndim=2 if several else 1).astype(np.float64)
    if not array.size or (several and array.shape[1] != len(parameters)):
        wanted = f"rows of {len(parameters)} numbers, one row for each point" if several else "at least one number"
        raise ValueError(f"Argument {label} must hold {wanted}, but {_checks.show(values)} was given.")
    if not np.all(np.isfinite(array)):
        wrong = array[~np.isfinite(array)][0]
        raise ValueError(f"Argument {label} must hold finite numbers, but {wrong} was given.")
    return _distinct(Dimension("_and_".join(parameters), parameters, array.reshape(len(array), -1)), label)


def _distinct(dimension: Dimension, label: str) -> Dimension:
    """`dimension`. Raises ValueError if two of its entries are the same point."""
    _check_number(label, len(dimension))
    order = np.lexsort(dimension.values.T[::-1])  # stable: of equal entries the first comes first
    repeats = np.zeros(len(dimension), bool)
    repeats[1:] = np.all(dimension.values[order[1:]] == dimension.values[order[:-1]], axis=1)
    if np.any(repeats):
        again = int(np.min(order[repeats]))
        row = dimension.values[again]
        first = int(np.argmax(np.all(dimension.values == row[None], axis=1)))
        shown = float(row[0]) if len(row) == 1 else tuple(row.tolist())
        raise ValueError(
            f"Argument {label} must hold every point once, but entries {first} and {again} are both {shown}."
        )
    return dimension
