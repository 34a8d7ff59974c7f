"""A statistic or the mean of an output as a function of parameters, for the user's own objectives."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from .._dynamics.common.lanes import Job, summarize
from .._dynamics.common.method import Exact
from .._dynamics.simulate import simulate
from .._ensemble.setup import EnsembleSetup
from .._excitation.excitation import BaseMotion, is_random
from .._excitation.segments import SegmentLaw
from .._foundation import checks
from .._foundation.types import FloatArray, InitialState, Status
from .._statistics.accumulator import Numbering
from .._systems.system import System
from .._uncertainty.families import RandomNumber
from .._uncertainty.numbers import number_at, shown, with_numbers
from .counting import recording
from .estimators import counting_engine, score_paths
from .problem import (
    LANES,
    Pilot,
    SensitivityProblem,
    buffer_sizes_for,
    problem_of,
    relative_bandwidth_of,
    require_correctable,
    require_precision,
)
from .statistic import AnyStatistic, BufferSizes, OfOutput, OfTotals, features_of, record_sequences, wrapped

# The mean of an output as a function of parameters, for `differentiable`: compiled, with differences as derivative.


_OUTPUT_LANES = 64
_SPARE = 2  # times as many steps and intervals as at the parameters given


def output_means(problem: SensitivityProblem, samples: int) -> Callable[[Array], Float[Array, "2"]]:
    """A function of the parameters' values: the sums of the output, and of 1, over the samples that finish.

    NaN where a sample needs more steps, or intervals of the base, than twice as many as at the parameters given.
    """
    statistic, model, method = problem.statistic, problem.model, problem.method
    assert isinstance(statistic, OfOutput)
    for parameter in problem.parameters:
        if any(isinstance(number_at(model, parameter.path[:end]), RandomNumber) for end in range(len(parameter.path))):
            raise ValueError(
                f"Argument wrt must name plain numbers for outputs, but {shown(parameter.path)} is that of a "
                "distribution; use sensitivity."
            )
    key = jax.random.wrap_key_data(problem.key_data)
    options = (problem.samples, 0, key, None, method, "totals", Numbering(1, True))
    inputs = EnsembleSetup.checked(model, problem.t1, *options).inputs
    rows = -(-samples // _OUTPUT_LANES)
    columns = tuple(jnp.asarray(column) for column in inputs.drawn(0, rows * _OUTPUT_LANES, problem.dtype))
    numbers = jnp.asarray(inputs.realization_numbers(0, rows * _OUTPUT_LANES))
    bases = inputs.realizations(0, rows * _OUTPUT_LANES, problem.t1)
    paths = tuple(parameter.path for parameter in problem.parameters)
    if isinstance(method, Exact) and not problem.by_intervals:
        method = Exact(max_steps=_SPARE * problem.steps)  # a number that does not depend on the parameters
    room = {}
    if isinstance(problem.law, SegmentLaw):
        room = {"capacity": _SPARE * problem.law.segments(problem.t1)}

    def sample(values: Array, column: tuple[Array, ...], number: Array, base: Any) -> Float[Array, "2"]:
        system, law, y0 = with_numbers(inputs.filled(column), paths, values)
        if base is None:
            # The numbers of the law may be traced.
            base = law.sample(jax.random.fold_in(key, number), problem.t1, **room) if is_random(law) else law
        one = simulate(system, base, t1=problem.t1, y0=y0, method=method)
        finished = one.status == Status.FINISHED
        short = (one.status == Status.OUT_OF_STEPS) | (one.status == Status.BASE_TOO_SHORT)
        value = jnp.where(finished, statistic.output.number(one, problem.dtype), jnp.where(short, jnp.nan, 0))
        return jnp.stack([value, finished.astype(value.dtype)])

    def means(values: Array, varied: None = None) -> Float[Array, "2"]:
        del varied
        batches = jax.tree.map(
            lambda leaf: leaf.reshape(rows, _OUTPUT_LANES, *leaf.shape[1:]), (columns, numbers, bases)
        )
        each = lax.map(lambda batch: jax.vmap(partial(sample, values))(*batch), batches)
        return jnp.sum(each, axis=(0, 1))

    return means


# A statistic as a function of parameters, for the user's own objectives, with the corrected derivative.


def differentiable(
    statistic: AnyStatistic,
    system: System,
    law: BaseMotion,
    *,
    wrt: str | tuple[str, ...] | list[str],
    t1: float,
    samples: int,
    key: Array | None = None,
    y0: InitialState | None = None,
) -> Callable[[ArrayLike], Array]:
    """A function of the values of the parameters `wrt` that estimates `statistic`, to use under ``jax.jit``.

    Call it with one number (`wrt` a name) or an array (as many as names). Differentiating it, in forward or reverse
    mode, gives the derivative of the expectation, corrected for sticks that appear and vanish as in `sensitivity`;
    the slope of the simulated mean, which is only piecewise smooth, is a different number. Every call uses the same
    random numbers, so there is no noise from call to call, but the function has small jumps. It has no second
    derivatives.

    The windows of the kernels are chosen once, from the parameters of `system` and `law` given here.

    Args:
        statistic: As for `sensitivity`, one. The derivative of an `Output` is that of central differences with the same
            random numbers, whose step is the default of `sensitivity`.
        system: As for `sensitivity`.
        law: As for `sensitivity`.
        wrt: As for `sensitivity`.
        t1: As for `sensitivity`, s.
        samples: Number of samples, rounded up to a multiple of 256.
        key: As for `sensitivity`.
        y0: As for `sensitivity`.

    Returns:
        The function. Its result is NaN where the statistic is defined for no sample, or where a sample has far more
        sticks than at the parameters given here.

    Raises:
        ValueError: As for `sensitivity` with ``estimator="corrected"``.
    """
    if isinstance(statistic, (list, tuple)):
        raise checks.refused("statistic", "be one statistic (sensitivity takes several)", statistic)
    problem, pilot = problem_of(statistic, system, law, wrt, t1, samples, key, y0)
    rows, bandwidth = -(-problem.samples // LANES), relative_bandwidth_of(problem, pilot)
    if problem.is_output:
        means = output_means(problem, rows * LANES)
    else:
        require_precision(problem)
        require_correctable(problem)
        means = (_counted if problem.is_counted else _recorded)(problem, pilot, bandwidth, rows)
    estimate = _ratio(means, bandwidth if problem.is_paired or problem.is_output else None)
    number = len(problem.parameters)

    def of(values: ArrayLike) -> Array:
        values = jnp.asarray(values, problem.dtype)
        if values.shape != (() if isinstance(wrt, str) else (number,)):
            raise ValueError(
                f"Argument values must hold {'one number' if isinstance(wrt, str) else f'{number} numbers'}, one for "
                f"each of {wrt}, but an array of shape {values.shape} was given."
            )
        return estimate(values.reshape(number))

    return of


_Means: TypeAlias = Callable[..., Float[Array, "2"]]
"""Means of numerator and denominator at parameter values, (values,).

To differentiate, pass the same values again as the second argument and differentiate by that.
"""


def _ratio(means: _Means, step: float | None) -> Callable[[Float[Array, " values"]], FloatArray]:
    """The ratio of both means, with its derivative by the quotient rule, all in one pass.

    With a `step` (relative to each value), the derivatives of the means are central differences.
    """

    def slopes(values: Array, units: Array) -> Float[Array, "values 2"]:
        """Derivatives of both means by every value, measured in `units`."""

        def along(direction):
            if step is not None:
                return (means(values + step * direction) - means(values - step * direction)) / (2 * step)
            return jax.jvp(lambda varied: means(values, varied), (values,), (direction,))[1]

        return jax.vmap(along)(jnp.diag(units))

    @jax.custom_jvp
    def estimate(values):
        above, below = means(values)
        return above / below

    @estimate.defjvp
    def _(primals, tangents):
        (values,), (moves,) = primals, tangents
        above, below = means(values)
        units = jnp.where(values == 0, 1, jnp.abs(values))
        by_unit = slopes(values, units)
        slope = (by_unit[:, 0] - above / below * by_unit[:, 1]) / below / units
        return above / below, jnp.sum(slope * moves)

    return estimate


def _counted(problem: SensitivityProblem, pilot: Pilot, bandwidth: float, rows: int) -> _Means:
    """Means by the engines that count sticks."""
    assert isinstance(problem.statistic, OfTotals)
    # One window, the widest: comparing several is not possible inside a compiled function.
    engine = counting_engine(problem, pilot, np.array([] if problem.is_paired else [bandwidth]))
    weights = jnp.asarray(problem.statistic.weights(problem.t1), problem.dtype)
    paths = problem.paths("engine")
    varying = problem.varying_leaves(0, rows * LANES)
    by = score_paths(engine, paths)
    by_score = tuple(other for path, other in zip(paths, by, strict=True) if other != path)

    def means(values: Array, varied: Array | None = None) -> Array:
        here = with_numbers(engine, paths, values)
        if by_score:
            here = with_numbers(here, by_score, (values[by.index(by_score[0])],))
        if varied is not None:
            here = with_numbers(here, by, varied)
        job = Job(here, problem.key_data, np.uint32(0), np.int32(rows), varying)
        counted = summarize(job, lanes=LANES, rows=rows, dtype=problem.dtype)
        done = counted.status == Status.FINISHED
        sticks = sum(counted.sums.event_parts, jnp.asarray(counted.sticks, problem.dtype))
        totals = [jnp.where(done, jnp.asarray(leaf), 0) for leaf in (counted.stick_time, sticks, done)]
        return weights @ jnp.stack([jnp.sum(leaf, dtype=problem.dtype) for leaf in totals])

    return means


def _recorded(problem: SensitivityProblem, pilot: Pilot, bandwidth: float, rows: int) -> _Means:
    """Means by recorded stick sequences."""
    engine, paths, buffer = problem.engine(), problem.paths(), buffer_sizes_for(problem, pilot)
    buffer = BufferSizes(2 * buffer.blocks, 2 * buffer.slots, 0 if problem.is_paired else 2 * buffer.candidates)
    bandwidths = np.array([bandwidth])
    varying = tuple(jnp.asarray(column) for column in problem.varying_leaves(0, rows * LANES))

    def means(values: Array, varied: Array | None = None) -> Array:
        here = with_numbers(engine, paths, values if varied is None else varied)
        here = wrapped(here, partial(recording, fixed_start=problem.fixed_start))

        def chunk(first):
            mine = jax.tree.map(lambda column: lax.dynamic_slice_in_dim(column, first, LANES), varying)
            job = Job(here, problem.key_data, first, np.int32(1), mine)
            recorded = record_sequences(job, lanes=LANES, buffer=buffer, dtype=problem.dtype)
            features = features_of(problem.statistic, recorded, bandwidths)
            status, sticks, candidates = recorded.counts
            done = (status == Status.FINISHED)[:, None]
            lost = jnp.any((sticks >= buffer.slots) | (candidates > buffer.candidates))
            parts = jnp.where(done, features.parts + features.event_parts[:, 0], 0)
            return jnp.where(lost, jnp.nan, jnp.sum(parts, axis=0))

        firsts = jnp.arange(rows, dtype=jnp.uint32) * np.uint32(LANES)
        return jnp.sum(lax.map(chunk, firsts), axis=0)

    return means
