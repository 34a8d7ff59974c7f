"""The commands of ``stickslip``: ``study`` for one ensemble; ``sweep``, ``resume``, ``status`` and ``show`` for many;
``explore`` for a page with sliders.

What only a simulation needs is imported in the functions, so that help and mistakes in options appear without it.
"""

import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import jax
from cyclopts import App, CycloptsError, UnusedCliTokensError

from .. import __version__
from .._foundation.extras import require_explorer
from .._foundation.files import file_to_write
from . import StudyError, _reading
from ._reading import FIGURES, MOST_SAMPLES, ExecutorOptions, StudyOptions, SweepOptions, Switch

_STUDY, _SWEEP, _EXECUTORS = StudyOptions(), SweepOptions(), ExecutorOptions()


def run(tokens: Sequence[str]) -> None:
    """Run the command given by `tokens`, the words of the command line.

    Args:
        tokens: Those after the name of the program.

    Raises:
        StudyError: For unknown commands and options, values of the wrong type, and mistakes in a file.
        SweepError: For a sweep that cannot run.
    """
    app = App(
        name="stickslip",
        version=__version__,
        help="Exact simulation of stick-slip (dry-friction) oscillators under random motion of their base.",
        help_formatter="plain",
    )
    for command in (study, sweep, resume, status, show, explore):
        app.command(command, name=command.__name__)
    try:
        command, bound, _ = app.parse_args(list(tokens), exit_on_error=False, print_error=False)
    except UnusedCliTokensError as error:
        unused = " ".join(error.unused_tokens or [])
        raise StudyError(f"One file or folder is allowed, but {unused} was given as well.") from None
    except CycloptsError as error:
        raise StudyError(" ".join(str(error).split())) from None
    command(*bound.args, **bound.kwargs)


def prepare_jax(dtype: str) -> None:
    """Set the precision, "float64" or "float32", before JAX starts."""
    jax.config.update("jax_enable_x64", dtype == "float64")


@contextmanager
def _warnings_as_sentences() -> Iterator[None]:
    """Print a warning as the sentence that it is, while the block or the decorated function runs."""
    with warnings.catch_warnings():
        warnings.filterwarnings("always", "The sweep asks for")
        warnings.showwarning = lambda message, *_, **__: print("stickslip:", message, file=sys.stderr)
        yield


def study(config: Path | None = None, /, *, options: StudyOptions = _STUDY) -> None:
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
    given = {name: getattr(options, name) for name in _reading.OPTIONS}
    described = _reading.read_config(config, given, example=options.print_example)
    if options.print_config or options.print_example is not None:
        print(described.to_toml(), end="")
        return
    prepare_jax(described.run.dtype)

    from ._run import as_json, run_study, table  # noqa: PLC0415

    result = run_study(described, force=options.force, progress=False if options.quiet else options.progress)
    if not options.quiet:
        print(table(result), file=sys.stderr if options.json else sys.stdout)
    if options.json:
        print(as_json(result))


@_warnings_as_sentences()
def sweep(
    config: Path | None = None, /, *, options: SweepOptions = _SWEEP, executors: ExecutorOptions = _EXECUTORS
) -> None:
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
    described = _reading.read_sweep_config(config, {"samples": options.samples}, paper=options.paper)
    if options.out is None or options.print_config:
        print(described.to_toml(), end="")
        return
    prepare_jax(described.run.dtype)
    from ._run import run_stored, sweep_of  # noqa: PLC0415

    source = "" if config is None else f"{config}: "
    run_stored(sweep_of(described, source), options.out.expanduser(), executors)


@_warnings_as_sentences()
def resume(folder: Path, /, *, executors: ExecutorOptions = _EXECUTORS) -> None:
    """Go on with a parameter sweep that was stopped.

    Parameters
    ----------
    folder
        Folder of the sweep.
    """
    from .._sweep.store import Store  # noqa: PLC0415
    from .._sweep.sweep import Sweep  # noqa: PLC0415

    prepare_jax(Store.reading(folder).dtype)
    from ._run import run_stored  # noqa: PLC0415

    run_stored(Sweep.load(folder), folder, executors)


@_warnings_as_sentences()
def status(folder: Path, /) -> None:
    """Say how far a parameter sweep has come, also while it runs.

    Parameters
    ----------
    folder
        Folder of the sweep.
    """
    from .._sweep.dataset import status_of  # noqa: PLC0415
    from ._run import status_text  # noqa: PLC0415

    print(status_text(folder, status_of(folder)))


@_warnings_as_sentences()
def show(folder: Path, /, *, out: Path | None = None, statistics: str | None = None, force: Switch = False) -> None:
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
    if out is not None:
        try:
            file_to_write(out, FIGURES, overwrite=force)
        except (ValueError, OSError) as error:
            said = str(error).replace("Argument path", "option --out").replace("overwrite=True", "--force")
            raise StudyError(said) from None
    from .._sweep.dataset import stored_dataset  # noqa: PLC0415
    from .._sweep.store import Store  # noqa: PLC0415

    prepare_jax(Store.reading(folder).dtype)
    from ._run import chosen_statistics, sweep_table  # noqa: PLC0415

    dataset = stored_dataset(folder)
    wanted = [] if statistics is None else [name.strip() for name in statistics.split(",")]
    names = chosen_statistics(dataset, wanted)
    print(sweep_table(dataset, names))
    if out is None:
        return
    from .. import plot  # noqa: PLC0415 - slow to load

    dimensions = len(dataset["samples"].dims)
    if dimensions > 2:
        raise StudyError(
            f"option --out draws sweeps of one or two parameters, but this one has {dimensions} dimensions; in Python, "
            "plot.parameter_sweep(results.isel(...), names) draws a part of it."
        )
    plot.save(plot.parameter_sweep(dataset, names), out, overwrite=force)
    print(f"The figure is in {out}.")


def explore(config: Path | None = None, /, *, samples: int = 2000, port: int = 0, browser: bool = True) -> None:
    """Show a system with sliders for its numbers in the browser of this machine; Ctrl-C ends it.

    Parameters
    ----------
    config
        TOML file of a study to begin with; without it, a mass on a spring.
    samples
        Number of realisations that are simulated whenever a slider moves.
    port
        Of the page's address; by default any that is free.
    browser
        Whether to open the page; its address is printed.
    """
    require_explorer()
    if not 0 <= port < 2**16:
        raise StudyError(f"Option --port must be from 1 to {2**16 - 1}, or 0 for any free one, but {port} was given.")
    if not 2 <= samples <= MOST_SAMPLES:
        raise StudyError(f"Option --samples must be from 2 to {MOST_SAMPLES:,}, but {samples:,} was given.")
    described = _reading.read_config(config)
    prepare_jax(described.run.dtype)
    from ._explorer_page import serve  # noqa: PLC0415
    from ._explorer_scene import scene_called, scene_of  # noqa: PLC0415

    try:
        first = scene_called("mass on a spring") if config is None else scene_of(described)
        scene = first._replace(samples=samples)
    except ValueError as error:
        raise StudyError(str(error)) from None
    with suppress(KeyboardInterrupt):  # before the server stops at Ctrl-C by itself
        serve(scene, port=port, opens=browser, say=lambda said: print(said, flush=True))
    print("The explorer has ended.")
