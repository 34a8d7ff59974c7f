"""Where a study runs: in threads, in processes of this machine, or on a cluster of dask."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax

from .. import _checks
from .._fast_cpu import cores
from .dask_executor import DaskCluster
from .executors import Executor, Threads
from .plan import Plan
from .processes import Processes
from .store import Store


@contextmanager
def executor_for(
    plan: Plan, store: Store, threads: int | None, workers: int | None, executor: Any, shared_folder: bool
) -> Iterator[Executor]:
    """The executor that the arguments of `Study.run` ask for. Raises ValueError for those that do not fit."""
    chosen = _chosen(plan, store, threads, workers, executor, shared_folder)
    finished = False
    try:
        yield chosen
        finished = True
    finally:
        chosen.close(wait=finished)


def _chosen(
    plan: Plan, store: Store, threads: int | None, workers: int | None, executor: Any, shared_folder: bool
) -> Executor:
    if executor is not None:
        return DaskCluster(plan, executor, store, shared_folder)
    if workers is not None:
        return Processes(plan, _checks.whole_number("workers", workers))
    usual = max(cores(), len(jax.local_devices()))
    return Threads(plan, usual if threads is None else _checks.whole_number("threads", threads))


def check_where(threads: Any, workers: Any, executor: Any, shared_folder: Any, *, has_folder: bool) -> None:
    """Raises ValueError for arguments of `Study.run` that exclude each other."""
    given = {"threads": threads, "workers": workers, "executor": executor}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise ValueError(f"Arguments {names[0]} and {names[1]} must not both be given; each says where to simulate.")
    _checks.truth("shared_folder", shared_folder)
    if shared_folder and (executor is None or not has_folder):
        missing = "a folder" if executor is not None else "executor"
        raise ValueError(
            f"Argument shared_folder must be True only with folder and executor, but {missing} was not given; it lets "
            "the workers of a cluster write into the folder of the study."
        )
