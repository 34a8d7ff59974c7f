"""The options of the ``stickslip`` command."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError

from .. import __version__
from ._errors import StudyError


def _whole_number(kind: type, tokens: Sequence[Any]) -> int:
    """Read a whole number; cyclopts alone would round 2.7 to 3."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f'"{tokens[0].value}" is not a whole number.') from None


_Whole = Annotated[int | None, Parameter(converter=_whole_number)]
Example = Literal["harmonic-base", "base-isolation", "motor-cart"]
Paper = Literal[
    "parametric-analysis", "stick-share-constant", "stick-share-square", "stick-share-harmonic", "stick-share-random"
]
_FIGURES = (".png", ".pdf", ".svg")
_Switch = Annotated[bool, Parameter(negative="", show_default=False)]


@dataclass(frozen=True)
class Options:
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
        sliding isolators in an earthquake (base-isolation), or a cart driven by a motor (motor-cart).
    """

    samples: _Whole = None
    seed: _Whole = None
    t1: float | None = None
    threads: _Whole = None
    chunk: _Whole = None
    out: str | None = None
    force: _Switch = False
    figures: bool | None = None
    json: _Switch = False
    quiet: _Switch = False
    progress: bool | None = None
    print_config: _Switch = False
    print_example: Example | None = None


@dataclass(frozen=True)
class Executors:
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
    quiet: _Switch = False
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
    print_config: _Switch = False


@dataclass(frozen=True)
class StudyCommand:
    """The arguments of ``stickslip study``: the configuration file, if any, and the options."""

    config: Path | None
    options: Options


@dataclass(frozen=True)
class SweepCommand:
    """The arguments of ``stickslip sweep``: the configuration file, if any, and the options."""

    config: Path | None
    options: SweepOptions
    executors: Executors


@dataclass(frozen=True)
class ResumeCommand:
    """The arguments of ``stickslip resume``."""

    folder: Path
    executors: Executors


@dataclass(frozen=True)
class StatusCommand:
    """The argument of ``stickslip status``."""

    folder: Path


@dataclass(frozen=True)
class ShowCommand:
    """The arguments of ``stickslip show``; no `statistics`: the usual ones."""

    folder: Path
    out: Path | None
    statistics: tuple[str, ...]
    force: bool


Command = StudyCommand | SweepCommand | ResumeCommand | StatusCommand | ShowCommand


def parse(tokens: Sequence[str]) -> Command | None:
    """The command given by `tokens`, the words of the command line; None if help or the version was printed.

    Raises StudyError for unknown commands and options and for values of the wrong type.
    """
    app = App(
        name="stickslip",
        version=__version__,
        help="Exact simulation of stick-slip (dry-friction) oscillators under random motion of their base.",
        help_formatter="plain",
    )
    for name, command in (
        ("study", _study), ("sweep", _sweep), ("resume", _resume), ("status", _status), ("show", _show),
    ):  # fmt: skip
        app.command(command, name=name)
    try:
        command, bound, _ = app.parse_args(list(tokens), exit_on_error=False, print_error=False)
        return command(*bound.args, **bound.kwargs)
    except UnusedCliTokensError as error:
        unused = " ".join(error.unused_tokens or [])
        raise StudyError(f"One file or folder is allowed, but {unused} was given as well.") from None
    except CycloptsError as error:
        raise StudyError(" ".join(str(error).split())) from None


def _study(
    config: Path | None = None, /, *, options: Annotated[Options, Parameter(name="*")] = Options()
) -> StudyCommand:
    """Simulate one ensemble, print its statistics, and store events, statistics and figures.

    The options replace what the configuration says. An existing result is never overwritten without --force.

    Parameters
    ----------
    config
        TOML file that describes the study; without it, the mass and spring of Lima and Sampaio's conference paper on
        a base that switches at random. Files that it names are relative to its folder.
    """
    if config is not None and options.print_example is not None:
        raise StudyError(
            f"{config} and --print-example {options.print_example} were both given; leave out one of them."
        )
    return StudyCommand(config, options)


def _sweep(
    config: Path | None = None,
    /,
    *,
    options: Annotated[SweepOptions, Parameter(name="*")] = SweepOptions(),
    executors: Annotated[Executors, Parameter(name="*")] = Executors(),
) -> SweepCommand:
    """Run a parameter sweep: the same ensemble at many values of its parameters.

    Every finished batch is stored in the folder. Ctrl-C stops after the batches under way, a second one at once; the
    same command goes on from there. It also adds points, samples or statistics to a sweep.

    Parameters
    ----------
    config
        TOML file that describes the sweep, with a section [sweep.over]; without it, --paper parametric-analysis.
    """
    if config is not None and options.paper is not None:
        raise StudyError(f"{config} and --paper {options.paper} were both given; leave out one of them.")
    if options.out is None and not options.print_config:
        raise StudyError("Option --out must name the folder of the sweep, but was left out.")
    return SweepCommand(config, options, executors)


def _resume(
    folder: Path, /, *, executors: Annotated[Executors, Parameter(name="*")] = Executors()
) -> ResumeCommand:  # fmt: skip
    """Go on with a parameter sweep that was stopped.

    Parameters
    ----------
    folder
        Folder of the sweep.
    """
    return ResumeCommand(folder, executors)


def _status(folder: Path, /) -> StatusCommand:
    """Say how far a parameter sweep has come, also while it runs.

    Parameters
    ----------
    folder
        Folder of the sweep.
    """
    return StatusCommand(folder)


def _show(
    folder: Path, /, *, out: Path | None = None, statistics: str | None = None, force: _Switch = False
) -> ShowCommand:
    """Print the statistics of a parameter sweep with their standard errors, and draw them, also while it runs.

    Parameters
    ----------
    folder
        Folder of the sweep.
    out
        File for the figure (PNG, PDF or SVG): curves along one parameter, curves or maps over two.
    statistics
        What to print and draw, names with commas between them (default: the statistics of totals, and derivatives).
    force
        Replace a figure that is there already.
    """
    if out is not None and out.suffix.lower() not in _FIGURES:
        raise StudyError(f"option --out must be a file that ends in {', '.join(_FIGURES)}, but {out} was given.")
    names = [] if statistics is None else [name.strip() for name in statistics.split(",")]
    return ShowCommand(folder, out, tuple(names), force)
