"""How a sensitivity problem is treated: counting lanes, recorded sequences, differences."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .._status import Status
from ..base_motion.laws import PoissonSwitching
from ..dynamics.chunks import chunks_of
from ..dynamics.lanes import Engine, Job
from .counting import CountingEngine, Likelihood
from .parameters import Path, with_numbers
from .problem import Pilot, Problem, Room, lanes_and_rows, sequence_lanes
from .runs import Rows, Tally, count_chunk, run_chunks, sequence_chunk, unit_of, value_chunk
from .sequences import Spans
from .statistic import OfTotals

RATE: Path = ("law", "rate")
_MOST_DOUBLINGS = 6  # of the room for a realisation


class Columns(NamedTuple):
    """Where a tally's rows hold the derivatives of numerator and denominator by one parameter, and the pathwise parts.

    Of several windows, `derivative` has one column each, the widest first.
    """

    derivative: tuple[int, ...]
    pathwise: int


def counted(problem: Problem, pilot: Pilot, reach: float) -> tuple[Tally, tuple[Columns, ...]]:
    """All parameters by counting lanes."""
    engine = counting_engine(problem, pilot, reach)
    paths, number = list(problem.paths()), len(problem.parameters)
    pathwise = list(range(number))
    for index, path in enumerate(problem.paths()):
        if path == RATE and engine.likelihood is not None:
            # Its derivative from the likelihood, and beside it the pathwise one.
            paths[index] = ("likelihood", "rate")
            pathwise[index] = len(paths)
            paths.append(RATE)
    # Two windows a path, and then the pathwise parts.
    columns = tuple(
        Columns((2 + 4 * index, 4 + 4 * index), 2 + 4 * len(paths) + 2 * pathwise[index]) for index in range(number)
    )
    return run_counting(problem, engine, tuple(paths)), columns


def counting_engine(problem: Problem, pilot: Pilot, reach: float) -> CountingEngine:
    """The engine that counts."""
    likelihood = None
    if type(problem.law) is PoissonSwitching:
        likelihood = Likelihood(problem.law.rate, pilot.stick_time, pilot.sticks)
    return CountingEngine(
        problem.system,
        problem.law,
        problem.t1,
        problem.y0,
        np.asarray(reach, problem.dtype),
        likelihood,
        problem.fixed_start,
    )


def run_counting(problem: Problem, engine: CountingEngine, paths: tuple[Path, ...]) -> Tally:
    """The problem's parts; columns: their derivatives by every path, and the pathwise parts of these."""
    assert isinstance(problem.statistic, OfTotals)
    lanes, rows = lanes_and_rows(problem)
    is_own = type(problem.law).__module__.startswith(__name__.partition(".")[0])
    weights = problem.statistic.weights(problem.t1)

    def simulate(first: int, number: int) -> Rows:
        slopes, pathwise, reached = [], [], []
        for path in paths:
            (*totals, _, _), (d_time, *d_counts, near), status = count_chunk[is_own](
                engine, problem.words, np.uint32(first), np.int32(-(-number // lanes)),
                path=path, lanes=lanes, rows=rows, dtype=problem.dtype,
            )  # fmt: skip
            d_time, *d_counts = (_flat(leaf, number) / unit_of(engine, path) for leaf in (d_time, *d_counts))
            slopes += [np.stack([d_time, d_count], axis=-1) @ weights[:, :2].T for d_count in d_counts]
            # The number of sticks of one trajectory does not change.
            pathwise.append(d_time[:, None] @ weights[:, :1].T)
            reached.append(_flat(near, number))
        parts = np.stack([_flat(leaf, number) for leaf in totals], axis=-1) @ weights[:, :2].T + weights[:, 2]
        near = np.repeat(np.max(reached, axis=0)[:, None], 2, axis=1)
        return Rows(_flat(status, number).astype(int), parts, np.concatenate([*slopes, *pathwise], axis=1), near)

    return run_chunks(simulate, problem.samples, lanes * rows, problem.threads)


def recorded(problem: Problem, room: Room, spans: Spans) -> tuple[Tally, tuple[Columns, ...]]:
    """All parameters by recorded sequences."""
    paths, windows = problem.paths(), len(spans.durations)
    columns = tuple(
        Columns(
            tuple(2 + 2 * (index * windows + window) for window in range(windows)),
            2 + 2 * (len(paths) * windows + index),
        )
        for index in range(len(paths))
    )
    return run_recording(problem, problem.engine(), paths, room, spans), columns


def run_recording(problem: Problem, engine: Engine, paths: tuple[Path, ...], room: Room, spans: Spans) -> Tally:
    """The problem's parts; columns: their derivatives by every path, for every window, and the pathwise parts."""
    lanes = sequence_lanes(problem)

    def simulate(first: int, number: int) -> Rows:
        columns, pathwise = [], []
        for path in paths:

            def run(room: Room, path=path) -> Any:
                done = sequence_chunk(
                    problem.statistic, engine, spans, problem.words, np.uint32(first), path=path,
                    fixed_start=problem.fixed_start, lanes=lanes, dtype=problem.dtype, **room._asdict(),
                )  # fmt: skip
                return done, done[2][0], done[2][2]

            (parts, _), (slopes, events), (status, near, _) = _with_room(run, room)
            slopes, events = (np.asarray(leaf, float)[:number] / unit_of(engine, path) for leaf in (slopes, events))
            columns.append((slopes[:, None] + events).reshape(number, -1))
            pathwise.append(slopes)
        parts, status, near = (np.asarray(leaf)[:number] for leaf in (parts, status, near))
        rows = np.concatenate([*columns, *pathwise], axis=1)
        return Rows(status, np.asarray(parts, float), rows, np.asarray(near, float))

    return run_chunks(simulate, problem.samples, lanes, problem.threads)


def differenced(problem: Problem, parameter: int, step: float, room: Room) -> Tally:
    """The problem's parts; columns: the parts with one parameter lower and higher by `step`, by the same random
    numbers.
    """
    path, engine = problem.paths()[parameter], problem.engine()
    value = problem.parameters[parameter].value
    varied = [engine] + [with_numbers(engine, (path,), (value + sign * step,)) for sign in (-1, 1)]
    values = _counted_values if problem.is_counted else _recorded_values
    lanes, rows = lanes_and_rows(problem) if problem.is_counted else (sequence_lanes(problem), 1)

    def simulate(first: int, number: int) -> Rows:
        runs = [values(problem, one, first, number, room) for one in varied]
        status = np.max([status for _, status in runs], axis=0)
        columns = np.concatenate([parts for parts, _ in runs[1:]], axis=1)
        return Rows(status, runs[0][0], columns, np.zeros((number, 1)))

    return run_chunks(simulate, problem.samples, lanes * rows, problem.threads)


def _counted_values(problem: Problem, engine: Engine, first: int, number: int, room: Room) -> Any:
    assert isinstance(problem.statistic, OfTotals)
    lanes, rows = lanes_and_rows(problem)
    job = Job(engine, problem.words, np.uint32(first), np.int32(-(-number // lanes)))
    results = chunks_of(engine).summarise(job, lanes=lanes, rows=rows, dtype=problem.dtype)
    totals = np.stack([np.asarray(leaf, float).reshape(-1)[:number] for leaf in (results.stick_time, results.sticks)])
    weights = problem.statistic.weights(problem.t1)
    return totals.T @ weights[:, :2].T + weights[:, 2], np.asarray(results.status).reshape(-1)[:number]


def _recorded_values(problem: Problem, engine: Engine, first: int, number: int, room: Room) -> Any:
    def run(room: Room) -> Any:
        done = value_chunk(
            problem.statistic, engine, problem.words, np.uint32(first),
            lanes=sequence_lanes(problem), dtype=problem.dtype, **room._asdict(),
        )  # fmt: skip
        return done, done[1], done[2]

    parts, status, _ = _with_room(run, room)
    return np.asarray(parts, float)[:number], np.asarray(status)[:number]


def _with_room(run: Callable[[Room], tuple[Any, Any, Any]], room: Room) -> Any:
    """What `run` gives with room for all sticks; it tells beside it status and number of sticks of every sample."""
    for _ in range(_MOST_DOUBLINGS):
        done, status, count = run(room)
        cut, most = np.isin(status, (Status.BASE_TOO_SHORT, Status.OUT_OF_STEPS)), int(np.max(count))
        if most > room.slots:
            room = room._replace(slots=8 * -(-most // 8))
        elif np.any(cut):
            room = room._replace(blocks=2 * room.blocks)
        else:
            break
    return done


def _flat(leaf: Any, number: int) -> np.ndarray:
    """The first samples of an array (rows, lanes)."""
    return np.asarray(leaf, float).reshape(-1)[:number]
