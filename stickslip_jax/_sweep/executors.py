"""Executors, which do the tasks of a sweep; the simplest is a pool of threads of this process."""

from abc import ABC, abstractmethod
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

from .plan import Plan, Task
from .workers import Outcome, Performer, attempted


class Written(NamedTuple):
    """The result of a task whose worker has written the batch into the folder of the sweep. `size`: in bytes."""

    size: int


class WorkerDiedError(Exception):
    """The worker of a task died. `others`: whether all other tasks under way are lost too."""

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
    def result(self, task: Task, future: Any) -> Outcome | Written:
        """The outcome of a future that is done.

        Raises WorkerDiedError, SweepError where the sweep cannot continue, and the error of the task.
        """

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
        self._performer, self._threads = Performer(plan), threads
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="stickslip sweep")

    @property
    def at_once(self) -> int:
        return 2 * self._threads

    def submit(self, task: Task) -> Future[Outcome]:
        return self._pool.submit(attempted, self._performer.perform, task)

    def result(self, task: Task, future: Future[Outcome]) -> Outcome:
        return future.result()

    def close(self, *, wait: bool) -> None:
        self._pool.shutdown(wait=wait, cancel_futures=True)
