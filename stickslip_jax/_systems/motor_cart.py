"""A cart on a rail with dry friction, driven by a DC motor through a scotch yoke (Lima and Sampaio 2022, eqs 1, 2, 5).

State: angle ``alpha`` (rad), ``alpha'`` (rad/s), current ``c`` (A). The cart slides with the
velocity ``-d sin(alpha) alpha'``, for which ``r = sin(alpha) alpha'`` is used. It passes through zero when the motor
stops and at dead centre (``sin alpha = 0``), where the cart reverses; at fixed sign of r the friction torque
``-sign mu m g d sin(alpha)`` is smooth, so both are events of one kind.

In a stick the current is known in closed form. A slip is integrated by the eighth-order Runge-Kutta method of Prince
and Dormand, all three states together. Exponential integrators that treat the fast current separately
were tried and are far less accurate at the same step: the angle by which a transient of the current turns the motor is
a linear invariant, which a Runge-Kutta method conserves exactly and an exponential one only to its order.
"""

import math
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from .. import _checks
from .. import _diffrax as diffrax
from .._claims import keeps
from .._excitation.excitation import Excitation
from .._excitation.smooth import Signal
from .._excitation.voltage import SourceVoltage
from .._fields import Choice, Quantity
from .._numerics.elementary import sincos, sincos_of_small
from .._numerics.runge_kutta import runge_kutta_step
from .._types import (
    AnyArray,
    Array,
    BoolScalar,
    ExplicitSolver,
    FloatArray,
    FloatScalar,
    Number,
    Scalar,
    Solver,
    State,
)
from .friction import Coulomb, FrictionLaw
from .layouts import motor_and_cart
from .mechanism import Mechanism
from .one_contact import OneContactModel
from .switched_model import FloatPair, Segments
from .system import SOLVED, Coordinate, StepCount, System, TimeScale, shortest_period, voltage_of

_LONGEST_TURN = 0.13  # of the motor in a step, in units of its `angle_scale`
_LONGEST_RESPONSE = 0.85  # of the current in a step; with the values of the paper four electrical time constants
_CONSTANT = StepCount(7.0, 4.0)  # the mechanical time constant is no period
_DECAY = StepCount(1 / 3, 1 / 4)  # steps beyond four electrical time constants are not stable


class MotorCart(System):
    """The motor-driven cart of Lima and Sampaio 2022; the defaults are its Table 1.

    State: motor angle ``alpha`` (rad), angular velocity ``alpha'`` (rad/s), current ``c`` (A). With
    ``m = cart_mass`` and ``d = eccentricity``,

    ``alpha'' (motor_inertia + m d^2 sin^2) + motor_damping alpha' + m d^2 sin cos alpha'^2 - motor_constant c
    = -mu m gravity d |sin| sign(alpha')``, ``inductance c' + resistance c + motor_constant alpha' = voltage``.

    The mass sticks while ``alpha' = 0`` and ``|motor_constant c| <= mu m gravity d |sin alpha|``; at ``sin alpha = 0``
    (dead centre) friction has no leverage and nothing sticks.

    Args:
        mu: Friction coefficient of cart and rail, zero or positive.
        cart_mass: kg, positive.
        eccentricity: Of the pin on the disk, m, positive.
        gravity: m/s^2, positive.
        motor_inertia: kg m^2, positive.
        motor_damping: N m s/rad, zero or positive.
        motor_constant: Of voltage (V s/rad) and torque (N m/A), positive.
        resistance: ohm, positive.
        inductance: H, positive.
        equation: "physical" as above (the default), or "printed": as printed in the paper (equation 2), whose term
            ``m d^2 sin cos`` multiplies ``alpha'`` and not its square, so that its units do not match.

    Raises:
        ValueError: For numbers out of range and for another `equation`.
    """

    mu: Annotated[Number, Quantity(meaning="friction coefficient of cart and rail", at_least=0)] = 0.2
    cart_mass: Annotated[Number, Quantity("kg", above=0)] = 5.0
    eccentricity: Annotated[Number, Quantity("m", "of the pin on the disk", above=0)] = 0.01
    gravity: Annotated[Number, Quantity("m/s^2", above=0)] = 9.81
    motor_inertia: Annotated[Number, Quantity("kg m^2", above=0)] = 1.21e-4
    motor_damping: Annotated[Number, Quantity("N m s/rad", at_least=0)] = 1.545e-4
    motor_constant: Annotated[Number, Quantity("V s/rad", "of voltage and torque; also N m/A", above=0)] = 5.33e-2
    resistance: Annotated[Number, Quantity("ohm", above=0)] = 0.307
    inductance: Annotated[Number, Quantity("H", above=0)] = 1.88e-4
    equation: Annotated[
        str, Choice(("physical", "printed"), "physical, or as printed in the paper (its units do not match)")
    ] = eqx.field(static=True, default="physical")

    @property
    def stops_are_unstable(self) -> bool:
        # Friction holds the less, the nearer to dead centre.
        return True

    @property
    def largest_friction_torque(self) -> Scalar:
        """Largest torque that friction can hold, at ``|sin alpha| = 1``: ``mu m gravity d``, N m."""
        return self.mu * self.cart_mass * self.gravity * self.eccentricity

    @property
    def shortest_time(self) -> Scalar:
        """The mechanical time constant at dead centre, ``motor_inertia resistance / motor_constant^2``, s."""
        return self.motor_inertia * self.resistance / self.motor_constant**2

    @property
    def angle_scale(self) -> Scalar:
        """The angle over which the inertia changes at dead centre, where it is least, rad; at most one.

        The inertia ``motor_inertia + m d^2 sin^2`` is zero at a complex angle about as far away, where the motion has a
        singularity: no Taylor series reaches further.
        """
        return (self.motor_inertia / (self.motor_inertia + self.cart_mass * self.eccentricity**2)) ** 0.5

    def ideal_speed(self, voltage: SourceVoltage) -> Scalar:
        """The speed at which the motor would balance the largest voltage, rad/s."""
        return (abs(voltage.mean) + abs(voltage.amplitude)) / self.motor_constant

    def longest_response(self, voltage: SourceVoltage) -> Scalar:
        """The longest step (s) in which the current follows the torque and the voltage.

        Over steps of several electrical time constants it follows changes with an error of low order, about the second,
        times the eighth power of the step in these constants: hence a mean of these and of the time of the changes.
        """
        decay = self.inductance / self.resistance
        changes = self.ideal_speed(voltage) / self.angle_scale + voltage.angular_frequency
        return _LONGEST_RESPONSE * (decay / changes) ** 0.5

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (
            Coordinate("angle", "rad", r"\alpha", 2 * math.pi),
            Coordinate("angular velocity", "rad/s", r"\dot\alpha"),
            Coordinate("current", "A", "c"),
        )

    @property
    def stick_position(self) -> Coordinate:
        return Coordinate("motor angle during the stick", "rad", r"\alpha", 2 * math.pi)

    def switched_model(self, smooth: Signal | None, solver: ExplicitSolver | None) -> "CartModel":
        assert isinstance(smooth, SourceVoltage)
        _require_sine(smooth)  # a realisation of a random law, say
        return CartModel(self, smooth)

    def time_scales(self, excitation: Excitation, solver: Solver | None) -> dict[str, TimeScale]:
        return {
            "mechanical time constant": TimeScale(self.shortest_time, _CONSTANT),
            "electrical time constant": TimeScale(self.inductance / self.resistance, _DECAY),
            "period of the voltage": TimeScale(shortest_period(excitation), SOLVED),
        }

    def usual_step(self, excitation: Excitation) -> Scalar:
        voltage = voltage_of(excitation)
        assert isinstance(voltage, SourceVoltage)
        return 1 / (self.ideal_speed(voltage) / (_LONGEST_TURN * self.angle_scale) + voltage.angular_frequency)

    @property
    def contact_scales(self) -> tuple[Scalar, Scalar]:
        torque, arm = self.largest_friction_torque, self.eccentricity
        return arm * torque * self.resistance / self.motor_constant**2, arm * torque / self.motor_inertia

    def state_scales(self, excitation: Excitation) -> tuple[Scalar, ...]:
        voltage = voltage_of(excitation)
        assert isinstance(voltage, SourceVoltage)
        speed = self.ideal_speed(voltage)
        return 1.0, speed, speed * self.motor_constant / self.resistance

    def check_excitation(self, excitation: Excitation) -> None:
        voltage = voltage_of(excitation)
        if not isinstance(voltage, SourceVoltage) or excitation.base or excitation.ground:
            raise ValueError(
                "Argument base of a MotorCart must be a SourceVoltage, or RandomPhase(SourceVoltage(...)), but another "
                "motion was given."
            )
        _require_sine(voltage)

    def check_solver(self, solver: Solver | None) -> None:
        if solver is not None:
            raise ValueError("Argument solver must be None for a MotorCart, which has an integrator of its own.")

    @property
    def body_name(self) -> str:
        return "motor"

    def mechanism(self, state: tuple[np.ndarray, ...], base: np.ndarray) -> Mechanism:
        return motor_and_cart(state[0], float(self.eccentricity))

    @property
    def band_coordinate(self) -> int:
        return 2

    def longest_stick(self, smooth: Signal, position: AnyArray) -> Array | None:
        return stick_duration_bound(self, smooth, position) if isinstance(smooth, SourceVoltage) else None

    def stick_band(
        self, times: Array, state: tuple[Array, ...], velocity: Array, acceleration: Array, ground: AnyArray | float
    ) -> tuple[Array, Array]:
        """Currents with ``|motor_constant c| <= mu m gravity d |sin alpha|``, A."""
        most = self.largest_friction_torque / self.motor_constant * jnp.abs(jnp.sin(state[0]))
        return -most, most


def _require_sine(voltage: Signal) -> None:
    """Raise ValueError for a subclass of `SourceVoltage` with another `value`, which the motor would not follow."""
    if not keeps(voltage, SourceVoltage, "value"):
        raise ValueError(
            f"Argument base of a MotorCart must be a sine about its mean, but {_checks.show(voltage)} was given, whose "
            "class overrides SourceVoltage.value; write motor and voltage as a SwitchedSystem of your own."
        )


def stick_duration_bound(system: MotorCart, voltage: SourceVoltage, angle: AnyArray | float) -> FloatArray:
    """Upper bound of the duration of sticks of a `MotorCart`.

    It is the longest time without a break during which friction can hold the torque of the steady current
    ``mean / resistance + A sin(...)``, that is, during which the sine lies between ``low`` and ``high``,
    ``(-+ mu m g d |sin angle| / motor_constant - mean / resistance) / A``. Where one of its extrema lies between them,
    that is ``(pi + 2 asin high) / angular_frequency`` or ``(pi - 2 asin low) / angular_frequency`` (Lima and Sampaio
    2022, section 4, whose mean is positive, and whose eqs 7 and 8 lack the angular frequency in some places); where
    none does, the current swings from one limit to the other in ``(asin high - asin low) / angular_frequency``, twice
    in a period; where both do, sticks may never end. The current that a stick begins with decays in the time
    ``inductance / resistance``; it can prolong a stick by about that much.

    A constant voltage (amplitude 0) gives 0 or infinity. At dead centre, and without friction, nothing sticks: 0.

    Args:
        system: The motor with its cart.
        voltage: The source voltage.
        angle: Motor angles, rad, any shape.

    Returns:
        The bound at each angle, s; infinity where sticks never end.

    Raises:
        ValueError: For arguments of another kind, and for angles that are not finite.

    >>> system, voltage = ss.MotorCart(mu=0.5), ss.SourceVoltage()
    >>> bound = ss.stick_duration_bound(system, voltage, math.pi / 2)
    >>> print(f"{bound:.5f} s")
    0.50828 s
    """
    if not isinstance(system, MotorCart) or not keeps(voltage, SourceVoltage, "value"):
        raise ValueError(
            "Arguments system and voltage must be a MotorCart and a SourceVoltage, but "
            f"{_checks.show(system)} and {_checks.show(voltage)} were given."
        )
    _checks.numeric("angle", angle, ndim=None)
    held = system.largest_friction_torque * jnp.abs(jnp.sin(jnp.asarray(angle, float))) / system.motor_constant
    reactance = system.inductance * voltage.angular_frequency
    amplitude = jnp.abs(voltage.amplitude) / jnp.sqrt(system.resistance**2 + reactance**2)
    mean = voltage.mean / system.resistance
    per_amplitude = 1 / jnp.where(amplitude > 0, amplitude, 1)
    spare = [limit - mean for limit in (-held, held)]
    low, high = (_asin_within(some * per_amplitude) for some in spare)
    over_lowest, over_highest = spare[0] <= -amplitude, spare[1] >= amplitude
    # At an extremum the current turns back, and passes through the same values again.
    bound = (high - low) * jnp.where(over_lowest | over_highest, 2, 1) / voltage.angular_frequency
    bound = jnp.where(amplitude > 0, bound, 0)
    return jnp.where(held > 0, jnp.where(over_lowest & over_highest, jnp.inf, bound), 0.0)


def _asin_within(sine: FloatArray) -> FloatArray:
    """The angle whose sine this is, from -pi / 2 to pi / 2, and the nearer one of these beyond."""
    within = jnp.abs(sine) < 1
    return jnp.where(within, jnp.arcsin(jnp.where(within, sine, 0)), jnp.sign(sine) * (math.pi / 2))


class CartModel(OneContactModel[FloatScalar]):
    """A `MotorCart` under a `SourceVoltage`. Its forcing is the phase of the voltage as a step begins, rad."""

    system: MotorCart
    smooth: SourceVoltage

    def forcing(self, t: FloatScalar, segments: Segments) -> FloatScalar:
        return self.smooth.angular_frequency * t + self.smooth.phase

    def slip(self, forcing: FloatScalar, y: State, h: FloatScalar, sign: FloatScalar) -> State:
        # Angles are measured from where the step begins, so that sines cost a third: `step_limit` keeps them small.
        rates = Partial(type(self)._slip_rates, self, sincos(y[0]), sincos(forcing), sign)
        (angle, speed, current), _ = runge_kutta_step(rates, (0 * h, *y[1:]), h, solver=diffrax.Dopri8())
        return y[0] + angle, speed, current

    def stick(self, forcing: FloatScalar, y: State, h: FloatScalar) -> State:
        rho = self.system.resistance / self.system.inductance
        rest = (y[2] - self._steady(forcing, jnp.zeros_like(h))) * jnp.exp(-rho * h)
        return y[0], jnp.zeros_like(h), rest + self._steady(forcing, h)

    def rates(self, forcing: FloatScalar, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        direction, phase = sincos(y[0]), sincos(forcing + self.smooth.angular_frequency * tau)
        sticking = sign == 0
        speed, friction = jnp.where(sticking, 0, y[1]), sign * self.system.largest_friction_torque * direction[0]
        turn, across = self._balances(direction, phase, speed, y[2], friction)
        return speed, jnp.where(sticking, 0, turn), across * (1 / self.system.inductance)

    def _slip_rates(
        self, start: FloatPair, phase: FloatPair, sign: FloatScalar, tau: FloatScalar, state: State
    ) -> State:
        """The rates of a slip `tau` (s) after a step began at the angle `start`, from which the `state` counts it."""
        angle, speed, current = state
        direction, phase = _turned(start, angle), _turned(phase, self.smooth.angular_frequency * tau)
        friction = sign * self.system.largest_friction_torque * direction[0]
        turn, across = self._balances(direction, phase, speed, current, friction)
        return speed, turn, across * (1 / self.system.inductance)

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
        turn = _LONGEST_TURN * self.system.angle_scale / jnp.maximum(jnp.abs(y[1]), 1e-9)
        slip = jnp.minimum(step, jnp.minimum(turn, self.system.longest_response(self.smooth)))
        slip = slip * jnp.minimum(1, 0.1 + age / (6 * transient))
        stick = jnp.minimum(2 * np.pi / (16 * self.smooth.angular_frequency), transient / 2 + age / 3)
        return jnp.where(sign == 0, stick, slip)

    def at_rest(self, forcing: FloatScalar, y: State) -> BoolScalar:
        return jnp.abs(y[1]) <= self.noise(forcing, y, jnp.ones_like(y[1]))

    def slip_sign(self, forcing: FloatScalar, y: State) -> FloatScalar:
        sine, cosine = sincos(y[0])
        # Exactly at dead centre r is 0, and its sign follows from its rate, r' = cos(alpha) alpha'^2.
        at_dead_center = jnp.abs(sine) <= jnp.finfo(y[0].dtype).eps * jnp.maximum(jnp.abs(y[0]), 1)
        return jnp.where(at_dead_center, jnp.sign(cosine), jnp.sign(sine * y[1]))

    def guard(self, forcing: FloatScalar, tau: FloatScalar, y: State, sign: FloatScalar) -> FloatPair:
        sine, cosine = sincos(y[0])
        _, turn, current_rate = self.rates(forcing, tau, y, sign)
        rate = turn * sine + y[1] * y[1] * cosine
        held = self.system.largest_friction_torque * jnp.abs(sine)
        per_held = jnp.where(held > 0, self.system.motor_constant / jnp.where(held > 0, held, 1), 0)
        share, share_rate = y[2] * per_held, current_rate * per_held
        sticking = sign == 0
        guard = jnp.where(sticking, 1 - share * share, sign * sine * y[1])
        return guard, jnp.where(sticking, -2 * share * share_rate, sign * rate)

    def guard_scale(self, forcing: FloatScalar, y: State, sign: FloatScalar) -> FloatScalar:
        return jnp.where(sign == 0, 2.0, self.system.ideal_speed(self.smooth) + jnp.abs(y[1]))

    def on_base(self, forcing: FloatScalar, y: State) -> State:
        return y[0], jnp.zeros_like(y[1]), y[2]

    def can_stick(self, forcing: FloatScalar, y: State) -> BoolScalar:
        held = self.system.largest_friction_torque * jnp.abs(sincos(y[0])[0])
        return (jnp.abs(self.system.motor_constant * y[2]) <= held) & (held > 0)

    def release_sign(self, forcing: FloatScalar, y: State) -> FloatScalar:
        # The motor starts in the direction of the torque of its current.
        return jnp.where(y[2] * sincos(y[0])[0] > 0, 1, -1).astype(y[0].dtype)

    @property
    def friction(self) -> FrictionLaw:
        return Coulomb(1.0)  # a share of the largest friction torque

    def rates_under(self, forcing: FloatScalar, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        direction, phase = sincos(y[0]), sincos(forcing + self.smooth.angular_frequency * tau)
        friction = coefficient * self.system.largest_friction_torque * jnp.abs(direction[0])
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
