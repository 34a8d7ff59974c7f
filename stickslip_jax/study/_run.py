"""Running a study: its ensemble is simulated, its statistics are estimated, both are stored with figures."""

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from .._ensemble.call import simulate_ensemble
from .._ensemble.result import Ensemble
from .._files import writing
from .._statistics.estimate import Estimate
from .._statistics.first_sticks import FirstSticks, first_stick
from .._statistics.totals import STATISTICS
from ._config import FileConfig, PointConfig, RunConfig, StudyConfig
from ._errors import StudyError
from ._figures import draw_figures
from ._folder import CONFIG, DATA, RESULT_FILES, SUMMARY, result_folder
from ._store import write_netcdf


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
        "method": run.method(),
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
