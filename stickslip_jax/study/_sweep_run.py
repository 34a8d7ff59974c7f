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
from typing import TYPE_CHECKING, Any

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
    # Initial values, and the slips of `Ageing`, have other names in `Sweep`.
    starts = {name: f"y0[{number}]" for number, name in enumerate(run.initial)}
    for names, values in sweep.over.parameter_values().items():
        renamed = [starts.get(name) or re.sub(r"\Ainitial_state\[", "y0[", name) for name in names]
        full = tuple(re.sub(r"\bslip\.", "law.", name) for name in renamed)
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
        said = str(error)
        for pattern, words in _WORDS_OF_THE_FILE.items():
            said = re.sub(pattern, words, said)
        # A message that lists the names allowed goes on with the one that was probably meant.
        found = re.fullmatch(_LISTING, said)
        if found is not None:
            given = (re.findall(r"[\w.]+", found[2]) or [""])[0]
            near = get_close_matches(given, re.findall(r"\w+", found[1]), n=1, cutoff=0.5)
            said = f"{said.removesuffix('.')}; did you mean {near[0]}?" if near else said
        raise StudyError(source + in_words_of_the_file(said)) from error


_LISTING = r".*? (?:names? out of|must name one of|statistic out of) (.*), but (.*) was given\."
_WORDS_OF_THE_FILE: dict[str, Any] = {
    r"(\bfriction(\.\w+)?)\.law\.": r"\1.slip.",
    # Of parameters that change together there are several.
    r"\AArgument over\[\(?'(.+?)'\)?\] ": lambda found: found[1].replace("', '", ", ") + " in [sweep.over] ",
    r"\AArgument over ": "[sweep.over] ",
    r"\AArgument sensitivities must hold .*?, with a statistic": (
        "sensitivities in [sweep] must hold lists of parameters by statistic"
    ),
    r"\AArgument (keep|statistics|standard_error|realizations|batch)\b(\['\w+'\])?": r"\1\2 in [sweep]",
}
"""What stands in place of the names of arguments in messages of `Sweep`, by regular expressions, in their order."""


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
    heads, columns = _coordinates(dataset)
    is_even = counts.min() == counts.max()
    if not is_even:
        heads.append("samples")
        columns.append([f"{count:,}" for count in counts])
    for name in names:
        heads.append(_with_unit(dataset[name].attrs["long_name"], dataset[name]))
        values, errors = (np.asarray(dataset[one]).reshape(-1) for one in (name, f"{name}_error"))
        pairs = zip(values, errors, strict=True)
        columns.append(["-" if math.isnan(value) else format_with_error(value, error) for value, error in pairs])
    classes = [json.loads(dataset.attrs[name]) for name in ("system", "law")]
    titles = [one["fields"]["name"] if one["class"] == "Unknown" else one["class"] for one in classes]
    every = f", {counts[0]:,} samples each" if is_even else ""
    counted = {one: f"samples_{one.name.lower()}" for one in Status}
    ending = {one: int(dataset[name].sum()) if name in dataset else 0 for one, name in counted.items()}
    spent = float(np.nansum(dataset["run_seconds"]))
    return "\n".join(
        [
            f"{', '.join(titles)}, on [0, {dataset.attrs['t1']:g}] s ({dataset.attrs['dtype']}): "
            f"{len(counts)} points{every}",
            "",
            *_rows(heads, columns, dataset),
            "",
            *_endings(ending, int(counts.sum())),
            f"Each with its standard error. Time spent simulating: {spent:.3g} s, summed over threads.",
        ]
    )


def _coordinates(dataset: "xarray.Dataset") -> tuple[list[str], list[list[str]]]:
    """Heads and columns of the parameters at each point."""
    dimensions = point_dimensions(dataset)
    heads, columns = [], []
    for dimension in dimensions:
        of_it = [name for name, one in dataset.coords.items() if one.dims == (dimension,) and name != dimension]
        for name in of_it or [dimension]:
            values = dataset[name].broadcast_like(dataset["samples"]).transpose(*dimensions).values.reshape(-1)
            heads.append(_with_unit(str(name), dataset[name]))
            columns.append([f"{value:.6g}" for value in values])
    return heads, columns


def _with_unit(name: str, variable: "xarray.DataArray") -> str:
    unit = variable.attrs.get("units", "1")
    return name if unit == "1" else f"{name} ({unit})"


def _rows(heads: list[str], columns: list[list[str]], dataset: "xarray.Dataset") -> Iterator[str]:
    """The lines of the table; a gap where the first of several dimensions goes on."""
    wrapped = [wrap(head, _HEAD_WIDTH) for head in heads]
    height = max(map(len, wrapped))
    wrapped = [[""] * (height - len(head)) + head for head in wrapped]
    widths = [max(map(len, [*head, *column])) for head, column in zip(wrapped, columns, strict=True)]
    block = math.prod(dataset["samples"].shape[1:])
    for number, row in enumerate([*zip(*wrapped, strict=True), *zip(*columns, strict=True)], -height):
        if number >= 0 and block > 1 and number % block == 0:
            yield ""
        yield "  ".join(f"{entry:>{width}}" for entry, width in zip(row, widths, strict=True)).rstrip()
