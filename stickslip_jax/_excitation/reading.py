"""Readers of recorded motions: tables of numbers (CSV) and accelerograms of the PEER NGA database (AT2)."""

import csv
import math
import os
import re
from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from .._foundation import checks
from .recorded import GroundAcceleration, Recorded

STANDARD_GRAVITY = 9.80665
"""m/s^2 (ISO 80000-3)."""

Row: TypeAlias = tuple[int, list[str]]
"""Number of a line, counted from 1, and its entries."""

_WHOLE, _DECIMAL = r"(\d+)", r"([-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?)"
_COUNT_AND_STEP = (
    re.compile(rf"NPTS\s*[=:]\s*{_WHOLE}\s*,?\s*DT\s*[=:]\s*{_DECIMAL}"),
    re.compile(rf"^\s*{_WHOLE}\s*,?\s+{_DECIMAL}\s*,?\s+NPTS\s*,?\s*DT\b"),
)
_QUANTITY_AND_UNIT = re.compile(r"\bUNITS?\b|\bTIME[- ]+(?:HISTORY|SERIES)\b")
_IN_G = re.compile(r"(?:\bIN|\bUNITS?(?:\s+OF|\s*[:=])?)\s*\(?G(?![A-Z/*])")
_FEWEST = 50  # points: shorter records are not looked at
# Of 18 well-known strong motions all reach 1.8 m/s^2, and none ends with more than 0.03 of its largest velocity.
_IN_G_BELOW, _DRIFT, _GAP = 2.0, 0.1, 1.5
_NO_ACCELERATION = re.compile(r"VELOCITY|DISPLACEMENT")


def read_csv(
    path: str | os.PathLike[str],
    *,
    time_column: int | str = 0,
    value_column: int | str = 1,
    scale: float = 1.0,
    delimiter: str | None = ",",
    shift: bool = False,
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """Times and values of a record in a text file, one sample a line.

    The first row is a header if it has no number in either column. Blank lines, and lines that begin with ``#``, do not
    count.

    Args:
        path: Name of the file.
        time_column: Number of the column of times, counted from 0, or its name in the header row. Times must be in s.
        value_column: Number or name of the column of values.
        scale: What the values are multiplied by, for example 0.01 for cm/s^2 into m/s^2.
        delimiter: The character between columns; None for any white space.
        shift: Subtract the first time from all; without it, the first time must be 0.

    Returns:
        Times (s) and values, both (points,), float64.

    Raises:
        ValueError: For arguments outside these bounds and, with the number of the line, for a file that is empty, has
            rows of different lengths or too few columns, entries that are not finite numbers, or times that do not
            increase.
        OSError: For a file that is missing or cannot be read.
    """
    _check_column("time_column", time_column)
    _check_column("value_column", value_column)
    checks.numeric("scale", scale)
    if delimiter is not None and not (isinstance(delimiter, str) and len(delimiter) == 1 and delimiter not in '"\r\n'):
        raise checks.refused("delimiter", "be a single sign such as ';', or None for white space", delimiter)
    file, text = _read(path)
    rows: list[Row] = []
    for number, line in enumerate(text.split("\n"), 1):
        # Line by line, so that a stray quotation mark cannot swallow the rest of the file.
        try:
            cut = line.split() if delimiter is None else next(csv.reader([line], delimiter=delimiter), [])
        except csv.Error as error:
            raise _unsuitable("rows of numbers", f"line {number} of {file} is none ({error})") from None
        entries = [entry.strip() for entry in cut]
        if any(entries) and not entries[0].startswith("#"):
            rows.append((number, entries))
    if not rows:
        raise _unsuitable("a row for each sample", f"{file} is empty")
    for line, entries in rows:
        if len(entries) != len(rows[0][1]):
            expected = f"line {line} of {file} has {len(entries)} and line {rows[0][0]} has {len(rows[0][1])}"
            raise _unsuitable("the same number of columns in every row", f"{expected}; correct the shorter one")
    time = _index_of("time_column", time_column, file, rows[0])
    value = _index_of("value_column", value_column, file, rows[0])
    by_name = isinstance(time_column, str) or isinstance(value_column, str)
    if by_name or not (_is_number(rows[0][1][time]) or _is_number(rows[0][1][value])):
        rows = rows[1:]
    times, values = (_finite(file, ((line, row[column]) for line, row in rows)) for column in (time, value))
    if len(times) < 2:
        raise _unsuitable("at least 2 samples", f"{file} has {len(times)}")
    falls = np.diff(times) <= 0
    if np.any(falls):
        at = int(np.argmax(falls)) + 1
        raise _unsuitable(
            "times that increase",
            f"in line {rows[at][0]} of {file} the time {times[at]} s follows {times[at - 1]} s; sort the lines, and "
            "keep one of those with the same time",
        )
    if times[0] != 0 and not shift:
        raise _unsuitable(
            "times that begin with 0", f"the first in {file} is {times[0]} s; shift=True subtracts it from all of them"
        )
    return times - times[0], values * float(scale)


def read_recorded_csv(
    path: str | os.PathLike[str],
    *,
    time_column: int | str = 0,
    value_column: int | str = 1,
    scale: float = 1.0,
    delimiter: str | None = ",",
    shift: bool = False,
    cutoff_hz: float | None = None,
) -> Recorded:
    """A recorded base velocity (m/s) or force (N), after multiplication by `scale`.

    One sample a line; the first row is a header if it has no number in either column. Blank lines, and lines that begin
    with ``#``, do not count.

    Args:
        path: Name of the file.
        time_column: Number of the column of times, counted from 0, or its name in the header row. Times must be in s.
        value_column: Number or name of the column of base velocities or forces.
        scale: What the values are multiplied by, for example 0.001 for mm/s into m/s.
        delimiter: The character between columns; None for any white space.
        shift: Subtract the first time from all; without it, the first time must be 0.
        cutoff_hz: Smooth the record to this bandwidth (Hz), as `Recorded.smoothed` does; None leaves it as it is.

    Returns:
        The motion, linear in time between the samples and as long as the record: a base, or a `force`.

    Raises:
        ValueError: For arguments outside these bounds and, with the number of the line, for a file that is empty, has
            rows of different lengths or too few columns, entries that are not finite numbers, or times that do not
            increase.
        OSError: For a file that is missing or cannot be read.

    Warns:
        RuntimeWarning: For a noisy record that is not smoothed.
    """
    columns = {"time_column": time_column, "value_column": value_column}
    record = read_csv(path, **columns, scale=scale, delimiter=delimiter, shift=shift)
    return Recorded(*record) if cutoff_hz is None else Recorded.smoothed(*record, cutoff_hz=cutoff_hz)


def read_acceleration_csv(
    path: str | os.PathLike[str],
    *,
    time_column: int | str = 0,
    value_column: int | str = 1,
    scale: float | None = None,
    delimiter: str | None = ",",
    shift: bool = False,
) -> GroundAcceleration:
    """A recorded ground acceleration, m/s^2 after multiplication by `scale` (9.80665 for a record in g).

    One sample a line; the first row is a header if it has no number in either column. Blank lines, and lines that begin
    with ``#``, do not count.

    Args:
        path: Name of the file.
        time_column: Number of the column of times, counted from 0, or its name in the header row. Times must be in s.
        value_column: Number or name of the column of accelerations.
        scale: What the values are multiplied by, for example 0.01 for cm/s^2 into m/s^2. By default 1, with a warning
            where they look like those of a record in g.
        delimiter: The character between columns; None for any white space.
        shift: Subtract the first time from all; without it, the first time must be 0.

    Returns:
        The ground motion, linear in time between the samples and as long as the record: a base for `simulate`.

    Raises:
        ValueError: For arguments outside these bounds and, with the number of the line, for a file that is empty, has
            rows of different lengths or too few columns, entries that are not finite numbers, or times that do not
            increase.
        OSError: For a file that is missing or cannot be read.

    Warns:
        RuntimeWarning: For a record whose values look like g, whose velocity drifts, or with gaps.
    """
    how = {"time_column": time_column, "value_column": value_column, "delimiter": delimiter, "shift": shift}
    times, values = read_csv(path, **how, scale=1.0 if scale is None else scale)
    return _looked_at(GroundAcceleration(times, values), path, is_stated=scale is not None)


def read_at2(path: str | os.PathLike[str], *, g: float = STANDARD_GRAVITY) -> GroundAcceleration:
    """A ground acceleration from an AT2 file of the PEER NGA database, in m/s^2.

    The header states that the record is an acceleration in units of g; its last line gives the number of samples and
    the time between them (s), as ``NPTS= 5372, DT= .0050 SEC`` or ``5372 0.0050 NPTS, DT``. The samples follow, any
    number a line.

    Args:
        path: Name of the file.
        g: m/s^2 in one unit of the file.

    Raises:
        ValueError: For a `g` that is not positive, and for a file that is empty, has no such header, holds another
            quantity or unit, another number of samples, or an entry that is not a finite number (with its line).
        OSError: For a file that is missing or cannot be read.

    Warns:
        RuntimeWarning: For a record whose velocity drifts.
    """
    checks.positive("g", g, "m/s^2")
    file, text = _read(path)
    if not text.strip():
        raise _unsuitable("an accelerogram", f"{file} is empty")
    lines = text.split("\n")
    ends = ((n, line, pattern.search(line.upper())) for n, line in enumerate(lines, 1) for pattern in _COUNT_AND_STEP)
    last, line, found = next((end for end in ends if end[2]), (0, "", None))
    if found is None:
        raise _unsuitable(
            "a header that ends with NPTS and DT, such as 'NPTS= 5372, DT= .0050 SEC'",
            f"{file} has no such line; read_acceleration_csv reads tables of times and values",
        )
    count, step = int(found[1]), float(found[2])
    if count < 2 or not 0 < step < math.inf:
        raise _unsuitable(
            "NPTS of at least 2 and a positive DT", f"line {last} of {file} is {checks.show(line.strip())}"
        )
    # The last line of the header about quantity and unit states an acceleration in g.
    stated = [line.strip() for line in lines[:last] if _QUANTITY_AND_UNIT.search(line.upper())]
    if not stated:
        raise _unsuitable(
            "an acceleration in units of g",
            f"the header of {file} names no unit; if it is g, add the line 'ACCELERATION TIME SERIES IN UNITS OF G'",
        )
    if _NO_ACCELERATION.search(stated[-1].upper()) or not _IN_G.search(stated[-1].upper()):
        raise _unsuitable(
            "an acceleration in units of g",
            f"the header of {file} says {checks.show(stated[-1])}; take the AT2 file of the same record",
        )
    entries = ((number, entry) for number, line in enumerate(lines[last:], last + 1) for entry in line.split())
    values = _finite(file, entries)
    if len(values) != count:
        raise _unsuitable(
            f"as many samples as its header says, NPTS = {count}", f"{file} holds {len(values)}; get a whole copy of it"
        )
    return _looked_at(GroundAcceleration(np.arange(count) * step, values * float(g)), path, is_stated=True)


def _looked_at(record: GroundAcceleration, path: object, *, is_stated: bool) -> GroundAcceleration:
    """The record, with a warning of what looks wrong in it; `is_stated`: whether its unit is known to be m/s^2."""
    times, values = np.asarray(record.times), np.asarray(record.accelerations)
    if len(times) < _FEWEST:
        return record
    steps, peak, found = np.diff(times), float(np.max(np.abs(values))), []
    velocity = np.cumsum(steps * (values[1:] + values[:-1]) / 2)
    fastest = float(np.max(np.abs(velocity)))
    if not is_stated and 0 < peak < _IN_G_BELOW:
        found.append(
            f"its largest acceleration is {peak:.3g} m/s^2, or is it in g? Give scale={STANDARD_GRAVITY} for g, or "
            "scale=1.0 for m/s^2"
        )
    if abs(velocity[-1]) > _DRIFT * fastest:
        found.append(
            f"the ground ends with a velocity of {velocity[-1]:.3g} m/s, of at most {fastest:.3g} m/s in the record; "
            "correct its baseline, or cut it where it is quiet"
        )
    if np.max(steps) > _GAP * np.median(steps):
        at = int(np.argmax(steps))
        found.append(
            f"its points are {np.median(steps):.4g} s apart, but {times[at]:.6g} s and {times[at + 1]:.6g} s are not; "
            "between them it is taken for a straight line"
        )
    for what in found:
        checks.warn(f"The record {checks.show(str(path))} looks odd: {what}.")
    return record


def _read(name: object) -> tuple[str, str]:
    """The name of the file, as messages show it, and its text."""
    path = checks.path("path", name, "the name of a file")
    shown = repr(str(path))  # whole: a name that is cut cannot be looked for
    try:
        # Old headers hold names in old encodings: an unreadable character matters only where a number should be.
        return shown, path.read_text(encoding="utf-8-sig", errors="replace")
    except FileNotFoundError:
        raise FileNotFoundError(
            f"Argument path must be the name of a file that exists, but {shown} was given; the folder looked in "
            f"is {str(path.absolute().parent)!r}."
        ) from None
    except OSError as error:
        raise type(error)(
            f"Argument path must be the name of a file that can be read, but {shown} was given ({error.strerror})."
        ) from None


def _check_column(name: str, column: object) -> None:
    counts = isinstance(column, (int, np.integer)) and not isinstance(column, bool) and column >= 0
    if not isinstance(column, str) and not counts:
        raise checks.refused(name, "be the number of a column, counted from 0, or its name in the header row", column)


def _index_of(argument: str, column: int | str, file: str, first_row: Row) -> int:
    line, entries = first_row
    if isinstance(column, str):
        if entries.count(column) != 1:
            raise ValueError(
                f"Argument {argument} must be the name of one of the columns {checks.show(entries)} of {file}, or its "
                f"number counted from 0, but {column!r} was given."
            )
        return entries.index(column)
    if column >= len(entries):
        raise ValueError(
            f"Argument {argument} must be the number of a column of {file}, from 0 to {len(entries) - 1}, but {column} "
            f"was given; if line {line} has more, give the sign between them as delimiter."
        )
    return int(column)


def _is_number(entry: str) -> bool:
    try:
        float(entry)
    except ValueError:
        return False
    return "_" not in entry  # Python reads 1_000 as a number


def _finite(file: str, entries: Iterable[tuple[int, str]]) -> Float[np.ndarray, " points"]:
    """The entries as numbers."""
    numbers = []
    for line, entry in entries:
        number = float(entry) if _is_number(entry) else math.nan
        if not math.isfinite(number):
            raise _unsuitable(
                "finite numbers only", f"line {line} of {file} has the entry {checks.show(entry)}; correct it"
            )
        numbers.append(number)
    return np.array(numbers, float)


def _unsuitable(wanted: str, found: str) -> ValueError:
    return ValueError(f"Argument path must name a file with {wanted}, but {found}.")
