"""Sticks in the order in which the lanes record them: those of a sample in order of time, samples interleaved."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .._numerics import loops
from .sticks import NUMBERS, FlatSticks, named_column


class StickStream(NamedTuple):
    """The sticks of many samples, those of each sample in order of time.

    Sorting millions of sticks by sample takes as long as simulating them, and most statistics do not need it.

    - `count`: number of sticks of each sample. `last`: end of its last stick, s (0 without any).
    - `numbers`, `ending`: as in `FlatSticks`; each column is also an attribute of its name.
    - `slip`: duration of the slip before each stick, s; 0 where a sample begins with a stick.
    - `owner`: the sample of each stick. `order`: number of sticks of the same sample before it.
    """

    count: Int[np.ndarray, " samples"]  # pyright: ignore[reportIncompatibleMethodOverride] - the name in CF conventions
    last: Float[np.ndarray, " samples"]
    numbers: Float[np.ndarray, "columns sticks"]
    slip: Float[np.ndarray, " sticks"]
    ending: Int[np.ndarray, " sticks"]
    owner: Int[np.ndarray, " sticks"]
    order: Int[np.ndarray, " sticks"]

    def __getattr__(self, name: str) -> np.ndarray:
        return named_column(self, name)

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
        whose = (sticks.sample.astype(np.int32), order.astype(np.int32))
        return cls(sticks.count, last, sticks.numbers, slip, sticks.ending, *whose)

    @property
    def begins_at_zero(self) -> Bool[np.ndarray, " samples"]:
        """Whether each sample begins with a stick."""
        begins = np.zeros(len(self.count), bool)
        at_zero = np.flatnonzero(self.start == 0)
        begins[self.owner[at_zero]] = True
        return begins

    def slip_after(self, t1: float) -> Float[np.ndarray, " samples"]:
        """Duration of the slip after each sample's last stick, s; 0 where it ends with a stick."""
        return np.maximum(self.last.dtype.type(t1) - self.last, 0)

    def only(self, kept: Bool[np.ndarray, " samples"]) -> "StickStream":
        """The same without the sticks of the samples that are not `kept`."""
        inside = kept[self.owner]
        count, last = np.where(kept, self.count, 0), np.where(kept, self.last, 0)
        return StickStream(count, last, *(column[..., inside] for column in self[2:]))

    def of_track(self, track: int, tracks: int) -> "StickStream":
        """The sticks of one track of systems with several contacts, collected as if each track were a sample.

        The tracks of a sample stand one after the other.
        """
        of_it = self.owner % tracks == track
        count, last = self.count[track::tracks], self.last[track::tracks]
        only = StickStream(count, last, *(column[..., of_it] for column in self[2:]))
        return only._replace(owner=only.owner // tracks)

    def in_order(self) -> FlatSticks:
        """The sticks in order of their samples."""
        first = np.cumsum(self.count) - self.count
        numbers, ending = np.empty(self.numbers.shape, self.numbers.dtype), np.empty_like(self.ending)
        columns = (tuple(self.numbers), self.ending, tuple(numbers), ending)
        loops.compiled().put_in_order(first, self.owner, self.order, *columns)
        return FlatSticks(self.count, numbers, ending)


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

    def add(
        self,
        values: Float[np.ndarray, "slots columns lanes"],
        ending: Int[np.ndarray, "slots lanes"],
        sample: Int[np.ndarray, "blocks lanes"],
    ) -> None:
        """Add the sticks of further blocks of records, which follow those added before.

        Args:
            values: The numbers of the sticks.
            ending: Their `Ending` codes, negative where there is no stick.
            sample: The sample of each lane in each block of slots.
        """
        lanes, dtype = ending.shape[1], values.dtype
        assert values.shape == (len(ending), len(NUMBERS), lanes)  # compiled loops check no bounds
        if not self._lanes:
            # The sample of each lane, the number of its sticks so far, and the end of the last.
            self._lanes = (np.full(lanes, -1), np.zeros(lanes, np.int32), np.zeros(lanes, dtype))
            self._of_samples = (np.zeros(self._samples, np.int64), np.zeros(self._samples, dtype))
        self._enlarge(self._number + ending.size, dtype)
        records = (loops.read_only(array) for array in (values, ending, sample))
        into = (*self._lanes, *self._of_samples, *self._columns)
        self._number = int(loops.compiled().gather(*records, self._samples, self._number, *into))

    def _enlarge(self, slots: int, dtype: Any) -> None:
        """Make the columns twice as long as `slots` if they are shorter."""
        if self._columns and slots <= len(self._columns[1]):
            return
        kinds = (dtype, np.int8, np.int32, np.int32)
        larger = (np.empty((len(NUMBERS), 2 * slots), dtype), *(np.empty(2 * slots, kind) for kind in kinds))
        for new, old in zip(larger, self._columns, strict=False):
            new[..., : self._number] = old[..., : self._number]
        self._columns = larger

    @property
    def sticks(self) -> StickStream:
        """The sticks of all blocks since `restart`."""
        return StickStream(*self._of_samples, *(column[..., : self._number] for column in self._columns))
