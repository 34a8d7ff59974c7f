"""The loop that does the tasks of a study."""

import queue
import time
from collections import deque
from typing import Any

from .._ensemble.progress import Progress
from .errors import StudyError
from .executors import Executor, WorkerDiedError
from .plan import Plan, Task
from .stopping import Stopping
from .work import Work
from .workers import Failed

_DEATHS = 3  # of workers while a task was under way, after which the study ends


def run_tasks(work: Work, executor: Executor, stopping: Stopping, bar: Progress) -> None:
    """Do all tasks of `work`, a few at a time, and store each result when it comes.

    Stops after the tasks under way when `stopping` asks for it. Raises StudyError if the folder cannot be written, or
    the workers keep dying.
    """
    waiting, under_way = deque(work.tasks()), _UnderWay(executor)
    lost: dict[Task, int] = {}
    bar.advance(sum(work.done))
    while (waiting and not stopping.requested) or under_way.began:
        while waiting and not stopping.requested and len(under_way.began) < executor.at_once:
            under_way.begin(waiting.popleft())
        task = under_way.next()
        if task is None:
            executor.check()
            continue
        seconds = under_way.seconds(task)
        try:
            found = under_way.result(task)
        except WorkerDiedError as error:
            again = [task, *(under_way.forget() if error.others else ())]
            _note_lost(work, again, lost, error)
            if error.others:
                executor.restart()
            waiting.extendleft(reversed(again))
            continue
        except StudyError:
            raise
        except Exception as error:
            found = Failed(str(error))
        if isinstance(found, Failed):
            work.fail(task, found.reason)
            work.store.log(f"FAILED {_described(work.plan, task)}: {found.reason}")
            continue
        waiting.extendleft(work.finish(task, found if isinstance(found, bytes) else None))
        work.store.log(f"done {_described(work.plan, task)} in {seconds:.2f} s")
        bar.advance(task.samples if task.derivative is None else 0)
        bar.note(f"{work.complete} of {work.plan.points.number} points")


class _UnderWay:
    """The tasks that an executor has been given. `began`: when each was."""

    def __init__(self, executor: Executor):
        self._executor = executor
        self._futures: dict[Task, Any] = {}
        self._ended: queue.SimpleQueue[tuple[Task, Any]] = queue.SimpleQueue()
        self.began: dict[Task, float] = {}

    def begin(self, task: Task) -> None:
        future = self._executor.submit(task)
        self._futures[task], self.began[task] = future, time.monotonic()
        future.add_done_callback(lambda done, task=task: self._ended.put((task, done)))

    def next(self) -> Task | None:
        """A task that is done; None if none is for a moment, so that signals are handled between the waits."""
        try:
            task, future = self._ended.get(timeout=0.1)
        except queue.Empty:
            return None
        return task if self._futures.get(task) is future else None  # else lost, and begun again

    def seconds(self, task: Task) -> float:
        """The time since a task began."""
        return time.monotonic() - self.began[task]

    def result(self, task: Task) -> Any:
        """What came of a task, which is not under way any more."""
        del self.began[task]
        return self._executor.result(task, self._futures.pop(task))

    def forget(self) -> list[Task]:
        """All tasks that are under way, none of which is any more."""
        tasks = list(self.began)
        self.began.clear()
        self._futures.clear()
        return tasks


def _note_lost(work: Work, again: list[Task], lost: dict[Task, int], error: WorkerDiedError) -> None:
    """Log that tasks are done again. Raises StudyError if one of them has been lost too often."""
    for task in again:
        lost[task] = lost.get(task, 0) + 1
    worst = max(again, key=lambda task: lost[task])
    work.store.log(f"a worker died ({error}); {len(again)} pieces are done again")
    if lost[worst] > _DEATHS:
        raise StudyError(
            f"A worker died {lost[worst]} times while it simulated {_described(work.plan, worst)} ({error}); what is "
            "done is kept. Perhaps memory ran out: take fewer workers, and run again."
        ) from error


def _described(plan: Plan, task: Task) -> str:
    what = f"samples {task.first} to {task.end - 1}"
    if task.derivative is not None:
        statistic, wrt = plan.derivatives[task.derivative]
        what = f"derivative of {statistic} by {', '.join(wrt)}"
    return f"{plan.points.described(task.point)}: {what}"
