"""The time scales of a system and of what drives it, and the step that they call for."""

import math
from typing import Any

import jax.numpy as jnp

from .. import _checks
from .._types import Scalar
from ..base_motion.drive import Drive
from ..base_motion.random import RandomPhase
from ..base_motion.smooth import Signal
from ..systems.mass_spring import MassSpring
from ..systems.motor_cart import MotorCart
from ..systems.switched_system import SwitchedSystem
from .oscillator_model import has_closed_form

# Steps for each shortest time: by default, and at least. What is smooth has at most two extrema in a sixth of its
# period; a Runge-Kutta step wants more; the cart's mechanical time constant is no period.
_PERIOD, _SOLVED, _CONSTANT = (16.0, 6.0), (48.0, 12.0), (7.0, 4.0)
_FRICTION = (6.0, 1.0)
_DECAY = (1 / 3, 1 / 4)  # steps beyond four electrical time constants are not stable
_OWN = "shortest time of the system"


def step_for(system: Any, drive: Drive, method: Any) -> Scalar:
    """The time step (s) of `method`, checked, or the default one.

    Raises ValueError if it is too long for the shortest time scale, or if one is needed because a time scale is not
    known.
    """
    scales = _scales(system, drive, method)
    known = {name: (time, parts) for name, (time, parts) in scales.items() if time is not None}
    unknown = [name for name in scales if name not in known]
    if method.step is None and unknown:
        raise ValueError(
            f"Argument method must give the step, Exact(step=...), but the {unknown[0]} is not known; or give what "
            f"you wrote a property {'shortest_time' if unknown[0] == _OWN else 'shortest_period'} (s)."
        )
    if method.step is None:
        steps = [time / parts[0] for time, parts in known.values()]
        if any(_checks.is_traced(step) for step in steps):
            return jnp.min(jnp.stack([jnp.asarray(step, float) for step in steps]))
        return min(float(step) for step in steps)
    if not _checks.is_traced(method.step):
        for name, (time, parts) in known.items():
            if not _checks.is_traced(time) and method.step > time / parts[1] * (1 + 1e-9):
                longest, share = float(time) / parts[1], 1 / parts[1]
                raise ValueError(
                    f"Argument step must be at most {longest:.4g} s, {share:.2g} times the {name} of {float(time):.4g} "
                    f"s, but {method.step} was given; between longer steps sticks could be missed."
                )
    return method.step


def _scales(system: Any, drive: Drive, method: Any) -> dict[str, tuple[Any, tuple[float, float]]]:
    """Each time scale (s) by name, with the number of steps in it by default and at least."""
    if isinstance(system, MotorCart):
        return {
            "mechanical time constant": (system.shortest_time, _CONSTANT),
            "electrical time constant": (system.inductance / system.resistance, _DECAY),
            "period of the voltage": (_period(drive.smooth), _SOLVED),
        }
    if isinstance(system, SwitchedSystem):
        return {
            _OWN: (system.shortest_time, _SOLVED),
            "shortest period of the base motion": (_period(drive.smooth), _SOLVED),
        }
    parts = _PERIOD if has_closed_form(system) and method.solver is None else _SOLVED
    natural = 2 * math.pi * (system.mass / system.stiffness) ** 0.5
    force = system.force
    return {
        "natural period": (natural, parts),
        "time in which the slip speed passes the scale of the friction law": (_passing_time(system), _FRICTION),
        "shortest period of the force": (force.shortest_period if isinstance(force, Signal) else math.inf, parts),
        "shortest period of the base motion": (_period(drive.smooth), parts),
    }


def _passing_time(system: MassSpring) -> Any:
    """How long the largest friction takes to change the speed by the scale over which the friction law changes, s."""
    scale, held = system.friction.speed_scale, system.friction.static * system.normal_force
    if scale is None or (not _checks.is_traced(held) and held == 0):
        return math.inf
    return scale * system.mass / held


def _period(smooth: Signal | RandomPhase | None) -> Any:
    if isinstance(smooth, RandomPhase):
        smooth = smooth.signal
    return math.inf if smooth is None else smooth.shortest_period
