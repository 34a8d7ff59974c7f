"""Moments of stick sequences: which, what was observed of them, and how the observed ones scatter."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .. import _checks
from .._ensemble.result import Ensemble
from .._sensitivity.differences import parts_of_sequences
from .._sensitivity.statistic import (
    OfOutput,
    OfTotals,
    StickSequence,
    StickStatistic,
    SumOfSquaredDurations,
    TimeToFirstStick,
    statistics_of,
)
from .._statistics.totals import mean_stick_count, mean_total_stick_time
from .._status import Status
from .._types import Array, Scalar

_ROUND_OFF = 1e-12
_DEPENDENT = 1e-9  # smallest eigenvalue of the correlations of moments that do not determine each other


@dataclasses.dataclass(frozen=True)
class Product(StickStatistic):
    """The mean over realisations of the product of two numbers whose means are statistics."""

    one: StickStatistic
    other: StickStatistic

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        return f"{self.one.name} * {self.other.name}"

    @property
    def unit(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        return f"{self.one.unit} * {self.other.unit}"

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        (a, _), (b, one) = self.one.parts(sticks, t1), self.other.parts(sticks, t1)
        return a * b, one


@dataclasses.dataclass(frozen=True)
class Recorded(StickStatistic):
    """A statistic found from recorded sticks, where it could be found from totals too: in the same way as others."""

    of: StickStatistic

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        return self.of.name

    @property
    def unit(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        return self.of.unit

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        return self.of.parts(sticks, t1)


DEFAULT = (mean_total_stick_time, mean_stick_count, SumOfSquaredDurations(), TimeToFirstStick())


class Observed(NamedTuple):
    """The moments of one experiment: means over its recordings, and the covariance of one recording's numbers.

    - `mean`: (moments,). `covariance`: (moments, moments), between recordings; NaN for one recording.
    - `values`: (recordings, moments), each recording's numbers: of a ratio of means, to first order (delta method).
    - `t1`: s. `has_ratios`: whether one is a ratio of two means.
    """

    statistics: tuple[StickStatistic, ...]
    mean: Float[np.ndarray, " moments"]
    covariance: Float[np.ndarray, "moments moments"]
    values: Float[np.ndarray, "recordings moments"]
    t1: float
    has_ratios: bool

    @property
    def recordings(self) -> int:
        """Their number."""
        return len(self.values)

    def only(self, chosen: Sequence[int]) -> "Observed":
        """The same with fewer moments."""
        at = list(chosen)
        statistics = tuple(self.statistics[index] for index in at)
        return Observed(
            statistics, self.mean[at], self.covariance[np.ix_(at, at)], self.values[:, at], self.t1, self.has_ratios
        )


def moments_of(moments: object) -> tuple[StickStatistic, ...]:
    """`moments` as statistics. Raises ValueError for what is no list of statistics of sticks."""
    several: Any = DEFAULT if moments is None else moments
    if not isinstance(several, (list, tuple)):
        several = [several]
    try:
        found = statistics_of(tuple(several))
    except ValueError as error:
        raise ValueError(str(error).replace("Argument statistic", "Argument moments", 1)) from error
    for one in found:
        if isinstance(one, OfOutput) or (isinstance(one, OfTotals) and one.counts_slips):
            raise _checks.refused(
                "moments", "hold statistics of sticks, of which recordings of sticks tell", one.name,
                "of slips take a StickFunctional of what lies between the sticks",
            )  # fmt: skip
    return found


def observed_ensembles(observed: object) -> list[Ensemble]:
    """The ensemble of each experiment. Raises ValueError for anything else, and where nothing can be learned."""
    several = list(observed) if isinstance(observed, (list, tuple)) else [observed]
    found: list[Ensemble] = []
    for number, one in enumerate(several):
        name = "observed" if len(several) == 1 else f"observed[{number}]"
        if not isinstance(one, Ensemble):
            raise _checks.refused(name, "be an Ensemble, as Ensemble.from_sticks makes one of measured sticks", one)
        unfinished = sum(count for status, count in one.status_counts.items() if status != Status.FINISHED)
        if unfinished:
            raise ValueError(
                f"Argument {name} must hold realisations that reached t1, but {unfinished} of {one.samples} did not; "
                "leave these out."
            )
        if one.flat_sticks is None:
            raise ValueError(
                f"Argument {name} must hold every stick, but this ensemble did not keep them; simulate it with "
                'keep="sticks".'
            )
        if not len(one.flat_sticks.start):
            raise ValueError(
                f"Argument {name} must hold sticks, but its {one.samples} recordings have none: nothing of sticks can "
                "be fitted to them."
            )
        found.append(one)
    if not found:
        raise _checks.refused("observed", "be an Ensemble or a list of them, at least one", observed)
    return found


def observed_moments(statistics: tuple[StickStatistic, ...], ensemble: Ensemble) -> Observed:
    """What `ensemble` says of the moments. Raises ValueError where a moment is defined for no recording."""
    sticks, t1 = ensemble.require_sticks(), float(ensemble.t1)
    means, values, has_ratios = [], [], False
    for one in statistics:
        above, below = parts_of_sequences(one, sticks, t1, np.float64).T
        if not below.mean() > 0:
            raise ValueError(
                f"Argument moments must be defined for some of the recordings, but {one.name!r} is for none of these "
                f"{ensemble.samples}."
            )
        has_ratios |= bool(np.any(below != 1))
        means.append(above.mean() / below.mean())
        values.append(means[-1] + (above - means[-1] * below) / below.mean())
    table, number = np.stack(values, axis=-1), len(values[0])
    covariance = np.atleast_2d(np.cov(table.T)) if number > 1 else np.full((len(statistics),) * 2, np.nan)
    return Observed(statistics, np.array(means), covariance, table, t1, has_ratios)


def without_scatter(observed: Observed) -> list[int]:
    """The moments that have the same value in all recordings."""
    spread = np.ptp(observed.values, axis=0)
    return [int(at) for at in np.flatnonzero(spread <= _ROUND_OFF * np.abs(observed.mean))]


def check_covariance(observed: Observed, name: str) -> None:
    """Raise ValueError unless the recordings determine a covariance of the moments that can be inverted."""
    moments = len(observed.statistics)
    if observed.recordings < moments + 2:
        raise ValueError(
            f"Argument {name} must hold at least {moments + 2} recordings for the covariance of {moments} moments, but "
            f"it holds {observed.recordings}; take fewer moments, or objective='likelihood', which has the model's."
        )
    fixed = without_scatter(observed)
    if fixed:
        raise ValueError(
            f"Argument moments must differ between recordings, but {observed.statistics[fixed[0]].name!r} is the same "
            f"in all of {name}; leave it out."
        )
    spread = np.sqrt(np.diag(observed.covariance))
    if np.linalg.eigvalsh(observed.covariance / np.outer(spread, spread))[0] < _DEPENDENT:
        names = ", ".join(repr(one.name) for one in observed.statistics)
        raise ValueError(
            f"Argument moments must not determine each other, but in {name} one of {names} follows from the others; "
            "leave it out."
        )
