"""What drives a system besides its base: the voltage of a motor, the acceleration of the ground, a force."""

from collections.abc import Callable
from typing import Any, NamedTuple

from .._excitation.ground import GroundMotion
from .._excitation.voltage import SourceVoltage
from .._simulation.result import Simulation


class Drive(NamedTuple):
    """An excitation to draw: `label` of its axis, and its value at times (s)."""

    label: str
    value: Callable[[Any], Any]


def drive_of(one: Simulation) -> Drive | None:
    """What drives the system of a simulation besides the velocity of its base; None if nothing does."""
    if isinstance(one.base, SourceVoltage):
        return Drive("voltage (V)", one.base.value)
    acceleration = getattr(one.base, "acceleration", None)
    if isinstance(one.base, GroundMotion) and acceleration is not None:
        return Drive("ground\nacceleration (m/s$^2$)", acceleration)
    value = getattr(getattr(one.system, "force", None), "value", None)
    return None if value is None else Drive("force (N)", value)
