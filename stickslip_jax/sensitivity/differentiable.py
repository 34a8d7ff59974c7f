"""A statistic as a function of parameters, for objectives of one's own: its derivative is the corrected one."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .._status import Status
from .._types import Array
from ..dynamics.lanes import Engine, Job, summarise
from .estimators import RATE, counting_engine
from .first_look import problem_of, reach_of, windows_of
from .parameters import Path, with_numbers
from .problem import Pilot, Problem, room_for
from .sequences import Spans, features_of, record_sequences
from .statistic import OfTotals

_LANES = 256


def differentiable(
    statistic: Any,
    system: Any,
    law: Any,
    *,
    wrt: str | tuple[str, ...] | list[str],
    t1: float,
    samples: int,
    key: Array | None = None,
    y0: Any = None,
) -> Callable[[Any], Array]:
    """A function of the values of the parameters `wrt` that estimates `statistic`, to use under ``jax.jit``.

    Call it with one number (`wrt` a name) or an array (as many as names). Differentiating it, in forward or reverse
    mode, gives the derivative of the expectation, corrected for sticks born and lost as `sensitivity` does, and not
    that of the simulated mean, which is piecewise smooth and whose slope is another. The random numbers are the same in
    every call, so that the function has no noise from call to call; it has small jumps. Second derivatives do not
    exist.

    Arguments and errors as for `sensitivity`; the windows of the kernels are settled here, by the parameters of
    `system` and `law`. `samples` is rounded up to a multiple of 256. NaN where no sample has what the statistic is of,
    or one has far more sticks than those of the parameters given here.
    """
    problem, pilot = problem_of(statistic, system, law, wrt, t1, samples, key, y0)
    rows = -(-problem.samples // _LANES)
    means = (_counted if problem.is_counted else _recorded)(problem, pilot, rows)
    number = len(problem.parameters)

    @jax.custom_jvp
    def estimate(values):
        above, below = means(values, None)
        return above / below

    @estimate.defjvp
    def _(primals, tangents):
        (values,), (moves,) = primals, tangents
        value, slope = estimate(values), jnp.zeros((), values.dtype)
        for index in range(number):
            unit = jnp.where(values[index] == 0, 1, jnp.abs(values[index]))
            (_, below), (d_above, d_below) = means(values, (index, unit))
            slope = slope + (d_above - value * d_below) / below / unit * moves[index]
        return value, slope

    def of(values: Any) -> Array:
        values = jnp.asarray(values, problem.dtype)
        if values.shape != (() if isinstance(wrt, str) else (number,)):
            raise ValueError(
                f"Argument values must hold {'one number' if isinstance(wrt, str) else f'{number} numbers'}, one for "
                f"each of {wrt}, but an array of shape {values.shape} was given."
            )
        return estimate(values.reshape(number))

    return of


Means = Callable[[Array, tuple[int, Array] | None], Any]


def _counted(problem: Problem, pilot: Pilot, rows: int) -> Means:
    """Means of numerator and denominator by counting lanes; with a parameter and its unit, their derivatives beside."""
    assert isinstance(problem.statistic, OfTotals)
    engine = counting_engine(problem, pilot, reach_of(problem, pilot))
    weights = jnp.asarray(problem.statistic.weights(problem.t1), problem.dtype)
    paths = problem.paths()

    def of_engine(engine: Engine) -> Array:
        job = Job(engine, problem.words, np.uint32(0), np.int32(rows))
        results = summarise(job, lanes=_LANES, rows=rows, dtype=problem.dtype)
        done = results.status == Status.FINISHED
        totals = [jnp.where(done, jnp.asarray(leaf), 0) for leaf in (results.stick_time, results.sticks, done)]
        return weights @ jnp.stack([jnp.sum(leaf, dtype=problem.dtype) for leaf in totals])

    def means(values: Array, varied: tuple[int, Array] | None) -> Any:
        here = _with_rate(engine, paths, values)
        if varied is None:
            return of_engine(here)
        index, unit = varied
        by_likelihood = paths[index] == RATE and engine.likelihood is not None
        path: Path = ("likelihood", "rate") if by_likelihood else paths[index]
        return jax.jvp(lambda value: of_engine(with_numbers(here, (path,), (value,))), (values[index],), (unit,))

    return means


def _with_rate(engine: Any, paths: tuple[Path, ...], values: Array) -> Any:
    """The engine with the parameters set, in the likelihood too."""
    varied = with_numbers(engine, paths, values)
    if engine.likelihood is None or RATE not in paths:
        return varied
    return with_numbers(varied, (("likelihood", "rate"),), (values[paths.index(RATE)],))


def _recorded(problem: Problem, pilot: Pilot, rows: int) -> Means:
    """The same by recorded sequences."""
    engine, room, paths = problem.engine(), room_for(problem, pilot), problem.paths()
    slots = 2 * room.slots
    # One window: which is best cannot be asked inside a compiled function.
    spans = Spans(
        jnp.asarray(windows_of(problem, pilot)[1:2], problem.dtype),
        jnp.asarray([reach_of(problem, pilot)], problem.dtype),
    )

    def of_engine(engine: Engine) -> Array:
        def chunk(first):
            recorded = record_sequences(
                engine, problem.words, first, lanes=_LANES, blocks=2 * room.blocks, slots=slots, dtype=problem.dtype
            )
            features = features_of(problem.statistic, engine, recorded, spans, problem.fixed_start)
            done = (recorded.status == Status.FINISHED)[:, None]
            parts = jnp.where(done, features.parts + features.events[:, 0], 0)
            lost = jnp.any(recorded.count > slots)
            return jnp.where(lost, jnp.nan, jnp.sum(parts, axis=0))

        firsts = jnp.arange(rows, dtype=jnp.uint32) * np.uint32(_LANES)
        return jnp.sum(lax.map(chunk, firsts), axis=0)

    def means(values: Array, varied: tuple[int, Array] | None) -> Any:
        here = with_numbers(engine, paths, values)
        if varied is None:
            return of_engine(here)
        index, unit = varied
        return jax.jvp(
            lambda value: of_engine(with_numbers(here, (paths[index],), (value,))), (values[index],), (unit,)
        )

    return means
