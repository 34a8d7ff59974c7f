"""Sobol' indices: which share of the variance of an output is due to which input."""

import dataclasses
import math
from collections.abc import Mapping
from itertools import combinations
from types import EllipsisType
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from .._foundation import checks
from .._foundation.extras import Entries, labeled_dataset, variable
from .._uncertainty.design import Design
from .estimate import DEFAULT_LEVEL, check_level

if TYPE_CHECKING:
    import xarray

_SHOWN = 4  # outputs in a repr


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SobolIndices:
    """Sobol' indices of one output or several, with bootstrap errors and intervals.

    The shapes below are for one output (samples,); of several outputs, the last dimension of each array is theirs. An
    index of an output that does not vary is NaN.

    - `factors`: the names of the inputs. `outputs`: those of the outputs, empty for one output without a name.
    - `first`: (factors,), first-order indices: the share of the variance that would vanish on average if the factor
      were known. `total`: (factors,), the share that would be left if all other factors were known.
    - `second`: (factors, factors), symmetric, NaN on the diagonal: the share due to two factors together beyond what
      each has alone. None if the design has no rows for it.
    - `first_error`, `total_error`, `second_error`: bootstrap standard errors, of the same shapes.
    - `first_interval`, `total_interval`, `second_interval`: (2, ...), the two ends of bootstrap intervals at `level`.
    - `base_samples`: the number of base rows. `samples`: of all rows. `resamples`: of the bootstrap.
    """

    factors: tuple[str, ...]
    outputs: tuple[str, ...]
    first: np.ndarray
    first_error: np.ndarray
    first_interval: np.ndarray
    total: np.ndarray
    total_error: np.ndarray
    total_interval: np.ndarray
    second: np.ndarray | None
    second_error: np.ndarray | None
    second_interval: np.ndarray | None
    level: float
    base_samples: int
    samples: int
    resamples: int

    def to_xarray(self) -> "xarray.Dataset":
        """All arrays as an ``xarray.Dataset`` with dimensions factor, other_factor, output and interval_end.

        Raises:
            ImportError: If xarray is not installed.
        """
        last = ("output",) if self.outputs else ()
        variables: Entries = {}
        for name, meaning in (("first", "first-order"), ("total", "total"), ("second", "second-order")):
            if getattr(self, name) is None:
                continue
            inputs = ("factor", "other_factor") if name == "second" else ("factor",)
            for suffix, ends, what in (
                ("", (), ""), ("_error", (), ", standard error"), ("_interval", ("interval_end",), ", interval"),
            ):  # fmt: skip
                values, about = getattr(self, name + suffix), f"{meaning} Sobol' index{what}"
                variables[name + suffix] = variable((*ends, *inputs, *last), values, about)
        coordinates: Entries = {"factor": list(self.factors), "interval_end": ["low", "high"]}
        if self.second is not None:
            coordinates["other_factor"] = list(self.factors)
        if last:
            coordinates["output"] = list(self.outputs)
        names = ("level", "base_samples", "samples", "resamples")
        return labeled_dataset(variables, coordinates, {name: getattr(self, name) for name in names})

    def __repr__(self) -> str:
        return self.table()

    def table(self, *, second_order: bool = False) -> str:
        """The indices with their intervals, a line for each factor, as ``print`` shows them.

        Args:
            second_order: Whether to show those of each pair of factors too.

        Raises:
            ValueError: For second-order indices of a design that has no rows for them.
        """
        checks.truth("second_order", second_order)
        if second_order and self.second is None:
            hint = "make the design with design.saltelli(..., second_order=True)"
            raise checks.refused("second_order", "be False for a design without rows for it", second_order, hint)
        lines = [
            f"Sobol' indices from {self.base_samples} base rows ({self.samples} samples), with {self.level * 100:g} % "
            "bootstrap intervals"
        ]
        if not self.outputs:
            return "\n".join([*lines, *self._lines(..., second_order)])
        for index, output in enumerate(self.outputs[:_SHOWN]):
            lines += [f"{output}:", *(f"  {line}" for line in self._lines((..., index), second_order))]
        if len(self.outputs) > _SHOWN:
            lines.append(f"and {len(self.outputs) - _SHOWN} more outputs")
        return "\n".join(lines)

    def _lines(self, of: EllipsisType | tuple[EllipsisType, int], second_order: bool) -> list[str]:
        """The lines that show one output; `of`: its place in the last dimension."""
        pairs = list(combinations(range(len(self.factors)), 2)) if second_order else []
        labels = [*self.factors, *(f"{self.factors[i]}, {self.factors[j]}" for i, j in pairs)]
        width = max(len(label) for label in labels)

        def cell(kind: str, at: tuple[int, ...]) -> str:
            (low, high), value = getattr(self, f"{kind}_interval")[of][(slice(None), *at)], getattr(self, kind)[of][at]
            return f"{value:7.4f} [{low:7.4f}, {high:7.4f}]"

        lines = [f"{'':{width}}  {'first-order':26}  total"]
        for at, name in enumerate(self.factors):
            lines.append(f"{name:{width}}  {cell('first', (at,))}  {cell('total', (at,))}")
        if pairs:
            lines.append(f"{'':{width}}  second-order")
            for label, pair in zip(labels[len(self.factors) :], pairs, strict=True):
                lines.append(f"{label:{width}}  {cell('second', pair)}")
        return lines


def sobol_indices(
    outputs: Any, design: Design, *, level: float = DEFAULT_LEVEL, resamples: int = 1000, seed: int = 0
) -> SobolIndices:
    """First-order, second-order and total Sobol' indices of any output, with bootstrap intervals.

    First-order indices are estimated after Saltelli et al. 2010 (table 2, b), total ones after Jansen 1999 (table 2,
    f), second-order ones after Saltelli 2002; outputs are centred by their mean before. The numbers are those of
    ``SALib.analyze.sobol``. Factors must be independent: with a `GaussianCopula`, the indices are those of the
    independent numbers that go into it.

    Args:
        outputs: A number for each sample, (samples,), or several, (samples, outputs), in the order of the design's
            rows; or a dict or DataFrame of named outputs (samples,).
        design: From `stickslip_jax.design.saltelli`. What its `realization` makes of the base's own randomness is
            written there: with "own", every total index holds all of the noise.
        level: Of the intervals, which are percentiles of the bootstrap. Whole base rows are drawn with replacement, as
            if they were independent: on a Sobol' sequence, errors and intervals are rather too large.
        resamples: Of the bootstrap, at least 100.
        seed: Of its draws.

    Raises:
        ValueError: For outputs that do not fit the design or are not finite, and for other arguments.
    """
    if not isinstance(design, Design) or not design.factors:
        raise checks.refused("design", "be made by stickslip_jax.design.saltelli", design)
    check_level(level)
    checks.whole_number("resamples", resamples, minimum=100)
    seed = checks.whole_number("seed", seed, minimum=0)
    names, table = _output_table(outputs, design)
    factors, rows = len(design.factors), design.base_samples
    assert rows is not None
    pairs = list(combinations(range(factors), 2)) if design.second_order else []

    # The numerators of all indices, first-order, total and second-order, and the mean and mean square of A and B, (base
    # rows, indices + 2, outputs). Indices are made of their means over base rows.
    y = (table - table.mean(axis=0)).reshape(rows, -1, table.shape[1])
    a, b, ab, ba = y[:, :1], y[:, -1:], y[:, 1 : factors + 1], y[:, factors + 1 : -1]
    second = [ba[:, [i]] * ab[:, [j]] - a * b for i, j in pairs]
    products = np.concatenate([b * (ab - a), (a - ab) ** 2 / 2, *second, (a + b) / 2, (a**2 + b**2) / 2], axis=1)
    # The means over all base rows, then those of resamples of these.
    rng, means = np.random.default_rng(seed), [products.mean(axis=0)]
    for _ in range(resamples):
        weights = np.bincount(rng.integers(rows, size=rows), minlength=rows) / rows
        means.append(np.tensordot(weights, products, axes=1))
    mean = np.stack(means)
    variance = mean[:, -1:] - mean[:, -2:-1] ** 2
    variance[..., np.ptp(table, axis=0) == 0] = 0
    with np.errstate(divide="ignore", invalid="ignore"):
        found = mean[:, :-2] / np.where(variance > 0, variance, math.nan)
    for at, (i, j) in enumerate(pairs, 2 * factors):
        found[:, at] -= found[:, i] + found[:, j]
    value, draws, tails = found[0], found[1:], ((1 - level) / 2, (1 + level) / 2)
    # (statistics, indices, outputs): value, error, low, high
    statistics = np.stack([value, draws.std(axis=0, ddof=1), *np.quantile(draws, tails, axis=0)])
    if names is None:
        statistics = statistics[..., 0]
    kinds = {"first": statistics[:, :factors], "total": statistics[:, factors : 2 * factors]}
    if design.second_order:
        kinds["second"] = np.full((len(statistics), factors, factors, *statistics.shape[2:]), math.nan)
        for at, (i, j) in enumerate(pairs, 2 * factors):
            kinds["second"][:, i, j] = kinds["second"][:, j, i] = statistics[:, at]
    arrays: dict[str, Any] = {"second": None, "second_error": None, "second_interval": None}
    for name, found in kinds.items():
        arrays |= {name: found[0], f"{name}_error": found[1], f"{name}_interval": found[2:]}
    return SobolIndices(
        factors=design.factors, outputs=names or (), level=float(level), base_samples=rows, samples=len(design),
        resamples=int(resamples), **arrays,
    )  # fmt: skip


def _output_table(outputs: Any, design: Design) -> tuple[tuple[str, ...] | None, np.ndarray]:
    """Names of the outputs, None for one without a name, and their numbers (samples, outputs)."""
    checks.tree("outputs", outputs)
    names, given = None, outputs
    if isinstance(outputs, Mapping) or (hasattr(outputs, "items") and hasattr(outputs, "columns")):
        pairs = list(outputs.items())
        names = tuple(str(name) for name, _ in pairs)
        shapes = {np.shape(one) for _, one in pairs}
        given = np.stack([np.asarray(one) for _, one in pairs], axis=1) if [len(one) for one in shapes] == [1] else None
    try:
        is_yes_or_no = isinstance(given, (np.ndarray, jax.Array)) and given.dtype == bool
        array = np.asarray(given) if is_yes_or_no else checks.numbers("outputs", given)
    except ValueError:
        array: np.ndarray = np.empty(0)
    if array.ndim not in (1, 2) or len(array) != len(design) or not array.size or array.dtype.kind not in "biuf":
        demand = f"hold a number for each of the {len(design)} samples of the design, (samples,) or (samples, outputs)"
        raise checks.refused("outputs", demand, outputs)
    table = (array[:, None] if array.ndim == 1 else array).astype(np.float64)
    wrong = ~np.isfinite(table)
    if wrong.any():
        row, column = (int(part) for part in np.argwhere(wrong)[0])
        raise ValueError(
            f"Argument outputs must be finite, but {int(wrong.any(axis=1).sum())} of {len(table)} samples are not, the "
            f"first one outputs[{row}] = {table[row, column]}; take an output that every sample has, such as a total "
            "or a count, or give a number for what is not defined."
        )
    if names is None and array.ndim == 2:
        names = tuple(f"output {index}" for index in range(array.shape[1]))
    return names, table
