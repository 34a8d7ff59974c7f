"""The time scales of a system and of what drives it, and the step that they call for."""

import math
from contextlib import suppress
from typing import Any

import jax.numpy as jnp

from .. import _checks
from .._types import Scalar
from ..base_motion.drive import Drive
from ..base_motion.random import RandomPhase
from ..base_motion.smooth import Signal
from ..numerics.known import NotKnown, plain, smallest
from ..systems.mass_spring import MassSpring
from ..systems.motor_cart import MotorCart
from ..systems.switched_system import SwitchedSystem
from .blocks import few_sizes
from .oscillator_model import has_closed_form

# Steps for each shortest time: by default, and at least. What is smooth has at most two extrema in a sixth of its
# period, but the sum of two such motions may have more: six steps missed a stick in 21 of 270,000 random trajectories
# of 60 s, eight in 4 of 279,000, ten in none of 288,000. A Runge-Kutta step wants more; the cart's mechanical time
# constant is no period.
_PERIOD, _SOLVED, _CONSTANT = (16.0, 10.0), (48.0, 12.0), (7.0, 4.0)
_FRICTION = (6.0, 1.0)
_DECAY = (1 / 3, 1 / 4)  # steps beyond four electrical time constants are not stable
_OWN = "shortest time of the system"


def step_for(system: Any, drive: Drive, method: Any) -> Scalar:
    """The time step (s) of `method`, checked, or the default one.

    Raises ValueError if it is too long for the shortest time scale, or if one is needed because a time scale is not
    known.
    """
    scales = {name: (plain(time), parts) for name, (time, parts) in _scales(system, drive, method).items()}
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
    step = plain(method.step)
    if not _checks.is_traced(step):
        for name, (time, parts) in known.items():
            if not _checks.is_traced(time) and step > time / parts[1] * (1 + 1e-9):
                longest, share = float(time) / parts[1], 1 / parts[1]
                raise ValueError(
                    f"Argument step must be at most {longest:.4g} s, {share:.2g} times the {name} of {float(time):.4g} "
                    f"s, but {step} was given; between longer steps sticks could be missed."
                )
    return step


def room_to_give(system: Any, drive: Drive, method: Any, t1: Scalar) -> str:
    """A number of steps to give where JAX traces what it depends on, from what is known of time and time scales."""
    horizon = min(_known([t1]), default=100.0)
    steps = [method.step] if method.step is not None else [
        time / parts[0] for time, parts in _scales(system, drive, method).values() if time is not None
    ]  # fmt: skip
    found = _known(steps)
    step = min((step for step in found if step < math.inf), default=0.01) / (1 if len(found) == len(steps) else 4)
    turns = few_sizes(math.ceil(1.5 * horizon / step) + 96)
    return f"max_steps={turns} is room for {horizon:g} s in steps of {step:.3g} s; too many cost nothing but memory"


def _known(numbers: list[Any]) -> list[float]:
    """The smallest value of each number that has one yet."""
    found = []
    for number in numbers:
        with suppress(NotKnown):
            found.append(smallest(number))
    return found


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
    if scale is None or _is(scale, math.inf) or _is(held, 0):
        return math.inf
    return scale * system.mass / held


def _is(number: Any, value: Any) -> bool:
    return not _checks.is_traced(number) and bool(number == value)


def _period(smooth: Signal | RandomPhase | None) -> Any:
    if isinstance(smooth, RandomPhase):
        smooth = smooth.signal
    return math.inf if smooth is None else smooth.shortest_period
