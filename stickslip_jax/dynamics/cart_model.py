"""The motor and cart as a switched model (Lima and Sampaio 2022, eqs 1, 2, 5).

State: angle ``alpha`` (rad), ``alpha'`` (rad/s), current ``c`` (A). What rubs is the cart; its velocity is
``-d sin(alpha) alpha'``, and ``r = sin(alpha) alpha'`` stands for it. It passes through zero when the motor stops and
at dead centre (``sin alpha = 0``), where the cart turns round; at fixed sign of r the friction torque
``-sign mu m g d sin(alpha)`` is smooth, so both are events of one kind.

In a stick the current is known in closed form. A slip is integrated by the eighth-order Runge-Kutta method of Prince
and Dormand, all three states together. Exponential integrators that treat the fast current apart were tried and are far
less accurate at the same step: the transient of the current turns the motor by an amount that a Runge-Kutta method
keeps exactly (it is a linear invariant), and an exponential one only to its order.
"""

from typing import NamedTuple

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._types import BoolArray, FloatArray
from ..base_motion.voltage import SourceVoltage
from ..numerics.elementary import sincos_of_small
from ..numerics.runge_kutta import runge_kutta_step
from ..numerics.sharing import sincos
from ..systems.motor_cart import MotorCart
from .switched_model import NOISE_ULPS, Pieces, State, SwitchedModel

_SOLVER = diffrax.Dopri8()
_LONGEST_TURN = 0.4  # of the motor in a step, rad


class CartInputs(NamedTuple):
    """The phase of the voltage at the time the step begins, rad."""

    phase: FloatArray


class CartModel(SwitchedModel):
    """A `MotorCart` under a `SourceVoltage`."""

    system: MotorCart
    smooth: SourceVoltage

    def inputs(self, t: FloatArray, pieces: Pieces) -> CartInputs:
        return CartInputs(self.smooth.angular_frequency * t + self.smooth.phase)

    def slip(self, inputs: CartInputs, y: State, h: FloatArray, sign: FloatArray) -> State:
        # Angles are measured from where the step begins, so that sines cost a third: `step_limit` keeps them small.
        field = _Slip(self, sincos(y[0]), sincos(inputs.phase), sign)
        (angle, speed, current), _ = runge_kutta_step(field, (0 * h, *y[1:]), h, solver=_SOLVER)
        return y[0] + angle, speed, current

    def stick(self, inputs: CartInputs, y: State, h: FloatArray) -> State:
        rho = self.system.resistance / self.system.inductance
        rest = (y[2] - self._steady(inputs, jnp.zeros_like(h))) * jnp.exp(-rho * h)
        return y[0], jnp.zeros_like(h), rest + self._steady(inputs, h)

    def rates(self, inputs: CartInputs, tau: FloatArray, y: State, sign: FloatArray) -> State:
        system = self.system
        sticking = sign == 0
        speed = jnp.where(sticking, 0, y[1])
        sine, _ = sincos(inputs.phase + self.smooth.angular_frequency * tau)
        voltage = self.smooth.mean + self.smooth.amplitude * sine
        current_rate = (voltage - system.resistance * y[2] - system.motor_constant * speed) * (1 / system.inductance)
        return speed, jnp.where(sticking, 0, self._torque(sign)(sincos(y[0]), *y[1:])), current_rate

    def step_limit(self, age: FloatArray, step: FloatArray, y: State, sign: FloatArray) -> FloatArray:
        # A jump of the torque sends the current through a transient, which calls for shorter steps while it lasts: in a
        # slip for the integrator, in a stick so that no step holds both the transient's extremum and others.
        transient = self.system.inductance / self.system.resistance
        slip = jnp.minimum(step, _LONGEST_TURN / jnp.maximum(jnp.abs(y[1]), 1e-9))
        slip = slip * jnp.minimum(1, 0.1 + age / (6 * transient))
        stick = jnp.minimum(2 * np.pi / (16 * self.smooth.angular_frequency), transient / 2 + age / 3)
        return jnp.where(sign == 0, stick, slip)

    def at_rest(self, inputs: CartInputs, y: State) -> BoolArray:
        noise = NOISE_ULPS * jnp.finfo(y[1].dtype).eps * self.guard_scale(inputs, y, jnp.ones_like(y[1]))
        return jnp.abs(y[1]) <= noise

    def slip_sign(self, inputs: CartInputs, y: State) -> FloatArray:
        sine, cosine = sincos(y[0])
        # Exactly at dead centre, what comes next: r' = cos(alpha) alpha'^2.
        at_dead_centre = jnp.abs(sine) <= jnp.finfo(y[0].dtype).eps * jnp.maximum(jnp.abs(y[0]), 1)
        return jnp.where(at_dead_centre, jnp.sign(cosine), jnp.sign(sine * y[1]))

    def guard(self, inputs: CartInputs, tau: FloatArray, y: State, sign: FloatArray) -> tuple[FloatArray, FloatArray]:
        sine, cosine = sincos(y[0])
        _, turn, current_rate = self.rates(inputs, tau, y, sign)
        rate = turn * sine + y[1] * y[1] * cosine
        held = self.system.largest_friction_torque * jnp.abs(sine)
        per_held = jnp.where(held > 0, self.system.motor_constant / jnp.where(held > 0, held, 1), 0)
        share, share_rate = y[2] * per_held, current_rate * per_held
        sticking = sign == 0
        guard = jnp.where(sticking, 1 - share * share, sign * sine * y[1])
        return guard, jnp.where(sticking, -2 * share * share_rate, sign * rate)

    def guard_scale(self, inputs: CartInputs, y: State, sign: FloatArray) -> FloatArray:
        ideal = (jnp.abs(self.smooth.mean) + jnp.abs(self.smooth.amplitude)) / self.system.motor_constant
        return jnp.where(sign == 0, 2.0, ideal + jnp.abs(y[1]))

    def on_base(self, inputs: CartInputs, y: State) -> State:
        return y[0], jnp.zeros_like(y[1]), y[2]

    def can_stick(self, inputs: CartInputs, y: State) -> BoolArray:
        held = self.system.largest_friction_torque * jnp.abs(sincos(y[0])[0])
        return (jnp.abs(self.system.motor_constant * y[2]) <= held) & (held > 0)

    def release_sign(self, inputs: CartInputs, y: State) -> FloatArray:
        # The motor turns the way its current drives it.
        return jnp.where(y[2] * sincos(y[0])[0] > 0, 1, -1).astype(y[0].dtype)

    def _torque(self, sign: FloatArray):
        """``alpha''`` as a function of sine and cosine of the angle, angular velocity and current."""
        system = self.system
        inertia = system.cart_mass * system.eccentricity**2
        rub = sign * system.largest_friction_torque

        def turn(direction: tuple[FloatArray, FloatArray], speed: FloatArray, current: FloatArray) -> FloatArray:
            sine, cosine = direction
            carried = speed * speed if system.equation == "physical" else speed
            driving = system.motor_constant * current - system.motor_damping * speed - rub * sine
            return (driving - inertia * sine * cosine * carried) / (system.motor_inertia + inertia * sine * sine)

        return turn

    def _steady(self, inputs: CartInputs, tau: FloatArray) -> FloatArray:
        """The current after a long stick: the steady answer to the voltage, A."""
        system, voltage = self.system, self.smooth
        reactance = system.inductance * voltage.angular_frequency
        gain = voltage.amplitude / (system.resistance**2 + reactance**2)
        sine, cosine = sincos(inputs.phase + voltage.angular_frequency * tau)
        return voltage.mean / system.resistance + gain * (system.resistance * sine - reactance * cosine)


class _Slip(eqx.Module):
    """The rates of a slip: a function of the time since the step began and of the state, its angle from there."""

    model: CartModel
    start: tuple[FloatArray, FloatArray]
    phase: tuple[FloatArray, FloatArray]
    sign: FloatArray

    def __call__(self, tau: FloatArray, state: State) -> State:
        angle, speed, current = state
        system, voltage = self.model.system, self.model.smooth
        sine, _ = _turned(self.phase, voltage.angular_frequency * tau)
        drop = system.resistance * current + system.motor_constant * speed
        current_rate = (voltage.mean + voltage.amplitude * sine - drop) * (1 / system.inductance)
        return speed, self.model._torque(self.sign)(_turned(self.start, angle), speed, current), current_rate


def _turned(direction: tuple[FloatArray, FloatArray], angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sine and cosine after a turn by a small angle."""
    sine, cosine = direction
    small_sine, small_cosine = sincos_of_small(angle)
    return sine * small_cosine + cosine * small_sine, cosine * small_cosine - sine * small_sine
