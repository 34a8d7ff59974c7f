"""Normal forces of contacts: numbers, or functions of time."""

import dataclasses
import math
from typing import Any, TypeAlias, cast

import jax.numpy as jnp

from .._excitation.force_steps import ForceSteps
from .._excitation.recorded import Recorded
from .._excitation.smooth import Harmonic, Signal, SumOfHarmonics
from .._fields import Quantity
from .._types import FloatArray, FloatScalar, Number, Scalar

NormalForce: TypeAlias = Number | Signal | Recorded | ForceSteps
"""N: a number, or a function of time."""
_PIECES = Recorded, ForceSteps
_FUNCTIONS = Signal, *_PIECES


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
    return tuple(one for one in normal_forces if isinstance(one, _PIECES))


def values_at(forces: tuple[NormalForce | None, ...], t: FloatScalar, recorded: FloatArray) -> FloatArray:
    """Forces (forces,) at the time `t` (s), N, of which None is zero.

    `recorded`: the values there of those that are `recorded_in` them.
    """
    values, number = [], 0
    for one in forces:
        if isinstance(one, Signal):
            values.append(one.value(t))
        elif isinstance(one, _PIECES):
            values.append(recorded[number])
            number += 1
        else:
            values.append(jnp.asarray(0.0 if one is None else one, t.dtype))
    return jnp.stack([jnp.asarray(value, t.dtype) for value in values])


def rates_at(forces: tuple[NormalForce | None, ...], t: FloatScalar, slopes: FloatArray) -> FloatArray:
    """The time derivatives (forces,) of `forces` at the time `t`; `slopes`: of those that are `recorded_in` them."""
    pieces = iter(range(len(forces)))
    rates = [
        one.rate(t) if isinstance(one, Signal) else slopes[next(pieces)] if isinstance(one, _PIECES) else 0.0
        for one in forces
    ]
    return jnp.stack([jnp.asarray(rate, t.dtype) for rate in rates])


def power_series_of(
    forces: tuple[NormalForce | None, ...], t: FloatScalar, recorded: FloatArray, slopes: FloatArray, terms: int
) -> list[FloatArray | None]:
    """The coefficients (forces,) of the power series of `forces` in the time since `t`; None where all are zero.

    Signals must be harmonic. `recorded`, `slopes`: of those that are `recorded_in` them, at `t`.
    """
    signals = {i: cast(Harmonic | SumOfHarmonics, one) for i, one in enumerate(forces) if isinstance(one, Signal)}
    harmonic = {i: one.power_series(t, terms) for i, one in signals.items()}
    pieces = {i: number for number, i in enumerate(i for i, one in enumerate(forces) if isinstance(one, _PIECES))}

    def coefficient(i: int, k: int) -> FloatScalar:
        if i in harmonic:
            return harmonic[i][k]
        return slopes[pieces[i]] if k == 1 and i in pieces else jnp.zeros_like(t)

    if not forces:
        return [None] * terms
    first: list[FloatArray | None] = [values_at(forces, t, recorded)]
    for k in range(1, terms):
        some = harmonic or (k == 1 and pieces)
        first.append(jnp.stack([coefficient(i, k) for i in range(len(forces))]) if some else None)
    return first


def size_of(normal_force: NormalForce, t: FloatScalar) -> FloatScalar:
    """The size of the terms that add up to its value at the time `t` (s): the scale of its round-off at zero."""
    largest = largest_of(normal_force)
    if largest is not None:
        return jnp.asarray(largest, t.dtype)
    signal = cast(Signal, normal_force)
    radian = 0.0 if signal.shortest_period is None else jnp.minimum(signal.shortest_period / (2 * math.pi), jnp.abs(t))
    # What oscillates is as large as its curvature says where it is zero.
    return jnp.abs(signal.value(t)) + jnp.abs(signal.curvature(t)) * radian**2


def largest_of(normal_force: NormalForce) -> Scalar | None:
    """The largest size that it has at any time, N, or an upper bound of it; None where that is not known."""
    if isinstance(normal_force, _PIECES):
        return jnp.max(jnp.abs(jnp.asarray(normal_force.values, float)))
    if not isinstance(normal_force, Signal):
        return jnp.abs(jnp.asarray(normal_force, float))
    if not normal_force.is_harmonic:
        return None
    tones: Any = normal_force
    return jnp.sum(jnp.abs(jnp.atleast_1d(jnp.asarray(tones.tones[0], float)))) + jnp.abs(
        jnp.asarray(tones.mean, float)
    )


def periods_of(normal_forces: tuple[NormalForce, ...]) -> dict[str, Scalar | None]:
    """The shortest period (s) of each that is a smooth function of time, by what it is called."""
    return {
        f"shortest period of normal force {number}": one.shortest_period
        for number, one in enumerate(normal_forces)
        if isinstance(one, Signal)
    }
