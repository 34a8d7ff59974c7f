"""User-defined systems: any ordinary differential equations with dry-friction contacts.

Slips and sticks are integrated; their ends follow from the rates. With the relative velocity ``sigma(t, y, base)`` and
``rates = a + b friction``, one unit of friction changes ``sigma'`` by ``gain = grad sigma . b`` (negative). In a stick,
friction is the share u of the kinetic force that keeps ``sigma' = 0`` (Filippov's sliding field); the stick
lasts while ``|u| <= static_ratio``. Where friction has no effect on sigma (``gain = 0``) nothing sticks.
"""

import abc
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from .._excitation.excitation import Excitation
from .._excitation.motion import Signal
from .._foundation import checks
from .._foundation import lazy_diffrax as diffrax
from .._foundation.types import (
    BoolScalar,
    ExplicitSolver,
    FloatArray,
    FloatScalar,
    InitialState,
    Number,
    Scalar,
    Solver,
    State,
)
from .._numerics.derivatives import without_derivatives
from .._numerics.steps import gross_changes, relative_error, runge_kutta_step
from .dynamic_friction import DynamicFriction
from .friction import Coulomb, FrictionLaw
from .memory_models import AgeingContact, AgeingContacts, InnerStates, with_ages
from .switched_model import FloatPair, OneContactModel, Segments, with_change
from .system import (
    AGE,
    SHORTEST_TIME,
    SOLVED,
    Coordinate,
    Memory,
    RecordedForces,
    Sizes,
    TimeScale,
    TimeScales,
    Tracks,
    Traits,
    WithContacts,
    ages_of,
    shortest_period,
)
from .users_checks import check_fields, check_ground, check_motion
from .users_models import GeneralContactsModel, GeneralForcing, UsersBase, depends_on_time, differs_between, records_in

_SLOWEST = 1e-150  # rad/s, where a system with several contacts gives no time scale
_NEWTON_STEPS = 2  # to relative velocity zero; where it is linear in the state, one is exact
_LEAST_GAIN = 64  # units in the last place of the terms of the gain; a smaller gain is round-off


class SwitchedSystem(WithContacts):
    """A system of your own: ordinary differential equations with a dry-friction contact. Subclass it and write:

    - `state_names`: name and unit of each number of the state, two or more.
    - `rates(t, y, base, friction)`: the time derivative of the state.
    - `relative_velocity(t, y, base)`: the velocity of one side of the contact relative to the other.

    Two masses in a row, the second of which rubs on the base::

        class TwoMasses(ss.SwitchedSystem):
            stiffness: float  # N/m, from the wall to the first mass, and between the masses
            mass: float  # kg, of each
            normal_force: float  # N
            mu: float
            mu_static: float

            @property
            def state_names(self):
                return "position 1 in m", "velocity 1 in m/s", "position 2 in m", "velocity 2 in m/s"

            def rates(self, t, y, base, friction):
                x1, v1, x2, v2 = y
                pull = self.stiffness * (x2 - x1)
                force = friction * self.mu * self.normal_force
                return v1, (pull - self.stiffness * x1) / self.mass, v2, (-pull - force) / self.mass

            def relative_velocity(self, t, y, base):
                return y[3] - base.velocity

            @property
            def static_ratio(self):
                return self.mu_static / self.mu

            @property
            def shortest_time(self):  # the shorter one of the two natural periods
                return 2 * math.pi / (1.618 * (self.stiffness / self.mass) ** 0.5)


        system = TwoMasses(stiffness=1.0, mass=1.0, normal_force=1.0, mu=0.3, mu_static=0.4)
        one = ss.simulate(system, ss.Harmonic(1.0, 0.8), t1=50.0, y0=(0.0, 0.0, 1.0, 0.0))

    Fields hold numbers and arrays, or functions of time, ``self.force.value(t)``: a signal such as `Harmonic`, a
    `Recorded` or `ForceSteps`, which time steps follow from point to point; all that JAX can differentiate with respect
    to. A record may be a force or the velocity of a belt, steps a force only. Where the annotation of a field holds a
    `Quantity`, the constructor checks the field. Anything else, such as a name or a function, is declared
    ``field: str = equinox.field(static=True)``.

    For several contacts declare their number, ``contacts = 2``. `friction` is then an array (contacts,), and
    `relative_velocity` returns as many numbers; `static_ratio` may be an array too. Their forces must act as those of
    masses do: friction in any contact slows the sliding there.

    Their normal forces, if they depend on time or state, are returned by `normal_forces`; `friction` is then in N (or
    N m), to be multiplied by the friction coefficient. Where a normal force is zero or negative its contact is open: no
    friction, and no stick.

    Laws with an inner state, such as `LuGre`, are named by `inner_laws`; static friction that grows while a stick lasts
    by `static_ratio_after`.

    The position of a stick is the first number of the state. Figures label their axes by `state_names`; override
    `coordinates` and `look` (a `plot.Look`) to change what they show.

    `simulate` and `simulate_ensemble` raise ValueError for an instance that breaks these rules in the initial state
    with the base at rest. Any base velocity may excite the system, and any ground acceleration if `rates` uses
    ``base.ground``.
    """

    @property
    @abc.abstractmethod
    def state_names(self) -> tuple[str, ...]:
        """Name and unit of each number of the state: ``("angle in rad", "angular velocity in rad/s")``."""

    @abc.abstractmethod
    def rates(self, t: FloatScalar, y: State, base: UsersBase, friction: FloatArray) -> tuple[FloatScalar | float, ...]:
        """The time derivative of the state, computed by JAX.

        Write a kinetic force that depends on the relative velocity r as ``friction * force(jnp.abs(r))``. Rates must be
        smooth functions otherwise.

        Args:
            t: Time, s.
            y: The state, a tuple of scalars.
            base: ``base.velocity`` and ``base.acceleration`` of the base, m/s and m/s^2 (or rad/s and rad/s^2), and
                ``base.ground``, the acceleration of the ground, m/s^2: in coordinates relative to it, it is subtracted
                from the rate of each velocity.
            friction: The friction force over the kinetic friction force: +1 while the relative velocity is positive, -1
                while it is negative, and in a stick whatever holds it, at most `static_ratio` in size. Positive values
                must act against a positive relative velocity, and rates must be affine in `friction`:
                ``a + b friction``, where a and b depend on time, state and base.

        Returns:
            As many scalars as the state has.
        """

    @abc.abstractmethod
    def relative_velocity(
        self, t: FloatScalar, y: State, base: UsersBase
    ) -> FloatArray | tuple[FloatScalar, ...] | list[FloatScalar]:
        """The relative velocity in the contact: a smooth scalar function of the state; of each of several contacts.

        Args:
            t: Time, s.
            y: The state, a tuple of scalars.
            base: The base, on whose velocity it may depend, but not on its acceleration.

        Returns:
            The relative velocity, m/s (or rad/s).
        """

    @property
    def contacts(self) -> int | None:
        """The number of contacts, 1 to 64; None for one whose relative velocity and friction are scalars."""
        return None

    def normal_forces(
        self, t: FloatScalar, y: State, base: UsersBase
    ) -> FloatArray | tuple[FloatScalar, ...] | list[FloatScalar]:
        """The normal forces (contacts,), N (or N m), smooth functions of the state, of a system with `contacts`.

        Not overridden: contacts never open, and `friction` of `rates` is a share of the kinetic force.
        """
        raise NotImplementedError("only what a subclass gives is asked for")

    @property
    def static_ratio(self) -> Scalar | FloatArray:
        """Largest static friction force over the kinetic one at vanishing speed, ``mu_static / mu``; at least 1."""
        return 1.0

    def static_ratio_after(self, age: FloatArray | float) -> Scalar | FloatArray:
        """The `static_ratio` of a stick that has lasted `age` (s); of several contacts both are arrays (contacts,).

        Overridden: the ages of sticks are part of the state, after the numbers that `state_names` lists; `rates` and
        the other methods do not see them. It must not fall with the age.
        """
        return self.static_ratio

    @property
    def shortest_time(self) -> Scalar | None:
        """The shortest time scale, s: the shortest natural period, or 2 pi times a shorter time constant.

        The default time step is 1/48 of it, and no step may be longer than 1/12 of it; adaptive steps of a system that
        uses the time, or whose contacts open, 1/4 of it. The shortest periods of signals in its fields count too. None
        where it is not known; the step must be given then, ``method=Exact(step=...)``.
        """
        return None

    @property
    def speed_scale(self) -> Scalar | None:
        """The scale of relative velocities, m/s (or rad/s): the change of speed by friction in one `shortest_time`.

        The default thresholds of `Regularized` follow from it. None where it is not known.
        """
        return None

    @property
    def inner_laws(self) -> tuple[DynamicFriction, ...]:
        """The friction laws with an inner state, such as `LuGre`, one for each contact; none by default.

        Overridden: `friction` of `rates` is the friction coefficient of each law at its relative velocity, which
        `rates` multiplies by the normal force; with `normal_forces` it is the friction force. The inner states are part
        of the state, after the numbers that `state_names` lists, and the method is ``Regularized()``.
        """
        return ()

    @property
    def stops_are_unstable(self) -> bool:
        """Whether friction depends on where the motion stops: two motions that nearly stop there may part quickly.

        First-order estimates of how nearly a motion stopped are then too inaccurate (docs/sensitivity.md).
        """
        return False

    @property
    def traits(self) -> Traits:
        return Traits(stops_are_unstable=self.stops_are_unstable)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return *map(Coordinate.of, self.state_names), *self.memory.coordinates

    @property
    def memory(self) -> Memory:
        ages = ()
        if type(self).static_ratio_after is not SwitchedSystem.static_ratio_after:
            ages = (AGE,) if self.contacts is None else ages_of(self.contacts)
        return Memory(ages, self.inner_laws)

    @property
    def tracks(self) -> Tracks:
        return Tracks(self.contacts, self._counted)

    @property
    def has_normal_forces(self) -> bool:
        """Whether normal forces are given as functions."""
        return type(self).normal_forces is not SwitchedSystem.normal_forces

    @property
    def static_exceeds_kinetic(self) -> bool:
        if self.memory.ages:
            return True
        ratio = self.static_ratio
        # Not by jnp.max: under jit that would trace a number that is known.
        return bool(np.any(np.asarray(ratio) > 1)) if np.ndim(ratio) else float(ratio) > 1

    def switched_model(
        self, smooth: Signal | None, solver: ExplicitSolver | None
    ) -> "GeneralModel | GeneralContactsModel | AgeingContact | AgeingContacts":
        model = self.model_without_ages(smooth, solver)
        return with_ages(model, len(self.state_names), bool(self.memory.ages), None)

    def model_without_ages(
        self, smooth: Signal | None, solver: ExplicitSolver | None
    ) -> "GeneralModel | GeneralContactsModel":
        """The `switched_model` of sticks that never grow stronger."""
        solver = diffrax.Dopri8() if solver is None else solver
        if self.contacts is not None:
            shortest = self.shortest_time
            fastest = jnp.asarray(_SLOWEST if shortest is None else 2 * np.pi / shortest, float)
            return GeneralContactsModel(solver=solver, system=self, smooth=smooth, fastest=fastest)
        return GeneralModel(self, smooth, solver)

    def inner_model(self, smooth: Signal | None) -> InnerStates | None:
        if not self.inner_laws:
            return None
        return InnerStates(self.model_without_ages(smooth, None), self.inner_laws, len(self.state_names))

    def time_scales(self, excitation: Excitation, solver: Solver | None) -> TimeScales:
        with checks.traceable(f"The property shortest_time of {type(self).__name__}"):
            shortest = self.shortest_time
        signals = jax.tree.leaves(self, is_leaf=lambda leaf: isinstance(leaf, Signal))
        signals = [leaf for leaf in signals if isinstance(leaf, Signal) and leaf.shortest_period is not None]
        driving = {"shortest period of the base motion": shortest_period(excitation)}
        driving |= {f"shortest period of signal {i}": signal.shortest_period for i, signal in enumerate(signals)}
        # What its methods do with time themselves, and contacts that its motion closes, are as short as it says.
        if self.has_normal_forces or depends_on_time(self):
            driving[SHORTEST_TIME] = shortest
        times = {SHORTEST_TIME: shortest} | driving
        return TimeScales({name: TimeScale(time, SOLVED) for name, time in times.items()}, driving)

    def sizes(self, excitation: Excitation) -> Sizes:
        speed, time, memory = self.speed_scale, self.shortest_time, self.memory
        state = (1.0,) * (len(self.state_names) + len(memory.ages))
        deceleration = None if speed is None or time is None else speed / time
        return Sizes(speed, deceleration, (*state, *(law.state_scale for law in memory.laws)))

    def check_code(self, y0: tuple[Number, ...] | None = None) -> None:
        if y0 is None:
            check_fields(self)
        else:
            check_motion(self, y0[: len(self.state_names)])

    def differs_between(self, y0: InitialState, times: np.ndarray, others: np.ndarray) -> bool:
        return differs_between(self, y0[: len(self.state_names)], times, others)

    def check_excitation(self, excitation: Excitation) -> None:
        super().check_excitation(excitation)
        if excitation.ground:
            check_ground(self)

    @property
    def recorded(self) -> RecordedForces:
        return RecordedForces(records_in(self))


class _Contact(NamedTuple):
    """The effect of friction at one instant.

    Attributes:
        idle: Rates without friction.
        by_friction: What one unit of friction adds to them.
        drift: The rate of the relative velocity without friction.
        has_effect: Whether friction has an effect on the relative velocity.
        gain: What one unit of friction adds to its rate.
        per_gain: ``1 / gain``, 0 where friction has no effect.
    """

    idle: State
    by_friction: State
    drift: FloatScalar
    has_effect: BoolScalar
    gain: FloatScalar
    per_gain: FloatScalar

    @property
    def share(self) -> FloatScalar:
        """The friction, as a share of the kinetic force, that keeps the relative velocity constant."""
        return -self.drift * self.per_gain


class GeneralModel(OneContactModel[GeneralForcing]):
    """A `SwitchedSystem` on a base with the velocity ``smooth(t)`` plus piecewise-linear parts."""

    system: SwitchedSystem
    smooth: Signal | None
    solver: ExplicitSolver
    age: FloatScalar | None = None

    def at_age(self, age: FloatArray) -> "GeneralModel":
        return eqx.tree_at(lambda model: model.age, self, age, is_leaf=lambda leaf: leaf is None)

    @property
    def _static_ratio(self) -> Scalar | FloatArray:
        return self.system.static_ratio if self.age is None else self.system.static_ratio_after(self.age)

    def forcing(self, t: FloatScalar, segments: Segments) -> GeneralForcing:
        return GeneralForcing.of(t, segments)

    def slip(self, forcing: GeneralForcing, y: State, h: FloatScalar, sign: FloatScalar) -> tuple[State, FloatScalar]:
        rates = Partial(type(self).slip_rates, self, forcing, sign=sign)
        slid, error = runge_kutta_step(rates, y, h, solver=self.solver)
        return slid, relative_error(error, y, slid, self._gross_changes(forcing, y, h))

    def stick(self, forcing: GeneralForcing, y: State, h: FloatScalar) -> tuple[State, FloatScalar]:
        rates = Partial(type(self).stick_rates, self, forcing)
        held, error = runge_kutta_step(rates, y, h, solver=self.solver)
        return self._held(forcing, h, held), relative_error(error, y, held, self._gross_changes(forcing, y, h))

    def rates(self, forcing: GeneralForcing, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        slid, held = self.slip_rates(forcing, tau, y, sign), self.stick_rates(forcing, tau, y)
        return tuple(jnp.where(sign == 0, a, b) for a, b in zip(held, slid, strict=True))

    def slip_rates(self, forcing: GeneralForcing, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        """The rates of a slip of this sign, continued smoothly to beyond the end of the slip.

        The last Runge-Kutta step of a slip may have stages slightly beyond its end. Friction that depends on the
        absolute relative velocity has a kink there, which would cost the order: beyond, rates are extrapolated from the
        mirror image of the state.
        """
        t, base, _ = self.base_at(forcing, tau)
        sigma, gradient = self._gradient(forcing, t, y, base)
        steep = sum(part * part for part in gradient)
        beyond = (sign * sigma < 0) & (steep > 0)
        shift = jnp.where(beyond, sigma / jnp.where(beyond, steep, 1), 0)
        end, image = (tuple(v - k * shift * g for v, g in zip(y, gradient, strict=True)) for k in (1, 2))
        here, there = self._rates(forcing, t, end, base, sign), self._rates(forcing, t, image, base, sign)
        return tuple(jnp.where(beyond, 2 * a - b, b) for a, b in zip(here, there, strict=True))

    def stick_rates(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> State:
        """The sliding field: the rates under the friction that keeps the relative velocity."""
        contact = self._contact(forcing, *self.base_at(forcing, tau)[:2], y)
        return tuple(a + contact.share * b for a, b in zip(contact.idle, contact.by_friction, strict=True))

    def guard(self, forcing: GeneralForcing, tau: FloatScalar, y: State, sign: FloatScalar) -> FloatPair:
        t, base, base_rates = self.base_at(forcing, tau)
        one = jnp.ones_like(t)

        slid = self.slip_rates(forcing, tau, y, sign)
        sigma, sigma_rate = jax.jvp(partial(self._sigma, forcing), (t, y, base), (one, slid, base_rates))

        def share_of(t, y, base):
            contact = self._contact(forcing, t, base, y)
            return contact.share / jnp.asarray(self._static_ratio, t.dtype), contact.has_effect

        held = self.stick_rates(forcing, tau, y)
        share, share_rate, has_effect = jax.jvp(share_of, (t, y, base), (one, held, base_rates), has_aux=True)
        sticking = sign == 0
        stick = jnp.where(has_effect, 1 - share * share, -1)
        stick_rate = jnp.where(has_effect, -2 * share * share_rate, 0)
        return jnp.where(sticking, stick, sign * sigma), jnp.where(sticking, stick_rate, sign * sigma_rate)

    def guard_scale(self, forcing: GeneralForcing, y: State, sign: FloatScalar) -> FloatScalar:
        t, base, _ = self.base_at(forcing, jnp.zeros_like(y[0]))
        sigma, gradient = self._gradient(forcing, t, y, base)
        by_base = jax.grad(lambda v: self._sigma(forcing, t, y, base._replace(velocity=v)))(base.velocity)
        slip = jnp.abs(sigma) + jnp.abs(by_base * base.velocity)
        slip = slip + sum(jnp.abs(part * value) for part, value in zip(gradient, y, strict=True))
        if self.system.shortest_time is not None:
            contact = self._contact(forcing, t, base, y)
            change = sum(jnp.abs(part * rate) for part, rate in zip(gradient, contact.idle, strict=True))
            slip = with_change(slip, change + jnp.abs(contact.gain), 2 * np.pi / self.system.shortest_time, t)
        return jnp.where(sign == 0, 2.0, slip)

    def on_base(self, forcing: GeneralForcing, y: State) -> State:
        return self._held(forcing, jnp.zeros_like(y[0]), y)

    def can_stick(self, forcing: GeneralForcing, y: State) -> BoolScalar:
        contact = self._contact(forcing, *self.base_at(forcing, jnp.zeros_like(y[0]))[:2], y)
        return contact.has_effect & (jnp.abs(contact.share) <= self._static_ratio)

    def release_sign(self, forcing: GeneralForcing, y: State) -> FloatScalar:
        # Without friction the relative velocity would change faster than friction can prevent.
        contact = self._contact(forcing, *self.base_at(forcing, jnp.zeros_like(y[0]))[:2], y)
        return jnp.where(contact.drift > 0, 1, -1).astype(y[0].dtype)

    @property
    def friction(self) -> FrictionLaw:
        """Coulomb's law, its coefficient a share of the kinetic force."""
        static_exceeds_kinetic = type(self.system).static_ratio is not SwitchedSystem.static_ratio
        return Coulomb(1.0, self.system.static_ratio if static_exceeds_kinetic else None)

    def rates_under(self, forcing: GeneralForcing, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        t, base, _ = self.base_at(forcing, tau)
        return self._rates(forcing, t, y, base, coefficient)

    def relative_velocity(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> FloatScalar:
        t, base, _ = self.base_at(forcing, tau)
        return self._sigma(forcing, t, y, base)

    def relative_acceleration(self, forcing: GeneralForcing, tau: FloatScalar, y: State, rates: State) -> FloatScalar:
        t, base, base_rates = self.base_at(forcing, tau)
        return jax.jvp(partial(self._sigma, forcing), (t, y, base), (jnp.ones_like(t), rates, base_rates))[1]

    def base_at(self, forcing: GeneralForcing, tau: FloatScalar) -> tuple[FloatScalar, UsersBase, UsersBase]:
        """The time, the base and its time derivative, `tau` later."""
        t, base = forcing.t + tau, forcing.base_at(self.smooth, tau)
        jerk = jnp.zeros_like(t) if self.smooth is None else jnp.asarray(self.smooth.curvature(t), t.dtype)
        return t, base, UsersBase(base.acceleration, jerk, forcing.ground_slope)

    def _rates(
        self, forcing: GeneralForcing, t: FloatScalar, y: State, base: UsersBase, friction: FloatScalar
    ) -> State:
        return tuple(jnp.asarray(rate, t.dtype) for rate in forcing.seen_at(self.system, t).rates(t, y, base, friction))

    def _gross_changes(self, forcing: GeneralForcing, y: State, h: FloatScalar) -> State:
        """The sum of the changes of each number of the state in the time `h` by each term of its rate alone."""
        model, forcing, y, h = without_derivatives((self, forcing, y, h))
        t, base, _ = model.base_at(forcing, jnp.zeros_like(h))
        none = jnp.zeros_like(t)
        slopes = jax.jacfwd(partial(model._rates, forcing, t), argnums=(0, 2))(y, base, none)
        return gross_changes(h, y, model._rates(forcing, t, y, base, none), *zip(*slopes, strict=True))

    def _sigma(self, forcing: GeneralForcing, t: FloatScalar, y: State, base: UsersBase) -> FloatScalar:
        return jnp.asarray(forcing.seen_at(self.system, t).relative_velocity(t, y, base), t.dtype)

    def _gradient(
        self, forcing: GeneralForcing, t: FloatScalar, y: State, base: UsersBase
    ) -> tuple[FloatScalar, State]:
        """The relative velocity and its gradient with respect to the state."""
        return jax.value_and_grad(lambda y: self._sigma(forcing, t, y, base))(y)

    def _contact(self, forcing: GeneralForcing, t: FloatScalar, base: UsersBase, y: State) -> _Contact:
        # Rates are affine in friction: their derivative is what friction adds, without cancellation.
        idle, by_friction = jax.jvp(
            lambda friction: self._rates(forcing, t, y, base, friction), (jnp.zeros_like(t),), (jnp.ones_like(t),)
        )
        _, gradient = self._gradient(forcing, t, y, base)
        # The relative velocity depends on the base's velocity only, whose rate is its acceleration.
        none = jnp.zeros_like(t)
        moving = (jnp.ones_like(t), idle, UsersBase(base.acceleration, none, none))
        _, drift = jax.jvp(partial(self._sigma, forcing), (t, y, base), moving)
        terms = [part * rate for part, rate in zip(gradient, by_friction, strict=True)]
        gain, size = sum(terms, jnp.zeros_like(t)), sum(map(jnp.abs, terms), jnp.zeros_like(t))
        has_effect = gain < -_LEAST_GAIN * jnp.finfo(t.dtype).eps * size
        per_gain = jnp.where(has_effect, 1 / jnp.where(has_effect, gain, -1), 0)
        return _Contact(idle, by_friction, drift, has_effect, gain, per_gain)

    def _held(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> State:
        """`y`, moved in the direction in which friction acts until the relative velocity is zero."""
        t, base, _ = self.base_at(forcing, tau)
        for _ in range(_NEWTON_STEPS):
            contact = self._contact(forcing, t, base, y)
            friction = self._sigma(forcing, t, y, base) * contact.per_gain
            y = tuple(value - friction * effect for value, effect in zip(y, contact.by_friction, strict=True))
        return y
