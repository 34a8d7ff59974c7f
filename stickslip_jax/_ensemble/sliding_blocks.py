"""Permanent displacements of sliding blocks under a set of recorded earthquakes, in one table."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._excitation.recorded import GroundAcceleration
from .._excitation.suites import RecordSuite
from .._foundation import checks
from .._foundation.files import table_of
from .._foundation.types import Number
from .._systems.slopes import rigid_block
from .._systems.system import System
from .ensemble import simulate_ensemble

if TYPE_CHECKING:
    import pandas


class NewmarkDisplacements(NamedTuple):
    """What `newmark_displacements` returns: how far each block has slid under each record.

    Attributes:
        records: The names of the records.
        scales: The factors of their accelerations, (scales,).
        yield_coefficients: Of the blocks, (yields,).
        values: Displacements down the slope after the earthquake, m, (records, scales, yields); NaN where a sample was
            not followed to its end.
    """

    records: tuple[str, ...]
    scales: np.ndarray
    yield_coefficients: np.ndarray
    values: np.ndarray

    @property
    def median(self) -> np.ndarray:
        """Of the records, m, (scales, yields)."""
        return np.median(self.values, axis=0)

    def to_pandas(self) -> "pandas.DataFrame":
        """A row for each record, scale and yield coefficient, with the displacement in m.

        Raises:
            ImportError: Without the extra ``tables``.
        """
        record, scale, above = (array.ravel() for array in np.indices(self.values.shape))
        columns = {"record": np.array(self.records)[record], "scale": self.scales[scale]}
        columns |= {"yield_coefficient": self.yield_coefficients[above], "displacement_m": self.values.ravel()}
        return table_of(columns)


def newmark_displacements(
    records: Mapping[str, GroundAcceleration] | Sequence[GroundAcceleration] | RecordSuite | str,
    yield_coefficients: Sequence[Number] | Number,
    *,
    scales: Sequence[Number] | Number = 1.0,
    block: Callable[[Any], System] = rigid_block,
    rest: Number = 5.0,
) -> NewmarkDisplacements:
    """Permanent displacements of sliding blocks under all records, scaled by all factors: one ensemble.

    A record accelerates the ground up the slope, as in SLAMMER: where it is above the yield acceleration, the block
    slides down. Negative `scales` turn it round.

    Args:
        records: By their names, a list, a `RecordSuite` of which each record is taken once, or the name of a folder;
            they may differ in length and in their time steps.
        yield_coefficients: Yield accelerations over that of gravity, positive.
        scales: Factors of the accelerations, finite.
        block: Makes the system of an array of yield coefficients: `rigid_block`, or with the soil
            ``functools.partial(ss.coupled_block, period=0.6, damping_ratio=0.1)``. For the decoupled analysis give
            records that `equivalent_acceleration` made. Its first coordinate counts, down the slope.
        rest: For how long the ground is at rest after the longest record, so that blocks come to rest, s, zero or
            positive. (SLAMMER stops where the record ends.)

    Returns:
        The displacements.

    Raises:
        ValueError: For what is no record, and numbers out of their range.

    >>> records = {
    ...     f"{end} s": ss.GroundAcceleration([0.0, end, end + 0.01], [4.0, 4.0, 0.0])
    ...     for end in (0.2, 0.4)
    ... }
    >>> print(ss.newmark_displacements(records, [0.1, 0.2]).values[:, 0].round(3))
    [[0.259 0.087]
     [1.01  0.341]]
    """
    given: Any = list(records.values()) if isinstance(records, Mapping) else records
    suite = given if isinstance(given, RecordSuite) else RecordSuite(given)
    names = tuple(records) if isinstance(records, Mapping) else suite.names
    given = {"yield_coefficients": yield_coefficients, "scales": scales}
    yields, factors = (np.atleast_1d(checks.numbers(name, value)).astype(float) for name, value in given.items())
    checks.bounded("yield_coefficients", yields, above=0, ndim=1)
    checks.bounded("scales", factors, ndim=1)
    if not callable(block):
        raise checks.refused("block", "be a function that makes a block of yield coefficients", block)
    checks.non_negative("rest", rest, "s")
    shape = len(yields), len(factors), len(names)  # of the samples: records run fastest, as in `at_scales`
    of_yield, of_scale, which = (array.ravel() for array in np.indices(shape))
    many = simulate_ensemble(
        block(yields[of_yield]),
        RecordSuite(suite.records, -factors[of_scale], which.astype(float)),
        t1=suite.duration + float(rest),
        samples=len(which),
        keep="totals",
        outputs={"slid": lambda one: one.final_state[0]},
    )
    values = np.reshape(many.output_values["slid"], shape).transpose(2, 1, 0)
    return NewmarkDisplacements(names, factors, yields, values)
