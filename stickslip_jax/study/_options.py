"""The options of the ``stickslip`` command."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError

from .. import __version__
from .._sweep.errors import StudyError


def _whole_number(kind: type, tokens: Sequence[Any]) -> int:
    """Read a whole number; cyclopts alone would round 2.7 to 3."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f'"{tokens[0].value}" is not a whole number.') from None


_Whole = Annotated[int | None, Parameter(converter=_whole_number)]
Example = Literal["harmonic-base", "base-isolation", "motor-cart"]
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
class Command:
    """The arguments of ``stickslip study``: the configuration file, if any, and the options."""

    config: Path | None
    options: Options


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
    app.command(_study, name="study")
    try:
        command, bound, _ = app.parse_args(list(tokens), exit_on_error=False, print_error=False)
    except UnusedCliTokensError as error:
        unused = " ".join(error.unused_tokens or [])
        raise StudyError(f"One configuration file is allowed, but {unused} was given as well.") from None
    except CycloptsError as error:
        raise StudyError(" ".join(str(error).split())) from None
    return command(*bound.args, **bound.kwargs)


def _study(config: Path | None = None, /, *, options: Annotated[Options, Parameter(name="*")] = Options()) -> Command:
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
    return Command(config, options)
