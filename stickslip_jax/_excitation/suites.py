"""Suites of recorded ground motions: many records, each at one scale or at several, as one law."""

import hashlib
import os
from collections.abc import Sequence
from typing import Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from .._compiler.native import neighbours
from .._foundation import checks
from .._foundation.fields import Checked, Quantity, is_distribution
from .._foundation.types import AnyArray, Number, Scalar
from .._uncertainty.families import Discrete, RandomNumber
from .reading import read_acceleration_csv, read_at2
from .recorded import GroundAcceleration, GroundMotion
from .segments import no_key

_READERS = {".at2": read_at2, ".csv": read_acceleration_csv}
_ROUND_OFF = 4  # units in the last place of the duration: times that far from equal steps are equal steps


class StoredRecords(Checked):
    """The points of many records, one record after the other, each stored once.

    Args:
        accelerations: m/s^2, (points,).
        first: Where each record begins, and last the number of all points, (records + 1,).
        steps: s, between the points of each record, (records,).
        times: s, from 0 in each record, (points,); empty where all records have equal steps.
        names: Of the records.
    """

    accelerations: Float[AnyArray, " points"]
    first: Int[AnyArray, " begins"]
    steps: Float[AnyArray, " records"]
    times: Float[AnyArray, " times"]
    names: tuple[str, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, records: Any) -> "StoredRecords":
        """Those of a record, a list of records, or the files in a folder. Raises ValueError for anything else."""
        names: Sequence[str] | None = None
        wanted = "be a list of GroundAccelerations, or the name of a folder with AT2 or CSV files"
        if isinstance(records, (str, os.PathLike)):
            files = sorted(one for one in checks.path("records", records).glob("*") if one.suffix.lower() in _READERS)
            names = [one.stem for one in files]
            records = [_READERS[one.suffix.lower()](one) for one in files] or str(records)
        records = [records] if isinstance(records, GroundAcceleration) else records
        is_list = isinstance(records, (list, tuple)) and len(records) > 0
        if not is_list or not all(isinstance(one, GroundAcceleration) for one in records):
            raise checks.refused("records", wanted, records)
        if checks.holds_traced(*records):
            raise checks.refused("records", "hold known numbers, of which JAX may trace the scale", records)
        times = [np.asarray(one.times, float) for one in records]
        steps = [_step_of(each) for each in times]
        return cls(
            np.concatenate([np.asarray(one.accelerations, float) for one in records]),
            np.cumsum([0, *map(len, times)]).astype(np.int32),
            np.array([step or 0.0 for step in steps]),
            np.concatenate(times) if None in steps else np.zeros(0),
            tuple(names or map(str, range(len(records)))),
        )

    @property
    def durations(self) -> Float[np.ndarray, " records"]:
        """Of each record, s."""
        first = np.asarray(self.first)
        return (
            np.asarray(self.times)[first[1:] - 1] if len(self.times) else np.asarray(self.steps) * (np.diff(first) - 1)
        )

    @property
    def peaks(self) -> Float[np.ndarray, " records"]:
        """The largest absolute acceleration of each record, m/s^2."""
        return np.maximum.reduceat(np.abs(np.asarray(self.accelerations)), np.asarray(self.first)[:-1])


def _step_of(times: Float[np.ndarray, " points"]) -> float | None:
    """The step between these times, s; None where they are not equally spaced."""
    numbers, near = np.arange(len(times)), _ROUND_OFF * np.spacing(times[-1])
    found = [step for step in (times[1], times[-1] / numbers[-1]) if np.all(np.abs(numbers * step - times) <= near)]
    return float(found[0]) if found else None


class RecordSuite(GroundMotion):
    """Many recorded ground motions as one law: each sample has one of the records, times a scale. ::

        suite = ss.RecordSuite("folder of AT2 files")
        many = ss.simulate_ensemble(system, suite, t1=suite.duration, samples=len(suite))

    Sample i has entry i: by default every record once, in its order. `at_scales` makes the suite of every record at
    every scale, for incremental dynamic analysis. ``many.input_values`` says which record and which scale each sample
    had. The records are stored once, whatever the number of samples. They may have different lengths and time steps:
    after its end a record is quiet, the ground has no acceleration.

    Args:
        records: A list of `GroundAcceleration`, or the name of a folder, whose AT2 and CSV files (times in s,
            accelerations in m/s^2) are read in the order of their names.
        scale: What accelerations are multiplied by: a number, an array with one for each sample, or a distribution,
            such as ``LogNormal(mean=1.0, std=0.3)``, from which every sample draws.
        record: The number of the record of each sample, from 0; "random" for records drawn at random, each as probable
            as every other; None for each once.

    Raises:
        ValueError: For anything else.
        OSError: For files that cannot be read.
    """

    records: StoredRecords
    record: Annotated[Number, Quantity(meaning="number of the record of a sample, from 0", at_least=0)]
    scale: Annotated[Number, Quantity(meaning="what its accelerations are multiplied by")]
    is_record = True

    def __init__(self, records: Any, scale: Any = 1.0, record: Any = None):
        self.records = records if isinstance(records, StoredRecords) else StoredRecords.of(records)
        every = range(len(self.records.names))
        if isinstance(record, str):
            checks.chosen("record", record, ("random",))
            record = Discrete(tuple(map(float, every)))
        self.record = np.array(every, float) if record is None else _as_array("record", record)
        self.scale = _as_array("scale", scale)

    def check_parts(self) -> None:
        if len(sizes := {len(value) for value in self._arrays}) > 1:
            raise ValueError(
                f"Arguments record and scale must have one number for each sample, but {sizes} were given; "
                "suite.at_scales has every record at every scale."
            )

    def check_relations(self) -> None:
        if checks.is_traced(self.record):
            return
        record, number = np.asarray(self.record, float), len(self.records.names)
        wrong = (record != np.round(record)) | (record >= number)
        if np.any(wrong):
            given = float(record[wrong].flat[0])
            raise checks.refused("record", f"be the number of one of {number} records, from 0", given)

    @property
    def _arrays(self) -> list[Any]:
        """What differs from sample to sample, and is given for each."""
        return [value for value in (self.record, self.scale) if np.ndim(value) and not is_distribution(value)]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the records: those of their files, or their numbers."""
        return self.records.names

    @property
    def duration(self) -> float:
        """Of the longest record, s."""
        return float(np.max(self.records.durations))

    @property
    def entries(self) -> tuple[AnyArray, AnyArray]:
        """The numbers of the records, and the scales, of the samples, (samples,).

        Raises:
            ValueError: For a suite that draws them.
        """
        for name, value in (("record", self.record), ("scale", self.scale)):
            if is_distribution(value):
                raise checks.refused(name, "be known for each sample here", value, "sample(key, t1) draws one")
        record, scale = (jnp.broadcast_to(jnp.asarray(one), (len(self),)) for one in (self.record, self.scale))
        return record.astype(jnp.int32), scale

    def at_scales(self, scales: npt.ArrayLike) -> "RecordSuite":
        """Every entry at every one of these scales: sample i has entry ``i % n`` of n, at scale ``i // n``.

        Args:
            scales: Numbers, by which the scale of each entry is multiplied; ``np.ones(50)`` repeats each 50 times.

        Raises:
            ValueError: For anything else, and a suite that draws records or scales itself.
        """
        checks.bounded("scales", scales, ndim=1)
        (record, own), every = map(np.asarray, self.entries), np.asarray(scales, float)
        if not len(every):
            raise checks.refused("scales", "hold at least one number", scales)
        return RecordSuite(self.records, (every[:, None] * own).reshape(-1), np.tile(record.astype(float), len(every)))

    def __len__(self) -> int:
        """The number of entries, which is that of samples; 1 where there is one motion, or one is drawn."""
        return max(map(len, self._arrays), default=1)

    def __getitem__(self, number: int | Array) -> "RecordSuite":
        """The ground motion of sample `number`, for `simulate`; JAX may trace the number."""
        if not checks.is_traced(number) and checks.whole_number("number", number, minimum=0) >= len(self):
            raise IndexError(f"Argument number must be below the {len(self)} samples, but {number} was given.")
        record, scale = self.entries
        return RecordSuite(self.records, scale[number], record[number])

    def motion(self, number: int) -> GroundAcceleration:
        """The ground motion of sample `number` by its points, as long as its record."""
        (record, scale), kept = (np.asarray(each)[number] for each in self.entries), self.records
        here = slice(*kept.first[record : record + 2])
        times = kept.times[here] if len(kept.times) else np.arange(here.stop - here.start) * kept.steps[record]
        return GroundAcceleration(times, kept.accelerations[here] * scale)

    def sample(self, key: Array | None, t1: Scalar, *, capacity: int | None = None) -> "RecordSuite":
        """One of the ground motions, for `simulate`: an entry, and numbers of the distributions, drawn by `key`.

        A suite of a single record at a number as its scale is its own. An ensemble takes the entries in their order,
        and draws from distributions by other random numbers.

        Args:
            key: A key from ``jax.random.key(seed)``.
            t1: Not needed: after its end a record is quiet.
            capacity: Not needed.

        Raises:
            ValueError: For a missing key, and distributions of other packages.
        """
        if not self._arrays and not any(map(is_distribution, (self.record, self.scale))):
            return self
        if key is None:
            raise no_key(self)
        for_entry, *keys = jax.random.split(key, 3)
        entry, found = jax.random.randint(for_entry, (), 0, len(self)), []
        for name, value, own in zip(("scale", "record"), (self.scale, self.record), keys, strict=True):
            if isinstance(value, RandomNumber):
                found.append(value.icdf(jax.random.uniform(own, dtype=jnp.result_type(float))))
            elif is_distribution(value):
                raise checks.refused(name, "be a distribution of stickslip_jax", value)
            else:
                found.append(jnp.asarray(value)[entry] if np.ndim(value) else value)
        return RecordSuite(self.records, *found)

    def segments(self, t1) -> int:
        return int(np.max(np.diff(self.records.first))) + 1

    def draw(self, key_data, number, dtype: DTypeLike):
        kept, line = self.records, number.astype(jnp.int32)
        which = jnp.asarray(self.record).astype(jnp.int32)
        first, after = neighbours(jnp.asarray(kept.first), which)
        left = after - 1 - first - line  # lines between points of the record, this one too
        here = jnp.minimum(first + line, after - 2)
        value, end = jnp.asarray(self.scale, dtype) * neighbours(jnp.asarray(kept.accelerations, dtype), here)
        if len(kept.times):
            begin, until = neighbours(jnp.asarray(kept.times, dtype), here)
        else:
            step = jnp.asarray(kept.steps, dtype)[which]
            begin, until = (here - first).astype(dtype) * step, (here - first + 1).astype(dtype) * step
        slope = (end - value) / (until - begin)
        duration = jnp.where(left > 0, until - begin, jnp.where(left == 0, jnp.inf, 0))
        return duration, jnp.where(left > 0, value, 0), jnp.where(left > 0, slope, 0)

    def next_segment(self, memory, drawn, dtype: DTypeLike):
        return *drawn, ()

    def __repr__(self) -> str:
        kept = self.records
        number, durations = len(kept.names), kept.durations
        shown = f"{number} record{'s' * (number > 1)} of {np.min(durations):g} to {np.max(durations):g} s"
        if any(map(checks.is_traced, (self.record, self.scale))):
            return f"RecordSuite({shown})"
        found = hashlib.sha256()  # by which files and folders of results know a suite that is too large for them
        for part in (kept.accelerations, kept.first, kept.steps, kept.times, self.record, self.scale):
            found.update(repr(part).encode() if is_distribution(part) else np.asarray(part, float).tobytes())
        return f"RecordSuite({shown}, {len(self)} samples, check sum {found.hexdigest()[:12]})"


def _as_array(name: str, value: Any) -> Any:
    """Numbers in a list as an array; anything else as it is."""
    return checks.numbers(name, value, ndim=1).astype(float) if isinstance(value, (list, tuple, range)) else value
