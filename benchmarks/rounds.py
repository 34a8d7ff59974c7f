"""Programs timed one after the other in every round, so that their ratios are taken under the same load."""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np


class Timed(NamedTuple):
    """One run: seconds, work done (in a unit of the caller's), and error of the result, if it has one."""

    seconds: float
    work: float = 1.0
    error: float | None = None

    @property
    def each(self) -> float:
        """Seconds per unit of work."""
        return self.seconds / self.work


class Program(NamedTuple):
    """What to time: `run` takes the number of the round."""

    label: str
    run: Callable[[int], Timed]
    compile_seconds: float = 0.0
    calls: int | None = None
    """In how many rounds it takes part, if not in all of them."""


def here(function: Callable[[int], float]) -> Callable[[int], Timed]:
    """Times `function`, which returns the work done, in this process."""

    def run(number: int) -> Timed:
        started = time.perf_counter()
        work = function(number)
        return Timed(time.perf_counter() - started, work)

    return run


class Rounds:
    """The runs of all programs."""

    def __init__(self, programs: Sequence[Program], rounds: int):
        self.programs, self.rounds = programs, rounds
        self.runs: dict[str, list[Timed]] = {program.label: [] for program in programs}
        for number in range(rounds):
            for program in programs:
                if program.calls is None or number < program.calls:
                    self.runs[program.label].append(program.run(number + 1))

    def each(self, label: str) -> float:
        """The median of the seconds per unit of work."""
        return float(np.median([run.each for run in self.runs[label]]))

    def seconds(self, label: str) -> float:
        """The median of the seconds."""
        return float(np.median([run.seconds for run in self.runs[label]]))

    def error(self, label: str) -> float | None:
        """The median of the errors of the runs; None if they have none."""
        told = [run.error for run in self.runs[label] if run.error is not None]
        return float(np.median(told)) if told else None

    def ratio(self, label: str, other: str) -> float:
        """The median, over the rounds, of the time per unit of work, `other` being 1."""
        pairs = zip(self.runs[label], self.runs[other], strict=False)
        return float(np.median([mine.each / its.each for mine, its in pairs]))
