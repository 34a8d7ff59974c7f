"""Suites of recorded ground motions: many records, each at one scale or at several, as one law."""

import hashlib
import os
from collections.abc import Sequence
from typing import Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
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
        if isinstance(records, (str, os.PathLike)):
            folder = checks.path("records", records)
            files = sorted(path for path in folder.glob("*") if path.suffix.lower() in _READERS)
            if not files:
                wanted = "be a folder with AT2 or CSV files, or a list of GroundAccelerations"
                raise checks.refused("records", wanted, str(records), "read_at2 and read_acceleration_csv read a file")
            records, names = [_READERS[path.suffix.lower()](path) for path in files], [path.stem for path in files]
        records = [records] if isinstance(records, GroundAcceleration) else records
        is_list = isinstance(records, (list, tuple)) and len(records) > 0
        if not is_list or not all(isinstance(one, GroundAcceleration) for one in records):
            wanted = "be a list of GroundAccelerations, or the name of a folder with AT2 or CSV files"
            raise checks.refused("records", wanted, records)
        if checks.holds_traced(*records):
            raise ValueError(
                "Argument records must be records of known numbers, but JAX is tracing them; to differentiate by their "
                "size, trace scale."
            )
        times = [np.asarray(one.times, float) for one in records]
        steps = [_step_of(each) for each in times]
        return cls(
            np.concatenate([np.asarray(one.accelerations, float) for one in records]),
            np.cumsum([0, *map(len, times)]).astype(np.int32),
            np.array([0.0 if step is None else step for step in steps]),
            np.concatenate(times) if None in steps else np.zeros(0),
            tuple(map(str, range(len(records))) if names is None else names),
        )

    @property
    def durations(self) -> Float[np.ndarray, " records"]:
        """Of each record, s."""
        last = np.asarray(self.first)[1:] - 1
        return np.asarray(self.times)[last] if len(self.times) else self.steps * np.diff(self.first - 1)

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
        sizes = {len(value) for value in self._arrays}
        if len(sizes) > 1:
            raise ValueError(
                f"Arguments record and scale must have one number for each sample, but {len(self.record)} records and "
                f"{len(self.scale)} scales were given; suite.at_scales has every record at every scale."
            )

    def check_relations(self) -> None:
        if checks.is_traced(self.record):
            return
        record, number = np.asarray(self.record, float), len(self.records.names)
        wrong = (record != np.round(record)) | (record >= number)
        if np.any(wrong):
            raise checks.refused("record", f"be the number of one of {number} records, from 0", record[wrong].flat[0])

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

    def at_scales(self, scales: Any, repeats: int = 1) -> "RecordSuite":
        """Every entry at every one of these scales: sample i has entry ``i % n`` of n, at scale ``i // n``.

        Args:
            scales: Numbers, by which the scale of each entry is multiplied; or a distribution, from which every sample
                draws, where that is 1.
            repeats: How often, for samples that differ in other numbers too.

        Raises:
            ValueError: For anything else, and a suite that draws records or scales itself.
        """
        number, repeats = len(self), checks.whole_number("repeats", repeats)
        for name, value in (("record", self.record), ("scale", self.scale)):
            if is_distribution(value):
                raise checks.refused(name, "be known for each entry, to have it at several scales", value)
        record, own = (np.broadcast_to(np.asarray(value, float), number) for value in (self.record, self.scale))
        if is_distribution(scales):
            if np.any(own != 1):
                raise checks.refused("scales", "be numbers for a suite that has scales of its own", scales)
            return RecordSuite(self.records, scales, np.tile(record, repeats))
        every = np.tile(np.atleast_1d(checks.numbers("scales", scales)), repeats)
        return RecordSuite(self.records, (every[:, None] * own).reshape(-1), np.tile(record, len(every)))

    def __len__(self) -> int:
        """The number of samples, one for each entry; of a suite whose records are drawn, that of the records."""
        return max(map(len, self._arrays), default=len(self.names) if is_distribution(self.record) else 1)

    def __getitem__(self, number: int | Array) -> "RecordSuite":
        """The ground motion of sample `number`, for `simulate`; JAX may trace the number."""
        if not checks.is_traced(number):
            number = checks.whole_number("number", number, minimum=0)
            if number >= len(self):
                raise IndexError(f"Argument number must be below the {len(self)} samples, but {number} was given.")
        for name, value in (("record", self.record), ("scale", self.scale)):
            if is_distribution(value):
                raise checks.refused(name, "be known, to take a sample by its number", value, "sample(key, t1) draws")
        entry = [value[number] if np.ndim(value) else value for value in map(jnp.asarray, (self.record, self.scale))]
        return RecordSuite(self.records, entry[1], entry[0])

    def motion(self, number: int) -> GroundAcceleration:
        """The ground motion of sample `number` by its points, as long as its record."""
        one, kept = self[number], self.records
        which = int(one.record)
        here = slice(int(kept.first[which]), int(kept.first[which + 1]))
        points = np.arange(here.stop - here.start)
        times = np.asarray(kept.times)[here] if len(kept.times) else points * float(kept.steps[which])
        return GroundAcceleration(times, np.asarray(kept.accelerations)[here] * float(one.scale))

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
        entry = jax.random.randint(for_entry, (), 0, len(self))

        def drawn(name: str, value: Any, key: Array) -> Any:
            if isinstance(value, RandomNumber):
                return value.icdf(jax.random.uniform(key, dtype=jnp.result_type(float)))
            if is_distribution(value):
                raise checks.refused(name, "be a distribution of stickslip_jax", value)
            return jnp.asarray(value)[entry] if np.ndim(value) else value

        return RecordSuite(self.records, drawn("scale", self.scale, keys[0]), drawn("record", self.record, keys[1]))

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
        # Files and folders of results know a suite too large for them by this sum.
        parts = (kept.accelerations, kept.first, kept.steps, kept.times, *map(_bytes, (self.record, self.scale)))
        found = hashlib.sha256(b"".join(np.asarray(part).tobytes() for part in parts)).hexdigest()[:12]
        return f"RecordSuite({shown}, {len(self)} samples, check sum {found})"


def _as_array(name: str, value: Any) -> Any:
    """Numbers in a list as an array; anything else as it is."""
    return checks.numbers(name, value, ndim=1).astype(float) if isinstance(value, (list, tuple, range)) else value


def _bytes(value: Any) -> Any:
    return np.frombuffer(repr(value).encode(), np.uint8) if is_distribution(value) else np.asarray(value, float)
