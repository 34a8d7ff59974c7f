"""The tasks of a sweep that are left, and the batches that are there."""

import contextlib
import pickle
import weakref
from collections.abc import Iterator
from tempfile import SpooledTemporaryFile, gettempdir

from .._ensemble.result import Ensemble
from .._statistics.totals import STATISTICS
from .batches import Derivatives, Head, derivatives_of, head_of, joined, packed, unfinished_in, unpacked
from .errors import DamagedBatchError, SweepError
from .plan import Plan, Task
from .store import Batch, Store, derivative_name

_IN_MEMORY = 2**26  # bytes of what has been read; what is more goes to a temporary file
_LISTINGS = 5  # of the folder at most, where a run that is under way has joined batches since the last


class Work:
    """The tasks of a sweep that are left, in order of the points.

    `done`: the samples of each point that are there. `failed`: what went wrong, by point. `without_memory`: tasks for
    which there was no memory, and the error; a later run does them. `complete`: points with nothing left to do.
    `damaged`: batches that could not be read, and were removed.
    """

    def __init__(self, plan: Plan, store: Store):
        self.plan, self.store = plan, store
        self.done = [0] * plan.points.number
        self.failed: dict[int, str] = {}
        self.without_memory: dict[Task, str] = {}
        self.complete = self.damaged = 0
        self._identities = [plan.points.identity(point) for point in range(plan.points.number)]
        self._batches = store.batches()
        self._left: dict[int, int] = {}  # tasks of a point that are not done
        # A run may join batches while they are read here: what was read once is kept, so that it stays the same.
        self._cache = None if self.store.can_write else ReadCache()

    def _batches_at(self, point: int) -> list[Batch]:
        """The batches of a point that are there."""
        return self._batches.get(self._identities[point], [])

    def _of_samples(self, point: int) -> list[Batch]:
        """The batches of samples of a point, without those of derivatives."""
        return [batch for batch in self._batches_at(point) if not batch.derivative]

    def _batch_of(self, task: Task) -> Batch:
        """The file for the result of a task."""
        return self.store.batch_of(self._identities[task.point], task, self.plan)

    def tasks(self) -> Iterator[Task]:
        """What is left to do. With wanted standard errors, the next batch of each point that misses them."""
        for point in range(self.plan.points.number):
            tasks = self._tasks_at(point)
            self._left[point] = len(tasks)
            if not tasks:
                self.complete += 1
                self._join(point)  # an earlier run may have been stopped before
            yield from tasks

    def _tasks_at(self, point: int) -> list[Task]:
        self.done[point] = sum(batch.end - batch.first for batch in self._of_samples(point))
        tasks = self._missing(point)
        there = {(batch.derivative, batch.end) for batch in self._batches_at(point)}
        for number in range(len(self.plan.derivatives)):
            if (derivative_name(self.plan, number), self.plan.samples) not in there:
                tasks.append(Task(point, 0, self.plan.samples, number))
        return tasks

    def _missing(self, point: int) -> list[Task]:
        """The tasks for samples of a point that are not there; with wanted standard errors, the first of them."""
        gaps, at = [], 0
        for batch in self._of_samples(point):
            gaps += self._tasks_between(point, at, batch.first)
            at = batch.end
        gaps += self._tasks_between(point, at, self.plan.samples)
        if self.plan.is_adaptive and gaps:
            return [] if self._is_precise(point) else gaps[:1]
        return gaps

    def _tasks_between(self, point: int, first: int, end: int) -> list[Task]:
        """The tasks of samples ``first .. end - 1``, which end at multiples of the size of a batch."""
        size = self.plan.batch
        ends = range((first // size + 1) * size, end + size, size) if first < end else ()
        return [Task(point, max(first, after - size), min(after, end)) for after in ends]

    def finish(self, task: Task, data: bytes | None) -> list[Task]:
        """Store the result of a task (None: the worker has stored it); returns the tasks that follow from it."""
        batch = self._batch_of(task)
        if data is not None:
            self.store.write(batch.path, data)
        batches = self._batches.setdefault(self._identities[task.point], [])
        batches.append(batch)
        batches.sort(key=lambda batch: (batch.derivative, batch.first))
        try:
            self._check(task, self.store.read(batch) if data is None else data)
        except DamagedBatchError as error:
            self._remove(task.point, batch, str(error))
            return []
        self._left[task.point] -= 1
        more = []
        if task.derivative is None:
            self.done[task.point] += task.samples
            more = self._missing(task.point) if self.plan.is_adaptive else []
            self._left[task.point] += len(more)
        if not self._left[task.point]:
            self.complete += 1
            self._join(task.point)
        return more

    def _check(self, task: Task, data: bytes) -> None:
        """Log the samples of a result that did not finish. Raises DamagedBatchError for the result of another task."""
        if task.derivative is not None:
            derivatives_of(data, task.end)
            return
        head = head_of(data, task.first, task.end)
        unfinished = ", ".join(f"{count} {status.name}" for status, count in unfinished_in(head).items())
        if unfinished:
            samples = f"samples {task.first} to {task.end - 1}"
            self.store.log(f"not to the end {self.plan.points.described(task.point)}: {samples}: {unfinished}")

    def _is_precise(self, point: int) -> bool:
        """Whether the standard errors of a point are as small as wanted."""
        ensemble = self.ensemble(point)
        if ensemble is None:
            return False
        wanted = self.plan.standard_errors.items()
        return all(STATISTICS[name](ensemble).standard_error <= most for name, most in wanted)  # NaN: not yet

    def ensemble(self, point: int) -> Ensemble | None:
        """The samples of a point from the first on that are there without a gap; None if there is none.

        Samples after a damaged batch are left out; the batch is removed, unless the store is only read. A program that
        only reads gets the same samples every time, also while a run adds batches.
        """
        found, fields = [], self.plan.fields_at(point)
        for batch, data in self._without_gap(point):
            try:
                found.append(unpacked(data, fields, batch.first, batch.end))
            except DamagedBatchError as error:
                self._remove(point, batch, str(error))
                break
        return joined(found) if len(found) > 1 else found[0] if found else None

    def _without_gap(self, point: int) -> list[tuple[Batch, bytes]]:
        """The batches of samples of a point from the first on that are there without a gap."""
        found = None if self._cache is None else self._cache.get(point)
        if found is None:
            found = self._read(point, is_gap_allowed=False)
            if self._cache is not None:
                self._cache.put(point, found)
        return found

    def heads(self, point: int) -> list[Head]:
        """The heads of the batches of samples of a point."""
        found = []
        for batch, data in self._read(point, is_gap_allowed=True):
            with self._damage_removed(point, batch):
                found.append(head_of(data, batch.first, batch.end))
        return found

    def _read(self, point: int, *, is_gap_allowed: bool) -> list[tuple[Batch, bytes]]:
        """The batches of samples of a point that are there, with their bytes."""
        for _ in range(_LISTINGS):
            found, at = [], 0
            try:
                for batch in self._of_samples(point):
                    if batch.first == at or is_gap_allowed:
                        with self._damage_removed(point, batch):
                            found.append((batch, self.store.read(batch)))
                            at = batch.end  # where it is damaged, all that follow come after a gap
                return found
            except FileNotFoundError:
                self._list_again()
        return []

    def _list_again(self) -> None:
        """List the batches again because one is gone. If this program only reads, a run has joined it with others."""
        self._batches = self.store.batches()
        self.damaged += 1

    def derivatives(self, point: int) -> dict[str, Derivatives]:
        """The results of the derivatives of a point that are there, by name."""
        found, names = {}, {derivative_name(self.plan, number) for number in range(len(self.plan.derivatives))}
        for batch in list(self._batches_at(point)):
            if batch.derivative in names and batch.end == self.plan.samples:
                try:
                    with self._damage_removed(point, batch):
                        found[batch.derivative] = derivatives_of(self.store.read(batch), batch.end)
                except FileNotFoundError:
                    self._list_again()
        return found

    def _join(self, point: int) -> None:
        """Join the files of a point, if there are several: each holds histograms, so that one takes less space."""
        batches = self._of_samples(point)
        if len(batches) < 2 or not self.store.can_write:
            return
        whole = self.ensemble(point)
        if whole is None or whole.samples != batches[-1].end:  # a damaged batch, which is done again
            return
        joint = self._batch_of(Task(point, 0, whole.samples))
        self.store.write(joint.path, packed(whole))
        others = [batch for batch in self._batches_at(point) if batch.derivative]
        self._batches[self._identities[point]] = [joint, *others]
        for batch in batches:
            with contextlib.suppress(OSError):  # what is left is not used, and removed at the end
                batch.path.unlink()

    def remove_leftovers(self) -> None:
        """Remove batches whose samples are in a longer one too. For when all of those have been read."""
        self.store.remove_leftovers(self._identities)

    @contextlib.contextmanager
    def _damage_removed(self, point: int, batch: Batch) -> Iterator[None]:
        """Remove a batch in which the block finds damage."""
        try:
            yield
        except DamagedBatchError as error:
            self._remove(point, batch, str(error))

    def _remove(self, point: int, batch: Batch, reason: str) -> None:
        with contextlib.suppress(ValueError):  # the folder was listed again since it was read
            self._batches_at(point).remove(batch)
        self.damaged += 1
        if self.store.can_write:
            self.store.remove(batch, reason)


class ReadCache:
    """The batches of points, with their bytes, as they were when they were read first."""

    def __init__(self) -> None:
        self._file = SpooledTemporaryFile(max_size=_IN_MEMORY)  # noqa: SIM115 - closed with this object
        weakref.finalize(self, self._file.close)
        self._starts: dict[int, int] = {}

    def put(self, point: int, batches: list[tuple[Batch, bytes]]) -> None:
        """Keep what was read of a point. Raises SweepError where there is no room for it."""
        try:
            start = self._file.seek(0, 2)
            pickle.dump(batches, self._file)
        except OSError as error:
            raise SweepError(
                f"{gettempdir()} cannot be written ({error.strerror}), where the batches of a large sweep are kept "
                "while it is read; make room there, or name another folder in the environment variable TMPDIR."
            ) from error
        self._starts[point] = start

    def get(self, point: int) -> list[tuple[Batch, bytes]] | None:
        """What was read of a point; None if nothing was."""
        if point not in self._starts:
            return None
        self._file.seek(self._starts[point])
        return pickle.load(self._file)
