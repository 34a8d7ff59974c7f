"""Sticks as columns of a table and as labelled arrays, and tables in files: of one trajectory and of many alike."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._conventions import Entries, flags, variable
from .._extras import require
from .._files import file_for_user, file_to_write
from .._status import Ending
from .._systems.system import Coordinate
from .stick_quantities import QUANTITIES
from .sticks import FlatSticks

if TYPE_CHECKING:
    import pandas

Columns = dict[str, np.ndarray]
"""Columns of a table by name; the names include the units."""


def time_columns(start: np.ndarray, end: np.ndarray) -> Columns:
    """When sticks or slips begin and end, and how long they last."""
    return {"start_s": start, "end_s": end, "duration_s": end - start}


def stick_columns(
    sticks: FlatSticks, order: np.ndarray, position: Coordinate, further: Columns | None = None
) -> Columns:
    """The columns of `sticks`, one row each, with the `order` of each in its sample.

    `position`: what the position of a stick is. `further`: what comes before how they began and ended.
    """
    columns = {"order": order, **time_columns(sticks.start, sticks.end)}
    units = {"position": None, **{name: one.unit for name, one in QUANTITIES.items()}}
    for name, own in units.items():
        unit = own or position.unit
        columns[name if unit == "1" else f"{name}_{unit}"] = getattr(sticks, name)
    columns |= further or {}
    columns["is_initial_rest"] = sticks.start == 0
    columns["ending"] = np.array([ending.name for ending in Ending])[sticks.ending]
    return columns


def stick_variables(sticks: FlatSticks, order: np.ndarray, position: Coordinate) -> Entries:
    """The variables of `sticks` along ``stick``, with the `order` of each in its sample."""
    further = {
        f"stick_{name}": variable("stick", getattr(sticks, name), one.label, one.unit or position.unit)
        for name, one in QUANTITIES.items()
    }
    folded = {} if position.period is None else {"period": position.period}
    about = "number of the stick in its sample, from 1; 0: begins at t = 0 and is not numbered (count_initial_rest)"
    return {
        "stick_order": variable("stick", order, about),
        "stick_start": variable("stick", sticks.start, "time at which the stick starts", "s"),
        "stick_end": variable("stick", sticks.end, "time at which the stick ends", "s"),
        "stick_position": variable("stick", sticks.position, position.name, position.unit, **folded),
        **further,
        "stick_ending": variable("stick", sticks.ending, "why the stick ended", **flags(Ending)),
    }


def slip_variables(start: np.ndarray, end: np.ndarray, censored: np.ndarray) -> Entries:
    """The variables of slips along ``slip``."""
    meanings = {"flag_values": [0, 1], "flag_meanings": "COMPLETE HORIZON"}
    return {
        "slip_start": variable("slip", start, "time at which the slip starts", "s"),
        "slip_end": variable("slip", end, "time at which the slip ends", "s"),
        "slip_ending": variable("slip", censored.astype(np.int8), "whether the horizon cuts the slip", **meanings),
    }


def table_of(columns: Columns) -> "pandas.DataFrame":
    """The columns as a table of pandas. Raises ImportError without the extra ``tables``."""
    require("Tables need", "tables", "pandas")
    import pandas as pd  # noqa: PLC0415 - an extra, loaded when asked for

    return pd.DataFrame(columns)


def write_table(columns: Columns, path: str | os.PathLike[str], overwrite: bool) -> Path:
    """Write the columns to `path`, in the format of its ending. Raises the errors of `Ensemble.write_sticks`."""
    path = file_to_write(path, (".csv", ".parquet"), overwrite=overwrite)
    is_csv = path.suffix.lower() == ".csv"
    if not is_csv:
        require("Parquet files need", "tables", "pandas", "pyarrow")
    table = table_of(columns)
    with file_for_user(path) as file:
        if is_csv:
            table.to_csv(file, index=False, mode="wb")
        else:
            table.to_parquet(file, engine="pyarrow", index=False, write_page_checksum=True)
    return path
