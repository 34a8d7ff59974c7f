"""A design: a table with one row for each sample of an ensemble."""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from .. import _checks
from .._types import DType

REALIZATION_FACTOR = "realization"
"""The name of the realisation where Sobol' indices treat it as one more factor."""

MOST_SAMPLES, MOST_NUMBERS = 2**30, 2**28
"""Rows of a design, and numbers in its table (2 GiB), at most."""
_MOST_REALIZATIONS = 2**32
_SHOWN = 6  # names in one line


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Design:
    """Numbers for every sample of an ensemble: a table with a row for each sample and a column for each number.

    The functions of `stickslip_jax.design` make designs. The arrays of a design are NumPy's and cannot be written to.

    - `names`: of the columns, such as ``("mu", "stiffness", "y0[0]")``; None for the random numbers of the model in
      their order.
    - `u`: (samples, numbers), uniform numbers in (0, 1), from which the distributions of the model make theirs; or
    - `values`: (samples, numbers), the numbers themselves, each in its unit. One of the two is None.
    - `realization`: (samples,), whole numbers: which realisation of the base each sample uses. Samples with the same
      entry see the same base motion (common random numbers).
    - `kind`: "random", "latin_hypercube", "sobol", "saltelli", "grid" or "table".
    - `base_samples`, `second_order`: of a design for Sobol' indices, how many base rows it has, and whether it has the
      rows that second-order indices need; None and False for others.

    Raises ValueError for arrays that do not fit together, numbers that are not finite, and `u` outside (0, 1).
    """

    kind: str
    names: tuple[str, ...] | None = None
    u: np.ndarray | None = None
    values: np.ndarray | None = None
    realization: np.ndarray
    base_samples: int | None = None
    second_order: bool = False

    def __post_init__(self) -> None:
        _checks.text("kind", self.kind)
        _checks.truth("second_order", self.second_order)
        if self.base_samples is not None:
            number = _checks.whole_number("base_samples", self.base_samples, maximum=MOST_SAMPLES)
            object.__setattr__(self, "base_samples", number)
        if (self.u is None) == (self.values is None):
            raise ValueError("Argument u or values must be given, and the other one be None.")
        name = "values" if self.u is None else "u"
        numbers = checked_numbers(name, getattr(self, name), uniform=self.u is not None)
        names = None if self.names is None else checked_names(self.names)
        if names is not None and len(names) != numbers.shape[1]:
            raise _checks.refused("names", f"hold one name for each of the {numbers.shape[1]} columns of {name}", names)
        realization = checked_realization(self.realization, len(numbers))
        for field, value in ((name, numbers), ("names", names), ("realization", realization)):
            object.__setattr__(self, field, value)
        if self.base_samples is not None and not self.factors:
            raise ValueError(
                f"Argument base_samples must fit the {len(numbers)} rows of a design for Sobol' indices, but "
                f"{self.base_samples} was given; make such designs with stickslip_jax.design.saltelli."
            )

    def __len__(self) -> int:
        return len(self.realization)

    @property
    def samples(self) -> int:
        """The number of samples, which is that of rows."""
        return len(self)

    @property
    def dimensions(self) -> int:
        """The number of columns."""
        return self._numbers.shape[1]

    @property
    def is_uniform(self) -> bool:
        """Whether the columns hold uniform numbers, `u`; else they hold `values`."""
        return self.u is not None

    @property
    def _numbers(self) -> np.ndarray:
        numbers = self.values if self.u is None else self.u
        assert numbers is not None
        return numbers

    @property
    def column_names(self) -> tuple[str, ...]:
        """A name for each column: `names`, or "u[0]", "u[1]" and so on."""
        return self.names or tuple(f"u[{index}]" for index in range(self.dimensions))

    @property
    def factors(self) -> tuple[str, ...]:
        """What Sobol' indices are of, in a design for them: the columns, and "realization" where it is a factor.

        Empty for other designs.
        """
        if self.base_samples is None:
            return ()
        for factors in (self.column_names, (*self.column_names, REALIZATION_FACTOR)):
            if len(self) == self.base_samples * saltelli_rows(len(factors), self.second_order):
                return factors
        return ()

    def block(self, first: int, number: int, dtype: DType = np.float64) -> tuple[np.ndarray, np.ndarray]:
        """The rows from `first` on, `number` of them or as many as there are.

        Returns their numbers, (rows, numbers) in `dtype`, and their realisations, (rows,). Uniform numbers lie in
        (0, 1) after rounding to `dtype` too.
        """
        rows = slice(first, first + number)
        numbers = self._numbers[rows].astype(dtype, copy=False)
        if self.is_uniform and numbers.dtype != self._numbers.dtype:
            one = numbers.dtype.type(1)
            numbers = np.minimum(numbers, np.nextafter(one, 0 * one))
        return numbers, self.realization[rows]

    def __repr__(self) -> str:
        names = self.column_names
        shown = ", ".join([*names[:_SHOWN], *(["..."] if len(names) > _SHOWN else [])])
        distinct = len(np.unique(self.realization))
        realizations = {len(self): "each with its own realisation", 1: "all with the same realisation"}
        base = "" if self.base_samples is None else f" ({self.base_samples} base rows)"
        kind = "uniform numbers" if self.is_uniform else "values"
        return (
            f"<{self.kind} design of {len(self)} samples{base}: {kind} of {shown}; "
            f"{realizations.get(distinct, f'{distinct} realisations')}>"
        )


def saltelli_rows(factors: int, second_order: bool) -> int:
    """How many rows of a design for Sobol' indices come from one base row."""
    return 2 * factors + 2 if second_order else factors + 2


def checked_names(names: object) -> tuple[str, ...]:
    """`names` as a tuple. Raises ValueError for anything but distinct names, at least one."""
    found = [] if isinstance(names, (str, bytes, range)) or not isinstance(names, Sequence) else list(names)
    if not found or not all(isinstance(name, str) and name for name in found):
        raise _checks.refused("names", "be a sequence of names of numbers, such as ['mu', 'stiffness', 'y0[0]']", names)
    twice = given_twice(found)
    if twice is not None:
        raise ValueError(f"Argument names must hold every name once, but {twice!r} was given twice.")
    return tuple(found)


def given_twice(names: Iterable[str]) -> str | None:
    """The first of `names` that was there before; None if all differ."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


def check_size(rows: int, columns: int, argument: str = "samples") -> None:
    """Raise ValueError for a table of more numbers than can be held, before there is one."""
    if rows * columns > MOST_NUMBERS:
        raise ValueError(
            f"Argument {argument} must be small enough for a table of at most {MOST_NUMBERS} numbers, but {rows} rows "
            f"of {columns} columns would have {rows * columns}; take fewer rows or columns."
        )


def checked_numbers(name: str, numbers: object, *, uniform: bool) -> np.ndarray:
    """`numbers` as a read-only array (samples, numbers) of float64. Raises ValueError for what a design cannot hold."""
    given = numbers_or_none(name, numbers, ndim=2)
    if not given.size:
        raise _checks.refused(name, "be an array (samples, numbers) of real numbers, at least one of each", numbers)
    array = np.array(given, np.float64)
    refuse_first(name, array, ~np.isfinite(array), "finite numbers")
    if uniform:
        refuse_first(name, array, ~((array > 0) & (array < 1)), "uniform numbers, above 0 and below 1")
    array.setflags(write=False)
    return array


def numbers_or_none(name: str, given: object, ndim: int) -> np.ndarray:
    """`given` as an array of real numbers, of `ndim` dimensions; an empty one for anything else."""
    try:
        return _checks.numbers(name, given, ndim)
    except ValueError:
        return np.empty(0)


def refuse_first(name: str, array: np.ndarray, wrong: np.ndarray, allowed: str) -> None:
    """Raise ValueError about the first entry of `array` that is `wrong`, if there is one."""
    if wrong.any():
        place = tuple(int(part) for part in np.argwhere(wrong)[0])
        raise ValueError(
            f"Argument {name} must hold {allowed}, but {name}[{', '.join(map(str, place))}] = {array[place]} was given."
        )


def checked_realization(realization: object, samples: int) -> np.ndarray:
    """`realization` as a read-only array (samples,) of int64. Raises ValueError for anything but whole numbers."""
    array = numbers_or_none("realization", realization, ndim=1)
    if array.shape != (samples,) or array.dtype.kind not in "iu":
        raise _checks.refused("realization", f"hold a whole number for each of the {samples} samples", realization)
    refuse_first("realization", array, (array < 0) | (array >= _MOST_REALIZATIONS), "numbers from 0 to 4294967295")
    array = array.astype(np.int64)
    array.setflags(write=False)
    return array
