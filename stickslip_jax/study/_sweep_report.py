"""Parameter sweeps as text: how far one has come, and tables of its statistics."""

import json
import math
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from .._statistics.estimate import format_with_error
from .._status import Status
from .._sweep.dataset import SweepStatus, point_dimensions, shown_statistics, statistics_of_points
from ._errors import StudyError

if TYPE_CHECKING:
    import xarray

_HEAD_WIDTH = 16


def status_text(folder: Path, status: SweepStatus) -> str:
    """What ``stickslip status`` prints."""
    wanted = f"{'at most ' if status.is_adaptive else ''}{status.most_samples:,}"
    running = "running now" if status.is_running else "finished" if status.is_finished else "not running"
    lines = [
        f"{folder}: {status.complete} of {status.points} points done, {status.samples:,} of {wanted} samples; "
        f"{running}.",
        *_endings(status.endings, sum(status.endings.values())),
        f"Time spent simulating: {status.seconds:.3g} s, summed over threads.",
    ]
    if status.is_finished:
        lines.append(f"`stickslip show {folder}` prints the result.")
    elif not status.is_running:
        lines.append(f"`stickslip resume {folder}` goes on from here.")
    return "\n".join(lines)


def _endings(counts: dict[Status, int], samples: int) -> list[str]:
    return [
        f"NOT FINISHED: {count:,} of {samples:,} samples, because {status.meaning}; they enter no statistic."
        for status, count in counts.items()
        if count and status is not Status.FINISHED
    ]


def chosen_statistics(dataset: "xarray.Dataset", names: Sequence[str] = ()) -> list[str]:
    """The names of the variables to show: `names`, or, of none, all statistics of totals and derivatives.

    Raises StudyError for a name that is no statistic with an error at each point.
    """
    if not names:
        return shown_statistics(dataset)
    known = statistics_of_points(dataset)
    for name in names:
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"; did you mean {near[0]}?" if near else "."
            raise StudyError(f"option --statistics must name some of {', '.join(known)}, but {name} was given{hint}")
    return list(names)


def sweep_table(dataset: "xarray.Dataset", names: Sequence[str]) -> str:
    """A table of the statistics called `names` at all points with standard errors, and what is to be known of them."""
    counts = np.asarray(dataset["samples"]).reshape(-1)
    stacked = {name: np.asarray(dataset[name]).reshape(-1) for name in [*names, *(f"{name}_error" for name in names)]}
    heads, columns = _coordinates(dataset)
    if counts.min() != counts.max():
        heads.append("samples")
        columns.append([f"{count:,}" for count in counts])
    for name in names:
        heads.append(_label(dataset[name]))
        pairs = zip(stacked[name], stacked[f"{name}_error"], strict=True)
        columns.append(["-" if math.isnan(value) else format_with_error(value, error) for value, error in pairs])
    every = f", {counts[0]:,} samples each" if counts.min() == counts.max() else ""
    counted = {one: f"samples_{one.name.lower()}" for one in Status}
    ending = {one: int(dataset[name].sum()) if name in dataset else 0 for one, name in counted.items()}
    spent = float(np.nansum(dataset["run_seconds"]))
    return "\n".join(
        [
            f"{_title(dataset)}: {len(counts)} points{every}",
            "",
            *_rows(heads, columns, dataset),
            "",
            *_endings(ending, int(counts.sum())),
            f"Each with its standard error. Time spent simulating: {spent:.3g} s, summed over threads.",
        ]
    )


def _title(dataset: "xarray.Dataset") -> str:
    system, law = (json.loads(dataset.attrs[name]) for name in ("system", "law"))
    names = [one["fields"]["name"] if one["class"] == "Unknown" else one["class"] for one in (system, law)]
    return f"{', '.join(names)}, on [0, {dataset.attrs['t1']:g}] s ({dataset.attrs['dtype']})"


def _coordinates(dataset: "xarray.Dataset") -> tuple[list[str], list[list[str]]]:
    """Heads and columns of the parameters at each point."""
    dimensions = point_dimensions(dataset)
    heads, columns = [], []
    for dimension in dimensions:
        of_it = [name for name, one in dataset.coords.items() if one.dims == (dimension,) and name != dimension]
        for name in of_it or [dimension]:
            values = dataset[name].broadcast_like(dataset["samples"]).transpose(*dimensions).values.reshape(-1)
            unit = dataset[name].attrs.get("units", "1")
            heads.append(str(name) if unit == "1" else f"{name} ({unit})")
            columns.append([f"{value:.6g}" for value in values])
    return heads, columns


def _label(variable: "xarray.DataArray") -> str:
    unit = variable.attrs.get("units", "1")
    return variable.attrs["long_name"] + ("" if unit == "1" else f" ({unit})")


def _rows(heads: list[str], columns: list[list[str]], dataset: "xarray.Dataset") -> Iterator[str]:
    """The lines of the table; a gap where the first of several dimensions goes on."""
    wrapped = [wrap(head, _HEAD_WIDTH) for head in heads]
    height = max(map(len, wrapped))
    wrapped = [[""] * (height - len(head)) + head for head in wrapped]
    widths = [max(map(len, [*head, *column])) for head, column in zip(wrapped, columns, strict=True)]
    for row in zip(*wrapped, strict=True):
        yield _line(row, widths)
    shape = dataset["samples"].shape
    block = math.prod(shape[1:]) if len(shape) > 1 else 0
    for number, row in enumerate(zip(*columns, strict=True)):
        if block > 1 and number % block == 0:
            yield ""
        yield _line(row, widths)


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(f"{entry:>{width}}" for entry, width in zip(row, widths, strict=True)).rstrip()
