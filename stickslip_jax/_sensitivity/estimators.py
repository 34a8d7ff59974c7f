"""The three ways to estimate a sensitivity: counting engines, recorded stick sequences, finite differences."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .._dynamics.chunks import chunks_of
from .._dynamics.lanes import Engine, Job
from .._inputs.numbers import Parameter, Path, check_numbers, with_numbers
from .._status import Status
from .._systems.built_in import is_built_in
from .counting import IntervalCounting, Likelihood
from .ensembles import ends_of, samples_per_task, simulated
from .problem import Pilot, Problem, buffer_sizes_for, lanes_and_rows, sequence_lanes
from .random_inputs import RandomEngine, inside, over, plain
from .runs import Accumulator, Rows, count_chunk, run_chunks, sequence_chunk, units_of, value_chunk
from .sequences import BufferSizes
from .statistic import OfTotals
from .step_counting import StepCounting
from .traces import traced

_MOST_DOUBLINGS = 6  # of the buffers of a realisation


class Columns(NamedTuple):
    """First columns of the derivatives of numerator and denominator by one parameter, and of their pathwise parts.

    `derivative` has one entry per window, the widest first.
    """

    derivative: tuple[int, ...]
    pathwise: int


def _columns(parameters: int, windows: int, paths: int, pathwise: list[int] | None = None) -> tuple[Columns, ...]:
    """Columns of the parameters in rows of parts (2,), derivatives (paths, windows, 2), pathwise parts (paths, 2).

    The first paths are those of the parameters; `pathwise`: for each parameter, the path whose pathwise part to use.
    """
    return tuple(
        Columns(
            tuple(2 + 2 * (index * windows + window) for window in range(windows)),
            2 + 2 * (paths * windows + (index if pathwise is None else pathwise[index])),
        )
        for index in range(parameters)
    )


def counted(problem: Problem, pilot: Pilot, bandwidths: np.ndarray) -> tuple[Accumulator, tuple[Columns, ...]]:
    """Derivatives by all parameters with a counting engine, a window per bandwidth; without any, the pathwise part."""
    engine = counting_engine(problem, pilot, bandwidths)
    paths, number = list(counting_paths(problem)), len(problem.parameters)
    pathwise = list(range(number))
    for index, path in enumerate(problem.paths()):
        score = score_path(engine, path)
        if score is not None:  # its derivative comes from the likelihood; the pathwise one is found beside it
            paths[index] = score
            pathwise[index] = len(paths)
            paths.append(path)
    accumulator = _run_counting(problem, engine, tuple(paths))
    return accumulator, _columns(number, max(1, len(bandwidths)), len(paths), pathwise)


def counting_engine(problem: Problem, pilot: Pilot, bandwidths: np.ndarray) -> Any:
    """The engine that counts, an `IntervalCounting` or a `StepCounting`; of a problem with inputs, a `RandomEngine`
    over one. Without `bandwidths`, for pathwise derivatives only.
    """
    bandwidths = np.asarray(bandwidths, problem.dtype)

    def counting(engine):
        if not problem.by_intervals:
            return StepCounting(engine, bandwidths, problem.fixed_start)
        likelihood = None
        if engine.law.has_exponential_gaps:
            likelihood = Likelihood(engine.law.rate, pilot.stick_time, pilot.sticks)
        return IntervalCounting(
            engine.system, engine.law, engine.t1, engine.y0, bandwidths, likelihood, problem.fixed_start
        )

    return over(problem.engine(), counting)


def score_path(engine: Any, path: Path) -> Path | None:
    """The path of the rate that the likelihood of a Poisson base knows, where `path` is that of the base's rate."""
    *outer, parent, name = path
    if (parent, name) != ("law", "rate") or outer not in ([], ["template"]):
        return None
    counting = plain(engine)
    if not isinstance(counting, IntervalCounting) or counting.likelihood is None:
        return None
    return (*outer, "likelihood", "rate")


def counting_paths(problem: Problem) -> tuple[Path, ...]:
    """Paths of the parameters in the counting engine."""
    return problem.paths() if problem.by_intervals else tuple(inside(path, "steps") for path in problem.paths())


def _run_counting(problem: Problem, engine: Any, paths: tuple[Path, ...]) -> Accumulator:
    """Moments of the statistic's parts, their derivatives by every path and window, and the pathwise parts of these."""
    per_task, record = _counter(problem, engine, paths)

    def simulate(first: int, number: int) -> Rows:
        parts, slopes, pathwise, near, status = record(first, number)
        return Rows.of(status, parts, slopes, pathwise, near[: len(problem.parameters)])

    return run_chunks(simulate, problem.samples, per_task, problem.threads)


def _counter(problem: Problem, engine: Any, paths: tuple[Path, ...]) -> tuple[int, Callable[[int, int], Any]]:
    """The largest number of samples of a task, and a function of a task's first sample and number of samples.

    The function gives the parts (samples, 2), their derivatives (paths, samples, windows, 2), the pathwise parts of
    these (paths, samples, 2), how many margins each window reached (paths, samples, windows), and status.
    """
    assert isinstance(problem.statistic, OfTotals)
    lanes, rows, per_task = lanes_and_rows(problem)
    weights = problem.statistic.weights(problem.t1)
    units = units_of(engine, paths)[:, None]

    def record(first: int, number: int) -> Any:
        totals, (d_time, d_births, near), status = count_chunk[is_built_in(engine)](
            engine, problem.own_leaves(first, lanes * rows), problem.key_data, np.uint32(first),
            np.int32(-(-number // lanes)), paths=paths, lanes=lanes, rows=rows, dtype=problem.dtype,
        )  # fmt: skip
        totals = np.stack([_flat(leaf, number) for leaf in totals], axis=-1)
        time, births = _flat(d_time, number) / units, [_flat(leaf, number) / units for leaf in d_births]
        # The number of sticks has no pathwise derivative: it is locally constant.
        pathwise = time[..., None] * weights[:, 0]
        slopes = [np.stack([time, born], axis=-1) @ weights[:, :2].T for born in births] or [pathwise]
        slopes = np.stack(slopes, axis=2)
        near = np.stack([_flat(leaf, number) for leaf in near], axis=-1) if near else np.zeros(slopes.shape[:3])
        for index, path in enumerate(paths):
            if "likelihood" in path:  # uses no window: it rests on all sticks
                near[index] = totals[:, 1:]
        parts = totals @ weights[:, :2].T + weights[:, 2]
        return parts, slopes, pathwise, near, _flat(status, number).astype(int)

    return per_task, record


def recorded(problem: Problem, pilot: Pilot, bandwidths: np.ndarray) -> tuple[Accumulator, tuple[Columns, ...]]:
    """Derivatives by all parameters from recorded stick sequences, with a window per bandwidth."""
    parameters, units = len(problem.parameters), units_of(problem.engine(), problem.paths())[:, None, None]
    record = _recorder(problem, buffer_sizes_for(problem, pilot), bandwidths)

    def simulate(first: int, number: int) -> Rows:
        features, slopes, status = record(first)
        pathwise, events = (np.asarray(leaf, float)[:, :number] for leaf in (slopes.parts, slopes.events))
        derivatives = (pathwise[:, :, None] + events) / units[..., None]
        parts, near = np.asarray(features.parts, float)[:number], np.asarray(slopes.near, float)[:, :number]
        return Rows.of(np.asarray(status)[:number], parts, derivatives, pathwise / units, near)

    accumulator = run_chunks(simulate, problem.samples, sequence_lanes(problem), problem.threads)
    return accumulator, _columns(parameters, len(bandwidths), parameters)


def _recorder(problem: Problem, buffer: BufferSizes, bandwidths: np.ndarray) -> Callable[[int], Any]:
    """A function of a chunk's first sample: `Features`, their derivatives, status."""
    engine = over(problem.engine(), partial(traced, fixed_start=problem.fixed_start))
    paths, lanes = tuple(inside(path, "engine") for path in problem.paths()), sequence_lanes(problem)

    def record(first: int) -> Any:
        own = problem.own_leaves(first, lanes)

        def run(buffer: BufferSizes) -> Any:
            features, slopes, (status, sticks, edges) = sequence_chunk(
                problem.statistic, engine, own, np.asarray(bandwidths, problem.dtype), problem.key_data,
                np.uint32(first), paths=paths, lanes=lanes, buffer=buffer, dtype=problem.dtype,
            )  # fmt: skip
            return (features, slopes, status), status, sticks, edges

        return _with_buffer(run, buffer)

    return record


def differenced(
    problem: Problem, pilot: Pilot, steps: np.ndarray, with_pathwise: bool
) -> tuple[Accumulator, tuple[Columns, ...]]:
    """Derivatives by all parameters as central differences of every trajectory, ``(f(p + s) - f(p - s)) / (2 s)``.

    `steps`: s, relative to the parameter's size. Both ends use the same random numbers. In place of the margins that a
    window reached, the trajectories are counted whose number of sticks differs between the ends.
    """
    engine, paths = problem.engine(), problem.paths()
    units = units_of(engine, paths)
    values, per_task, pathwise_of = _by_totals(problem, pilot) if problem.is_counted else _by_sequences(problem, pilot)
    pairs: list[tuple[Any, Any, Any]] = []
    for path, parameter, unit in zip(paths, problem.parameters, units, strict=True):
        for length in steps * unit:
            below, above = _ends(engine, path, parameter, length)
            pairs.append((length, below, above))
    pathwise = pathwise_of if with_pathwise else None
    return _differences(problem, engine, pairs, values, per_task, pathwise)


def differenced_ensembles(problem: Problem, steps: np.ndarray) -> tuple[Accumulator, tuple[Columns, ...]]:
    """As `differenced`, of whole ensembles: of regularised dynamics."""
    model = problem.model
    assert model is not None
    pairs = []
    for parameter in problem.parameters:
        for length in steps * (abs(parameter.value) or 1.0):
            pairs.append((length, *(simulated(problem, end) for end in ends_of(model, parameter, length))))
    per_task = samples_per_task(problem)
    return _differences(problem, simulated(problem, model), pairs, lambda values, *task: values(*task), per_task, None)


def _differences(
    problem: Problem,
    centre: Any,
    pairs: list[tuple[Any, ...]],
    values: Callable[[Any, int, int], Any],
    per_task: int,
    pathwise_of: Callable[[int, int], np.ndarray] | None,
) -> tuple[Accumulator, tuple[Columns, ...]]:
    """Moments of the parts and their differences. `pairs`: length and both ends, for all parameters and steps."""
    parameters = len(problem.parameters)
    steps = len(pairs) // parameters

    def simulate(first: int, number: int) -> Rows:
        def difference(length: float, *ends: Any) -> Any:
            (low, low_status, low_count), (high, high_status, high_count) = (values(end, first, number) for end in ends)
            return (high - low) / (2 * length), np.maximum(low_status, high_status), low_count != high_count

        parts, status, _ = values(centre, first, number)
        differences, statuses, near = zip(*(difference(*pair) for pair in pairs), strict=True)
        shape = (parameters, steps, number)
        slopes = np.moveaxis(np.reshape(differences, (*shape, 2)), 2, 1)
        pathwise = np.zeros((parameters, number, 2)) if pathwise_of is None else pathwise_of(first, number)
        near = np.moveaxis(np.reshape(near, shape), 2, 1).astype(float)
        return Rows.of(np.max([status, *statuses], axis=0), parts, slopes, pathwise, near)

    accumulator = run_chunks(simulate, problem.samples, per_task, problem.threads)
    return accumulator, _columns(parameters, steps, parameters)


# A function of an engine, a task's first sample and number of samples that gives the statistic's parts, status and
# number of sticks; the largest number of samples of a task; a function of first sample and number of samples that gives
# the pathwise derivatives.
_Values = tuple[Callable[[Engine, int, int], Any], int, Callable[[int, int], np.ndarray]]


def _by_totals(problem: Problem, pilot: Pilot) -> _Values:
    """The functions that `differenced` calls, for statistics of totals."""
    assert isinstance(problem.statistic, OfTotals)
    lanes, rows, per_task = lanes_and_rows(problem)
    weights = problem.statistic.weights(problem.t1)
    _, pathwise_of = _counter(problem, counting_engine(problem, pilot, np.zeros(0)), counting_paths(problem))

    def values(engine: Engine, first: int, number: int) -> Any:
        own = problem.own_leaves(first, lanes * rows)
        if isinstance(engine, RandomEngine):
            engine, own = engine.drawn(own)
        job = Job(engine, problem.key_data, np.uint32(first), np.int32(-(-number // lanes)), own)
        with_records = problem.random is not None and problem.random.inputs.has_sampled_law
        results = chunks_of(engine, with_records=with_records).summarize(
            job, lanes=lanes, rows=rows, dtype=problem.dtype
        )
        totals = np.stack([_flat(leaf, number) for leaf in (results.stick_time, results.sticks)], axis=-1)
        return totals @ weights[:, :2].T + weights[:, 2], _flat(results.status, number).astype(int), totals[:, 1]

    def pathwise(first: int, number: int) -> np.ndarray:
        return pathwise_of(first, number)[2]

    return values, per_task, pathwise


def _by_sequences(problem: Problem, pilot: Pilot) -> _Values:
    """The functions that `differenced` calls, for statistics of recorded sequences."""
    lanes, units = sequence_lanes(problem), units_of(problem.engine(), problem.paths())[:, None, None]
    buffer = buffer_sizes_for(problem, pilot)._replace(edges=0)
    record = _recorder(problem, buffer, np.zeros(0))

    def values(engine: Engine, first: int, number: int) -> Any:
        own = problem.own_leaves(first, lanes)
        if isinstance(engine, RandomEngine):
            engine, own = engine.drawn(own)
        watched = over(engine, partial(traced, fixed_start=problem.fixed_start))

        def run(buffer: BufferSizes) -> Any:
            done = value_chunk(
                problem.statistic, watched, own, problem.key_data, np.uint32(first), lanes=lanes, buffer=buffer,
                dtype=problem.dtype,
            )  # fmt: skip
            return done, done[1], done[2], np.zeros(1)

        parts, status, sticks = (np.asarray(leaf)[:number] for leaf in _with_buffer(run, buffer))
        return parts.astype(float), status, sticks

    def pathwise(first: int, number: int) -> np.ndarray:
        return np.asarray(record(first)[1].parts, float)[:, :number] / units

    return values, lanes, pathwise


def _ends(engine: Engine, path: Path, parameter: Parameter, length: float) -> list[Engine]:
    """The engine with the parameter lowered and raised by `length`. Raises ValueError if a value is not allowed."""
    ends = [with_numbers(engine, (path,), (float(parameter.value + sign * length),)) for sign in (-1, 1)]
    try:
        for end in ends:
            check_numbers(end)
    except ValueError as error:
        raise ValueError(
            f"Argument step (or relative_bandwidth) must be smaller: {parameter.name} = {parameter.value:g} is to be "
            f"varied by {length:g}, which it does not allow. {error}"
        ) from error
    return ends


def _with_buffer(run: Callable[[BufferSizes], tuple[Any, Any, Any, Any]], buffer: BufferSizes) -> Any:
    """The first output of `run`, with buffers doubled until all fits; its others: status, sticks, edges of samples."""
    done = None
    for _ in range(_MOST_DOUBLINGS):
        done, status, sticks, edges = run(buffer)
        cut = np.isin(status, (Status.BASE_TOO_SHORT, Status.OUT_OF_STEPS))
        # One slot more than there are sticks: a stick of zero length may be inserted.
        needed = BufferSizes(buffer.blocks, 8 * -(-(int(np.max(sticks)) + 1) // 8), 8 * -(-int(np.max(edges)) // 8))
        if needed.slots > buffer.slots or needed.edges > buffer.edges:
            buffer = BufferSizes(buffer.blocks, max(needed.slots, buffer.slots), max(needed.edges, buffer.edges))
        elif np.any(cut):
            buffer = buffer._replace(blocks=2 * buffer.blocks)
        else:
            break
    return done


def _flat(leaf: Any, number: int) -> np.ndarray:
    """The first samples of an array (..., rows, lanes)."""
    return np.asarray(leaf, float).reshape(*np.shape(leaf)[:-2], -1)[..., :number]
