"""Running a sweep in a folder: what is left to do is done and stored, until all is there or Ctrl-C stops it."""

import queue
import signal
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

from .._ensemble.parts import Progress, progress_bar
from .._foundation import checks
from .._foundation.processes import cores
from .batches import Failed, NoMemory, Outcome, outcome_of, warnings_by_thread
from .dataset import Work, dataset_of, require_packages, write_dataset
from .executors import DaskCluster, Executor, Pending, Processes, Threads, WorkerDiedError, Written
from .plan import Plan, SweepError, Task
from .store import LOG, Store, opened

if TYPE_CHECKING:
    import distributed
    import xarray


# The loop that does the tasks of a sweep, until all are done or Ctrl-C stops it.


_DEATHS = 3  # of workers while a task was under way, after which the sweep ends


class Stopping:
    """Whether the sweep is to stop. `requested`: after the batches under way."""

    def __init__(self) -> None:
        self.requested = False

    def request(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal: the first time ask to stop, the second time raise KeyboardInterrupt."""
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        # In one write: a second Ctrl-C comes between the parts that print would write.
        sys.stderr.write(
            "\nStopping after the batches under way; what is done is kept. Press Ctrl-C again to stop at once.\n"
        )


@contextmanager
def stoppable() -> Iterator[Stopping]:
    """Handles SIGINT while the block runs, where signals can be handled: in the main thread, unless it is ignored."""
    stopping = Stopping()
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before in (signal.SIG_IGN, None):
        yield stopping
        return
    signal.signal(signal.SIGINT, stopping.request)
    try:
        yield stopping
    finally:
        signal.signal(signal.SIGINT, before)


def run_tasks(work: Work, executor: Executor, stopping: Stopping, bar: Progress) -> None:
    """Do all tasks of `work`, a few at a time, and store each result when it comes.

    If there was no memory for a task it is done again, with fewer tasks at a time: a smaller batch would change the
    last digits. Stops after the tasks under way when `stopping` asks for it. Raises SweepError if the folder cannot be
    written, or the workers keep dying.
    """
    waiting, under_way = deque(work.tasks()), _UnderWay(executor)
    lost: dict[Task, int] = {}
    bar.advance(sum(work.done))
    while (waiting and not stopping.requested) or under_way.began:
        while waiting and not stopping.requested and under_way.has_room:
            under_way.begin(waiting.popleft())
        task = under_way.next()
        if task is None:
            executor.check()
            continue
        began, alone = under_way.began[task], under_way.is_alone(task)
        try:
            found = under_way.result(task)
        except WorkerDiedError as error:
            again = [task, *(under_way.forget() if error.others else ())]
            if _note_lost(work, again, lost, error) > 1:
                under_way.narrow(began)
            if error.others:
                executor.restart()
            waiting.extendleft(reversed(again))
            continue
        except SweepError:
            raise
        except Exception as error:
            found = outcome_of(error)
        if isinstance(found, NoMemory) and not alone:
            under_way.narrow(began)
            waiting.appendleft(task)
            work.store.log(
                f"no memory for {described(work.plan, task)} ({found.reason}); it is done again, with at most "
                f"{under_way.most} at a time"
            )
        elif isinstance(found, NoMemory):
            work.without_memory[task] = found.reason
            work.store.log(f"no memory for {described(work.plan, task)}, even alone: {found.reason}")
        elif isinstance(found, Failed):
            work.failed[task.point] = found.reason  # the other tasks of the point go on
            work.store.log(f"FAILED {described(work.plan, task)}: {found.reason}")
        else:
            waiting.extendleft(work.finish(task, found if isinstance(found, bytes) else None))
            work.store.log(f"done {described(work.plan, task)} in {time.monotonic() - began:.2f} s")
            bar.advance(task.samples if task.derivative is None else 0)
            bar.note(f"{work.complete} of {work.plan.points.number} points")


class _UnderWay:
    """The tasks that an executor has been given. `began`: when each was. `most`: how many at a time are allowed, if
    fewer than the executor takes.
    """

    def __init__(self, executor: Executor):
        self._executor = executor
        self._futures: dict[Task, Pending] = {}
        self._ended: queue.SimpleQueue[tuple[Task, Pending]] = queue.SimpleQueue()
        self._not_alone: set[Task] = set()
        self.began: dict[Task, float] = {}
        self.most: int | None = None
        self._narrowed = 0.0

    @property
    def has_room(self) -> bool:
        """Whether another task may begin."""
        return len(self.began) < (self._executor.at_once if self.most is None else self.most)

    def narrow(self, began: float) -> None:
        """Allow fewer tasks at a time, because there was no memory for one that `began` then.

        Half of those that were worked on: as many again wait in the executor. Tasks that were under way together
        narrow it once.
        """
        if began >= self._narrowed:
            self.most, self._narrowed = max(1, (len(self.began) + 1) // 4), time.monotonic()

    def is_alone(self, task: Task) -> bool:
        """Whether no other task was under way since this one began."""
        return task not in self._not_alone

    def begin(self, task: Task) -> None:
        self._not_alone.discard(task)
        if self.began:
            self._not_alone |= {task, *self.began}
        future = self._executor.submit(task)
        self._futures[task], self.began[task] = future, time.monotonic()
        future.add_done_callback(lambda done, task=task: self._ended.put((task, done)))

    def next(self) -> Task | None:
        """A task that is done; None if none is within a tenth of a second, so that signals are handled in between."""
        try:
            task, future = self._ended.get(timeout=0.1)
        except queue.Empty:
            return None
        return task if self._futures.get(task) is future else None  # else lost, and begun again

    def result(self, task: Task) -> Outcome | Written:
        """The outcome of a task, which is no longer under way."""
        del self.began[task]
        return self._executor.result(task, self._futures.pop(task))

    def forget(self) -> list[Task]:
        """Forget all tasks that are under way, and return them."""
        tasks = list(self.began)
        self.began.clear()
        self._futures.clear()
        return tasks


def _note_lost(work: Work, again: list[Task], lost: dict[Task, int], error: WorkerDiedError) -> int:
    """Log that tasks are done again; how often one of them has been lost. Raises SweepError if that is too often."""
    for task in again:
        lost[task] = lost.get(task, 0) + 1
    worst = max(again, key=lambda task: lost[task])
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


class ExecutorChoice(NamedTuple):
    """The arguments of `Sweep.run` that say where to simulate."""

    threads: int | None = None
    workers: int | None = None
    executor: "distributed.Client | None" = None
    shared_folder: bool = False

    def check(self, *, has_folder: bool) -> None:
        """Raises ValueError for arguments that exclude each other."""
        names = [name for name in ("threads", "workers", "executor") if getattr(self, name) is not None]
        if len(names) > 1:
            raise ValueError(
                f"Arguments {names[0]} and {names[1]} must not both be given; each says where to simulate."
            )
        checks.truth("shared_folder", self.shared_folder)
        if self.shared_folder and (self.executor is None or not has_folder):
            missing = "a folder" if self.executor is not None else "executor"
            raise ValueError(
                f"Argument shared_folder must be True only with folder and executor, but {missing} was not given; it "
                "lets the workers of a cluster write into the folder of the sweep."
            )

    @contextmanager
    def opened(self, plan: Plan, store: Store) -> Iterator[Executor]:
        """The executor that was asked for, closed at the end."""
        executor = self._executor(plan, store)
        finished = False
        try:
            yield executor
            finished = True
        finally:
            executor.close(wait=finished)

    def _executor(self, plan: Plan, store: Store) -> Executor:
        if self.executor is not None:
            return DaskCluster(plan, self.executor, store, self.shared_folder)
        if self.workers is not None:
            return Processes(plan, checks.whole_number("workers", self.workers))
        usual = max(cores(), len(jax.local_devices()))
        return Threads(plan, usual if self.threads is None else checks.whole_number("threads", self.threads))


def run_sweep(plan: Plan, folder: Path | None, choice: ExecutorChoice, progress: bool | None) -> "xarray.Dataset":
    """Do what is left of a sweep, and return its result; see `Sweep.run`."""
    require_packages()
    choice.check(has_folder=folder is not None)
    _check_dtype(plan)
    if folder is None:
        with TemporaryDirectory(prefix="stickslip-sweep-") as temporary:
            return _run_in(Path(temporary), False, plan, choice, progress)
    return _run_in(folder, True, plan, choice, progress)


def _run_in(folder: Path, kept: bool, asked: Plan, choice: ExecutorChoice, progress: bool | None) -> "xarray.Dataset":
    """`run_sweep` in a folder; `kept`: whether it is the user's."""
    with opened(folder, asked) as (store, plan), stoppable() as stopping, warnings_by_thread():
        store.log(f"begun: {plan.points.number} points, {plan.samples} samples each")
        for _ in range(_ROUNDS):
            work, total = Work(plan, store), plan.points.number * plan.samples
            with choice.opened(plan, store) as executor, progress_bar(progress, total) as bar:
                run_tasks(work, executor, stopping, bar)
            if stopping.requested:
                _stop(work, kept)
            if work.without_memory:
                _raise_no_memory(work, kept)
            dataset = dataset_of(work)
            if work.damaged:
                continue
            path = write_dataset(store, dataset)
            store.check_kept()
            work.remove_leftovers()
            if work.failed:
                _raise_failed(work, path, kept)
            store.log("finished")
            return dataset
        raise SweepError(f"{folder} gives back other bytes than were written; check the disk, and run again.")


def _stop(work: Work, kept: bool) -> None:
    work.store.log("stopped")
    on = f"`stickslip resume {work.store.folder}`, or the same call again, goes on from here."
    raise KeyboardInterrupt(
        f"Stopped with {work.complete} of {work.plan.points.number} points done; "
        + (on if kept else "they are lost, because no folder was given.")
    )


def _raise_no_memory(work: Work, kept: bool) -> None:
    task = min(work.without_memory)
    points = len({one.point for one in work.without_memory})
    what = f"There was no memory for batches of {points} of {work.plan.points.number} points, even one at a time"
    work.store.log(f"stopped: {what}")
    raise SweepError(
        f"{what}, first {described(work.plan, task)} ({work.without_memory[task]}); "
        + (
            f"what is done is kept in {work.store.folder}: run again where there is more memory, or run the sweep with "
            "a smaller batch into another folder."
            if kept
            else "run it with a smaller batch, or where there is more memory, and give a folder, which keeps what is "
            "done."
        )
    )


def _raise_failed(work: Work, path: Path, kept: bool) -> None:
    point = min(work.failed)
    failed = f"{len(work.failed)} of {work.plan.points.number} points failed"
    work.store.log(f"finished, but {failed}")
    raise SweepError(
        f"{failed}, first {work.plan.points.described(point)}: {work.failed[point].rstrip('.')}; "
        + (
            f"{path} has the results of the others, and {work.store.folder / LOG} all reasons."
            if kept
            else "give a folder, which keeps the results of the others."
        )
    )


def _check_dtype(plan: Plan) -> None:
    if str(jnp.result_type(float)) != plan.dtype:
        raise SweepError(
            f"This sweep is in {plan.dtype}, and JAX is set to {jnp.result_type(float)}; call "
            f"jax.config.update('jax_enable_x64', {plan.dtype == 'float64'}) before anything else."
        )
    if plan.dtype == "float32":
        warnings.warn("This sweep runs in float32.", stacklevel=4)
