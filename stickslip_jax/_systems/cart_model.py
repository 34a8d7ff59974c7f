"""How a `MotorCart` slips and sticks.

The cart slides with the velocity ``-d sin(alpha) alpha'``, for which ``r = sin(alpha) alpha'`` is used. It passes
through zero when the motor stops and at dead centre (``sin alpha = 0``), where the cart reverses; at fixed sign of r
the friction torque ``-sign mu m g d sin(alpha)`` is smooth, so both are events of one kind.

In a stick the current is known in closed form. A slip is integrated by the eighth-order Runge-Kutta method of Prince
and Dormand, all three states together. Exponential integrators that treat the fast current separately
were tried and are far less accurate at the same step: the angle by which a transient of the current turns the motor is
a linear invariant, which a Runge-Kutta method conserves exactly and an exponential one only to its order.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from .. import _diffrax as diffrax
from .._excitation.voltage import SourceVoltage
from .._numerics.elementary import sincos, sincos_of_small
from .._numerics.primal import without_derivatives
from .._numerics.runge_kutta import gross_changes, relative_error, runge_kutta_step
from .._types import BoolScalar, FloatArray, FloatScalar, Scalar, State
from .composed_friction import AtAge
from .friction import Coulomb, FrictionLaw
from .one_contact import OneContactModel
from .switched_model import FloatPair, Segments

LONGEST_TURN = 0.13  # of the motor in a step, in units of its `angle_scale`


class OnPin(FrictionLaw):
    """The friction `law` of the cart, for velocities of the pin that moves it, where sin(alpha) is `sine`.

    The cart has ``-sine`` times the velocity of the pin; friction on it acts on the motor by the lever ``|sine|``.
    """

    law: FrictionLaw
    sine: FloatArray

    def check_relations(self) -> None:
        """The law has checked itself."""

    @property
    def constant(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances only
        return self.law.constant

    @property
    def static_exceeds_kinetic(self) -> bool:
        return self.law.static_exceeds_kinetic

    @property
    def static(self) -> Scalar:
        return self.law.static

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return self.law.kinetic(jnp.abs(self.sine) * speed)

    def in_direction(self, velocity: FloatArray) -> FrictionLaw:
        return OnPin(self.law.in_direction(-velocity * self.sine), self.sine)


class CartModel(OneContactModel[FloatScalar]):
    """A `MotorCart` under a `SourceVoltage`. Its forcing is the phase of the voltage as a step begins, rad."""

    system: Any  # a MotorCart, which makes this model
    smooth: SourceVoltage

    def forcing(self, t: FloatScalar, segments: Segments) -> FloatScalar:
        return self.smooth.angular_frequency * t + self.smooth.phase

    def slip(self, forcing: FloatScalar, y: State, h: FloatScalar, sign: FloatScalar) -> State:
        # Angles are measured from where the step begins, so that sines cost a third: `step_limit` keeps them small.
        rates = Partial(type(self)._slip_rates, self, sincos(y[0]), sincos(forcing), sign)
        (angle, speed, current), _ = runge_kutta_step(rates, (0 * h, *y[1:]), h, solver=diffrax.Dopri8())
        return y[0] + angle, speed, current

    def slip_and_error(
        self, forcing: FloatScalar, y: State, h: FloatScalar, sign: FloatScalar
    ) -> tuple[State, FloatScalar | None]:
        if self.friction.constant:
            return self.slip(forcing, y, h, sign), None
        rates = Partial(type(self).rates, self, forcing, sign=sign)
        slid, error = runge_kutta_step(rates, y, h, solver=diffrax.Dopri8())
        return slid, relative_error(error, y, slid, self._gross_changes(forcing, y, h))

    def at_age(self, age: FloatArray) -> "CartModel":
        return eqx.tree_at(lambda model: model.system.friction, self, AtAge(self.friction, age))

    def stick(self, forcing: FloatScalar, y: State, h: FloatScalar) -> State:
        rho = self.system.resistance / self.system.inductance
        rest = (y[2] - self._steady(forcing, jnp.zeros_like(h))) * jnp.exp(-rho * h)
        return y[0], jnp.zeros_like(h), rest + self._steady(forcing, h)

    def rates(self, forcing: FloatScalar, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        direction, phase = sincos(y[0]), sincos(forcing + self.smooth.angular_frequency * tau)
        sticking = sign == 0
        speed, friction = jnp.where(sticking, 0, y[1]), self._slip_torque(direction[0], y[1], sign)
        turn, across = self._balances(direction, phase, speed, y[2], friction)
        return speed, jnp.where(sticking, 0, turn), across * (1 / self.system.inductance)

    def _slip_rates(
        self, start: FloatPair, phase: FloatPair, sign: FloatScalar, tau: FloatScalar, state: State
    ) -> State:
        """The rates of a slip `tau` (s) after a step began at the angle `start`, from which the `state` counts it."""
        angle, speed, current = state
        direction, phase = _turned(start, angle), _turned(phase, self.smooth.angular_frequency * tau)
        friction = self._slip_torque(direction[0], speed, sign)
        turn, across = self._balances(direction, phase, speed, current, friction)
        return speed, turn, across * (1 / self.system.inductance)

    def _slip_torque(self, sine: FloatScalar, speed: FloatScalar, sign: FloatScalar) -> FloatScalar:
        """The friction torque against the motor in a slip of this sign, N m."""
        torque = self.system.friction_torque_of_one
        if self.system.friction is not None:
            # The cart moves forward where r is negative.
            sliding = sign * self.system.eccentricity * sine * speed
            torque = self.friction.continued_coefficient(sliding, -sign) * torque
        return sign * torque * sine

    def _band(self, sine: FloatScalar) -> tuple[Scalar, FloatScalar]:
        """Centre and half width of the torques of the current that friction can hold, N m.

        What a stick needs against the centre tells which way it breaks, even where one direction has no friction.
        """
        if self.system.friction is None:
            return 0.0, self.system.largest_friction_torque * jnp.abs(sine)
        law, ways = OnPin(self.friction, sine), (jnp.full_like(sine, way) for way in (-1.0, 1.0))
        backward, forward = (law.stick_limit(way) * self.system.friction_torque_of_one * jnp.abs(sine) for way in ways)
        return (forward - backward) / 2, (forward + backward) / 2

    def _gross_changes(self, forcing: FloatScalar, y: State, h: FloatScalar) -> State:
        """The sum of the changes of each number of the state in the time `h` by each term of its rate alone."""
        model, forcing, y, h = without_derivatives((self, forcing, y, h))
        none = jnp.zeros_like(h)

        def under(coefficient: FloatScalar, *state: FloatScalar) -> State:
            return model.rates_under(forcing, none, state, coefficient)

        by_state = jax.jacfwd(under, argnums=(1, 2, 3))(none, *y)
        _, by_friction = jax.jvp(lambda c: under(c, *y), (none,), (none + model.friction.static,))
        return gross_changes(h, y, under(none, *y), by_state, by_friction)

    def _balances(
        self, direction: FloatPair, phase: FloatPair, speed: FloatScalar, current: FloatScalar, friction: FloatScalar
    ) -> FloatPair:
        """The equations of motion (eqs 1, 2): angular acceleration (rad/s^2), and voltage across the inductance (V).

        `direction`, `phase`: sine and cosine of the motor angle and of the phase of the voltage. `friction`: N m.
        """
        system, (sine, cosine) = self.system, direction
        inertia = system.cart_mass * system.eccentricity**2
        carried = speed * speed if system.equation == "physical" else speed
        driving = system.motor_constant * current - system.motor_damping * speed - friction
        torque = driving - inertia * sine * cosine * carried
        drop = system.resistance * current + system.motor_constant * speed
        across = self.smooth.mean + self.smooth.amplitude * phase[0] - drop
        return torque / (system.motor_inertia + inertia * sine * sine), across

    def step_limit(self, age: FloatScalar, step: FloatScalar, y: State, sign: FloatScalar) -> FloatScalar:
        # After a jump of the torque the current has a transient, which needs shorter steps: in a slip for the
        # integrator, in a stick so that no step holds both the extremum of the transient and others.
        transient = self.system.inductance / self.system.resistance
        turn = LONGEST_TURN * self.system.angle_scale / jnp.maximum(jnp.abs(y[1]), 1e-9)
        slip = jnp.minimum(step, jnp.minimum(turn, self.system.longest_response(self.smooth)))
        slip = slip * jnp.minimum(1, 0.1 + age / (6 * transient))
        stick = jnp.minimum(2 * np.pi / (16 * self.smooth.angular_frequency), transient / 2 + age / 3)
        return jnp.where(sign == 0, stick, slip)

    def at_rest(self, forcing: FloatScalar, y: State, times: float = 1.0) -> BoolScalar:
        return jnp.abs(y[1]) <= times * self.noise(forcing, y, jnp.ones_like(y[1]))

    def slip_sign(self, forcing: FloatScalar, y: State) -> FloatScalar:
        sine, cosine = sincos(y[0])
        # Exactly at dead centre r is 0, and its sign follows from its rate, r' = cos(alpha) alpha'^2.
        at_dead_center = jnp.abs(sine) <= jnp.finfo(y[0].dtype).eps * jnp.maximum(jnp.abs(y[0]), 1)
        return jnp.where(at_dead_center, jnp.sign(cosine), jnp.sign(sine * y[1]))

    def guard(self, forcing: FloatScalar, tau: FloatScalar, y: State, sign: FloatScalar) -> FloatPair:
        sine, cosine = sincos(y[0])
        _, turn, current_rate = self.rates(forcing, tau, y, sign)
        rate = turn * sine + y[1] * y[1] * cosine
        center, held = self._band(sine)
        per_held = jnp.where(held > 0, self.system.motor_constant / jnp.where(held > 0, held, 1), 0)
        share = (y[2] - center / self.system.motor_constant) * per_held
        share_rate = current_rate * per_held
        sticking = sign == 0
        guard = jnp.where(sticking, 1 - share * share, sign * sine * y[1])
        return guard, jnp.where(sticking, -2 * share * share_rate, sign * rate)

    def guard_scale(self, forcing: FloatScalar, y: State, sign: FloatScalar) -> FloatScalar:
        return jnp.where(sign == 0, 2.0, self.system.ideal_speed(self.smooth) + jnp.abs(y[1]))

    def on_base(self, forcing: FloatScalar, y: State) -> State:
        return y[0], jnp.zeros_like(y[1]), y[2]

    def can_stick(self, forcing: FloatScalar, y: State) -> BoolScalar:
        center, held = self._band(sincos(y[0])[0])
        return (jnp.abs(self.system.motor_constant * y[2] - center) <= held) & (held > 0)

    def release_sign(self, forcing: FloatScalar, y: State) -> FloatScalar:
        # The motor starts in the direction of the torque of its current.
        sine = sincos(y[0])[0]
        beyond = y[2] - self._band(sine)[0] / self.system.motor_constant
        return jnp.where(beyond * sine > 0, 1, -1).astype(y[0].dtype)

    @property
    def friction(self) -> FrictionLaw:
        # By default its coefficient is a share of the largest friction torque.
        return Coulomb(1.0) if self.system.friction is None else self.system.friction

    def friction_at(self, y: State) -> FrictionLaw:
        law = self.friction
        return OnPin(law, jnp.sin(y[0])) if law.depends_on_direction or not law.constant else law

    def to_inner_law(self, y: State) -> FloatPair:
        # The law is that of the cart, which moves with -sin(alpha) times the velocity of the pin.
        return -jnp.sin(y[0]), -self.heading(y)

    def rates_under(self, forcing: FloatScalar, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        direction, phase = sincos(y[0]), sincos(forcing + self.smooth.angular_frequency * tau)
        friction = coefficient * self.system.friction_torque_of_one * jnp.abs(direction[0])
        turn, across = self._balances(direction, phase, y[1], y[2], friction)
        return y[1], turn, across / self.system.inductance

    def slip_direction(self, y: State, sign: FloatScalar) -> FloatScalar:
        # Slips go by the sign of the cart's velocity, `rates_under` and `relative_velocity` by that of the motor's.
        return sign * self.heading(y)

    def heading(self, y: State) -> FloatScalar:
        """+1 on the half with sin(alpha) > 0, where the cart moves against its axis as the angle grows; else -1."""
        return jnp.where(jnp.sin(y[0]) < 0, -1.0, 1.0).astype(y[0].dtype)

    def relative_velocity(self, forcing: FloatScalar, tau: FloatScalar, y: State) -> FloatScalar:
        # Velocity of the pin that moves the cart, ``eccentricity alpha'``: zero in sticks only.
        return self.system.eccentricity * y[1]

    def relative_acceleration(self, forcing: FloatScalar, tau: FloatScalar, y: State, rates: State) -> FloatScalar:
        return self.system.eccentricity * rates[1]

    def _steady(self, forcing: FloatScalar, tau: FloatScalar) -> FloatScalar:
        """The steady current in a stick, when its transient has decayed, A."""
        system, voltage = self.system, self.smooth
        reactance = system.inductance * voltage.angular_frequency
        gain = voltage.amplitude / (system.resistance**2 + reactance**2)
        sine, cosine = sincos(forcing + voltage.angular_frequency * tau)
        return voltage.mean / system.resistance + gain * (system.resistance * sine - reactance * cosine)


def _turned(direction: FloatPair, angle: FloatScalar) -> FloatPair:
    """Sine and cosine after a rotation by a small angle."""
    sine, cosine = direction
    small_sine, small_cosine = sincos_of_small(angle)
    return sine * small_cosine + cosine * small_sine, cosine * small_cosine - sine * small_sine
