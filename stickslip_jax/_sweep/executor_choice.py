"""Where a sweep runs: in threads, in processes of this machine, or on a cluster of dask."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax

from .. import _checks
from .._processor import cores
from .dask_executor import DaskCluster
from .executors import Executor, Threads
from .plan import Plan
from .processes import Processes
from .store import Store


class ExecutorChoice(NamedTuple):
    """The arguments of `Sweep.run` that say where to simulate."""

    threads: int | None = None
    workers: int | None = None
    executor: Any = None
    shared_folder: bool = False

    def check(self, *, has_folder: bool) -> None:
        """Raises ValueError for arguments that exclude each other."""
        names = [name for name in ("threads", "workers", "executor") if getattr(self, name) is not None]
        if len(names) > 1:
            raise ValueError(
                f"Arguments {names[0]} and {names[1]} must not both be given; each says where to simulate."
            )
        _checks.truth("shared_folder", self.shared_folder)
        if self.shared_folder and (self.executor is None or not has_folder):
            missing = "a folder" if self.executor is not None else "executor"
            raise ValueError(
                f"Argument shared_folder must be True only with folder and executor, but {missing} was not given; it "
                "lets the workers of a cluster write into the folder of the sweep."
            )

    @contextmanager
    def opened(self, plan: Plan, store: Store) -> Iterator[Executor]:
        """The executor that was asked for, closed at the end."""
        chosen = self._executor(plan, store)
        finished = False
        try:
            yield chosen
            finished = True
        finally:
            chosen.close(wait=finished)

    def _executor(self, plan: Plan, store: Store) -> Executor:
        if self.executor is not None:
            return DaskCluster(plan, self.executor, store, self.shared_folder)
        if self.workers is not None:
            return Processes(plan, _checks.whole_number("workers", self.workers))
        usual = max(cores(), len(jax.local_devices()))
        return Threads(plan, usual if self.threads is None else _checks.whole_number("threads", self.threads))
