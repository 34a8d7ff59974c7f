"""A study as one labelled data set: every stick, the totals of each sample, the statistics, and their provenance."""

import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import h5netcdf
import jax
import numpy as np
import xarray as xr

from .._ensemble.dataset import compression
from .._ensemble.netcdf import as_netcdf
from .._ensemble.result import Ensemble
from .._files import write_whole
from .._statistics.estimate import Estimate
from .._statistics.first_sticks import FirstSticks
from .._status import Ending
from ._config import StudyConfig


def write_netcdf(
    path: Path,
    config: StudyConfig,
    ensemble: Ensemble,
    statistics: Mapping[str, Estimate],
    first_sticks: FirstSticks | None = None,
) -> None:
    """Write the data set of a study to `path`, a NetCDF 4 file.

    Histograms and all else of ``ensemble.statistics.to_xarray()`` are in the group ``statistics``. `load` makes the
    ensemble of the file again. Raises OSError if the file cannot be written.
    """
    dataset = dataset_of_study(config, ensemble, statistics, first_sticks)
    groups = {} if ensemble.accumulator is None else {"statistics": ensemble.statistics.to_xarray()}
    write_whole(path, as_netcdf(dataset, compression(dataset), groups))


def dataset_of_study(
    config: StudyConfig,
    ensemble: Ensemble,
    statistics: Mapping[str, Estimate],
    first_sticks: FirstSticks | None = None,
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
    """`value` as an attribute called `name`, a table as attributes called ``<name>_<key>``; True as 1, False as 0."""
    if isinstance(value, dict):
        return {key: entry for part in value for key, entry in _flat(f"{name}_{part}", value[part]).items()}
    return {name: int(value) if isinstance(value, bool) else value}
