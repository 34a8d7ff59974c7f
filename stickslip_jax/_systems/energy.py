"""Friction forces and energies of the built-in systems: what is stored, supplied and dissipated."""

from functools import singledispatch
from typing import Any, NamedTuple, TypeAlias

import jax.numpy as jnp

from .._foundation import checks
from .._foundation.methods import keeps
from .._foundation.types import FloatScalar, Scalar, State
from .mass_spring import OscillatorForcing, OscillatorModel
from .memory_models import AgeingContact
from .motor_cart import CartModel, MotorCart
from .switched_model import F, OneContactModel
from .system import System

Terms: TypeAlias = dict[str, FloatScalar]
"""Energies (J) or powers (W) by name."""


class Powers(NamedTuple):
    """Powers at one instant, W: what the excitation supplies, and what is turned into heat, each by its name."""

    supplied: Terms
    dissipated: Terms


@singledispatch
def friction_force(model: OneContactModel, y: State, coefficient: FloatScalar) -> FloatScalar:
    """The friction force under this signed friction coefficient, N: on the mass, of a motor on the cart."""
    raise NotImplementedError  # not reached: `require_known` refuses what is not registered below


@singledispatch
def stored_energies(model: OneContactModel, y: State) -> Terms:
    """The energies stored in the state, J."""
    raise NotImplementedError  # not reached: `require_known` refuses what is not registered below


@singledispatch
def powers(model: OneContactModel[F], forcing: F, y: State, force: FloatScalar) -> Powers:
    """The powers in the state `y` under the friction force `force` (N); their sum is the rate of what is stored."""
    raise NotImplementedError  # not reached: `require_known` refuses what is not registered below


def require_known(system: System, model: OneContactModel, name: str) -> None:
    """Check that friction forces of `system` are known in newtons, not only as shares. Raises ValueError otherwise."""
    model = model.inner if isinstance(model, AgeingContact) else model
    if not any(keeps(model, kind, "rates", "rates_under") for kind in (OscillatorModel, CartModel)):
        raise ValueError(
            f"{name} needs a MassSpring or a MotorCart, but a simulation of {checks.show(system)} was given: the "
            "friction of a system of your own is known as a share of its largest kinetic force only."
        )


def require_energy(system: System) -> None:
    """Check that the equations of motion are those of a system with an energy. Raises ValueError otherwise."""
    if isinstance(system, MotorCart) and system.equation != "physical":
        raise ValueError(
            f'energies needs a MotorCart with equation="physical", but one with equation="{system.equation}" was '
            "given: the units of that equation do not match, so that it has no energy."
        )


def fastest_decay(model: OneContactModel) -> Scalar:
    """The rate at which the fastest motion in a slip may die out within a step, 1/s; 0 where steps are shorter."""
    model = model.inner if isinstance(model, AgeingContact) else model
    if not isinstance(model, OscillatorModel) or model.system.damping is None:
        return 0.0
    return model.system.damping / model.system.mass


@friction_force.register
def _(model: OscillatorModel, y: State, coefficient: FloatScalar) -> FloatScalar:
    return -coefficient * model.system.normal_force


@stored_energies.register
def _(model: OscillatorModel, y: State) -> Terms:
    system, (x, p) = model.system, y
    return {"kinetic": 0.5 * system.mass * p * p, "elastic": 0.5 * system.stiffness * x * x}


@powers.register
def _(model: OscillatorModel, forcing: OscillatorForcing, y: State, force: FloatScalar) -> Powers:
    # The base moves with velocity v against the force -force that the mass exerts on it (Lima and Sampaio 2015, the
    # energy analysis of section 2): it supplies force v, of which force x' reaches the mass.
    system, (_, p), none = model.system, y, jnp.zeros_like(forcing.t)
    velocity = model.base_motion(forcing, none).velocity
    damping = 0 if system.damping is None else system.damping
    supplied = {"base": force * velocity, "load": model.load_at(forcing, none) * p}
    return Powers(supplied, {"friction": force * (velocity - p), "damping": damping * p * p})


@friction_force.register
def _(model: CartModel, y: State, coefficient: FloatScalar) -> FloatScalar:
    # On the cart at ``x = d cos alpha``, whose velocity is ``-d sin alpha alpha'`` (Lima and Sampaio 2022, eq. 4).
    return coefficient * model.system.friction_torque_of_one / model.system.eccentricity * model.heading(y)


@stored_energies.register
def _(model: CartModel, y: State) -> Terms:
    system, (angle, speed, current) = model.system, y
    cart = system.eccentricity * jnp.sin(angle) * speed
    kinetic = 0.5 * (system.motor_inertia * speed * speed + system.cart_mass * cart * cart)
    return {"kinetic": kinetic, "magnetic": 0.5 * system.inductance * current * current}


@powers.register
def _(model: CartModel, forcing: FloatScalar, y: State, force: FloatScalar) -> Powers:
    system, (angle, speed, current) = model.system, y
    voltage = model.smooth.mean + model.smooth.amplitude * jnp.sin(forcing)
    friction = force * system.eccentricity * jnp.sin(angle) * speed
    heat = {"friction": friction, "damping": system.motor_damping * speed * speed}
    return Powers({"voltage": voltage * current}, heat | {"resistance": system.resistance * current * current})


@friction_force.register
def _(model: AgeingContact, y: State, coefficient: FloatScalar) -> FloatScalar:
    return friction_force(model.inner, y[:-1], coefficient)


@stored_energies.register
def _(model: AgeingContact, y: State) -> Terms:
    return stored_energies(model.inner, y[:-1])


@powers.register
def _(model: AgeingContact, forcing: Any, y: State, force: FloatScalar) -> Powers:
    return powers(model.inner, forcing, y[:-1], force)
