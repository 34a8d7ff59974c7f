"""Chunks of realisations with derivatives: compiled functions, and the threads that call them."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .._compiler import WIDE_VECTORS, CompiledNatively
from .._dynamics.common.engine import Engine
from .._dynamics.common.lanes import Job, summarize
from .._numerics.moments import Moments
from .._status import Status
from .._types import AnyArray, Array, DType, IntArray
from .._uncertainty.numbers import Path, number_at, with_numbers
from .sequences import BufferSizes, Features, RecordedCounts, features_of, record_sequences
from .statistic import StickStatistic

_Value = TypeVar("_Value")
_Other = TypeVar("_Other")


class Rows(NamedTuple):
    """Results of samples: numerator and denominator, their derivatives, and the pathwise parts of these.

    `in_window`: how many distances were inside each window.
    """

    status: Int[np.ndarray, " samples"]
    parts: Float[np.ndarray, "samples 2"]
    slopes: Float[np.ndarray, "paths samples windows 2"]
    pathwise: Float[np.ndarray, "paths samples 2"]
    in_window: Float[np.ndarray, "paths samples windows"]

    @property
    def columns(self) -> Float[np.ndarray, "samples columns"]:
        """The numbers to take moments of."""
        columns = (np.moveaxis(leaf, 1, 0).reshape(len(self.parts), -1) for leaf in (self.slopes, self.pathwise))
        return np.concatenate([self.parts, *columns], axis=1)


class DerivativeColumns(NamedTuple):
    """First columns of the derivatives of numerator and denominator by one parameter, and of their pathwise parts.

    `derivative` has one entry per window, the widest first.
    """

    derivative: tuple[int, ...]
    pathwise: int


class Accumulator(NamedTuple):
    """Sums over the finished samples: moments of `Rows.columns`, for each half of the samples (every other one).

    - `in_window`: how many distances were inside each window.
    - `pathwise`: for each parameter, the path whose pathwise part is that of its derivative; empty: its own path.
    """

    halves: tuple[Moments, Moments]
    in_window: Float[np.ndarray, "parameters windows"]
    pathwise: tuple[int, ...] = ()

    @classmethod
    def of(cls, rows: Rows) -> "Accumulator":
        """The sums of one chunk."""
        done = rows.status == Status.FINISHED
        columns = rows.columns
        first, second = (Moments.of(columns[half::2][done[half::2]]) for half in (0, 1))
        return cls((first, second), rows.in_window[:, done].sum(axis=1))

    @property
    def columns(self) -> tuple[DerivativeColumns, ...]:
        """Where the derivatives by each parameter stand in the moments. The first paths are those of the parameters."""
        parameters, windows = self.in_window.shape
        paths = (len(self.halves[0].mean) - 2) // (2 * windows + 2)
        return tuple(
            DerivativeColumns(
                tuple(2 + 2 * (index * windows + window) for window in range(windows)),
                2 + 2 * (paths * windows + pathwise),
            )
            for index, pathwise in enumerate(self.pathwise or range(parameters))
        )

    @property
    def moments(self) -> Moments:
        """Moments of both halves together."""
        return self.halves[0].merge(self.halves[1])

    def merge(self, other: "Accumulator") -> "Accumulator":
        """The sums of both."""
        first, second = (one.merge(two) for one, two in zip(self.halves, other.halves, strict=True))
        return Accumulator((first, second), self.in_window + other.in_window)


def run_chunks(simulate: Callable[[int, int], Rows], samples: int, per_chunk: int, threads: int) -> Accumulator:
    """Call ``simulate(first, number)`` for all samples in chunks; the result does not depend on `threads`."""
    firsts = range(0, samples, per_chunk)
    with ThreadPoolExecutor(min(threads, len(firsts))) as pool:
        accumulators = pool.map(lambda first: Accumulator.of(simulate(first, min(per_chunk, samples - first))), firsts)
        total = next(accumulators)
        for accumulator in accumulators:
            total = total.merge(accumulator)
    return total


def derivatives_of(
    function: Callable[[Array], tuple[_Value, _Other]], engine: Engine, paths: tuple[Path, ...], dtype: DType
) -> tuple[_Value, _Value, _Other]:
    """Value of `function` of the engine's numbers at `paths`, its derivatives along a first axis, its other output.

    One pass simulates the motion once for all. The numbers are varied in units of their own size (1 where it is 0), so
    that bandwidths of kernels are relative to the parameter.
    """
    values = jnp.stack([jnp.asarray(number_at(engine, path), dtype) for path in paths])
    units = jnp.where(values == 0, 1, jnp.abs(values))

    def along(direction):
        return jax.jvp(function, (values,), (direction,), has_aux=True)

    return jax.vmap(along, out_axes=(None, 0, None))(jnp.diag(units))


def units_of(engine: Engine, paths: tuple[Path, ...]) -> Float[np.ndarray, " paths"]:
    """The units in which `derivatives_of` varies the numbers at `paths`."""
    return np.array([abs(float(number_at(engine, path))) or 1.0 for path in paths])


_Slopes: TypeAlias = tuple[Array, tuple[Array, ...], tuple[Array, ...]]
"""Derivatives of stick time, and of `event_parts` and `in_window` of `Counted`, (paths, rows, lanes)."""


def _count(
    job: Job, *, paths: tuple[Path, ...], lanes: int, rows: int, dtype: DType
) -> tuple[tuple[Array, Array], _Slopes, IntArray]:
    """Total stick time and number of sticks, their derivatives by the numbers at `paths`, and status; (rows, lanes)."""

    def run(values):
        varied = job._replace(engine=with_numbers(job.engine, paths, values))
        counted = summarize(varied, lanes=lanes, rows=rows, dtype=dtype)
        return (counted.stick_time, counted.event_parts, counted.in_window), (counted.sticks, counted.status)

    (time, _, _), slopes, (sticks, status) = derivatives_of(run, job.engine, paths, dtype)
    return (time, sticks), slopes, status


def _sequence(
    statistic: StickStatistic,
    job: Job,
    bandwidths: AnyArray,
    *,
    paths: tuple[Path, ...],
    lanes: int,
    buffer: BufferSizes,
    dtype: DType,
) -> tuple[Features, Features, RecordedCounts]:
    """`Features`, their derivatives by the numbers at `paths` along a first axis, and the counts of each lane.

    The derivatives are pathwise parts, event parts, and how many distances the windows hold.
    """

    def run(values):
        varied = job._replace(engine=with_numbers(job.engine, paths, values))
        recorded = record_sequences(varied, lanes=lanes, buffer=buffer, dtype=dtype)
        return features_of(statistic, varied.engine, recorded, bandwidths), recorded.counts

    return derivatives_of(run, job.engine, paths, dtype)


def _values(
    statistic: StickStatistic, job: Job, *, lanes: int, buffer: BufferSizes, dtype: DType
) -> tuple[Float[Array, "lanes 2"], RecordedCounts]:
    """Parts of the statistic, and the counts of each lane. `buffer.candidates` must be 0."""
    recorded = record_sequences(job, lanes=lanes, buffer=buffer, dtype=dtype)
    return features_of(statistic, job.engine, recorded, np.zeros(0)).parts, recorded.counts


_COUNT_STATIC = ("paths", "lanes", "rows", "dtype")
# Native loops and wide vectors only where all compiled functions are the package's own (see `_dynamics/compiled.py`).
count_chunk = {
    True: CompiledNatively(_count, _COUNT_STATIC, compiler_options=WIDE_VECTORS),
    False: jax.jit(_count, static_argnames=_COUNT_STATIC),
}
_BUFFER = ("statistic", "lanes", "buffer", "dtype")
value_chunk = jax.jit(_values, static_argnames=_BUFFER)
sequence_chunk = jax.jit(_sequence, static_argnames=("paths", *_BUFFER))
