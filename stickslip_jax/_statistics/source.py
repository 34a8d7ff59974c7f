"""What the statistics need of an ensemble, and the check that it is one."""

import dataclasses
from collections.abc import Callable, Hashable
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np

from .. import _checks
from .._events.sticks import FlatSticks
from .._numerics.moments import Moments
from .._status import Status
from .estimate import Estimate


@runtime_checkable
class EnsembleLike(Protocol):
    """The result of `simulate_ensemble`, as far as the statistics of totals use it; see `Ensemble`."""

    @property
    def t1(self) -> float: ...
    @property
    def moments(self) -> Moments: ...
    @property
    def status_counts(self) -> dict[Status, int]: ...
    def finished_sticks(self) -> FlatSticks: ...
    def require_sticks(self) -> FlatSticks: ...


@runtime_checkable
class WithNumberedSticks(Protocol):
    """The result of `simulate_ensemble`, as far as the tests of independence use it; see `Ensemble`."""

    def numbered_sticks(self) -> FlatSticks: ...


StickSource: TypeAlias = WithNumberedSticks | FlatSticks
"""An `Ensemble`, or the sticks of many samples themselves."""


Statistic: TypeAlias = Callable[[Any], Estimate]
"""A function of an ensemble's totals, such as `stick_fraction`."""


def require_ensemble(ensemble: object) -> Any:
    """`ensemble` itself, an `Ensemble`. Raises ValueError if it is no result of `simulate_ensemble`."""
    if not hasattr(ensemble, "status_counts") or not hasattr(ensemble, "moments"):
        raise ValueError(
            f"Argument ensemble must be the result of simulate_ensemble, but {_checks.show(ensemble)} was given; "
            "a single simulation has .stick_fraction, .sticks and .slips itself."
        )
    return ensemble


def origin_of(ensemble: EnsembleLike) -> Hashable:
    """What the samples of an ensemble have in common with those of others: its key; without one, their own means."""
    key_data = getattr(ensemble, "key_data", None)
    if key_data is not None:
        return tuple(int(word) for word in key_data)
    moments = ensemble.moments
    return ("no key", float(ensemble.t1), int(moments.number), *map(float, moments.mean))


def by_totals(statistic: Statistic, ensemble: object) -> tuple[np.ndarray, Estimate, Callable[[Moments], Estimate]]:
    """The totals of the retained samples, and the estimates from all samples and from other moments of their totals.

    Raises ValueError for an ensemble without sticks, and unless `statistic` is a function that returns an `Estimate`.
    """
    whole = require_ensemble(ensemble)
    whole.finished_sticks()  # refuses an ensemble that has none
    if not callable(statistic) or isinstance(statistic, type):
        raise ValueError(
            "Argument statistic must be a function such as stick_fraction or mean_stick_duration, but "
            f"{_checks.show(statistic)} was given."
        )
    found: object = statistic(whole)
    if not isinstance(found, Estimate):
        raise ValueError(
            "Argument statistic must be a function that returns an Estimate, such as stick_fraction or "
            f"mean_stick_duration, but it returned {_checks.show(found)}."
        )
    return whole.retained.totals, found, lambda moments: statistic(dataclasses.replace(whole, moments=moments))
