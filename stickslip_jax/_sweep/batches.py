"""What a task simulates, and its result as bytes that can be written to a file, or sent to another machine."""

import dataclasses
import io
import json
import time
import zipfile
import zlib
from typing import Any, TypedDict

import numpy as np

from .._ensemble.call import simulate_batch
from .._ensemble.data import Retained
from .._ensemble.encoding import Decoder, Encoder
from .._ensemble.parts import EnsembleAccumulator
from .._ensemble.result import Ensemble
from .._events.sticks import FlatSticks
from .._files import unpacked_arrays
from .._sensitivity import Sensitivities, sensitivity
from .._statistics.totals import DIFFERENTIABLE
from .._status import Status
from .errors import DamagedBatchError
from .plan import RETAINED, Plan, Task
from .task_warnings import warnings_of_task

_SUMS = ("moments", "accumulator", "near_grazing_samples")


class Head(TypedDict):
    """What a batch of samples says of itself, and its sums as an `Encoder` writes them."""

    samples: int
    first_sample: int
    status_counts: list[int]
    run_seconds: float
    moments: object
    accumulator: object
    near_grazing_samples: object


class Derivatives(TypedDict):
    """The derivatives of a statistic from samples ``0 .. end - 1``, by parameter, and the warnings about them."""

    end: int
    by: dict[str, dict[str, object]]
    warnings: list[str]
    seconds: float


def perform(plan: Plan, task: Task) -> bytes:
    """Do the work of `task` in this thread. Raises ValueError for a point that cannot be simulated."""
    if task.derivative is None:
        return packed(_simulated(plan, task))
    return json.dumps(_derivatives(plan, task)).encode()


def _simulated(plan: Plan, task: Task) -> Ensemble:
    run = plan.run_at(task.point)
    fewest = min(plan.samples, plan.batch)
    # Joined, the batches keep the first sticks of the point, whatever the size of a batch; each sample has one or more.
    retained = max(0, RETAINED - task.first)
    return simulate_batch(
        run, task.first, task.samples, plan.keep, retained=retained, fewest=fewest, outputs=plan.outputs
    )


def _derivatives(plan: Plan, task: Task) -> Derivatives:
    assert task.derivative is not None
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
    return {"end": task.end, "by": numbers, "warnings": texts, "seconds": time.perf_counter() - started}


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


def unpacked(data: bytes, fields: dict[str, Any], first: int, end: int) -> Ensemble:
    """The ensemble of the batch of samples ``first .. end - 1`` that `perform` made.

    `fields`: from `Plan.fields_at`. Raises DamagedBatchError for other bytes, and for those of other samples.
    """
    try:
        head = head_of(data, first, end)
        arrays = unpacked_arrays(data, _MOST_UNPACKED + 16 * (end - first) * (1 + len(fields["output_units"])))
        decoder = Decoder(arrays["floats"], arrays["integers"])
        found = {name: decoder.decoded(head[name]) for name in _SUMS}
        sticks = {name.removeprefix("stick_"): column for name, column in arrays.items() if name.startswith("stick_")}
        retained = Retained(FlatSticks.of(**sticks), arrays["totals"]) if sticks else None
        outputs = {name: arrays[f"output_{name}"] for name in fields["output_units"]}
        if any(len(column) != end - first for column in outputs.values()):
            raise ValueError("its outputs are of other samples")
        counts = dict(zip(Status, head["status_counts"], strict=True))
        numbers: dict[str, Any] = {name: head[name] for name in ("samples", "first_sample", "run_seconds")}
    except _UNFIT as error:
        raise DamagedBatchError(str(error)) from error
    return Ensemble(
        **fields, **found, **numbers, status_counts=counts, retained=retained, sample_totals=None, flat_sticks=None,
        output_values=outputs,
        threads=1, compile_seconds=0.0,
    )  # fmt: skip


def head_of(data: bytes, first: int, end: int) -> Head:
    """The head of the batch of samples ``first .. end - 1``. Raises DamagedBatchError as `unpacked`."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _head_in(archive, first, end)
    except _UNFIT as error:
        raise DamagedBatchError(str(error)) from error


def _head_in(archive: zipfile.ZipFile, first: int, end: int) -> Head:
    if archive.getinfo("head.json").file_size > _MOST_UNPACKED:
        raise ValueError("its head is too long")
    head = json.loads(archive.read("head.json"))
    samples = end - first
    if (head["first_sample"], head["samples"], sum(head["status_counts"])) != (first, samples, samples):
        raise ValueError(f"it holds {head['samples']} samples from {head['first_sample']} on")
    return head


def derivatives_of(data: bytes, end: int) -> Derivatives:
    """The derivatives that `perform` found from samples ``0 .. end - 1``. Raises DamagedBatchError for other bytes."""
    try:
        found = json.loads(data)
        if found["end"] != end or not found["by"].keys():
            raise ValueError(f"it holds derivatives from {found['end']} samples")
    except _UNFIT as error:
        raise DamagedBatchError(str(error)) from error
    return found


def unfinished_in(head: Head) -> dict[Status, int]:
    """How many samples of a batch did not reach the end, by their status; `head`: from `head_of`."""
    counts = zip(Status, head["status_counts"], strict=True)
    return {status: count for status, count in counts if count and status != Status.FINISHED}


def joined(batches: list[Ensemble]) -> Ensemble:
    """Consecutive batches as one ensemble, merged in their order."""
    first, *_ = batches
    accumulator = EnsembleAccumulator(sum(one.samples for one in batches), first.keep, RETAINED)
    for one in batches:
        accumulator.add_ensemble(one)
    return dataclasses.replace(
        first, samples=accumulator.samples, run_seconds=sum(one.run_seconds for one in batches), **accumulator.found()
    )
