"""A cart on a rail with dry friction, driven by a DC motor through a scotch yoke (Lima and Sampaio), and how it
slips and sticks.
"""

import math
from typing import Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array

from .._excitation.excitation import Excitation
from .._excitation.motion import Signal, SourceVoltage
from .._foundation import checks
from .._foundation import lazy_diffrax as diffrax
from .._foundation.fields import Choice, Quantity, is_distribution, keeps
from .._foundation.types import (
    AnyArray,
    BoolScalar,
    ExplicitSolver,
    FloatArray,
    FloatScalar,
    Number,
    Scalar,
    Solver,
    State,
)
from .._numerics.derivatives import without_derivatives
from .._numerics.elementary import sincos, sincos_of_small
from .._numerics.steps import gross_changes, relative_error, runge_kutta_step
from .friction import AtAge, Coulomb, FrictionLaw, MadeOfLaws, require_law, times_of_slips
from .layouts import motor_and_cart
from .memory_models import AgeingContact, InnerStates, SlipWeakening, inner_laws_of, with_ages
from .places import FrictionByPlace, PlacedContact
from .switched_model import EnergyModel, FloatPair, Powers, Segments, Terms
from .system import (
    AGE,
    DECAYED,
    PASSED,
    SOLVED,
    Coordinate,
    Look,
    Memory,
    Sizes,
    StepCount,
    System,
    TimeScale,
    TimeScales,
    Traits,
    shortest_period,
    voltage_of,
)

# How a `MotorCart` slips and sticks.
#
# The cart slides with the velocity ``-d sin(alpha) alpha'``, for which ``r = sin(alpha) alpha'`` is used. It passes
# through zero when the motor stops and at dead centre (``sin alpha = 0``), where the cart reverses; at fixed sign of r
# the friction torque ``-sign mu m g d sin(alpha)`` is smooth, so both are events of one kind.
#
# In a stick the current is known in closed form. A slip is integrated by the eighth-order Runge-Kutta method of Prince
# and Dormand, all three states together. Exponential integrators that treat the fast current separately were tried and
# are far less accurate at the same step: the angle by which a transient of the current turns the motor is a linear
# invariant, which a Runge-Kutta method conserves exactly and an exponential one only to its order.


LONGEST_TURN = 0.13  # of the motor in a step, in units of its `angle_scale`


class OnPin(MadeOfLaws):
    """The friction `law` of the cart, for velocities of the pin that moves it, where sin(alpha) is `sine`.

    The cart has ``-sine`` times the velocity of the pin; friction on it acts on the motor by the lever ``|sine|``.
    """

    law: FrictionLaw
    sine: FloatArray

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


class CartModel(EnergyModel[FloatScalar]):
    """A `MotorCart` under a `SourceVoltage`. Its forcing is the phase of the voltage as a step begins, rad."""

    system: Any  # a MotorCart, which makes this model
    smooth: SourceVoltage

    def forcing(self, t: FloatScalar, segments: Segments) -> FloatScalar:
        return self.smooth.angular_frequency * t + self.smooth.phase

    def slip(
        self, forcing: FloatScalar, y: State, h: FloatScalar, sign: FloatScalar
    ) -> tuple[State, FloatScalar | None]:
        if self.friction.constant:
            # Angles are measured from where the step begins, so that sines cost a third: `step_limit` keeps them small.
            rates = Partial(type(self)._slip_rates, self, sincos(y[0]), sincos(forcing), sign)
            (angle, speed, current), _ = runge_kutta_step(rates, (0 * h, *y[1:]), h, solver=diffrax.Dopri8())
            return (y[0] + angle, speed, current), None
        rates = Partial(type(self).rates, self, forcing, sign=sign)
        slid, error = runge_kutta_step(rates, y, h, solver=diffrax.Dopri8())
        return slid, relative_error(error, y, slid, self._gross_changes(forcing, y, h))

    def at_age(self, age: FloatArray) -> "CartModel":
        return eqx.tree_at(lambda model: model.system.friction, self, AtAge(self.friction, age))

    def stick(self, forcing: FloatScalar, y: State, h: FloatScalar) -> tuple[State, None]:
        rho = self.system.resistance / self.system.inductance
        rest = (y[2] - self._steady(forcing, jnp.zeros_like(h))) * jnp.exp(-rho * h)
        return (y[0], jnp.zeros_like(h), rest + self._steady(forcing, h)), None

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
        # The cart moves forward where r is negative.
        coefficient = self.friction.continued_coefficient(sign * self.system.eccentricity * sine * speed, -sign)
        return sign * (coefficient * self.system.friction_torque_of_one) * sine

    def _band(self, sine: FloatScalar) -> FloatPair:
        """Centre and half width of the torques of the current that friction can hold, N m.

        What a stick needs against the centre tells which way it breaks, even where one direction has no friction.
        """
        backward, forward = (torque * jnp.abs(sine) for torque in self.system.held_torques(sine))
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

    def position(self, y: State) -> FloatScalar:
        return self.system.eccentricity * jnp.cos(y[0])

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

    def friction_force(self, y: State, coefficient: FloatScalar) -> FloatScalar:
        # On the cart at ``x = d cos alpha``, whose velocity is ``-d sin alpha alpha'`` (Lima and Sampaio 2022, eq. 4).
        return coefficient * self.system.friction_torque_of_one / self.system.eccentricity * self.heading(y)

    def stored_energies(self, y: State) -> Terms:
        system, (angle, speed, current) = self.system, y
        cart = system.eccentricity * jnp.sin(angle) * speed
        kinetic = 0.5 * (system.motor_inertia * speed * speed + system.cart_mass * cart * cart)
        return {"kinetic": kinetic, "magnetic": 0.5 * system.inductance * current * current}

    def powers(self, forcing: FloatScalar, y: State, force: FloatScalar) -> Powers:
        system, (angle, speed, current) = self.system, y
        voltage = self.smooth.mean + self.smooth.amplitude * jnp.sin(forcing)
        friction = force * system.eccentricity * jnp.sin(angle) * speed
        heat = {"friction": friction, "damping": system.motor_damping * speed * speed}
        return Powers({"voltage": voltage * current}, heat | {"resistance": system.resistance * current * current})

    def check_energy(self) -> None:
        if self.system.equation != "physical":
            raise ValueError(
                f'energies needs a MotorCart with equation="physical", but one with equation="{self.system.equation}" '
                "was given: the units of that equation do not match, so that it has no energy."
            )

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


# A cart on a rail with dry friction, driven by a DC motor through a scotch yoke (Lima and Sampaio 2022, eqs 1, 2, 5).
#
# State: angle ``alpha`` (rad), ``alpha'`` (rad/s), current ``c`` (A). How it slips and sticks: above.


USUAL_MU = 0.2
_FOR_EVER = 1e30  # s: a stick that ends lasts less than a period of the voltage
_ENDLESS = 1e30  # N m: times the sine of dead centre it is still zero
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

    With a `friction` law its coefficient at the velocity of the cart is in place of mu. The cart is at ``d cos(alpha)``
    on its rail, with the velocity ``-d sin(alpha) alpha'``: that is the relative velocity of the law, positive (forward
    slips) while the motor turns forward with ``sin alpha < 0``, or backward with ``sin alpha > 0``. The age of the
    stick, where static friction grows, follows the other numbers of the state, as does the inner state of a law that
    has one (`LuGre`), which is simulated by ``Regularized()``.

    Args:
        mu: Friction coefficient of cart and rail, zero or positive; by default 0.2, or None with a `friction` law.
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
        friction: A friction law in place of mu, such as `Coulomb` with another static coefficient, `Directional`,
            `Ageing`, or a `FrictionByPlace` of places on the rail (``on="ground"``).

    Raises:
        ValueError: For numbers out of range, for another `equation`, if both `mu` and `friction` are given, and for
            friction by place on the base.
    """

    # None stands for 0.2, which `__post_init__` puts there unless a law is given.
    mu: Annotated[Number | None, Quantity(meaning="friction coefficient of cart and rail", at_least=0)] = None
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
    friction: FrictionLaw | None = None

    def __post_init__(self):
        if self.mu is None and self.friction is None:
            object.__setattr__(self, "mu", USUAL_MU)

    def check_parts(self) -> None:
        if self.friction is None:
            return
        if not isinstance(self.friction, FrictionLaw):
            raise checks.refused("friction", "be a friction law such as Coulomb(mu=0.3), or None", self.friction)
        require_law("friction", self.friction, may_differ_by_place=True)
        if isinstance(self.friction, SlipWeakening):
            hint = "a MassSpring and a LinearStructure take it"
            raise checks.refused("friction", "be no SlipWeakening", self.friction, hint)
        if isinstance(self.friction, FrictionByPlace) and self.friction.on != "ground":
            raise checks.refused(
                "friction", 'have its places on="ground", which is the rail of a MotorCart', self.friction
            )
        if self.mu is not None:
            raise ValueError(
                f"Argument mu must be None where a law gives the friction, but mu={checks.show(self.mu)} and "
                f"friction={checks.show(self.friction)} were given; keep one of them."
            )

    def check_relations(self) -> None:
        if self.friction is not None and not any(
            map(is_distribution, jax.tree.leaves(self.friction, is_leaf=is_distribution))
        ):
            self.friction.check_directions()

    @property
    def traits(self) -> Traits:
        # Friction holds the less, the nearer to dead centre.
        return Traits(stops_are_unstable=True, jumps_at_places=isinstance(self.friction, FrictionByPlace))

    @property
    def static_exceeds_kinetic(self) -> bool:
        return self.friction is not None and self.friction.static_exceeds_kinetic

    @property
    def largest_friction_torque(self) -> Scalar:
        """Largest torque that friction can hold, at ``|sin alpha| = 1``: ``mu m gravity d``, N m.

        With a law that of its static coefficient, for a stick that has just begun.
        """
        mu = self.mu if self.friction is None else self.friction.static
        assert mu is not None
        return mu * self.cart_mass * self.gravity * self.eccentricity

    @property
    def friction_torque_of_one(self) -> Scalar:
        """The friction torque, N m, at ``|sin alpha| = 1`` that a coefficient of 1 of the `CartModel` stands for."""
        if self.friction is None:
            return self.largest_friction_torque
        return self.cart_mass * self.gravity * self.eccentricity

    def at_angle(self, angle: FloatScalar) -> "MotorCart":
        """The same with the friction law of the place where the cart is."""
        law = self.friction
        if not isinstance(law, FrictionByPlace):
            return self
        region = law.region_of(self.eccentricity * jnp.cos(angle))
        return eqx.tree_at(lambda cart: cart.friction, self, law.in_region(region))

    def held_torques(self, sine: FloatScalar, age: FloatScalar | None = None) -> tuple[Scalar, Scalar]:
        """The largest torques, N m at ``|sin alpha| = 1``, that friction can hold in a stick.

        Args:
            sine: Of the angle, a scalar.
            age: Of the stick, s, a scalar; None for one that has just begun.

        Returns:
            That against turning backward, and that against turning forward.
        """
        if self.friction is None:
            return self.largest_friction_torque, self.largest_friction_torque
        law = OnPin(self.friction if age is None else AtAge(self.friction, age), sine)
        ways = (jnp.full_like(sine, way) for way in (-1.0, 1.0))
        backward, forward = (law.stick_limit(way) * self.friction_torque_of_one for way in ways)
        return backward, forward

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
            *self.memory.coordinates,
        )

    @property
    def memory(self) -> Memory:
        if self.friction is None:
            return Memory()
        return Memory((AGE,) if self.friction.grows else (), inner_laws_of((self.friction,)))

    @property
    def stick_position(self) -> Coordinate:
        return Coordinate("motor angle during the stick", "rad", r"\alpha", 2 * math.pi)

    def switched_model(
        self, smooth: Signal | None, solver: ExplicitSolver | None
    ) -> CartModel | AgeingContact | PlacedContact:
        assert isinstance(smooth, SourceVoltage)
        _require_sine(smooth)  # a realisation of a random law, say
        model = CartModel(self, smooth)
        if isinstance(self.friction, FrictionByPlace):
            return PlacedContact(model, self.friction)
        return model if self.friction is None else with_ages(model, 3, self.friction.grows, self.friction.growth_time)

    def inner_model(self, smooth: Signal | None) -> InnerStates | None:
        laws = self.memory.laws
        if not laws:
            return None
        assert isinstance(smooth, SourceVoltage)
        _require_sine(smooth)
        return InnerStates(CartModel(self, smooth), 3, laws)

    def time_scales(self, excitation: Excitation, solver: Solver | None) -> TimeScales:
        voltage = voltage_of(excitation)
        driving = {"period of the voltage": shortest_period(excitation)}
        scales = {
            "mechanical time constant": TimeScale(self.shortest_time, _CONSTANT),
            "electrical time constant": TimeScale(self.inductance / self.resistance, _DECAY),
            **{name: TimeScale(time, SOLVED) for name, time in driving.items()},
        }
        if self.friction is not None and not self.friction.constant:
            # The motor moves as a mass on the cart's rail, the heavier, the nearer to dead centre.
            mass = self.cart_mass + self.motor_inertia / self.eccentricity**2
            passing, decay = times_of_slips(self.friction, mass, self.cart_mass * self.gravity, None)
            scales["time in which the slip speed passes the scale of the friction law"] = TimeScale(passing, PASSED)
            scales["decay time of the slip speed by viscous friction"] = TimeScale(decay, DECAYED)
        if not isinstance(voltage, SourceVoltage):  # which `check_excitation` refuses
            return TimeScales(scales, driving)
        turning = self.ideal_speed(voltage) / (LONGEST_TURN * self.angle_scale)
        return TimeScales(scales, driving, usual_step=1 / (turning + voltage.angular_frequency))

    def sizes(self, excitation: Excitation) -> Sizes:
        voltage, torque, arm = voltage_of(excitation), self.largest_friction_torque, self.eccentricity
        assert isinstance(voltage, SourceVoltage)
        speed, memory = self.ideal_speed(voltage), self.memory
        state = 1.0, speed, speed * self.motor_constant / self.resistance
        of_memory = (*(self.shortest_time for _ in memory.ages), *memory.state_scales)
        slip = arm * torque * self.resistance / self.motor_constant**2
        return Sizes(slip, arm * torque / self.motor_inertia, (*state, *of_memory))

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
    def look(self) -> Look:
        def longest(voltage: Signal, angle: AnyArray) -> Array | None:
            return stick_duration_bound(self, voltage, angle) if isinstance(voltage, SourceVoltage) else None

        return Look(
            "motor",
            lambda state, base: motor_and_cart(state[0], float(self.eccentricity)),
            self._stick_band,
            band_coordinate=2,
            longest_stick=longest,
        )

    def _stick_band(
        self, times: Array, state: tuple[Array, ...], velocity: Array, acceleration: Array, ground: AnyArray | float
    ) -> tuple[Array, Array]:
        """Currents with ``|motor_constant c| <= mu m gravity d |sin alpha|``, A, of a stick of the age in the state."""
        sine = jnp.sin(state[0])
        ages = state[3] if self.memory.ages else jnp.zeros_like(sine)
        held = jax.vmap(lambda angle, age: self.at_angle(angle).held_torques(jnp.sin(angle), age))(state[0], ages)
        backward, forward = (torque / self.motor_constant * jnp.abs(sine) for torque in held)
        return -backward, forward


def _require_sine(voltage: Signal) -> None:
    """Raise ValueError for a subclass of `SourceVoltage` with another `value`, which the motor would not follow."""
    if not keeps(voltage, SourceVoltage, "value"):
        raise ValueError(
            f"Argument base of a MotorCart must be a sine about its mean, but {checks.show(voltage)} was given, whose "
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

    With a `friction` law the limits are those of its two directions; where static friction grows, those of a stick
    that has lasted for ever. A constant voltage (amplitude 0) gives 0 or infinity. At dead centre, and without
    friction, nothing sticks: 0.

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
    checks.require_threads_of_jax()
    if not isinstance(system, MotorCart) or not keeps(voltage, SourceVoltage, "value"):
        raise ValueError(
            "Arguments system and voltage must be a MotorCart and a SourceVoltage, but "
            f"{checks.show(system)} and {checks.show(voltage)} were given."
        )
    checks.numeric("angle", angle, ndim=None)
    angles = jnp.asarray(angle, float)
    sine, for_ever = jnp.sin(angles), jnp.asarray(_FOR_EVER, angles.dtype)
    # Of sticks that have lasted for ever, which may have grown without a limit.
    torques = jax.vmap(lambda one: system.at_angle(one).held_torques(jnp.sin(one), for_ever))(angles.reshape(-1))
    torques = [jnp.nan_to_num(torque, nan=_ENDLESS, posinf=_ENDLESS).reshape(sine.shape) for torque in torques]
    held = [torque * jnp.abs(sine) / system.motor_constant for torque in torques]
    reactance = system.inductance * voltage.angular_frequency
    amplitude = jnp.abs(voltage.amplitude) / jnp.sqrt(system.resistance**2 + reactance**2)
    mean = voltage.mean / system.resistance
    per_amplitude = 1 / jnp.where(amplitude > 0, amplitude, 1)
    spare = [limit - mean for limit in (-held[0], held[1])]
    low, high = (_asin_within(some * per_amplitude) for some in spare)
    over_lowest, over_highest = spare[0] <= -amplitude, spare[1] >= amplitude
    # At an extremum the current turns back, and passes through the same values again.
    bound = (high - low) * jnp.where(over_lowest | over_highest, 2, 1) / voltage.angular_frequency
    bound = jnp.where(amplitude > 0, bound, 0)
    return jnp.where(jnp.maximum(*held) > 0, jnp.where(over_lowest & over_highest, jnp.inf, bound), 0.0)


def _asin_within(sine: FloatArray) -> FloatArray:
    """The angle whose sine this is, from -pi / 2 to pi / 2, and the nearer one of these beyond."""
    within = jnp.abs(sine) < 1
    return jnp.where(within, jnp.arcsin(jnp.where(within, sine, 0)), jnp.sign(sine) * (math.pi / 2))
