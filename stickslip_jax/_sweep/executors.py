"""Executors, which do the tasks of a sweep: threads of this process, or processes of this machine."""

import signal
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol, runtime_checkable

from .._extras import require
from . import workers
from .errors import SweepError
from .plan import Plan, Task
from .workers import Outcome, Performer

# loky ends workers that have grown, as ours do when they compile for another task; they do not go on growing.
_ENVIRONMENT = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e15"}


class Written(NamedTuple):
    """The result of a task whose worker has written the batch into the folder of the sweep. `size`: in bytes."""

    size: int


class WorkerDiedError(Exception):
    """The worker of a task died. `others`: whether all other tasks under way are lost too."""

    def __init__(self, reason: str, *, others: bool):
        super().__init__(reason)
        self.others = others


@runtime_checkable
class Pending(Protocol):
    """The outcome of a task that is under way: a future of the standard library, or of dask."""

    def add_done_callback(self, fn: Callable[[Any], object], /) -> None: ...

    def result(self) -> Any: ...


class Executor(ABC):
    """Does tasks somewhere, as many at a time as there are `workers`."""

    def __init__(self, workers: int):
        self._workers = workers

    @property
    def at_once(self) -> int:
        """How many tasks are worth submitting before the first is done."""
        return 2 * self._workers

    @abstractmethod
    def submit(self, task: Task) -> Pending:
        """Begin a task."""

    def result(self, task: Task, future: Pending) -> Outcome | Written:
        """The outcome of a task that is done.

        Raises WorkerDiedError, SweepError where the sweep cannot continue, and the error of the task.
        """
        return future.result()

    @abstractmethod
    def close(self, *, wait: bool) -> None:
        """Close it; tasks that have not begun are cancelled. `wait`: whether to wait for those that have."""

    def restart(self) -> None:  # noqa: B027 - threads have nothing to do
        """Start it again after all tasks under way were lost."""

    def check(self) -> None:  # noqa: B027 - only connections are lost
        """Raises SweepError if futures can no longer become done."""


class Threads(Executor):
    """Threads of this process."""

    def __init__(self, plan: Plan, threads: int):
        super().__init__(threads)
        self._performer = Performer(plan)
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="stickslip sweep")

    def submit(self, task: Task) -> Future[Outcome]:
        return self._pool.submit(workers.attempted, self._performer.perform, task)

    def close(self, *, wait: bool) -> None:
        self._pool.shutdown(wait=wait, cancel_futures=True)


class Processes(Executor):
    """Processes of this machine, each with one thread. They are spawned: JAX does not survive a fork.

    Those of loky do not run the user's program again, as those of the standard library and of dask do.
    """

    def __init__(self, plan: Plan, processes: int):
        super().__init__(processes)
        self._start = workers.start_of_process(plan)
        self._pool = self._new()

    def _new(self) -> Any:
        require("Argument workers needs", "study", "loky")
        from loky import ProcessPoolExecutor  # noqa: PLC0415 - an extra, loaded when asked for

        prepare = workers.prepare_process
        return ProcessPoolExecutor(self._workers, initializer=prepare, initargs=self._start, env=_ENVIRONMENT)

    def submit(self, task: Task) -> Future[Outcome]:
        try:
            with _no_interrupts():
                return self._pool.submit(workers.perform_in_process, task)
        except BrokenExecutor as error:  # a worker died while there was nothing to do
            future: Future[Outcome] = Future()
            future.set_exception(error)
            return future

    def result(self, task: Task, future: Pending) -> Outcome:
        try:
            return future.result()
        except (BrokenExecutor, CancelledError) as error:
            reason = str(error).partition("\n")[0]
            raise WorkerDiedError(reason, others=True) from error  # the whole pool breaks
        except workers.UnfitWorkerError as error:
            raise SweepError(str(error)) from error

    def restart(self) -> None:
        self.close(wait=False)
        self._pool = self._new()

    def close(self, *, wait: bool) -> None:
        self._pool.shutdown(wait=True, kill_workers=not wait)


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """Processes that are started in the block ignore Ctrl-C from the beginning: they inherit what is blocked."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
