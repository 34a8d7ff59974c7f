"""Realisations of a base motion whose velocity is constant between jumps."""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from .._types import AnyArray, FloatArray


class VelocitySteps(eqx.Module):
    """One base motion: ``velocities[i]`` (m/s) for ``durations[i]`` (s), one after the other from t = 0.

    Neighbouring velocities differ, except that spare slots at the end have duration 0. A last duration of
    infinity means "for ever". Made by the laws' ``sample``; use `PiecewiseConstant` to give your own.
    """

    durations: Float[Array, " intervals"]
    velocities: Float[Array, " intervals"]

    @property
    def times(self) -> Float[Array, " intervals"]:
        """The instants at which the intervals begin, s."""
        zero = jnp.zeros_like(self.durations[..., :1])
        return jnp.concatenate([zero, jnp.cumsum(self.durations, axis=-1)[..., :-1]], axis=-1)

    def velocity(self, time: AnyArray | float) -> FloatArray:
        """Base velocity at the given times (any shape), m/s; at a jump, the one after it. One realisation only."""
        # Spare slots begin when all is over: searching among starts with the spare ones moved to infinity skips them.
        starts = jnp.where(self.durations > 0, self.times, jnp.inf)
        index = jnp.searchsorted(starts, jnp.asarray(time), side="right") - 1
        return self.velocities[jnp.clip(index, 0)]


def merge_equal_neighbours(durations: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Join neighbouring intervals of equal velocity; the arrays keep their length, spare slots have duration 0.

    A stick that runs across such a boundary is one stick: to the mass there is no boundary.
    """
    size = durations.shape[0]
    begins = jnp.concatenate([jnp.ones(1, bool), velocities[1:] != velocities[:-1]])
    slot = jnp.cumsum(begins) - 1
    joined = jnp.zeros_like(durations).at[slot].add(durations)
    (source,) = jnp.nonzero(begins, size=size, fill_value=size - 1)
    return joined, velocities[lax.stop_gradient(source)]
