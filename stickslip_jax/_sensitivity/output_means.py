"""The mean of an output as a function of parameters, for `differentiable`: compiled, with differences as derivative."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Float

from .._dynamics.common.method import Exact, Regularized
from .._dynamics.common.validation import Arguments
from .._dynamics.switched.run import steps_for
from .._ensemble.setup import EnsembleSetup
from .._excitation.excitation import is_random
from .._excitation.segments import SegmentLaw
from .._simulation.call import simulate
from .._statistics.accumulator import Numbering
from .._status import Status
from .._types import Array
from .._uncertainty.numbers import number_at, shown, with_numbers
from .._uncertainty.random_number import RandomNumber
from .problem import Problem
from .statistic import OfOutput

_LANES = 64
_SPARE = 2  # times as many steps and intervals as at the parameters given


def output_means(problem: Problem, samples: int) -> Callable[[Array], Float[Array, "2"]]:
    """A function of the parameters' values: the sums of the output, and of 1, over the samples that finish.

    NaN where a sample needs more steps, or intervals of the base, than twice as many as at the parameters given.
    """
    statistic, model = problem.statistic, problem.model
    assert isinstance(statistic, OfOutput)
    assert model is not None
    for parameter in problem.parameters:
        if any(isinstance(number_at(model, parameter.path[:end]), RandomNumber) for end in range(len(parameter.path))):
            raise ValueError(
                f"Argument wrt must name plain numbers for outputs, but {shown(parameter.path)} is that of a "
                "distribution; use sensitivity."
            )
    key = jax.random.wrap_key_data(problem.key_data)
    options = (problem.samples, 0, key, None, problem.method, "totals", Numbering(1, True))
    inputs = EnsembleSetup.checked(model, problem.t1, *options).inputs
    rows = -(-samples // _LANES)
    columns = tuple(jnp.asarray(column) for column in inputs.drawn(0, rows * _LANES, problem.dtype))
    numbers = jnp.asarray(inputs.realization_numbers(0, rows * _LANES))
    bases = inputs.realizations(0, rows * _LANES, problem.t1)
    paths, method = tuple(parameter.path for parameter in problem.parameters), _method_of(problem)

    def sample(values: Array, column: tuple[Array, ...], number: Array, base: Any) -> Float[Array, "2"]:
        system, law, y0 = with_numbers(inputs.filled(column), paths, values)
        if base is None:
            base = _realization(law, problem, jax.random.fold_in(key, number)) if is_random(law) else law
        one = simulate(system, base, t1=problem.t1, y0=y0, method=method)
        finished = one.status == Status.FINISHED
        short = (one.status == Status.OUT_OF_STEPS) | (one.status == Status.BASE_TOO_SHORT)
        value = jnp.where(finished, statistic.output.number(one, problem.dtype), jnp.where(short, jnp.nan, 0))
        return jnp.stack([value, finished.astype(value.dtype)])

    def means(values: Array, varied: None = None) -> Float[Array, "2"]:
        del varied
        batches = jax.tree.map(lambda leaf: leaf.reshape(rows, _LANES, *leaf.shape[1:]), (columns, numbers, bases))
        each = lax.map(lambda batch: jax.vmap(partial(sample, values))(*batch), batches)
        return jnp.sum(each, axis=(0, 1))

    return means


def _method_of(problem: Problem) -> Exact | Regularized:
    """The method, with a number of steps that does not depend on the parameters."""
    if problem.by_intervals or not isinstance(problem.method, Exact):
        return problem.method
    excitation, step = Arguments(problem.system, problem.law, problem.method, problem.t1).checked_step("law")
    return Exact(max_steps=_SPARE * steps_for(problem.system, excitation, problem.t1, step))


def _realization(law: Any, problem: Problem, key: Array) -> Any:
    """The realisation of a law whose numbers may be traced."""
    if isinstance(law, SegmentLaw):
        assert isinstance(problem.law, SegmentLaw)
        return law.sample(key, problem.t1, capacity=_SPARE * problem.law.segments(problem.t1))
    return law.sample(key, problem.t1)
