"""What an ensemble hands back: sums for the statistics and, if kept, every stick of every sample."""

import dataclasses
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from . import _checks
from ._status import Status
from .base_motion.drive import is_random
from .base_motion.random import realised_state
from .events import Sticks
from .numerics.moments import Moments

FEATURES = ("stick_time", "stick_count", "slip_count")
"""What `Moments` holds of each finished sample."""


class SampleTotals(NamedTuple):
    """Totals of each sample; arrays (samples,). Times in s."""

    sticks: np.ndarray
    slips: np.ndarray
    stick_time: np.ndarray
    status: np.ndarray
    doubts: np.ndarray


class FlatSticks(NamedTuple):
    """The sticks of many samples one after the other (the "contiguous ragged" form of CF conventions)."""

    count: np.ndarray  # (samples,)
    start: np.ndarray  # (all sticks,), as the following
    end: np.ndarray
    position: np.ndarray
    ending: np.ndarray

    @classmethod
    def collect(cls, pieces: "list[tuple[np.ndarray, ...]]", finished: np.ndarray) -> "FlatSticks":
        """Put pieces of `sticks_of` in order of sample, then time. Samples not `finished` have no sticks."""
        sample, start, end, position, ending = (np.concatenate(column) for column in zip(*pieces, strict=True))
        order = np.argsort(sample, kind="stable")  # by radix for 16-bit numbers, five times faster
        count = np.bincount(sample, minlength=len(finished))[: len(finished)]
        order = order[: count.sum()]  # what lanes without a sample did stands at the end
        if not np.all(finished):
            order = order[np.repeat(finished, count)]
            count = np.where(finished, count, 0)
        return cls(count, *(values[order] for values in (start, end, position, ending)))

    def padded(self) -> Sticks:
        """As `Sticks` with arrays (samples, slots), slots being the largest count (at least 1)."""
        slots = max(1, int(self.count.max(initial=0)))
        mask = np.arange(slots) < self.count[:, None]

        def fill(values, padding):
            padded = np.full(mask.shape, padding, values.dtype)
            padded[mask] = values
            return padded

        return Sticks(fill(self.start, np.nan), fill(self.end, np.nan), fill(self.position, np.nan),
                      fill(self.ending, -1), mask)  # fmt: skip


def sticks_of(values: np.ndarray, ending: np.ndarray, sample: np.ndarray) -> tuple[np.ndarray, ...]:
    """The sticks among records: sample, start, end, position and ending of each, in order of time for each sample.

    `values` (slots, 3, lanes) holds start, end and position, `ending` (slots, lanes) is negative where there is no
    stick, and `sample` (blocks, lanes) tells whose records the lanes of each block of slots hold.
    """
    slots, lanes = ending.shape
    small = sample.astype(np.uint16 if sample.max() < 1 << 16 else np.int64)
    owner = np.repeat(small, slots // len(sample), axis=0)
    found = np.flatnonzero(ending >= 0)
    at = found + 2 * lanes * (found // np.int64(lanes))
    flat = values.reshape(-1)
    columns = (flat[at], flat[at + lanes], flat[at + 2 * lanes])
    return owner.reshape(-1)[found], *columns, ending.reshape(-1)[found]


@dataclasses.dataclass(frozen=True, repr=False, eq=False)
class Ensemble:
    """Many simulated samples of one law.

    - `system`, `law`, `t1` (s), `y0` (m, m/s), `samples`, `key_words`: what was simulated.
    - `method`: how; a `Regularized` method has its options filled in.
    - `moments`: number, mean and covariance of each finished sample's `FEATURES`, for the statistics.
    - `doubtful`: how many samples had an instant at which the last digits decide whether there was an event (see
      `Simulation`); they are counted like the others.
    - `status_counts`: how many samples ended with each `Status`; all that are not FINISHED enter no statistic.
    - `sticks`: every stick, arrays (samples, slots), and `totals` of each sample, if ``keep="sticks"``.
    - `flat_sticks`: the same sticks one after the other, without padding.
    - `compile_seconds`, `run_seconds`: where the time went.
    """

    system: Any
    law: Any
    t1: float
    method: Any
    y0: tuple[Any, ...]
    samples: int
    key_words: tuple[int, ...] | None
    dtype: str
    moments: Moments
    status_counts: dict[Status, int]
    doubtful: int
    totals: SampleTotals | None
    flat_sticks: FlatSticks | None
    threads: int
    compile_seconds: float
    run_seconds: float

    @cached_property
    def sticks(self) -> Sticks:
        """Every stick of every sample, arrays (samples, slots). Raises ValueError unless ``keep="sticks"``."""
        return self.require_sticks().padded()

    def require_sticks(self) -> FlatSticks:
        """`flat_sticks`, or a ValueError that says how to keep them."""
        if self.flat_sticks is None:
            raise ValueError(
                'This ensemble kept only statistics, no sticks; call simulate_ensemble(..., keep="sticks").'
            )
        return self.flat_sticks

    @property
    def finished(self) -> int:
        """Number of samples that reached ``t1``."""
        return self.status_counts[Status.FINISHED]

    def realisation(self, number: int) -> tuple[Any, tuple[float, ...]]:
        """The base motion and the initial state of sample `number`: what `simulate` needs to follow it again.

        Raises ValueError unless ``0 <= number < samples``.
        """
        if _checks.whole_number("number", number, minimum=0) >= self.samples:
            raise ValueError(f"Argument number must be below the {self.samples} samples, but {number} was given.")
        if self.key_words is None:
            return self.law, self.y0
        key = jax.random.fold_in(jax.random.wrap_key_data(jnp.array(self.key_words, jnp.uint32)), number)
        base = self.law.sample(key, self.t1) if is_random(self.law) else self.law
        y0 = realised_state(self.y0, jax.random.key_data(key), jnp.dtype(self.dtype))
        return base, tuple(float(value) for value in y0)

    def to_xarray(self) -> Any:
        """The sticks and each sample's totals as an ``xarray.Dataset`` with units and long names.

        Sticks come as CF contiguous ragged arrays along ``stick``; ``stick_count`` tells how many belong to each
        sample. Needs ``keep="sticks"`` (else ValueError) and the extra ``study`` (else ImportError).
        """
        from ._xarray import dataset_of  # noqa: PLC0415 - needs an extra

        return dataset_of(self)

    def __repr__(self) -> str:
        sticks = self.moments.mean[FEATURES.index("stick_count")] * self.moments.number
        lines = [
            f"Ensemble of {self.samples} samples on [0, {self.t1:g}] s",
            f"  system    {_brief(self.system)}",
            f"  law       {_brief(self.law)}",
            f"  sticks    {round(sticks)} found" + ("" if self.flat_sticks is None else ", all kept"),
            f"  time      {self.run_seconds:.3g} s to run, {self.compile_seconds:.3g} s to compile",
        ]
        failed = {status: count for status, count in self.status_counts.items() if status and count}
        lines += [f"  NOT FINISHED: {count} samples, because {status.meaning}" for status, count in failed.items()]
        lines += [f"  in doubt  {self.doubtful} samples, by the last digits"] if self.doubtful else []
        return "\n".join(lines if failed else [*lines, "  finished  all samples"])


def _brief(module: Any) -> str:
    text = " ".join(eqx.tree_pformat(module, short_arrays=False).split())
    return text if len(text) <= 110 else text[:107] + "..."
