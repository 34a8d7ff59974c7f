"""Where the tasks of a study are done: in threads, in processes of this machine, or by a cluster of dask."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax

from .. import _checks
from .plan import Plan, Task
from .store import Store
from .workers import Failed, Performer


class Written(NamedTuple):
    """What comes back for a piece that the worker has written into the folder of the study."""

    size: int


class WorkerDiedError(Exception):
    """The worker of a task died. `others`: whether all tasks under way are lost with it."""

    def __init__(self, reason: str, *, others: bool):
        super().__init__(reason)
        self.others = others


class Executor(ABC):
    """Does tasks somewhere."""

    @property
    @abstractmethod
    def at_once(self) -> int:
        """How many tasks are worth submitting before the first is done."""

    @abstractmethod
    def submit(self, task: Task) -> Any:
        """A future of the task, with ``add_done_callback``."""

    @abstractmethod
    def result(self, task: Task, future: Any) -> bytes | Written | Failed:
        """What came of a future that is done. Raises WorkerDiedError, StudyError where there is no going on, and what
        went wrong with the task.
        """

    @abstractmethod
    def close(self, *, wait: bool) -> None:
        """End it; what has not begun is cancelled. `wait`: whether to wait for what has."""

    def restart(self) -> None:  # noqa: B027 - threads have nothing to do
        """Make it work again after all tasks under way were lost."""

    def check(self) -> None:  # noqa: B027 - only connections are lost
        """Raises StudyError if no future can become done any more."""


class Threads(Executor):
    """Threads of this process."""

    def __init__(self, plan: Plan, threads: int):
        self._performer, self._threads = Performer(plan), threads
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="stickslip study")

    @property
    def at_once(self) -> int:
        return 2 * self._threads

    def submit(self, task: Task) -> Future[bytes]:
        return self._pool.submit(self._performer.perform, task)

    def result(self, task: Task, future: Future[bytes]) -> bytes | Failed:
        try:
            return future.result()
        except ValueError as error:
            return Failed(str(error))

    def close(self, *, wait: bool) -> None:
        self._pool.shutdown(wait=wait, cancel_futures=True)


class Where(NamedTuple):
    """Where to simulate, as in the arguments of `Study.run`."""

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
        from .dask_executor import DaskCluster  # noqa: PLC0415 - an extra

        return DaskCluster(plan, where.executor, store, where.shared_folder)
    if where.workers is not None:
        from .processes import Processes  # noqa: PLC0415 - an extra

        return Processes(plan, _checks.whole_number("workers", where.workers))
    from .._fast_cpu import cores  # noqa: PLC0415

    usual = max(cores(), len(jax.local_devices()))
    return Threads(plan, usual if where.threads is None else _checks.whole_number("threads", where.threads))


def check_where(where: Where, *, has_folder: bool) -> None:
    """Raises ValueError for arguments of `Study.run` that exclude each other."""
    executor, shared_folder = where.executor, where.shared_folder
    names = [name for name in ("threads", "workers", "executor") if getattr(where, name) is not None]
    if len(names) > 1:
        raise ValueError(f"Arguments {names[0]} and {names[1]} must not both be given; each says where to simulate.")
    _checks.truth("shared_folder", shared_folder)
    if shared_folder and (executor is None or not has_folder):
        missing = "a folder" if executor is not None else "executor"
        raise ValueError(
            f"Argument shared_folder must be True only with folder and executor, but {missing} was not given; it lets "
            "the workers of a cluster write into the folder of the study."
        )
