"""The commands of parameter sweeps: ``sweep``, ``resume``, ``status`` and ``show``."""

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ._options import Executors, ResumeCommand, ShowCommand, StatusCommand, SweepCommand

if TYPE_CHECKING:
    import xarray

    from .._sweep.sweep import Sweep

_Prepare = Callable[[str], None]
"""Sets the precision of JAX, "float64" or "float32", before it starts."""


def run_command(command: SweepCommand | ResumeCommand | StatusCommand | ShowCommand, prepare: _Prepare) -> None:
    """Run a command, and print what it has to say. Raises StudyError for what the user can correct."""
    with warnings.catch_warnings():
        warnings.filterwarnings("always", "The sweep asks for")
        warnings.showwarning = _tell
        if isinstance(command, SweepCommand):
            _sweep(command, prepare)
        elif isinstance(command, ResumeCommand):
            _resume(command, prepare)
        elif isinstance(command, StatusCommand):
            _status(command.folder)
        else:
            _show(command, prepare)


def _tell(message: Warning | str, *_: Any, **__: Any) -> None:
    """A warning as the sentence that it is."""
    print("stickslip:", message, file=sys.stderr)


def _sweep(command: SweepCommand, prepare: _Prepare) -> None:
    from ._reading import read_sweep_config  # noqa: PLC0415 - what only a simulation needs is loaded when there is one

    options = command.options
    config = read_sweep_config(command.config, {"samples": options.samples}, paper=options.paper)
    if options.print_config:
        print(config.to_toml(), end="")
        return
    prepare(config.run.dtype)
    from ._sweep_run import sweep_of  # noqa: PLC0415

    assert options.out is not None  # as the options are checked
    sweep = sweep_of(config, "" if command.config is None else f"{command.config}: ")
    _run(sweep, options.out.expanduser(), command.executors)


def _resume(command: ResumeCommand, prepare: _Prepare) -> None:
    from .._sweep.store import Store  # noqa: PLC0415
    from .._sweep.sweep import Sweep  # noqa: PLC0415

    prepare(Store.reading(command.folder).body["deciding"]["dtype"])
    _run(Sweep.load(command.folder), command.folder, command.executors)


def _run(sweep: "Sweep", folder: Path, executors: Executors) -> None:
    from .._sweep.store import DATA  # noqa: PLC0415
    from ._sweep_run import run_stored  # noqa: PLC0415

    dataset = run_stored(
        sweep, folder, threads=executors.threads, workers=executors.workers, dask=executors.dask,
        progress=False if executors.quiet else executors.progress,
    )  # fmt: skip
    if not executors.quiet:
        _print_table(dataset)
        print(f"The result is in {folder / DATA}; `stickslip show {folder} --out FIGURE.png` draws it.")


def _status(folder: Path) -> None:
    from .._sweep.looking import status_of  # noqa: PLC0415
    from ._sweep_report import status_text  # noqa: PLC0415

    print(status_text(folder, status_of(folder)))


def _show(command: ShowCommand, prepare: _Prepare) -> None:
    from .._sweep.looking import stored_dataset  # noqa: PLC0415
    from .._sweep.store import Store  # noqa: PLC0415

    prepare(Store.reading(command.folder).body["deciding"]["dtype"])
    if command.out is not None:
        _check_figure(command.out, command.force)
    dataset = stored_dataset(command.folder)
    names = _print_table(dataset, command.statistics)
    if command.out is not None:
        _draw(dataset, names, command.out, command.force)
        print(f"The figure is in {command.out}.")


def _print_table(dataset: "xarray.Dataset", wanted: tuple[str, ...] = ()) -> list[str]:
    from ._sweep_report import chosen_statistics, sweep_table  # noqa: PLC0415

    names = chosen_statistics(dataset, wanted)
    print(sweep_table(dataset, names))
    return names


def _draw(dataset: "xarray.Dataset", names: list[str], path: Path, force: bool) -> None:
    from .. import plot  # noqa: PLC0415 - slow to load
    from ._errors import StudyError  # noqa: PLC0415

    if len(dataset["samples"].dims) > 2:
        raise StudyError(
            f"option --out draws sweeps of one or two parameters, but this one has {len(dataset['samples'].dims)} "
            "dimensions; in Python, plot.parameter_sweep(results.isel(...), names) draws a part of it."
        )
    plot.save(plot.parameter_sweep(dataset, names), path, overwrite=force)


def _check_figure(path: Path, force: bool) -> None:
    """Raise StudyError where no figure can be written."""
    from .._files import file_to_write  # noqa: PLC0415
    from ._errors import StudyError  # noqa: PLC0415

    try:
        file_to_write(path, overwrite=force)
    except (ValueError, OSError) as error:
        said = str(error).replace("Argument path", "option --out").replace("overwrite=True", "--force")
        raise StudyError(said) from None
