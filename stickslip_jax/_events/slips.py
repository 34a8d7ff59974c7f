"""The slips of many samples: what lies between their sticks."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .._status import Ending
from .sticks import FlatSticks


class FlatSlips(NamedTuple):
    """The slips of many samples one after the other, in order of sample, then time; arrays (slips,).

    - `sample`: the sample of each slip. `start`, `end`: s. `censored`: whether the horizon cuts it.
    """

    sample: Int[np.ndarray, " slips"]
    start: Float[np.ndarray, " slips"]
    end: Float[np.ndarray, " slips"]
    censored: Bool[np.ndarray, " slips"]

    @property
    def duration(self) -> Float[np.ndarray, " slips"]:
        """How long each slip lasts, s."""
        return self.end - self.start

    @property
    def order(self) -> Int[np.ndarray, " slips"]:
        """The order of each slip within its sample, from 1."""
        first = np.flatnonzero(np.diff(self.sample, prepend=-1))
        return np.arange(len(self.sample)) - np.repeat(first, np.diff(first, append=len(self.sample))) + 1


def slips_after(sticks: FlatSticks, t1: float) -> tuple[Float[np.ndarray, " sticks"], Float[np.ndarray, " sticks"]]:
    """Start and duration (s) of the slip after each stick, the last one up to `t1`; NaN where there is none."""
    end, next_start = np.asarray(sticks.end, np.float64), np.append(sticks.start[1:], 0.0)
    last = (sticks.first + sticks.count - 1)[sticks.count > 0]
    next_start[last] = sticks.start.dtype.type(t1)
    start = np.where((sticks.ending == Ending.HORIZON) | (next_start <= end), np.nan, end)
    return start, next_start - start


def slips_among(sticks: FlatSticks, t1: float, finished: Bool[np.ndarray, " samples"] | None = None) -> FlatSlips:
    """The slips on ``[0, t1]`` (s) of all samples that have `finished`; None: of all samples.

    One before the first stick of a sample unless this begins at t = 0, one between two sticks unless they touch, one
    after the last unless the horizon cuts that. `sticks` holds none of samples that have not finished.
    """
    at, has = np.arange(len(sticks.start)), sticks.count > 0
    is_last = np.zeros(len(at), bool)
    is_last[(sticks.first + sticks.count - 1)[has]] = True
    is_first = np.zeros(len(at), bool)
    is_first[sticks.first[has]] = True
    horizon = sticks.start.dtype.type(t1)
    before = np.where(is_first, 0, np.roll(sticks.end, 1))
    leads = ~(is_first & (sticks.start == 0)) & ~sticks.touches
    trails = is_last & (sticks.ending != Ending.HORIZON)
    empty = np.flatnonzero(~has if finished is None else finished & ~has)
    none = np.zeros(len(empty))
    sample = np.concatenate([sticks.sample[leads], sticks.sample[trails], empty])
    start = np.concatenate([before[leads], sticks.end[trails], none]).astype(sticks.start.dtype)
    end = np.concatenate([sticks.start[leads], np.full(trails.sum(), horizon), none + horizon])
    censored = np.repeat([False, True, True], [leads.sum(), trails.sum(), len(empty)])
    order = np.lexsort((start, sample))
    return FlatSlips(sample[order], start[order], end.astype(sticks.start.dtype)[order], censored[order])
