"""The slips of an ensemble that kept its sticks: what lies between the sticks of the samples that finished."""

from typing import Any, NamedTuple

import numpy as np

from .._events.sticks import Slips
from .._status import Ending, Status


class FlatSlips(NamedTuple):
    """The slips of many samples one after the other, in order of sample, then time; arrays (slips,).

    - `sample`: the sample of each slip. `start`, `end`: s. `censored`: whether the horizon cuts it.
    """

    sample: np.ndarray
    start: np.ndarray
    end: np.ndarray
    censored: np.ndarray


def flat_slips(ensemble: Any) -> FlatSlips:
    """The slips of all samples that finished. Raises ValueError unless ``keep="sticks"``.

    One before the first stick of a sample unless this begins at t = 0, one between two sticks, one after the last
    unless the horizon cuts that.
    """
    sticks, finished = ensemble.require_sticks(), ensemble.totals.status == Status.FINISHED
    at, has = np.arange(len(sticks.start)), sticks.count > 0
    is_last = np.zeros(len(at), bool)
    is_last[(sticks.first + sticks.count - 1)[has]] = True
    is_first = np.zeros(len(at), bool)
    is_first[sticks.first[has]] = True
    horizon = sticks.start.dtype.type(ensemble.t1)
    before = np.where(is_first, 0, np.roll(sticks.end, 1))
    leads = ~(is_first & (sticks.start == 0))
    trails = is_last & (sticks.ending != Ending.HORIZON)
    empty = np.flatnonzero(finished & ~has)
    none = np.zeros(len(empty))
    sample = np.concatenate([sticks.sample[leads], sticks.sample[trails], empty])
    start = np.concatenate([before[leads], sticks.end[trails], none]).astype(sticks.start.dtype)
    end = np.concatenate([sticks.start[leads], np.full(trails.sum(), horizon), none + horizon])
    censored = np.repeat([False, True, True], [leads.sum(), trails.sum(), len(empty)])
    order = np.lexsort((start, sample))
    return FlatSlips(sample[order], start[order], end.astype(sticks.start.dtype)[order], censored[order])


def padded_slips(ensemble: Any) -> Slips:
    """The same as `Slips` with arrays (samples, slots), where slots is the largest number of slips (at least 1)."""
    slips = flat_slips(ensemble)
    count = np.bincount(slips.sample, minlength=ensemble.samples)
    mask = np.arange(max(1, int(count.max(initial=0)))) < count[:, None]

    def fill(values: np.ndarray, padding: Any) -> np.ndarray:
        padded = np.full(mask.shape, padding, values.dtype)
        padded[mask] = values
        return padded

    return Slips(fill(slips.start, np.nan), fill(slips.end, np.nan), fill(slips.censored, False), mask)
