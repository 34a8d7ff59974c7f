"""Sticks as they come out of the lanes' records: in runs, each of one sample and in order of time."""

from typing import Any

import numpy as np

from .events import FlatSticks
from .numerics import loops


class StickRuns:
    """The sticks of `samples` samples, run after run. A sample may have several runs, the earlier before the later.

    To bring millions of sticks into the order of their samples takes as long as to simulate them; what the statistics
    need can be had without.

    - `owner`, `length`: the sample of each run and its number of sticks, (runs,).
    - `start`, `end`, `position`, `ending`: as in `FlatSticks`, (sticks,).
    - `count`: of sticks of each sample, (samples,).
    - `place`: of the first stick of each run. `earlier`: sticks of the same sample in earlier runs. Both (runs,).
    """

    def __init__(self, owner: np.ndarray, length: np.ndarray, columns: tuple[np.ndarray, ...], samples: int):
        self.start, self.end, self.position, self.ending = columns
        self.samples = samples
        place = np.cumsum(length) - length
        order = np.argsort(owner.astype(np.uint16) if samples < 1 << 16 else owner, kind="stable")  # by radix if small
        # From here on runs stand in order of their samples.
        self.owner, self.length, self.place = owner[order], length[order], place[order]
        self._order = order
        self.count = np.bincount(self.owner, weights=self.length, minlength=samples).astype(np.int64)
        begins = np.ones(len(self.owner), bool)
        begins[1:] = self.owner[1:] != self.owner[:-1]
        self._begins = np.flatnonzero(begins)  # the first run of each sample that has any
        earlier = np.cumsum(self.length) - self.length
        each = np.diff(np.append(self._begins, len(self.owner)))
        self.earlier = earlier - np.repeat(earlier[self._begins], each)  # sticks of the same sample in earlier runs

    @classmethod
    def of(cls, sticks: FlatSticks) -> "StickRuns":
        """Of sticks in order of their samples."""
        has = sticks.count > 0
        return cls(np.flatnonzero(has), sticks.count[has], tuple(sticks[1:]), len(sticks.count))

    @property
    def begins_at_zero(self) -> np.ndarray:
        """Whether each sample begins with a stick, (samples,)."""
        begins = np.zeros(self.samples, bool)
        begins[self.owner[self._begins]] = self.start[self.place[self._begins]] == 0
        return begins

    def at_order(self, order: int, skipped: np.ndarray) -> np.ndarray:
        """Where the stick of so high an order (from 0) stands, of each sample that has it, in order of the samples.

        `skipped`: how many sticks of each sample are not numbered, (samples,).
        """
        inside = order + skipped[self.owner] - self.earlier
        here = (inside >= 0) & (inside < self.length)
        return (self.place + inside)[here]

    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """When the slip before each run begins, (runs,), and when the last stick of each sample ends, (samples,); s."""
        finish = self.end[self.place + self.length - 1]  # of each run
        before = np.zeros_like(finish)
        before[1:] = finish[:-1]
        before[self._begins] = 0
        last = np.zeros(self.samples, self.end.dtype)
        last[self.owner] = finish  # the latest run of a sample is written last
        return before, last

    def slips(self, t1: float) -> tuple[np.ndarray, np.ndarray]:
        """Duration of the slip before each stick, (sticks,), and of the one after each sample's last, (samples,); in s.

        It is 0 where a sample begins or ends with a stick: there is no slip then.
        """
        before, last = self.edges()
        since = np.empty_like(self.end)
        since[1:] = self.end[:-1]
        since[self.place] = before
        return np.subtract(self.start, since, out=since), np.maximum(last.dtype.type(t1) - last, 0)

    def in_memory(self, of_runs: np.ndarray) -> np.ndarray:
        """What is told of each run, in the order in which they lie in memory, (runs,)."""
        moved = np.empty_like(of_runs)
        moved[self._order] = of_runs
        return moved

    def in_order(self) -> FlatSticks:
        """The sticks in order of their samples."""
        compiled = loops.compiled()
        if compiled is not None:
            columns, endings = (self.start, self.end, self.position), self.ending
            into = tuple(np.empty_like(column) for column in (*columns, endings))
            compiled.join(self.place, self.length, columns, endings, into[:3], into[3])
            return FlatSticks(self.count, *into)
        ahead = self.place - (np.cumsum(self.length) - self.length)
        at = np.arange(len(self.start)) + np.repeat(ahead, self.length)
        return FlatSticks(
            self.count, *(column.take(at) for column in (self.start, self.end, self.position, self.ending))
        )


class StickGatherer:
    """Takes sticks out of records, some blocks after the other, into memory of its own, which it uses again and again.

    Fresh memory for every part would take longer to be had than the sticks to be put there.
    """

    def __init__(self) -> None:
        self._columns: tuple[np.ndarray, ...] = ()
        self.restart(0)

    def restart(self, samples: int) -> None:
        """Begin anew, with so many samples; what `runs` gave before is lost."""
        self._samples, self._number, self._owner, self._length = samples, 0, [], []

    def add(self, values: np.ndarray, ending: np.ndarray, sample: np.ndarray) -> None:
        """Take in the sticks of further blocks of records, later than those before.

        `values` (slots, 3, lanes) holds start, end and position, `ending` (slots, lanes) is negative where there is no
        stick, and `sample` (blocks, lanes) tells whose records the lanes of each block of slots hold.
        """
        compiled = loops.compiled()
        if compiled is None:
            self._add_by_numpy(values, ending, sample)
            return
        values, ending, sample = (loops.read_only(array) for array in (values, ending, sample))
        owner, length = (np.empty(sample.size, np.int64) for _ in range(2))
        place = np.empty(ending.shape[1], np.uint64)
        runs, number = compiled.runs_of(ending, sample, self._samples, owner, length, place)
        compiled.gather(values, ending, sample, self._samples, place, *self._room(number, values.dtype))
        self._owner.append(owner[:runs])
        self._length.append(length[:runs])

    def _add_by_numpy(self, values: np.ndarray, ending: np.ndarray, sample: np.ndarray) -> None:
        slots, lanes = ending.shape
        # Lane by lane, so that the sticks of a sample lie together. Rows of a power of two: shifts do for divisions.
        bits = (slots - 1).bit_length()
        endings = np.full((lanes, 1 << bits), -1, ending.dtype)
        endings[:, :slots] = ending.T
        if np.any(idle := sample >= self._samples):  # lanes that have come to the end of their samples
            cells = endings[:, :slots].reshape(lanes, len(sample), -1)
            cells[idle.T] = -1
        found = np.flatnonzero(endings >= 0)
        at = (found & ((1 << bits) - 1)) * (3 * lanes)
        at += found >> bits
        columns = self._room(len(found), values.dtype)
        for column, first in zip(columns[:3], range(3), strict=True):
            values.reshape(-1)[first * lanes :].take(at, out=column, mode="clip")
        endings.reshape(-1).take(found, out=columns[3], mode="clip")
        owner, length = _runs(ending, sample)
        length[owner >= self._samples] = 0
        self._owner.append(owner)
        self._length.append(length)

    def _room(self, more: int, dtype: Any) -> tuple[np.ndarray, ...]:
        """Where to put so many more sticks."""
        begin, end = self._number, self._number + more
        if not self._columns or end > len(self._columns[0]):
            larger = tuple(np.empty(2 * end, of) for of in (dtype, dtype, dtype, np.int8))
            for new, old in zip(larger, self._columns, strict=False):
                new[:begin] = old[:begin]
            self._columns = larger
        self._number = end
        return tuple(column[begin:end] for column in self._columns)

    def runs(self, finished: np.ndarray) -> StickRuns:
        """The sticks of all blocks since `restart`. Samples not `finished`, (samples,), have none."""
        owner, length = np.concatenate(self._owner), np.concatenate(self._length)
        columns = tuple(column[: self._number] for column in self._columns)
        has = length > 0
        owner, length = owner[has], length[has]
        kept = finished[owner]
        if not np.all(kept):
            inside = np.repeat(kept, length)
            columns = tuple(column[inside] for column in columns)
        return StickRuns(owner[kept], length[kept], columns, len(finished))


def _runs(ending: np.ndarray, sample: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Owner and length of the runs among records: neighbouring blocks of a lane that belong to one sample."""
    slots, lanes = ending.shape
    blocks = (ending >= 0).reshape(len(sample), -1, lanes)
    small = slots < 256 * len(sample)
    length = np.add.reduce(blocks, axis=1, dtype=np.uint8 if small else np.int64).T.reshape(-1).astype(np.int64)
    owner = sample.T.reshape(-1)
    change = np.ones(len(owner), bool)
    change[1:] = owner[1:] != owner[:-1]
    change[:: len(sample)] = True  # the next lane
    first = np.flatnonzero(change)
    return owner[first], np.add.reduceat(length, first)
