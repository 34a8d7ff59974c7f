"""Designs of uniform numbers: random, Latin hypercube, Sobol' sequence, and Saltelli's for Sobol' indices."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._numerics.random_bits import key_data_of
from .._types import AnyArray, Array
from .design import MOST_SAMPLES, Design, check_size, checked_names, saltelli_rows

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

    - `samples`: the number of rows.
    - `names`: of the numbers of the system, law or start that the design sets, each given as a distribution there:
      "mu", "stiffness", "y0[0]". None: the random numbers of the model in their order, `dimensions` of them.
    - `realization`: which realisation of the base each sample uses: "own", or "common", the same for all samples, or
      whole numbers (samples,), by which samples with the same number share one.
    - `seed`: a whole number, or a key from ``jax.random.key(seed)``.

    Raises ValueError for arguments outside these bounds.
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

    Arguments and errors are those of `random`.
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

    - `samples`: the number of rows, a power of two.
    - `scramble`: shift and scramble the points at random (Matousek 1998), which makes means unbiased; without it there
      is only one sequence, and `seed` does nothing.

    The numbers are scipy's, moved from the lower corner of their cells of width 2^-30 to the middle, because
    distributions without bounds have no number at 0. Other arguments and errors are those of `random`. Raises
    ValueError unless `samples` is a power of two: only then are the points balanced.
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

    - `base_samples`: the number of base rows, a power of two.
    - `second_order`: whether there are the rows for second-order indices.
    - `realization`: what becomes of the base's own randomness, the noise.

      - "shared": the rows mostly from A share one realisation, those mostly from B another one. So two samples that are
        compared differ in the factors that the index is about and in nothing else. First-order, second-order and total
        indices are right: shares of the whole variance, that of the noise in it. Total indices hold the interactions of
        a factor with the noise.
      - "factor": the same, and the realisation is one more factor, named "realization", with indices of its own: how
        much of the variance is due to the noise. It takes d + 1 for d above.
      - "own": every sample has its own. First-order and second-order indices are right, with larger errors; every total
        index holds all of the noise besides.
      - "common": all samples have the same. The indices are those of that one realisation.
      - whole numbers (samples,).

    Other arguments and errors are those of `sobol`.
    """
    names, dimensions = _columns(names, dimensions)
    number = _power_of_two("base_samples", base_samples)
    _checks.truth("second_order", second_order)
    factors = dimensions + 1 if isinstance(realization, str) and realization == "factor" else dimensions
    rows = saltelli_rows(factors, second_order)
    _checks.whole_number("base_samples", number * rows, maximum=MOST_SAMPLES)
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
        options = ", ".join(map(repr, words))
        raise _checks.refused(
            "realization", f"be {options} or an array with a whole number for each sample", realization
        )
    return words[realization]


def _shape(samples: object, names: object, dimensions: object) -> tuple[int, tuple[str, ...] | None, int]:
    """The number of rows, and names and number of the columns."""
    names, dimensions = _columns(names, dimensions)
    samples = _checks.whole_number("samples", samples, maximum=MOST_SAMPLES)
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
    dimensions = _checks.whole_number("dimensions", dimensions, maximum=_MOST_DIMENSIONS)
    if names is not None and len(names) != dimensions:
        raise ValueError(
            f"Argument dimensions must be {len(names)}, the number of names, but {dimensions} was given; leave it out."
        )
    return names, dimensions


def _power_of_two(name: str, number: object) -> int:
    number = _checks.whole_number(name, number, maximum=MOST_SAMPLES)
    if number & (number - 1):
        below = 1 << (number.bit_length() - 1)
        raise ValueError(
            f"Argument {name} must be a power of two, for which the points of a Sobol' sequence are balanced, but "
            f"{number} was given; take {below} or {2 * below}, or latin_hypercube or random for any number."
        )
    return number


def _check_dimensions(dimensions: int) -> None:
    if dimensions > _MOST_DIMENSIONS:
        raise ValueError(
            f"Argument dimensions must ask for at most {_MOST_DIMENSIONS} columns of a Sobol' sequence (tables A and B "
            f"take two for each number), but {dimensions} are needed; take fewer, or latin_hypercube or random."
        )


def _sobol_points(samples: int, dimensions: int, scramble: bool, seed: Seed) -> np.ndarray:
    from scipy.stats import qmc  # noqa: PLC0415 - loaded when used

    _checks.truth("scramble", scramble)
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
    return np.random.default_rng(_checks.whole_number("seed", seed, minimum=0))
