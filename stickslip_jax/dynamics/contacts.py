"""What regularised dynamics needs to know of a system: its rates under any friction, and its relative velocity."""

import abc
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from .._types import FloatArray
from ..base_motion.smooth import Signal
from ..base_motion.voltage import SourceVoltage
from ..numerics.sharing import sincos
from ..systems.friction import Coulomb, FrictionLaw
from ..systems.motor_cart import MotorCart
from ..systems.switched_system import Base, SwitchedSystem
from .cart_model import CartInputs, CartModel
from .general_model import GeneralInputs, GeneralModel
from .oscillator_model import OscillatorInputs, OscillatorModel
from .switched_model import Pieces, State


class Contact(eqx.Module):
    """A system and its drive. `inputs` are what `inputs(t, pieces)` returned; `tau` is the time since that t."""

    @property
    @abc.abstractmethod
    def friction(self) -> FrictionLaw:
        """The friction law of the contact."""

    @abc.abstractmethod
    def inputs(self, t: FloatArray, pieces: Pieces) -> Any:
        """What the drive does from time t on, until a piece ends."""

    @abc.abstractmethod
    def rates(self, inputs: Any, tau: FloatArray, y: State, grip: FloatArray) -> State:
        """The time derivative of the state under the signed friction coefficient `grip`; affine in it."""

    @abc.abstractmethod
    def speed(self, inputs: Any, tau: FloatArray, y: State) -> FloatArray:
        """The relative velocity, m/s."""

    @abc.abstractmethod
    def speed_rate(self, inputs: Any, tau: FloatArray, y: State, rates: State) -> FloatArray:
        """Its time derivative, where the state changes with `rates`."""


class OscillatorContact(Contact):
    """A `MassSpring`; state: x (m), x' (m/s)."""

    model: OscillatorModel

    @property
    def friction(self) -> FrictionLaw:
        return self.model.system.friction

    def inputs(self, t: FloatArray, pieces: Pieces) -> OscillatorInputs:
        return self.model.inputs(t, pieces)

    def rates(self, inputs: OscillatorInputs, tau: FloatArray, y: State, grip: FloatArray) -> State:
        system = self.model.system
        drag = 0 if system.damping is None else system.damping * y[1]
        force = self.model.load_at(inputs, tau) - drag - system.stiffness * y[0] - grip * system.normal_force
        return y[1], force / system.mass

    def speed(self, inputs: OscillatorInputs, tau: FloatArray, y: State) -> FloatArray:
        return y[1] - self.model.base_motion(inputs, tau)[0]

    def speed_rate(self, inputs: OscillatorInputs, tau: FloatArray, y: State, rates: State) -> FloatArray:
        return rates[1] - self.model.base_motion(inputs, tau)[1]


class CartContact(Contact):
    """A `MotorCart`; its velocity is that of the pin that drives it, ``eccentricity alpha'``: zero in sticks only.

    State: alpha (rad), alpha' (rad/s), current (A).
    """

    model: CartModel

    @property
    def friction(self) -> FrictionLaw:
        return Coulomb(self.model.system.mu)

    def inputs(self, t: FloatArray, pieces: Pieces) -> CartInputs:
        return self.model.inputs(t, pieces)

    def rates(self, inputs: CartInputs, tau: FloatArray, y: State, grip: FloatArray) -> State:
        system, voltage = self.model.system, self.model.smooth
        angle, speed, current = y
        sine, cosine = sincos(angle)
        inertia = system.cart_mass * system.eccentricity**2
        carried = speed * speed if system.equation == "physical" else speed
        rub = grip * system.cart_mass * system.gravity * system.eccentricity * jnp.abs(sine)
        torque = (
            system.motor_constant * current - system.motor_damping * speed - rub - inertia * sine * cosine * carried
        )
        phase, _ = sincos(inputs.phase + voltage.angular_frequency * tau)
        drop = system.resistance * current + system.motor_constant * speed
        rise = (voltage.mean + voltage.amplitude * phase - drop) / system.inductance
        return speed, torque / (system.motor_inertia + inertia * sine * sine), rise

    def speed(self, inputs: CartInputs, tau: FloatArray, y: State) -> FloatArray:
        return self.model.system.eccentricity * y[1]

    def speed_rate(self, inputs: CartInputs, tau: FloatArray, y: State, rates: State) -> FloatArray:
        return self.model.system.eccentricity * rates[1]


class GeneralContact(Contact):
    """A `SwitchedSystem`; its friction coefficient is the share of its own kinetic force."""

    model: GeneralModel

    @property
    def friction(self) -> FrictionLaw:
        system = self.model.system
        holds_more = type(system).static_ratio is not SwitchedSystem.static_ratio
        return Coulomb(1.0, system.static_ratio if holds_more else None)

    def inputs(self, t: FloatArray, pieces: Pieces) -> GeneralInputs:
        return self.model.inputs(t, pieces)

    def rates(self, inputs: GeneralInputs, tau: FloatArray, y: State, grip: FloatArray) -> State:
        t, base, _ = self.model.base_at(inputs, tau)
        return tuple(jnp.asarray(rate, t.dtype) for rate in self.model.system.rates(t, y, base, grip))

    def speed(self, inputs: GeneralInputs, tau: FloatArray, y: State) -> FloatArray:
        t, base, _ = self.model.base_at(inputs, tau)
        return jnp.asarray(self.model.system.relative_velocity(t, y, base), t.dtype)

    def speed_rate(self, inputs: GeneralInputs, tau: FloatArray, y: State, rates: State) -> FloatArray:
        t, base, jerk = self.model.base_at(inputs, tau)

        def speed(t, y, base):
            return jnp.asarray(self.model.system.relative_velocity(t, y, base), t.dtype)

        return jax.jvp(speed, (t, y, base), (jnp.ones_like(t), rates, Base(base.acceleration, jerk)))[1]


def contact_of(system: Any, smooth: Signal | None) -> Contact:
    """The contact of `system` under a realised smooth drive."""
    if isinstance(system, MotorCart):
        assert isinstance(smooth, SourceVoltage)
        return CartContact(CartModel(system, smooth))
    if isinstance(system, SwitchedSystem):
        return GeneralContact(GeneralModel(system, smooth, diffrax.Dopri8()))
    return OscillatorContact(OscillatorModel(system, smooth))
