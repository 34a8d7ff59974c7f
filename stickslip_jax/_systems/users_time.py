"""Whether what a user's methods return depends on time by itself."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .users_forcing import UsersBase


def differs_between(system: Any, y0: Any, times: np.ndarray, others: np.ndarray) -> bool:
    """Whether rates, relative velocities or normal forces of `system`, its base at rest, are others at `times` than at
    `others` (s), near the state `y0`: not in it, where a number may be zero.
    """
    start, zero = np.asarray(y0, float), jnp.zeros(())
    state = tuple(jnp.asarray(start + (0.3 + 0.1 * np.arange(len(start))) * (1 + np.abs(start))))
    base = UsersBase(zero, zero, zero)
    friction = jnp.full(() if system.contacts is None else (system.contacts,), 0.5)

    def at(t):
        rates = [system.rates(t, state, base, share * friction) for share in (0.0, 1.0)]
        forces = system.normal_forces(t, state, base) if system.has_normal_forces else ()
        parts = jax.tree.leaves((rates, system.relative_velocity(t, state, base), forces))
        return jnp.concatenate([jnp.ravel(jnp.asarray(part, float)) for part in parts])

    first, second = (np.asarray(jax.vmap(at)(jnp.asarray(values))) for values in (times, others))
    scale = np.max(np.abs(first), axis=0)
    return bool(np.any(np.abs(first - second) > np.sqrt(np.finfo(first.dtype).eps) * scale))
