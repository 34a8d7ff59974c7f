"""Realisations of a piecewise-constant base velocity."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import _checks
from .._types import AnyArray, FloatArray


def _as_jax(name: str, values: Any) -> Any:
    return _checks.jax_array(name, values) if isinstance(values, (np.ndarray, jax.Array)) else values


class VelocitySteps(eqx.Module):
    """One realisation of a piecewise-constant base velocity: ``velocities[i]`` (m/s) for ``durations[i]`` (s).

    The intervals follow one another from t = 0. Neighbouring velocities differ; unused intervals at the end have
    duration 0. A last duration of infinity means "for ever". The ``sample`` method of the laws makes them; for a base
    motion of your own use `PiecewiseConstant`.

    Raises ValueError for arrays of different shapes, negative durations, a duration of 0 before the end, velocities
    that are not finite or equal to their neighbour's.
    """

    durations: Float[Array, "*batch intervals"] = eqx.field(converter=partial(_as_jax, "durations"))
    velocities: Float[Array, "*batch intervals"] = eqx.field(converter=partial(_as_jax, "velocities"))

    def __check_init__(self):
        for name in ("durations", "velocities"):
            value = getattr(self, name)
            if not isinstance(value, jax.Array):
                raise ValueError(f"Argument {name} must be an array, but {_checks.show(value)} was given.")
        if self.durations.shape != self.velocities.shape or self.durations.ndim == 0:
            raise ValueError(
                "Arguments durations and velocities must have the same shape (intervals,), but they have shapes "
                f"{self.durations.shape} and {self.velocities.shape}."
            )
        if _checks.is_traced(self.durations) or _checks.is_traced(self.velocities) or self.durations.ndim > 1:
            return
        durations = np.asarray(self.durations)
        if not np.all(durations >= 0):
            raise ValueError(f"Argument durations must be zero or positive, but {_checks.show(durations)} was given.")
        if np.any((durations[1:] > 0) & (durations[:-1] == 0)):
            raise ValueError(
                "Argument durations must be 0 in unused intervals at the end only, but an interval of duration 0 has "
                f"one after it that lasts: {_checks.show(durations)}; leave it out."
            )
        lasting = np.asarray(self.velocities)[durations > 0]
        _checks.bounded("velocities", lasting, ndim=1)
        if np.any(lasting[1:] == lasting[:-1]):
            raise ValueError(
                "Argument velocities must change from interval to interval, but two neighbours are equal; "
                "use PiecewiseConstant(times, velocities), which merges them."
            )

    @property
    def times(self) -> Float[Array, " intervals"]:
        """Times at which the intervals begin, s."""
        zero = jnp.zeros_like(self.durations[..., :1])
        return jnp.concatenate([zero, jnp.cumsum(self.durations, axis=-1)[..., :-1]], axis=-1)

    def velocity(self, time: AnyArray | float) -> FloatArray:
        """Base velocity at the given times (any shape), m/s; at a jump, the one after it. One realisation only."""
        # Unused intervals are moved to infinity, so that the search skips them.
        starts = jnp.where(self.durations > 0, self.times, jnp.inf)
        index = jnp.searchsorted(starts, jnp.asarray(time), side="right") - 1
        return self.velocities[jnp.clip(index, 0)]
