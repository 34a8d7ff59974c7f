"""The loop that does the tasks of a study."""

import queue
import time
from collections import deque
from concurrent.futures import CancelledError

from .._ensemble.progress import Progress
from .errors import StudyError
from .executors import DIED, Executor
from .plan import Plan, Task
from .stopping import Stopping
from .work import Work

_DEATHS = 3  # of workers while a task was under way, after which it has failed


def run_tasks(work: Work, executor: Executor, stopping: Stopping, bar: Progress) -> None:
    """Do all tasks of `work`, a few at a time, and store each result when it comes.

    Stops after the tasks under way when `stopping` asks for it. Raises StudyError if the folder cannot be written, or
    the workers keep dying.
    """
    plan, waiting, under_way = work.plan, deque(work.tasks()), {}
    ended: queue.SimpleQueue[Task] = queue.SimpleQueue()
    deaths: dict[Task, int] = {}
    bar.advance(sum(work.done))
    while (waiting and not stopping.requested) or under_way:
        while waiting and not stopping.requested and len(under_way) < executor.at_once:
            task = waiting.popleft()
            future = executor.submit(task)
            under_way[task] = (future, time.monotonic())
            future.add_done_callback(lambda _, task=task: ended.put(task))
        try:
            task = ended.get(timeout=0.1)  # signals are handled between the waits
        except queue.Empty:
            continue
        if task not in under_way:
            continue
        future, began = under_way.pop(task)
        try:
            data = future.result()
        except (*DIED, CancelledError) as error:
            lost = [task, *under_way]
            under_way.clear()
            _again(work, lost, deaths, executor, error)
            waiting.extendleft(reversed(lost))
            continue
        except Exception as error:
            work.fail(task, str(error))
            work.store.log(f"FAILED {_described(plan, task)}: {error}")
            continue
        waiting.extendleft(work.finish(task, data))
        work.store.log(f"done {_described(plan, task)} in {time.monotonic() - began:.2f} s")
        bar.advance(task.samples if task.derivative is None else 0)
        bar.note(f"{work.complete} of {plan.points.number} points")


def _again(work: Work, lost: list[Task], deaths: dict[Task, int], executor: Executor, error: BaseException) -> None:
    """Prepare for doing the `lost` tasks again. Raises StudyError if that has been tried often enough."""
    for task in lost:
        deaths[task] = deaths.get(task, 0) + 1
    worst = max(lost, key=lambda task: deaths[task])
    work.store.log(f"a worker died ({error}); {len(lost)} pieces are done again")
    if deaths[worst] > _DEATHS or not executor.restart():
        raise StudyError(
            f"A worker process died {deaths[worst]} times while it simulated {_described(work.plan, worst)} ({error}); "
            "what is done is kept. Perhaps memory ran out: take fewer workers, and run again."
        ) from error


def _described(plan: Plan, task: Task) -> str:
    what = f"samples {task.first} to {task.end - 1}"
    if task.derivative is not None:
        statistic, wrt = plan.derivatives[task.derivative]
        what = f"derivative of {statistic} by {', '.join(wrt)}"
    return f"{plan.points.described(task.point)}: {what}"
