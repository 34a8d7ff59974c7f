"""Where the tasks of a study are done: in threads, in processes of this machine, or by a cluster of dask."""

import itertools
import threading
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Protocol, runtime_checkable

import jax

from .. import _checks
from .pieces import perform
from .plan import Plan, Task
from .workers import arguments_of_worker, perform_in_worker, prepare_worker


@runtime_checkable
class Executor(Protocol):
    """Does tasks somewhere."""

    @property
    def at_once(self) -> int:
        """How many tasks are worth submitting before the first is done."""
        ...

    def submit(self, task: Task) -> Any:
        """A future of the bytes of the task's piece, with ``add_done_callback`` and ``result``."""
        ...

    def restart(self) -> bool:
        """Make it work again after a worker died; whether it can."""
        ...

    def close(self, *, wait: bool) -> None:
        """End it; what has not begun is cancelled. `wait`: whether to wait for what has."""
        ...


class Threads:
    """Threads of this process; pieces are spread over the devices that JAX has."""

    def __init__(self, plan: Plan, threads: int):
        self._plan, self._threads = plan, threads
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="stickslip study")
        self._devices, self._number = jax.local_devices(), itertools.count()
        self._compiling, self._compiled = threading.Lock(), False

    @property
    def at_once(self) -> int:
        return 2 * self._threads

    def submit(self, task: Task) -> Future[bytes]:
        device = self._devices[next(self._number) % len(self._devices)]
        return self._pool.submit(self._perform, task, device)

    def _perform(self, task: Task, device: Any) -> bytes:
        if not self._compiled:  # the first task compiles what all need, while the others wait
            with self._compiling:
                if not self._compiled:
                    done = self._perform_on(task, device)
                    self._compiled = True
                    return done
        return self._perform_on(task, device)

    def _perform_on(self, task: Task, device: Any) -> bytes:
        if len(self._devices) == 1:
            return perform(self._plan, task)
        with jax.default_device(device):
            return perform(self._plan, task)

    def restart(self) -> bool:
        return False

    def close(self, *, wait: bool) -> None:
        self._pool.shutdown(wait=wait, cancel_futures=True)


class Processes:
    """Processes of this machine, each with one thread. They are spawned: JAX does not survive a fork.

    Those of loky do not run the user's program again, as those of the standard library do.
    """

    def __init__(self, plan: Plan, workers: int):
        try:
            from loky import ProcessPoolExecutor  # noqa: PLC0415 - an extra, loaded when asked for
        except ImportError:
            raise ImportError("Argument workers needs loky: pip install 'stickslip_jax[study]'.") from None
        self._pool_class, self._workers, self._start = ProcessPoolExecutor, workers, arguments_of_worker(plan)
        self._pool = self._new()

    @property
    def at_once(self) -> int:
        return 2 * self._workers

    def _new(self) -> Any:
        return self._pool_class(self._workers, initializer=prepare_worker, initargs=self._start)

    def submit(self, task: Task) -> Future[bytes]:
        return self._pool.submit(perform_in_worker, task)

    def restart(self) -> bool:
        self._pool.shutdown(wait=True, kill_workers=True)
        self._pool = self._new()
        return True

    def close(self, *, wait: bool) -> None:
        self._pool.shutdown(wait=True, kill_workers=not wait)


DIED = (BrokenExecutor,)
"""What a future raises if its worker died."""


@contextmanager
def executor_for(plan: Plan, threads: int | None, workers: int | None, executor: Any) -> Iterator[Executor]:
    """The executor that the arguments of `Study.run` ask for. Raises ValueError where they exclude each other."""
    given = [name for name, value in (("threads", threads), ("workers", workers), ("executor", executor)) if value]
    if len(given) > 1:
        raise ValueError(f"Arguments {given[0]} and {given[1]} must not both be given; each says where to simulate.")
    if executor is not None:
        from .dask_executor import DaskCluster  # noqa: PLC0415 - an extra

        chosen: Executor = DaskCluster(plan, executor)
    elif workers is not None:
        chosen = Processes(plan, _checks.whole_number("workers", workers))
    else:
        from .._fast_cpu import cores  # noqa: PLC0415

        chosen = Threads(plan, cores() if threads is None else _checks.whole_number("threads", threads))
    finished = False
    try:
        yield chosen
        finished = True
    finally:
        chosen.close(wait=finished)
