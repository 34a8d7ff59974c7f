"""Estimates of derivatives by chunks of realisations: by event parts, and by differences with common random
numbers.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._compiler import WIDE_VECTORS, CompiledNatively
from .._dynamics.common.lanes import Engine, Job, summarize
from .._dynamics.engine_choice import compiled_for
from .._dynamics.sticks import FlatSticks
from .._ensemble.call import simulate_batch
from .._ensemble.parts import RETAINED
from .._ensemble.setup import EnsembleSetup, OutputRunner
from .._foundation.types import AnyArray, DType, IntArray, Status
from .._numerics.sums import Moments
from .._statistics.accumulator import Numbering
from .._systems.system import is_built_in
from .._uncertainty.inputs import StochasticModel
from .._uncertainty.numbers import NumberPath, Parameter, check_numbers, number_at, with_numbers
from .counting import IntervalCounting, Likelihood, StepCounting, recording
from .problem import Pilot, SensitivityProblem, buffer_sizes_for, lanes_and_rows, sequence_lanes
from .statistic import (
    BufferSizes,
    Features,
    OfOutput,
    OfTotals,
    RandomEngine,
    RecordedCounts,
    StickSequence,
    StickStatistic,
    features_of,
    record_sequences,
    single_engine,
    wrapped,
    wrapped_path,
)

# Chunks of realisations with derivatives: compiled functions, and the threads that call them.


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
    paths: tuple[NumberPath, ...],
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


def units_of(engine: Engine, paths: tuple[NumberPath, ...]) -> Float[np.ndarray, " paths"]:
    """The units in which `derivatives_of` varies the numbers at `paths`."""
    return np.array([abs(float(number_at(engine, path))) or 1.0 for path in paths])


_Slopes: TypeAlias = tuple[Array, tuple[Array, ...], tuple[Array, ...]]
"""Derivatives of stick time, and of `event_parts` and `in_window` of `Counted`, (paths, rows, lanes)."""


def _count(
    job: Job, chosen: AnyArray, *, paths: tuple[NumberPath, ...], lanes: int, rows: int, dtype: DType
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
    paths: tuple[NumberPath, ...],
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
# Native loops and wide vectors only where all compiled functions are the package's own (see `engine_choice.py`).
count_chunk = {
    True: CompiledNatively(_count, _COUNT_STATIC, compiler_options=WIDE_VECTORS),
    False: jax.jit(_count, static_argnames=_COUNT_STATIC),
}
_BUFFER = ("statistics", "lanes", "buffer", "dtype")
value_chunk = jax.jit(_values, static_argnames=_BUFFER)
sequence_chunk = jax.jit(_sequence, static_argnames=("paths", *_BUFFER))


# Sensitivities by event parts: from engines that count, and from recorded stick sequences.


_TOGETHER = 2  # derivatives in one pass of time steps: XLA (jaxlib 0.10) makes no native loop of three with damping
_MOST_TRIES = 6  # with larger and larger buffers of a realisation

_Result = TypeVar("_Result")


def counted(problem: SensitivityProblem, pilot: Pilot, bandwidths: np.ndarray) -> Source:
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
    problem: SensitivityProblem, pilot: Pilot, bandwidths: np.ndarray
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


def score_paths(engine: Engine, paths: tuple[NumberPath, ...]) -> tuple[NumberPath, ...]:
    """The `paths`, but where one is that of the rate of the base's gaps, that of the rate the likelihood knows."""
    counting, outer = single_engine(engine), ("template",) if isinstance(engine, RandomEngine) else ()
    if not isinstance(counting, IntervalCounting) or counting.likelihood is None:
        return paths
    rate = (*outer, "engine", "law", counting.engine.law.gap_rate)
    return tuple((*outer, "likelihood", "rate") if path == rate else path for path in paths)


def wrapped_paths(problem: SensitivityProblem) -> tuple[NumberPath, ...]:
    """Paths of the parameters in an engine that counts or records."""
    return tuple(map(wrapped_path, problem.paths()))


def counter(
    problem: SensitivityProblem, engine: Engine, paths: tuple[NumberPath, ...]
) -> Callable[[int, int], list[Rows]]:
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


def recorded(problem: SensitivityProblem, pilot: Pilot, bandwidths: np.ndarray) -> Source:
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


def recorder(problem: SensitivityProblem, buffer: BufferSizes, bandwidths: np.ndarray) -> Callable[[int], _Recorded]:
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


# Finite differences with common random numbers: of every trajectory, or between ensembles.
#
# Regularised dynamics, which only ensembles simulate, has no boundaries: there a stick is a time below a threshold. The
# options of the method that follow from the system, such as the threshold, follow the parameter. So do the matrices of
# structures with a list of contacts.


_ALL = Numbering(1, True)  # counts a stick that begins at t = 0, as the statistics do

_TOLERANCE = 0.1
"""How far, in standard errors, the derivatives of an output by two steps may differ even if it is not by chance.

Of a smooth output hardly anything is by chance in their difference, which is of the order of the squared step.
"""

_Tree = TypeVar("_Tree")


class _Values(NamedTuple):
    """Of some samples: numerator and denominator of each statistic, status, and number of sticks.

    Of outputs, `counted` holds their values in place of the number of sticks.
    """

    parts: Float[np.ndarray, "statistics samples 2"]
    status: Int[np.ndarray, " samples"]
    counted: Float[np.ndarray, "statistics samples"]


_ValuesOf: TypeAlias = Callable[[int, int], _Values]
"""A function of a task's first sample and its number of samples."""
_Pathwise: TypeAlias = Callable[[int, int], Float[np.ndarray, "statistics parameters samples 2"]]
"""The pathwise derivatives, likewise."""
_Pairs: TypeAlias = list[tuple[float, list[_ValuesOf]]]
"""The difference's half-width and the values at both ends, for all parameters and steps."""


def differenced(problem: SensitivityProblem, pilot: Pilot, steps: np.ndarray, with_pathwise: bool) -> Source:
    """Derivatives by all parameters as central differences of every trajectory, ``(f(p + s) - f(p - s)) / (2 s)``.

    `steps`: s, relative to the parameter's size. Both ends use the same random numbers. In place of the distances
    inside a window, the trajectories are counted whose number of sticks differs between the ends.
    """
    if problem.needs_ensembles:
        return _differenced_ensembles(problem, steps)
    engine, paths = problem.engine(), problem.paths()
    values, per_task, pathwise = _by_totals(problem, pilot) if problem.is_counted else _by_sequences(problem, pilot)
    pairs = [
        (length, [partial(values, end) for end in _ends_of(engine, path, parameter, length)])
        for path, parameter, unit in zip(paths, problem.parameters, units_of(engine, paths), strict=True)
        for length in steps * unit
    ]
    rows = _differences(problem, partial(values, engine), pairs, pathwise if with_pathwise else None)
    return Source(rows, per_task, steps)


def _differenced_ensembles(problem: SensitivityProblem, steps: np.ndarray) -> Source:
    """As `differenced`, of whole ensembles: of regularised dynamics, of systems with a list of contacts, of outputs."""
    model = problem.model
    assert model is not None
    pairs = [
        (length, [_simulated(problem, end) for end in _ends_of(model, parameter.path, parameter, length)])
        for parameter in problem.parameters
        for length in steps * (abs(parameter.value) or 1.0)
    ]
    rows = _differences(problem, _simulated(problem, model), pairs, None)
    return Source(rows, lanes_and_rows(problem)[2], steps, tolerance=_TOLERANCE if problem.is_output else 0.0)


def _ends_of(tree: _Tree, path: NumberPath, parameter: Parameter, length: float) -> list[_Tree]:
    """An engine or model with the parameter at `path` lowered and raised by `length`.

    Raises ValueError if a value is not allowed.
    """
    ends = [with_numbers(tree, (path,), (float(parameter.value + sign * length),)) for sign in (-1, 1)]
    try:
        for end in ends:
            check_numbers(end)
    except ValueError as error:
        raise ValueError(
            f"Argument step (or relative_bandwidth) must be smaller: {parameter.name} = {parameter.value:g} is to be "
            f"varied by {length:g}, which it does not allow. {error}"
        ) from error
    return ends


def _differences(
    problem: SensitivityProblem, centre: _ValuesOf, pairs: _Pairs, pathwise_of: _Pathwise | None
) -> Callable[[int, int], list[Rows]]:
    """The parts of each statistic and their differences."""
    parameters = len(problem.parameters)
    steps = len(pairs) // parameters

    def rows(first: int, number: int) -> list[Rows]:
        def difference(length: float, ends: list[_ValuesOf]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            low, high = (end(first, number) for end in ends)
            slope = (high.parts - low.parts) / (2 * length)
            return slope, np.maximum(low.status, high.status), low.counted != high.counted

        parts, status, _ = centre(first, number)
        slopes, statuses, differs = zip(*(difference(*pair) for pair in pairs), strict=True)
        status = np.max([status, *statuses], axis=0)
        shape = (parameters, steps, len(parts), number)
        slopes = np.moveaxis(np.reshape(slopes, (*shape, 2)), (2, 3), (0, 2))
        differs = np.moveaxis(np.reshape(differs, shape), (2, 3), (0, 2)).astype(float)
        none = np.zeros((len(parts), parameters, number, 2))
        pathwise = none if pathwise_of is None else pathwise_of(first, number)
        return [
            Rows(status, values, slope, path, differ)
            for values, slope, path, differ in zip(parts, slopes, pathwise, differs, strict=True)
        ]

    return rows


# The values of an engine's samples; the largest number of samples of a task; the pathwise derivatives.
_Source: TypeAlias = tuple[Callable[[Engine, int, int], _Values], int, _Pathwise]


def _by_totals(problem: SensitivityProblem, pilot: Pilot) -> _Source:
    """What `differenced` needs, for statistics of totals."""
    lanes, rows, per_task = lanes_and_rows(problem)
    count = counter(problem, counting_engine(problem, pilot, np.zeros(0)), wrapped_paths(problem))

    def values(engine: Engine, first: int, number: int) -> _Values:
        job = _drawn(problem.job(engine, first, lanes * rows, -(-number // lanes)))
        with_records = problem.random is not None and problem.random.inputs.has_sampled_law
        results = compiled_for(job.engine, with_records=with_records).summarize(
            job, lanes=lanes, rows=rows, dtype=problem.dtype
        )
        columns = (results.stick_time, results.sticks, results.slips, results.status)
        stick_time, sticks, slips, status = (flat(leaf, number) for leaf in columns)
        return _of_totals(problem, stick_time, sticks, slips, status)

    return values, per_task, lambda first, number: np.stack([one.pathwise for one in count(first, number)])


def _of_totals(
    problem: SensitivityProblem, stick_time: np.ndarray, sticks: np.ndarray, slips: np.ndarray, status: np.ndarray
) -> _Values:
    parts = np.stack([one.parts_of(problem.t1, stick_time, sticks, slips) for one in problem.totals])
    return _Values(parts, status.astype(int), _for_each(parts, sticks))


def _for_each(parts: np.ndarray, sticks: AnyArray) -> np.ndarray:
    """The number of sticks of each sample, for each statistic."""
    return np.broadcast_to(np.asarray(sticks, float), parts.shape[:2])


def _drawn(job: Job) -> Job:
    """The job with its random numbers drawn: both ends of a difference are then compiled once."""
    if not isinstance(job.engine, RandomEngine):
        return job
    engine, varying = job.engine.drawn(job.varying)
    return job._replace(engine=engine, varying=varying)


def _by_sequences(problem: SensitivityProblem, pilot: Pilot) -> _Source:
    """What `differenced` needs, for statistics of recorded sequences."""
    lanes, units = sequence_lanes(problem), units_of(problem.engine(), problem.paths())[:, None, None]
    buffer = buffer_sizes_for(problem, pilot)._replace(candidates=0)
    record = recorder(problem, buffer, np.zeros(0))

    def values(engine: Engine, first: int, number: int) -> _Values:
        job = _drawn(problem.job(engine, first, lanes))
        job = job._replace(engine=wrapped(job.engine, partial(recording, fixed_start=problem.fixed_start)))

        def run(buffer: BufferSizes) -> tuple[tuple[tuple[AnyArray, ...], RecordedCounts], RecordedCounts]:
            found = value_chunk(problem.statistics, job, lanes=lanes, buffer=buffer, dtype=problem.dtype)
            return found, found[1]

        parts, counts = with_buffer(run, buffer)
        status, sticks = (np.asarray(leaf)[:number] for leaf in (counts.status, counts.sticks))
        parts = np.stack([np.asarray(one, float)[:number] for one in parts])
        return _Values(parts, status, _for_each(parts, sticks))

    def pathwise(first: int, number: int) -> np.ndarray:
        return np.stack([np.asarray(one.parts, float)[:, :number] / units for one in record(first)[1]])

    return values, lanes, pathwise


def _simulated(problem: SensitivityProblem, model: StochasticModel) -> _ValuesOf:
    """The values of the samples of an ensemble of `model`."""
    key = jax.random.wrap_key_data(problem.key_data)
    options = (problem.samples, 0, key, None, problem.method, "sticks", _ALL)
    run = EnsembleSetup.checked(model, problem.t1, *options)
    if problem.is_output:
        outputs = {one.output.name: one.output for one in problem.statistics if isinstance(one, OfOutput)}
        return partial(_of_outputs, OutputRunner(run, outputs))

    def values(first: int, number: int) -> _Values:
        many = simulate_batch(run, first, number, "sticks", retained=RETAINED, fewest=problem.samples)
        stick_time, sticks, slips, status = (
            np.asarray(getattr(many.totals, name)) for name in ("stick_time", "sticks", "slips", "status")
        )
        if problem.is_counted:
            return _of_totals(problem, stick_time, sticks, slips, status)
        each = [parts_of_sequences(one, many.require_sticks(), problem.t1, problem.dtype) for one in problem.statistics]
        parts = np.stack(each)
        return _Values(parts, status.astype(int), _for_each(parts, sticks))

    return values


def _of_outputs(runner: OutputRunner, first: int, number: int) -> _Values:
    """The values of outputs; a sample without a finite one did not finish."""
    values = np.stack(list(runner.values(first, number).values()))
    known = np.all(np.isfinite(values), axis=0)
    parts = np.stack([np.where(known, values, 0), np.ones_like(values)], axis=-1)
    return _Values(parts, np.where(known, Status.FINISHED, Status.NOT_FINITE).astype(int), values)


def parts_of_sequences(statistic: StickStatistic, sticks: FlatSticks, t1: float, dtype: DType) -> np.ndarray:
    """Numerator and denominator of each sample, (samples, 2)."""
    most = 8 * -(-(int(sticks.count.max()) + 1) // 8)  # few sizes: each is compiled
    slots = np.arange(len(sticks.start)) - np.repeat(sticks.first, sticks.count)
    columns = np.zeros((2, len(sticks.count), most), dtype)
    columns[:, sticks.sample, slots] = sticks.start, sticks.duration
    mask = np.arange(most) < sticks.count[:, None]
    one = jax.jit(jax.vmap(lambda *sequence: statistic.parts(StickSequence(*sequence), t1)))
    return np.stack([np.asarray(part, float) for part in one(*columns, mask)], axis=-1)
