"""The work of a study that is left, and how far it has come."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from .._ensemble.result import Ensemble
from .._statistics.registry import STATISTICS
from .pieces import DamagedPieceError, joined, packed, unpacked
from .plan import Plan, Task
from .store import Piece, Store, derivative_name


@dataclass
class Work:
    """The tasks of a study that are left, in order of the points.

    `done`: the samples of each point that are there. `failed`: what went wrong, by point. `complete`: points with
    nothing left to do. `damaged`: pieces that could not be read, and were removed.
    """

    plan: Plan
    store: Store
    done: list[int] = field(default_factory=list)
    failed: dict[int, str] = field(default_factory=dict)
    complete: int = 0
    damaged: int = 0

    def __post_init__(self) -> None:
        self._identities = [self.plan.points.identity(point) for point in range(self.plan.points.number)]
        self._pieces = self.store.pieces()
        self._left: dict[int, int] = {}  # tasks of a point that are not done
        self.done = [0] * self.plan.points.number

    def pieces(self, point: int) -> list[Piece]:
        """The pieces of a point that are there."""
        return self._pieces.get(self._identities[point], [])

    def path_of(self, task: Task) -> Any:
        """The file for the result of a task."""
        return self.store.path_of(self._identities[task.point], task, self.plan)

    def tasks(self) -> Iterator[Task]:
        """What is left to do. With wanted standard errors, the next piece of each point that misses them."""
        for point in range(self.plan.points.number):
            tasks = self._tasks_at(point)
            self._left[point] = len(tasks)
            self.complete += not tasks
            yield from tasks

    def _tasks_at(self, point: int) -> list[Task]:
        pieces, at, gaps = self.pieces(point), 0, []
        for piece in (one for one in pieces if not one.derivative):
            gaps += self._cut(point, at, piece.first)
            self.done[point] += piece.end - piece.first
            at = piece.end
        gaps += self._cut(point, at, self.plan.samples)
        if self.plan.is_adaptive and gaps:
            gaps = gaps[:1] if not self._is_precise(point) else []
        there = {(piece.derivative, piece.end) for piece in pieces}
        for number in range(len(self.plan.derivatives)):
            if (derivative_name(self.plan, number), self.plan.samples) not in there:
                gaps.append(Task(point, 0, self.plan.samples, number))
        return gaps

    def _cut(self, point: int, first: int, end: int) -> list[Task]:
        """The tasks of samples ``first .. end - 1``, which end at multiples of the piece."""
        tasks, piece = [], self.plan.piece
        while first < end:
            after = min(end, (first // piece + 1) * piece)
            tasks.append(Task(point, first, after))
            first = after
        return tasks

    def finish(self, task: Task, data: bytes) -> list[Task]:
        """Store the result of a task; returns what is to be done next because of it."""
        path = self.path_of(task)
        self.store.write(path, data)
        name = "" if task.derivative is None else derivative_name(self.plan, task.derivative)
        pieces = self._pieces.setdefault(self._identities[task.point], [])
        pieces.append(Piece(path, task.first, task.end, name))
        pieces.sort(key=lambda piece: (piece.derivative, piece.first))
        self._left[task.point] -= 1
        if task.derivative is None:
            self.done[task.point] += task.samples
            more = self._next(task)
            self._left[task.point] += len(more)
        else:
            more = []
        if not self._left[task.point]:
            self.complete += 1
            self._join(task.point)
        return more

    def _next(self, task: Task) -> list[Task]:
        if not self.plan.is_adaptive or task.end >= self.plan.samples or self._is_precise(task.point):
            return []
        return self._cut(task.point, task.end, self.plan.samples)[:1]

    def _is_precise(self, point: int) -> bool:
        """Whether the standard errors of a point are as small as wanted."""
        ensemble = self.ensemble(point)
        if ensemble is None:
            return False
        wanted = self.plan.standard_errors.items()
        return all(STATISTICS[name](ensemble).standard_error <= most for name, most in wanted)  # NaN: not yet

    def fail(self, task: Task, reason: str) -> None:
        """Note that a task failed; the others of its point go on."""
        self.failed[task.point] = reason

    def ensemble(self, point: int) -> Ensemble | None:
        """The samples of a point from the first on that are there without a gap; None if there is none.

        Pieces that are damaged end it; they are removed, unless the store is only read.
        """
        found, at = [], 0
        run = self.plan.run_at(point)
        for piece in list(self.pieces(point)):
            if piece.derivative or piece.first != at:
                continue
            try:
                found.append(unpacked(self.store.read(piece), run))
            except (DamagedPieceError, FileNotFoundError) as error:
                if self._was_joined(piece):
                    return self.ensemble(point)
                self._remove(point, piece, str(error))
                break
            at = piece.end
        return joined(found) if len(found) > 1 else found[0] if found else None

    def derivatives(self, point: int) -> dict[str, dict[str, Any]]:
        """The results of the derivatives of a point that are there, by name."""
        found, names = {}, {derivative_name(self.plan, number) for number in range(len(self.plan.derivatives))}
        for piece in list(self.pieces(point)):
            if piece.derivative in names and piece.end == self.plan.samples:
                try:
                    found[piece.derivative] = json.loads(self.store.read(piece))
                except (ValueError, FileNotFoundError) as error:
                    self._remove(point, piece, str(error))
        return found

    def _join(self, point: int) -> None:
        """Make one file of the pieces of samples of a point, if there are several; the files take much space."""
        pieces = [piece for piece in self.pieces(point) if not piece.derivative]
        if len(pieces) < 2:
            return
        whole = self.ensemble(point)
        if whole is None or whole.samples != pieces[-1].end:  # a damaged piece, which is done again
            return
        task = Task(point, 0, whole.samples)
        path = self.path_of(task)
        self.store.write(path, packed(whole))
        others = [piece for piece in self.pieces(point) if piece.derivative]
        self._pieces[self._identities[point]] = [Piece(path, 0, whole.samples), *others]
        for piece in pieces:
            piece.path.unlink(missing_ok=True)

    def _was_joined(self, piece: Piece) -> bool:
        """Whether a run, which this store only watches, has made one file of this one and others; then look again."""
        if self.store.writable or piece.path.exists():
            return False
        self._pieces = self.store.pieces()
        return True

    def _remove(self, point: int, piece: Piece, reason: str) -> None:
        if self.store.writable:
            self.store.log(f"damaged, to be done again: {piece.path.name} ({reason})")
            piece.path.unlink(missing_ok=True)
        self._pieces[self._identities[point]].remove(piece)
        self.damaged += 1
