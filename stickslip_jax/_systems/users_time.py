"""Whether what a user's methods return depends on time by itself."""

from functools import lru_cache
from itertools import repeat
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .users_forcing import UsersBase, with_records_at


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


def depends_on_time(system: Any) -> bool:
    """Whether what the methods of `system` return depends on time otherwise than by its base and its records."""
    leaves, structure = jax.tree.flatten(system)
    kind = structure, tuple(jax.ShapeDtypeStruct(jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
    try:
        return _depends_on_time(*kind)
    except TypeError:  # a static field cannot be hashed
        return _depends_on_time.__wrapped__(*kind)


@lru_cache(maxsize=256)
def _depends_on_time(structure: Any, leaves: tuple[jax.ShapeDtypeStruct, ...]) -> bool:
    def at(t, numbers):
        given: Any = jax.tree.unflatten(structure, numbers)
        zero, system = jnp.zeros(()), with_records_at(given, t, repeat(jnp.zeros(())))
        base, y = UsersBase(zero, zero, zero), (zero,) * len(given.state_names)
        friction = jnp.zeros(() if given.contacts is None else (given.contacts,))
        forces = system.normal_forces(t, y, base) if given.has_normal_forces else ()
        return system.rates(t, y, base, friction), system.relative_velocity(t, y, base), forces

    try:  # what does not depend on t stays without the axis of a batch of times
        jax.eval_shape(jax.vmap(at, (0, None), out_axes=None), jnp.zeros(2), leaves)
    except ValueError:
        return True
    return False
