"""What a sweep simulates, checked, and cut into tasks; what a task simulates, its result as bytes, and the process that
does it.
"""

import dataclasses
import errno
import functools
import importlib
import importlib.util
import io
import itertools
import json
import os
import pickle
import signal
import threading
import time
import warnings
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias, cast, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._dynamics.simulate import Output
from .._dynamics.sticks import FlatSticks
from .._ensemble.data import EnsembleAccumulator, Keep, Retained
from .._ensemble.encoding import DamagedFileError, Decoder, Encoder, SweepError, versions
from .._ensemble.ensemble import Ensemble, simulate_batch
from .._ensemble.points import Points, Setter, SweepSetting, check_points, setter_of
from .._ensemble.setup import MOST_SAMPLES, AtEnd, EnsembleSetup, fields_of_outputs
from .._foundation import checks
from .._foundation.files import unpacked_arrays
from .._foundation.processes import require_memory
from .._foundation.types import Status
from .._numerics.elementary import key_data_of
from .._sensitivity.call import sensitivity
from .._sensitivity.estimate import Sensitivities
from .._statistics.quantities import DISTRIBUTIONS, Numbering
from .._statistics.totals import DIFFERENTIABLE, STATISTICS
from .._uncertainty.numbers import parameters_of

# What a sweep simulates, checked: its setting, points and options, and the tasks into which its work is divided.


Derivative = tuple[str, tuple[str, ...]]
"""A statistic, and the parameters by which it is differentiated."""

_SMALLEST_BATCH, _LARGEST_BATCH, _BATCHES = 1024, 16_384, 64
_MOST_BATCHES = 10_000_000
RETAINED = 20_000
"""The most sticks of a point that are kept for standard errors."""


class Task(NamedTuple):
    """A part of the work, done by one thread: samples ``first .. end - 1`` of a point; or, where `derivative` is not
    None, the derivatives of that number at the point, from all its samples.
    """

    point: int
    first: int
    end: int
    derivative: int | None = None

    @property
    def samples(self) -> int:
        """How many samples it simulates."""
        return self.end - self.first


@dataclasses.dataclass(eq=False)
class Plan:
    """The arguments of a `Sweep`, which every worker needs. Raises ValueError, with their names, for unsuitable ones.

    What may be given in several ways was checked before: `checked_keep`, `checked_statistics` and the like.
    """

    setting: SweepSetting
    points: Points
    t1: float
    samples: int
    key_data: tuple[int, ...] | None
    keep: Keep
    numbering: Numbering
    statistics: tuple[str, ...]
    derivatives: tuple[Derivative, ...]
    independent: bool
    standard_errors: dict[str, float]
    realizations: int
    batch: int
    dtype: str
    outputs: dict[str, Output] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        checks.truth("independent", self.independent)
        checks.positive("t1", self.t1, "s")
        self.t1, self.independent = float(self.t1), bool(self.independent)
        self.samples = checks.whole_number("samples", self.samples, maximum=MOST_SAMPLES)
        self.realizations = checks.whole_number("realizations", self.realizations, minimum=0)
        require_memory("realizations", 4096.0 * self.realizations * self.points.number, "the times of their sticks")
        self.batch = checks.whole_number("batch", self.batch, maximum=MOST_SAMPLES)
        if self.points.number * -(-self.samples // self.batch) > _MOST_BATCHES:
            raise checks.refused("batch", f"be larger, for at most {_MOST_BATCHES:,} batches in all", self.batch)

    @property
    def output_code(self) -> list[list[str]]:
        """Name, unit and a check sum of the code of each output: functions themselves are not stored."""
        return [[name, output.unit, output.code_sum] for name, output in sorted(self.outputs.items())]

    @cached_property
    def _with_values(self) -> Setter:
        return setter_of(self.setting, self.points.parameters)

    def setting_at(self, point: int) -> SweepSetting:
        """What is simulated at a point."""
        return self._with_values(self.points.values(point))

    def key_at(self, point: int) -> Array | None:
        """The key of a point: the sweep's, or one that depends on the values of the parameters there too."""
        if self.key_data is None:
            return None
        key = jax.random.wrap_key_data(jnp.array(self.key_data, jnp.uint32))
        if self.independent:
            identity = self.points.identity(point)
            for word in (identity[:8], identity[8:]):
                key = jax.random.fold_in(key, int(word, 16))
        return key

    def run_at(self, point: int) -> EnsembleSetup:
        """The checked ensemble of a point."""
        setting = self.setting_at(point)
        return EnsembleSetup.checked(
            setting.model, self.t1, self.samples, 0, self.key_at(point), None,
            setting.method, self.keep, self.numbering,
        )  # fmt: skip

    def fields_at(self, point: int) -> dict[str, Any]:
        """The fields of the `Ensemble` of a point that its arguments are, without what only simulating it needs."""
        fields = {name: getattr(self, name) for name in ("t1", "numbering", "dtype")}
        fields |= fields_of_outputs(self.outputs)
        return {**self.setting_at(point)._asdict(), **fields, "key_data": key_data_in(self.key_at(point))}

    def check(self) -> None:
        """Check every point as far as that is possible without simulating. Raises ValueError for what does not fit."""
        check_points(self._with_values, self.points, self.setting_at)
        for _, wrt in self.derivatives:
            parameters_of(self.setting_at(0).model._asdict(), wrt)
        try:
            AtEnd(self.run_at(0), self.outputs)
        except ValueError as error:
            raise ValueError(f"The point {self.points.described(0)} cannot be simulated: {error}") from error


def usual_batch(points: int, samples: int) -> int:
    """How many samples make a batch: few batches are too coarse for several threads, many cost time for each."""
    fair = -(-points * samples // (_BATCHES * 256)) * 256
    return min(max(fair, _SMALLEST_BATCH), _LARGEST_BATCH)


def checked_statistics(statistics: object, keep: Keep) -> tuple[str, ...]:
    """The names of what is estimated; None for all that `keep` allows. Raises ValueError for other names."""
    more = [] if keep == "totals" else [quantity.name for quantity in DISTRIBUTIONS]
    known = list(dict.fromkeys([*STATISTICS, *more]))  # the stick fraction has a distribution too
    if statistics is None:
        return tuple(known)
    names = [statistics] if isinstance(statistics, str) else statistics
    names = [getattr(name, "name", name) for name in names] if isinstance(names, (list, tuple)) else [names]
    for name in names:
        if not isinstance(name, str) or name not in known:
            hint = 'keep="statistics" offers more' if keep == "totals" else ""
            raise checks.refused("statistics", f"be names out of {', '.join(map(repr, known))}", name, hint)
    return tuple(dict.fromkeys(names))


def checked_derivatives(sensitivities: object) -> tuple[Derivative, ...]:
    """The derivatives as pairs of names. Raises ValueError for anything else."""
    known = [statistic.name for statistic in DIFFERENTIABLE]
    found = []
    entries = sensitivities if isinstance(sensitivities, Iterable) else [sensitivities]  # which is no pair
    if isinstance(sensitivities, (str, bytes, Mapping)) or hasattr(sensitivities, "__array__"):
        entries = [sensitivities]
    for entry in entries:
        pair = tuple(entry) if isinstance(entry, (list, tuple)) and len(entry) == 2 else (entry, None)
        statistic, wrt = getattr(pair[0], "name", pair[0]), pair[1]
        wrt = (wrt,) if isinstance(wrt, str) else tuple(wrt) if isinstance(wrt, (list, tuple)) else ()
        named = isinstance(statistic, str) and all(isinstance(name, str) for name in wrt)
        if not named or statistic not in known or not wrt:
            wanted = (
                "hold pairs of a statistic and the parameter, or parameters, by which it is differentiated, such as "
                f"('mean_stick_duration', 'mu'), with a statistic out of {', '.join(map(repr, known))}"
            )
            raise checks.refused("sensitivities", wanted, entry)
        found.append((statistic, wrt))
    return tuple(dict.fromkeys(found))


def checked_errors(standard_error: object, statistics: tuple[str, ...]) -> dict[str, float]:
    """The wanted standard errors by statistic. Raises ValueError for anything else."""
    if standard_error is None:
        return {}
    if not isinstance(standard_error, dict) or not standard_error:
        wanted = "be a dict from names of statistics to standard errors, such as {'mean_stick_duration': 0.01}"
        raise checks.refused("standard_error", wanted, standard_error)
    for name, value in standard_error.items():
        if name not in STATISTICS or name not in statistics:
            allowed = ", ".join(repr(one) for one in statistics if one in STATISTICS)
            raise checks.refused("standard_error", f"name statistics out of {allowed}", name)
        checks.positive(f"standard_error[{name!r}]", value)
    return {name: float(value) for name, value in standard_error.items()}


def checked_keep(keep: object) -> Keep:
    """`keep`, "statistics" or "totals". Raises ValueError for anything else."""
    allowed = [name for name in get_args(Keep) if name != "sticks"]
    if not isinstance(keep, str) or keep not in allowed:
        hint = "every stick of a point comes from sweep.ensemble_at(mu=...)"
        raise checks.refused("keep", f"be one of {', '.join(map(repr, allowed))}", keep, hint)
    return cast(Keep, keep)


def key_data_in(key: Array | None) -> tuple[int, ...] | None:
    """The numbers of `key`; None where there is none."""
    return None if key is None else tuple(int(word) for word in np.asarray(key_data_of(key)))


# Warnings of tasks that run in several threads, collected task by task.
#
# ``warnings.catch_warnings`` is of the whole process: in threads, one task would catch the warnings of another.


_local = threading.local()
_lock, _filters = threading.Lock(), ExitStack()
_users: list[None] = []
"""An entry for each `warnings_by_thread` that is in force."""


@contextmanager
def warnings_of_task() -> Iterator[list[str]]:
    """The texts of the RuntimeWarnings of this thread while the block runs, inside of `warnings_by_thread`."""
    _local.texts = texts = []
    try:
        yield texts
    finally:
        _local.texts = None


@contextmanager
def warnings_by_thread() -> Iterator[None]:
    """Gives the RuntimeWarnings of a thread to its `warnings_of_task`, and shows those of other threads.

    Several threads may use it at once: the filters of warnings, which all threads share, come back when the last one
    leaves.
    """
    with _lock:
        if not _users:
            _filters.enter_context(warnings.catch_warnings())
            warnings.simplefilter("always", RuntimeWarning)
            warnings.filterwarnings("ignore", "stickslip_jax runs in float32")  # the sweep says so once
            show = warnings.showwarning

            def show_or_collect(message: Warning | str, *where: Any, **more: Any) -> None:
                texts = getattr(_local, "texts", None)
                if texts is None:
                    show(message, *where, **more)
                else:
                    texts.append(str(message))

            warnings.showwarning = show_or_collect
        _users.append(None)
    try:
        yield
    finally:
        with _lock:
            _users.pop()
            if not _users:
                _filters.close()


# What a task simulates, and its result as bytes that can be written to a file, or sent to another machine.


_SUMS = ("moments", "accumulator", "near_grazing_samples")


def perform(plan: Plan, task: Task) -> bytes:
    """Do the work of `task` in this thread. Raises ValueError for a point that cannot be simulated."""
    if task.derivative is None:
        # Joined, the batches keep the first sticks of the point, whatever the size of a batch; each sample has one or
        # more.
        setup, retained = plan.run_at(task.point), max(0, RETAINED - task.first)
        own = (task.first, task.samples, plan.keep)
        return packed(simulate_batch(setup, *own, retained=retained, outputs=plan.outputs))
    name, wrt = plan.derivatives[task.derivative]
    statistic = next(one for one in DIFFERENTIABLE if one.name == name)
    setting, started = plan.setting_at(task.point), time.perf_counter()
    with warnings_of_task() as texts:
        found = sensitivity(
            statistic, *setting.model[:2], wrt=wrt, t1=plan.t1, samples=task.samples, key=plan.key_at(task.point),
            y0=setting.y0, method=setting.method, threads=1,
        )  # fmt: skip
    names = ("value", "value_error", "derivative", "standard_error", "estimator", "samples", "sticks_in_window")
    assert isinstance(found, Sensitivities)  # as `wrt` is a tuple
    numbers = {parameter: {name: getattr(one, name) for name in names} for parameter, one in found.items()}
    spent = time.perf_counter() - started
    return json.dumps({"end": task.end, "by": numbers, "warnings": texts, "seconds": spent}).encode()


def packed(ensemble: Ensemble) -> bytes:
    """The sums and retained sticks of an ensemble as bytes; what `unpacked` needs to make it again."""
    encoder, retained = Encoder(), ensemble.retained
    head = {name: encoder.encoded(getattr(ensemble, name)) for name in _SUMS}
    head |= {
        "samples": ensemble.samples,
        "first_sample": ensemble.first_sample,
        "status_counts": [int(ensemble.status_counts[status]) for status in Status],
        "run_seconds": ensemble.run_seconds,
    }
    arrays = {"floats": encoder.floats, "integers": encoder.integers}
    arrays |= {f"output_{name}": column for name, column in ensemble.output_values.items()}
    if retained is not None:
        arrays |= {f"stick_{name}": column for name, column in retained.sticks.columns.items()}
        arrays["totals"] = retained.totals
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("head.json", json.dumps(head))
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as entry:
                np.lib.format.write_array(entry, np.asarray(array), allow_pickle=False)
    return buffer.getvalue()


_MOST_UNPACKED = 2**28  # bytes of a batch besides its outputs: sums, histograms, and the sticks that it keeps
_UNFIT = (
    zipfile.BadZipFile, zlib.error, ArithmeticError, AttributeError, EOFError, LookupError, NotImplementedError,
    RecursionError, TypeError, ValueError,
)  # fmt: skip
"""What reading bytes raises that `packed` did not make."""


@contextmanager
def _damage_told() -> Iterator[None]:
    """Raises DamagedFileError where the block reads bytes that `perform` did not make."""
    try:
        yield
    except _UNFIT as error:
        raise DamagedFileError(str(error)) from error


@_damage_told()
def unpacked(data: bytes, fields: dict[str, Any], first: int, end: int) -> Ensemble:
    """The ensemble of the batch of samples ``first .. end - 1`` that `perform` made.

    `fields`: from `Plan.fields_at`. Raises DamagedFileError for other bytes, and for those of other samples.
    """
    head = head_of(data, first, end)
    arrays = unpacked_arrays(data, _MOST_UNPACKED + 16 * (end - first) * (1 + len(fields["output_units"])))
    decoder = Decoder(arrays["floats"], arrays["integers"])
    sticks = {name.removeprefix("stick_"): column for name, column in arrays.items() if name.startswith("stick_")}
    outputs = {name: arrays[f"output_{name}"] for name in fields["output_units"]}
    if any(len(column) != end - first for column in outputs.values()):
        raise ValueError("its outputs are of other samples")
    return Ensemble(
        **fields,
        **{name: decoder.decoded(head[name]) for name in _SUMS},
        **{name: head[name] for name in ("samples", "first_sample", "run_seconds")},
        status_counts=dict(zip(Status, head["status_counts"], strict=True)),
        retained=Retained(FlatSticks.of(**sticks), arrays["totals"]) if sticks else None,
        sample_totals=None,
        flat_sticks=None,
        output_values=outputs,
        threads=1,
        compile_seconds=0.0,
    )


@_damage_told()
def head_of(data: bytes, first: int, end: int) -> dict[str, Any]:
    """What the batch of samples ``first .. end - 1`` says of itself, as `packed` wrote it: their numbers, how many have
    each status, and their sums. Raises DamagedFileError as `unpacked`.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if archive.getinfo("head.json").file_size > _MOST_UNPACKED:
            raise ValueError("its head is too long")
        head = json.loads(archive.read("head.json"))
    samples = end - first
    if (head["first_sample"], head["samples"], sum(head["status_counts"])) != (first, samples, samples):
        raise ValueError(f"it holds {head['samples']} samples from {head['first_sample']} on")
    return head


@_damage_told()
def derivatives_of(data: bytes, end: int) -> dict[str, Any]:
    """The derivatives that `perform` found from samples ``0 .. end - 1``: `by` parameter, with `warnings` about them.

    Raises DamagedFileError for other bytes.
    """
    found = json.loads(data)
    if found["end"] != end or not found["by"].keys():
        raise ValueError(f"it holds derivatives from {found['end']} samples")
    return found


def joined(batches: list[Ensemble]) -> Ensemble:
    """Consecutive batches as one ensemble, merged in their order."""
    first, *_ = batches
    accumulator = EnsembleAccumulator(sum(one.samples for one in batches), first.keep, RETAINED)
    for one in batches:
        accumulator.add_ensemble(one)
    return dataclasses.replace(
        first, samples=accumulator.samples, run_seconds=sum(one.run_seconds for one in batches), **accumulator.found()
    )


# Doing tasks in a process: this one, a worker process of this machine, or a worker of a cluster.


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


class Performer:
    """Does tasks of a plan in any threads of this process, spread over the devices that JAX has here."""

    def __init__(self, plan: Plan):
        self._plan, self._number = plan, itertools.count()
        self._devices = [(device, threading.Lock()) for device in jax.local_devices()]
        self._compiled: set[object] = set()

    def perform(self, task: Task) -> bytes:
        """Do a task. Raises ValueError for a point that cannot be simulated."""
        device, compiling = self._devices[next(self._number) % len(self._devices)]
        with jax.default_device(device) if len(self._devices) > 1 else nullcontext():
            with compiling:  # the first task compiles what all need, while the others wait
                if device not in self._compiled:
                    done = perform(self._plan, task)
                    self._compiled.add(device)
                    return done
            return perform(self._plan, task)


# --- sending


class Sent(NamedTuple):
    """A plan that is sent to other processes, and what these must have in common with this one."""

    plan: bytes
    double: bool
    versions: tuple[tuple[str, str], ...]


def sent(plan: Plan) -> Sent:
    """The plan for a worker. Raises ValueError for one that cannot be sent."""
    # cloudpickle comes with loky and dask, and sends the classes of notebooks too
    pickler = importlib.import_module("cloudpickle" if importlib.util.find_spec("cloudpickle") else "pickle")
    try:
        data = pickler.dumps(dataclasses.replace(plan))  # without what it has computed
    except Exception as error:  # pickling a user's object may raise anything
        raise ValueError(
            "Arguments system and law must be objects that can be sent to other processes, but pickling them failed "
            f"({error}); define their classes in a module, or install cloudpickle."
        ) from error
    return Sent(data, plan.dtype == "float64", tuple(sorted(versions().items())))


def perform_sent(plan: Sent, task: Task) -> Outcome:
    """Do a task of a plan that was sent.

    Raises SweepError where this process cannot, and errors that have other causes than the point or the memory.
    """
    with _in_precision(plan.double), warnings_by_thread():
        with _reading:  # one performer for all threads, whose compilations they share
            performer = _performer(plan)
        try:
            return performer.perform(task)
        except Exception as error:
            outcome = outcome_of(error)
            if isinstance(error, ValueError) or isinstance(outcome, NoMemory):
                return outcome
            raise


_reading = threading.Lock()


@functools.lru_cache(maxsize=4)  # sweeps that run at once on one worker do not throw out each other
def _performer(plan: Sent) -> Performer:
    here = versions()
    differing = [(name, version) for name, version in plan.versions if here.get(name) != version]
    other = [f"{name} {here.get(name)} instead of {version}" for name, version in differing]
    if other:
        raise SweepError(
            f"A worker has {', '.join(other)}, which may give other numbers; install the same versions everywhere."
        )
    try:
        return Performer(pickle.loads(plan.plan))
    except Exception as error:  # unpickling a user's object may raise anything
        raise SweepError(
            f"A worker cannot read the sweep ({error}); the modules that define its system and law must be installed "
            "where the workers run."
        ) from error


_changed = threading.Condition()
_running: list[None] = []
"""An entry for each task that runs. The precision of JAX is of the whole process: tasks in another one wait."""


@contextmanager
def _in_precision(double: bool) -> Iterator[None]:
    """Keep JAX in this precision while the block runs."""
    with _changed:
        _changed.wait_for(lambda: not _running or jax.config.read("jax_enable_x64") == double)
        if jax.config.read("jax_enable_x64") != double:
            jax.config.update("jax_enable_x64", double)
        _running.append(None)
    try:
        yield
    finally:
        with _changed:
            _running.pop()
            _changed.notify_all()


# --- worker processes of this machine

SETTINGS = (
    "jax_enable_x64",
    "jax_platforms",
    "jax_compilation_cache_dir",
    "jax_compilation_cache_max_size",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)
_plan_of_process: list[Sent] = []


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
