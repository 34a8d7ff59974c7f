"""Finite differences with common random numbers: of every trajectory, or between ensembles.

Regularised dynamics, which only ensembles simulate, has no boundaries: there a stick is a time below a threshold. The
options of the method that follow from the system, such as the threshold, follow the parameter. So do the matrices of
structures with a list of contacts.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import numpy as np
from jaxtyping import Float, Int

from .._dynamics.common.engine import Engine
from .._dynamics.common.lanes import Job
from .._dynamics.compiled import compiled_for
from .._ensemble.call import simulate_batch
from .._ensemble.outputs import OutputRunner
from .._ensemble.parts import RETAINED
from .._ensemble.setup import EnsembleSetup
from .._events.sticks import FlatSticks
from .._statistics.accumulator import Numbering
from .._status import Status
from .._types import AnyArray, DType
from .._uncertainty.inputs import Model
from .._uncertainty.numbers import Parameter, Path, check_numbers, with_numbers
from .chunks import Rows, Source, units_of, value_chunk
from .estimators import counter, counting_engine, flat, recorder, with_buffer, wrapped_paths
from .problem import Pilot, Problem, buffer_sizes_for, lanes_and_rows, sequence_lanes
from .random_inputs import RandomEngine, wrapped
from .recording import recording
from .sequences import BufferSizes, RecordedCounts
from .statistic import OfOutput, StickSequence, StickStatistic

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


def differenced(problem: Problem, pilot: Pilot, steps: np.ndarray, with_pathwise: bool) -> Source:
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


def _differenced_ensembles(problem: Problem, steps: np.ndarray) -> Source:
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


def _ends_of(tree: _Tree, path: Path, parameter: Parameter, length: float) -> list[_Tree]:
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
    problem: Problem, centre: _ValuesOf, pairs: _Pairs, pathwise_of: _Pathwise | None
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


def _by_totals(problem: Problem, pilot: Pilot) -> _Source:
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
    problem: Problem, stick_time: np.ndarray, sticks: np.ndarray, slips: np.ndarray, status: np.ndarray
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


def _by_sequences(problem: Problem, pilot: Pilot) -> _Source:
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


def _simulated(problem: Problem, model: Model) -> _ValuesOf:
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
