"""Checks of an ensemble that was read: it must be one that a simulation could have given."""

from collections.abc import Mapping
from enum import IntEnum
from typing import Any

import numpy as np

from .. import _checks
from .._dynamics.common.method import Exact, Regularized
from .._events.sticks import NUMBERS, FlatSticks
from .._numerics.moments import Moments
from .._statistics.accumulator import StickAccumulator
from .._statistics.totals import TOTALS
from .._status import Ending, Status
from .._systems.system import System
from .._uncertainty.random_number import RandomNumber
from .setup import MOST_SAMPLES
from .unknown import Unknown

_SLACK = 1e-5  # of t1: sticks of single precision may end so much later, and a few sum to so much more


def check_fields(fields: Mapping[str, Any]) -> None:
    """Raise ValueError, with a few words as its message, for fields that no ensemble has."""
    _checks.positive("t1", fields["t1"], "s")
    _checks.whole_number("samples", fields["samples"], maximum=MOST_SAMPLES)
    _checks.whole_number("first_sample", fields["first_sample"], minimum=0, maximum=MOST_SAMPLES - fields["samples"])
    _checks.whole_number("threads_used", fields["threads"])
    for name in ("compile_seconds", "run_seconds"):
        _checks.non_negative(name, fields[name])
    if fields["dtype"] not in ("float32", "float64"):
        raise ValueError(f"its numbers have the type {_checks.show(fields['dtype'])}")
    words = fields["key_data"]
    if words is not None and (len(words) != 2 or not all(0 <= word < 2**32 for word in words)):
        raise ValueError(f"its key is {_checks.show(words)}")
    _check_kinds(fields)
    counts = fields["status_counts"]
    if min(counts.values()) < 0 or sum(counts.values()) != fields["samples"]:
        raise ValueError(f"it tells the endings of {sum(counts.values())} of {fields['samples']} samples")
    if not 0 <= fields["near_grazing_samples"] <= fields["samples"]:
        raise ValueError(f"it has {fields['near_grazing_samples']} samples near grazing")
    _check_sums(fields["moments"], fields["accumulator"], counts[Status.FINISHED])
    retained = fields["retained"]
    if retained is not None:
        check_sticks(retained.sticks, retained.totals[:, 0], np.ones(len(retained.totals), bool), fields["t1"])
    _check_samples(fields)


def _check_samples(fields: Mapping[str, Any]) -> None:
    """What is held of each sample."""
    counts, flat = fields["status_counts"], fields["flat_sticks"]
    totals = fields["sample_totals"]
    if totals is not None:
        if {len(column) for column in totals} != {fields["samples"]}:
            raise ValueError(f"it has totals of {len(totals.sticks)} of {fields['samples']} samples")
        present = np.bincount(_codes(totals.status, Status, "status"), minlength=len(counts))
        if any(present[status] != counts[status] for status in Status):
            raise ValueError("the endings of its samples are not those that it counts")
        if np.any(totals.slips < 0) or np.any(totals.near_grazing_count < 0):
            raise ValueError("it has negative numbers of slips, or of instants decided by round-off")
    for name, values in fields["output_values"].items():
        if values.shape != (fields["samples"],) or values.dtype.kind != "f":
            raise ValueError(f"it has outputs {_checks.show(name)} of {len(values)} of {fields['samples']} samples")
    if flat is not None and totals is not None:
        check_sticks(flat, totals.stick_time, totals.status == Status.FINISHED, fields["t1"])


def _check_kinds(fields: Mapping[str, Any]) -> None:
    """The objects that a simulation is made from."""
    if not isinstance(fields["system"], System):
        raise ValueError(f"its system is {_checks.show(fields['system'])}")
    if not isinstance(fields["method"], (Exact, Regularized, Unknown, type(None))):
        raise ValueError(f"its method is {_checks.show(fields['method'])}")
    if isinstance(fields["law"], (str, bytes, int, float, dict, list, np.ndarray)):
        raise ValueError(f"its law is {_checks.show(fields['law'])}")
    y0 = fields["y0"]
    for value in y0 if isinstance(y0, tuple) else (None,):
        if not isinstance(value, (RandomNumber, Unknown)) and not np.all(np.isfinite(np.asarray(value, float))):
            raise ValueError(f"its trajectories start at {_checks.show(y0)}")


def _check_sums(moments: object, accumulator: object, finished: int) -> None:
    d = len(TOTALS)
    if not isinstance(moments, Moments) or np.shape(moments.mean) != (d,) or np.shape(moments.scatter) != (d, d):
        raise ValueError("it lacks the sums of its samples")
    if moments.number != finished or not (np.all(np.isfinite(moments.mean)) and np.all(np.isfinite(moments.scatter))):
        raise ValueError(f"its sums are of {moments.number} samples, of which {finished} finished, or are not finite")
    if accumulator is None:
        return
    if not isinstance(accumulator, StickAccumulator):
        raise ValueError(f"its histograms are {_checks.show(accumulator)}")
    if np.any(np.asarray(accumulator.endings) < 0) or int(accumulator.samples.number) != finished:
        raise ValueError(f"its histograms are of {accumulator.samples.number} samples, of which {finished} finished")


def check_sticks(sticks: FlatSticks, stick_time: np.ndarray, finished: np.ndarray, t1: float) -> None:
    """Sticks of samples that finished lie in [0, t1], one after the other, and sum to the stick time."""
    _codes(sticks.ending, Ending, "ending")
    live = finished[sticks.sample]
    start, end = (np.asarray(values, np.float64) for values in (sticks.start, sticks.end))
    late = t1 * (1 + _SLACK)
    again = np.zeros(len(start), bool)
    again[1:] = (sticks.sample[1:] == sticks.sample[:-1]) & (start[1:] < end[:-1] - _SLACK * t1)
    # NaN fails the comparisons, as it should.
    wrong = live & (~((start >= 0) & (end >= start) & (end <= late)) | again)
    if np.any(wrong):
        at = int(np.argmax(wrong))
        raise ValueError(f"it has a stick from {start[at]:g} to {end[at]:g} s, which cannot be with t1 = {t1:g} s")
    if any(np.any(np.isinf(getattr(sticks, name)[live])) for name in NUMBERS):
        raise ValueError("it has sticks at infinite positions")
    sums = np.zeros(len(sticks.count))
    np.add.at(sums, sticks.sample, end - start)
    # In single precision each of many sticks adds round-off of t1, of either sign.
    single = 8 * np.finfo(np.float32).eps if sticks.start.dtype == np.float32 else 0.0
    slack = (_SLACK + single * np.sqrt(sticks.count)) * t1
    if not np.all((np.abs(sums - stick_time) <= slack)[finished]):
        raise ValueError("its sticks do not last for its stick times")


def _codes(values: np.ndarray, kind: type[IntEnum], name: str) -> np.ndarray:
    """`values`, which must be codes of this `kind`."""
    unknown = ~np.isin(values, [int(code) for code in kind])
    if np.any(unknown):
        raise ValueError(f"it has the {name} {values[unknown][0]}, which this version does not know")
    return np.asarray(values, np.int64)
