"""A mass on a spring, pressed on a moving base: its parameters, checks and scales."""

import math
from contextlib import suppress
from functools import partial
from typing import Annotated, Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .. import _diffrax as diffrax
from .._excitation.excitation import Excitation
from .._excitation.force_steps import ForceSteps
from .._excitation.recorded import Recorded
from .._excitation.segments import SegmentLaw
from .._excitation.smooth import Signal
from .._fields import Quantity, is_distribution
from .._numerics.known import NotKnown
from .._types import AnyArray, Array, ExplicitSolver, FloatArray, FloatScalar, Number, Scalar, Solver
from .ageing_model import AgeingContact, AgeingContacts, with_ages
from .built_in import is_built_in
from .composed_friction import AtAge
from .contact import Contact
from .dynamic_friction import DynamicFriction
from .friction import FrictionLaw, times_of_slips
from .inner_states import InnerStates, inner_laws_of
from .layouts import mass_on_belt
from .mechanism import Mechanism
from .normal_force import NormalForceQuantity, is_function, recorded_in
from .oscillator_model import OscillatorModel, SolverOscillatorModel
from .steady_response import check_no_resonance
from .structure import LinearStructure, StructureModel
from .system import AGE, DECAYED, PASSED, PERIOD, SOFT, SOLVED, Coordinate, StepCount, System, TimeScale

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
        force: External force on the mass, N: a `Signal` such as `Harmonic`, or a `Recorded`. None is zero.

    Raises:
        ValueError: If a number is out of its range or not finite, or `friction` or `force` is of another kind.
    """

    mass: Annotated[Number, Quantity("kg", above=0)]
    stiffness: Annotated[Number, Quantity("N/m", at_least=0)]
    # A `NormalForce`: all but the structure that stands for one that varies compute with a number.
    normal_force: Annotated[
        Any,
        NormalForceQuantity("N", above=0, hint="a mass that lifts off has a function of time, such as a ForceSteps"),
    ]
    friction: FrictionLaw
    # None rather than zero: an undamped system is then another pytree, known as undamped when numbers are traced.
    damping: Annotated[Number | None, Quantity("N s/m", at_least=0)] = eqx.field(
        default=None, converter=lambda v: None if _is_zero(v) else v
    )
    force: Signal | Recorded | None = None
    rests_on: ClassVar = dict.fromkeys(("has_interval_form", "has_closed_form"), ("switched_model", "stick_half_width"))

    def check_parts(self) -> None:
        if not isinstance(self.friction, FrictionLaw):
            raise ValueError(
                "Argument friction must be a friction law such as Coulomb(mu=0.3), but "
                f"{_checks.show(self.friction)} was given."
            )
        if self.force is not None and not isinstance(self.force, (Signal, Recorded)):
            raise ValueError(
                "Argument force must be a signal such as Harmonic(amplitude, angular_frequency) or Recorded(times, "
                f"values), but {_checks.show(self.force)} was given."
            )

    def check_relations(self) -> None:
        if not any(map(is_distribution, jax.tree.leaves(self.friction, is_leaf=is_distribution))):
            self.friction.check_directions()

    @property
    def _as_structure(self) -> LinearStructure | None:
        """The same mass as a structure with one contact, which may open, where the normal force varies; else None."""
        if not is_function(self.normal_force):
            return None
        contact = Contact(np.ones(1), self.normal_force, self.friction)
        damping = None if self.damping is None else jnp.reshape(jnp.asarray(self.damping), (1,))
        mass, stiffness = (jnp.reshape(jnp.asarray(value), (1,)) for value in (self.mass, self.stiffness))
        force = None if self.force is None else (self.force,)
        return LinearStructure(mass, stiffness, damping, (contact,), force, uncoupled=True).of_contact(0)

    @property
    def contact_count(self) -> int | None:
        return 1 if is_function(self.normal_force) else None

    @property
    def counted_track(self) -> int | None:
        return 0 if is_function(self.normal_force) else None

    def ready(self) -> System:
        structure = self._as_structure
        return self if structure is None or type(self) is not MassSpring else structure.ready()

    @property
    def recorded_normal_forces(self) -> tuple[SegmentLaw, ...]:
        return recorded_in((self.normal_force,))

    @property
    def angular_frequency(self) -> Scalar:
        """Natural angular frequency ``omega = sqrt(stiffness / mass)``, rad/s."""
        return jnp.sqrt(self.stiffness / self.mass)

    @property
    def stick_half_width(self) -> Scalar:
        """Largest displacement (m) at which the mass sticks on a base of constant velocity, without force and damping.

        It is ``a = mu_static * normal_force / stiffness``, infinite without a spring.

        Raises:
            ValueError: Where the normal force varies.
        """
        if is_function(self.normal_force):
            raise ValueError(
                "stick_half_width is that of a constant normal force, but normal_force is "
                f"{_checks.show(self.normal_force)}."
            )
        return _over(self.friction.static * self.normal_force, self.stiffness)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (
            Coordinate("position", "m", "x"),
            Coordinate("velocity", "m/s", r"\dot x"),
            *self.ages,
            *self.inner_states,
        )

    @property
    def inner_laws(self) -> tuple[DynamicFriction, ...]:
        return inner_laws_of((self.friction,))

    @property
    def ages(self) -> tuple[Coordinate, ...]:
        return (AGE,) if self.friction.grows else ()

    @property
    def stick_position(self) -> Coordinate:
        return Coordinate("position of the mass when the stick starts", "m", "x")

    @property
    def has_fixed_time_scales(self) -> bool:
        return True

    @property
    def natural_frequency(self) -> Scalar | None:
        return None if _is_zero(self.stiffness) else self.angular_frequency

    @property
    def static_exceeds_kinetic(self) -> bool:
        return self.friction.static_exceeds_kinetic

    @property
    def recorded_loads(self) -> tuple[Recorded, ...]:
        return (self.force,) if isinstance(self.force, Recorded) else ()

    @property
    def sticks_at_base_velocity(self) -> bool:
        return True

    @property
    def has_interval_form(self) -> bool:
        friction = self.friction
        is_simple = friction.constant and not (friction.static_exceeds_kinetic or friction.depends_on_direction)
        is_constant = not is_function(self.normal_force)
        return is_simple and is_constant and self.damping is None and self.force is None

    @property
    def has_closed_form(self) -> bool:
        """That of constant kinetic friction under a force that is constant, piecewise linear in time, or harmonic."""
        is_constant = self.friction.constant and not is_function(self.normal_force)
        return is_constant and (not isinstance(self.force, Signal) or self.force.is_harmonic)

    def switched_model(
        self, smooth: Signal | None, solver: ExplicitSolver | None
    ) -> "OscillatorModel | StructureModel | AgeingContact | AgeingContacts":
        structure = self._as_structure
        if structure is not None:
            return structure.switched_model(smooth, solver)
        if solver is None and self.has_closed_form:
            model = OscillatorModel(self, smooth)
        else:
            # A solver that the user gives takes the given steps, unless the friction law is the user's too.
            controlled = solver is None or not is_built_in(self)
            model = SolverOscillatorModel(self, smooth, diffrax.Dopri8() if solver is None else solver, controlled)
        return with_ages(model, 2, self.friction.grows, self.friction.growth_time)

    def inner_model(self, smooth: Signal | None) -> InnerStates | None:
        structure = self._as_structure
        if structure is not None:
            return structure.inner_model(smooth)
        model = SolverOscillatorModel(self, smooth, diffrax.Dopri8(), False)
        return InnerStates(model, self.inner_laws, 2, speed=1) if self.inner_laws else None

    def time_scales(self, excitation: Excitation, solver: Solver | None) -> dict[str, TimeScale]:
        structure = self._as_structure
        if structure is not None:
            return structure.time_scales(excitation, solver)
        steps = PERIOD if self.has_closed_form and solver is None else _CONTROLLED if solver is None else SOLVED
        natural = 2 * math.pi * _over(self.mass, self.stiffness) ** 0.5
        passing, decay = times_of_slips(self.friction, self.mass, self.normal_force, self.damping)
        return {
            "natural period": TimeScale(natural, steps),
            "time in which the slip speed passes the scale of the friction law": TimeScale(passing, PASSED),
            "decay time of the slip speed by damping and viscous friction": TimeScale(
                math.inf if steps is PERIOD else decay, DECAYED
            ),
            **{name: TimeScale(time, steps) for name, time in self.driving_times(excitation).items()},
        }

    def driving_times(self, excitation: Excitation) -> dict[str, Scalar | None]:
        structure = self._as_structure
        if structure is not None:
            return structure.driving_times(excitation)
        force = {"shortest period of the force": self.force.shortest_period} if isinstance(self.force, Signal) else {}
        return force | super().driving_times(excitation)

    @property
    def contact_scales(self) -> tuple[Scalar | FloatArray | None, Scalar | FloatArray | None]:
        structure = self._as_structure
        if structure is not None:
            return structure.contact_scales
        held = self.friction.static * self.normal_force
        return held / self.mass * self._clock, held / self.mass

    def state_scales(self, excitation: Excitation) -> tuple[Scalar, ...]:
        structure = self._as_structure
        if structure is not None:
            return structure.state_scales(excitation)
        speed, _ = self.contact_scales
        assert speed is not None
        return (
            speed * self._clock,
            speed,
            *(self._clock for _ in self.ages),
            *(law.state_scale for law in self.inner_laws),
        )

    @property
    def _clock(self) -> Scalar:
        """In which the motion changes: the time of one radian, or 1 s where there is hardly a spring."""
        squared = jnp.asarray(self.stiffness / self.mass, float)
        swings = squared > SOFT**2
        return jnp.where(swings, 1 / jnp.sqrt(jnp.where(swings, squared, 1)), 1.0)

    def check_solver(self, solver: Solver | None) -> None:
        if solver is None and self.damping is None and isinstance(self.force, Signal):
            with suppress(NotKnown):
                check_no_resonance(self.force, (self.stiffness / self.mass) ** 0.5)

    @property
    def body_name(self) -> str:
        return "mass"

    def mechanism(self, state: tuple[np.ndarray, ...], base: np.ndarray) -> Mechanism:
        return mass_on_belt(state[0], base, bool(self.stiffness > 0))

    @property
    def slip_center(self) -> Scalar | None:
        friction = self.friction
        if not friction.constant or friction.depends_on_direction or self.force is not None or _is_zero(self.stiffness):
            return None
        if is_function(self.normal_force):
            return None
        return self.friction.slip_coefficient(jnp.zeros(())) * self.normal_force / self.stiffness

    @property
    def band_symbols(self) -> str:
        mu = r"\mu" if self.friction.constant and not self.friction.static_exceeds_kinetic else r"\mu_\mathrm{s}"
        return rf"|x| \leq {mu} n/k"

    def stick_band(
        self, times: Array, state: tuple[Array, ...], velocity: Array, acceleration: Array, ground: AnyArray | float
    ) -> tuple[Array, Array]:
        """Positions with ``|mass v' + damping v + stiffness x - force| <= mu_static normal_force``, m; NaN without a
        spring, where the position does not matter.
        """
        force: FloatArray | float = 0.0
        if self.force is not None:
            force = self.force.value(times) if isinstance(self.force, Recorded) else jax.vmap(self.force.value)(times)
        load = force - self.mass * (acceleration + ground)
        if self.damping is not None:
            load = load - self.damping * velocity
        stiffness = jnp.where(jnp.asarray(self.stiffness) > 0, self.stiffness, jnp.nan)
        normal = self.normal_force
        if isinstance(normal, (Recorded, ForceSteps)):
            normal = normal.value(times)
        elif isinstance(normal, Signal):
            normal = jax.vmap(normal.value)(times)
        # An open contact holds nothing: the band is empty there.
        closed = jnp.where(jnp.asarray(normal) > 0, normal, jnp.nan)
        ages = state[2] if self.friction.grows else jnp.zeros_like(times)
        forward, backward = (jax.vmap(partial(self._limit_at, sign))(ages) for sign in (1.0, -1.0))
        # A mass that lags behind the base once it is released needs a positive force.
        return (load - forward * closed) / stiffness, (load + backward * closed) / stiffness

    def _limit_at(self, sign: float, age: FloatScalar) -> FloatArray:
        """The largest friction coefficient of a stick of this age that would break into a slip of this sign."""
        return jnp.asarray(AtAge(self.friction, age).stick_limit(jnp.full_like(age, sign)), age.dtype)


def _over(value: Number, stiffness: Number) -> Any:
    """``value / stiffness``, infinite where that is zero."""
    if _is_zero(stiffness):
        return math.inf
    with np.errstate(divide="ignore"):
        return value / stiffness


def _is_zero(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and value == 0
