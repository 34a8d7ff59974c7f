"""Files of sticks and of slips as tables, one row for each."""

import os
from pathlib import Path

import numpy as np

from .._events.stick_quantities import QUANTITIES
from .._files import file_for_user, file_to_write
from .._statistics.quantities import STICK_QUANTITIES
from .._status import Ending
from .data import EnsembleData
from .origins import known_inputs
from .slips import flat_slips


def write_sticks(ensemble: EnsembleData, path: str | os.PathLike[str], overwrite: bool = False) -> Path:
    """Write every stick of `ensemble` to `path`, in the format of its file extension; see `Ensemble.write_sticks`."""
    sticks = ensemble.require_sticks()
    position = ensemble.system.stick_position.unit
    units = {one.name: one.unit for one in STICK_QUANTITIES} | {name: one.unit for name, one in QUANTITIES.items()}
    columns = {
        "sample": sticks.sample,
        "order": ensemble.numbering.order_of(sticks),
        "start_s": sticks.start,
        "end_s": sticks.end,
    }
    for name, own in units.items():
        unit = own or position
        columns[name if unit == "1" else f"{name}_{unit}"] = getattr(sticks, name)
    columns |= {name: values[sticks.sample] for name, (values, _) in known_inputs(ensemble).items()}
    columns["is_initial_rest"] = sticks.start == 0
    columns["ending"] = np.array([ending.name for ending in Ending])[sticks.ending]
    return _write(columns, path, overwrite)


def write_slips(ensemble: EnsembleData, path: str | os.PathLike[str], overwrite: bool = False) -> Path:
    """Write every slip of `ensemble` to `path`, in the format of its file extension; see `Ensemble.write_slips`."""
    slips = flat_slips(ensemble)
    times = {"start_s": slips.start, "end_s": slips.end, "duration_s": slips.end - slips.start}
    return _write({"sample": slips.sample, **times, "is_censored": slips.censored}, path, overwrite)


def _write(columns: dict[str, np.ndarray], path: str | os.PathLike[str], overwrite: bool) -> Path:
    """Write the columns to `path`. Raises the errors of `Ensemble.write_sticks`."""
    path = file_to_write(path, (".csv", ".parquet"), overwrite=overwrite)
    try:
        import pandas as pd  # noqa: PLC0415 - an extra, loaded when asked for
    except ImportError:
        raise ImportError("Tables need pandas: pip install 'stickslip_jax[tables]'.") from None
    table = pd.DataFrame(columns)
    try:
        with file_for_user(path) as file:
            if path.suffix.lower() == ".csv":
                table.to_csv(file, index=False, mode="wb")
            else:
                table.to_parquet(file, engine="pyarrow", index=False, write_page_checksum=True)
    except ImportError:
        raise ImportError("Parquet files need pyarrow: pip install 'stickslip_jax[tables]'.") from None
    return path
