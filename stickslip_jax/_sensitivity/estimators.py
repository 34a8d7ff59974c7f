"""Sensitivities by event parts: from engines that count, and from recorded stick sequences."""

from collections.abc import Callable
from functools import partial
from typing import TypeAlias, TypeVar

import jax
import numpy as np

from .._dynamics.common.engine import Engine
from .._status import Status
from .._systems.built_in import is_built_in
from .._types import AnyArray
from .._uncertainty.numbers import Path
from .chunks import Rows, Source, count_chunk, sequence_chunk, units_of
from .counting import IntervalCounting, Likelihood
from .problem import Pilot, Problem, buffer_sizes_for, lanes_and_rows, sequence_lanes
from .random_inputs import RandomEngine, single_engine, wrapped, wrapped_path
from .recording import recording
from .sequences import BufferSizes, Features, RecordedCounts
from .statistic import OfTotals
from .step_counting import StepCounting

_TOGETHER = 2  # derivatives in one pass of time steps: XLA (jaxlib 0.10) makes no native loop of three with damping
_MOST_TRIES = 6  # with larger and larger buffers of a realisation

_Result = TypeVar("_Result")


def counted(problem: Problem, pilot: Pilot, bandwidths: np.ndarray) -> Source:
    """Derivatives by all parameters with a counting engine, a window per bandwidth; without any, the pathwise part."""
    engine = counting_engine(problem, pilot, bandwidths)
    paths = wrapped_paths(problem)
    # The derivative by a rate comes from the likelihood; its pathwise part is found beside it.
    every = tuple(dict.fromkeys((*score_paths(engine, paths), *paths)))
    count = counter(problem, engine, every)

    def rows(first: int, samples: int) -> list[Rows]:
        return [one._replace(in_window=one.in_window[: len(paths)]) for one in count(first, samples)]

    pathwise = tuple(every.index(path) for path in paths)
    return Source(rows, lanes_and_rows(problem)[2], bandwidths, pathwise)


def counting_engine(
    problem: Problem, pilot: Pilot, bandwidths: np.ndarray
) -> IntervalCounting | StepCounting | RandomEngine:
    """The engine that counts; of a problem with inputs, a `RandomEngine` over one. Without `bandwidths`, for pathwise
    derivatives only.
    """
    bandwidths = np.asarray(bandwidths, problem.dtype)

    def counting(engine):
        if not problem.by_intervals:
            return StepCounting(engine, bandwidths, problem.fixed_start)
        law, likelihood = engine.law, None
        if law.gap_rate is not None:
            likelihood = Likelihood(getattr(law, law.gap_rate), pilot.stick_time, pilot.sticks)
        return IntervalCounting(engine, bandwidths, likelihood, problem.fixed_start)

    return wrapped(problem.engine(), counting)


def score_paths(engine: Engine, paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """The `paths`, but where one is that of the rate of the base's gaps, that of the rate the likelihood knows."""
    counting, outer = single_engine(engine), ("template",) if isinstance(engine, RandomEngine) else ()
    if not isinstance(counting, IntervalCounting) or counting.likelihood is None:
        return paths
    rate = (*outer, "engine", "law", counting.engine.law.gap_rate)
    return tuple((*outer, "likelihood", "rate") if path == rate else path for path in paths)


def wrapped_paths(problem: Problem) -> tuple[Path, ...]:
    """Paths of the parameters in an engine that counts or records."""
    return tuple(map(wrapped_path, problem.paths()))


def counter(problem: Problem, engine: Engine, paths: tuple[Path, ...]) -> Callable[[int, int], list[Rows]]:
    """A function of a task's first sample and number of samples, with derivatives by the numbers at `paths`."""
    lanes, rows, _ = lanes_and_rows(problem)
    units = units_of(engine, paths)[:, None]
    together = len(paths) if problem.by_intervals else min(len(paths), _TOGETHER)
    parts = -(-len(paths) // together)
    chosen = np.minimum(np.arange(parts * together, dtype=np.int32), len(paths) - 1).reshape(parts, together)

    def count(first: int, number: int) -> list[Rows]:
        job = problem.job(engine, first, lanes * rows, -(-number // lanes))
        found = [
            count_chunk[is_built_in(engine)](job, part, paths=paths, lanes=lanes, rows=rows, dtype=problem.dtype)
            for part in chosen
        ]
        totals, _, status = found[0]  # the same in all
        slopes = jax.tree.map(lambda *each: np.concatenate(each)[: len(paths)], *(one[1] for one in found))
        d_time, d_events, d_window = slopes
        totals = np.stack([flat(leaf, number) for leaf in totals], axis=-1)
        time, event_parts = flat(d_time, number) / units, [flat(leaf, number) / units for leaf in d_events]
        in_window = [flat(leaf, number) for leaf in d_window]
        in_window = np.stack(in_window, axis=-1) if in_window else np.zeros((*time.shape, 1))
        no_window = np.zeros((*time.shape, 1))
        for index, path in enumerate(paths):
            if "likelihood" in path:  # uses no window: it rests on all sticks
                in_window[index] = no_window[index] = totals[:, 1:]
        status, t1 = flat(status, number).astype(int), problem.t1
        return [
            _counted_rows(one, t1, status, totals, time, [], no_window)
            if one.ignores_stick_count
            else _counted_rows(one, t1, status, totals, time, event_parts, in_window)
            for one in problem.totals
        ]

    return count


def _counted_rows(
    statistic: OfTotals, t1: float, status: np.ndarray, totals: np.ndarray, time: np.ndarray,
    event_parts: list[np.ndarray], in_window: np.ndarray,
) -> Rows:  # fmt: skip
    """The rows of one statistic. `time`: derivatives of stick time; `event_parts`: of the number of sticks."""
    weights = statistic.weights(t1)
    # The number of sticks has no pathwise derivative: it is locally constant.
    pathwise = time[..., None] * weights[:, 0]
    slopes = [np.stack([time, part], axis=-1) @ weights[:, :2].T for part in event_parts] or [pathwise]
    parts = totals @ weights[:, :2].T + weights[:, 2]
    return Rows(status, parts, np.stack(slopes, axis=2), pathwise, in_window)


def recorded(problem: Problem, pilot: Pilot, bandwidths: np.ndarray) -> Source:
    """Derivatives by all parameters from recorded stick sequences, with a window per bandwidth."""
    units = units_of(problem.engine(), problem.paths())[:, None, None]
    record = recorder(problem, buffer_sizes_for(problem, pilot), bandwidths)

    def rows_of(features: Features, slopes: Features, status: AnyArray, number: int) -> Rows:
        pathwise, events = (np.asarray(leaf, float)[:, :number] for leaf in (slopes.parts, slopes.event_parts))
        derivatives = (pathwise[:, :, None] + events) / units[..., None]
        parts, in_window = np.asarray(features.parts, float)[:number], np.asarray(slopes.in_window, float)[:, :number]
        return Rows(np.asarray(status)[:number], parts, derivatives, pathwise / units, in_window)

    def rows(first: int, number: int) -> list[Rows]:
        *found, status = record(first)
        return [rows_of(features, slopes, status, number) for features, slopes in zip(*found, strict=True)]

    return Source(rows, sequence_lanes(problem), bandwidths)


_Recorded: TypeAlias = tuple[tuple[Features, ...], tuple[Features, ...], AnyArray]


def recorder(problem: Problem, buffer: BufferSizes, bandwidths: np.ndarray) -> Callable[[int], _Recorded]:
    """A function of a chunk's first sample: `Features` of each statistic, their derivatives, status."""
    engine = wrapped(problem.engine(), partial(recording, fixed_start=problem.fixed_start))
    paths, lanes = wrapped_paths(problem), sequence_lanes(problem)

    def record(first: int) -> _Recorded:
        job = problem.job(engine, first, lanes)

        def run(buffer: BufferSizes) -> tuple[_Recorded, RecordedCounts]:
            features, slopes, counts = sequence_chunk(
                problem.statistics, job, np.asarray(bandwidths, problem.dtype), paths=paths, lanes=lanes, buffer=buffer,
                dtype=problem.dtype,
            )  # fmt: skip
            return (features, slopes, counts.status), counts

        return with_buffer(run, buffer)

    return record


def with_buffer(
    run: Callable[[BufferSizes], tuple[_Result, RecordedCounts]], buffer: BufferSizes, tries: int = _MOST_TRIES
) -> _Result:
    """The result of `run`, with larger buffers until all fits, or `tries` are used up."""
    result, (status, sticks, candidates) = run(buffer)
    # One slot more than there are sticks: a stick of zero length may be inserted.
    slots, candidates = (8 * -(-int(most) // 8) for most in (np.max(sticks) + 1, np.max(candidates)))
    larger = BufferSizes(buffer.blocks, max(slots, buffer.slots), max(candidates, buffer.candidates))
    if larger == buffer and np.any(np.isin(status, (Status.BASE_TOO_SHORT, Status.OUT_OF_STEPS))):
        larger = buffer._replace(blocks=2 * buffer.blocks)
    return result if larger == buffer or tries == 1 else with_buffer(run, larger, tries - 1)


def flat(leaf: AnyArray, number: int) -> np.ndarray:
    """The first samples of an array (..., rows, lanes)."""
    return np.asarray(leaf, float).reshape(*np.shape(leaf)[:-2], -1)[..., :number]
