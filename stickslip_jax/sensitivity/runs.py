"""Chunks of realisations with derivatives: compiled functions, and the threads that call them."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._status import Status
from .._types import Array
from ..dynamics.lanes import Engine, Job, summarise
from ..numerics.moments import Moments
from .counting import CountingEngine
from .parameters import Path, number_at, with_numbers
from .sequences import Spans, features_of, record_sequences, sequences_of, stacked_parts
from .statistic import StickStatistic


class Rows(NamedTuple):
    """Of each sample: status (samples,); numerator and denominator (samples, 2); other columns (samples, columns), such
    as their derivatives; how many sticks and near misses each window reached (samples, windows).
    """

    status: np.ndarray
    parts: np.ndarray
    columns: np.ndarray
    near: np.ndarray


class Tally(NamedTuple):
    """Sums over samples: moments of the rows ``[parts, columns]`` of the finished ones, and what the windows held."""

    moments: Moments
    near: np.ndarray

    @classmethod
    def of(cls, rows: Rows) -> "Tally":
        """The sums of one chunk."""
        done = rows.status == Status.FINISHED
        return cls(Moments.of(np.concatenate([rows.parts, rows.columns], axis=1)[done]), rows.near[done].sum(axis=0))

    def merge(self, other: "Tally") -> "Tally":
        """The sums of both."""
        return Tally(self.moments.merge(other.moments), self.near + other.near)


def run_chunks(simulate: Callable[[int, int], Rows], samples: int, per_chunk: int, threads: int) -> Tally:
    """Call ``simulate(first, number)`` for all samples; what comes out does not depend on `threads`."""
    firsts = range(0, samples, per_chunk)
    with ThreadPoolExecutor(min(threads, len(firsts))) as pool:
        tallies = pool.map(lambda first: Tally.of(simulate(first, min(per_chunk, samples - first))), firsts)
        total = next(tallies)
        for tally in tallies:
            total = total.merge(tally)
    return total


def derivative_of(function: Callable[[Any], tuple[Any, Any]], engine: Engine, path: Path, dtype: Any) -> Any:
    """Value of `function` of the engine's number at `path`, its derivative, its other output.

    The number is varied in units of its own size (1 where it is 0), so that kernels reach as far for large parameters
    as for small ones.
    """
    value = jnp.asarray(number_at(engine, path), dtype)
    return jax.jvp(function, (value,), (jnp.where(value == 0, 1, jnp.abs(value)),), has_aux=True)


def unit_of(engine: Engine, path: Path) -> float:
    """What `derivative_of` varies the number at `path` in."""
    return abs(float(number_at(engine, path))) or 1.0


def _count(
    engine: CountingEngine,
    words: Array,
    first: Array,
    used_rows: Array,
    *,
    path: Path,
    lanes: int,
    rows: int,
    dtype: Any,
) -> Any:
    """Total stick time, number of sticks, and two zeros as `CountingEngine` tells (rows, lanes); their derivatives by
    the number at `path`, of which the last count what the kernels reached; status (rows, lanes).
    """

    def run(value):
        job = Job(with_numbers(engine, (path,), (value,)), words, first, used_rows)
        results = summarise(job, lanes=lanes, rows=rows, dtype=dtype)
        counts = (jnp.asarray(results.sticks, dtype), results.slips, results.doubts)
        return (results.stick_time, *counts), results.status

    return derivative_of(run, engine, path, dtype)


def _sequence(
    statistic: StickStatistic,
    engine: Engine,
    spans: Spans,
    words: Array,
    first: Array,
    *,
    path: Path,
    fixed_start: bool,
    lanes: int,
    blocks: int,
    slots: int,
    dtype: Any,
) -> Any:
    """Parts (lanes, 2) and zeros (lanes, windows, 2); their derivatives by the number at `path`, which are pathwise and
    event parts; status (lanes,), what the windows reached (lanes, windows), number of sticks (lanes,).
    """

    def run(value):
        varied = with_numbers(engine, (path,), (value,))
        recorded = record_sequences(varied, words, first, lanes=lanes, blocks=blocks, slots=slots, dtype=dtype)
        features = features_of(statistic, varied, recorded, spans, fixed_start)
        return (features.parts, features.events), (recorded.status, features.near, recorded.count)

    return derivative_of(run, engine, path, dtype)


def _values(
    statistic: StickStatistic,
    engine: Any,
    words: Array,
    first: Array,
    *,
    lanes: int,
    blocks: int,
    slots: int,
    dtype: Any,
) -> Any:
    """Parts (lanes, 2), status and number of sticks (lanes,)."""
    recorded = record_sequences(engine, words, first, lanes=lanes, blocks=blocks, slots=slots, dtype=dtype)
    t1 = jnp.asarray(engine.t1, dtype)
    parts = jax.vmap(lambda one: stacked_parts(statistic, one, t1))(sequences_of(recorded))
    return parts, recorded.status, recorded.count


_COUNT_STATIC = ("path", "lanes", "rows", "dtype")
# Wide vectors only where nothing but the package's own functions is compiled (see `dynamics.chunks`).
count_chunk = {
    is_own: jax.jit(_count, static_argnames=_COUNT_STATIC, compiler_options=options)
    for is_own, options in ((True, {"xla_cpu_prefer_vector_width": 512}), (False, None))
}
_ROOM = ("statistic", "lanes", "blocks", "slots", "dtype")
value_chunk = jax.jit(_values, static_argnames=_ROOM)
sequence_chunk = jax.jit(_sequence, static_argnames=("path", "fixed_start", *_ROOM))
