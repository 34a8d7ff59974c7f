"""Parameter sweeps of the command: made from their file, run, resumed."""

import asyncio
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .._sweep.sweep import Sweep
from ._errors import StudyError
from ._options import ExecutorOptions
from ._run import arguments_of, in_words_of_the_file
from ._sweep_config import SweepConfig

if TYPE_CHECKING:
    import distributed
    import xarray

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
