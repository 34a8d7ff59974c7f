"""Sensitivities by event parts: from engines that count, and from recorded stick sequences."""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np

from .._dynamics.common.engine import Engine
from .._status import Status
from .._systems.built_in import is_built_in
from .._types import AnyArray
from .._uncertainty.numbers import Path
from .chunks import Accumulator, Rows, count_chunk, run_chunks, sequence_chunk, units_of
from .counting import IntervalCounting, Likelihood
from .problem import Pilot, Problem, buffer_sizes_for, lanes_and_rows, sequence_lanes
from .random_inputs import RandomEngine, single_engine, wrapped, wrapped_path
from .recording import recording
from .sequences import BufferSizes, Features, RecordedCounts
from .statistic import OfTotals
from .step_counting import StepCounting

_MOST_TRIES = 6  # with larger and larger buffers of a realisation

_Result = TypeVar("_Result")


def counted(problem: Problem, pilot: Pilot, bandwidths: np.ndarray) -> Accumulator:
    """Derivatives by all parameters with a counting engine, a window per bandwidth; without any, the pathwise part."""
    engine = counting_engine(problem, pilot, bandwidths)
    paths = wrapped_paths(problem)
    # The derivative by a rate comes from the likelihood; its pathwise part is found beside it.
    every = tuple(dict.fromkeys((*score_paths(engine, paths), *paths)))
    count = counter(problem, engine, every)

    def simulate(first: int, samples: int) -> Rows:
        rows = count(first, samples)
        return rows._replace(in_window=rows.in_window[: len(paths)])

    accumulator = run_chunks(simulate, problem.samples, lanes_and_rows(problem)[2], problem.threads)
    return accumulator._replace(pathwise=tuple(every.index(path) for path in paths))


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


def counter(problem: Problem, engine: Engine, paths: tuple[Path, ...]) -> Callable[[int, int], Rows]:
    """A function of a task's first sample and number of samples, with derivatives by the numbers at `paths`."""
    assert isinstance(problem.statistic, OfTotals)
    lanes, rows, _ = lanes_and_rows(problem)
    weights = problem.statistic.weights(problem.t1)
    units = units_of(engine, paths)[:, None]

    def count(first: int, number: int) -> Rows:
        job = problem.job(engine, first, lanes * rows, -(-number // lanes))
        totals, (d_time, d_events, d_window), status = count_chunk[is_built_in(engine)](
            job, paths=paths, lanes=lanes, rows=rows, dtype=problem.dtype
        )
        totals = np.stack([flat(leaf, number) for leaf in totals], axis=-1)
        time, event_parts = flat(d_time, number) / units, [flat(leaf, number) / units for leaf in d_events]
        # The number of sticks has no pathwise derivative: it is locally constant.
        pathwise = time[..., None] * weights[:, 0]
        slopes = [np.stack([time, part], axis=-1) @ weights[:, :2].T for part in event_parts] or [pathwise]
        slopes = np.stack(slopes, axis=2)
        in_window = [flat(leaf, number) for leaf in d_window]
        in_window = np.stack(in_window, axis=-1) if in_window else np.zeros(slopes.shape[:3])
        for index, path in enumerate(paths):
            if "likelihood" in path:  # uses no window: it rests on all sticks
                in_window[index] = totals[:, 1:]
        parts = totals @ weights[:, :2].T + weights[:, 2]
        return Rows(flat(status, number).astype(int), parts, slopes, pathwise, in_window)

    return count


def recorded(problem: Problem, pilot: Pilot, bandwidths: np.ndarray) -> Accumulator:
    """Derivatives by all parameters from recorded stick sequences, with a window per bandwidth."""
    units = units_of(problem.engine(), problem.paths())[:, None, None]
    record = recorder(problem, buffer_sizes_for(problem, pilot), bandwidths)

    def simulate(first: int, number: int) -> Rows:
        features, slopes, status = record(first)
        pathwise, events = (np.asarray(leaf, float)[:, :number] for leaf in (slopes.parts, slopes.event_parts))
        derivatives = (pathwise[:, :, None] + events) / units[..., None]
        parts, in_window = np.asarray(features.parts, float)[:number], np.asarray(slopes.in_window, float)[:, :number]
        return Rows(np.asarray(status)[:number], parts, derivatives, pathwise / units, in_window)

    return run_chunks(simulate, problem.samples, sequence_lanes(problem), problem.threads)


def recorder(
    problem: Problem, buffer: BufferSizes, bandwidths: np.ndarray
) -> Callable[[int], tuple[Features, Features, AnyArray]]:
    """A function of a chunk's first sample: `Features`, their derivatives, status."""
    engine = wrapped(problem.engine(), partial(recording, fixed_start=problem.fixed_start))
    paths, lanes = wrapped_paths(problem), sequence_lanes(problem)

    def record(first: int) -> tuple[Features, Features, AnyArray]:
        job = problem.job(engine, first, lanes)

        def run(buffer: BufferSizes) -> tuple[tuple[Features, Features, AnyArray], RecordedCounts]:
            features, slopes, counts = sequence_chunk(
                problem.statistic, job, np.asarray(bandwidths, problem.dtype), paths=paths, lanes=lanes, buffer=buffer,
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
