"""Running what a file describes: one ensemble, stored and drawn with its statistics, or a parameter sweep; and telling
of both as text.
"""

import asyncio
import dataclasses
import json
import math
import os
import platform
import re
import shutil
import signal
import tempfile
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import h5netcdf
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from .._dynamics.simulate import simulate
from .._dynamics.simulation import Simulation
from .._ensemble.conversions import compression
from .._ensemble.encoding import as_netcdf
from .._ensemble.ensemble import Ensemble, simulate_ensemble
from .._excitation.motion import SourceVoltage
from .._foundation.files import write_whole, writing
from .._foundation.types import Ending, Status
from .._statistics.estimate import Estimate, format_with_error
from .._statistics.quantities import FirstSticks, first_stick
from .._statistics.totals import STATISTICS
from .._sweep.dataset import SweepStatus, point_dimensions, shown_statistics, statistics_of_points
from .._sweep.store import DATA as SWEEP_DATA
from .._sweep.sweep import Sweep
from .._systems.system import unphased
from . import StudyError
from ._config import FileConfig, PointConfig, StudyConfig, SweepConfig
from ._reading import ExecutorOptions
from ._sections import nearest

if TYPE_CHECKING:
    import distributed

# The folder of a result: no file is overwritten without --force, and no result is left incomplete.


DATA = "study.nc"
CONFIG = "study.toml"
SUMMARY = "summary.txt"
TIME_HISTORY = "time_history.png"
PHASE_PORTRAIT = "phase_portrait.png"
STICK_DURATIONS = "stick_durations.png"
DURATION_AND_POSITION = "duration_and_position.png"
RESULT_FILES = (CONFIG, SUMMARY, TIME_HISTORY, PHASE_PORTRAIT, STICK_DURATIONS, DURATION_AND_POSITION, DATA)
"""The files of a result, in the order in which they are put in place; the data come last and mark it complete."""


@contextmanager
def result_folder(directory: Path, *, force: bool = False) -> Iterator[Path]:
    """A temporary folder to write `RESULT_FILES` into, which become the result in `directory` if the block succeeds.

    The files are moved to `directory` together at the end. With `force` they replace an older result, at the end and
    not before. Other files in `directory` stay. If the block fails or is interrupted, everything is as it was before.

    Raises StudyError, before the block runs, if `directory` holds a result and `force` is False, or cannot be written.
    """
    _refuse_to_overwrite(directory, force)
    made: list[Path] = []  # what did not exist before
    try:
        try:
            for folder in reversed([directory, *directory.parents]):
                if not folder.exists():
                    folder.mkdir()
                    made.append(folder)
            staging = Path(tempfile.mkdtemp(prefix=".unfinished-", dir=directory))
        except NotADirectoryError:
            raise StudyError(f"{directory} cannot hold a result, because it is, or lies below, a file.") from None
        except (OSError, ValueError) as error:  # ValueError: not even a path, because it holds a null character
            reason = getattr(error, "strerror", None) or error
            raise StudyError(f"{directory} cannot be written ({reason}); choose another folder.") from None
        try:
            yield staging
            with _uninterrupted():
                _refuse_to_overwrite(directory, force)  # another run may have finished meanwhile
                _publish(staging, directory)
        finally:
            with _uninterrupted():
                shutil.rmtree(staging, ignore_errors=True)
    except BaseException:
        for folder in reversed(made):
            with suppress(OSError):  # others may have put something there
                folder.rmdir()
        raise


def _refuse_to_overwrite(directory: Path, force: bool) -> None:
    found = [name for name in RESULT_FILES if os.path.lexists(directory / name)]
    if found and not force:
        raise StudyError(
            f"{directory} holds a result already ({found[-1]}); choose another folder with --out, or replace it with "
            "--force."
        )


def _publish(staging: Path, directory: Path) -> None:
    """Move the old files aside and the new ones into place; if that fails, move all of them back."""
    aside = staging / "replaced"
    aside.mkdir()
    moves = [(directory / name, aside / name) for name in reversed(RESULT_FILES)]
    moves += [(staging / name, directory / name) for name in RESULT_FILES]
    moved: list[tuple[Path, Path]] = []
    try:
        for source, target in moves:
            if os.path.lexists(source):
                source.replace(target)
                moved.append((source, target))
    except BaseException:
        for source, target in reversed(moved):
            target.replace(source)
        raise


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Ignore Ctrl-C for the few milliseconds that moving or removing files takes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if usual is None else usual)


# The figures of a study, drawn by `stickslip_jax.plot`.


_PERIODS_SHOWN = 16  # of the free oscillation: more could not be distinguished
_VOLTAGE_PERIODS_SHOWN = 6


def draw_figures(config: StudyConfig, ensemble: Ensemble, first_sticks: FirstSticks | None, folder: Path) -> None:
    """Draw the beginning of sample 0 and, unless only totals were kept, the sticks of all samples, as PNG files.

    - `first_sticks`: of every sample of a `MotorCart`; else None.
    - `folder`: where to write the files, which are called as in `RESULT_FILES`.
    """
    from .. import plot  # noqa: PLC0415 - slow to load, and not wanted with --no-figures

    one = beginning_of_sample_0(config, ensemble)
    if int(one.status) == Status.FINISHED:
        part = f", first {float(one.t1):.3g} s of {config.run.t1:g} s" if float(one.t1) < config.run.t1 else ""
        title = f"Sample 0{part}"
        plot.save(plot.time_history(one), folder / TIME_HISTORY, title=title)
        plot.save(plot.phase_portrait(one), folder / PHASE_PORTRAIT, title=title)
    if ensemble.accumulator is None:
        return
    samples = f"{ensemble.samples} samples"
    plot.save(plot.histogram(ensemble), folder / STICK_DURATIONS, title=f"Stick durations in {samples}")
    if first_sticks is None:
        whose, axes = "sticks", plot.joint_histogram(ensemble.statistics.joint("duration", "position"))
    else:
        # The bound of stick durations is known in closed form for a voltage.
        bound: Any = ensemble.law if isinstance(unphased(ensemble.law), SourceVoltage) else None
        whose, axes = "first sticks", plot.stick_map(first_sticks, system=ensemble.system, bound=bound)
    plot.save(axes, folder / DURATION_AND_POSITION, title=f"Duration and position of {whose} in {samples}")


def beginning_of_sample_0(config: StudyConfig, ensemble: Ensemble) -> Simulation:
    """Sample 0 of the ensemble with all its events, from 0 to a time whose oscillations a figure can tell apart."""
    frequency = ensemble.system.natural_frequency
    if frequency is None or not np.all(np.asarray(frequency) > 0):
        shown = _VOLTAGE_PERIODS_SHOWN * float(getattr(unphased(ensemble.law), "shortest_period", math.inf))
    else:
        shown = _PERIODS_SHOWN * 2 * math.pi / float(frequency)
    t1 = min(ensemble.t1, shown)
    method = dataclasses.replace(config.run.method(config.system.has_inner_states), max_steps=None)
    for covered in (t1, 2 * t1, 4 * t1):
        # A base motion drawn for a shorter time begins in the same way: the beginning is enough, if it covers t1.
        system, base, y0 = dataclasses.replace(ensemble, t1=covered).realization(0)
        one = simulate(system, base, t1=t1, y0=y0, method=method)
        if int(one.status) != Status.BASE_TOO_SHORT:
            break
    return one


# Running a study: its ensemble is simulated, its statistics are estimated, both are stored with figures.


@dataclass(frozen=True)
class StoredStudy:
    """A study that was run and stored.

    Attributes:
        config: Its description.
        ensemble: What was simulated.
        statistics: By their names.
        first_sticks: Of every sample of a `MotorCart`, if the sticks were kept; else None.
        directory: The folder of the result.
        files: The names of the files in it.
    """

    config: StudyConfig
    ensemble: Ensemble
    statistics: Mapping[str, Estimate]
    first_sticks: FirstSticks | None
    directory: Path
    files: tuple[str, ...]


def run_study(config: StudyConfig, *, force: bool = False, progress: bool | None = None) -> StoredStudy:
    """Simulate one ensemble and store the result in its output directory. If it fails, nothing is left behind.

    Args:
        config: The description of the study.
        force: Whether to replace a result that is there already, once the new one is complete.
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.

    Returns:
        The study and its result.

    Raises:
        StudyError: For an output directory that holds a result or cannot be written, for a dtype other than the one
            JAX is set to, and for what `simulate_ensemble` refuses.
        OSError: If writing fails.
    """
    run = config.run
    if str(jnp.result_type(float)) != run.dtype:
        wanted = run.dtype == "float64"
        raise StudyError(
            f"dtype {run.dtype} in [run] needs jax.config.update('jax_enable_x64', {wanted}) before anything else."
        )
    directory = Path(config.output.directory).expanduser()
    with result_folder(directory, force=force) as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "stickslip_jax runs in float32")  # as the configuration asks
        arguments = arguments_of(config, run) | {"keep": run.keep, "threads": run.threads, "chunk": run.chunk}
        try:
            ensemble = simulate_ensemble(**arguments, progress=progress)
        except ValueError as error:
            raise StudyError(in_words_of_the_file(error, _OF_AN_ENSEMBLE)) from error
        statistics = {name: estimate(ensemble) for name, estimate in STATISTICS.items()}
        first = None
        # Their durations and positions are compared with the bound that is known for a voltage.
        if ensemble.flat_sticks is not None and config.system.driven_by_voltage:
            first = first_stick(ensemble, count_initial_rest=run.count_initial_rest)
        with writing(directory):
            write_netcdf(folder / DATA, config, ensemble, statistics, first)
            (folder / CONFIG).write_text(config.to_toml(), encoding="utf-8")
            if ensemble.accumulator is not None:
                (folder / SUMMARY).write_text(f"{ensemble.summary()}\n", encoding="utf-8")
            if config.output.figures:
                draw_figures(config, ensemble, first, folder)
        files = tuple(name for name in RESULT_FILES if (folder / name).exists())
    return StoredStudy(config, ensemble, statistics, first, directory, files)


def arguments_of(config: FileConfig, run: PointConfig) -> dict[str, Any]:
    """The arguments that `simulate_ensemble` and `Sweep` have in common. Raises StudyError as `built`."""
    return {
        "system": built(config.system, "system"),
        "law": built(config.base, "base"),
        "t1": run.t1,
        "samples": run.samples,
        "key": jax.random.key(run.seed),
        "y0": run.y0(),
        "method": run.method(config.system.has_inner_states),
        "orders": run.orders,
        "count_initial_rest": run.count_initial_rest,
        "outputs": run.outputs,
    }


def built(section: Any, name: str) -> Any:
    """The object that `section` describes, for the simulation. Raises StudyError if it cannot be built."""
    try:
        return section.build()
    except (ValueError, OSError) as error:
        raise StudyError(f"in [{name}], {in_words_of_the_file(error, _OF_A_FILE)}") from error


_NO_ARGUMENT = r"\AArguments? ", ""
_OF_A_FILE = [(r"\AArguments? path\b", "file"), _NO_ARGUMENT]
_OF_AN_ENSEMBLE = [
    (r"\AArguments? (base|law)\b", "[base]"),
    (r"\AArguments? force\b", "[system.force]"),
    (r"\AArguments? (keep|samples|step|t1)\b", r"\1 in [run]"),
    _NO_ARGUMENT,
    (r"use method=Exact\(solver=diffrax\.Dopri8\(\)\)", 'set solver = "Dopri8" in [run]'),
]
_OF_A_SWEEP = [
    (r"(\bfriction(\.\w+)?)\.law\.", r"\1.slip."),
    # Of parameters that change together there are several.
    (r"\AArgument over\[\(?'(.+?)'\)?\] ", lambda found: found[1].replace("', '", ", ") + " in [sweep.over] "),
    (r"\AArgument over ", "[sweep.over] "),
    (
        r"\AArgument sensitivities must hold .*?, with a statistic",
        "sensitivities in [sweep] must hold lists of parameters by statistic",
    ),
    (r"\AArgument (keep|statistics|standard_error|realizations|batch)\b(\['\w+'\])?", r"\1\2 in [sweep]"),
    *_OF_AN_ENSEMBLE,
]
"""What stands in place of the names of arguments in messages, by regular expressions, in their order."""
_LISTING = r".*? (?:names? out of|must name one of|statistic out of) (.*), but (.*) was given\."


def in_words_of_the_file(error: Exception, words: list[tuple[str, Any]]) -> str:
    """A message with the names of arguments replaced by sections and keys of the file."""
    said = str(error)
    for pattern, replacement in words:
        said = re.sub(pattern, replacement, said)
    return said


# --- the data set


def write_netcdf(
    path: Path,
    config: StudyConfig,
    ensemble: Ensemble,
    statistics: Mapping[str, Estimate],
    first_sticks: FirstSticks | None,
) -> None:
    """Write the data set of a study to `path`, a NetCDF 4 file of the ensemble (``ensemble.to_xarray()``) and them.

    `first_sticks` become variables along ``sample``, ``first_stick_<column>``, NaN where there is none. Each statistic
    is a variable, its standard error another, ``<name>_standard_error``. All have ``units`` and ``long_name``; the
    attributes say what was simulated, by which versions, and how many samples did not finish: parameters are called
    ``<section>_<key>``, in the units of the configuration, which is an attribute itself.

    Histograms and all else of ``ensemble.statistics.to_xarray()`` are in the group ``statistics``. `load` makes the
    ensemble of the file again. Raises OSError if the file cannot be written.
    """
    dataset = ensemble.to_xarray()
    for name, estimate in statistics.items():
        error = f"{name}_standard_error"
        about = {"long_name": estimate.name, "units": estimate.unit, "ancillary_variables": error}
        dataset[name] = ((), estimate.value, about)
        about = {"long_name": f"standard error of the {estimate.name}", "units": estimate.unit}
        dataset[error] = ((), estimate.standard_error, about)
    if first_sticks is not None:
        endings = {"flag_values": [-1, *map(int, Ending)], "flag_meanings": " ".join(["NONE", *Ending.__members__])}
        for name, values, long_name, units, more in (
            ("start", first_sticks.start, "time at which the first stick starts", "s", {}),
            ("duration", first_sticks.duration, "duration of the first stick", "s", {}),
            ("angle", first_sticks.position, "motor angle during the first stick", "rad", {}),
            ("ending", first_sticks.ending, "why the first stick ended", "1", endings),
        ):
            dataset[f"first_stick_{name}"] = ("sample", values, {"long_name": long_name, "units": units, **more})
    dataset.attrs |= {
        "title": "Ensemble of stick-slip motions",
        "jax_version": jax.__version__,
        "numpy_version": np.__version__,
        "python_version": platform.python_version(),
        "xarray_version": xr.__version__,
        "h5netcdf_version": h5netcdf.__version__,
        "platform": platform.platform(),
        "device": str(jax.devices()[0].device_kind),
        "date_created": datetime.now(UTC).isoformat(timespec="seconds"),
        "configuration": config.to_toml(),
    }
    for section in ("system", "base", "run"):
        dataset.attrs |= _flat(section, getattr(config, section).model_dump(exclude_none=True))
    groups = {} if ensemble.accumulator is None else {"statistics": ensemble.statistics.to_xarray()}
    write_whole(path, as_netcdf(dataset, compression(dataset), groups))


def _flat(name: str, value: object) -> dict[str, object]:
    """`value` as an attribute called `name`, a table as attributes called ``<name>_<key>``; True as 1, False as 0.

    A list that holds lists or tables is a table by number.
    """
    if isinstance(value, list) and any(isinstance(part, (list, dict)) for part in value):
        value = dict(enumerate(value))
    if isinstance(value, dict):
        return {key: entry for part in value for key, entry in _flat(f"{name}_{part}", value[part]).items()}
    return {name: int(value) if isinstance(value, bool) else value}


# The result of a study as text: a table for people, JSON for programs.


def table(study: StoredStudy) -> str:
    """A table of the statistics with units and standard errors, then samples finished, time taken, and files."""
    run, ensemble = study.config.run, study.ensemble
    samples, grazing = ensemble.samples, ensemble.near_grazing_samples
    rows = [("statistic", "value", "standard error", "unit")]
    for one in study.statistics.values():
        value, error = "not defined", ""
        if not math.isnan(one.value):
            value, error = format_with_error(one.value, one.standard_error).split(" +- ")
        rows.append((one.name, value, error, one.unit))
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    lines = [
        f"{run.samples} samples of {study.config.system.title}, {study.config.base.title}, on [0, {run.t1:g}] s "
        f"({run.dtype}, seed {run.seed})",
        "",
        *(f"{a:<{widths[0]}}  {b:>{widths[1]}}  {c:>{widths[2]}}  {d}" for a, b, c, d in rows),
        "",
    ]
    lines += _endings(ensemble.status_counts) or [f"All {samples} samples reached t1."]
    if ensemble.keep == "totals" and not run.count_initial_rest:
        lines.append('With keep = "totals" sticks that begin at t = 0 count in all numbers.')
    if ensemble.key_data is None and samples > 1:
        lines.append(f"Nothing is random here: all {samples} samples are the same.")
    if grazing:
        lines.append(f"Near-grazing: {grazing} of {samples} samples, in which round-off decides about an event.")
    if study.first_sticks is not None:
        rest = "" if run.count_initial_rest else ", rest at t = 0 not counted"
        lines.append(f"A first stick was found in {study.first_sticks.count} of {samples} samples{rest}.")
    if run.dtype == "float32":
        lines.append("In float32 event times are accurate to about 2e-6 of t1.")
    lines += [
        f"Time: {ensemble.compile_seconds:.3g} s to compile, {ensemble.run_seconds:.3g} s to run "
        f"on {ensemble.threads} thread{'s' if ensemble.threads > 1 else ''}.",
        f"Files in {study.directory}: {', '.join(study.files)}",
    ]
    return "\n".join(lines)


def as_json(study: StoredStudy) -> str:
    """One JSON object: statistics by name, samples not finished, times, files. Undefined numbers are null."""
    ensemble = study.ensemble
    content: dict[str, object] = {
        name: {
            "value": one.value if math.isfinite(one.value) else None,
            "standard_error": one.standard_error if math.isfinite(one.standard_error) else None,
            "unit": one.unit,
            "samples": one.samples,
        }
        for name, one in study.statistics.items()
    }
    content["samples"] = ensemble.samples
    content["not_finished"] = {status.name: count for status, count in _not_finished(ensemble.status_counts).items()}
    content["near_grazing_samples"] = ensemble.near_grazing_samples
    if study.first_sticks is not None:
        content["first_sticks"] = study.first_sticks.count
    content["seconds"] = {"compile": ensemble.compile_seconds, "run": ensemble.run_seconds}
    content["files"] = [str(study.directory / name) for name in study.files]
    return json.dumps(content, indent=2, allow_nan=False)


def _not_finished(counts: Mapping[Status, int]) -> dict[Status, int]:
    return {status: count for status, count in counts.items() if status is not Status.FINISHED and count}


def _endings(counts: Mapping[Status, int]) -> list[str]:
    """A line for each reason why samples did not finish; `counts`: of all samples, by how they ended."""
    samples = sum(counts.values())
    return [
        f"NOT FINISHED: {count:,} of {samples:,} samples, because {status.meaning}; they enter no statistic."
        for status, count in _not_finished(counts).items()
    ]


# A parameter sweep: made from its file, run, resumed.


_SECONDS_TO_CONNECT = 10


def sweep_of(config: SweepConfig, source: str = "") -> Sweep:
    """The sweep that `config` describes. Raises StudyError, beginning with `source`, for what does not fit."""
    run, sweep = config.run, config.sweep
    over: dict[str | tuple[str, ...], np.ndarray] = {}
    # Initial values, and the slips of `Ageing`, have other names in `Sweep`.
    starts = {name: f"y0[{number}]" for number, name in enumerate(run.initial)}
    for names, values in sweep.over.parameter_values().items():
        renamed = [starts.get(name) or re.sub(r"\Ainitial_state\[", "y0[", name) for name in names]
        full = tuple(re.sub(r"\bslip\.", "law.", name) for name in renamed)
        over[full if len(full) > 1 else "".join(full)] = values
    try:
        return Sweep(
            **arguments_of(config, run),
            **sweep.model_dump(exclude={"over", "sensitivities"}),
            over=over,
            sensitivities=[(name, tuple(wrt)) for name, wrt in (sweep.sensitivities or {}).items()],
        )
    except StudyError as error:
        raise StudyError(f"{source}{error}") from error
    except ValueError as error:
        said = in_words_of_the_file(error, _OF_A_SWEEP)
        # A message that lists the names allowed goes on with the one that was probably meant.
        if found := re.fullmatch(_LISTING, said):
            given = (re.findall(r"[\w.]+", found[2]) or [""])[0]
            said = said.removesuffix(".") + (nearest(given, re.findall(r"\w+", found[1]), cutoff=0.5) or ".")
        raise StudyError(source + said) from error


def run_stored(sweep: Sweep, folder: Path, where: ExecutorOptions) -> None:
    """Run what is left of a sweep in `folder`, and print its result.

    Raises SweepError as `Sweep.run` does, and StudyError where no scheduler answers at the address ``where.dask``.
    """
    with nullcontext() if where.dask is None else _client(where.dask) as client, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "This sweep runs in float32")  # as its file asks
        progress = False if where.quiet else where.progress
        dataset = sweep.run(folder, threads=where.threads, workers=where.workers, executor=client, progress=progress)
    if not where.quiet:
        print(sweep_table(dataset, chosen_statistics(dataset)))
        print(f"The result is in {folder / SWEEP_DATA}; `stickslip show {folder} --out FIGURE.png` draws it.")


@contextmanager
def _client(address: str) -> "Iterator[distributed.Client]":
    """A client of the dask scheduler at `address`. Raises StudyError if there is none."""
    if find_spec("distributed") is None:
        raise StudyError("Option --dask needs distributed: pip install 'stickslip_jax[cluster]'.")
    kind, _, _ = address.rpartition("://")
    if kind not in ("", "tcp", "ws"):
        raise StudyError(
            f"Option --dask must be the address of a dask scheduler, such as tcp://127.0.0.1:8786, but {address} was "
            f"given; {kind}:// needs a client with settings of its own: in Python, sweep.run(executor=client) takes it."
        )
    from distributed import Client  # noqa: PLC0415 - an extra, loaded when asked for

    try:
        # Asked first: the client itself waits for ever where something listens that is no scheduler.
        asyncio.run(asyncio.wait_for(_identity(address), _SECONDS_TO_CONNECT))
        client = Client(address, timeout=_SECONDS_TO_CONNECT)
    except Exception as error:  # whatever speaks there may answer anything
        reason = " ".join(str(error).split()) or f"none within {_SECONDS_TO_CONNECT} s"
        raise StudyError(
            f"Option --dask must be the address of a dask scheduler, such as tcp://127.0.0.1:8786, but {address} gave "
            f"no answer ({reason}); start one with `dask scheduler`."
        ) from None
    with client:
        yield client


async def _identity(address: str) -> None:
    """Ask the scheduler at `address` what it is. Raises ValueError for something else that speaks there."""
    from distributed import rpc  # noqa: PLC0415 - an extra, loaded when asked for

    async with rpc(address) as scheduler:
        found = await scheduler.identity() or {}
    if "Scheduler" not in str(found["type"]):
        raise ValueError(f"a {found['type']} is there")


# A parameter sweep as text: how far it has come, and a table of its statistics.


_HEAD_WIDTH = 16
_MOST_ROWS = 60  # of a table in a terminal


def status_text(folder: Path, status: SweepStatus) -> str:
    """What ``stickslip status`` prints."""
    wanted = f"{'at most ' if status.is_adaptive else ''}{status.most_samples:,}"
    running = "running now" if status.is_running else "finished" if status.is_finished else "not running"
    lines = [
        f"{folder}: {status.complete} of {status.points} points done, {status.samples:,} of {wanted} samples; "
        f"{running}.",
        *_endings(status.endings),
        f"Time spent simulating: {status.seconds:.3g} s, summed over threads.",
    ]
    if status.seconds_left is not None:
        minutes, seconds = divmod(round(status.seconds_left), 60)
        lines.append(f"Time left at this pace: about {f'{minutes:,} min ' if minutes else ''}{seconds} s.")
    if status.is_finished:
        lines.append(f"`stickslip show {folder}` prints the result.")
    elif not status.is_running:
        lines.append(f"`stickslip resume {folder}` goes on from here.")
    return "\n".join(lines)


def chosen_statistics(dataset: xr.Dataset, names: Sequence[str] = ()) -> list[str]:
    """The names of the variables to show: `names`, or, of none, all statistics of totals and derivatives.

    Raises StudyError for a name that is no statistic with an error at each point.
    """
    if not names:
        return shown_statistics(dataset)
    known = statistics_of_points(dataset)
    for name in names:
        if name not in known:
            allowed, hint = ", ".join(known), nearest(name, known) or "."
            raise StudyError(f"option --statistics must name some of {allowed}, but {name} was given{hint}")
    return list(names)


def sweep_table(dataset: xr.Dataset, names: Sequence[str]) -> str:
    """A table of the statistics called `names` at all points with standard errors, and what is to be known of them."""
    counts = np.asarray(dataset["samples"]).reshape(-1)
    heads, columns = _coordinates(dataset)
    is_even = counts.min() == counts.max()
    if not is_even:
        heads.append("samples")
        columns.append([f"{count:,}" for count in counts])
    for name in names:
        heads.append(_with_unit(dataset[name].attrs["long_name"], dataset[name]))
        values, errors = (np.asarray(dataset[one]).reshape(-1) for one in (name, f"{name}_error"))
        pairs = zip(values, errors, strict=True)
        columns.append(["-" if math.isnan(value) else format_with_error(value, error) for value, error in pairs])
    classes = [json.loads(dataset.attrs[name]) for name in ("system", "law")]
    titles = [one["fields"]["name"] if one["class"] == "Unknown" else one["class"] for one in classes]
    every = f", {counts[0]:,} samples each" if is_even else ""
    ending = {one: int(np.sum(dataset.get(f"samples_{one.name.lower()}", 0))) for one in Status}
    spent, left = float(np.nansum(dataset["run_seconds"])), len(counts) - _MOST_ROWS
    return "\n".join(
        [
            f"{', '.join(titles)}, on [0, {dataset.attrs['t1']:g}] s ({dataset.attrs['dtype']}): "
            f"{len(counts)} points{every}",
            "",
            *_rows(heads, [column[:_MOST_ROWS] for column in columns], dataset),
            *([] if left <= 0 else [f"and {left:,} more points: ss.Sweep.load(folder).results has all of them"]),
            "",
            *_endings(ending),
            f"Each with its standard error. Time spent simulating: {spent:.3g} s, summed over threads.",
        ]
    )


def _coordinates(dataset: xr.Dataset) -> tuple[list[str], list[list[str]]]:
    """Heads and columns of the parameters at each point."""
    dimensions = point_dimensions(dataset)
    heads, columns = [], []
    for dimension in dimensions:
        of_it = [name for name, one in dataset.coords.items() if one.dims == (dimension,) and name != dimension]
        for name in of_it or [dimension]:
            values = dataset[name].broadcast_like(dataset["samples"]).transpose(*dimensions).values.reshape(-1)
            heads.append(_with_unit(str(name), dataset[name]))
            columns.append([f"{value:.6g}" for value in values])
    return heads, columns


def _with_unit(name: str, variable: xr.DataArray) -> str:
    unit = variable.attrs.get("units", "1")
    return name if unit == "1" else f"{name} ({unit})"


def _rows(heads: list[str], columns: list[list[str]], dataset: xr.Dataset) -> Iterator[str]:
    """The lines of the table; a gap where the first of several dimensions goes on."""
    wrapped = [wrap(head, _HEAD_WIDTH) for head in heads]
    height = max(map(len, wrapped))
    wrapped = [[""] * (height - len(head)) + head for head in wrapped]
    widths = [max(map(len, [*head, *column])) for head, column in zip(wrapped, columns, strict=True)]
    block = math.prod(dataset["samples"].shape[1:])
    for number, row in enumerate([*zip(*wrapped, strict=True), *zip(*columns, strict=True)], -height):
        if number >= 0 and block > 1 and number % block == 0:
            yield ""
        yield "  ".join(f"{entry:>{width}}" for entry, width in zip(row, widths, strict=True)).rstrip()
