"""The options of the ``stickslip`` command."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter, Token

from ._errors import StudyError


def _whole_number(kind: type, tokens: Sequence[Token]) -> int:
    """Read a whole number; cyclopts alone would round 2.7 to 3."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f'"{tokens[0].value}" is not a whole number.') from None


_Whole = Annotated[int | None, Parameter(converter=_whole_number)]
Example = Literal["harmonic-base", "base-isolation", "motor-cart", "two-blocks"]
Paper = Literal[
    "parametric-analysis", "stick-share-constant", "stick-share-square", "stick-share-harmonic", "stick-share-random"
]
FIGURES = (".png", ".pdf", ".svg")
Switch = Annotated[bool, Parameter(negative="", show_default=False)]


@dataclass(frozen=True)
class StudyOptions:
    """The options of ``stickslip study``; None leaves the choice to the configuration.

    Parameters
    ----------
    samples
        Number of samples.
    seed
        Seed of the random numbers.
    t1
        Duration of each sample, s.
    threads
        Worker threads (default: all cores).
    chunk
        Samples simulated per call (default: chosen for speed). Does not change the results.
    out
        Folder for the result (default: results/study).
    force
        Replace a result in that folder, once the new one is complete.
    figures
        Draw figures, or not.
    json
        Print the statistics as one JSON object on standard output, all else on standard error.
    quiet
        Print no table and no progress.
    progress
        Show a progress bar, or not (default: only on a terminal).
    print_config
        Print the complete configuration, a file to start from, and run nothing.
    print_example
        Print the configuration of an example, likewise: a mass on a base that oscillates (harmonic-base), a building on
        sliding isolators in an earthquake (base-isolation), a cart driven by a motor (motor-cart), or a structure with
        several contacts (two-blocks).
    """

    samples: _Whole = None
    seed: _Whole = None
    t1: float | None = None
    threads: _Whole = None
    chunk: _Whole = None
    out: str | None = None
    force: Switch = False
    figures: bool | None = None
    json: Switch = False
    quiet: Switch = False
    progress: bool | None = None
    print_config: Switch = False
    print_example: Example | None = None


@dataclass(frozen=True)
class ExecutorOptions:
    """Where a sweep is simulated; the numbers are the same everywhere.

    Parameters
    ----------
    threads
        Threads of one process (default: all cores).
    workers
        Processes on this machine, in place of threads.
    dask
        Address of a dask scheduler whose workers simulate, such as tcp://127.0.0.1:8786.
    quiet
        Print no table and no progress.
    progress
        Show a progress bar, or not (default: only on a terminal).
    """

    threads: _Whole = None
    workers: _Whole = None
    dask: str | None = None
    quiet: Switch = False
    progress: bool | None = None

    def __post_init__(self):
        given = [f"--{name}" for name in ("threads", "workers", "dask") if getattr(self, name) is not None]
        if len(given) > 1:
            raise StudyError(f"Options {given[0]} and {given[1]} were both given; each says where to simulate.")
        for name in ("threads", "workers"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise StudyError(f"option --{name} must be at least 1, but {value} was given.")


@dataclass(frozen=True)
class SweepOptions:
    """The options of ``stickslip sweep``.

    Parameters
    ----------
    out
        Folder of the sweep; needed to run it.
    samples
        Number of samples at each point.
    paper
        A sweep of a paper in place of a file: statistics over friction and switching rate (parametric-analysis), or the
        share of time spent sticking over friction and frequency of the belt (stick-share-...).
    print_config
        Print the complete configuration, a file to start from, and run nothing.
    """

    out: Path | None = None
    samples: _Whole = None
    paper: Paper | None = None
    print_config: Switch = False
