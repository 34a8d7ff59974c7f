"""`simulate_ensemble`: many samples of a random excitation, in chunks and threads, with streamed statistics."""

import dataclasses
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._compiler import Layout, packed
from .._dynamics.common.engine import Engine, SampleTotals
from .._dynamics.common.lanes import BLOCK
from .._dynamics.common.method import EXACT, Exact, Regularized
from .._dynamics.compiled import compiled_for, solve_chunk
from .._dynamics.regularized.engine import AdaptiveBatch
from .._dynamics.regularized.settings import ADAPTIVE_STEPS, MORE, numbers_as_arrays
from .._events.stick_stream import StickCollector
from .._excitation.excitation import BaseMotion
from .._forks import require_threads_of_jax
from .._processor import cores
from .._simulation.outputs import Output, Outputs, checked_outputs
from .._statistics.accumulator import Numbering
from .._status import Status
from .._systems.system import System
from .._types import Array, InitialState
from .._uncertainty.copula import GaussianCopula
from .._uncertainty.design import Design
from .._uncertainty.inputs import Model
from .data import Fields, Keep
from .origins import check_extendable
from .outputs import NO_OUTPUTS, TAKEN, fields_of_outputs, only, outputs_of, runner_for
from .parts import EnsembleAccumulator, Part, prepare
from .progress import progress_bar
from .result import Ensemble
from .setup import MOST_SAMPLES, EnsembleSetup

_Simulate = Callable[[int, int], tuple[Part, ...]]  # samples ``first .. first + number - 1``; the part of each track
_ADAPTIVE_LANES = 64  # of a batch, always: idle ones take time too, and each needs memory for all of its steps
_ONE_SIZE = 8192  # samples of a task where tasks of any size share a compilation
_RECORDED_AT_ONCE = 2**17  # intervals per call that keeps sticks: few calls, with records that stay in the cache


def simulate_ensemble(
    system: System,
    law: BaseMotion,
    *,
    t1: float,
    samples: int | Design,
    key: Array | None = None,
    correlation: GaussianCopula | None = None,
    y0: InitialState | None = None,
    method: Exact | Regularized = EXACT,
    keep: Keep = "statistics",
    orders: int = 10,
    count_initial_rest: bool = False,
    threads: int | None = None,
    chunk: int | None = None,
    progress: bool | None = None,
    first_sample: int = 0,
    outputs: Outputs | None = None,
) -> Ensemble:
    """Simulate `samples` independent realisations of the excitation `law`.

    Sample i is ``simulate(system, law.sample(jax.random.fold_in(key, i), t1), ...)``, whatever the number of samples,
    the chunk size or the threads; ``system, base, y0 = many.realization(i)`` returns what it is simulated with. Any
    single number of `system`, `law` or `y0` may differ from sample to sample: an array (samples,), or a distribution
    (see docs/uncertain.md); ``many.input_values`` gives what was drawn.

    Args:
        system: A `MassSpring`, a `MotorCart` or a `SwitchedSystem` of your own.
        law: A random excitation, any that `simulate` takes, or an object with ``sample(key, t1)`` that returns one.
        t1: Duration, s.
        samples: Their number, or a design (`stickslip_jax.design`) with a row for each.
        key: From ``jax.random.key(seed)``; None where nothing is random.
        correlation: Of random numbers; by default they are independent.
        y0: Initial state as in `simulate`, or an array (samples, coordinates).
        method: `Exact`, with a time step where one is needed, or `Regularized`.
        keep: "totals" (fastest): ``many.totals`` of each sample, and their statistics; "statistics": all of these, in
            memory that does not grow with `samples`; "sticks" keeps every stick and the totals too.
        orders: Statistics are made of the 1st, 2nd, ... up to this stick of a sample, at most the 1000th.
        count_initial_rest: Whether a stick that begins at t = 0, from a start at rest, counts as the 1st.
        threads: Worker threads (default: all cores).
        chunk: Samples simulated per call (default: chosen for speed).
        progress: True shows a progress bar, False none; by default on a terminal and in a notebook.
        first_sample: The number i of the first, where several machines share one ensemble (see `concatenate`).
        outputs: Numbers of your own: a dict from names to functions of a `Simulation` that return one number, or to
            `Output` objects, which have a unit, such as ``{"peak": lambda one: one.peak("position")}``. For them every
            sample is simulated once more and recorded, batch by batch. ``many.outputs["peak"]`` is their distribution,
            ``many.output_values["peak"]`` the number of each sample.

    Returns:
        An `Ensemble`. Samples that did not reach ``t1`` are counted in ``many.status_counts`` and in no statistic.

    Raises:
        ValueError: For arguments outside these bounds.

    >>> system = ss.MassSpring(
    ...     mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0)
    ... )
    >>> law = ss.PoissonSwitching(speed=1.0, rate=1.0)
    >>> many = ss.simulate_ensemble(
    ...     system, law, t1=50.0, samples=1000, key=jax.random.key(0), y0=(0.0, 1.0)
    ... )
    >>> print(ss.mean_stick_duration(many))
    mean stick duration (pooled): 0.2540 +- 0.0011 s
    """
    require_threads_of_jax()
    numbering, model = Numbering.checked(orders, count_initial_rest), Model(system, law, y0)
    wanted = checked_outputs(outputs, TAKEN)
    setup = EnsembleSetup.checked(model, t1, samples, first_sample, key, correlation, method, keep, numbering)
    samples, first = setup.inputs.samples - int(first_sample), int(first_sample)
    (found,) = found_by(setup, first, (EnsembleAccumulator(samples, keep),), threads, chunk, progress, wanted)
    return Ensemble(**setup.fields(), samples=samples, first_sample=first, **found, **fields_of_outputs(wanted))


def found_by(
    setup: EnsembleSetup, first: int, accumulators: Sequence[EnsembleAccumulator], threads: int | None,
    chunk: int | None, progress: bool | None, outputs: Mapping[str, Output],
) -> list[Fields]:  # fmt: skip
    """The fields of an `Ensemble` that simulating samples `first`, ``first + 1``, ... and adding them gives.

    `accumulators`: of each track, one where there is one contact. They are given as many samples as they lack.
    """
    samples = accumulators[0].missing
    threads = _checks.whole_number("threads", threads) if threads is not None else cores()
    plan = (_Plan.of_batches if isinstance(setup.engine, AdaptiveBatch) else _Plan.of)(samples, threads, chunk)
    started = time.perf_counter()
    numbers_of, finished = runner_for(setup, outputs), []
    simulate = _simulator(setup, plan, accumulators)
    _compile(simulate, setup, accumulators[0].keep)
    compiled = time.perf_counter()
    with progress_bar(progress, samples) as bar:
        for number, parts in _in_order(simulate, plan, first, samples):
            for accumulator, part in zip(accumulators, parts, strict=True):
                accumulator.add(part)
            finished.append(np.equal(parts[0].results.status, Status.FINISHED) if outputs else ())
            bar.advance(number)
    values = only(np.concatenate(finished), numbers_of(first, samples, threads))
    for accumulator in accumulators:
        accumulator.add_outputs(values)
    shared = {
        "threads": min(plan.threads, -(-samples // plan.samples_per_task)),
        "compile_seconds": compiled - started,
        "run_seconds": time.perf_counter() - compiled,
    }
    return [accumulator.found() | shared for accumulator in accumulators]


def _extended(
    ensemble: Ensemble, samples: int, threads: int | None, chunk: int | None, progress: bool | None
) -> Ensemble:
    """`ensemble` with more samples; see `Ensemble.extended`."""
    require_threads_of_jax()
    check_extendable(ensemble)
    first = ensemble.first_sample + ensemble.samples
    samples = _checks.whole_number("samples", samples, maximum=MOST_SAMPLES - first)
    model = Model(ensemble.system, ensemble.law, ensemble.y0)
    assert isinstance(ensemble.method, (Exact, Regularized))  # `check_extendable` saw to it
    options = (ensemble.copula, ensemble.method, ensemble.keep, ensemble.numbering)
    outputs = outputs_of(ensemble)
    setup = EnsembleSetup.checked(model, ensemble.t1, samples, first, ensemble._key, *options)
    accumulator = EnsembleAccumulator(ensemble.samples + samples, ensemble.keep)
    accumulator.add_ensemble(ensemble)
    (found,) = found_by(setup, first, (accumulator,), threads, chunk, progress, outputs)
    for name in ("compile_seconds", "run_seconds"):
        found[name] += getattr(ensemble, name)
    return dataclasses.replace(ensemble, samples=ensemble.samples + samples, **found)


Ensemble._extend = staticmethod(_extended)


def simulate_batch(
    setup: EnsembleSetup, first: int, samples: int, keep: Keep, *, retained: int, fewest: int,
    outputs: Mapping[str, Output] = NO_OUTPUTS,
) -> Ensemble:  # fmt: skip
    """Samples `first`, ``first + 1``, ... of a larger whole, simulated in this thread.

    `retained`: the most sticks that are retained for standard errors. `fewest`: of samples that any batch of the whole
    has; programs compiled for one batch fit all others with the same `fewest`.
    """
    adaptive = isinstance(setup.engine, AdaptiveBatch)
    plan = _Plan.of_batches(fewest, 1, None) if adaptive else _Plan.of(_ONE_SIZE, 1, _ONE_SIZE)
    accumulator, started = EnsembleAccumulator(samples, keep, retained), time.perf_counter()
    simulate = _simulator(setup, plan, (accumulator,))
    numbers_of, finished = runner_for(setup, outputs), []
    for begin, number in plan.tasks(first, samples):
        (part,) = simulate(begin, number)
        accumulator.add(part)
        finished.append(np.equal(part.results.status, Status.FINISHED))
    accumulator.add_outputs(only(np.concatenate(finished), numbers_of(first, samples)))
    spent = time.perf_counter() - started
    return Ensemble(
        **setup.fields(), samples=samples, first_sample=first, **accumulator.found(), threads=1, compile_seconds=0.0,
        run_seconds=spent, **fields_of_outputs(outputs),
    )  # fmt: skip


def _compile(simulate: _Simulate, setup: EnsembleSetup, keep: Keep) -> None:
    """Compile before the threads start, so that not each of them compiles the same code."""
    with ThreadPoolExecutor(1) as pool:  # Numba compiles while XLA does
        prepared = pool.submit(prepare, setup.dtype) if keep != "totals" else None
        simulate(0, 0)
        if prepared is not None:
            prepared.result()


class _Plan(NamedTuple):
    """Division of the samples into tasks of `samples_per_task`, simulated in `rows` of `lanes`."""

    lanes: int
    rows: int
    samples_per_task: int
    threads: int

    @classmethod
    def of(cls, samples: int, threads: int, chunk: int | None) -> "_Plan":
        # The arrays of 256 lanes stay in the cache (benchmarks/README.md).
        lanes, rows = 256, 32
        if chunk is not None:
            # Lanes beyond the samples are wasted, but up to 4096 let different numbers of samples share a compilation.
            chunk = min(_checks.whole_number("chunk", chunk, maximum=MOST_SAMPLES), max(samples, 4096))
            lanes = min(lanes, 1 << (chunk - 1).bit_length())
            return cls(lanes, -(-chunk // lanes), chunk, threads)
        # Small runs are divided into smaller tasks, so that every thread has work.
        fair = -(-samples // (4 * threads * lanes)) * lanes
        return cls(lanes, rows, min(fair, lanes * rows), threads)

    @classmethod
    def of_batches(cls, samples: int, threads: int, chunk: int | None) -> "_Plan":
        """The plan for adaptive steps, where every sample of a task has its own lane.

        The number of lanes is always the same, though some may be idle: how the compiler orders the operations of a
        lane, and so the last digits, depends on it, and errors of adaptive steps grow from there.
        """
        most = -(-samples // threads) if chunk is None else _checks.whole_number("chunk", chunk, maximum=MOST_SAMPLES)
        return cls(_ADAPTIVE_LANES, 1, min(_ADAPTIVE_LANES, most), threads)

    def tasks(self, first: int, samples: int) -> list[tuple[int, int]]:
        """The first sample of each task and their number, for samples `first`, ``first + 1``, ..."""
        size, end = self.samples_per_task, first + samples
        return [(begin, min(size, end - begin)) for begin in range(first, end, size)]


def _simulator(setup: EnsembleSetup, plan: _Plan, accumulators: Sequence[EnsembleAccumulator]) -> _Simulate:
    """A function that simulates samples ``first .. first + number - 1`` and records what the `accumulators` keep."""
    if isinstance(setup.engine, AdaptiveBatch):
        return _solver(setup, setup.engine, plan, accumulators[0])
    return _streamer(setup, plan) if accumulators[0].keep == "totals" else _recorder(setup, plan, accumulators)


def _solver(setup: EnsembleSetup, batch: AdaptiveBatch, plan: _Plan, accumulator: EnsembleAccumulator) -> _Simulate:
    """The same as `_simulator`, for adaptive steps."""
    dtype, sizes = setup.dtype, tuple(int(size) for size in batch.sizes)
    arrays = numbers_as_arrays(batch._replace(sizes=()), dtype)._replace(method=batch.method)
    how = {"samples": plan.lanes, "leaf_numbers": setup.leaf_numbers, "sizes": sizes,
           "keep": accumulator.keep != "totals", "dtype": dtype}  # fmt: skip

    def simulate(first: int, number: int) -> tuple[Part]:
        varying = tuple(jnp.asarray(column) for column in setup.varying_leaves(first, plan.lanes))
        numbers = jnp.asarray(setup.inputs.realization_numbers(first, plan.lanes))
        given, lanes = (varying, setup.key_data, numbers, jnp.uint32(number)), np.arange(plan.lanes)
        results, records = solve_chunk(arrays, *given, **how, most=batch.method.max_steps or ADAPTIVE_STEPS)
        results, kept = SampleTotals(*map(np.asarray, results)), [(records, lanes >= 0)]
        short = (results.status == Status.OUT_OF_STEPS) & (lanes < number)
        if batch.method.max_steps is None and np.any(short):  # the others stay as they are
            more, records = solve_chunk(arrays, *given, **how, most=MORE * ADAPTIVE_STEPS)
            results = SampleTotals(*(np.where(short, new, old) for new, old in zip(more, results, strict=True)))
            kept = [(kept[0][0], ~short), (records, short)]
        results = SampleTotals(*(leaf[:number] for leaf in results))
        if records is None:
            return (Part(results),)
        sticks = StickCollector()
        sticks.restart(number)
        for found, of_lanes in kept:
            assert found is not None
            values = np.stack([np.asarray(column).T for column in found.columns.values()], axis=1)
            sticks.add(values, np.where(of_lanes, np.asarray(found.ending).T, np.int8(-1)), lanes[None, :])
        part = Part.of(results, sticks.sticks, setup.t1, setup.numbering, accumulator.wants_sticks, setup.period)
        return (part,)

    return simulate


def _streamer(setup: EnsembleSetup, plan: _Plan) -> _Simulate:
    """The same as `_simulator`, for ``keep="totals"``."""
    assert isinstance(setup.engine, Engine)
    summarize = compiled_for(setup.engine, with_records=setup.inputs.has_sampled_law).summarize

    def simulate(first: int, number: int) -> tuple[Part, ...]:
        job = setup.job(first, -(-number // plan.lanes), plan.lanes * plan.rows)
        results = summarize(job, lanes=plan.lanes, rows=plan.rows, dtype=setup.dtype)
        results = SampleTotals(*(np.asarray(leaf).reshape(-1, *leaf.shape[2:])[:number] for leaf in results))
        return tuple(Part(results.of_track(track)) for track in setup.tracks)

    return simulate


def _recorder(setup: EnsembleSetup, plan: _Plan, accumulators: Sequence[EnsembleAccumulator]) -> _Simulate:
    """The same as `_simulator`, with every stick recorded and accumulated."""
    assert isinstance(setup.engine, Engine)
    _, begin, record = compiled_for(setup.engine, with_records=setup.inputs.has_sampled_law)
    of_thread = threading.local()  # memory of each thread, reused because allocating it for every task is slow
    blocks, dtype = max(1, _RECORDED_AT_ONCE // (BLOCK * plan.lanes)), setup.dtype
    lane, track = np.arange(plan.lanes)[:, None], np.arange(len(setup.tracks))

    def simulate(first: int, number: int) -> tuple[Part, ...]:
        if not hasattr(of_thread, "sticks"):
            of_thread.sticks = StickCollector()
        rows = -(-number // plan.lanes)
        job = jax.tree.map(jnp.asarray, setup.job(first, rows, plan.lanes * plan.rows))
        now, task, layout = begin(job, lanes=plan.lanes, dtype=dtype), packed(job), Layout.of(job)
        of_thread.sticks.restart(number * len(track))
        ended, unfinished = [], True
        while unfinished:
            now, buffer, progress = record(task, now, layout=layout, lanes=plan.lanes, blocks=blocks, dtype=dtype)
            progress = jax.tree.map(np.asarray, progress)
            sample = progress.row[..., None] * plan.lanes + lane
            # The sticks of each track of a sample are collected as if they were those of a sample.
            whose = (sample * len(track) + track).reshape(len(sample), -1)
            of_thread.sticks.add(np.asarray(buffer.values), np.asarray(buffer.ending), whose)
            ended.append((sample[progress.ended, 0], *(column[progress.ended] for column in progress.results)))
            unfinished = np.any(progress.row[-1] + progress.ended[-1] < rows)
        results, sticks = _of_samples(ended, rows * plan.lanes, number), of_thread.sticks.sticks

        def part(track: int | None, keeps: bool) -> Part:
            of_it = sticks if track is None else sticks.of_track(track, len(setup.tracks))
            return Part.of(results.of_track(track), of_it, setup.t1, setup.numbering, keeps, setup.period)

        return tuple(part(one, to.wants_sticks) for one, to in zip(setup.tracks, accumulators, strict=True))

    return simulate


def _of_samples(ended: list[tuple[np.ndarray, ...]], samples: int, number: int) -> SampleTotals:
    """The results of the first `number` of `samples` samples, in order.

    `ended`: sample numbers and results, in the order in which the samples ended.
    """
    sample, *columns = (np.concatenate(parts) for parts in zip(*ended, strict=True))
    ordered = [np.empty((samples, *column.shape[1:]), column.dtype) for column in columns]
    for to, column in zip(ordered, columns, strict=True):
        to[sample] = column
    return SampleTotals(*(column[:number] for column in ordered))


def _in_order(simulate: _Simulate, plan: _Plan, first: int, samples: int) -> Iterator[tuple[int, tuple[Part, ...]]]:
    """Simulate all tasks in threads, a few at a time, and yield the parts in order of the samples."""
    tasks = deque(plan.tasks(first, samples))
    waiting: deque[tuple[int, Future]] = deque()
    with ThreadPoolExecutor(min(plan.threads, len(tasks))) as pool:
        try:
            while tasks or waiting:
                while tasks and len(waiting) < 2 * plan.threads:
                    begin, number = tasks.popleft()
                    waiting.append((number, pool.submit(simulate, begin, number)))
                number, future = waiting.popleft()
                yield number, future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
