"""Sticks in the order in which the lanes record them: those of a sample in order of time, samples interleaved."""

from typing import Any, NamedTuple

import numpy as np

from .._numerics import loops
from .sticks import FURTHER, NUMBERS, FlatSticks


class StickStream(NamedTuple):
    """The sticks of many samples, those of each sample in order of time.

    Sorting millions of sticks by sample takes as long as simulating them, and most statistics do not need it.

    - `count`: number of sticks of each sample. `last`: end of its last stick, s (0 without any). (samples,).
    - `start`, `end`, `position`, `ending`: as in `FlatSticks`, (sticks,).
    - `owner`: the sample of each stick. `order`: number of sticks of the same sample before it. (sticks,).
    - `slip`: duration of the slip before each stick, s; 0 where a sample begins with a stick. (sticks,).
    - `further`: as in `FlatSticks`, (columns, sticks).
    """

    count: np.ndarray  # pyright: ignore[reportIncompatibleMethodOverride] - the name in CF conventions
    last: np.ndarray
    start: np.ndarray
    end: np.ndarray
    position: np.ndarray
    slip: np.ndarray
    ending: np.ndarray
    owner: np.ndarray
    order: np.ndarray
    further: np.ndarray

    @classmethod
    def of(cls, sticks: FlatSticks) -> "StickStream":
        """The stream of `sticks`, which are in order of their samples."""
        first, has = sticks.first, sticks.count > 0
        slip = np.empty_like(sticks.start)
        slip[1:] = sticks.start[1:] - sticks.end[:-1]
        slip[first[has]] = sticks.start[first[has]]
        last = np.zeros(len(has), sticks.end.dtype)
        last[has] = sticks.end[(first + sticks.count - 1)[has]]
        order = np.arange(len(slip)) - np.repeat(first, sticks.count)
        own = (sticks.start, sticks.end, sticks.position, slip, sticks.ending)
        return cls(sticks.count, last, *own, sticks.sample.astype(np.int32), order.astype(np.int32), sticks.further)

    @property
    def begins_at_zero(self) -> np.ndarray:
        """Whether each sample begins with a stick, (samples,)."""
        begins = np.zeros(len(self.count), bool)
        at_zero = np.flatnonzero(self.start == 0)
        begins[self.owner[at_zero]] = True
        return begins

    def slip_after(self, t1: float) -> np.ndarray:
        """Duration of the slip after each sample's last stick, s; 0 where it ends with a stick. (samples,)."""
        return np.maximum(self.last.dtype.type(t1) - self.last, 0)

    def only(self, kept: np.ndarray) -> "StickStream":
        """The same without the sticks of the samples that are not `kept`, (samples,)."""
        inside = kept[self.owner]
        count, last = np.where(kept, self.count, 0), np.where(kept, self.last, 0)
        return StickStream(count, last, *(column[..., inside] for column in self[2:]))

    def in_order(self) -> FlatSticks:
        """The sticks in order of their samples."""
        first = np.cumsum(self.count) - self.count
        columns = (self.start, self.end, self.position, self.ending, self.further)
        start, end, position, ending, further = into = tuple(np.empty_like(column) for column in columns)
        loops.compiled().put_in_order(first, self.owner, self.order, columns, into)
        return FlatSticks._make((self.count, start, end, position, *further, ending))


class StickCollector:
    """Collects the sticks of successive blocks of records in memory that it reuses.

    Allocating memory for every part would take longer than collecting its sticks.
    """

    def __init__(self) -> None:
        self._columns: tuple[np.ndarray, ...] = ()
        self.restart(0)

    def restart(self, samples: int) -> None:
        """Start over, with so many `samples`; overwrites what `sticks` returned before."""
        self._samples, self._number = samples, 0
        self._lanes: tuple[np.ndarray, ...] = ()
        self._of_samples: tuple[np.ndarray, ...] = ()

    def add(self, values: np.ndarray, ending: np.ndarray, sample: np.ndarray) -> None:
        """Add the sticks of further blocks of records, which follow those added before.

        - `values`: the numbers of the sticks, (slots, columns, lanes). `ending`: (slots, lanes), negative where there
          is no stick. `sample`: the sample of each lane in each block of slots, (blocks, lanes).
        """
        lanes, dtype = ending.shape[1], values.dtype
        assert values.shape == (len(ending), len(NUMBERS), lanes)  # compiled loops check no bounds
        if not self._lanes:
            # The sample of each lane, the number of its sticks so far, and the end of the last.
            self._lanes = (np.full(lanes, -1), np.zeros(lanes, np.int32), np.zeros(lanes, dtype))
            self._of_samples = (np.zeros(self._samples, np.int64), np.zeros(self._samples, dtype))
        columns = self._buffer(ending.size, dtype)
        records = (loops.read_only(array) for array in (values, ending, sample))
        self._number += loops.compiled().gather(*records, self._samples, *self._lanes, *self._of_samples, *columns)

    def _buffer(self, more: int, dtype: Any) -> tuple[np.ndarray, ...]:
        """The slots for up to `more` further sticks, enlarged as needed."""
        begin, end = self._number, self._number + more
        if not self._columns or end > len(self._columns[0]):
            kinds = (dtype, dtype, dtype, dtype, np.int8, np.int32, np.int32)
            larger = (*(np.empty(2 * end, kind) for kind in kinds), np.empty((len(FURTHER), 2 * end), dtype))
            for new, old in zip(larger, self._columns, strict=False):
                new[..., :begin] = old[..., :begin]
            self._columns = larger
        return tuple(column[..., begin:end] for column in self._columns)

    @property
    def sticks(self) -> StickStream:
        """The sticks of all blocks since `restart`."""
        return StickStream(*self._of_samples, *(column[..., : self._number] for column in self._columns))
