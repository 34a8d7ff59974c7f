"""Doing tasks in a process: this one, a worker process of this machine, or a worker of a cluster."""

import dataclasses
import errno
import functools
import importlib
import importlib.util
import itertools
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import NamedTuple, TypeAlias

import jax

from .. import _compilation_cache
from .batches import perform
from .manifest import versions
from .plan import Plan, Task
from .task_warnings import warnings_by_thread


class UnfitWorkerError(RuntimeError):
    """A worker that cannot do tasks of a sweep; the message is a sentence that says what to do."""


class Failed(NamedTuple):
    """The outcome for a point that cannot be simulated."""

    reason: str


class NoMemory(NamedTuple):
    """The outcome of a task for which there was no memory."""

    reason: str


Outcome: TypeAlias = bytes | Failed | NoMemory
"""What comes of a task: its result, or why there is none."""


_NO_MEMORY = ("RESOURCE_EXHAUSTED", "std::bad_alloc", "MemoryError", "can't start new thread")
"""What errors of JAX, and of what it calls, say where there is no memory."""


def outcome_of(error: Exception) -> Failed | NoMemory:
    """What an error in a task means. Its reason is never empty."""
    said = " ".join(str(error).split())
    kind = type(error).__name__
    if not said or not isinstance(error, ValueError):
        said = f"{kind}: {said}" if said else kind
    no_memory = isinstance(error, OSError) and error.errno == errno.ENOMEM
    if no_memory or isinstance(error, MemoryError) or any(part in said for part in _NO_MEMORY):
        return NoMemory(said)
    return Failed(said)


def attempted(perform: Callable[[Task], bytes], task: Task) -> Outcome:
    """Do a task. Raises errors that have other causes than its point or the memory."""
    try:
        return perform(task)
    except Exception as error:
        outcome = outcome_of(error)
        if isinstance(error, ValueError) or isinstance(outcome, NoMemory):
            return outcome
        raise


class Performer:
    """Does tasks of a plan in any threads of this process, spread over the devices that JAX has here."""

    def __init__(self, plan: Plan):
        self._plan, self._devices, self._number = plan, jax.local_devices(), itertools.count()
        self._compiling = [threading.Lock() for _ in self._devices]
        self._compiled: set[int] = set()

    def perform(self, task: Task) -> bytes:
        """Do a task. Raises ValueError for a point that cannot be simulated."""
        device = next(self._number) % len(self._devices)
        if device not in self._compiled:  # the first task compiles what all need, while the others wait
            with self._compiling[device]:
                if device not in self._compiled:
                    done = self._on(device, task)
                    self._compiled.add(device)
                    return done
        return self._on(device, task)

    def _on(self, device: int, task: Task) -> bytes:
        with jax.default_device(self._devices[device]) if len(self._devices) > 1 else nullcontext():
            return perform(self._plan, task)


# --- sending


class Sent(NamedTuple):
    """A plan that is sent to other processes, and what these must have in common with this one.

    `caches`: whether compilations are kept here, as they then are there.
    """

    plan: bytes
    double: bool
    versions: dict[str, str]
    caches: bool


def sent(plan: Plan) -> Sent:
    """The plan for a worker. Raises ValueError for one that cannot be sent."""
    caches = bool(getattr(jax.config, "jax_compilation_cache_dir", None))
    return Sent(_dumps(plan), plan.dtype == "float64", versions(), caches)


def _dumps(plan: Plan) -> bytes:
    # cloudpickle comes with loky and dask, and sends the classes of notebooks too
    pickler = importlib.import_module("cloudpickle" if importlib.util.find_spec("cloudpickle") else "pickle")
    try:
        return pickler.dumps(dataclasses.replace(plan))  # without what it has computed
    except Exception as error:  # pickling a user's object may raise anything
        raise ValueError(
            "Arguments system and law must be objects that can be sent to other processes, but pickling them failed "
            f"({error}); define their classes in a module, or install cloudpickle."
        ) from error


def perform_sent(plan: Sent, task: Task) -> Outcome:
    """Do a task of a plan that was sent. Raises UnfitWorkerError where this process cannot."""
    with _precision.of(plan.double), warnings_by_thread():
        with _reading:  # one performer for all threads, whose compilations they share
            performer = _performer(plan.plan, tuple(sorted(plan.versions.items())), plan.caches)
        return attempted(performer.perform, task)


_reading = threading.Lock()


@functools.lru_cache(maxsize=4)  # sweeps that run at once on one worker do not throw out each other
def _performer(plan: bytes, wanted: tuple[tuple[str, str], ...], caches: bool) -> Performer:
    if caches:
        _compilation_cache.use()
    here = versions()
    other = [f"{name} {here.get(name)} instead of {version}" for name, version in wanted if here.get(name) != version]
    if other:
        raise UnfitWorkerError(
            f"A worker has {', '.join(other)}, which may give other numbers; install the same versions everywhere."
        )
    try:
        return Performer(pickle.loads(plan))
    except Exception as error:  # unpickling a user's object may raise anything
        raise UnfitWorkerError(
            f"A worker cannot read the sweep ({error}); the modules that define its system and law must be installed "
            "where the workers run."
        ) from error


class _Precision:
    """The precision of JAX is of the whole process: tasks in another one wait until no task runs."""

    def __init__(self) -> None:
        self._changed, self._running = threading.Condition(), 0

    @contextmanager
    def of(self, double: bool) -> Iterator[None]:
        """Keep JAX in this precision while the block runs."""
        with self._changed:
            self._changed.wait_for(lambda: not self._running or jax.config.read("jax_enable_x64") == double)
            if jax.config.read("jax_enable_x64") != double:
                jax.config.update("jax_enable_x64", double)
            self._running += 1
        try:
            yield
        finally:
            with self._changed:
                self._running -= 1
                self._changed.notify_all()


_precision = _Precision()

# --- worker processes of this machine

_SETTINGS = (
    "jax_enable_x64",
    "jax_platforms",
    "jax_compilation_cache_dir",
    "jax_compilation_cache_max_size",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)
_plan_of_process: list[Sent] = []


def start_of_process(plan: Plan) -> tuple[Sent, dict[str, object], int]:
    """The arguments of `prepare_process`. Raises ValueError for a plan that cannot be sent."""
    return sent(plan), {name: getattr(jax.config, name) for name in _SETTINGS}, os.getpid()


def prepare_process(plan: Sent, settings: dict[str, object], parent: int) -> None:
    """Set JAX as in the main process; once in every worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all processes, and the main one decides
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    for name, value in settings.items():
        jax.config.update(name, value)
    _plan_of_process[:] = [plan]


def _end_with(parent: int) -> None:
    """End this process soon after its parent, which may have been killed."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def perform_in_process(task: Task) -> Outcome:
    """Do a task of the sweep that the process was started for."""
    return perform_sent(_plan_of_process[0], task)
