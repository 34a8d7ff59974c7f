"""Parameter sweeps of the command: made from their file, run, resumed, and told as text."""

import asyncio
import json
import math
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from .._foundation.types import Status
from .._statistics.estimate import format_with_error
from .._sweep.dataset import SweepStatus, point_dimensions, shown_statistics, statistics_of_points
from .._sweep.sweep import Sweep
from ._config import SweepConfig
from ._errors import StudyError
from ._reading import ExecutorOptions
from ._run import arguments_of, in_words_of_the_file

if TYPE_CHECKING:
    import distributed
    import xarray


# Parameter sweeps of the command: made from their file, run, resumed.


_SECONDS_TO_CONNECT = 10


def sweep_of(config: SweepConfig, source: str = "") -> Sweep:
    """The sweep that `config` describes. Raises StudyError, beginning with `source`, for what does not fit."""
    run, sweep = config.run, config.sweep
    over: dict[str | tuple[str, ...], np.ndarray] = {}
    for names, values in sweep.over.parameter_values().items():
        full = tuple(_full_name(name, run.initial) for name in names)
        over[full if len(full) > 1 else "".join(full)] = values
    try:
        return Sweep(
            **arguments_of(config, run),
            **sweep.model_dump(exclude={"over", "sensitivities"}),
            over=over,
            sensitivities=[(name, tuple(wrt)) for name, wrt in (sweep.sensitivities or {}).items()],
        )
    except StudyError as error:
        raise StudyError(f"{source}{error}") from error
    except ValueError as error:
        raise StudyError(source + _in_words_of_the_sweep(str(error))) from error


def _full_name(name: str, initial: tuple[str, ...]) -> str:
    """The name in `Sweep` of a parameter of the file: initial values, and the slips of `Ageing`, have others there."""
    if name in initial:
        return f"y0[{initial.index(name)}]"
    return re.sub(r"\bslip\.", "law.", re.sub(r"\Ainitial_state\[", "y0[", name))


_SENSITIVITIES = "sensitivities in [sweep] must hold lists of parameters by statistic"
_OF_SWEEP = ("keep", "statistics", "standard_error", "realizations", "batch")


def _in_words_of_the_sweep(said: str) -> str:
    """A message of `Sweep` with the names of its arguments replaced by sections and keys of the file."""
    said = re.sub(r"(\bfriction(\.\w+)?)\.law\.", r"\1.slip.", said)
    said = re.sub(r"\AArgument over\[\(?'(.+?)'\)?\] ", _values_in_the_file, said)
    said = re.sub(r"\AArgument over ", "[sweep.over] ", said)
    said = re.sub(r"\AArgument sensitivities must hold .*?, with a statistic", _SENSITIVITIES, said)
    said = re.sub(rf"\AArgument ({'|'.join(_OF_SWEEP)})\b(\['\w+'\])?", r"\1\2 in [sweep]", said)
    return in_words_of_the_file(_with_suggestion(said))


def _values_in_the_file(argument: re.Match[str]) -> str:
    names = argument[1].replace("', '", ", ")  # of parameters that change together
    return f"{names} in [sweep.over] "


def _with_suggestion(said: str) -> str:
    """A message that lists the names allowed, with the one that was probably meant."""
    found = re.fullmatch(r".*? (?:names? out of|must name one of|statistic out of) (.*), but (.*) was given\.", said)
    if found is None:
        return said
    given = (re.findall(r"[\w.]+", found[2]) or [""])[0]
    near = get_close_matches(given, re.findall(r"\w+", found[1]), n=1, cutoff=0.5)
    return f"{said.removesuffix('.')}; did you mean {near[0]}?" if near else said


def run_stored(sweep: Sweep, folder: Path, where: ExecutorOptions) -> "xarray.Dataset":
    """Run what is left of a sweep in `folder`, and return its result.

    Raises SweepError as `Sweep.run` does, and StudyError where no scheduler answers at the address ``where.dask``.
    """
    with nullcontext() if where.dask is None else _client(where.dask) as client, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "This sweep runs in float32")  # as its file asks
        progress = False if where.quiet else where.progress
        return sweep.run(folder, threads=where.threads, workers=where.workers, executor=client, progress=progress)


@contextmanager
def _client(address: str) -> "Iterator[distributed.Client]":
    """A client of the dask scheduler at `address`. Raises StudyError if there is none."""
    if find_spec("distributed") is None:
        raise StudyError("Option --dask needs distributed: pip install 'stickslip_jax[cluster]'.")
    kind, _, _ = address.rpartition("://")
    if kind not in ("", "tcp", "ws"):
        raise StudyError(
            f"Option --dask must be the address of a dask scheduler, such as tcp://127.0.0.1:8786, but {address} was "
            f"given; {kind}:// needs a client with settings of its own: in Python, sweep.run(executor=client) takes it."
        )
    from distributed import Client  # noqa: PLC0415 - an extra, loaded when asked for

    try:
        # Asked first: the client itself waits for ever where something listens that is no scheduler.
        asyncio.run(asyncio.wait_for(_identity(address), _SECONDS_TO_CONNECT))
        client = Client(address, timeout=_SECONDS_TO_CONNECT)
    except Exception as error:  # whatever speaks there may answer anything
        reason = " ".join(str(error).split()) or f"none within {_SECONDS_TO_CONNECT} s"
        raise StudyError(
            f"Option --dask must be the address of a dask scheduler, such as tcp://127.0.0.1:8786, but {address} gave "
            f"no answer ({reason}); start one with `dask scheduler`."
        ) from None
    with client:
        yield client


async def _identity(address: str) -> None:
    """Ask the scheduler at `address` what it is. Raises ValueError for something else that speaks there."""
    from distributed import rpc  # noqa: PLC0415 - an extra, loaded when asked for

    async with rpc(address) as scheduler:
        found = await scheduler.identity() or {}
    if "Scheduler" not in str(found["type"]):
        raise ValueError(f"a {found['type']} is there")


# Parameter sweeps as text: how far one has come, and tables of its statistics.


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
