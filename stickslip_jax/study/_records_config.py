"""Records in a study: signals at given times, given in the configuration or read from a file."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from .._excitation.ground import GroundAcceleration
from .._excitation.reading import STANDARD_GRAVITY, read_at2, read_csv
from .._excitation.recorded import Recorded
from ._sections import Section, shown_value, toml_value

_WHITE_SPACE = "whitespace"


def _existing(file: str, info: Any) -> str:
    """The absolute path of `file`, which is relative to the folder of the configuration."""
    folder = Path((info.context or {}).get("folder", "."))
    try:
        path = folder.joinpath(Path(file).expanduser()).absolute()
    except RuntimeError:  # ~ of a user who has no home
        path = folder.joinpath(file).absolute()
    if not path.is_file():
        raise ValueError(
            f"file must be the name of a file that exists, but {toml_value(file)} was given; the folder looked in is "
            f"{path.parent}."
        )
    return str(path)


def _column(value: object, info: Any) -> int | str:
    if isinstance(value, str) or (isinstance(value, int) and not isinstance(value, bool) and value >= 0):
        return value
    raise ValueError(
        f"{info.field_name} must be the number of a column, counted from 0, or its name in quotation marks, but "
        f"{shown_value(value)} was given."
    )


def _delimiter(value: str) -> str:
    if value != _WHITE_SPACE and (len(value) != 1 or value in '"\r\n'):
        raise ValueError(
            f'delimiter must be a single character or "{_WHITE_SPACE}", but {shown_value(value)} was given.'
        )
    return value


_File = Annotated[str, AfterValidator(_existing)]
_Column = Annotated[object, AfterValidator(_column)]
_TABLE_ONLY = ("time_column", "value_column", "delimiter", "shift")
"""Keys that only tables have."""


class _FromFile(Section):
    """Keys that say how to read a file; None leaves the choice to the reader."""

    time_column: _Column | None = Field(
        default=None, description="the times' column: its number, counted from 0, or name; not given: 0"
    )
    value_column: _Column | None = Field(default=None, description="the values' column, likewise; not given: 1")
    delimiter: Annotated[str, AfterValidator(_delimiter)] | None = Field(
        default=None, description=f'character between columns, or "{_WHITE_SPACE}"; not given: a comma'
    )
    shift: bool | None = Field(
        default=None, description="whether to subtract the first time from all; not given: false"
    )
    scale: float | None = Field(default=None, description="what the values in the file are multiplied by; not given: 1")

    def _refuse(self, keys: Iterable[str], reason: str) -> None:
        for key in keys:
            if getattr(self, key) is not None:
                raise ValueError(f"{key} must be left out, but {shown_value(getattr(self, key))} was given: {reason}.")

    def _read(self, file: str) -> tuple[np.ndarray, np.ndarray]:
        """Times (s) and values of the table. Raises ValueError if they are unsuitable, OSError if it cannot be read."""
        chosen = {key: getattr(self, key) for key in (*_TABLE_ONLY, "scale") if getattr(self, key) is not None}
        if self.delimiter == _WHITE_SPACE:
            chosen["delimiter"] = None
        return read_csv(file, **chosen)


class RecordedConfig(_FromFile):
    """A recorded signal: ``file``, or ``times`` and ``values``."""

    law: Literal["Recorded"]
    file: _File | None = Field(default=None, description="table (CSV) with a row for each time; or times and values")
    times: list[float] | None = Field(default=None, description="s, increasing; the first is 0")
    values: list[float] | None = Field(default=None, description="m/s for a base velocity, N for a force")

    @model_validator(mode="after")
    def _one_source(self) -> "RecordedConfig":
        inline = self.times is not None and self.values is not None
        if (self.file is None) != inline or (self.times is None) != (self.values is None):
            raise ValueError("a Recorded needs either file, or times and values.")
        if inline:
            self._refuse((*_TABLE_ONLY, "scale"), "it says how to read a file, and none is given")
            self.build()
        return self

    def build(self) -> Recorded:
        """The signal for the simulation.

        Raises ValueError for an unsuitable record, OSError for a file that cannot be read.
        """
        return Recorded(self.times, self.values) if self.file is None else Recorded(*self._read(self.file))


class GroundAccelerationConfig(_FromFile):
    """Section ``[base]`` with a recorded ground acceleration: an AT2 file, or a table (CSV)."""

    law: Literal["GroundAcceleration"]
    file: _File = Field(description="AT2 file of the PEER NGA database, or table (CSV) of times in s and m/s^2")
    scale: float | None = Field(
        default=None, description=f"factor of the accelerations ({STANDARD_GRAVITY} for a table in g); not given: 1"
    )

    @model_validator(mode="after")
    def _keys_fit(self) -> "GroundAccelerationConfig":
        if self._is_at2:
            self._refuse(_TABLE_ONLY, "it says how to read a table, and the file is an AT2 file")
        return self

    @property
    def _is_at2(self) -> bool:
        return Path(self.file).suffix.lower() == ".at2"

    def build(self) -> GroundAcceleration:
        """The ground motion for the simulation.

        Raises ValueError for an unsuitable record, OSError for a file that cannot be read.
        """
        if not self._is_at2:
            return GroundAcceleration(*self._read(self.file))
        record = read_at2(self.file)
        return record if self.scale is None else GroundAcceleration(record.times, self.scale * record.accelerations)
