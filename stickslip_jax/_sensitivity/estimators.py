"""Sensitivities by event parts: from engines that count, and from recorded stick sequences."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from .._dynamics.common.engine import Engine
from .._status import Status
from .._systems.built_in import is_built_in
from .._types import AnyArray
from .._uncertainty.numbers import Path
from .chunks import Accumulator, RecordedCounts, Rows, count_chunk, run_chunks, sequence_chunk, units_of
from .counting import IntervalCounting, Likelihood
from .problem import Pilot, Problem, buffer_sizes_for, lanes_and_rows, sequence_lanes
from .random_inputs import RandomEngine, single_engine, wrapped, wrapped_path
from .recording import recording
from .sequences import BufferSizes, Features
from .statistic import OfTotals
from .step_counting import StepCounting

_MOST_TRIES = 6  # with larger and larger buffers of a realisation

_Result = TypeVar("_Result")


class DerivativeColumns(NamedTuple):
    """First columns of the derivatives of numerator and denominator by one parameter, and of their pathwise parts.

    `derivative` has one entry per window, the widest first.
    """

    derivative: tuple[int, ...]
    pathwise: int


Estimated: TypeAlias = tuple[Accumulator, tuple[DerivativeColumns, ...]]
"""Sums over all samples, and where the derivatives by each parameter stand in them."""


def columns_of(
    parameters: int, windows: int, paths: int, pathwise: list[int] | None = None
) -> tuple[DerivativeColumns, ...]:
    """Columns of the parameters in rows of parts (2,), derivatives (paths, windows, 2), pathwise parts (paths, 2).

    The first paths are those of the parameters; `pathwise`: for each parameter, the path whose pathwise part to use.
    """
    return tuple(
        DerivativeColumns(
            tuple(2 + 2 * (index * windows + window) for window in range(windows)),
            2 + 2 * (paths * windows + (index if pathwise is None else pathwise[index])),
        )
        for index in range(parameters)
    )


def counted(problem: Problem, pilot: Pilot, bandwidths: np.ndarray) -> Estimated:
    """Derivatives by all parameters with a counting engine, a window per bandwidth; without any, the pathwise part."""
    engine = counting_engine(problem, pilot, bandwidths)
    paths, number = list(wrapped_paths(problem)), len(problem.parameters)
    pathwise = list(range(number))
    for index, path in enumerate(paths[:number]):
        score = score_path(engine, path)
        if score is not None:  # its derivative comes from the likelihood; the pathwise one is found beside it
            paths[index] = score
            pathwise[index] = len(paths)
            paths.append(path)
    per_task, count = counter(problem, engine, tuple(paths))

    def simulate(first: int, samples: int) -> Rows:
        rows = count(first, samples)
        return rows._replace(in_window=rows.in_window[:number])

    accumulator = run_chunks(simulate, problem.samples, per_task, problem.threads)
    return accumulator, columns_of(number, max(1, len(bandwidths)), len(paths), pathwise)


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
        likelihood = None
        if engine.law.has_exponential_gaps:
            likelihood = Likelihood(engine.law.rate, pilot.stick_time, pilot.sticks)
        return IntervalCounting(engine, bandwidths, likelihood, problem.fixed_start)

    return wrapped(problem.engine(), counting)


def score_path(engine: Engine, path: Path) -> Path | None:
    """The path of the rate that the likelihood of a Poisson base knows, where `path` is that of the base's rate."""
    outer, inner = path[:-3], path[-3:]
    counting = single_engine(engine)
    if inner != ("engine", "law", "rate") or outer not in ((), ("template",)):
        return None
    if not isinstance(counting, IntervalCounting) or counting.likelihood is None:
        return None
    return (*outer, "likelihood", "rate")


def wrapped_paths(problem: Problem) -> tuple[Path, ...]:
    """Paths of the parameters in an engine that counts or records."""
    return tuple(map(wrapped_path, problem.paths()))


def counter(problem: Problem, engine: Engine, paths: tuple[Path, ...]) -> tuple[int, Callable[[int, int], Rows]]:
    """The largest number of samples of a task, and a function of a task's first sample and number of samples."""
    assert isinstance(problem.statistic, OfTotals)
    lanes, rows, per_task = lanes_and_rows(problem)
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

    return per_task, count


def recorded(problem: Problem, pilot: Pilot, bandwidths: np.ndarray) -> Estimated:
    """Derivatives by all parameters from recorded stick sequences, with a window per bandwidth."""
    parameters, units = len(problem.parameters), units_of(problem.engine(), problem.paths())[:, None, None]
    record = recorder(problem, buffer_sizes_for(problem, pilot), bandwidths)

    def simulate(first: int, number: int) -> Rows:
        features, slopes, status = record(first)
        pathwise, events = (np.asarray(leaf, float)[:, :number] for leaf in (slopes.parts, slopes.event_parts))
        derivatives = (pathwise[:, :, None] + events) / units[..., None]
        parts, in_window = np.asarray(features.parts, float)[:number], np.asarray(slopes.in_window, float)[:, :number]
        return Rows(np.asarray(status)[:number], parts, derivatives, pathwise / units, in_window)

    accumulator = run_chunks(simulate, problem.samples, sequence_lanes(problem), problem.threads)
    return accumulator, columns_of(parameters, len(bandwidths), parameters)


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
