"""Designs of values: all combinations of some, and tables of one's own."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import _checks
from .design import MOST_SAMPLES, Design, check_size, checked_names, checked_numbers, numbers_or_none, refuse_first
from .uniform_designs import Realization, realizations


def grid(values: Mapping[str, npt.ArrayLike], *, realization: Realization = "own") -> Design:
    """All combinations of given values: ``grid({"mu": [0.2, 0.5], "stiffness": [1.0, 2.0, 4.0]})`` has six samples.

    - `values`: for each number of the system, law or start its values, (values,), in its unit. The last number changes
      from each sample to the next, the first one most slowly; so an output (samples,) takes the shape of the grid by
      ``output.reshape(2, 3)``.
    - `realization`: which realisation of the base each sample uses: "own", or "common", the same for all samples, or
      whole numbers (samples,), by which samples with the same number share one.

    Raises ValueError for anything else.

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

    - `numbers`: a DataFrame or a dict of arrays (samples,), with a column for each number of the system, law or start;
      or an array (samples, numbers) and the `names` of its columns.
    - `uniform`: False for the numbers themselves, each in its unit; True for uniform numbers in (0, 1), from which the
      distributions of the model make theirs. A uniform array may come without names: its columns are then the random
      numbers of the model in their order.
    - `realization`: which realisation of the base each sample uses: "own", or "common", the same for all samples, or
      whole numbers (samples,), by which samples with the same number share one.

    Raises ValueError for columns of unequal length, numbers that are not finite, and uniform ones outside (0, 1).
    """
    _checks.truth("uniform", uniform)
    if not hasattr(numbers, "items"):
        if names is None and not uniform:
            raise ValueError(
                "Argument names must be given with an array of numbers, one name for each column, such as "
                "['mu', 'stiffness'], but None was given."
            )
        array: Any = numbers
    else:
        if names is not None:
            raise _checks.refused("names", "be left out where numbers has named columns", names)
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
        raise _checks.refused(argument, "be a dict of arrays by name, such as {'mu': [0.2, 0.5]}", given)
    names = [name for name, _ in pairs]
    if not all(isinstance(name, str) and name for name in names) or len(set(names)) < len(names):
        raise ValueError(
            f"Argument {argument} must have a different name for each column, such as 'mu', but the names "
            f"{_checks.show(names)} were given."
        )
    return {name: _column(f"{argument}[{name!r}]", column) for name, column in pairs}


def _column(name: str, given: object) -> np.ndarray:
    """A column called `name`. Raises ValueError for what holds no numbers, none at all, or too many."""
    if isinstance(given, range):  # which has no numbers yet
        check_size(len(given), 1, name)
    column = numbers_or_none(name, given, ndim=1)
    if not column.size:
        raise _checks.refused(name, "be a one-dimensional sequence of real numbers, at least one", given)
    refuse_first(name, column, ~np.isfinite(column), "finite numbers")
    return column
