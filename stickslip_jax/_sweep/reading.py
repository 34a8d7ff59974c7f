"""Reading a sweep without changing its folder, also while a run writes to it."""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from .._status import Status
from .dataset import dataset_of, read_dataset
from .errors import SweepError
from .manifest import sum_of
from .store import Store
from .work import Work

if TYPE_CHECKING:
    import xarray


class SweepStatus(NamedTuple):
    """How far a sweep has come.

    - `points`: their number. `complete`: the number of those that are done.
    - `samples`: how many have been simulated. `most_samples`: how many are wanted; where points end at a standard error
      (`is_adaptive`), the largest number.
    - `endings`: how many samples have each status. `seconds`: time spent simulating, summed over threads.
    - `is_running`: whether a run works on it now. `is_finished`: whether its data set is complete.
    """

    points: int
    complete: int
    samples: int
    most_samples: int
    is_adaptive: bool
    endings: dict[Status, int]
    seconds: float
    is_running: bool
    is_finished: bool


def status_of(folder: Path) -> SweepStatus:
    """The status of the sweep in `folder`. Raises SweepError if there is none."""
    store = Store.reading(folder)
    is_running, is_finished = store.is_in_use, _finished(store) is not None
    # Whether a point has the standard error that was asked for, only a plan that can be run can tell.
    plan = store.plan(to_run=bool(store.body["asked"]["standard_errors"]))
    endings, seconds = dict.fromkeys(Status, 0), 0.0
    work = Work(plan, store)
    for point in range(plan.points.number):
        for head in work.heads(point):
            seconds += head["run_seconds"]
            for status, count in zip(Status, head["status_counts"], strict=True):
                endings[status] += count
    for _ in work.tasks():  # counts what is done, after damaged batches were left out above
        pass
    points = plan.points.number
    return SweepStatus(
        points, points if is_finished else work.complete, sum(work.done), points * plan.samples, plan.is_adaptive,
        endings, seconds, is_running, is_finished,
    )  # fmt: skip


def stored_dataset(folder: Path) -> "xarray.Dataset":
    """The result of the sweep in `folder`, as far as it is stored.

    Raises SweepError if there is none, or one of classes of your own that is not finished.
    """
    store = Store.reading(folder)
    finished = _finished(store)
    return dataset_of(Work(store.plan(), store)) if finished is None else finished


def _finished(store: Store) -> "xarray.Dataset | None":
    """The stored data set, if it is the result of what the manifest asks for."""
    try:
        found = read_dataset(store.folder)
    except (SweepError, OSError, ValueError):  # none, or a damaged one, which the batches replace
        return None
    return found if found.attrs.get("manifest_sha256") == sum_of(store.body) else None
