"""The statistics that `sensitivity` differentiates: ratios of two means over realisations."""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import ClassVar, NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Bool, Float

from .. import _checks
from .._simulation.outputs import Output
from .._statistics.totals import DIFFERENTIABLE, Linear, StatisticOfTotals
from .._types import Array, Scalar


class StickSequence(NamedTuple):
    """The sticks of one realisation in order of time.

    Attributes:
        start: When each stick begins, s; 0 in empty slots.
        duration: How long it lasts, s; 0 in empty slots.
        mask: Marks the filled slots; the empty ones come last.
    """

    start: Float[Array, " slots"]
    duration: Float[Array, " slots"]
    mask: Bool[Array, " slots"]


class StickStatistic(abc.ABC):
    """A statistic of the stick sequence: the mean over realisations of one number, divided by the mean of another.

    Attributes:
        name: For tables and figures.
        unit: For tables and figures.
        is_of_totals: Whether it depends only on the number of sticks and the total stick time of each realisation.
    """

    name: str
    unit: str
    is_of_totals = False

    @abc.abstractmethod
    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        """The two numbers for one realisation on [0, t1] (s); smooth in starts and durations."""


@dataclasses.dataclass(frozen=True)
class OfTotals(StickStatistic):
    """A statistic of the total stick time and the number of sticks, as `_statistics/totals.py` defines it."""

    definition: StatisticOfTotals
    is_of_totals = True

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        return self.definition.label

    @property
    def unit(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        return self.definition.unit

    @property
    def ignores_stick_count(self) -> bool:
        """Whether sticks of zero length do not change it: then its derivative has no event part."""
        return self.definition.numerator.stick_count == self.definition.denominator.stick_count == 0

    @property
    def counts_slips(self) -> bool:
        """Whether it depends on the number of slips, which the lanes that follow derivatives do not count."""
        return not self.definition.is_of_sticks

    def weights(self, t1: float) -> Float[np.ndarray, "2 3"]:
        """Coefficients of total stick time, number of sticks and 1 in numerator and denominator, for `t1` (s)."""
        return self.definition.weights(t1)[:, [0, 1, -1]]

    def parts_of(self, t1: float, stick_time: np.ndarray, sticks: np.ndarray, slips: np.ndarray) -> np.ndarray:
        """Numerator and denominator of samples with these totals, (samples, 2)."""
        weights = self.definition.weights(t1)
        totals = np.stack([np.asarray(one, float) for one in (stick_time, sticks, slips)], axis=-1)
        return totals @ weights[:, :3].T + weights[:, -1]

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        totals = jnp.stack([jnp.sum(sticks.duration), jnp.sum(sticks.mask), jnp.ones_like(sticks.start[0])])

        def value_of(one: Linear) -> Array:
            value = jnp.asarray((one.stick_time, one.stick_count, one.constant), totals.dtype) @ totals
            return value + one.t1 * t1 if one.t1 else value

        above, below = value_of(self.definition.numerator), value_of(self.definition.denominator)
        return (above / below, jnp.ones_like(above)) if self.definition.denominator.is_constant else (above, below)


@dataclasses.dataclass(frozen=True)
class RealizationMeanDuration(StickStatistic):
    """The mean over realisations of the mean stick duration of each, s; realisations without a stick do not count."""

    name = "mean stick duration (of realisation means)"
    unit = "s"

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        count = jnp.sum(sticks.mask)
        some = count > 0
        mean = jnp.sum(sticks.duration) / jnp.where(some, count, 1)
        return jnp.where(some, mean, 0), some.astype(mean.dtype)


@dataclasses.dataclass(frozen=True)
class _OfNumber(StickStatistic):
    """A mean over the i-th sticks of all realisations that have one.

    Args:
        number: i = 1, 2, ...
        count_initial_rest: Whether a stick that begins at t = 0, because the mass starts at rest, counts. By default
            it does not, and the next one is the first.

    Raises:
        ValueError: Unless `number` is a whole number of at least 1.
    """

    number: int
    count_initial_rest: bool = False
    unit = "s"
    quantity: ClassVar[str]

    def __post_init__(self):
        _checks.whole_number("number", self.number)

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        return f"mean {self.quantity} of stick {self.number}"

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        counted = sticks.mask if self.count_initial_rest else sticks.mask & (sticks.start > 0)
        chosen = counted & (jnp.cumsum(counted) == self.number)
        value = jnp.sum(jnp.where(chosen, getattr(sticks, self.quantity), 0))
        return value, jnp.any(chosen).astype(value.dtype)


@dataclasses.dataclass(frozen=True)
class StickStart(_OfNumber):
    __doc__ = f"The mean start of the i-th stick, s.\n{(_OfNumber.__doc__ or '').partition(chr(10))[2]}"
    quantity = "start"


@dataclasses.dataclass(frozen=True)
class StickDuration(_OfNumber):
    __doc__ = f"The mean duration of the i-th stick, s.\n{(_OfNumber.__doc__ or '').partition(chr(10))[2]}"
    quantity = "duration"


@dataclasses.dataclass(frozen=True)
class SumOfSquaredDurations(StickStatistic):
    """The mean over realisations of the sum of squared stick durations, s^2.

    Unlike the number of sticks, it hardly changes where short sticks escape notice.
    """

    name = "mean sum of squared stick durations"
    unit = "s^2"

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        value = jnp.sum(sticks.duration**2)
        return value, jnp.ones_like(value)


@dataclasses.dataclass(frozen=True)
class TimeToFirstStick(StickStatistic):
    """The mean over realisations of the time until a stick begins after t = 0, or until ``t1`` where none does, s."""

    name = "mean time to the first stick"
    unit = "s"

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        begins = sticks.mask & (sticks.start > 0)
        value = jnp.min(jnp.where(begins, sticks.start, jnp.asarray(t1, sticks.start.dtype)))
        return value, jnp.ones_like(value)


@dataclasses.dataclass(frozen=True)
class StickFunctional(StickStatistic):
    """The mean over realisations of a user-supplied function of the stick sequence.

    Args:
        function: Takes a `StickSequence` and returns one number, traceable by JAX. It must be smooth in starts and
            durations as long as the number of sticks does not change, and must not depend on empty slots (where starts
            and durations are 0).
        name: For tables and figures.
        unit: For tables and figures.

    Raises:
        ValueError: Unless `function` can be called.
    """

    function: Callable[[StickSequence], ArrayLike]
    name: str = "user's functional"
    unit: str = "1"

    def __post_init__(self):
        if not callable(self.function):
            raise ValueError(
                f"Argument function must be a function of a StickSequence, but {_checks.show(self.function)} was given."
            )

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        value = jnp.asarray(self.function(sticks), sticks.start.dtype)
        return value, jnp.ones_like(value)


@dataclasses.dataclass(frozen=True)
class OfOutput(StickStatistic):
    """The mean of an output of a user's own."""

    output: Output

    @property
    def name(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        return f"mean {self.output.name}"

    @property
    def unit(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride] - computed
        return self.output.unit

    def parts(self, sticks: StickSequence, t1: Scalar) -> tuple[Array, Array]:
        raise NotImplementedError("an output is that of a whole simulation, not of its sticks")


AnyStatistic: TypeAlias = StickStatistic | StatisticOfTotals | Output | str
"""What `sensitivity` takes: a string is the name of a statistic of totals."""


def statistics_of(statistic: AnyStatistic | Sequence[AnyStatistic]) -> tuple[StickStatistic, ...]:
    """`statistic`, one or several, as `StickStatistic` objects. Raises ValueError for anything else."""
    several = list(statistic) if isinstance(statistic, (list, tuple)) else [statistic]
    found = tuple(map(statistic_of, several)) or (statistic_of(statistic),)
    if len({one.name for one in found}) < len(found):
        raise ValueError(
            "Argument statistic must hold different statistics, with different names, but "
            f"{_checks.show([one.name for one in found])} were given."
        )
    return found


def statistic_of(statistic: object) -> StickStatistic:
    """`statistic` as a `StickStatistic`. Raises ValueError for anything else."""
    if isinstance(statistic, Output):
        return OfOutput(statistic)
    if isinstance(statistic, str):
        statistic = next((one for one in DIFFERENTIABLE if one.name == statistic), statistic)
    if isinstance(statistic, StickStatistic):
        if statistic.is_of_totals and not isinstance(statistic, OfTotals):
            raise ValueError(
                f"Argument statistic must have is_of_totals = False, but {_checks.show(statistic)} was given: only the "
                "package's own statistics are found from totals."
            )
        return statistic
    if isinstance(statistic, StatisticOfTotals) and any(statistic is one for one in DIFFERENTIABLE):
        return OfTotals(statistic)
    raise ValueError(
        f"Argument statistic must be {', '.join(map(repr, DIFFERENTIABLE))}, or a StickStatistic such as "
        f"StickDuration(1), an Output, or a list of them, but {_checks.show(statistic)} was given."
    )
