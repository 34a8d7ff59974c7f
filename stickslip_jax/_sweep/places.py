"""Where a sweep runs: in threads, in processes of this machine, or on a cluster of dask."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax

from .. import _checks
from .._fast_cpu import cores
from .dask_executor import DaskCluster
from .executors import Executor, Threads
from .plan import Plan
from .processes import Processes
from .store import Store


class Where(NamedTuple):
    """Where to simulate, as in the arguments of `Sweep.run`."""

    threads: int | None = None
    workers: int | None = None
    executor: Any = None
    shared_folder: bool = False


@contextmanager
def executor_for(plan: Plan, store: Store, where: Where) -> Iterator[Executor]:
    """The executor that was asked for, closed at the end."""
    chosen = _chosen(plan, store, where)
    finished = False
    try:
        yield chosen
        finished = True
    finally:
        chosen.close(wait=finished)


def _chosen(plan: Plan, store: Store, where: Where) -> Executor:
    if where.executor is not None:
        return DaskCluster(plan, where.executor, store, where.shared_folder)
    if where.workers is not None:
        return Processes(plan, _checks.whole_number("workers", where.workers))

    usual = max(cores(), len(jax.local_devices()))
    return Threads(plan, usual if where.threads is None else _checks.whole_number("threads", where.threads))


def check_where(where: Where, *, has_folder: bool) -> None:
    """Raises ValueError for arguments of `Sweep.run` that exclude each other."""
    executor, shared_folder = where.executor, where.shared_folder
    names = [name for name in ("threads", "workers", "executor") if getattr(where, name) is not None]
    if len(names) > 1:
        raise ValueError(f"Arguments {names[0]} and {names[1]} must not both be given; each says where to simulate.")
    _checks.truth("shared_folder", shared_folder)
    if shared_folder and (executor is None or not has_folder):
        missing = "a folder" if executor is not None else "executor"
        raise ValueError(
            f"Argument shared_folder must be True only with folder and executor, but {missing} was not given; it lets "
            "the workers of a cluster write into the folder of the sweep."
        )
