"""A mass on a spring, pressed on a moving base: its parameters, and its motion in closed form."""

import math
from contextlib import suppress
from functools import partial
from typing import Annotated, Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.tree_util import Partial
from jaxtyping import Array

from .._compiler.programs import plain_numpy
from .._excitation.excitation import Excitation
from .._excitation.motion import Harmonic, Signal, SumOfHarmonics, added_up, angle
from .._foundation import checks
from .._foundation import lazy_diffrax as diffrax
from .._foundation.fields import Quantity, is_distribution, keeps
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
from .._numerics.derivatives import NotKnown, bounds_of, values_of
from .._numerics.elementary import responses, sincos
from .._numerics.steps import gross_changes, relative_error, runge_kutta_step
from .contacts import Contact, ForceQuantity, SeriesStiffness, check_spring, force_at, is_function, recorded_in
from .contacts_model import stick_band
from .dynamic_friction import DieterichRuina
from .friction import AtAge, FrictionLaw, require_law, times_of_slips
from .layouts import mass_on_belt
from .memory_models import (
    AgeingContact,
    AgeingContacts,
    InnerStates,
    SlipWeakening,
    WeakeningContacts,
    inner_laws_of,
    with_ages,
)
from .places import FrictionByPlace, PlacedContact
from .structure import LinearStructure
from .structure_models import StructureModel
from .switched_model import Base, EnergyModel, FloatPair, Forcing, Powers, Terms, later, with_change
from .system import (
    AGE,
    DECAYED,
    PASSED,
    PERIOD,
    SOFT,
    SOLVED,
    Coordinate,
    Look,
    Memory,
    RecordedForces,
    Sizes,
    StepCount,
    System,
    TimeScale,
    TimeScales,
    Tracks,
    Traits,
    is_built_in,
    observed_of,
    shortest_period,
)

# The steady response to a harmonic force, which an undamped system does not have at its natural frequency.


_RESONANCE = 1e-7  # relative distance of the frequencies below which the closed form loses all its digits


def check_no_resonance(force: Any, omega: Scalar) -> None:
    """Raises ValueError for a harmonic `force` at the natural angular frequency `omega` (rad/s) of undamped motion:
    the closed form is the steady response, and there is none at resonance. Under vmap that of every sample is checked;
    raises NotKnown under jit.
    """
    if not force.is_harmonic:
        return
    frequencies = force.tones[1]
    if np.any(np.abs(values_of(frequencies - omega)) < _RESONANCE * values_of(omega)):
        raise ValueError(
            f"Argument force must not have the natural angular frequency of {_shown(omega)} rad/s where there is no "
            f"damping, but {_shown(frequencies)} rad/s was given; use method=Exact(solver=diffrax.Dopri8()), which "
            "needs no closed form."
        )


def _shown(value: Number) -> str:
    low, high = bounds_of(value)
    return f"{low:.9g}" if low == high else f"{low:.9g} to {high:.9g}"


# A mass on a spring under its excitation: how it slips and sticks, in closed form or by a Runge-Kutta step.
#
# ``m x'' + c x' + k x = F(t) - sign mu n`` in a slip: the response to a step and a ramp of the force, besides that to
# harmonic forces (any book on vibration). Nothing is divided by the stiffness, which may be zero. Under other forces
# and friction laws each step is one Runge-Kutta step.


class OscillatorModel(EnergyModel[Forcing]):
    """A `MassSpring` on a base with the velocity ``smooth(t)`` plus piecewise-linear parts. State: x (m), x' (m/s)."""

    system: Any  # a MassSpring, which makes this model
    smooth: Signal | None
    steps_may_be_long: ClassVar[bool] = True
    has_kinks: ClassVar[bool] = False

    def slip(self, forcing: Forcing, y: State, h: FloatScalar, sign: FloatScalar) -> tuple[State, FloatScalar | None]:
        m, k, c = self._constants()
        coefficient = sign * self.friction.continued_coefficient(jnp.zeros_like(h), sign)
        # Beside the steady response to harmonic forces: a motion under a force that grows steadily.
        (x0, p0), (x1, p1) = (self._steady(forcing, tau) for tau in (jnp.zeros_like(h), h))
        force = cast(Harmonic | SumOfHarmonics | None, self.system.force if self._is_harmonic else None)
        load, load_slope = self._load(forcing)
        load = load + (0 if force is None else force.mean)
        first = (load - coefficient * self.system.normal_force - k * (y[0] - x0)) / m
        slope, speed = load_slope / m, y[1] - p0
        by = responses(0 if c is None else c / (2 * m), jnp.asarray(k / m, h.dtype), h)
        x = y[0] + (x1 - x0) + speed * by.impulse + first * by.step + slope * by.ramp
        return (x, p1 + speed * by.rate + first * by.impulse + slope * by.step), None

    def at_age(self, age: FloatArray) -> "OscillatorModel":
        return eqx.tree_at(lambda model: model.system.friction, self, AtAge(self.friction, age))

    def stick(self, forcing: Forcing, y: State, h: FloatScalar) -> tuple[State, None]:
        travel = h * later(forcing.base, 0.5 * h)
        if self.smooth is not None:
            travel = travel + self.smooth.integral(forcing.t, h)
        return (y[0] + travel, self.base_motion(forcing, h)[0]), None

    def rates(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        velocity, acceleration = self.base_motion(forcing, tau)
        coefficient = sign * self.friction.continued_coefficient(sign * (y[1] - velocity), sign)
        speed, slip = self.rates_under(forcing, tau, y, coefficient)
        return speed, jnp.where(sign == 0, acceleration, slip)

    def guard(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatScalar) -> FloatPair:
        m, k, c = self._constants()
        velocity, acceleration = self.base_motion(forcing, tau)
        beyond, holds = self._beyond_and_limit(forcing, tau, y)
        per_held = jnp.where(holds > 0, 1 / jnp.where(holds > 0, holds, 1), 0)
        share = beyond * per_held
        t = forcing.t + tau
        jerk = 0 if self.smooth is None else self.smooth.curvature(t)
        force = self.system.force
        force_rate = self._load(forcing)[1] + (force.rate(t) if isinstance(force, Signal) else 0)
        share_rate = (m * jerk + _times(c, acceleration) + k * velocity - force_rate) * per_held
        slip_rate = self.rates(forcing, tau, y, sign)[1] - acceleration
        sticking = sign == 0
        held = jnp.where(holds > 0, 1 - share * share, -1)
        guard = jnp.where(sticking, held, sign * (y[1] - velocity))
        return guard, jnp.where(sticking, -2 * share * share_rate, sign * slip_rate)

    def guard_scale(self, forcing: Forcing, y: State, sign: FloatScalar) -> FloatScalar:
        m, k, _ = self._constants()
        velocity = self.base_motion(forcing, jnp.zeros_like(y[0]))[0]
        omega, deceleration = lax.stop_gradient((jnp.sqrt(k / m), self.friction.static * self.system.normal_force / m))
        slip = jnp.abs(y[1]) + jnp.abs(velocity) + omega * jnp.abs(y[0])
        return jnp.where(sign == 0, 2.0, with_change(slip, deceleration, omega, forcing.t))

    def on_base(self, forcing: Forcing, y: State) -> State:
        return y[0], self.base_motion(forcing, jnp.zeros_like(y[0]))[0]

    def can_stick(self, forcing: Forcing, y: State) -> BoolScalar:
        beyond, holds = self._beyond_and_limit(forcing, jnp.zeros_like(y[0]), y)
        # Without friction nothing sticks, not even where no force is needed.
        return (jnp.abs(beyond) <= holds) & (holds > 0)

    def release_sign(self, forcing: Forcing, y: State) -> FloatScalar:
        # The base pulls harder than friction can hold: the mass lags behind.
        return jnp.where(self._beyond_and_limit(forcing, jnp.zeros_like(y[0]), y)[0] > 0, -1, 1).astype(y[0].dtype)

    @property
    def time_scales_are_known(self) -> bool:
        signals = [signal for signal in (self.smooth, self.system.force) if isinstance(signal, Signal)]
        return self.friction.speed_scale is not None and all(signal.shortest_period is not None for signal in signals)

    @property
    def friction(self) -> FrictionLaw:
        return self.system.friction

    def rates_under(self, forcing: Forcing, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        m, k, c = self._constants()
        friction = coefficient * self.system.normal_force
        return y[1], (self.load_at(forcing, tau) - _times(c, y[1]) - k * y[0] - friction) / m

    def relative_velocity(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatScalar:
        return y[1] - self.base_motion(forcing, tau)[0]

    def relative_acceleration(self, forcing: Forcing, tau: FloatScalar, y: State, rates: State) -> FloatScalar:
        return rates[1] - self.base_motion(forcing, tau)[1]

    def friction_force(self, y: State, coefficient: FloatScalar) -> FloatScalar:
        return -coefficient * self.system.normal_force

    def base_shear(self, forcing: Forcing, total: FloatArray) -> FloatScalar:
        # Of the load, the ground's acceleration is no force in the frame at rest.
        none = jnp.zeros_like(total)
        return self.system.mass * (total - forcing.ground[0]) - self.load_at(forcing, none)

    def stored_energies(self, y: State) -> Terms:
        system, (x, p) = self.system, y
        return {"kinetic": 0.5 * system.mass * p * p, "elastic": 0.5 * system.stiffness * x * x}

    def powers(self, forcing: Forcing, y: State, force: FloatScalar) -> Powers:
        # The base moves with velocity v against the force -force that the mass exerts on it (Lima and Sampaio 2015, the
        # energy analysis of section 2): it supplies force v, of which force x' reaches the mass.
        (_, p), none, (_, _, c) = y, jnp.zeros_like(forcing.t), self._constants()
        velocity = self.base_motion(forcing, none).velocity
        supplied = {"base": force * velocity, "load": self.load_at(forcing, none) * p}
        return Powers(supplied, {"friction": force * (velocity - p), "damping": (0 if c is None else c) * p * p})

    @property
    def fastest_decay(self) -> Scalar:
        m, _, c = self._constants()
        return 0.0 if c is None else c / m

    def _constants(self):
        return self.system.mass, self.system.stiffness, self.system.damping

    def base_motion(self, forcing: Forcing, tau: FloatScalar) -> Base:
        """Velocity and acceleration of the base, `tau` (s) later."""
        return forcing.base_at(self.smooth, tau)

    def load_at(self, forcing: Forcing, tau: FloatScalar) -> FloatScalar:
        load = later(self._load(forcing), tau)
        return load + self.system.force.value(forcing.t + tau) if isinstance(self.system.force, Signal) else load

    def _load(self, forcing: Forcing) -> FloatPair:
        """The piecewise-linear part of the load, and its slope: recorded forces and the acceleration of the ground."""
        mass, (ground, ground_slope) = self.system.mass, forcing.ground
        constant = 0.0 if self.system.force is None or is_function(self.system.force) else self.system.force
        ((force, slope),) = forcing.force or ((constant, 0.0),)
        return force - mass * ground, slope - mass * ground_slope

    def _beyond_and_limit(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatPair:
        """The friction force that a stick needs, ``m v' + c v + k x - F`` (Lima and Sampaio 2017, eq. 3), from the
        middle of the `stick_band` on, and the largest one in that direction, N.
        """
        m, k, c = self._constants()
        velocity, acceleration = self.base_motion(forcing, tau)
        needed = m * acceleration + _times(c, velocity) + k * y[0] - self.load_at(forcing, tau)
        # A mass that needs a positive force lags behind the base once it is released.
        limit = jnp.asarray(self.friction.stick_limit(-needed) * self.system.normal_force)
        if not self.friction.depends_on_direction:
            return needed, limit
        ways = (jnp.full_like(needed, way) for way in (-1.0, 1.0))
        backward, forward = (self.friction.stick_limit(way) * self.system.normal_force for way in ways)
        middle, limit = stick_band(backward, forward, limit)
        return needed - middle, limit

    @property
    def _is_harmonic(self) -> bool:
        """Whether there is a harmonic force; under other signals slips have no closed form."""
        return isinstance(self.system.force, Signal)

    def _steady(self, forcing: Forcing, tau: FloatScalar) -> FloatPair:
        """Position and velocity of the steady response to a harmonic force, without its mean."""
        m, k, c = self._constants()
        if not self._is_harmonic:
            return jnp.zeros_like(tau), jnp.zeros_like(tau)

        def answer(amplitude: FloatArray, w: FloatArray, phase: FloatArray) -> FloatPair:
            elastic, viscous = k - m * w * w, _times(c, w)
            gain = amplitude / (elastic * elastic + viscous * viscous)
            sine, cosine = sincos(angle(w, forcing.t + tau, phase))
            return gain * (elastic * cosine + viscous * sine), gain * w * (viscous * cosine - elastic * sine)

        position, velocity = added_up(answer, cast(Harmonic | SumOfHarmonics, self.system.force).tones)
        return position, velocity


class SolverOscillatorModel(OscillatorModel):
    """An `OscillatorModel` whose slips are integrated by `solver`: any friction law, any smooth force."""

    solver: ExplicitSolver
    controlled: bool = eqx.field(static=True)
    steps_may_be_long: ClassVar[bool] = False
    has_kinks: ClassVar[bool] = True

    def slip(self, forcing: Forcing, y: State, h: FloatScalar, sign: FloatScalar) -> tuple[State, FloatScalar | None]:
        rates = Partial(type(self).rates, self, forcing, sign=sign)
        y1, error = runge_kutta_step(rates, y, h, solver=self.solver)
        if not self.controlled:
            return y1, None
        m, k, c = self._constants()
        none = jnp.zeros_like(h)
        coefficient = self.friction.continued_coefficient(sign * self.relative_velocity(forcing, none, y), sign)
        friction = coefficient * self.system.normal_force
        by_state = ((none, none + 1), (none + k / m, none + (0 if c is None else c / m)))
        gross = gross_changes(h, y, (none, self.load_at(forcing, none) / m), by_state, (none, friction / m))
        return y1, relative_error(error, y, y1, gross)


def _times(c: Scalar | None, value: FloatScalar) -> FloatScalar | int:
    return 0 if c is None else c * value


# A mass on a spring, pressed on a moving base: its parameters, checks and scales.


# The error of each step without a closed form is controlled, so that fewer steps do than in `SOLVED`.
_CONTROLLED = StepCount(40.0, 12.0)


class MassSpring(System):
    """A mass held to the ground by a spring and pressed on a base that moves with velocity ``v(t)``.

    While slipping, ``mass x'' + damping x' + stiffness x = force(t) + mu normal_force sign(v - x')``; while sticking,
    ``x' = v``, which lasts as long as ``|mass v' + damping v + stiffness x - force| <= mu_static normal_force``
    (Lima and Sampaio 2017, "Construction of a statistical model", equation 1, where damping and force are zero).

    Args:
        mass: kg, positive.
        stiffness: N/m, positive; or zero for a mass without a spring, as Newmark's sliding block.
        normal_force: N, positive; or a function of time: a `Signal` such as `Harmonic`, a `Recorded` or a `ForceSteps`.
            While that is zero or negative the mass slides without friction, and nothing sticks.
        friction: The friction law, such as `Coulomb(mu)`.
        damping: Of a viscous damper to the ground, N s/m, zero or positive. None is zero.
        force: External force on the mass, N: a number, or a function of time: a `Signal` such as `Harmonic`, a
            `Recorded` or a `ForceSteps`; of a function of your own make a signal by `Signal.of`. None is zero.
        series_stiffness: N/m, of a spring between the mass and a slider without mass, which rubs on the base and whose
            sticks are counted: an element of Jenkins; see `Contact`. None: the mass itself rubs on it.

    Raises:
        ValueError: If a number is out of its range or not finite, `friction` or `force` is of another kind, or there is
            a `series_stiffness` before friction that depends on the speed or the age.
    """

    mass: Annotated[Number, Quantity("kg", above=0)]
    stiffness: Annotated[Number, Quantity("N/m", at_least=0)]
    # A `NormalForce`: all but the structure that stands for one that varies compute with a number.
    normal_force: Annotated[
        Any,
        ForceQuantity("N", above=0, hint="a mass that lifts off has a function of time, such as a ForceSteps"),
    ]
    friction: FrictionLaw
    # None rather than zero: an undamped system is then another pytree, known as undamped when numbers are traced.
    damping: Annotated[Number | None, Quantity("N s/m", at_least=0)] = eqx.field(
        default=None, converter=lambda v: None if _is_zero(v) else v
    )
    # None rather than zero: a free system is then another pytree, whose motion has a closed form over whole intervals.
    force: Annotated[Any, ForceQuantity("N")] = eqx.field(default=None, converter=lambda v: None if _is_zero(v) else v)
    series_stiffness: SeriesStiffness = None

    def check_parts(self) -> None:
        require_law("friction", self.friction, may_differ_by_place=not self._is_structure)
        check_spring(self.series_stiffness, self.friction)

    def check_relations(self) -> None:
        if not any(map(is_distribution, jax.tree.leaves(self.friction, is_leaf=is_distribution))):
            self.friction.check_directions()

    @property
    def _is_structure(self) -> bool:
        """Whether it moves as a structure with one contact: its normal force varies, it rubs behind a spring, or its
        friction weakens with the slip distance or steps with the normal force.
        """
        steps = isinstance(self.friction, DieterichRuina) and self.friction.normal_stress is not None
        return self._has_no_band or steps or isinstance(self.friction, SlipWeakening)

    @property
    def _has_no_band(self) -> bool:
        """Whether there is no one displacement up to which it sticks."""
        return is_function(self.normal_force) or self.series_stiffness is not None

    @property
    def _as_structure(self) -> LinearStructure | None:
        """The same mass as a structure with one contact, where it moves as one; else None."""
        if not self._is_structure:
            return None
        contact = Contact(np.ones(1), self.normal_force, self.friction, 1.0, self.series_stiffness)
        damping = None if self.damping is None else jnp.reshape(jnp.asarray(self.damping), (1,))
        mass, stiffness = (jnp.reshape(jnp.asarray(value), (1,)) for value in (self.mass, self.stiffness))
        force = None if self.force is None else (self.force,)
        return LinearStructure(mass, stiffness, damping, (contact,), force, uncoupled=True).of_contact(0)

    @property
    def tracks(self) -> Tracks:
        return Tracks(1, 0) if self._is_structure else Tracks()

    def ready(self) -> System:
        structure = self._as_structure
        return self if structure is None or type(self) is not MassSpring else structure.ready()

    @property
    def recorded(self) -> RecordedForces:
        return RecordedForces(recorded_in((self.force,)), recorded_in((self.normal_force,)))

    @property
    def angular_frequency(self) -> Scalar:
        """Natural angular frequency ``omega = sqrt(stiffness / mass)``, rad/s."""
        return jnp.sqrt(self.stiffness / self.mass)

    @property
    def stick_half_width(self) -> Scalar:
        """Largest displacement (m) at which the mass sticks on a base of constant velocity, without force and damping.

        It is ``a = mu_static * normal_force / stiffness``, infinite without a spring.

        Raises:
            ValueError: Where the normal force varies, or there is a `series_stiffness`.
        """
        if self._has_no_band:
            name = "normal_force" if self.series_stiffness is None else "series_stiffness"
            raise ValueError(
                "stick_half_width is that of a constant normal force without a spring in front of the contact, but "
                f"{name} is {checks.show(getattr(self, name))}."
            )
        return _over(self.friction.static * self.normal_force, self.stiffness)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        motion = Coordinate("position", "m", "x"), Coordinate("velocity", "m/s", r"\dot x")
        return *motion, *self.memory.coordinates

    @property
    def observed(self) -> tuple[Coordinate, ...]:
        return observed_of(("",), ("",))

    @property
    def memory(self) -> Memory:
        place = Coordinate("place on the base", "m", r"\xi")
        places = (place,) if self._by_place is not None and self._by_place.on == "base" else ()
        elongations = () if self.series_stiffness is None else (Coordinate("elongation", "m", "e"),)
        slips = (Coordinate("slip distance", "m", "s"),) if isinstance(self.friction, SlipWeakening) else ()
        ages = (AGE,) if self.friction.grows else ()
        return Memory(ages, inner_laws_of((self.friction,)), places, elongations, slips)

    @property
    def _by_place(self) -> FrictionByPlace | None:
        """The friction law, where it differs from place to place."""
        return self.friction if isinstance(self.friction, FrictionByPlace) else None

    @property
    def stick_position(self) -> Coordinate:
        what = "mass" if self.series_stiffness is None else "slider"
        return Coordinate(f"position of the {what} when the stick starts", "m", "x")

    @property
    def natural_frequency(self) -> Scalar | None:
        return None if _is_zero(self.stiffness) else self.angular_frequency

    @property
    def static_exceeds_kinetic(self) -> bool:
        return self.friction.static_exceeds_kinetic

    @property
    def traits(self) -> Traits:
        friction = self.friction
        is_simple = friction.constant and not (friction.static_exceeds_kinetic or friction.depends_on_direction)
        is_free = self.damping is None and self.force is None and not self._is_structure
        by_place = self._by_place is not None
        is_plain = is_simple and is_free and not by_place and self._moves_as_it_says
        return Traits(has_interval_form=is_plain, jumps_at_places=by_place)

    @property
    def _moves_as_it_says(self) -> bool:
        """Whether the motion is this class's, not that of a subclass with equations of its own."""
        return keeps(self, MassSpring, "switched_model", "stick_half_width")

    @property
    def _has_closed_form(self) -> bool:
        """Whether slips between events are followed in closed form, without a solver: under constant kinetic friction
        and a force that is constant, piecewise linear in time, or harmonic.
        """
        is_constant = self.friction.constant and not self._is_structure and self._moves_as_it_says
        return is_constant and (not isinstance(self.force, Signal) or self.force.is_harmonic)

    def switched_model(
        self, smooth: Signal | None, solver: ExplicitSolver | None
    ) -> "OscillatorModel | StructureModel | AgeingContact | AgeingContacts | PlacedContact | WeakeningContacts":
        structure = self._as_structure
        if structure is not None:
            return structure.switched_model(smooth, solver)
        if solver is None and self._has_closed_form:
            model = OscillatorModel(self, smooth)
        else:
            # A solver that the user gives takes the given steps, unless the friction law is the user's too.
            controlled = solver is None or not is_built_in(self)
            model = SolverOscillatorModel(self, smooth, diffrax.Dopri8() if solver is None else solver, controlled)
        if self._by_place is not None:
            return PlacedContact(model, self._by_place)
        return with_ages(model, 2, self.friction.grows, self.friction.growth_time)

    def inner_model(self, smooth: Signal | None) -> InnerStates | None:
        structure = self._as_structure
        if structure is not None:
            return structure.inner_model(smooth)
        model, laws = SolverOscillatorModel(self, smooth, diffrax.Dopri8(), False), self.memory.laws
        return InnerStates(model, 2, laws, speed=1) if laws else None

    def time_scales(self, excitation: Excitation, solver: Solver | None) -> TimeScales:
        structure = self._as_structure
        if structure is not None:
            return structure.time_scales(excitation, solver)
        steps = PERIOD if self._has_closed_form and solver is None else _CONTROLLED if solver is None else SOLVED
        natural = 2 * math.pi * _over(self.mass, self.stiffness) ** 0.5
        passing, decay = times_of_slips(self.friction, self.mass, self.normal_force, self.damping)
        driving = {"shortest period of the base motion": shortest_period(excitation)}
        if isinstance(self.force, Signal):
            driving = {"shortest period of the force": self.force.shortest_period} | driving
        scales = {
            "natural period": TimeScale(natural, steps),
            "time in which the slip speed passes the scale of the friction law": TimeScale(passing, PASSED),
            "decay time of the slip speed by damping and viscous friction": TimeScale(
                math.inf if steps is PERIOD else decay, DECAYED
            ),
            **{name: TimeScale(time, steps) for name, time in driving.items()},
        }
        return TimeScales(scales, driving, are_all=True)

    def sizes(self, excitation: Excitation) -> Sizes:
        structure = self._as_structure
        if structure is not None:
            return structure.sizes(excitation)
        # The motion changes in the time of one radian, or in 1 s where there is hardly a spring.
        xp = plain_numpy()
        squared, memory = xp.asarray(self.stiffness / self.mass, float), self.memory
        swings = squared > SOFT**2
        clock = xp.where(swings, 1 / xp.sqrt(xp.where(swings, squared, 1)), 1.0)
        deceleration = self.friction.static * self.normal_force / self.mass
        speed = deceleration * clock
        of_memory = (*(clock for _ in memory.ages), *memory.state_scales)
        return Sizes(speed, deceleration, (speed * clock, speed, *(speed * clock for _ in memory.places), *of_memory))

    def check_solver(self, solver: Solver | None) -> None:
        if solver is None and self.damping is None and isinstance(self.force, Signal):
            with suppress(NotKnown):
                check_no_resonance(self.force, (self.stiffness / self.mass) ** 0.5)

    @property
    def look(self) -> Look:
        friction, center = self.friction, None
        about_points = friction.constant and not friction.depends_on_direction and self.force is None
        about_points = about_points and self._by_place is None
        if about_points and not _is_zero(self.stiffness) and not self._is_structure:
            center = friction.kinetic(jnp.zeros(())) * self.normal_force / self.stiffness
        motion = "mass", lambda state, base: mass_on_belt(state[0], base, bool(self.stiffness > 0))
        if self.series_stiffness is not None or isinstance(self.friction, SlipWeakening):
            return Look(*motion)
        mu = r"\mu" if friction.constant and not friction.static_exceeds_kinetic else r"\mu_\mathrm{s}"
        return Look(
            *motion,
            self._stick_band,
            band_symbols=rf"|x| \leq {mu} n/k",
            slip_center=center,
            second_is_base_velocity=True,
        )

    def _stick_band(
        self, times: Array, state: tuple[Array, ...], velocity: Array, acceleration: Array, ground: AnyArray | float
    ) -> tuple[Array, Array]:
        """Positions with ``|mass v' + damping v + stiffness x - force| <= mu_static normal_force``, m; NaN without a
        spring, where the position does not matter.
        """
        load = force_at(self.force, times) - self.mass * (acceleration + ground)
        if self.damping is not None:
            load = load - self.damping * velocity
        stiffness = jnp.where(jnp.asarray(self.stiffness) > 0, self.stiffness, jnp.nan)
        normal = force_at(self.normal_force, times)
        # An open contact holds nothing: the band is empty there.
        closed = jnp.where(normal > 0, normal, jnp.nan)
        ages = state[2] if self.friction.grows else jnp.zeros_like(times)

        def limit_at(age: FloatScalar, sign: float) -> FloatArray:
            """The largest friction coefficient of a stick of this age that would break into a slip of this sign."""
            return jnp.asarray(AtAge(self.friction, age).stick_limit(jnp.full_like(age, sign)), age.dtype)

        forward, backward = (jax.vmap(partial(limit_at, sign=sign))(ages) for sign in (1.0, -1.0))
        if self._by_place is not None:
            place = state[2] if self._by_place.on == "base" else state[0]
            forward = backward = jax.vmap(self._by_place.static_at)(place)
        # A mass that lags behind the base once it is released needs a positive force.
        return (load - forward * closed) / stiffness, (load + backward * closed) / stiffness


def _over(value: Number, stiffness: Number) -> Any:
    """``value / stiffness``, infinite where that is zero."""
    if _is_zero(stiffness):
        return math.inf
    with np.errstate(divide="ignore"):
        return value / stiffness


def _is_zero(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and bool(value == 0)  # of NumPy's floats too
