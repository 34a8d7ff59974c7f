"""Tasks done in processes of this machine."""

import signal
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future
from contextlib import contextmanager
from typing import Any

from .errors import SweepError
from .executors import Executor, WorkerDiedError
from .plan import Plan, Task
from .workers import Outcome, UnfitWorkerError, perform_in_process, prepare_process, start_of_process

# loky ends workers that have grown, as ours do when they compile for another task; they do not go on growing.
_ENVIRONMENT = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e15"}


class Processes(Executor):
    """Processes of this machine, each with one thread. They are spawned: JAX does not survive a fork.

    Those of loky do not run the user's program again, as those of the standard library do.
    """

    def __init__(self, plan: Plan, workers: int):
        try:
            from loky import ProcessPoolExecutor  # noqa: PLC0415 - an extra, loaded when asked for
        except ImportError:
            raise ImportError("Argument workers needs loky: pip install 'stickslip_jax[study]'.") from None
        self._pool_class, self._workers, self._start = ProcessPoolExecutor, workers, start_of_process(plan)
        self._pool = self._new()

    @property
    def at_once(self) -> int:
        return 2 * self._workers

    def _new(self) -> Any:
        return self._pool_class(
            self._workers, initializer=prepare_process, initargs=self._start, env=_ENVIRONMENT
        )  # fmt: skip

    def submit(self, task: Task) -> Future[Outcome]:
        try:
            with _no_interrupts():
                return self._pool.submit(perform_in_process, task)
        except BrokenExecutor as error:  # a worker died while there was nothing to do
            future: Future[Outcome] = Future()
            future.set_exception(error)
            return future

    def result(self, task: Task, future: Future[Outcome]) -> Outcome:
        try:
            return future.result()
        except (BrokenExecutor, CancelledError) as error:
            reason = str(error).partition("\n")[0]
            raise WorkerDiedError(reason, others=True) from error  # the whole pool breaks
        except UnfitWorkerError as error:
            raise SweepError(str(error)) from error

    def restart(self) -> None:
        self._pool.shutdown(wait=True, kill_workers=True)
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
