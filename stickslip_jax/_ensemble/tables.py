"""Files of sticks as tables, one row for each stick."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from .. import _checks
from .._events.sticks import FURTHER
from .._statistics.registry import STICK_QUANTITIES
from .._status import Ending

_WRITERS = {".csv": "to_csv", ".parquet": "to_parquet"}


def write_sticks(ensemble: Any, path: str | os.PathLike[str]) -> Path:
    """Write every stick of `ensemble` to `path`, in the format of its file extension; see `Ensemble.write_sticks`."""
    if not isinstance(path, (str, os.PathLike)):
        raise ValueError(f"Argument path must be a file name, but {_checks.show(path)} was given.")
    sticks, path = ensemble.require_sticks(), Path(path)
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise ValueError(f"Argument path must end in {' or '.join(_WRITERS)}, but {str(path)!r} was given.")
    try:
        import pandas as pd  # noqa: PLC0415 - an extra, loaded when asked for
    except ImportError:
        raise ImportError("Tables of sticks need pandas: pip install 'stickslip_jax[tables]'.") from None
    position = ensemble.system.stick_position.unit
    units = {one.name: one.unit for one in STICK_QUANTITIES} | {name: one.unit for name, one in FURTHER.items()}
    columns = {
        "sample": sticks.sample,
        "order": ensemble.numbering.order_of(sticks),
        "start_s": sticks.start,
        "end_s": sticks.end,
    }
    for name, own in units.items():
        unit = own or position
        columns[name if unit == "1" else f"{name}_{unit}"] = getattr(sticks, name)
    columns["is_initial_rest"] = sticks.start == 0
    columns["ending"] = np.array([ending.name for ending in Ending])[sticks.ending]
    table = pd.DataFrame(columns)
    try:
        getattr(table, writer)(path, index=False)
    except ImportError:
        raise ImportError("Parquet files need pyarrow: pip install 'stickslip_jax[tables]'.") from None
    return path
