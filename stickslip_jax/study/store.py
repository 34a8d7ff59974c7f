"""A study as one labelled data set: every stick, each sample's totals, the statistics, and where they come from."""

import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5netcdf
import jax
import numpy as np
import xarray as xr

from .. import __version__
from .._status import Status
from ..ensemble_result import Ensemble
from ..statistics.estimates import Estimate
from .config import StudyConfig


def write_netcdf(path: Path, config: StudyConfig, ensemble: Ensemble, statistics: Mapping[str, Estimate]) -> None:
    """Write the data set of a study to `path`, a NetCDF 4 file. Raises OSError if that fails."""
    dataset_of_study(config, ensemble, statistics).to_netcdf(path, engine="h5netcdf")


def dataset_of_study(config: StudyConfig, ensemble: Ensemble, statistics: Mapping[str, Estimate]) -> Any:
    """An ``xarray.Dataset``: what ``ensemble.to_xarray()`` gives (if the sticks were kept) and the statistics.

    Each statistic is a variable, its standard error another, ``<name>_standard_error``, both with ``units`` and
    ``long_name``; the attributes say what was simulated, by which versions, and how many samples did not finish.
    """
    dataset = xr.Dataset() if ensemble.flat_sticks is None else ensemble.to_xarray()
    for name, estimate in statistics.items():
        error = f"{name}_standard_error"
        about = {"long_name": estimate.name, "units": estimate.unit, "ancillary_variables": error}
        dataset[name] = ((), estimate.value, about)
        about = {"long_name": f"standard error of the {estimate.name}", "units": estimate.unit}
        dataset[error] = ((), estimate.standard_error, about)
    dataset.attrs.update({"title": "Ensemble of stick-slip motions", **_provenance(config, ensemble)})
    return dataset


def _provenance(config: StudyConfig, ensemble: Ensemble) -> dict[str, Any]:
    """How the numbers came about; parameters are named ``<section>_<key>``, in the units of ``configuration``."""
    attributes: dict[str, Any] = {
        "source": f"stickslip_jax {__version__}",
        "stickslip_jax_version": __version__,
        "jax_version": jax.__version__,
        "numpy_version": np.__version__,
        "python_version": platform.python_version(),
        "xarray_version": xr.__version__,
        "h5netcdf_version": h5netcdf.__version__,
        "platform": platform.platform(),
        "device": str(jax.devices()[0].device_kind),
        "date_created": datetime.now(UTC).isoformat(timespec="seconds"),
        "configuration": config.to_toml(),
        "samples_finished": ensemble.finished,
        "compile_seconds": ensemble.compile_seconds,
        "run_seconds": ensemble.run_seconds,
        "threads_used": ensemble.threads,
    }
    for status in Status:
        if status is not Status.FINISHED:
            attributes[f"samples_{status.name.lower()}"] = ensemble.status_counts[status]
    if ensemble.key_words is not None:
        attributes["key_words"] = np.array(ensemble.key_words, np.uint32)
    for section in ("system", "base", "run"):
        for key, value in getattr(config, section).model_dump(exclude_none=True).items():
            attributes[f"{section}_{key}"] = value
    return attributes
