"""Executors, which do the tasks of a sweep: threads, processes of this machine, or a cluster of dask.distributed."""

import contextlib
import functools
import os
import signal
import socket
import sys
import time
import uuid
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from .._foundation import checks
from .._foundation.extras import require
from .._foundation.files import write_whole
from . import batches
from .batches import Failed, NoMemory, Outcome, Performer, Sent, UnfitWorkerError, perform_sent, sent
from .manifest import with_header
from .plan import Plan, SweepError, Task
from .store import Store, cannot_write

if TYPE_CHECKING:
    import distributed


# Executors, which do the tasks of a sweep: threads of this process, or processes of this machine.


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
        return self._pool.submit(batches.attempted, self._performer.perform, task)

    def close(self, *, wait: bool) -> None:
        self._pool.shutdown(wait=wait, cancel_futures=True)


class Processes(Executor):
    """Processes of this machine, each with one thread. They are spawned: JAX does not survive a fork.

    Those of loky do not run the user's program again, as those of the standard library and of dask do.
    """

    def __init__(self, plan: Plan, processes: int):
        super().__init__(processes)
        self._start = batches.start_of_process(plan)
        self._pool = self._new()

    def _new(self) -> Any:
        require("Argument workers needs", "study", "loky")
        from loky import ProcessPoolExecutor  # noqa: PLC0415 - an extra, loaded when asked for

        prepare = batches.prepare_process
        return ProcessPoolExecutor(self._workers, initializer=prepare, initargs=self._start, env=_ENVIRONMENT)

    def submit(self, task: Task) -> Future[Outcome]:
        try:
            with _no_interrupts():
                return self._pool.submit(batches.perform_in_process, task)
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
        except batches.UnfitWorkerError as error:
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


# Tasks done by the workers of a cluster of dask.distributed.


_RETRIES = 3  # of a task that failed for another reason than its point
_PART = 4 * 2**20  # bytes: dask warns about tasks that hold 10 MB
_VISIBLE = 30.0  # s until a file that another machine has written must be seen here
_COUNTED = 1.0  # s for which a count of the cluster's threads holds
_LONG = 10.0  # s without a result, after which it is asked whether the workers are paused


class DaskCluster(Executor):
    """The workers of a cluster, to which a ``dask.distributed.Client`` is connected.

    The plan is sent to the cluster once, as arguments of tasks whose result it is. If the worker that holds it dies,
    the scheduler makes it again, and workers that start later get it from others. A task is a few numbers. At most two
    tasks for each thread of the cluster are submitted at a time, and results are released as soon as they arrive.
    """

    def __init__(self, plan: Plan, client: "distributed.Client", store: Store, shared_folder: bool):
        _check_client(client)
        super().__init__(1)
        self._client: Any = client  # whose annotations are those of its coroutines
        self._checked, self._sent = plan, sent(plan)
        self._store, self._shared = store, shared_folder
        self._futures: dict[Task, distributed.Future] = {}
        self._counted = -_COUNTED
        self._printed: set[str] = set()
        self._came = time.monotonic()  # when the last result did
        self._plan = self._send()

    def _send(self) -> "distributed.Future":
        """The future of the plan in the cluster."""
        self.check()
        data = self._sent.plan
        parts = [self._begun("plan-part", bytes, data[at : at + _PART]) for at in range(0, len(data), _PART)]
        return self._begun("plan", _assembled, parts, *self._sent[1:])

    def _begun(self, name: str, function: Callable[..., object], *arguments: object) -> "distributed.Future":
        """The future of a function, with its arguments, in the cluster."""
        key = f"stickslip-{name}-{uuid.uuid4().hex[:8]}"
        return self._client.submit(function, *arguments, key=key, pure=False, retries=_RETRIES)

    @property
    def at_once(self) -> int:
        """Two tasks for each thread that there is now; workers come and go."""
        self.check()
        return super().at_once

    def submit(self, task: Task) -> "distributed.Future":
        self.check()
        name = "-".join(map(str, task))
        if self._shared:
            path = str(self._path_of(task).resolve())
            future = self._begun(name, _perform_and_write, self._plan, tuple(task), path, self._store.sweep_id)
        else:
            future = self._begun(name, _perform, self._plan, tuple(task))
        self._futures[task] = future
        return future

    def result(self, task: Task, future: Pending) -> Outcome | Written:
        from distributed import KilledWorker  # noqa: PLC0415 - an extra, of which a client is there

        mine = self._futures.pop(task)
        self._came = time.monotonic()
        try:
            found = future.result()
        except KilledWorker as error:
            raise SweepError(
                f"Workers of the cluster died {error.allowed_failures + 1} times with the same batch, the last "
                f"{error.last_worker.address}; what is done is kept. Perhaps memory ran out: give the workers more, or "
                "fewer threads, and run again."
            ) from error
        except UnfitWorkerError as error:
            raise SweepError(str(error)) from error
        except CancelledError as error:  # by a restart of the cluster, with all others
            self.check()
            raise WorkerDiedError(f"the cluster cancelled its tasks: {error}", others=True) from error
        except OSError as error:
            self.check()
            raise WorkerDiedError(str(error), others=False) from error
        except RuntimeError as error:
            if "deserialization" not in str(error):
                raise
            raise SweepError(
                f"The scheduler of the cluster cannot read the sweep ({str(error).partition('.')[0]}); install "
                "stickslip_jax, dask and distributed in the same versions there."
            ) from error
        finally:
            mine.release()
        if isinstance(found, Written):
            self._check_visible(self._path_of(task), found.size)
        return found

    def _path_of(self, task: Task) -> Path:
        return self._store.batch_of(self._checked.points.identity(task.point), task, self._checked).path

    def _check_visible(self, path: Path, size: int) -> None:
        """Raises SweepError if a file that a worker wrote does not appear here; network folders take a moment."""
        end = time.monotonic() + _VISIBLE
        while True:
            with contextlib.suppress(OSError):
                names = os.listdir(path.parent)  # asks the server, where looking for one file may not
                if path.name in names and path.stat().st_size == size:
                    return
            self._store.check_kept()
            if time.monotonic() > end:
                raise SweepError(
                    f"{path.name}, which a worker has written, is not in {path.parent}; the folder is not the same "
                    "everywhere: leave shared_folder out, and run again."
                )
            time.sleep(0.1)

    def check(self) -> None:
        if self._client.status != "running":
            raise SweepError(
                "The connection to the cluster was lost; the batches that came before are kept in "
                f"{self._store.folder}. Connect a new client: the same call with it goes on from there."
            )
        if time.monotonic() >= self._counted + _COUNTED:
            self._count()

    def _count(self) -> None:
        """Count the threads of the cluster; print a message if the sweep has to wait for workers."""
        try:
            threads = sum(self._client.nthreads().values())
        except OSError:  # of a connection that is being lost, which the next check tells
            return
        finally:
            self._counted = time.monotonic()
        self._workers = max(1, threads)
        message = ""
        if not threads:
            start = f"start one with `dask worker {self._client.scheduler.address}`, or stop with Ctrl-C."
            message = f"The cluster has no workers, and the sweep waits for them; {start}"
        elif self._futures and time.monotonic() > self._came + _LONG and self._are_paused():
            message = (
                "The workers of the cluster are paused, because their memory is nearly full, and the sweep waits for "
                "them; give them more memory, or stop with Ctrl-C."
            )
        if message and message not in self._printed:  # once: workers come and go
            self._printed.add(message)
            self._store.log(message.partition(";")[0])
            print(message, file=sys.stderr)

    def _are_paused(self) -> bool:
        """Whether every worker has stopped taking tasks: dask does that where their memory is nearly full."""
        workers = self._client.scheduler_info()["workers"].values()
        return bool(workers) and all(worker.get("status") == "paused" for worker in workers)

    def restart(self) -> None:
        self._plan = self._send()

    def close(self, *, wait: bool) -> None:
        """Release what is under way; the client is the caller's, and stays open."""
        if self._client.status == "running":
            for future in (*self._futures.values(), self._plan):
                future.release()
        self._futures.clear()


def _check_client(client: object) -> None:
    if not all(callable(getattr(client, name, None)) for name in ("submit", "nthreads")):
        raise ValueError(
            "Argument executor must be a dask.distributed.Client, but "
            f"{checks.show(client)} was given; threads and workers need no client."
        )
    if getattr(client, "asynchronous", False):
        raise ValueError(
            "Argument executor must be a dask.distributed.Client that waits for answers, but one with "
            "asynchronous=True was given; make it without, outside of coroutines."
        )


# --- in the workers


def _assembled(parts: list[bytes], double: bool, versions: dict[str, str], caches: bool) -> Sent:
    return Sent(b"".join(parts), double, versions, caches)


def _perform(plan: Sent, task: tuple) -> Outcome:
    return perform_sent(plan, Task(*task))


def _perform_and_write(plan: Sent, task: tuple, path: str, sweep_id: bytes) -> Written | Failed | NoMemory:
    """Do a task, and write its batch into the folder of the sweep. Raises UnfitWorkerError where that is not here."""
    _check_shared(Path(path).parents[1], sweep_id)
    found = perform_sent(plan, Task(*task))
    if not isinstance(found, bytes):
        return found
    whole = with_header(sweep_id, Path(path).name, found)
    try:
        write_whole(Path(path), whole)
    except OSError as error:
        raise UnfitWorkerError(f"{_where()}: {cannot_write(Path(path).parents[1], error)}") from error
    return Written(len(whole))


@functools.lru_cache(maxsize=4)
def _check_shared(folder: Path, sweep_id: bytes) -> None:
    try:
        if Store.reading(folder).sweep_id == sweep_id:
            return
        reason = "holds another sweep"
    except SweepError as error:
        reason = f"cannot be used ({error})"
    raise UnfitWorkerError(
        f"{_where()}: {folder} {reason} there; leave shared_folder out unless the folder is the same everywhere."
    )


def _where() -> str:
    return f"Worker on {socket.gethostname()}"
