"""Chunks of realisations with derivatives: compiled functions, and the threads that call them."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._compiler import WIDE_VECTORS, CompiledNatively
from .._dynamics.lanes import Job, summarize
from .._numerics.moments import Moments
from .._status import Status
from .._types import AnyInteger, Array
from .._uncertainty.numbers import Path, number_at, with_numbers
from .sequences import BufferSizes, features_of, record_sequences
from .statistic import StickStatistic


class Rows(NamedTuple):
    """Results per sample: status (samples,); the numbers to take moments of, `columns` (samples, columns).

    `near` (parameters, samples, windows): how many margins each window reached.
    """

    status: np.ndarray
    columns: np.ndarray
    near: np.ndarray

    @classmethod
    def of(
        cls, status: np.ndarray, parts: np.ndarray, slopes: np.ndarray, pathwise: np.ndarray, near: np.ndarray
    ) -> "Rows":
        """Rows whose columns are numerator and denominator, their derivatives, and the pathwise parts of these.

        - `parts`: (samples, 2); `slopes`: (parameters, samples, windows, 2); `pathwise`: (parameters, samples, 2).
        """
        columns = (np.moveaxis(leaf, 1, 0).reshape(len(parts), -1) for leaf in (slopes, pathwise))
        return cls(status, np.concatenate([parts, *columns], axis=1), near)


class Accumulator(NamedTuple):
    """Sums over the finished samples: moments of the columns, for each half of the samples (every other one).

    `near` (parameters, windows): how many margins the windows reached.
    """

    halves: tuple[Moments, Moments]
    near: np.ndarray

    @classmethod
    def of(cls, rows: Rows) -> "Accumulator":
        """The sums of one chunk."""
        done = rows.status == Status.FINISHED
        first, second = (Moments.of(rows.columns[half::2][done[half::2]]) for half in (0, 1))
        return cls((first, second), rows.near[:, done].sum(axis=1))

    @property
    def moments(self) -> Moments:
        """Moments of both halves together."""
        return self.halves[0].merge(self.halves[1])

    def merge(self, other: "Accumulator") -> "Accumulator":
        """The sums of both."""
        first, second = (one.merge(two) for one, two in zip(self.halves, other.halves, strict=True))
        return Accumulator((first, second), self.near + other.near)


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
    function: Callable[[Array], tuple[Any, Any]], engine: Any, paths: tuple[Path, ...], dtype: Any
) -> Any:
    """Value of `function` of the engine's numbers at `paths`, its derivatives along a first axis, its other output.

    One pass simulates the motion once for all. The numbers are varied in units of their own size (1 where it is 0), so
    that bandwidths of kernels are relative to the parameter.
    """
    values = jnp.stack([jnp.asarray(number_at(engine, path), dtype) for path in paths])
    units = jnp.where(values == 0, 1, jnp.abs(values))

    def along(direction):
        return jax.jvp(function, (values,), (direction,), has_aux=True)

    return jax.vmap(along, out_axes=(None, 0, None))(jnp.diag(units))


def units_of(engine: Any, paths: tuple[Path, ...]) -> np.ndarray:
    """The units in which `derivatives_of` varies the numbers at `paths`, (paths,)."""
    return np.array([abs(float(number_at(engine, path))) or 1.0 for path in paths])


def _count(
    engine: Any,
    own: Any,
    key_data: Array,
    first: AnyInteger,
    used_rows: AnyInteger,
    *,
    paths: tuple[Path, ...],
    lanes: int,
    rows: int,
    dtype: Any,
) -> tuple[Any, Any, Any]:
    """Totals, their derivatives by the numbers at `paths`, and status.

    Total stick time and number of sticks (rows, lanes); the derivatives of stick time, `births` and `near` (paths,
    rows, lanes), the last two for each window; status (rows, lanes).
    """

    def run(values):
        job = Job(with_numbers(engine, paths, values), key_data, first, used_rows, own)
        counted = summarize(job, lanes=lanes, rows=rows, dtype=dtype)
        return (counted.stick_time, counted.births, counted.near), (counted.sticks, counted.status)

    (time, _, _), slopes, (sticks, status) = derivatives_of(run, engine, paths, dtype)
    return (time, sticks), slopes, status


def _sequence(
    statistic: StickStatistic,
    engine: Any,
    own: Any,
    bandwidths: Array,
    key_data: Array,
    first: Array,
    *,
    paths: tuple[Path, ...],
    lanes: int,
    buffer: BufferSizes,
    dtype: Any,
) -> Any:
    """`Features`, their derivatives by the numbers at `paths` along a first axis, and (status, sticks, edges) (lanes,).

    The derivatives are pathwise parts, event parts, and how many margins the windows reached.
    """

    def run(values):
        varied = with_numbers(engine, paths, values)
        recorded = record_sequences(varied, own, key_data, first, lanes=lanes, buffer=buffer, dtype=dtype)
        features = features_of(statistic, varied, recorded, bandwidths)
        return features, (recorded.status, recorded.sticks, recorded.edges)

    return derivatives_of(run, engine, paths, dtype)


def _values(
    statistic: StickStatistic,
    engine: Any,
    own: Any,
    key_data: Array,
    first: Array,
    *,
    lanes: int,
    buffer: BufferSizes,
    dtype: Any,
) -> Any:
    """Parts (lanes, 2), status and number of sticks (lanes,). `buffer.edges` must be 0."""
    recorded = record_sequences(engine, own, key_data, first, lanes=lanes, buffer=buffer, dtype=dtype)
    return features_of(statistic, engine, recorded, np.zeros(0)).parts, recorded.status, recorded.sticks


_COUNT_STATIC = ("paths", "lanes", "rows", "dtype")
# Native loops and wide vectors only where all compiled functions are the package's own (see `_dynamics/compiled.py`).
count_chunk = {
    True: CompiledNatively(_count, _COUNT_STATIC, compiler_options=WIDE_VECTORS),
    False: jax.jit(_count, static_argnames=_COUNT_STATIC),
}
_BUFFER = ("statistic", "lanes", "buffer", "dtype")
value_chunk = jax.jit(_values, static_argnames=_BUFFER)
sequence_chunk = jax.jit(_sequence, static_argnames=("paths", *_BUFFER))
