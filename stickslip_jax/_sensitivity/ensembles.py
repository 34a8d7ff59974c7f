"""Finite differences between ensembles with the same random numbers, for motion that only an ensemble simulates.

Regularised dynamics has no margins: there a stick is a time below a threshold. The options of the method that follow
from the system, such as the threshold, follow the parameter.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from .._ensemble.call import simulate_batch
from .._ensemble.parts import RETAINED
from .._ensemble.setup import EnsembleSetup
from .._events.sticks import FlatSticks
from .._statistics.accumulator import Numbering
from .._status import Status
from .._uncertainty.inputs import Model
from .._uncertainty.numbers import Parameter, check_numbers, with_numbers
from .problem import Problem, lanes_and_rows
from .statistic import OfTotals, StickSequence, StickStatistic

_ALL = Numbering(1, True)  # counts a stick that begins at t = 0, as the statistics do


def ends_of(model: Model, parameter: Parameter, length: float) -> list[Model]:
    """The model with the parameter lowered and raised by `length`. Raises ValueError if a value is not allowed."""
    ends = [with_numbers(model, (parameter.path,), (float(parameter.value + sign * length),)) for sign in (-1, 1)]
    try:
        for end in ends:
            check_numbers(tuple(end))
    except ValueError as error:
        raise ValueError(
            f"Argument step must be smaller: {parameter.name} = {parameter.value:g} is to be varied by {length:g}, "
            f"which it does not allow. {error}"
        ) from error
    return ends


def simulated(problem: Problem, model: Model) -> Callable[[int, int], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """A function of a task's first sample and number of samples that simulates `model`.

    It gives the statistic's parts (samples, 2), the status and the number of sticks of each sample.
    """
    key = jax.random.wrap_key_data(problem.key_data)
    options = (problem.samples, 0, key, None, problem.method, "sticks", _ALL)
    run = EnsembleSetup.checked(model, problem.t1, *options)

    def values(first: int, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        many = simulate_batch(run, first, number, "sticks", retained=RETAINED, fewest=problem.samples)
        totals = many.totals
        assert totals is not None
        status = np.where(totals.status == Status.FINISHED, totals.status, np.maximum(totals.status, 1)).astype(int)
        return _parts(problem, totals, many.require_sticks()), status, totals.sticks

    return values


def samples_per_task(problem: Problem) -> int:
    """The largest number of samples of a task."""
    return lanes_and_rows(problem)[2]


def _parts(problem: Problem, totals: Any, sticks: FlatSticks) -> np.ndarray:
    """Numerator and denominator of the statistic of each sample, (samples, 2)."""
    if isinstance(problem.statistic, OfTotals):
        weights = problem.statistic.weights(problem.t1)
        columns = np.stack([np.asarray(totals.stick_time, float), np.asarray(totals.sticks, float)], axis=-1)
        return columns @ weights[:, :2].T + weights[:, 2]
    return _parts_of_sequences(problem.statistic, sticks, problem.t1, problem.dtype)


def _parts_of_sequences(statistic: StickStatistic, sticks: FlatSticks, t1: float, dtype: Any) -> np.ndarray:
    most = 8 * -(-(int(sticks.count.max()) + 1) // 8)  # few sizes: each is compiled
    slots = np.arange(len(sticks.start)) - np.repeat(sticks.first, sticks.count)
    columns = np.zeros((2, len(sticks.count), most), dtype)
    columns[:, sticks.sample, slots] = sticks.start, sticks.duration
    mask = np.arange(most) < sticks.count[:, None]
    one = jax.jit(jax.vmap(lambda *sequence: statistic.parts(StickSequence(*sequence), t1)))
    return np.stack([np.asarray(part, float) for part in one(*columns, mask)], axis=-1)
