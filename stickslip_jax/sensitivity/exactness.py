"""Where derivatives do not exist: all trajectories begin with an arc that exactly grazes; base speeds w = 1 and 2."""

import warnings
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..dynamics.interval_engine import scales_of, start_motion
from ..numerics.random_bits import random_words
from .counting import relative_excess
from .parameters import number_at, with_numbers
from .problem import Problem

_LANES = 64  # enough to meet every first velocity that is not rare
_EXACTLY = 1e-9  # of the scale of the squared velocities


def warn_if_grazing(problem: Problem) -> tuple[str, ...]:
    """Names of the parameters by which no derivative exists, with a RuntimeWarning about them."""
    if not (problem.by_intervals and problem.fixed_start):
        return ()
    paths = problem.paths()
    engine, dtype = problem.engine(), problem.dtype
    words = random_words(problem.words, jnp.arange(_LANES, dtype=jnp.uint32))

    def excess(values):
        """``R^2 - q^2`` of the first arc, relative to its scale; 1 for arcs from above."""
        varied = with_numbers(engine, paths, values)
        scales = scales_of(varied.system, varied.t1, dtype)
        motion = start_motion(scales, (varied.y0[0], varied.y0[1]))

        def of(high, low):
            memory = varied.law.begin((high, low), dtype)
            drawn = varied.law.draw((high, low), jnp.zeros((), jnp.uint32), dtype)
            _, velocity, _ = varied.law.next_interval(memory, drawn, dtype)
            return relative_excess(scales, motion, velocity)

        return jax.vmap(of)(*words)

    grazes, moved = _zeros(problem, excess)
    if moved:
        warnings.warn(
            f"The derivative with respect to {', '.join(moved)} does not exist: {np.mean(grazes):.0%} of the "
            "trajectories begin with an arc that grazes the base velocity exactly, so that it makes a stick for "
            "smaller changes of one sign and none for those of the other. It is given as NaN; change y0, or make it "
            "random.",
            RuntimeWarning,
            stacklevel=4,
        )
    return tuple(moved)


def warn_at_special_speeds(problem: Problem, told: tuple[str, ...]) -> None:
    """RuntimeWarning where a base speed is exactly ``a omega`` or twice that, and a parameter changes their ratio w.

    There the circle on which the mass leaves a stick passes through special points of the phase plane, and the mean
    number of sticks bends without end: differences grow as steps shrink. Not for parameters `told` of already.
    """
    if not problem.by_intervals:
        return
    paths = problem.paths()
    engine, dtype = problem.engine(), problem.dtype
    words = random_words(problem.words, jnp.arange(_LANES, dtype=jnp.uint32))

    def distance(values):
        """``w - 1`` and ``w - 2`` of the first base speed; 1 for a base at rest."""
        varied = with_numbers(engine, paths, values)
        scales = scales_of(varied.system, varied.t1, dtype)

        def of(high, low):
            memory = varied.law.begin((high, low), dtype)
            drawn = varied.law.draw((high, low), jnp.zeros((), jnp.uint32), dtype)
            _, velocity, _ = varied.law.next_interval(memory, drawn, dtype)
            w = jnp.abs(velocity) * scales.per_omega / scales.half_width
            return jnp.where(velocity == 0, 1.0, jnp.stack([w - 1, w - 2]))

        return jax.vmap(of)(*words).reshape(-1)

    found, moved = _zeros(problem, distance)
    moved = [name for name in moved if name not in told]
    if moved:
        special = 1 if np.any(found.reshape(-1, 2)[:, 0]) else 2
        warnings.warn(
            f"The dimensionless base speed w = speed / (a omega) is exactly {special}, where the mean number of "
            f"sticks has no derivative with respect to {', '.join(moved)}: its slope depends on the step at which it "
            "is taken. The slope over about `reach` is given; see docs/sensitivity.md.",
            RuntimeWarning,
            stacklevel=4,
        )


def _zeros(problem: Problem, function: Callable[[Any], Any]) -> tuple[np.ndarray, list[str]]:
    """Where a function of the parameters' values is exactly 0, (numbers,), and which parameters move it there."""
    engine = problem.engine()
    values = jnp.stack([jnp.asarray(number_at(engine, path), problem.dtype) for path in problem.paths()])
    slopes = np.asarray(jax.jacfwd(function)(values))
    zero = np.abs(np.asarray(function(values))) < _EXACTLY
    moved = [
        parameter.name
        for index, parameter in enumerate(problem.parameters)
        if np.any(zero & (np.abs(slopes[:, index]) > _EXACTLY))
    ]
    return zero, moved
