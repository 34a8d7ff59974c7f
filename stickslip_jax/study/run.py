"""Run a study: simulate its ensemble, estimate its statistics, and store both with figures."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp

from ..ensemble import simulate_ensemble
from ..ensemble_result import Ensemble
from ..statistics.estimates import (
    Estimate,
    mean_slip_count,
    mean_slip_duration,
    mean_stick_count,
    mean_stick_duration,
    stick_fraction,
)
from .config import RunConfig, StudyConfig
from .errors import StudyError
from .figures import draw_figures
from .folder import CONFIG, DATA, RESULT_FILES, result_folder
from .store import write_netcdf

STATISTICS = {
    "stick_fraction": stick_fraction,
    "mean_stick_count": mean_stick_count,
    "mean_slip_count": mean_slip_count,
    "mean_stick_duration": mean_stick_duration,
    "mean_slip_duration": mean_slip_duration,
}
"""What a study estimates; the names are those of the variables in its file."""


@dataclass(frozen=True)
class Study:
    """A study that has been run and stored: its statistics by name, and the files in `directory`."""

    config: StudyConfig
    ensemble: Ensemble
    statistics: Mapping[str, Estimate]
    directory: Path
    files: tuple[str, ...]


def run_study(config: StudyConfig, *, force: bool = False, progress: bool | None = None) -> Study:
    """Simulate the ensemble that `config` describes and store the result in its output directory.

    - `force`: replace a result that is there already, once the new one is complete.
    - `progress`: as in `simulate_ensemble`.

    On any failure nothing is left behind. Raises StudyError for an output directory that holds a result or cannot be
    written, a dtype that JAX is not set to, and arguments that `simulate_ensemble` refuses; OSError if writing fails.
    """
    _check_dtype(config.run)
    directory = Path(config.output.directory).expanduser()
    with result_folder(directory, force=force) as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "stickslip_jax runs in float32")  # as the configuration asks
        ensemble = simulate(config, progress)
        statistics = {name: estimate(ensemble) for name, estimate in STATISTICS.items()}
        write_netcdf(folder / DATA, config, ensemble, statistics)
        (folder / CONFIG).write_text(config.to_toml(), encoding="utf-8")
        if config.output.figures:
            draw_figures(config, ensemble, folder)
        files = tuple(name for name in RESULT_FILES if (folder / name).exists())
    return Study(config, ensemble, statistics, directory, files)


def simulate(config: StudyConfig, progress: bool | None = None) -> Ensemble:
    """The ensemble that `config` describes. Raises StudyError for arguments that `simulate_ensemble` refuses."""
    run = config.run
    try:
        return simulate_ensemble(
            config.system.build(),
            config.base.build(),
            t1=run.t1,
            samples=run.samples,
            key=jax.random.key(run.seed),
            y0=(run.initial_position, run.initial_velocity),
            keep=run.keep,
            threads=run.threads,
            chunk=run.chunk,
            progress=progress,
        )
    except ValueError as error:
        raise StudyError(str(error).removeprefix("Argument ")) from error


def _check_dtype(run: RunConfig) -> None:
    if str(jnp.result_type(float)) != run.dtype:
        wanted = run.dtype == "float64"
        raise StudyError(
            f"dtype {run.dtype} in [run] needs jax.config.update('jax_enable_x64', {wanted}) before anything else."
        )
