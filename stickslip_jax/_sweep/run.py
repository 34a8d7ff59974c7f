"""Running a sweep in a folder: what is left to do is done and stored, until all is there or Ctrl-C stops it.

Executors do it: threads, processes of this machine, or a cluster of dask.distributed.
"""

import contextlib
import functools
import math
import os
import queue
import signal
import socket
import sys
import threading
import time
import uuid
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from .._ensemble.encoding import SweepError, cannot_write, with_header
from .._foundation import checks
from .._foundation.extras import Progress, progress_bar, require
from .._foundation.files import write_whole
from .._foundation.processes import usual_threads
from . import batches
from .batches import SETTINGS, Failed, NoMemory, Outcome, Performer, Plan, Sent, Task, outcome_of, perform_sent, sent
from .dataset import Results, Work, require_packages, write_dataset
from .store import LOG, Store, opened

if TYPE_CHECKING:
    import distributed
    import xarray


# Executors, which do the tasks of a sweep: threads of this process, or processes of this machine.


# loky ends workers that have grown, as ours do when they compile for another task; they do not go on growing.
_ENVIRONMENT = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e15"}


class WorkerDiedError(Exception):
    """The worker of a task died. `others`: whether all other tasks under way are lost too."""

    def __init__(self, reason: str, *, others: bool):
        super().__init__(reason)
        self.others = others


class Executor:
    """Does tasks in a pool, as many at a time as it has `workers`, and is closed at the end of a ``with`` block.

    - `new_pool`: makes it, a `ThreadPoolExecutor` or one of processes of loky. `perform`: does a task there.
    - `tasks`: those under way, by future, with the time when each began. `most`: how many at a time are allowed, if
      fewer than it takes.
    """

    def __init__(self, workers: int, new_pool: Callable[[], Any], perform: Callable[..., object]):
        self._workers, self._new_pool, self._perform = workers, new_pool, perform
        self.tasks: dict[Any, tuple[Task, float]] = {}
        self.most, self._narrowed = math.inf, 0.0
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._pool = new_pool()

    @property
    def at_once(self) -> int | float:
        """How many tasks are worth submitting before the first is done."""
        return min(self.most, 2 * self._workers)

    def submit(self, task: Task) -> Any:
        """The future of a task that begins, of the standard library or of dask."""
        try:
            with _no_interrupts():
                return self._pool.submit(self._perform, task)
        except BrokenExecutor as error:  # a worker died while there was nothing to do
            future: Future[Outcome] = Future()
            future.set_exception(error)
            return future

    def begin(self, task: Task) -> None:
        """Begin a task."""
        future = self.submit(task)
        self.tasks[future] = task, time.monotonic()
        future.add_done_callback(lambda _: self._ended.put(future))

    def ended(self) -> Any:
        """The future of a task that is done; None if none is within a tenth of a second, in which signals come."""
        try:
            future = self._ended.get(timeout=0.1)
        except queue.Empty:
            return None
        return future if future in self.tasks else None  # else lost, and begun again

    def forgotten(self) -> list[Task]:
        """All tasks that are under way, which are no longer."""
        tasks = [task for task, _ in self.tasks.values()]
        self.tasks.clear()
        return tasks

    def narrow(self, began: float) -> None:
        """Allow fewer tasks at a time, because there was no memory for one that `began` then.

        Half of those that were worked on: as many again wait in the executor. Tasks that were under way together
        narrow it once.
        """
        if began >= self._narrowed:
            self.most, self._narrowed = max(1, (len(self.tasks) + 1) // 4), time.monotonic()

    def was_alone(self, began: float) -> bool:
        """Whether a task that `began` then was under way without others."""
        return self.most == 1 and began >= self._narrowed

    def result(self, task: Task, future: Any) -> Outcome | int:
        """The outcome of a task that is done; the size (bytes) of a batch that the worker has written into the folder.

        Raises WorkerDiedError, SweepError where the sweep cannot continue, and the error of the task.
        """
        try:
            return future.result()
        except (BrokenExecutor, CancelledError) as error:  # the whole pool breaks
            raise WorkerDiedError(str(error).partition("\n")[0], others=True) from error

    def restart(self) -> None:
        """Start it again after all tasks under way were lost."""
        self.close(wait=False)
        self._pool = self._new_pool()

    def close(self, *, wait: bool) -> None:
        """Close it; tasks that have not begun are cancelled. `wait`: whether to wait for those that have."""
        if isinstance(self._pool, ThreadPoolExecutor):
            self._pool.shutdown(wait=wait, cancel_futures=True)
        else:
            self._pool.shutdown(wait=True, kill_workers=not wait)

    def check(self) -> None:
        """Raises SweepError if futures can no longer become done, as where a connection is lost."""

    def __enter__(self) -> "Executor":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(wait=kind is None)


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
        if not all(callable(getattr(client, name, None)) for name in ("submit", "nthreads")):
            hint = "threads and workers need no client"
            raise checks.refused("executor", "be a dask.distributed.Client", client, hint)
        if getattr(client, "asynchronous", False):
            raise ValueError(
                "Argument executor must be a dask.distributed.Client that waits for answers, but one with "
                "asynchronous=True was given; make it without, outside of coroutines."
            )
        self._client: Any = client  # whose annotations are those of its coroutines
        self._checked, self._sent = plan, sent(plan)
        self._store, self._shared = store, shared_folder
        self._counted = -_COUNTED
        self._printed: set[str] = set()
        self._came = time.monotonic()  # when the last result did
        super().__init__(1, self._send, _perform)

    def _send(self) -> "distributed.Future":
        """The future of the plan in the cluster."""
        self.check()
        data = self._sent.plan
        parts = [self._begun("plan-part", bytes, data[at : at + _PART]) for at in range(0, len(data), _PART)]
        return self._begun("plan", _assembled, parts, *self._sent[1:])

    def _begun(self, name: str, function: Callable[..., object], *arguments: object) -> "distributed.Future":
        """The future of a function, with its arguments, in the cluster."""
        key = f"stickslip-{name}-{uuid.uuid4().hex[:8]}"
        try:
            return self._client.submit(function, *arguments, key=key, pure=False, retries=_RETRIES)
        except Exception:  # perhaps the client was closed after it was checked, for which distributed has many errors
            self.check()
            raise

    @property
    def at_once(self) -> int | float:
        """Two tasks for each thread that there is now; workers come and go."""
        self.check()
        return super().at_once

    def submit(self, task: Task) -> "distributed.Future":
        self.check()
        path = self._store.batch_of(task, self._checked).path.resolve()
        shared = (str(path), self._store.sweep_id) if self._shared else ()
        return self._begun("-".join(map(str, task)), self._perform, self._pool, tuple(task), *shared)

    def result(self, task: Task, future: "distributed.Future") -> Outcome | int:
        from distributed import KilledWorker  # noqa: PLC0415 - an extra, of which a client is there

        self._came = time.monotonic()
        try:
            found = future.result()
        except KilledWorker as error:
            raise SweepError(
                f"Workers of the cluster died {error.allowed_failures + 1} times with the same batch, the last "
                f"{error.last_worker.address}; what is done is kept. Perhaps memory ran out: give the workers more, or "
                "fewer threads, and run again."
            ) from error
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
            future.release()
        if isinstance(found, int):
            self._check_visible(self._store.batch_of(task, self._checked).path, found)
        return found

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
        """Also count the threads of the cluster, and print a message if the sweep has to wait for workers."""
        if self._client.status != "running":
            raise SweepError(
                "The connection to the cluster was lost; the batches that came before are kept in "
                f"{self._store.folder}. Connect a new client: the same call with it goes on from there."
            )
        if time.monotonic() < self._counted + _COUNTED:
            return
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
        elif self.tasks and time.monotonic() > self._came + _LONG and self._are_paused():
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

    def close(self, *, wait: bool) -> None:
        """Release what is under way; the client is the caller's, and stays open."""
        if self._client.status == "running":
            for future in (*self.tasks, self._pool):
                future.release()


# --- in the workers


def _assembled(parts: list[bytes], double: bool, versions: tuple[tuple[str, str], ...]) -> Sent:
    return Sent(b"".join(parts), double, versions)


def _perform(plan: Sent, task: tuple, path: str = "", sweep_id: bytes = b"") -> Outcome | int:
    """Do a task; where there is a `path`, write its batch there, into the folder of the sweep, and return its size.

    Raises SweepError where that is not here.
    """
    folder = Path(path).parent.parent
    if path:
        _check_shared(folder, sweep_id)
    found = perform_sent(plan, Task(*task))
    if not path or not isinstance(found, bytes):
        return found
    whole = with_header(sweep_id, Path(path).name, found)
    try:
        write_whole(Path(path), whole)
    except OSError as error:
        raise SweepError(f"{_where()}: {cannot_write(folder, error)}") from error
    return len(whole)


@functools.lru_cache(maxsize=4)
def _check_shared(folder: Path, sweep_id: bytes) -> None:
    try:
        if Store.reading(folder).sweep_id == sweep_id:
            return
        reason = "holds another sweep"
    except SweepError as error:
        reason = f"cannot be used ({error})"
    raise SweepError(
        f"{_where()}: {folder} {reason} there; leave shared_folder out unless the folder is the same everywhere."
    )


def _where() -> str:
    return f"Worker on {socket.gethostname()}"


# The loop that does the tasks of a sweep, until all are done or Ctrl-C stops it.


_DEATHS = 3  # of workers while a task was under way, after which the sweep ends


@contextmanager
def stoppable() -> Iterator[threading.Event]:
    """Handles SIGINT while the block runs, where signals can be handled: in the main thread, unless it is ignored.

    The event is set by the first one: the sweep is to stop after the batches under way. The second one raises
    KeyboardInterrupt.
    """
    stopping, before = threading.Event(), signal.getsignal(signal.SIGINT)

    def request(number: int, frame: FrameType | None) -> None:
        if stopping.is_set():
            raise KeyboardInterrupt
        stopping.set()
        # In one write: a second Ctrl-C comes between the parts that print would write.
        sys.stderr.write(
            "\nStopping after the batches under way; what is done is kept. Press Ctrl-C again to stop at once.\n"
        )

    if threading.current_thread() is not threading.main_thread() or before in (signal.SIG_IGN, None):
        yield stopping
        return
    signal.signal(signal.SIGINT, request)
    try:
        yield stopping
    finally:
        signal.signal(signal.SIGINT, before)


def run_tasks(work: Work, results: Results, executor: Executor, stopping: threading.Event, bar: Progress) -> None:
    """Do all tasks of `work`, a few at a time, store each when it comes, and put each point that is complete.

    If there was no memory for a task it is done again, with fewer tasks at a time: a smaller batch would change the
    last digits. Stops after the tasks under way when `stopping` asks for it. Raises SweepError if the folder cannot be
    written, or the workers keep dying.
    """
    waiting, lost = deque(work.tasks()), Counter[Task]()
    bar.advance(sum(work.done))
    while (waiting and not stopping.is_set()) or executor.tasks:
        while waiting and not stopping.is_set() and len(executor.tasks) < executor.at_once:
            executor.begin(waiting.popleft())
        future = executor.ended()
        if future is None:
            executor.check()
            continue
        task, began = executor.tasks.pop(future)
        try:
            found = executor.result(task, future)
        except WorkerDiedError as error:
            again = [task, *(executor.forgotten() if error.others else ())]
            if _note_lost(work, again, lost, error) > 1:
                executor.narrow(began)
            if error.others:
                executor.restart()
            waiting.extendleft(reversed(again))
            continue
        except SweepError:
            raise
        except Exception as error:
            found = outcome_of(error)
        if isinstance(found, NoMemory) and not executor.was_alone(began):
            executor.narrow(began)
            waiting.appendleft(task)
            work.store.log(
                f"no memory for {described(work.plan, task)} ({found.reason}); it is done again, with at most "
                f"{executor.most} at a time"
            )
        elif isinstance(found, NoMemory):
            work.without_memory[task] = found.reason
            work.store.log(f"no memory for {described(work.plan, task)}, even alone: {found.reason}")
        elif isinstance(found, Failed):
            work.failed[task.point] = found.reason  # the other tasks of the point go on
            work.store.log(f"FAILED {described(work.plan, task)}: {found.reason}")
        else:
            waiting.extendleft(work.finish(task, found if isinstance(found, bytes) else None))
            results.put_if_complete(task.point)
            work.store.log(f"done {described(work.plan, task)} in {time.monotonic() - began:.2f} s")
            bar.advance(task.samples if task.derivative is None else 0)
            bar.note(f"{work.complete} of {work.plan.points.number} points")


def _note_lost(work: Work, again: list[Task], lost: Counter[Task], error: WorkerDiedError) -> int:
    """Log that tasks are done again; how often one of them has been lost. Raises SweepError if that is too often."""
    lost.update(again)
    worst = max(again, key=lost.__getitem__)
    work.store.log(f"a worker died ({error}); {len(again)} batches are done again")
    if lost[worst] > _DEATHS:
        raise SweepError(
            f"A worker died {lost[worst]} times while it simulated {described(work.plan, worst)} ({error}); what is "
            "done is kept. Perhaps memory ran out: take fewer workers, and run again."
        ) from error
    return lost[worst]


def described(plan: Plan, task: Task) -> str:
    """A task in words: "mu = 0.5: samples 0 to 1023"."""
    what = f"samples {task.first} to {task.end - 1}"
    if task.derivative is not None:
        statistic, wrt = plan.derivatives[task.derivative]
        what = f"derivative of {statistic} by {', '.join(wrt)}"
    return f"{plan.points.described(task.point)}: {what}"


# Running a sweep in a folder: what is left to do is done and stored, then all is put together.


_ROUNDS = 3  # after which batches that keep coming back damaged are an error of the disk


def _executor_for(
    plan: Plan, store: Store, threads: int | None, workers: int | None, client: Any, shared_folder: bool
) -> Executor:
    """The executor that was asked for."""
    if client is not None:
        return DaskCluster(plan, client, store, shared_folder)
    if workers is not None:
        # Spawned processes: JAX does not survive a fork. Those of loky do not run the user's program again, as those of
        # the standard library and of dask do.
        number = checks.whole_number("workers", workers)
        start = (sent(plan), {name: getattr(jax.config, name) for name in SETTINGS}, os.getpid())
        require("Argument workers needs", "study", "loky")
        from loky import ProcessPoolExecutor  # noqa: PLC0415 - an extra, loaded when asked for

        options: dict[str, Any] = {"initializer": batches.prepare_process, "initargs": start, "env": _ENVIRONMENT}
        return Executor(number, functools.partial(ProcessPoolExecutor, number, **options), batches.perform_in_process)
    usual = max(usual_threads(), len(jax.local_devices()))
    number = usual if threads is None else checks.whole_number("threads", threads)
    new_pool = functools.partial(ThreadPoolExecutor, number, thread_name_prefix="stickslip sweep")
    return Executor(number, new_pool, Performer(plan).perform)


def run_sweep(
    plan: Plan, folder: Path | None, *, threads: int | None, workers: int | None,
    executor: "distributed.Client | None", shared_folder: bool, progress: bool | None,
) -> "xarray.Dataset":  # fmt: skip
    """Do what is left of a sweep, and return its result; see `Sweep.run`."""
    require_packages()
    choice = {"threads": threads, "workers": workers, "executor": executor}
    names = [name for name, given in choice.items() if given is not None]
    if len(names) > 1:
        raise ValueError(f"Arguments {names[0]} and {names[1]} must not both be given; each says where to simulate.")
    checks.truth("shared_folder", shared_folder)
    if shared_folder and (executor is None or folder is None):
        missing = "executor" if executor is None else "a folder"
        raise ValueError(
            f"Argument shared_folder must be True only with folder and executor, but {missing} was not given; it lets "
            "the workers of a cluster write into the folder of the sweep."
        )
    if str(jnp.result_type(float)) != plan.dtype:
        raise SweepError(
            f"This sweep is in {plan.dtype}, and JAX is set to {jnp.result_type(float)}; call "
            f"jax.config.update('jax_enable_x64', {plan.dtype == 'float64'}) before anything else."
        )
    if plan.dtype == "float32":
        warnings.warn("This sweep runs in float32.", stacklevel=3)
    number = plan.points.number
    with ExitStack() as stack:
        there = folder or Path(stack.enter_context(TemporaryDirectory(prefix="stickslip-sweep-")))
        store, plan = stack.enter_context(opened(there, plan))
        stopping = stack.enter_context(stoppable())
        stack.enter_context(batches.warnings_by_thread())
        store.log(f"begun: {number} points, {plan.samples} samples each")
        for _ in range(_ROUNDS):
            work = Work(plan, store)
            results = Results(work)
            tasks_by = _executor_for(plan, store, threads, workers, executor, shared_folder)
            with tasks_by, progress_bar(progress, number * plan.samples) as bar:
                run_tasks(work, results, tasks_by, stopping, bar)
            if stopping.is_set():
                store.log("stopped")
                resume = f"`stickslip resume {there}`, or the same call again, goes on from here."
                raise KeyboardInterrupt(
                    f"Stopped with {work.complete} of {number} points done; "
                    + (resume if folder is not None else "they are lost, because no folder was given.")
                )
            if work.without_memory:
                task = min(work.without_memory)
                points = len({one.point for one in work.without_memory})
                what = f"There was no memory for batches of {points} of {number} points, even one at a time"
                store.log(f"stopped: {what}")
                raise SweepError(
                    f"{what}, first {described(plan, task)} ({work.without_memory[task]}); "
                    + (
                        f"what is done is kept in {there}: run again where there is more memory, or run the sweep with "
                        "a smaller batch into another folder."
                        if folder is not None
                        else "run it with a smaller batch, or where there is more memory, and give a folder, which "
                        "keeps what is done."
                    )
                )
            with progress_bar(progress, results.steps, "point put together") as bar:
                dataset = results.dataset(bar)
            if work.damaged:
                continue
            path = write_dataset(store, dataset)
            store.check_kept()
            store.remove_leftovers(work.identities)
            if work.failed:
                point = min(work.failed)
                failed = f"{len(work.failed)} of {number} points failed"
                store.log(f"finished, but {failed}")
                raise SweepError(
                    f"{failed}, first {plan.points.described(point)}: {work.failed[point].rstrip('.')}; "
                    + (
                        f"{path} has the results of the others, and {there / LOG} all reasons."
                        if folder is not None
                        else "give a folder, which keeps the results of the others."
                    )
                )
            store.log("finished")
            return dataset
        raise SweepError(f"{there} gives back other bytes than were written; check the disk, and run again.")
