"""Running a study in a folder: what is left to do is done and stored, then all is put together."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp

from .._ensemble.progress import progress_bar
from .dataset import dataset_of, write_dataset
from .errors import StudyError
from .places import executor_for
from .plan import Plan
from .runner import run_tasks
from .stopping import stoppable
from .store import opened
from .warned import collecting
from .work import Work

if TYPE_CHECKING:
    import xarray

_ROUNDS = 3  # after which pieces that keep coming back damaged are an error of the disk


def run_study(
    plan: Plan, folder: Path, threads: int | None, workers: int | None, executor: Any, shared_folder: bool,
    progress: bool | None,
) -> "xarray.Dataset":  # fmt: skip
    """Do what is left of a study, and return its result; see `Study.run`."""
    _check_dtype(plan)
    with opened(folder, plan) as (store, cut), stoppable() as stopping, collecting():
        store.log(f"begun: {cut.points.number} points, {cut.samples} samples each")
        for _ in range(_ROUNDS):
            work = Work(cut, store)
            with (
                executor_for(cut, store, threads, workers, executor, shared_folder) as chosen,
                progress_bar(progress, cut.points.number * cut.samples) as bar,
            ):
                run_tasks(work, chosen, stopping, bar)
            if stopping.requested:
                _stop(work, folder)
            if work.failed:
                _raise_failed(work)
            dataset = dataset_of(work)
            if not work.damaged:
                write_dataset(store, dataset)
                store.log("finished")
                return dataset
        raise StudyError(f"{folder} gives back other bytes than were written; check the disk, and run again.")


def _stop(work: Work, folder: Path) -> None:
    work.store.log("stopped")
    raise KeyboardInterrupt(
        f"Stopped with {work.complete} of {work.plan.points.number} points done; `stickslip resume {folder}`, or the "
        "same call again, goes on from here."
    )


def _raise_failed(work: Work) -> None:
    point = min(work.failed)
    raise StudyError(
        f"{len(work.failed)} of {work.plan.points.number} points failed, first {work.plan.points.described(point)}: "
        f"{work.failed[point]} The others are stored in {work.store.folder}; its log.txt has all reasons."
    )


def _check_dtype(plan: Plan) -> None:
    if str(jnp.result_type(float)) != plan.dtype:
        raise StudyError(
            f"This study is in {plan.dtype}, and JAX is set to {jnp.result_type(float)}; call "
            f"jax.config.update('jax_enable_x64', {plan.dtype == 'float64'}) before anything else."
        )
    if plan.dtype == "float32":
        warnings.warn("This study runs in float32.", stacklevel=5)
