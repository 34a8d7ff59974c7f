"""What sensitivities can be asked of: statistics that are the ratio of two means over realisations."""

import abc
import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._statistics.estimates import mean_stick_count, mean_stick_duration, stick_fraction
from .._types import Array


class StickSequence(NamedTuple):
    """The sticks of one realisation in order of time; arrays (slots,), of which `mask` marks the filled ones.

    `start`, `duration`: s; 0 in spare slots, which come last.
    """

    start: Array
    duration: Array
    mask: Array


class StickStatistic(abc.ABC):
    """A statistic of the stick sequence: the mean of one number of a realisation by that of another.

    `name`, `unit`: for tables and figures. `is_of_totals`: whether it depends on nothing but each realisation's number
    of sticks and total stick time.
    """

    name: str
    unit: str
    is_of_totals = False

    @abc.abstractmethod
    def parts(self, sticks: StickSequence, t1: Any) -> tuple[Any, Any]:
        """The two numbers of one realisation on [0, t1]; smooth in starts and durations."""


@dataclasses.dataclass(frozen=True)
class OfTotals(StickStatistic):
    """A ratio of linear functions of the total stick time and the number of sticks.

    `above`, `below`: their coefficients, of time (1/s), number and 1. `per_horizon`: whether to divide by ``t1``.
    """

    name: str
    unit: str
    above: tuple[int, int, int]
    below: tuple[int, int, int]
    per_horizon: bool = False
    is_of_totals = True

    @property
    def is_blind_to_events(self) -> bool:
        """Whether sticks of no length do not show: then there is no event part."""
        return self.above[1] == self.below[1] == 0

    def weights(self, t1: float) -> np.ndarray:
        """The coefficients of numerator and denominator, (2, 3)."""
        return np.array([self.above, self.below]) / np.array([[t1 if self.per_horizon else 1.0], [1.0]])

    def parts(self, sticks: StickSequence, t1: Any) -> tuple[Any, Any]:
        totals = jnp.stack([jnp.sum(sticks.duration), jnp.sum(sticks.mask), jnp.ones_like(sticks.start[0])])
        above = jnp.asarray(self.above, totals.dtype) @ totals
        return above / t1 if self.per_horizon else above, jnp.asarray(self.below, totals.dtype) @ totals


STICK_FRACTION = OfTotals("stick fraction", "1", (1, 0, 0), (0, 0, 1), per_horizon=True)
TOTAL_STICK_TIME = OfTotals("mean total stick time", "s", (1, 0, 0), (0, 0, 1))
STICK_COUNT = OfTotals("mean number of sticks", "1", (0, 1, 0), (0, 0, 1))
POOLED_DURATION = OfTotals("mean stick duration (pooled)", "s", (1, 0, 0), (0, 1, 0))


@dataclasses.dataclass(frozen=True)
class RealisationMeanDuration(StickStatistic):
    """The mean over realisations of each one's own mean stick duration, s; those without a stick do not count."""

    name = "mean stick duration (of realisation means)"
    unit = "s"

    def parts(self, sticks: StickSequence, t1: Any) -> tuple[Any, Any]:
        count = jnp.sum(sticks.mask)
        some = count > 0
        mean = jnp.sum(sticks.duration) / jnp.where(some, count, 1)
        return jnp.where(some, mean, 0), some.astype(mean.dtype)


@dataclasses.dataclass(frozen=True)
class _OfNumber(StickStatistic):
    """A mean over the i-th sticks of all realisations that have one.

    - `number`: i = 1, 2, ...
    - `count_initial_rest`: whether a stick that begins at t = 0, because the mass was put down at rest, counts. By
      default it does not, and the next one is the first.

    Raises ValueError for another number.
    """

    number: Any
    count_initial_rest: bool = False

    def __post_init__(self):
        _checks.whole_number("number", self.number)

    @abc.abstractmethod
    def value_of(self, sticks: StickSequence) -> Array:
        """What to average, of every stick."""

    def parts(self, sticks: StickSequence, t1: Any) -> tuple[Any, Any]:
        counted = sticks.mask if self.count_initial_rest else sticks.mask & (sticks.start > 0)
        chosen = counted & (jnp.cumsum(counted) == self.number)
        value = jnp.sum(jnp.where(chosen, self.value_of(sticks), 0))
        return value, jnp.any(chosen).astype(value.dtype)


@dataclasses.dataclass(frozen=True)
class StickStart(_OfNumber):
    __doc__ = f"The mean start of the i-th stick, s.\n{(_OfNumber.__doc__ or '').partition(chr(10))[2]}"
    unit = "s"

    @property
    def name(self) -> str:
        return f"mean start of stick {self.number}"

    def value_of(self, sticks: StickSequence) -> Array:
        return sticks.start


@dataclasses.dataclass(frozen=True)
class StickDuration(_OfNumber):
    __doc__ = f"The mean duration of the i-th stick, s.\n{(_OfNumber.__doc__ or '').partition(chr(10))[2]}"
    unit = "s"

    @property
    def name(self) -> str:
        return f"mean duration of stick {self.number}"

    def value_of(self, sticks: StickSequence) -> Array:
        return sticks.duration


@dataclasses.dataclass(frozen=True)
class StickFunctional(StickStatistic):
    """The mean of a function of the user's.

    - `function`: takes a `StickSequence` and gives one number that JAX can trace; smooth in starts and durations as
      long as no stick comes or goes, and blind to spare slots (their starts and durations are 0).
    - `name`, `unit`: for tables and figures.
    """

    function: Any
    name: str = "user's functional"
    unit: str = "1"

    def __post_init__(self):
        if not callable(self.function):
            raise ValueError(
                f"Argument function must be a function of a StickSequence, but {_checks.show(self.function)} was given."
            )

    def parts(self, sticks: StickSequence, t1: Any) -> tuple[Any, Any]:
        value = jnp.asarray(self.function(sticks), sticks.start.dtype)
        return value, jnp.ones_like(value)


_PUBLIC = {stick_fraction: STICK_FRACTION, mean_stick_count: STICK_COUNT, mean_stick_duration: POOLED_DURATION}


def statistic_of(statistic: Any) -> StickStatistic:
    """The `StickStatistic` that the caller means. Raises ValueError for anything that has none."""
    if isinstance(statistic, StickStatistic):
        return statistic
    try:
        return _PUBLIC[statistic]
    except (KeyError, TypeError):
        raise ValueError(
            "Argument statistic must be stick_fraction, mean_stick_count, mean_stick_duration, or a StickStatistic "
            f"such as StickDuration(1), but {_checks.show(statistic)} was given."
        ) from None
