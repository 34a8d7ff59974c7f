"""Running a study: its ensemble is simulated, its statistics are estimated, both are stored with figures."""

import platform
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5netcdf
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from .._ensemble.call import simulate_ensemble
from .._ensemble.dataset import compression
from .._ensemble.netcdf import as_netcdf
from .._ensemble.result import Ensemble
from .._files import write_whole, writing
from .._statistics.estimate import Estimate
from .._statistics.first_sticks import FirstSticks, first_stick
from .._statistics.totals import STATISTICS
from .._status import Ending
from ._config import FileConfig, PointConfig, RunConfig, StudyConfig
from ._errors import StudyError
from ._figures import draw_figures
from ._folder import CONFIG, DATA, RESULT_FILES, SUMMARY, result_folder


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
        progress: Whether to show a progress bar, as in `simulate_ensemble`.

    Returns:
        The study and its result.

    Raises:
        StudyError: For an output directory that holds a result or cannot be written, for a dtype other than the one
            JAX is set to, and for what `simulate_ensemble` refuses.
        OSError: If writing fails.
    """
    _check_dtype(config.run)
    directory = Path(config.output.directory).expanduser()
    with result_folder(directory, force=force) as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "stickslip_jax runs in float32")  # as the configuration asks
        ensemble = simulate(config, progress)
        statistics = {name: estimate(ensemble) for name, estimate in STATISTICS.items()}
        first = _first_sticks(config, ensemble)
        with writing(directory):
            _write(folder, config, ensemble, statistics, first)
        files = tuple(name for name in RESULT_FILES if (folder / name).exists())
    return StoredStudy(config, ensemble, statistics, first, directory, files)


def _write(
    folder: Path, config: StudyConfig, ensemble: Ensemble, statistics: Mapping[str, Estimate], first: FirstSticks | None
) -> None:
    """Write all files of the result into a folder."""
    write_netcdf(folder / DATA, config, ensemble, statistics, first)
    (folder / CONFIG).write_text(config.to_toml(), encoding="utf-8")
    if ensemble.accumulator is not None:
        (folder / SUMMARY).write_text(f"{ensemble.summary()}\n", encoding="utf-8")
    if config.output.figures:
        draw_figures(config, ensemble, first, folder)


def simulate(config: StudyConfig, progress: bool | None = None) -> Ensemble:
    """Simulate the ensemble that `config` describes.

    Raises StudyError for records that are unsuitable or cannot be read, and for arguments that `simulate_ensemble`
    refuses, before anything is simulated.
    """
    run, arguments = config.run, arguments_of(config, config.run)
    try:
        return simulate_ensemble(
            **arguments, keep=run.keep, threads=run.threads, chunk=run.chunk, progress=progress
        )  # fmt: skip
    except ValueError as error:
        raise StudyError(in_words_of_the_file(str(error))) from error


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
    }


def built(section: Any, name: str) -> Any:
    """The object that `section` describes, for the simulation. Raises StudyError if it cannot be built."""
    try:
        return section.build()
    except (ValueError, OSError) as error:
        said = re.sub(r"\AArguments? (path\b)?", lambda found: "file" if found[1] else "", str(error))
        raise StudyError(f"in [{name}], {said}") from error


def _first_sticks(config: StudyConfig, ensemble: Ensemble) -> FirstSticks | None:
    if ensemble.flat_sticks is None or not config.run.maps_first_sticks:
        return None
    return first_stick(ensemble, count_initial_rest=config.run.count_initial_rest)


_NAMES = {
    "base": "[base]",
    "force": "[system.force]",
    "keep": "keep in [run]",
    "law": "[base]",
    "samples": "samples in [run]",
    "step": "step in [run]",
    "t1": "t1 in [run]",
}


def in_words_of_the_file(said: str) -> str:
    """A message of `simulate_ensemble` with the names of its arguments replaced by sections and keys of the file."""
    said = re.sub(r"\AArguments? (\w+)", lambda found: _NAMES.get(found[1], found[1]), said)
    return said.replace("use method=Exact(solver=diffrax.Dopri8())", 'set solver = "Dopri8" in [run]')


def _check_dtype(run: RunConfig) -> None:
    if str(jnp.result_type(float)) != run.dtype:
        wanted = run.dtype == "float64"
        raise StudyError(
            f"dtype {run.dtype} in [run] needs jax.config.update('jax_enable_x64', {wanted}) before anything else."
        )


# --- the data set


def write_netcdf(
    path: Path,
    config: StudyConfig,
    ensemble: Ensemble,
    statistics: Mapping[str, Estimate],
    first_sticks: FirstSticks | None,
) -> None:
    """Write the data set of a study to `path`, a NetCDF 4 file.

    Histograms and all else of ``ensemble.statistics.to_xarray()`` are in the group ``statistics``. `load` makes the
    ensemble of the file again. Raises OSError if the file cannot be written.
    """
    dataset = _dataset_of(config, ensemble, statistics, first_sticks)
    groups = {} if ensemble.accumulator is None else {"statistics": ensemble.statistics.to_xarray()}
    write_whole(path, as_netcdf(dataset, compression(dataset), groups))


def _dataset_of(
    config: StudyConfig, ensemble: Ensemble, statistics: Mapping[str, Estimate], first_sticks: FirstSticks | None
) -> xr.Dataset:
    """An ``xarray.Dataset`` of the ensemble (``ensemble.to_xarray()``) and of the statistics.

    `first_sticks` become variables along ``sample``, ``first_stick_<column>``, NaN where there is none. Each statistic
    is a variable, its standard error another, ``<name>_standard_error``. All have ``units`` and ``long_name``; the
    attributes say what was simulated, by which versions, and how many samples did not finish.
    """
    dataset = ensemble.to_xarray()
    for name, estimate in statistics.items():
        error = f"{name}_standard_error"
        about = {"long_name": estimate.name, "units": estimate.unit, "ancillary_variables": error}
        dataset[name] = ((), estimate.value, about)
        about = {"long_name": f"standard error of the {estimate.name}", "units": estimate.unit}
        dataset[error] = ((), estimate.standard_error, about)
    if first_sticks is not None:
        for name, column in _first_stick_columns(first_sticks).items():
            dataset[f"first_stick_{name}"] = column
    dataset.attrs.update({"title": "Ensemble of stick-slip motions", **_provenance(config)})
    return dataset


def _first_stick_columns(first: FirstSticks) -> dict[str, tuple[str, np.ndarray, dict[str, object]]]:
    endings = {"flag_values": [-1, *map(int, Ending)], "flag_meanings": " ".join(["NONE", *Ending.__members__])}
    return {
        "start": ("sample", first.start, {"long_name": "time at which the first stick starts", "units": "s"}),
        "duration": ("sample", first.duration, {"long_name": "duration of the first stick", "units": "s"}),
        "angle": ("sample", first.position, {"long_name": "motor angle during the first stick", "units": "rad"}),
        "ending": ("sample", first.ending, {"long_name": "why the first stick ended", "units": "1", **endings}),
    }


def _provenance(config: StudyConfig) -> dict[str, object]:
    """Attributes that say how the numbers were computed, besides those of the ensemble; parameters are called
    ``<section>_<key>``.

    Units are those of the configuration, which is an attribute itself.
    """
    attributes: dict[str, object] = {
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
        attributes |= _flat(section, getattr(config, section).model_dump(exclude_none=True))
    return attributes


def _flat(name: str, value: object) -> dict[str, object]:
    """`value` as an attribute called `name`, a table as attributes called ``<name>_<key>``; True as 1, False as 0.

    A list that holds lists or tables is a table by number.
    """
    if isinstance(value, list) and any(isinstance(part, (list, dict)) for part in value):
        value = dict(enumerate(value))
    if isinstance(value, dict):
        return {key: entry for part in value for key, entry in _flat(f"{name}_{part}", value[part]).items()}
    return {name: int(value) if isinstance(value, bool) else value}
