"""Estimates of derivatives by chunks of realisations: by event parts, and by differences with common random
numbers.
"""

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial, reduce
from typing import Any, NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._compiler import WIDE_VECTORS, CompiledNatively
from .._dynamics.common.lanes import Engine, Job, SampleTotals, summarize
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
from .._uncertainty.numbers import NumberPath, check_numbers, number_at, with_numbers
from .boundaries import BoundarySums, FirstSegment
from .counting import IntervalCounting, Likelihood, StepCounting, recording
from .problem import LANES, ROWS, Pilot, SensitivityProblem, buffer_sizes_for
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
)

# Chunks of realisations with derivatives: compiled functions, and the threads that call them.


_Value = TypeVar("_Value")
_Other = TypeVar("_Other")


class Rows(NamedTuple):
    """Results of samples: numerator and denominator, their derivatives, and the pathwise parts of these.

    `in_window`: how many distances were inside each window. `tolerance`: as in `Accumulator`.
    """

    status: Int[np.ndarray, " samples"]
    parts: Float[np.ndarray, "samples 2"]
    slopes: Float[np.ndarray, "paths samples windows 2"]
    pathwise: Float[np.ndarray, "paths samples 2"]
    in_window: Float[np.ndarray, "paths samples windows"]
    tolerance: float = 0.0

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
    - `tolerance`: in standard errors, how far windows may differ where it is not by chance.
    """

    halves: tuple[Moments, Moments]
    in_window: Float[np.ndarray, "parameters windows"]
    tolerance: float = 0.0

    @property
    def columns(self) -> tuple[DerivativeColumns, ...]:
        """Where the derivatives by each parameter stand in the moments."""
        parameters, windows = self.in_window.shape
        derivatives = 2 + 2 * np.arange(parameters * windows).reshape(parameters, windows)
        pathwise = 2 + 2 * (parameters * windows + np.arange(parameters))
        return tuple(map(DerivativeColumns, map(tuple, derivatives.tolist()), pathwise.tolist()))

    @property
    def moments(self) -> Moments:
        """Moments of both halves together."""
        return self.halves[0].merge(self.halves[1])


class JointAccumulator(NamedTuple):
    """The sums of several statistics over the same samples: moments of their columns one after the other, by halves.

    - `sizes`: how many columns each statistic has. `in_window`, `tolerance`: of each, as in `Accumulator`.
    """

    halves: tuple[Moments, Moments]
    sizes: tuple[int, ...]
    in_window: tuple[Float[np.ndarray, "parameters windows"], ...]
    tolerance: tuple[float, ...]

    @classmethod
    def of(cls, rows: list[Rows]) -> "JointAccumulator":
        """The sums of one chunk, with the rows of each statistic."""
        done = np.max([one.status for one in rows], axis=0) == Status.FINISHED
        each = [one.columns for one in rows]
        columns = np.concatenate(each, axis=1)
        first, second = (Moments.of(columns[half::2][done[half::2]]) for half in (0, 1))
        in_window = tuple(one.in_window[:, done].sum(axis=1) for one in rows)
        sizes, tolerance = (tuple(one.shape[1] for one in each), tuple(one.tolerance for one in rows))
        return cls((first, second), sizes, in_window, tolerance)

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
        return Accumulator((first, second), self.in_window[number], self.tolerance[number])


class Source(NamedTuple):
    """How the rows of some statistics are found, from the same loop.

    - `rows`: of samples ``first .. first + number - 1``, for each statistic, as a function of these two.
    - `per_task`: the largest `number`. `widths`: of the windows, or the steps, relative to the parameter.
    """

    rows: Callable[[int, int], list[Rows]]
    per_task: int
    widths: Float[np.ndarray, " windows"]


def run_chunks(sources: list[Source], samples: int, threads: int) -> JointAccumulator:
    """The sums over all samples, in chunks, of the statistics of all sources; they do not depend on `threads`."""
    per_chunk = min(source.per_task for source in sources)
    firsts = range(0, samples, per_chunk)

    def simulate(first: int) -> JointAccumulator:
        number = min(per_chunk, samples - first)
        return JointAccumulator.of([rows for source in sources for rows in source.rows(first, number)])

    with ThreadPoolExecutor(min(threads, len(firsts))) as pool:
        return reduce(JointAccumulator.merge, pool.map(simulate, firsts))


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


def units_of(tree: Engine | StochasticModel, paths: tuple[NumberPath, ...]) -> Float[np.ndarray, " paths"]:
    """The units in which `derivatives_of` varies the numbers at `paths`."""
    return np.array([abs(float(number_at(tree, path))) or 1.0 for path in paths])


def _count(
    job: Job, chosen: AnyArray, *, paths: tuple[NumberPath, ...], lanes: int, rows: int, dtype: DType
) -> tuple[tuple[Array, Array], tuple[Array, BoundarySums], IntArray]:
    """Total stick time and number of sticks, (rows, lanes); derivatives of stick time, and of the sums in `Counted`, by
    the `chosen` ones of the numbers at `paths`, (chosen, rows, lanes); and status.
    """

    def run(values):
        varied = job._replace(engine=with_numbers(job.engine, paths, values))
        counted = summarize(varied, lanes=lanes, rows=rows, dtype=dtype)
        return (counted.stick_time, counted.sums), (counted.sticks, counted.status)

    (time, _), slopes, (sticks, status) = derivatives_of(run, job.engine, paths, dtype, jnp.asarray(chosen))
    return (time, sticks), slopes, status


def _sequence(
    statistics: tuple[StickStatistic, ...], job: Job, bandwidths: AnyArray, *, paths: tuple[NumberPath, ...],
    lanes: int, buffer: BufferSizes, dtype: DType,
) -> tuple[tuple[Features, ...], tuple[Features, ...], RecordedCounts]:  # fmt: skip
    """`Features` of each statistic, their derivatives by the numbers at `paths` along a first axis, and the counts.

    The derivatives are pathwise parts, event parts, and how many distances the windows hold; none without `paths`.
    """

    def run(values):
        varied = job._replace(engine=with_numbers(job.engine, paths, values))
        recorded = record_sequences(varied, lanes=lanes, buffer=buffer, dtype=dtype)
        return tuple(features_of(one, recorded, bandwidths) for one in statistics), recorded.counts

    if not paths:
        features, counts = run(())
        return features, (), counts
    return derivatives_of(run, job.engine, paths, dtype)


_COUNT_STATIC = ("paths", "lanes", "rows", "dtype")
# Native loops and wide vectors only where all compiled functions are the package's own (see `engine_choice.py`).
count_chunk = {
    True: CompiledNatively(_count, _COUNT_STATIC, compiler_options=WIDE_VECTORS),
    False: jax.jit(_count, static_argnames=_COUNT_STATIC),
}
sequence_chunk = jax.jit(_sequence, static_argnames=("statistics", "paths", "lanes", "buffer", "dtype"))


# Sensitivities by event parts: from engines that count, and from recorded stick sequences.


_TOGETHER = 2  # derivatives in one pass of time steps: XLA (jaxlib 0.10) makes no native loop of three with damping
_MOST_TRIES = 6  # with larger and larger buffers of a realisation


def counted(problem: SensitivityProblem, pilot: Pilot, bandwidths: np.ndarray, *, by_score: bool = True) -> Source:
    """Derivatives by all parameters with a counting engine, a window per bandwidth; without any, the pathwise part.

    `by_score`: whether the derivative by a rate comes from the likelihood; its pathwise part is found beside it.
    """
    engine, own = counting_engine(problem, pilot, bandwidths), problem.paths("engine")
    paths = tuple(dict.fromkeys((*score_paths(engine, own), *own))) if by_score else own
    parameters, places = slice(len(own)), [paths.index(path) for path in own]  # of the derivatives, of pathwise parts
    units, t1 = units_of(engine, paths)[:, None], problem.t1
    together = len(paths) if problem.by_intervals else min(len(paths), _TOGETHER)
    passes = -(-len(paths) // together)
    chosen = np.minimum(np.arange(passes * together, dtype=np.int32), len(paths) - 1).reshape(passes, together)

    def rows(first: int, number: int) -> list[Rows]:
        job = problem.job(engine, first, LANES * ROWS, -(-number // LANES))
        found = [
            count_chunk[is_built_in(engine)](job, part, paths=paths, lanes=LANES, rows=ROWS, dtype=problem.dtype)
            for part in chosen
        ]
        totals, _, status = found[0]  # the same in all
        slopes = jax.tree.map(lambda *each: np.concatenate(each)[: len(paths)], *(one[1] for one in found))
        d_time, (d_events, d_window) = jax.tree.map(lambda leaf: flat(leaf, number), slopes)
        totals = np.stack([flat(leaf, number) for leaf in totals], axis=-1)
        time, event_parts = d_time / units, [leaf / units for leaf in d_events]
        no_window = np.zeros((*time.shape, 1))
        in_window = np.stack(d_window, axis=-1) if d_window else no_window
        for index, path in enumerate(paths):
            if "likelihood" in path:  # uses no window: it rests on all sticks
                in_window[index] = no_window[index] = totals[:, 1:]
        status = flat(status, number).astype(int)

        def rows_of(statistic: OfTotals) -> Rows:
            weights = statistic.weights(t1)
            parts = totals @ weights[:, :2].T + weights[:, 2]
            # The number of sticks has no pathwise derivative: it is locally constant.
            pathwise = time[..., None] * weights[:, 0]
            slopes, windows = pathwise[:, :, None], no_window
            if event_parts and not statistic.ignores_stick_count:
                each = [np.stack([time, part], axis=-1) @ weights[:, :2].T for part in event_parts]
                slopes, windows = np.stack(each, axis=2), in_window
            return Rows(status, parts, slopes[parameters], pathwise[places], windows[parameters])

        return list(map(rows_of, problem.totals))

    return Source(rows, problem.per_task, bandwidths)


def counting_engine(
    problem: SensitivityProblem, pilot: Pilot, bandwidths: np.ndarray
) -> IntervalCounting | StepCounting | RandomEngine:
    """The engine that counts; of a problem with inputs, a `RandomEngine` over one. Without `bandwidths`, for pathwise
    derivatives only.
    """
    bandwidths = np.asarray(bandwidths, problem.dtype)

    def counting(engine):
        if not problem.by_intervals:
            return StepCounting(engine, bandwidths, problem.first_segment, with_distances=len(bandwidths) > 0)
        law, likelihood = engine.law, None
        if law.gap_rate is not None:
            likelihood = Likelihood(getattr(law, law.gap_rate), pilot.stick_time, pilot.sticks)
        return IntervalCounting(engine, bandwidths, likelihood, problem.first_segment)

    return wrapped(problem.engine(), counting)


def score_paths(engine: Engine, paths: tuple[NumberPath, ...]) -> tuple[NumberPath, ...]:
    """The `paths`, but where one is that of the rate of the base's gaps, that of the rate the likelihood knows."""
    counting, outer = single_engine(engine), ("template",) if isinstance(engine, RandomEngine) else ()
    if not isinstance(counting, IntervalCounting) or counting.likelihood is None:
        return paths
    rate = (*outer, "engine", "law", counting.engine.law.gap_rate)
    return tuple((*outer, "likelihood", "rate") if path == rate else path for path in paths)


def recorded(problem: SensitivityProblem, pilot: Pilot, bandwidths: np.ndarray) -> Source:
    """Derivatives by all parameters from recorded stick sequences, with a window per bandwidth; without any, the
    pathwise part.
    """
    engine, paths = problem.engine(), problem.paths("engine")
    units = units_of(engine, problem.paths())[:, None, None]
    buffer = buffer_sizes_for(problem, pilot)
    recorder = wrapped(engine, partial(recording, first=problem.first_segment))

    def rows(first: int, number: int) -> list[Rows]:
        job = problem.job(recorder, first, problem.sequence_lanes)
        found, slopes, counts = with_sequences(problem, job, buffer, bandwidths, paths)
        status = np.asarray(counts.status)[:number]

        def rows_of(features: Features, slopes: Features) -> Rows:
            parts = np.asarray(features.parts, float)[:number]
            pathwise, events, in_window = (np.asarray(leaf, float)[:, :number] for leaf in slopes)
            derivatives = (pathwise[:, :, None] + events) / units[..., None]
            return Rows(status, parts, derivatives, pathwise / units, in_window)

        return list(map(rows_of, found, slopes))

    return Source(rows, problem.sequence_lanes, bandwidths)


def with_sequences(
    problem: SensitivityProblem, job: Job, buffer: BufferSizes, bandwidths: np.ndarray, paths: tuple[NumberPath, ...]
) -> tuple[tuple[Features, ...], tuple[Features, ...], RecordedCounts]:
    """What `sequence_chunk` finds of the samples of a job that records, with larger buffers until all fits.

    `paths`: in the engine that records. Without `bandwidths` nothing but the sticks is recorded.
    """
    buffer, tries = buffer if len(bandwidths) else buffer._replace(candidates=0), 0
    while True:
        found = sequence_chunk(
            problem.statistics, job, np.asarray(bandwidths, problem.dtype), paths=paths, lanes=problem.sequence_lanes,
            buffer=buffer, dtype=problem.dtype,
        )  # fmt: skip
        status, sticks, candidates = found[2]
        # One slot more than there are sticks: a stick of zero length may be inserted.
        slots, candidates = (8 * -(-int(most) // 8) for most in (np.max(sticks) + 1, np.max(candidates)))
        larger = BufferSizes(buffer.blocks, max(slots, buffer.slots), max(candidates, buffer.candidates))
        if larger == buffer and np.any(np.isin(status, (Status.BASE_TOO_SHORT, Status.OUT_OF_STEPS))):
            larger = buffer._replace(blocks=2 * buffer.blocks)
        tries += 1
        if larger == buffer or tries == _MOST_TRIES:
            return found
        buffer = larger


def flat(leaf: AnyArray, number: int) -> np.ndarray:
    """The first samples of an array (..., rows, lanes)."""
    return np.asarray(leaf, float).reshape(*np.shape(leaf)[:-2], -1)[..., :number]


# Finite differences with common random numbers: of every trajectory, or between ensembles.
#
# Regularised dynamics, which only ensembles simulate, has no boundaries: there a stick is a time below a threshold. The
# options of the method that follow from the system, such as the threshold, follow the parameter. So do the matrices of
# structures with a list of contacts.


_TOLERANCE = 0.1
"""How far, in standard errors, the derivatives of an output by two steps may differ even if it is not by chance.

Of a smooth output hardly anything is by chance in their difference, which is of the order of the squared step.
"""


class _Values(NamedTuple):
    """Of some samples: numerator and denominator of each statistic, status, and number of sticks.

    Of outputs, `counted` holds their values in place of the number of sticks, (statistics, samples).
    """

    parts: Float[np.ndarray, "statistics samples 2"]
    status: Int[np.ndarray, " samples"]
    counted: Float[np.ndarray, "*statistics samples"]


_ValuesOf: TypeAlias = Callable[[int, int], _Values]
"""A function of a task's first sample and its number of samples."""


def differenced(problem: SensitivityProblem, pilot: Pilot, steps: np.ndarray, with_pathwise: bool) -> Source:
    """Derivatives by all parameters as central differences of every trajectory, ``(f(p + s) - f(p - s)) / (2 s)``.

    `steps`: s, relative to the parameter's size. Both ends use the same random numbers. In place of the distances
    inside a window, the trajectories are counted whose number of sticks differs between the ends.

    Raises ValueError if a value at an end is not allowed.
    """
    tree: Any = problem.model if problem.needs_ensembles else problem.engine()
    paths = tuple(one.path for one in problem.parameters) if problem.needs_ensembles else problem.paths()

    def values_at(tree: Any) -> _ValuesOf:
        if problem.needs_ensembles:
            return _values_of_ensemble(problem, tree)
        return partial(_values_of_engine, problem, pilot, tree)

    pairs: list[tuple[float, list[_ValuesOf]]] = []  # the half-width, and both ends, for all parameters and steps
    for path, parameter, unit in zip(paths, problem.parameters, units_of(tree, paths), strict=True):
        for length in steps * unit:
            ends = [with_numbers(tree, (path,), (float(parameter.value + sign * length),)) for sign in (-1, 1)]
            try:
                for end in ends:
                    check_numbers(end)
            except ValueError as error:
                raise ValueError(
                    f"Argument step (or relative_bandwidth) must be smaller: {parameter.name} = {parameter.value:g} is "
                    f"to be varied by {length:g}, which it does not allow. {error}"
                ) from error
            pairs.append((length, [values_at(end) for end in ends]))
    centre, pathwise_by = values_at(tree), None
    if with_pathwise:
        find = partial(counted, by_score=False) if problem.is_counted else recorded
        pathwise_by = find(problem, pilot, np.zeros(0))

    def rows(first: int, number: int) -> list[Rows]:
        def difference(length: float, ends: list[_ValuesOf]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            low, high = (end(first, number) for end in ends)
            slope = (high.parts - low.parts) / (2 * length)
            differs = np.broadcast_to(low.counted != high.counted, slope.shape[:2])
            return slope, np.maximum(low.status, high.status), differs

        parts, status, _ = centre(first, number)
        slopes, statuses, differs = zip(*(difference(*pair) for pair in pairs), strict=True)
        status = np.max([status, *statuses], axis=0)
        shape = (len(paths), len(steps), len(parts), number)
        slopes = np.moveaxis(np.reshape(slopes, (*shape, 2)), (2, 3), (0, 2))
        differs = np.moveaxis(np.reshape(differs, shape), (2, 3), (0, 2)).astype(float)
        pathwise = np.zeros((len(parts), len(paths), number, 2))
        if pathwise_by is not None:
            pathwise = [one.pathwise for one in pathwise_by.rows(first, number)]
        tolerance = [_TOLERANCE if problem.is_output else 0.0] * len(parts)
        return list(map(partial(Rows, status), parts, slopes, pathwise, differs, tolerance))

    by_totals = problem.is_counted or problem.needs_ensembles
    return Source(rows, problem.per_task if by_totals else problem.sequence_lanes, steps)


def _values_of_ensemble(problem: SensitivityProblem, model: StochasticModel) -> _ValuesOf:
    """The values of the samples of an ensemble of `model`."""
    key = jax.random.wrap_key_data(problem.key_data)
    numbering = Numbering(1, True)  # counts a stick that begins at t = 0, as the statistics do
    options = (problem.samples, 0, key, None, problem.method, "sticks", numbering)
    setup = EnsembleSetup.checked(model, problem.t1, *options)
    if problem.is_output:
        outputs = {one.output.name: one.output for one in problem.statistics if isinstance(one, OfOutput)}
        runner = OutputRunner(setup, outputs)

        def values_of_outputs(first: int, number: int) -> _Values:
            values = np.stack(list(runner.values(first, number).values()))
            known = np.all(np.isfinite(values), axis=0)  # a sample without a finite one did not finish
            parts = np.stack([np.where(known, values, 0), np.ones_like(values)], axis=-1)
            return _Values(parts, np.where(known, Status.FINISHED, Status.NOT_FINITE).astype(int), values)

        return values_of_outputs

    def values(first: int, number: int) -> _Values:
        many = simulate_batch(setup, first, number, "sticks", retained=RETAINED, fewest=problem.samples)
        if problem.is_counted:
            return _values_of_totals(problem, many.totals)
        flat_sticks, status = many.require_sticks(), np.asarray(many.totals.status).astype(int)
        parts = [parts_of_sequences(one, flat_sticks, problem.t1, problem.dtype) for one in problem.statistics]
        return _Values(np.stack(parts), status, np.asarray(many.totals.sticks))

    return values


def _values_of_engine(problem: SensitivityProblem, pilot: Pilot, engine: Engine, first: int, number: int) -> _Values:
    """The values of samples `first` to ``first + number - 1`` of an engine."""
    samples, rows = (LANES * ROWS, -(-number // LANES)) if problem.is_counted else (problem.sequence_lanes, 1)
    job = problem.job(engine, first, samples, rows)
    if isinstance(engine, RandomEngine):
        # With its random numbers drawn, both ends of a difference are compiled once.
        job = job.with_columns()._replace(engine=dataclasses.replace(engine, sources=(None,) * len(engine.sources)))
    if problem.is_counted:
        with_records = problem.random is not None and problem.random.inputs.has_sampled_law
        summarize = compiled_for(job.engine, with_records=with_records).summarize
        totals = summarize(job, lanes=LANES, rows=ROWS, dtype=problem.dtype)
        return _values_of_totals(problem, jax.tree.map(lambda leaf: flat(leaf, number), totals))
    # Only the sticks are asked for, and nothing about what has a density.
    job = job._replace(engine=wrapped(job.engine, partial(recording, first=FirstSegment(False, False))))
    found, _, counts = with_sequences(problem, job, buffer_sizes_for(problem, pilot), np.zeros(0), ())
    status, sticks = (np.asarray(leaf)[:number] for leaf in (counts.status, counts.sticks))
    return _Values(np.stack([np.asarray(one.parts, float)[:number] for one in found]), status, sticks)


def _values_of_totals(problem: SensitivityProblem, totals: SampleTotals) -> _Values:
    stick_time, sticks, slips, status = map(np.asarray, (totals.stick_time, totals.sticks, totals.slips, totals.status))
    parts = np.stack([one.parts_of(problem.t1, stick_time, sticks, slips) for one in problem.totals])
    return _Values(parts, status.astype(int), sticks)


def parts_of_sequences(statistic: StickStatistic, sticks: FlatSticks, t1: float, dtype: DType) -> np.ndarray:
    """Numerator and denominator of each sample, (samples, 2)."""
    most = 8 * -(-(int(sticks.count.max()) + 1) // 8)  # few sizes: each is compiled
    slots = np.arange(len(sticks.start)) - np.repeat(sticks.first, sticks.count)
    columns = np.zeros((2, len(sticks.count), most), dtype)
    columns[:, sticks.sample, slots] = sticks.start, sticks.duration
    mask = np.arange(most) < sticks.count[:, None]
    one = jax.jit(jax.vmap(lambda *sequence: statistic.parts(StickSequence(*sequence), t1)))
    return np.stack([np.asarray(part, float) for part in one(*columns, mask)], axis=-1)
