"""Slips between the sticks of many samples; sticks and slips as columns of tables and as labelled arrays."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .._foundation.extras import Entries, flags, require, variable
from .._foundation.files import file_for_user, file_to_write
from .._foundation.types import Ending
from .._systems.system import Coordinate
from .sticks import QUANTITIES, FlatSticks

if TYPE_CHECKING:
    import pandas


# The slips of many samples: what lies between their sticks.


class FlatSlips(NamedTuple):
    """The slips of many samples one after the other, in order of sample, then time; arrays (slips,).

    - `sample`: the sample of each slip. `start`, `end`: s. `censored`: whether the horizon cuts it.
    """

    sample: Int[np.ndarray, " slips"]
    start: Float[np.ndarray, " slips"]
    end: Float[np.ndarray, " slips"]
    censored: Bool[np.ndarray, " slips"]

    @property
    def duration(self) -> Float[np.ndarray, " slips"]:
        """How long each slip lasts, s."""
        return self.end - self.start

    @property
    def order(self) -> Int[np.ndarray, " slips"]:
        """The order of each slip within its sample, from 1."""
        first = np.flatnonzero(np.diff(self.sample, prepend=-1))
        return np.arange(len(self.sample)) - np.repeat(first, np.diff(first, append=len(self.sample))) + 1


def slips_after(sticks: FlatSticks, t1: float) -> tuple[Float[np.ndarray, " sticks"], Float[np.ndarray, " sticks"]]:
    """Start and duration (s) of the slip after each stick, the last one up to `t1`; NaN where there is none."""
    end, next_start = np.asarray(sticks.end, np.float64), np.append(sticks.start[1:], 0.0)
    last = (sticks.first + sticks.count - 1)[sticks.count > 0]
    next_start[last] = sticks.start.dtype.type(t1)
    start = np.where((sticks.ending == Ending.HORIZON) | (next_start <= end), np.nan, end)
    return start, next_start - start


def slips_among(sticks: FlatSticks, t1: float, finished: Bool[np.ndarray, " samples"] | None = None) -> FlatSlips:
    """The slips on ``[0, t1]`` (s) of all samples that have `finished`; None: of all samples.

    One before the first stick of a sample unless this begins at t = 0, one between two sticks unless they touch, one
    after the last unless the horizon cuts that. `sticks` holds none of samples that have not finished.
    """
    owner, has = sticks.sample, sticks.count > 0
    is_first, is_last = np.diff(owner, prepend=-1) != 0, np.diff(owner, append=-1) != 0
    horizon = sticks.start.dtype.type(t1)
    before = np.where(is_first, 0, np.roll(sticks.end, 1))
    leads = ~(is_first & (sticks.start == 0)) & ~sticks.touches
    trails = is_last & (sticks.ending != Ending.HORIZON)
    empty = np.flatnonzero(~has if finished is None else finished & ~has)
    none = np.zeros(len(empty))
    sample = np.concatenate([owner[leads], owner[trails], empty])
    start = np.concatenate([before[leads], sticks.end[trails], none]).astype(sticks.start.dtype)
    end = np.concatenate([sticks.start[leads], np.full(trails.sum(), horizon), none + horizon])
    censored = np.repeat([False, True, True], [leads.sum(), trails.sum(), len(empty)])
    order = np.lexsort((start, sample))
    return FlatSlips(sample[order], start[order], end.astype(sticks.start.dtype)[order], censored[order])


# Sticks as columns of a table and as labelled arrays, and tables in files: of one trajectory and of many alike.


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
