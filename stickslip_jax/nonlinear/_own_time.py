"""Whether the equations of a user's system change with time by themselves, apart from the motions that drive them."""

import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._excitation.excitation import BaseMotion, motion_of
from .._systems.switched_system import SwitchedSystem
from .._systems.system import System
from .._systems.users_forcing import UsersBase
from .._types import InitialState, Scalar
from ._cycle import slowest_time
from ._period import common_period, repetitions

_PARTS = np.array([0.0, 0.013, 0.171, 0.31, 0.4737, 0.618, 0.757, 0.893])  # of a period, or many: no simple ratios
_FAR = np.array([1.0, 7.31, 93.7])


def changes_by_itself(system: System, base: BaseMotion, y0: InitialState, given: Scalar | None) -> bool:
    """Whether rates, relative velocities or normal forces of a user's system change with time otherwise than its base
    and the motions in its fields do: looked at near `y0` at a few instants.

    Raises ValueError where they do, and do not begin anew after the period (s) `given`.
    """
    numbers = jax.tree.leaves((system, base, y0, given))
    if not isinstance(system, SwitchedSystem) or any(map(_checks.is_traced, numbers)):
        return False
    found = repetitions(system, motion_of(base))
    if any(period is None for _, period in found):
        return False  # a period is asked for because of these
    common = common_period(found)
    if common is None:
        times = slowest_time(system, base) * np.outer(_FAR, _PARTS).ravel()
        changes = not _are_equal(system, y0, times, np.zeros_like(times))
    else:
        changes = not _are_equal(system, y0, float(common) * _PARTS, float(common) * (1 + _PARTS))
    if changes and given is not None and not _are_equal(system, y0, float(given) * _PARTS, float(given) * (1 + _PARTS)):
        raise ValueError(
            f"Argument period must be a time after which the rates of {type(system).__name__} begin anew, but they "
            f"differ from those {_checks.show(given)} s later."
        )
    return changes


def _are_equal(system: SwitchedSystem, y0: InitialState, times: np.ndarray, others: np.ndarray) -> bool:
    """Whether what the system's methods return is the same at `times` and at `others` (s)."""
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
    return bool(np.all(np.abs(first - second) <= np.sqrt(np.finfo(first.dtype).eps) * scale))
