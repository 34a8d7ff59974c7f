"""Files of sticks and of slips of an ensemble as tables, one row for each."""

import os
from pathlib import Path

from .._events.tables import stick_columns, time_columns, write_table
from .data import EnsembleData
from .origins import known_inputs
from .slips import flat_slips


def write_sticks(ensemble: EnsembleData, path: str | os.PathLike[str], overwrite: bool = False) -> Path:
    """Write every stick of `ensemble` to `path`, in the format of its file extension; see `Ensemble.write_sticks`."""
    sticks = ensemble.require_sticks()
    inputs = {name: values[sticks.sample] for name, (values, _) in known_inputs(ensemble).items()}
    order, position = ensemble.numbering.order_of(sticks), ensemble.system.stick_position
    columns = {"sample": sticks.sample, **stick_columns(sticks, order, position, inputs)}
    return write_table(columns, path, overwrite)


def write_slips(ensemble: EnsembleData, path: str | os.PathLike[str], overwrite: bool = False) -> Path:
    """Write every slip of `ensemble` to `path`, in the format of its file extension; see `Ensemble.write_slips`."""
    slips = flat_slips(ensemble)
    columns = {"sample": slips.sample, **time_columns(slips.start, slips.end), "is_censored": slips.censored}
    return write_table(columns, path, overwrite)
