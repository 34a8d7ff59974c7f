"""Normal forces of contacts: numbers, or functions of time."""

import dataclasses
from typing import Any, TypeAlias

import jax.numpy as jnp

from .._excitation.force_steps import ForceSteps
from .._excitation.recorded import Recorded
from .._excitation.smooth import Signal
from .._fields import Quantity
from .._types import FloatArray, FloatScalar, Number, Scalar

NormalForce: TypeAlias = Number | Signal | Recorded | ForceSteps
"""N: a number, or a function of time."""
_FUNCTIONS = Signal, Recorded, ForceSteps


@dataclasses.dataclass(frozen=True, repr=False)
class NormalForceQuantity(Quantity):
    """A number, or a function of time."""

    def is_function(self, value: object) -> bool:
        return isinstance(value, _FUNCTIONS)


def is_function(normal_force: NormalForce) -> bool:
    """Whether it varies in time."""
    return isinstance(normal_force, _FUNCTIONS)


def recorded_in(normal_forces: tuple[NormalForce, ...]) -> tuple[Recorded | ForceSteps, ...]:
    """Those that are piecewise linear in time."""
    return tuple(one for one in normal_forces if isinstance(one, (Recorded, ForceSteps)))


def values_at(forces: tuple[NormalForce | None, ...], t: FloatScalar, recorded: FloatArray) -> FloatArray:
    """Forces (forces,) at the time `t` (s), N, of which None is zero.

    `recorded`: the values there of those that are `recorded_in` them.
    """
    values, number = [], 0
    for one in forces:
        if isinstance(one, Signal):
            values.append(one.value(t))
        elif isinstance(one, (Recorded, ForceSteps)):
            values.append(recorded[number])
            number += 1
        else:
            values.append(jnp.asarray(0.0 if one is None else one, t.dtype))
    return jnp.stack([jnp.asarray(value, t.dtype) for value in values])


def size_of(normal_force: NormalForce, value: FloatScalar) -> FloatScalar:
    """The size of the terms that add up to its `value`: the scale of its round-off where it passes zero."""
    if isinstance(normal_force, (Recorded, ForceSteps)):
        return jnp.max(jnp.abs(jnp.asarray(normal_force.values, value.dtype)))
    if isinstance(normal_force, Signal) and normal_force.is_harmonic:
        tones: Any = normal_force
        amplitudes = jnp.atleast_1d(jnp.asarray(tones.tones[0], value.dtype))
        return jnp.sum(jnp.abs(amplitudes)) + jnp.abs(jnp.asarray(tones.mean, value.dtype))
    return jnp.abs(value)


def largest_of(normal_force: NormalForce) -> Scalar | None:
    """The largest size that it has at any time, N, or an upper bound of it; None where that is not known."""
    if isinstance(normal_force, Signal) and not normal_force.is_harmonic:
        return None
    number = jnp.zeros(()) if is_function(normal_force) else jnp.asarray(normal_force, float)
    return size_of(normal_force, number)


def periods_of(normal_forces: tuple[NormalForce, ...]) -> dict[str, Scalar | None]:
    """The shortest period (s) of each that is a smooth function of time, by what it is called."""
    return {
        f"shortest period of normal force {number}": one.shortest_period
        for number, one in enumerate(normal_forces)
        if isinstance(one, Signal)
    }
