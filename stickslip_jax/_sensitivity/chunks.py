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
    - `tolerance`: in standard errors, how far windows may differ where it is not by chance.
    """

    halves: tuple[Moments, Moments]
    in_window: Float[np.ndarray, "parameters windows"]
    pathwise: tuple[int, ...] = ()
    tolerance: float = 0.0

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


class JointAccumulator(NamedTuple):
    """The sums of several statistics over the same samples: moments of their columns one after the other, by halves.

    - `sizes`: how many columns each statistic has. `in_window`, `pathwise`, `tolerance`: of each, as in `Accumulator`.
    """

    halves: tuple[Moments, Moments]
    sizes: tuple[int, ...]
    in_window: tuple[Float[np.ndarray, "parameters windows"], ...]
    pathwise: tuple[tuple[int, ...], ...]
    tolerance: tuple[float, ...]

    @classmethod
    def of(cls, rows: list[Rows], sources: "list[Source]") -> "JointAccumulator":
        """The sums of one chunk, with the rows of each statistic, and the source of each."""
        done = np.max([one.status for one in rows], axis=0) == Status.FINISHED
        each = [one.columns for one in rows]
        columns = np.concatenate(each, axis=1)
        first, second = (Moments.of(columns[half::2][done[half::2]]) for half in (0, 1))
        in_window = tuple(one.in_window[:, done].sum(axis=1) for one in rows)
        about = tuple(source.pathwise for source in sources), tuple(source.tolerance for source in sources)
        return cls((first, second), tuple(one.shape[1] for one in each), in_window, *about)

    def merge(self, other: "JointAccumulator") -> "JointAccumulator":
        """The sums of both."""
        first, second = (one.merge(two) for one, two in zip(self.halves, other.halves, strict=True))
        in_window = tuple(one + two for one, two in zip(self.in_window, other.in_window, strict=True))
        return self._replace(halves=(first, second), in_window=in_window)

    def slice_of(self, number: int) -> slice:
        """The columns of a statistic."""
        first = sum(self.sizes[:number])
        return slice(first, first + self.sizes[number])

    def single(self, number: int) -> Accumulator:
        """The sums of one statistic alone."""
        own = self.slice_of(number)
        first, second = (Moments(half.number, half.mean[own], half.scatter[own, own]) for half in self.halves)
        return Accumulator((first, second), self.in_window[number], self.pathwise[number], self.tolerance[number])


class Source(NamedTuple):
    """How the rows of some statistics are found, from the same loop.

    - `rows`: of samples ``first .. first + number - 1``, for each statistic, as a function of these two.
    - `per_task`: the largest `number`. `widths`: of the windows, or the steps, relative to the parameter.
    - `pathwise`, `tolerance`: as in `Accumulator`.
    """

    rows: Callable[[int, int], list[Rows]]
    per_task: int
    widths: Float[np.ndarray, " windows"]
    pathwise: tuple[int, ...] = ()
    tolerance: float = 0.0


def run_chunks(sources: list[Source], samples: int, threads: int) -> JointAccumulator:
    """The sums over all samples, in chunks, of the statistics of all sources; they do not depend on `threads`."""
    per_chunk = min(source.per_task for source in sources)
    firsts = range(0, samples, per_chunk)

    def simulate(first: int) -> JointAccumulator:
        each = [source.rows(first, min(per_chunk, samples - first)) for source in sources]
        of_each = [source for source, found in zip(sources, each, strict=True) for _ in found]
        return JointAccumulator.of([rows for found in each for rows in found], of_each)

    with ThreadPoolExecutor(min(threads, len(firsts))) as pool:
        accumulators = pool.map(simulate, firsts)
        total = next(accumulators)
        for accumulator in accumulators:
            total = total.merge(accumulator)
    return total


def derivatives_of(
    function: Callable[[Array], tuple[_Value, _Other]],
    engine: Engine,
    paths: tuple[Path, ...],
    dtype: DType,
    chosen: IntArray | None = None,
) -> tuple[_Value, _Value, _Other]:
    """Value of `function` of the engine's numbers at `paths`, its derivatives along a first axis, its other output.

    `chosen`: by which of them; by default by all.

    One pass simulates the motion once for all. The numbers are varied in units of their own size (1 where it is 0), so
    that bandwidths of kernels are relative to the parameter.
    """
    values = jnp.stack([jnp.asarray(number_at(engine, path), dtype) for path in paths])
    units = jnp.where(values == 0, 1, jnp.abs(values))

    def along(direction):
        return jax.jvp(function, (values,), (direction,), has_aux=True)

    directions = jnp.diag(units)
    return jax.vmap(along, out_axes=(None, 0, None))(directions if chosen is None else directions[chosen])


def units_of(engine: Engine, paths: tuple[Path, ...]) -> Float[np.ndarray, " paths"]:
    """The units in which `derivatives_of` varies the numbers at `paths`."""
    return np.array([abs(float(number_at(engine, path))) or 1.0 for path in paths])


_Slopes: TypeAlias = tuple[Array, tuple[Array, ...], tuple[Array, ...]]
"""Derivatives of stick time, and of `event_parts` and `in_window` of `Counted`, (paths, rows, lanes)."""


def _count(
    job: Job, chosen: AnyArray, *, paths: tuple[Path, ...], lanes: int, rows: int, dtype: DType
) -> tuple[tuple[Array, Array], _Slopes, IntArray]:
    """Total stick time and number of sticks, their derivatives by the `chosen` ones of the numbers at `paths`, and
    status; (rows, lanes).
    """

    def run(values):
        varied = job._replace(engine=with_numbers(job.engine, paths, values))
        counted = summarize(varied, lanes=lanes, rows=rows, dtype=dtype)
        return (counted.stick_time, counted.event_parts, counted.in_window), (counted.sticks, counted.status)

    (time, _, _), slopes, (sticks, status) = derivatives_of(run, job.engine, paths, dtype, jnp.asarray(chosen))
    return (time, sticks), slopes, status


def _sequence(
    statistics: tuple[StickStatistic, ...],
    job: Job,
    bandwidths: AnyArray,
    *,
    paths: tuple[Path, ...],
    lanes: int,
    buffer: BufferSizes,
    dtype: DType,
) -> tuple[tuple[Features, ...], tuple[Features, ...], RecordedCounts]:
    """`Features` of each statistic, their derivatives by the numbers at `paths` along a first axis, and the counts.

    The derivatives are pathwise parts, event parts, and how many distances the windows hold.
    """

    def run(values):
        varied = job._replace(engine=with_numbers(job.engine, paths, values))
        recorded = record_sequences(varied, lanes=lanes, buffer=buffer, dtype=dtype)
        features = tuple(features_of(one, varied.engine, recorded, bandwidths) for one in statistics)
        return features, recorded.counts

    return derivatives_of(run, job.engine, paths, dtype)


def _values(
    statistics: tuple[StickStatistic, ...], job: Job, *, lanes: int, buffer: BufferSizes, dtype: DType
) -> tuple[tuple[Float[Array, "lanes 2"], ...], RecordedCounts]:
    """Parts of each statistic, and the counts of each lane. `buffer.candidates` must be 0."""
    recorded = record_sequences(job, lanes=lanes, buffer=buffer, dtype=dtype)
    return tuple(features_of(one, job.engine, recorded, np.zeros(0)).parts for one in statistics), recorded.counts


_COUNT_STATIC = ("paths", "lanes", "rows", "dtype")
# Native loops and wide vectors only where all compiled functions are the package's own (see `_dynamics/compiled.py`).
count_chunk = {
    True: CompiledNatively(_count, _COUNT_STATIC, compiler_options=WIDE_VECTORS),
    False: jax.jit(_count, static_argnames=_COUNT_STATIC),
}
_BUFFER = ("statistics", "lanes", "buffer", "dtype")
value_chunk = jax.jit(_values, static_argnames=_BUFFER)
sequence_chunk = jax.jit(_sequence, static_argnames=("paths", *_BUFFER))
