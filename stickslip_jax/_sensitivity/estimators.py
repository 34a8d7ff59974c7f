"""Estimates of derivatives by chunks of realisations: by event parts, and by differences with common random
numbers.
"""

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial, reduce
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._compiler.native import WIDE_VECTORS, CompiledNatively
from .._compiler.programs import kept_jit
from .._dynamics.common.lanes import Engine, Job, SampleTotals, summarize, with_leaves
from .._dynamics.engine_choice import compiled_for
from .._dynamics.sticks import FlatSticks
from .._ensemble.data import RETAINED
from .._ensemble.ensemble import simulate_batch
from .._ensemble.setup import EnsembleSetup, OutputRunner
from .._foundation.processes import is_wide
from .._foundation.types import AnyArray, DType, IntArray, Status
from .._numerics.sums import Moments
from .._statistics.quantities import Numbering
from .._systems.system import is_built_in
from .._uncertainty.inputs import StochasticModel
from .._uncertainty.numbers import check_numbers, with_numbers
from .boundaries import BoundarySums, FirstSegment
from .counting import IntervalCounting, Likelihood, StepCounting, recording
from .problem import Pilot, SensitivityProblem, buffer_sizes_for
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

    `in_window`: how many distances were inside each window. `tolerance`: as in `Windows`.
    """

    status: Int[np.ndarray, " samples"]
    parts: Float[np.ndarray, "samples 2"]
    slopes: Float[np.ndarray, "paths samples windows 2"]
    pathwise: Float[np.ndarray, "paths samples 2"]
    in_window: Float[np.ndarray, "paths samples windows"]
    tolerance: float = 0.0

    @property
    def columns(self) -> Float[np.ndarray, "samples columns"]:
        """The numbers to take moments of: `parts`, and by each parameter their derivatives, the pathwise ones last."""
        derivatives = np.concatenate([self.slopes, self.pathwise[:, :, None]], axis=2)
        return np.concatenate([self.parts, np.moveaxis(derivatives, 1, 0).reshape(len(self.parts), -1)], axis=1)


class Windows(NamedTuple):
    """One statistic and its derivative by one parameter, as several windows show it.

    - `halves`: moments of numerator and denominator, their derivatives by each window, the widest first, and their
      pathwise parts, two columns each; for each half of the samples (every other one).
    - `in_window`: how many distances were inside each window.
    - `tolerance`: in standard errors, how far windows may differ where it is not by chance.
    """

    halves: tuple[Moments, Moments]
    in_window: Float[np.ndarray, " windows"]
    tolerance: float = 0.0

    @property
    def moments(self) -> Moments:
        """Moments of both halves together."""
        return self.halves[0].merge(self.halves[1])


class Accumulator(NamedTuple):
    """Sums over the finished samples: moments of the `Rows.columns` of all statistics, one after the other, by halves.

    - `in_window`, `tolerance`: of each statistic, as in `Windows`.
    """

    halves: tuple[Moments, Moments]
    in_window: tuple[Float[np.ndarray, "parameters windows"], ...]
    tolerance: tuple[float, ...]

    @classmethod
    def of(cls, rows: list[Rows]) -> "Accumulator":
        """The sums of one chunk, with the rows of each statistic."""
        done = np.max([one.status for one in rows], axis=0) == Status.FINISHED
        columns = np.concatenate([one.columns for one in rows], axis=1)
        first, second = (Moments.of(columns[half::2][done[half::2]]) for half in (0, 1))
        in_window = tuple(one.in_window[:, done].sum(axis=1) for one in rows)
        return cls((first, second), in_window, tuple(one.tolerance for one in rows))

    def merge(self, other: "Accumulator") -> "Accumulator":
        """The sums of both."""
        first, second = (one.merge(two) for one, two in zip(self.halves, other.halves, strict=True))
        in_window = tuple(one + two for one, two in zip(self.in_window, other.in_window, strict=True))
        return self._replace(halves=(first, second), in_window=in_window)

    def columns(self, statistic: int, parameter: int) -> Int[np.ndarray, " columns"]:
        """The columns of a statistic, and of its derivative by a parameter, as `Windows` has them."""
        first = sum(
            2 + 2 * parameters * (windows + 1) for parameters, windows in map(np.shape, self.in_window[:statistic])
        )
        each = 2 * (self.in_window[statistic].shape[1] + 1)
        return first + np.concatenate([np.arange(2), 2 + each * parameter + np.arange(each)])

    def single(self, statistic: int, parameter: int) -> Windows:
        """The sums of one statistic and its derivative by one parameter."""
        own = self.columns(statistic, parameter)
        first, second = (Moments(half.number, half.mean[own], half.scatter[np.ix_(own, own)]) for half in self.halves)
        return Windows((first, second), self.in_window[statistic][parameter], self.tolerance[statistic])


class Source(NamedTuple):
    """How the rows of some statistics are found, from the same loop.

    - `rows`: of samples ``first .. first + number - 1``, for each statistic, as a function of these two.
    - `per_task`: the largest `number`. `widths`: of the windows, or the steps, relative to the parameter.
    """

    rows: Callable[[int, int], list[Rows]]
    per_task: int
    widths: Float[np.ndarray, " windows"]


def run_chunks(sources: list[Source], samples: int, threads: int) -> Accumulator:
    """The sums over all samples, in chunks, of the statistics of all sources; they do not depend on `threads`."""
    per_chunk = min(source.per_task for source in sources)
    firsts = range(0, samples, per_chunk)

    def simulate(first: int) -> Accumulator:
        number = min(per_chunk, samples - first)
        return Accumulator.of([rows for source in sources for rows in source.rows(first, number)])

    with ThreadPoolExecutor(min(threads, len(firsts))) as pool:
        return reduce(Accumulator.merge, pool.map(simulate, firsts))


def derivatives_of(
    function: Callable[[Array], tuple[_Value, _Other]],
    engine: Engine,
    leaves: tuple[int, ...],
    dtype: DType,
    chosen: IntArray | None = None,
) -> tuple[_Value, _Value, _Other]:
    """Value of `function` of some `leaves` of the engine, its derivatives along a first axis, its other output.

    `chosen`: by which of them; by default by all.

    One pass simulates the motion once for all. The numbers are varied in units of their own size (1 where it is 0), so
    that bandwidths of kernels are relative to the parameter.
    """
    given = jax.tree.leaves(engine)
    values = jnp.stack([jnp.asarray(given[leaf], dtype) for leaf in leaves])
    units = jnp.where(values == 0, 1, jnp.abs(values))

    def along(direction):
        return jax.jvp(function, (values,), (direction,), has_aux=True)

    directions = jnp.diag(units)
    return jax.vmap(along, out_axes=(None, 0, None))(directions if chosen is None else directions[chosen])


def _count(
    job: Job, chosen: AnyArray, *, leaves: tuple[int, ...], lanes: int, rows: int, dtype: DType
) -> tuple[tuple[Array, Array], tuple[Array, BoundarySums], IntArray]:
    """Total stick time and number of sticks, (rows, lanes); derivatives of stick time, and of the sums in `Counted`, by
    the `chosen` ones of some `leaves` of the engine, (chosen, rows, lanes); and status.
    """

    def run(values):
        varied = job._replace(engine=with_leaves(job.engine, leaves, values))
        counted = summarize(varied, lanes=lanes, rows=rows, dtype=dtype)
        return (counted.stick_time, counted.sums), (counted.sticks, counted.status)

    (time, _), slopes, (sticks, status) = derivatives_of(run, job.engine, leaves, dtype, jnp.asarray(chosen))
    return (time, sticks), slopes, status


def _sequence(
    statistics: tuple[StickStatistic, ...], job: Job, bandwidths: AnyArray, *, leaves: tuple[int, ...],
    lanes: int, buffer: BufferSizes, dtype: DType,
) -> tuple[tuple[Features, ...], tuple[Features, ...], RecordedCounts]:  # fmt: skip
    """`Features` of each statistic, their derivatives by `leaves` of the engine along a first axis, and the counts.

    The derivatives are pathwise parts, event parts, and how many distances the windows hold; none without `leaves`.
    """

    def run(values):
        varied = job._replace(engine=with_leaves(job.engine, leaves, values))
        recorded = record_sequences(varied, lanes=lanes, buffer=buffer, dtype=dtype)
        return tuple(features_of(one, recorded, bandwidths) for one in statistics), recorded.counts

    if not leaves:
        features, counts = run(())
        return features, (), counts
    return derivatives_of(run, job.engine, leaves, dtype)


_COUNT_STATIC = ("leaves", "lanes", "rows", "dtype")
# Native loops and wide vectors only where all compiled functions are the package's own (see `engine_choice.py`).
count_chunk = {
    True: CompiledNatively(_count, _COUNT_STATIC, compiler_options=WIDE_VECTORS),
    False: kept_jit(_count, static_argnames=_COUNT_STATIC),
}
sequence_chunk = kept_jit(_sequence, static_argnames=("statistics", "leaves", "lanes", "buffer", "dtype"))


# Sensitivities by event parts: from engines that count, and from recorded stick sequences.


_TOGETHER = 2  # derivatives in one pass of time steps: XLA (jaxlib 0.10) makes no native loop of three with damping
_MOST_TRIES = 6  # with larger and larger buffers of a realisation


def counted(problem: SensitivityProblem, pilot: Pilot, bandwidths: np.ndarray, *, by_score: bool = True) -> Source:
    """Derivatives by all parameters with a counting engine, a window per bandwidth; without any, the pathwise part.

    `by_score`: whether the derivative by a rate comes from the likelihood; its pathwise part is found beside it.
    """
    engine, own = counting_engine(problem, pilot, bandwidths), problem.leaves
    leaves = tuple(dict.fromkeys((*score_leaves(problem, engine), *own))) if by_score else own
    parameters, places = slice(len(own)), [leaves.index(leaf) for leaf in own]  # of the derivatives, of pathwise parts
    given, t1 = jax.tree.leaves(engine), problem.t1
    units = np.array([abs(float(given[leaf])) or 1.0 for leaf in leaves])[:, None]
    together = len(leaves) if problem.by_intervals else min(len(leaves), _TOGETHER)
    passes = -(-len(leaves) // together)
    chosen = np.minimum(np.arange(passes * together, dtype=np.int32), len(leaves) - 1).reshape(passes, together)
    # Of several contacts LLVM (jaxlib 0.10) takes many minutes for the machine code of a native loop.
    count = count_chunk[is_built_in(engine) and problem.system.tracks.contacts is None and not is_wide()]
    lanes, most = problem.lanes, problem.rows

    def rows(first: int, number: int) -> list[Rows]:
        job = problem.job(engine, first, lanes * most, -(-number // lanes))
        found = [count(job, part, leaves=leaves, lanes=lanes, rows=most, dtype=problem.dtype) for part in chosen]
        totals, _, status = found[0]  # the same in all
        slopes = jax.tree.map(lambda *each: np.concatenate(each)[: len(leaves)], *(one[1] for one in found))
        d_time, (d_events, d_window) = jax.tree.map(lambda leaf: flat(leaf, number), slopes)
        totals = np.stack([flat(leaf, number) for leaf in totals], axis=-1)
        time, event_parts = d_time / units, [leaf / units for leaf in d_events]
        no_window = np.zeros((*time.shape, 1))
        in_window = np.stack(d_window, axis=-1) if d_window else no_window
        for index, leaf in enumerate(leaves):
            if leaf not in own:  # that of the likelihood uses no window: it rests on all sticks
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
        return IntervalCounting(engine, bandwidths, problem.first_segment, likelihood=likelihood)

    return wrapped(problem.engine(), counting)


def score_leaves(problem: SensitivityProblem, engine: Engine) -> tuple[int, ...]:
    """The leaves of the parameters; that of the rate of the base's gaps is the one that the likelihood knows."""
    counting = single_engine(engine)
    if not isinstance(counting, IntervalCounting) or counting.likelihood is None:
        return problem.leaves
    rate = len(jax.tree.leaves((counting.engine, counting.bandwidths)))  # the likelihood comes next
    path, each = ("law", counting.engine.law.gap_rate), zip(problem.parameters, problem.leaves, strict=True)
    return tuple(rate if parameter.path == path else leaf for parameter, leaf in each)


def recorded(problem: SensitivityProblem, pilot: Pilot, bandwidths: np.ndarray) -> Source:
    """Derivatives by all parameters from recorded stick sequences, with a window per bandwidth; without any, the
    pathwise part.
    """
    leaves, units = problem.leaves, problem.units[:, None, None]
    buffer = buffer_sizes_for(problem, pilot)
    recorder = wrapped(problem.engine(), partial(recording, first=problem.first_segment))

    def rows(first: int, number: int) -> list[Rows]:
        job = problem.job(recorder, first, problem.sequence_lanes)
        found, slopes, counts = with_sequences(problem, job, buffer, bandwidths, leaves)
        status = np.asarray(counts.status)[:number]

        def rows_of(features: Features, slopes: Features) -> Rows:
            parts = np.asarray(features.parts, float)[:number]
            pathwise, events, in_window = (np.asarray(leaf, float)[:, :number] for leaf in slopes)
            derivatives = (pathwise[:, :, None] + events) / units[..., None]
            return Rows(status, parts, derivatives, pathwise / units, in_window)

        return list(map(rows_of, found, slopes))

    return Source(rows, problem.sequence_lanes, bandwidths)


def with_sequences(
    problem: SensitivityProblem, job: Job, buffer: BufferSizes, bandwidths: np.ndarray, leaves: tuple[int, ...]
) -> tuple[tuple[Features, ...], tuple[Features, ...], RecordedCounts]:
    """What `sequence_chunk` finds of the samples of a job that records, with larger buffers until all fits.

    `leaves`: of the engine, to differentiate by. Without `bandwidths` nothing but the sticks is recorded.
    """
    buffer, tries = buffer if len(bandwidths) else buffer._replace(candidates=0), 0
    while True:
        found = sequence_chunk(
            problem.statistics, job, np.asarray(bandwidths, problem.dtype), leaves=leaves, lanes=problem.sequence_lanes,
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
    by_ensembles, engine, leaves = problem.needs_ensembles, None, (0,) * len(problem.parameters)
    if not by_ensembles:
        engine, leaves = problem.engine(), problem.leaves

    def values_of(model: StochasticModel, changed: dict[int, float]) -> _ValuesOf:
        """The values under a model; `changed`: the leaves of the engine in which it differs from the problem's."""
        if by_ensembles:
            return _values_of_ensemble(problem, model)
        return partial(_values_of_engine, problem, pilot, with_leaves(engine, tuple(changed), changed.values()))

    pairs: list[tuple[float, list[_ValuesOf]]] = []  # the half-width, and both ends, for all parameters and steps
    for parameter, unit, leaf in zip(problem.parameters, problem.units, leaves, strict=True):
        for length in steps * unit:
            ends = []
            for value in (float(parameter.value - length), float(parameter.value + length)):
                model = with_numbers(problem.model, (parameter.path,), (value,))
                try:
                    check_numbers(model)
                except ValueError as error:
                    raise ValueError(
                        f"Argument step (or relative_bandwidth) must be smaller: {parameter.name} = "
                        f"{parameter.value:g} is to be varied by {length:g}, which it does not allow. {error}"
                    ) from error
                ends.append(values_of(model, {leaf: value}))
            pairs.append((length, ends))
    centre, pathwise_by = values_of(problem.model, {}), None
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
        shape = (len(problem.parameters), len(steps), len(parts), number)
        slopes = np.moveaxis(np.reshape(slopes, (*shape, 2)), (2, 3), (0, 2))
        differs = np.moveaxis(np.reshape(differs, shape), (2, 3), (0, 2)).astype(float)
        pathwise = np.zeros((len(parts), len(problem.parameters), number, 2))
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
        many = simulate_batch(setup, first, number, "sticks", retained=RETAINED)
        if problem.is_counted:
            return _values_of_totals(problem, many.totals)
        flat_sticks, status = many.require_sticks(), np.asarray(many.totals.status).astype(int)
        parts = [parts_of_sequences(one, flat_sticks, problem.t1, problem.dtype) for one in problem.statistics]
        return _Values(np.stack(parts), status, np.asarray(many.totals.sticks))

    return values


def _values_of_engine(problem: SensitivityProblem, pilot: Pilot, engine: Engine, first: int, number: int) -> _Values:
    """The values of samples `first` to ``first + number - 1`` of an engine."""
    lanes, most = problem.lanes, problem.rows
    samples, rows = (lanes * most, -(-number // lanes)) if problem.is_counted else (problem.sequence_lanes, 1)
    job = problem.job(engine, first, samples, rows)
    if isinstance(engine, RandomEngine):
        # With its random numbers drawn, both ends of a difference are compiled once.
        job = job.with_columns()._replace(engine=dataclasses.replace(engine, sources=(None,) * len(engine.sources)))
    if problem.is_counted:
        with_records = problem.random is not None and problem.random.inputs.has_sampled_law
        summarize = compiled_for(job.engine, with_records=with_records).summarize
        totals = summarize(job, lanes=lanes, rows=most, dtype=problem.dtype)
        return _values_of_totals(problem, jax.tree.map(lambda leaf: flat(leaf, number), totals))
    # Only the sticks are asked for, and nothing about what has a density.
    job = job._replace(engine=wrapped(job.engine, partial(recording, first=FirstSegment(False, False))))
    found, _, counts = with_sequences(problem, job, buffer_sizes_for(problem, pilot), np.zeros(0), ())
    status, sticks = (np.asarray(leaf)[:number] for leaf in (counts.status, counts.sticks))
    return _Values(np.stack([np.asarray(one.parts, float)[:number] for one in found]), status, sticks)


def _values_of_totals(problem: SensitivityProblem, totals: SampleTotals) -> _Values:
    columns = np.stack([np.asarray(one, float) for one in (totals.stick_time, totals.sticks, totals.slips)], axis=-1)
    weights = [one.definition.weights(problem.t1) for one in problem.totals]
    parts = np.stack([columns @ of[:, :3].T + of[:, -1] for of in weights])
    return _Values(parts, np.asarray(totals.status).astype(int), np.asarray(totals.sticks))


def parts_of_sequences(statistic: StickStatistic, sticks: FlatSticks, t1: float, dtype: DType) -> np.ndarray:
    """Numerator and denominator of each sample, (samples, 2)."""
    most = 8 * -(-(int(sticks.count.max()) + 1) // 8)  # few sizes: each is compiled
    slots = np.arange(len(sticks.start)) - np.repeat(sticks.first, sticks.count)
    columns = np.zeros((2, len(sticks.count), most), dtype)
    columns[:, sticks.sample, slots] = sticks.start, sticks.duration
    mask = np.arange(most) < sticks.count[:, None]
    one = jax.jit(jax.vmap(lambda *sequence: statistic.parts(StickSequence(*sequence), t1)))
    return np.stack([np.asarray(part, float) for part in one(*columns, mask)], axis=-1)
