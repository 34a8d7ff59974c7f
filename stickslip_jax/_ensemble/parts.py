"""Parts of an ensemble, which threads simulate, and the accumulator that merges them."""

import os
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .._dynamics.lanes import LaneResults
from .._events.stick_stream import StickCollector, StickStream
from .._events.sticks import NUMBERS, FlatSticks
from .._numerics.moments import Moments
from .._statistics.accumulator import Numbering, StickAccumulator
from .._statistics.registry import TOTALS
from .._status import Status
from .result import Retained, SampleTotals

Keep: TypeAlias = Literal["totals", "statistics", "sticks"]
"""What an ensemble keeps: totals of stick time, sticks and slips only; all statistics; or also every stick."""

RETAINED = 1_000_000
"""With ``keep="statistics"``, the most sticks that are retained, those of the first samples: for standard errors and
for what cannot be accumulated (ranks, tests)."""
FEWEST = 64
"""The fewest samples that are retained, however many sticks they have."""


class Part(NamedTuple):
    """A part of the ensemble: results of consecutive samples, their sticks, and the sums over these sticks."""

    results: LaneResults
    sticks: FlatSticks | None = None
    accumulator: StickAccumulator | None = None

    @classmethod
    def of(
        cls, results: LaneResults, sticks: StickCollector, t1: float, numbering: Numbering, keep_sticks: bool
    ) -> "Part":
        """The part made from the results and the sticks of consecutive samples, simulated up to `t1` (s).

        `keep_sticks`: whether the part holds the sticks too, not only their sums.
        """
        finished = np.equal(results.status, Status.FINISHED)
        stick_time, slips = (np.asarray(column)[finished] for column in (results.stick_time, results.slips))
        done, found = sticks.sticks, None
        if not np.all(finished):
            found = done.only(finished).in_order()
            done = StickStream.of(found.only(finished))
        accumulator = StickAccumulator.of(done, stick_time, slips, t1, numbering)
        return cls(results, found or done.in_order() if keep_sticks else None, accumulator)


def prepare(dtype: Any) -> None:
    """Compile the loops that collect and count sticks with times of `dtype`, unless they are compiled."""
    sticks = StickCollector()
    sticks.restart(1)
    sticks.add(np.zeros((1, len(NUMBERS), 1), dtype), np.zeros((1, 1), np.int8), np.zeros((1, 1), np.int64))
    one = np.zeros(1)
    Part.of(LaneResults(one, one, one, np.full(1, Status.FINISHED), one), sticks, 1.0, Numbering(1, False), True)


class EnsembleAccumulator:
    """Merges the parts of an ensemble, which are added in order of the samples.

    Holds the sums over all samples, and the sticks of the first samples (with ``keep="sticks"``, of all).
    """

    def __init__(self, samples: int, keep: Keep):
        self.samples, self.keep = samples, keep
        self.moments = Moments.of(np.zeros((0, len(TOTALS))))
        self.counts = np.zeros(len(Status), int)
        self.near_grazing_samples = 0
        self.accumulator: StickAccumulator | None = None
        self._kept: list[Part] = []
        self._space, self._retained_samples = RETAINED, 0  # number of sticks that still fit

    @property
    def wants_sticks(self) -> bool:
        """Whether the sticks of further parts are kept."""
        return self.keep == "sticks" or self._space > 0

    def add(self, part: Part) -> None:
        """Add the next part."""
        self.counts += np.bincount(part.results.status, minlength=len(Status))
        self.near_grazing_samples += int(np.count_nonzero(part.results.near_grazing_count))
        self.moments = self.moments.merge(Moments.of(_totals_of(part.results)))
        if part.accumulator is not None:
            self.accumulator = (
                part.accumulator if self.accumulator is None else self.accumulator.merge(part.accumulator)
            )
        if part.sticks is None:
            return
        if self.keep == "sticks":
            self._kept.append(part._replace(accumulator=None))
            _check_memory(self._kept, self.samples)
        elif self._space > 0:
            # A sample takes the space of its sticks and one more, so that samples without sticks are limited too.
            fits = int(np.searchsorted(np.cumsum(part.sticks.count + 1), self._space, side="right"))
            fits = max(fits, min(FEWEST - self._retained_samples, len(part.sticks.count)))
            self._retained_samples += fits
            results = LaneResults(*(column[:fits].copy() for column in part.results))
            whole = fits == len(part.sticks.count)
            self._kept.append(Part(results, part.sticks if whole else part.sticks.head(fits)))
            left = self._space - len(part.sticks.start) - fits if fits == len(part.results.status) else 0
            self._space = max(left, int(self._retained_samples < FEWEST))

    def found(self) -> dict[str, Any]:
        """The fields of an `Ensemble` that come from the parts, by name."""
        is_full, kept = self.keep == "sticks", [part.sticks for part in self._kept if part.sticks is not None]
        sticks = FlatSticks.joined(kept) if kept else None
        return {
            "moments": self.moments,
            "status_counts": {status: int(self.counts[status]) for status in Status},
            "near_grazing_samples": self.near_grazing_samples,
            "accumulator": self.accumulator,
            "retained": None if sticks is None else self._retained(sticks),
            "totals": self._totals() if is_full else None,
            "flat_sticks": sticks if is_full else None,
        }

    def _totals(self) -> SampleTotals:
        """The totals of every kept sample."""
        columns = [np.concatenate(column) for column in zip(*(part.results for part in self._kept), strict=True)]
        by_name = dict(zip(LaneResults._fields, columns, strict=True))
        return SampleTotals(**{name: by_name[name] for name in SampleTotals._fields})

    def _retained(self, sticks: FlatSticks) -> Retained:
        """The sticks and totals of the kept samples that finished."""
        results = [part.results for part in self._kept]
        finished = np.concatenate([np.equal(one.status, Status.FINISHED) for one in results])
        return Retained(sticks.only(finished), np.concatenate([_totals_of(one) for one in results]))


def _totals_of(results: LaneResults) -> np.ndarray:
    """The `TOTALS` of each finished sample, (finished samples, 3)."""
    finished = results.status == Status.FINISHED
    columns = (results.stick_time, results.sticks, results.slips)
    return np.stack([np.asarray(column, np.float64) for column in columns], axis=1)[finished]


def _check_memory(kept: list[Part], samples: int) -> None:
    """Raise ValueError before the sticks outgrow the memory: joining them takes twice their size."""
    if len(kept) % 64 != 1 or "SC_PHYS_PAGES" not in getattr(os, "sysconf_names", {}):
        return
    done = sum(len(part.results.status) for part in kept)
    size = sum(column.nbytes for part in kept for column in (*part.results, *(part.sticks or ())))
    expected, memory = 2 * size / done * samples, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if expected > memory:
        raise ValueError(
            f'Argument keep must be "statistics" for so many samples: keeping the sticks of {samples} takes '
            f"about {expected / 1e9:.0f} GB, and this machine has {memory / 1e9:.0f} GB."
        )
