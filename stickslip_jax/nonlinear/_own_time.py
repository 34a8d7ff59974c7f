"""Whether the equations of a user's system change with time by themselves, apart from the motions that drive them."""

import jax
import numpy as np

from .. import _checks
from .._dynamics.common.time_scales import slowest_time
from .._excitation.excitation import BaseMotion, motion_of
from .._systems.system import System
from .._types import InitialState, Scalar
from ._period import common_period, repetitions

_PARTS = np.array([0.0, 0.013, 0.171, 0.31, 0.4737, 0.618, 0.757, 0.893])  # of a period, or many: no simple ratios
_FAR = np.array([1.0, 7.31, 93.7])


def changes_by_itself(system: System, base: BaseMotion, y0: InitialState, given: Scalar | None) -> bool:
    """Whether rates, relative velocities or normal forces of a user's system change with time otherwise than its base
    and the motions in its fields do: looked at near `y0` at a few instants.

    Raises ValueError where they do, and do not begin anew after the period (s) `given`.
    """
    numbers = jax.tree.leaves((system, base, y0, given))
    if any(map(_checks.is_traced, numbers)):
        return False
    found = repetitions(system, motion_of(base))
    if any(period is None for _, period in found):
        return False  # a period is asked for because of these
    common = common_period(found)
    if common is None:
        times = slowest_time(system, base) * np.outer(_FAR, _PARTS).ravel()
        changes = system.differs_between(y0, times, np.zeros_like(times))
    else:
        changes = system.differs_between(y0, float(common) * _PARTS, float(common) * (1 + _PARTS))
    if changes and given is not None and system.differs_between(y0, float(given) * _PARTS, float(given) * (1 + _PARTS)):
        raise ValueError(
            f"Argument period must be a time after which the rates of {type(system).__name__} begin anew, but they "
            f"differ from those {_checks.show(given)} s later."
        )
    return changes
