"""Running a sweep in a folder: what is left to do is done and stored, then all is put together."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp

from .. import _checks
from .._ensemble.progress import progress_bar
from .._processor import cores
from .dask_executor import DaskCluster
from .dataset import dataset_of, require_packages, write_dataset
from .errors import SweepError
from .executors import Executor, Processes, Threads
from .plan import Plan
from .runner import described, run_tasks, stoppable
from .store import LOG, Store, opened
from .task_warnings import warnings_by_thread
from .work import Work

if TYPE_CHECKING:
    import distributed
    import xarray

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
            return Processes(plan, _checks.whole_number("workers", self.workers))
        usual = max(cores(), len(jax.local_devices()))
        return Threads(plan, usual if self.threads is None else _checks.whole_number("threads", self.threads))


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
