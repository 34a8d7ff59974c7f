"""Where derivatives do not exist: all trajectories begin alike, with an arc that exactly grazes the base velocity."""

import warnings

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

    values = jnp.stack([jnp.asarray(number_at(engine, path), dtype) for path in paths])
    slopes = np.asarray(jax.jacfwd(excess)(values))
    grazes = np.abs(np.asarray(excess(values))) < _EXACTLY
    moved = [
        parameter.name
        for index, parameter in enumerate(problem.parameters)
        if np.any(grazes & (np.abs(slopes[:, index]) > _EXACTLY))
    ]
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
