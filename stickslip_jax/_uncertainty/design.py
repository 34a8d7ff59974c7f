"""Designs: tables with one row for each sample of an ensemble, of uniform numbers or of values."""

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array

from .._foundation import checks
from .._foundation.types import AnyArray, DType
from .._numerics.elementary import key_data_of

# A design: a table with one row for each sample of an ensemble.


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
        checks.text("kind", self.kind)
        checks.truth("second_order", self.second_order)
        if self.base_samples is not None:
            number = checks.whole_number("base_samples", self.base_samples, maximum=MOST_SAMPLES)
            object.__setattr__(self, "base_samples", number)
        if (self.u is None) == (self.values is None):
            raise ValueError("Argument u or values must be given, and the other one be None.")
        name = "values" if self.u is None else "u"
        numbers = checked_numbers(name, getattr(self, name), uniform=self.u is not None)
        names = None if self.names is None else checked_names(self.names)
        if names is not None and len(names) != numbers.shape[1]:
            raise checks.refused("names", f"hold one name for each of the {numbers.shape[1]} columns of {name}", names)
        realization = numbers_or_none("realization", self.realization, ndim=1)
        if realization.shape != (len(numbers),) or realization.dtype.kind not in "iu":
            demand = f"hold a whole number for each of the {len(numbers)} samples"
            raise checks.refused("realization", demand, self.realization)
        outside = (realization < 0) | (realization >= _MOST_REALIZATIONS)
        refuse_first("realization", realization, outside, "numbers from 0 to 4294967295")
        realization = realization.astype(np.int64)
        realization.setflags(write=False)
        for field, value in ((name, numbers), ("names", names), ("realization", realization)):
            object.__setattr__(self, field, value)
        if self.base_samples is not None and not self.factors:
            demand = f"fit the {len(numbers)} rows of a design for Sobol' indices"
            hint = "make such designs with stickslip_jax.design.saltelli"
            raise checks.refused("base_samples", demand, self.base_samples, hint)

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
        raise checks.refused("names", "be a sequence of names of numbers, such as ['mu', 'stiffness', 'y0[0]']", names)
    twice = given_twice(found)
    if twice is not None:
        raise ValueError(f"Argument names must hold every name once, but {twice!r} was given twice.")
    return tuple(found)


def given_twice(names: Iterable[str]) -> str | None:
    """The first of `names` that is there again; None if all differ."""
    return next((name for name, number in Counter(names).items() if number > 1), None)


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
        raise checks.refused(name, "be an array (samples, numbers) of real numbers, at least one of each", numbers)
    array = np.array(given, np.float64)
    refuse_first(name, array, ~np.isfinite(array), "finite numbers")
    if uniform:
        refuse_first(name, array, ~((array > 0) & (array < 1)), "uniform numbers, above 0 and below 1")
    array.setflags(write=False)
    return array


def numbers_or_none(name: str, given: object, ndim: int) -> np.ndarray:
    """`given` as an array of real numbers, of `ndim` dimensions; an empty one for anything else."""
    try:
        return checks.numbers(name, given, ndim)
    except ValueError:
        return np.empty(0)


def refuse_first(name: str, array: np.ndarray, wrong: np.ndarray, allowed: str) -> None:
    """Raise ValueError about the first entry of `array` that is `wrong`, if there is one."""
    if wrong.any():
        place = tuple(int(part) for part in np.argwhere(wrong)[0])
        raise ValueError(
            f"Argument {name} must hold {allowed}, but {name}[{', '.join(map(str, place))}] = {array[place]} was given."
        )


# Designs of uniform numbers: random, Latin hypercube, Sobol' sequence, and Saltelli's for Sobol' indices.


_BITS = 30  # of the numbers of a Sobol' sequence: as many as there are samples at most
_MOST_DIMENSIONS = 21201  # for which scipy has direction numbers

Seed = int | np.integer | Array
"""A whole number, or a key made by ``jax.random.key``."""
Realization = str | Sequence[int] | AnyArray
"""Which realisation of the base each sample uses: a word, or whole numbers (samples,)."""


def random(
    samples: int,
    names: Sequence[str] | None = None,
    *,
    dimensions: int | None = None,
    realization: Realization = "own",
    seed: Seed = 0,
) -> Design:
    """Independent uniform numbers: what an ensemble without a design draws, but known before it is simulated.

    Args:
        samples: The number of rows.
        names: Of the numbers of the system, law or start that the design sets, each given as a distribution there:
            "mu", "stiffness", "y0[0]". None: the random numbers of the model in their order, `dimensions` of them.
        dimensions: The number of columns, where `names` does not tell it.
        realization: Which realisation of the base each sample uses: "own", or "common", the same for all samples, or
            whole numbers (samples,), by which samples with the same number share one.
        seed: A whole number, or a key from ``jax.random.key(seed)``.

    Raises:
        ValueError: For arguments outside these bounds.
    """
    samples, names, dimensions = _shape(samples, names, dimensions)
    cells = _generator(seed).integers(2**52, size=(samples, dimensions))
    u = (cells + 0.5) * 2.0**-52  # the midpoints of equal cells: never 0 or 1
    return Design(kind="random", names=names, u=u, realization=realizations(realization, samples))


def latin_hypercube(
    samples: int,
    names: Sequence[str] | None = None,
    *,
    dimensions: int | None = None,
    realization: Realization = "own",
    seed: Seed = 0,
) -> Design:
    """A Latin hypercube: of `samples` equal parts of (0, 1), each number falls into each part once (McKay et al. 1979).

    Means of outputs that are nearly sums of functions of one number each have a smaller error than with `random`
    numbers. Standard errors that take samples for independent are then too large.

    Args:
        samples: The number of rows.
        names: Of the numbers of the system, law or start that the design sets, each given as a distribution there:
            "mu", "stiffness", "y0[0]". None: the random numbers of the model in their order, `dimensions` of them.
        dimensions: The number of columns, where `names` does not tell it.
        realization: Which realisation of the base each sample uses: "own", or "common", the same for all samples, or
            whole numbers (samples,), by which samples with the same number share one.
        seed: A whole number, or a key from ``jax.random.key(seed)``.

    Raises:
        ValueError: For arguments outside these bounds.
    """
    from scipy.stats import qmc  # noqa: PLC0415 - loaded when used

    samples, names, dimensions = _shape(samples, names, dimensions)
    drawn = qmc.LatinHypercube(dimensions, **_by(seed)).random(samples)
    u = np.clip(drawn, 2.0**-54, 1 - 2.0**-53)
    return Design(kind="latin_hypercube", names=names, u=u, realization=realizations(realization, samples))


def sobol(
    samples: int,
    names: Sequence[str] | None = None,
    *,
    dimensions: int | None = None,
    realization: Realization = "own",
    scramble: bool = True,
    seed: Seed = 0,
) -> Design:
    """Points of a Sobol' sequence, which fill the unit cube more evenly than random ones (Sobol' 1967).

    Means of smooth outputs have a much smaller error than with `random` numbers. What the base's own randomness adds
    is not made smaller, and standard errors that take samples for independent are too large: for an error, repeat with
    several seeds.

    The numbers are scipy's, moved from the lower corner of their cells of width 2^-30 to the middle, because
    distributions without bounds have no number at 0.

    Args:
        samples: The number of rows, a power of two: only then are the points balanced.
        names: Of the numbers of the system, law or start that the design sets, each given as a distribution there:
            "mu", "stiffness", "y0[0]". None: the random numbers of the model in their order, `dimensions` of them.
        dimensions: The number of columns, where `names` does not tell it.
        realization: Which realisation of the base each sample uses: "own", or "common", the same for all samples, or
            whole numbers (samples,), by which samples with the same number share one.
        scramble: Shift and scramble the points at random (Matousek 1998), which makes means unbiased; without it there
            is only one sequence, and `seed` does nothing.
        seed: A whole number, or a key from ``jax.random.key(seed)``.

    Raises:
        ValueError: For arguments outside these bounds.
    """
    samples, names, dimensions = _shape(_power_of_two("samples", samples), names, dimensions)
    _check_dimensions(dimensions)
    u = _sobol_points(samples, dimensions, scramble, seed)
    return Design(kind="sobol", names=names, u=u, realization=realizations(realization, samples))


def saltelli(
    base_samples: int,
    names: Sequence[str] | None = None,
    *,
    dimensions: int | None = None,
    second_order: bool = True,
    realization: Realization = "shared",
    scramble: bool = True,
    seed: Seed = 0,
) -> Design:
    """A design for `sobol_indices`: two tables A and B, and A with one column of B at a time (Saltelli et al. 2010).

    Each of the `base_samples` base rows, with d factors, gives d + 2 samples: its row of A, A with column j from B for
    each j, and its row of B; for second-order indices d more before the last, B with column j from A. This is the order
    of SALib. A and B are halves of one Sobol' sequence in twice the dimensions.

    Args:
        base_samples: The number of base rows, a power of two.
        names: Of the numbers of the system, law or start that the design sets, each given as a distribution there:
            "mu", "stiffness", "y0[0]". None: the random numbers of the model in their order, `dimensions` of them.
        dimensions: The number of columns, where `names` does not tell it.
        second_order: Whether there are the rows for second-order indices.
        realization: What becomes of the base's own randomness, the noise.

            - "shared": the rows mostly from A share one realisation, those mostly from B another one. So two samples
              that are compared differ in the factors that the index is about and in nothing else. First-order,
              second-order and total indices are right: shares of the whole variance, that of the noise in it. Total
              indices hold the interactions of a factor with the noise.
            - "factor": the same, and the realisation is one more factor, named "realization", with indices of its own:
              how much of the variance is due to the noise. It takes d + 1 for d above.
            - "own": every sample has its own. First-order and second-order indices are right, with larger errors; every
              total index holds all of the noise besides.
            - "common": all samples have the same. The indices are those of that one realisation.
            - whole numbers (samples,).
        scramble: Shift and scramble the points at random (Matousek 1998), which makes means unbiased; without it there
            is only one sequence, and `seed` does nothing.
        seed: A whole number, or a key from ``jax.random.key(seed)``.

    Raises:
        ValueError: For arguments outside these bounds.
    """
    names, dimensions = _columns(names, dimensions)
    number = _power_of_two("base_samples", base_samples)
    checks.truth("second_order", second_order)
    factors = dimensions + 1 if isinstance(realization, str) and realization == "factor" else dimensions
    rows = saltelli_rows(factors, second_order)
    checks.whole_number("base_samples", number * rows, maximum=MOST_SAMPLES)
    _check_dimensions(2 * dimensions)
    check_size(number * rows, dimensions, "base_samples")
    points = _sobol_points(number, 2 * dimensions, scramble, seed)
    # Which row of a block takes which factor from B.
    one = np.eye(factors, dtype=bool)
    nearly_b = ~one if second_order else one[:0]
    from_b = np.concatenate([np.zeros((1, factors), bool), one, nearly_b, np.ones((1, factors), bool)])
    a, b = points[:, None, :dimensions], points[:, None, dimensions:]
    u = np.where(from_b[None, :, :dimensions], b, a).reshape(-1, dimensions)
    mostly_b = from_b[:, -1] if factors > dimensions else np.arange(rows) > factors
    shared = np.arange(number)[:, None] + number * mostly_b[None]
    choices = {"shared": shared.ravel(), "factor": shared.ravel()}
    return Design(
        kind="saltelli", names=names, u=u, realization=realizations(realization, len(u), choices),
        base_samples=number, second_order=bool(second_order),
    )  # fmt: skip


def realizations(realization: Realization, samples: int, more: dict[str, np.ndarray] | None = None) -> Any:
    """The realisation of each sample; `more`: what further words mean. Raises ValueError for other words."""
    if not isinstance(realization, str):
        return realization
    words = {"own": np.arange(samples), "common": np.zeros(samples, np.int64), **(more or {})}
    if realization not in words:
        demand = f"be {', '.join(map(repr, words))} or an array with a whole number for each sample"
        raise checks.refused("realization", demand, realization)
    return words[realization]


def _shape(samples: object, names: object, dimensions: object) -> tuple[int, tuple[str, ...] | None, int]:
    """The number of rows, and names and number of the columns."""
    names, dimensions = _columns(names, dimensions)
    samples = checks.whole_number("samples", samples, maximum=MOST_SAMPLES)
    check_size(samples, dimensions)
    return samples, names, dimensions


def _columns(names: object, dimensions: object) -> tuple[tuple[str, ...] | None, int]:
    """Names and number of the columns."""
    if names is not None:
        names = checked_names(names)
    elif dimensions is None:
        raise ValueError(
            "Argument names must be given, such as ['mu', 'stiffness'], or else dimensions, the number of columns, but "
            "both are None."
        )
    if dimensions is None:
        return names, len(names or ())
    dimensions = checks.whole_number("dimensions", dimensions, maximum=_MOST_DIMENSIONS)
    if names is not None and len(names) != dimensions:
        raise checks.refused("dimensions", f"be {len(names)}, the number of names", dimensions, "leave it out")
    return names, dimensions


def _power_of_two(name: str, number: object) -> int:
    number = checks.whole_number(name, number, maximum=MOST_SAMPLES)
    if number & (number - 1):
        below = 1 << (number.bit_length() - 1)
        demand = "be a power of two, for which the points of a Sobol' sequence are balanced"
        hint = f"take {below} or {2 * below}, or latin_hypercube or random for any number"
        raise checks.refused(name, demand, number, hint)
    return number


def _check_dimensions(dimensions: int) -> None:
    if dimensions > _MOST_DIMENSIONS:
        raise ValueError(
            f"Argument dimensions must ask for at most {_MOST_DIMENSIONS} columns of a Sobol' sequence (tables A and B "
            f"take two for each number), but {dimensions} are needed; take fewer, or latin_hypercube or random."
        )


def _sobol_points(samples: int, dimensions: int, scramble: bool, seed: Seed) -> np.ndarray:
    from scipy.stats import qmc  # noqa: PLC0415 - loaded when used

    checks.truth("scramble", scramble)
    engine = qmc.Sobol(dimensions, scramble=bool(scramble), bits=_BITS, **_by(seed))
    return engine.random(samples) + 2.0 ** -(_BITS + 1)


def _by(seed: Seed) -> dict[str, Any]:
    """The argument of scipy's engines for their random numbers, which was called `seed` before scipy 1.15."""
    import scipy  # noqa: PLC0415 - loaded when used

    version = tuple(int(part) for part in scipy.__version__.split(".")[:2])
    return {"rng" if version >= (1, 15) else "seed": _generator(seed)}


def _generator(seed: Seed) -> np.random.Generator:
    if isinstance(seed, jax.Array) and (seed.shape == (2,) or jnp.issubdtype(seed.dtype, jax.dtypes.prng_key)):
        return np.random.default_rng(np.asarray(key_data_of(seed)))
    return np.random.default_rng(checks.whole_number("seed", seed, minimum=0))


# Designs of values: all combinations of some, and tables of one's own.


def grid(values: Mapping[str, npt.ArrayLike], *, realization: Realization = "own") -> Design:
    """All combinations of given values: ``grid({"mu": [0.2, 0.5], "stiffness": [1.0, 2.0, 4.0]})`` has six samples.

    Args:
        values: For each number of the system, law or start its values, (values,), in its unit. The last number changes
            from each sample to the next, the first one most slowly; so an output (samples,) takes the shape of the grid
            by ``output.reshape(2, 3)``.
        realization: Which realisation of the base each sample uses: "own", or "common", the same for all samples, or
            whole numbers (samples,), by which samples with the same number share one.

    Raises:
        ValueError: For anything else.

    >>> ss.design.grid({"mu": [0.2, 0.5], "stiffness": [1.0, 2.0, 4.0]})
    <grid design of 6 samples: values of mu, stiffness; each with its own realisation>
    """
    columns = _named_columns("values", values)
    samples = math.prod(len(column) for column in columns.values())
    if samples > MOST_SAMPLES:
        raise ValueError(
            f"Argument values must have at most {MOST_SAMPLES} combinations, but has {samples}; give fewer values of "
            "each, or take sobol."
        )
    check_size(samples, len(columns), "values")
    axes = np.meshgrid(*columns.values(), indexing="ij")
    numbers = np.stack([axis.ravel() for axis in axes], axis=1)
    chosen = realizations(realization, samples)
    return Design(kind="grid", names=tuple(columns), values=numbers, realization=chosen)


def table(
    numbers: Any, names: Sequence[str] | None = None, *, uniform: bool = False, realization: Realization = "own"
) -> Design:
    """A table of one's own: measured parameters, or the design matrix of another program.

    Args:
        numbers: A DataFrame or a dict of arrays (samples,), with a column for each number of the system, law or start;
            or an array (samples, numbers).
        names: Those of the columns of an array.
        uniform: False for the numbers themselves, each in its unit; True for uniform numbers in (0, 1), from which the
            distributions of the model make theirs. A uniform array may come without names: its columns are then the
            random numbers of the model in their order.
        realization: Which realisation of the base each sample uses: "own", or "common", the same for all samples, or
            whole numbers (samples,), by which samples with the same number share one.

    Raises:
        ValueError: For columns of unequal length, numbers that are not finite, and uniform ones outside (0, 1).
    """
    checks.truth("uniform", uniform)
    if not hasattr(numbers, "items"):
        if names is None and not uniform:
            demand = "be given with an array of numbers, one name for each column, such as ['mu', 'stiffness']"
            raise checks.refused("names", demand, None)
        array: Any = numbers
    else:
        if names is not None:
            raise checks.refused("names", "be left out where numbers has named columns", names)
        columns = _named_columns("numbers", numbers)
        lengths = {name: len(column) for name, column in columns.items()}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"Argument numbers must have columns of equal length, but their lengths are {lengths}.")
        names, array = tuple(columns), np.stack([*columns.values()], axis=1)
    array = checked_numbers("numbers", array, uniform=uniform)
    return Design(
        kind="table", names=None if names is None else checked_names(names),
        u=array if uniform else None, values=None if uniform else array,
        realization=realizations(realization, len(array)),
    )  # fmt: skip


def _named_columns(argument: str, given: Any) -> dict[str, np.ndarray]:
    """The columns of a dict or DataFrame by name."""
    if not hasattr(given, "items") or not (pairs := list(given.items())):
        raise checks.refused(argument, "be a dict of arrays by name, such as {'mu': [0.2, 0.5]}", given)
    names = [name for name, _ in pairs]
    if not all(isinstance(name, str) and name for name in names) or len(set(names)) < len(names):
        raise ValueError(
            f"Argument {argument} must have a different name for each column, such as 'mu', but the names "
            f"{checks.show(names)} were given."
        )
    columns = {}
    for name, column in pairs:
        own = f"{argument}[{name!r}]"
        if isinstance(column, range):  # which has no numbers yet
            check_size(len(column), 1, own)
        columns[name] = numbers_or_none(own, column, ndim=1)
        if not columns[name].size:
            raise checks.refused(own, "be a one-dimensional sequence of real numbers, at least one", column)
        refuse_first(own, columns[name], ~np.isfinite(columns[name]), "finite numbers")
    return columns
