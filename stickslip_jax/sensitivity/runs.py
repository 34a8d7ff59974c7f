"""Chunks of realisations with derivatives: compiled functions, and the threads that call them."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._fast_cpu import fast_cpu_enabled
from .._status import Status
from .._types import Array
from ..dynamics.lanes import Engine, Job, summarise
from ..numerics.moments import Moments
from .counting import CountingEngine, Windows
from .parameters import Path, number_at, with_numbers
from .sequences import features_of, record_sequences
from .statistic import StickSequence, StickStatistic, _OfTotals

_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


class Rows(NamedTuple):
    """Of each sample: status, arcs near an edge (samples,); numerator and denominator (samples, 2); their derivatives
    and pathwise parts (parameters, samples, 2).
    """

    status: np.ndarray
    near: np.ndarray
    parts: np.ndarray
    derivatives: np.ndarray
    pathwise: np.ndarray


class Tally(NamedTuple):
    """Sums over samples: moments of rows ``[parts, derivatives..., pathwise...]`` of the finished ones."""

    moments: Moments
    near: int
    finished: int


def tally_of(rows: Rows) -> Tally:
    """The sums of one chunk."""
    done = rows.status == Status.FINISHED
    columns = [rows.parts, *rows.derivatives, *rows.pathwise]
    return Tally(Moments.of(np.concatenate(columns, axis=1)[done]), int(rows.near[done].sum()), int(done.sum()))


def merged(tallies: list[Tally]) -> Tally:
    """The sums of several chunks, in their order."""
    total = tallies[0]
    for tally in tallies[1:]:
        total = Tally(total.moments.merge(tally.moments), total.near + tally.near, total.finished + tally.finished)
    return total


def run_chunks(simulate: Callable[[int, int], Tally], samples: int, per_chunk: int, threads: int) -> Tally:
    """Call ``simulate(first, number)`` for all samples; what comes out does not depend on `threads`."""
    firsts = range(0, samples, per_chunk)
    with ThreadPoolExecutor(min(threads, len(firsts))) as pool:
        return merged(list(pool.map(lambda first: simulate(first, min(per_chunk, samples - first)), firsts)))


def cores() -> int:
    """How many threads can work at once."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def lanes_and_rows(samples: int, threads: int) -> tuple[int, int]:
    """In how many lanes and rows to follow the samples of a chunk."""
    lanes, rows = (256, 16) if fast_cpu_enabled() else (2048, 4)
    lanes = min(lanes, max(64, 1 << (-(-samples // threads) - 1).bit_length()))
    return lanes, max(1, min(rows, -(-samples // (threads * lanes))))


def derivatives_of(
    function: Callable[[Array], tuple[Any, Any]], engine: Engine, paths: tuple[Path, ...], dtype: Any
) -> tuple[Any, Any, Any]:
    """Value and auxiliary output of `function` at the engine's numbers at `paths`, and its derivatives by each, stacked.

    They are derivatives by the parameter in units of its own size (1 where it is 0), so that kernels reach as far for
    large parameters as for small ones.
    """
    values = jnp.stack([jnp.asarray(number_at(engine, path), dtype) for path in paths])

    def by(direction):
        return jax.jvp(function, (values,), (direction,), has_aux=True)

    directions = jnp.diag(size_of(values))
    if len(paths) == 1:  # without a batch of one, which compiles to slower code
        value, derivative, aux = by(directions[0])
        return value, jax.tree.map(lambda leaf: leaf[None], derivative), aux
    return jax.vmap(by, out_axes=(None, 0, None))(directions)


def size_of(values: Any) -> Any:
    """The unit that a parameter is varied in: its size, or 1 where it is 0."""
    return jnp.where(values == 0, 1, jnp.abs(values))


def _count(
    statistic: _OfTotals,
    engine: CountingEngine,
    words: Array,
    first: Array,
    used_rows: Array,
    *,
    paths: tuple[Path, ...],
    lanes: int,
    rows: int,
    dtype: Any,
) -> Any:
    """Features (rows, lanes) of each sample and, where there are `paths`, their derivatives."""

    def run(values):
        job = Job(with_numbers(engine, paths, values) if paths else engine, words, first, used_rows)
        results = summarise(job, lanes=lanes, rows=rows, dtype=dtype)
        parts = statistic.of_totals(results.stick_time, jnp.asarray(results.sticks, dtype), engine.t1)
        return (jnp.stack(parts, axis=-1), results.doubts), results.status

    if not paths:
        features, status = run(None)
        return features, jax.tree.map(lambda leaf: leaf[None][:0], features), status
    return derivatives_of(run, engine, paths, dtype)


def _sequence(
    statistic: StickStatistic,
    engine: Engine,
    windows: Windows,
    words: Array,
    first: Array,
    *,
    paths: tuple[Path, ...],
    fixed_start: bool,
    lanes: int,
    slots: int,
    dtype: Any,
) -> Any:
    """Features (lanes,) of each sample and, where there are `paths`, their derivatives, event parts beside them."""

    def run(values):
        varied = with_numbers(engine, paths, values) if paths else engine
        recorded = record_sequences(varied, words, first, lanes=lanes, slots=slots, dtype=dtype)
        if not paths:
            sticks = StickSequence(recorded.start.T, (recorded.end - recorded.start).T, (recorded.ending >= 0).T)
            parts = jnp.stack(jax.vmap(lambda one: statistic.parts(one, engine.t1))(sticks), axis=-1)
            return (parts, jnp.zeros_like(parts)), (recorded.status, recorded.count, recorded.count)
        features = features_of(statistic, varied, recorded, windows, fixed_start)
        both = jnp.stack(features.parts, axis=-1), jnp.stack(features.events, axis=-1)
        return both, (recorded.status, features.near, recorded.count)

    if not paths:
        (parts, _), aux = run(None)
        return (parts, parts), (parts[None][:0], parts[None][:0]), aux
    return derivatives_of(run, engine, paths, dtype)


_STATIC_COUNT = ("statistic", "paths", "lanes", "rows", "dtype")
_STATIC_SEQUENCE = ("statistic", "paths", "fixed_start", "lanes", "slots", "dtype")
# Wide vectors only where nothing of the user's is compiled: see `dynamics.chunks`.
count_chunk = {
    own: jax.jit(_count, static_argnames=_STATIC_COUNT, compiler_options=_OPTIONS if own else None)
    for own in (True, False)
}
sequence_chunk = jax.jit(_sequence, static_argnames=_STATIC_SEQUENCE)
