"""The loop that does the tasks of a sweep, until all are done or Ctrl-C stops it."""

import queue
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from .._ensemble.progress import Progress
from .errors import SweepError
from .executors import Executor, Pending, WorkerDiedError, Written
from .plan import Plan, Task
from .work import Work
from .workers import Failed, NoMemory, Outcome, outcome_of

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
