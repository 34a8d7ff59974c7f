"""Warnings where no derivative exists: a first arc that grazes exactly in every trajectory; special base speeds."""

import warnings
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from .._dynamics.common.engine import Engine
from .._dynamics.interval.arcs import Scales
from .._dynamics.interval.crossing import scales_of, start_motion
from .._dynamics.interval.engine import IntervalEngine
from .._numerics.random_bits import random_words
from .._types import Array, DType
from .._uncertainty.numbers import Parameter, Path, number_at, with_numbers
from .boundaries import relative_excess
from .problem import Problem

_LANES = 64  # enough to draw every first velocity that is not rare
_EXACTLY = 1e-9  # tolerance relative to the squared velocities, and to w
_SPECIAL = (1.0, 2.0, 3.0, 8.0, 15.0)  # values of w (docs/sensitivity.md)

_Function: TypeAlias = Callable[[IntervalEngine, Scales, Float[Array, " lanes"]], Array]
"""Of an engine, its scales, and the first base velocity of each lane: numbers of each lane, (lanes, ...)."""


def warn_if_grazing(problem: Problem) -> tuple[str, ...]:
    """Names of the parameters by which no derivative exists because the first arc grazes; warns (RuntimeWarning)."""
    if not (problem.by_intervals and problem.fixed_start):
        return ()
    grazes, moved = _zeros(problem, _excess)
    if moved:
        warnings.warn(
            f"The derivative with respect to {', '.join(moved)} does not exist: {np.mean(grazes):.0%} of the "
            "trajectories begin with an arc that grazes the base velocity exactly, so that a change of one sign, "
            "however small, makes a stick there, and one of the other sign none. The derivative is given as NaN; "
            "change y0, or make it random.",
            RuntimeWarning,
            stacklevel=4,
        )
    return tuple(moved)


def warn_at_special_speeds(problem: Problem, already_warned: tuple[str, ...]) -> None:
    """RuntimeWarning where the base speed over ``a omega``, w, is one of `_SPECIAL`, and a parameter changes it.

    There the circle on which the mass leaves a stick passes through special points of the phase plane, or the mass,
    where the base reverses as it is farthest out, comes back on the edge of the stick band. The mean number of sticks
    has no derivative: differences grow as steps shrink. `already_warned`: parameters with a warning.
    """
    if not problem.by_intervals or _speed_differs(problem):
        return
    found, moved = _zeros(problem, _from_special_speeds)
    moved = [name for name in moved if name not in already_warned]
    if moved:
        special = _SPECIAL[int(np.argmax(np.any(found, axis=0)))]
        warnings.warn(
            f"The dimensionless base speed w = speed / (a omega) is exactly {special:g}, where the mean number of "
            f"sticks has no derivative with respect to {', '.join(moved)}: its slope depends on the step at which it "
            "is taken. The slope over about `relative_bandwidth` is given; see docs/sensitivity.md.",
            RuntimeWarning,
            stacklevel=4,
        )


def _excess(engine: IntervalEngine, scales: Scales, velocities: Float[Array, " lanes"]) -> Float[Array, " lanes"]:
    """``R^2 - q^2`` of the first arc, relative to its scale; 1 for arcs from above."""
    motion = start_motion(scales, (engine.y0[0], engine.y0[1]))
    return jax.vmap(lambda velocity: relative_excess(scales, motion, velocity))(velocities)


def _from_special_speeds(_: IntervalEngine, scales: Scales, velocities: Float[Array, " lanes"]) -> Array:
    """``w`` of the first base speed less each special one, (lanes, special speeds); 1 for a base at rest."""
    velocity = velocities[:, None]
    squared = scales.spring.squared
    omega = jnp.sqrt(jnp.where(squared > 0, squared, 1))
    w = jnp.where(squared > 0, jnp.abs(velocity) * omega / scales.deceleration, 0)
    return jnp.where(velocity == 0, 1.0, w - jnp.array([_SPECIAL], velocity.dtype))


def _velocities(engine: IntervalEngine, key_data: tuple[Array, Array], dtype: DType) -> Float[Array, " lanes"]:
    """The first base velocity of each lane, m/s."""

    def of(high, low):
        memory = engine.law.begin((high, low), dtype)
        drawn = engine.law.draw((high, low), jnp.zeros((), jnp.uint32), dtype)
        return engine.law.next_interval(memory, drawn, dtype)[1]

    return jax.vmap(of)(*key_data)


def _zeros(problem: Problem, function: _Function) -> tuple[Bool[np.ndarray, "..."], list[str]]:
    """Where a function of the engine is exactly 0, and the names of the parameters that change it there."""
    # Only where all samples are the same system; what differs in their starts does not matter here.
    problem = problem._replace(
        random=None, parameters=tuple(one for one in problem.parameters if _is_shared(problem, one))
    )
    engine, dtype = problem.engine(), problem.dtype
    if not problem.parameters:
        return np.zeros(0, bool), []
    key_data = random_words(problem.key_data, jnp.arange(_LANES, dtype=jnp.uint32))
    # Compiled as one: run operation by operation, it would take longer than the sensitivity itself.
    found, slopes = _with_slopes(engine, key_data, function=function, paths=problem.paths(), dtype=dtype)
    zero, moves = np.abs(np.asarray(found)) < _EXACTLY, np.abs(np.asarray(slopes)) > _EXACTLY
    moved = [parameter.name for index, parameter in enumerate(problem.parameters) if np.any(zero & moves[..., index])]
    return zero, moved


def _speed_differs(problem: Problem) -> bool:
    """Whether ``speed / (a omega)`` differs from sample to sample."""
    entries = () if problem.random is None else problem.random.inputs.entries
    return any(entry.path[0] == "system" or entry.path == ("law", "speed") for entry in entries)


def _is_shared(problem: Problem, parameter: Parameter) -> bool:
    """Whether the parameter is a number of all samples, not one of a distribution."""
    entries = () if problem.random is None else problem.random.inputs.entries
    return not any(parameter.path[: len(entry.path)] == entry.path for entry in entries)


@partial(jax.jit, static_argnames=("function", "paths", "dtype"))
def _with_slopes(
    engine: Engine, key_data: tuple[Array, Array], *, function: _Function, paths: tuple[Path, ...], dtype: DType
) -> tuple[Array, Array]:
    """Values of the function, and its derivatives by the parameters along a last axis."""

    def of(values: Array) -> Array:
        here = with_numbers(engine, paths, values)
        return function(here, scales_of(here.system, here.t1, dtype), _velocities(here, key_data, dtype))

    values = jnp.stack([jnp.asarray(number_at(engine, path), dtype) for path in paths])
    return of(values), jax.jacfwd(of)(values)
