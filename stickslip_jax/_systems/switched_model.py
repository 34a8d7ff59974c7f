"""A system under its excitation, as the engines integrate it: how it slips and sticks, and when; with one contact."""

import abc
from collections.abc import Callable
from functools import reduce
from operator import add
from typing import Any, ClassVar, Generic, NamedTuple, TypeAlias, TypeVar, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from .._excitation.motion import Signal
from .._excitation.segments import Segment, added
from .._foundation import checks
from .._foundation.fields import keeps
from .._foundation.types import BoolArray, BoolScalar, DType, FloatArray, FloatScalar, Number, Scalar, State
from .friction import FrictionLaw

# A system under its excitation, as the engines integrate it: how it slips and sticks, and when each ends.
#
# Exact dynamics uses the slips, the sticks and the guards; regularised dynamics the rates under any friction force and
# the relative velocity. All arrays are those of one trajectory: the engines make batches with ``jax.vmap``. What
# belongs to a contact (the sign of its mode, its guard) is a scalar where there is one contact, else an array
# (contacts,).


NOISE_ULPS = 64  # the round-off of the guard, in units in the last place of its scale
_SO_FAR = 16.0  # times the speeds of a motion: beyond what forces change in one radian, unless the motion is slow

F = TypeVar("F")
"""The forcing of a model: its excitation from the time a step begins until a segment ends."""


FloatPair: TypeAlias = tuple[FloatScalar, FloatScalar]
Guard: TypeAlias = tuple[FloatArray, FloatArray]
"""The guards of the contacts, and their time derivatives."""


Form: TypeAlias = tuple[tuple[int, float], ...]
"""A linear form of the numbers of a state, and of what is observed beside it: the places of some, with its weight."""
Along: TypeAlias = Callable[[FloatArray], FloatPair]
"""The values of forms, and their slopes, each at its time (forms,) (s) after the beginning of a step."""


def of_form(form: Form, numbers: State) -> FloatArray:
    """The value of the `form`."""
    return reduce(add, (weight * numbers[place] for place, weight in form))


def is_observed(form: Form, size: int) -> bool:
    """Whether some of the `form` is beside the state of this `size`, as `System.observed`."""
    return any(place >= size for place, _ in form)


class Segments(NamedTuple):
    """The present segments of what is piecewise linear: base velocity, ground acceleration, force and normal forces."""

    base: tuple[Segment, ...]
    ground: tuple[Segment, ...]
    force: tuple[Segment, ...]
    normal: tuple[Segment, ...] = ()


class Base(NamedTuple):
    """The base at one instant: velocity in m/s (or rad/s) and acceleration; zeros for a base at rest."""

    velocity: FloatScalar
    acceleration: FloatScalar


class Forcing(NamedTuple):
    """What is piecewise linear in time, from the time `t` (s) on: values there and slopes.

    - `base`: velocity, m/s. `ground`: acceleration, m/s^2. `force`, `normal`: of each record or steps, N.
    """

    t: FloatScalar
    base: FloatPair
    ground: FloatPair
    force: tuple[FloatPair, ...]
    normal: tuple[FloatPair, ...]

    @classmethod
    def of(cls, t: FloatScalar, segments: Segments) -> "Forcing":
        """The forcing from `t` on, until one of the present segments ends."""
        force, normal = (tuple(added(t, (one,)) for one in part) for part in (segments.force, segments.normal))
        return cls(t, added(t, segments.base), added(t, segments.ground), force, normal)

    def base_at(self, smooth: Signal | None, tau: FloatScalar) -> Base:
        """The base `tau` (s) later, of velocity ``smooth`` plus the linear part."""
        velocity, slope = later(self.base, tau), self.base[1]
        if smooth is None:
            return Base(velocity, slope)
        return Base(velocity + smooth.value(self.t + tau), slope + smooth.rate(self.t + tau))


def later(linear: FloatPair, tau: FloatScalar | float) -> FloatScalar:
    """The value of what is linear in time, `tau` (s) later."""
    value, slope = linear
    return value + tau * slope


def with_change(velocity: FloatArray, rate: FloatArray, fastest: Scalar, t: FloatScalar) -> FloatArray:
    """The size of the relative `velocity`, with what forces change of it at this `rate` in the time of one radian.

    On a base at rest all relative velocity is due to them. The radian is that of the `fastest` motion (rad/s); where
    that is slow or zero, forces change no more than has moved until the time `t`.
    """
    moved = _SO_FAR * (velocity + rate * t)
    return velocity + jnp.where(rate < moved * fastest, rate / jnp.where(fastest > 0, fastest, 1), moved)


class Question(NamedTuple):
    """Which contacts are asked whether friction holds them, their relative velocities being zero.

    Attributes:
        sign: The mode of the others.
        asked: Those that are asked.
        released: Of those asked, what slips in any case: its stick has just reached its limit.
        goes_on: Of those asked, what has stuck so far: round-off at the limit does not release it.
    """

    sign: FloatArray
    asked: BoolArray
    released: BoolArray
    goes_on: BoolArray


class Decision(NamedTuple):
    """What friction does with the contacts that were asked.

    Attributes:
        holds: Whether it holds them.
        release_sign: The sign of the relative velocity where it does not.
        guard: The guard of a stick there, of which the sign decided.
        guard_rate: Its time derivative.
    """

    holds: BoolArray
    release_sign: FloatArray
    guard: FloatArray
    guard_rate: FloatArray


def chosen_state(chosen: BoolArray, new: State, old: State) -> State:
    """One of two states."""
    return tuple(jnp.where(chosen, a, b) for a, b in zip(new, old, strict=True))


class SwitchedModel(eqx.Module, Generic[F]):
    """A system under its excitation.

    In its methods `forcing` is what ``forcing(t, segments)`` returned, and `tau` (s) the time since that t.

    Attributes:
        steps_may_be_long: Whether `slip` and `stick` are as exact over a long time as over a short step.
        has_short_steps: Whether steps are short beside all that moves in them, as what dies out.
        has_kinks: Whether friction in a slip may have a kink where the relative velocity is zero, as users write it.
    """

    steps_may_be_long: ClassVar[bool] = False
    has_short_steps: ClassVar[bool] = False
    has_kinks: ClassVar[bool] = True

    @property
    def contacts(self) -> int | None:
        """The number of contacts, where modes are arrays (contacts,); None for one contact, whose mode is a scalar."""
        return None

    @property
    def has_sliders(self) -> bool:
        """Whether some contacts of a list rub at the ends of springs."""
        return False

    @property
    def varying(self) -> tuple[int, ...]:
        """The contacts of a list whose normal forces vary."""
        return ()

    def among_all(self, of_varying: Array, others: Number | bool) -> Array:
        """What is given of the `varying` contacts, among all, (contacts,); `others`: that of the rest."""
        # Read, not written at their places: XLA makes no native loop of what scatters.
        places = np.full(self.contacts or 0, len(self.varying))
        places[list(self.varying)] = np.arange(len(self.varying))
        return jnp.append(of_varying, jnp.asarray(others, of_varying.dtype))[places]

    @property
    def time_scales_are_known(self) -> bool:
        """Whether all time scales are known, whatever the state: a step that suits them is short enough everywhere."""
        return False

    def start(self, y0: tuple[Number, ...] | FloatArray, dtype: DType) -> State:
        """The state with these numbers, one for each coordinate of the system."""
        return tuple(jnp.asarray(value, dtype) for value in y0)

    def numbers(self, y: State) -> State:
        """The numbers of the state `y`, one for each coordinate of the system."""
        return y

    def at_age(self, age: FloatArray) -> "SwitchedModel[F]":
        """The same model where sticks have lasted `age` (s), of each contact; asked only where friction grows so."""
        raise NotImplementedError("of models whose friction does not grow with the age of a stick")

    def stuck(self, sign: FloatArray) -> BoolArray:
        """What sticks in the mode `sign`: of several contacts (contacts + 1,), each, and last all that are closed."""
        return sign == 0

    def slips(self, sign: FloatArray) -> FloatArray:
        """The sign of the slip of each contact in the mode `sign`; 0 of what sticks or is open."""
        return sign

    def stick_position(self, y: State) -> FloatArray:
        """What is recorded as the position of a stick that begins in the state `y`, for each that can be `stuck`."""
        return y[0]

    def forcing(self, t: FloatScalar, segments: Segments) -> Any:
        """The excitation from time t (s) on, until a segment ends: a `Forcing`, unless a model needs another."""
        return Forcing.of(t, segments)

    def flow(self, forcing: F, y: State, h: FloatScalar, sign: FloatArray) -> State:
        """The state after the time `h` (s) in the mode of this `sign`, 0 in a stick."""
        return self.flow_and_error(forcing, y, h, sign)[0]

    @abc.abstractmethod
    def flow_and_error(
        self, forcing: F, y: State, h: FloatScalar, sign: FloatArray
    ) -> tuple[State, FloatScalar | None]:
        """The result of `flow`, and its relative error; None where the step is known to be short enough."""

    @abc.abstractmethod
    def rates(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        """The time derivative of the state; `sign` is 0 in a stick."""

    def dense(self, forcing: F, y: State, h: FloatScalar, sign: FloatArray) -> Callable[[FloatScalar], State]:
        """The state as a function of the time (s) since the beginning of a step of the length `h` (s)."""
        return lambda tau: self.flow(forcing, y, tau, sign)

    def along(self, forcing: F, y: State, h: FloatScalar, sign: FloatArray, forms: tuple[Form, ...]) -> Along:
        """The `forms` of the state within a step of the length `h` (s) in the mode of this `sign`."""
        weights = np.zeros((len(forms), len(self.numbers(y))))
        for row, form in zip(weights, forms, strict=True):
            for place, weight in form:
                row[place] += weight

        def at(one: tuple[FloatScalar, FloatArray]) -> FloatPair:
            tau, weight = one
            reached = self.flow(forcing, y, tau, sign)
            rates = self.rates(forcing, tau, reached, sign)
            value, slope = (jnp.dot(weight, jnp.stack(self.numbers(of))) for of in (reached, rates))
            return value, slope

        # One after the other: a flow takes long to compile.
        return lambda tau: lax.map(at, (tau, jnp.asarray(weights, tau.dtype)))

    @abc.abstractmethod
    def relative_velocity(self, forcing: F, tau: FloatScalar, y: State) -> FloatArray:
        """The relative velocity of each contact, m/s."""

    def at_rest(self, forcing: F, y: State, times: float = 1.0) -> BoolArray:
        """Whether the relative velocity is zero, but for so many `times` its round-off, at `tau` 0."""
        velocity = self.relative_velocity(forcing, jnp.zeros((), y[0].dtype), y)
        return jnp.abs(velocity) <= times * self.noise(forcing, y, jnp.ones_like(velocity))

    def noise(self, forcing: F, y: State, sign: FloatArray) -> FloatArray:
        """The round-off of the guard at `tau` 0."""
        return NOISE_ULPS * jnp.finfo(y[0].dtype).eps * self.guard_scale(forcing, y, sign)

    def after(
        self, forcing: F, y: State, sign: FloatArray, landed: BoolArray, ended: BoolArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        """What an event or the end of a segment does to the normal forces, before it is decided what contacts do.

        Args:
            forcing: From there on.
            y: The state there.
            sign: Of the mode until then.
            landed: Which modes end there.
            ended: Whether a segment ends there.

        Returns:
            The `sign` with which to decide; the modes that end there of contacts alone; and which contacts must be
            asked, because they close or open there.
        """
        return sign, landed, jnp.zeros_like(landed)

    def slip_sign(self, forcing: F, y: State) -> FloatArray:
        """The sign of the relative velocity at and right after `tau` 0, for a state that is not `at_rest`."""
        return jnp.sign(self.relative_velocity(forcing, jnp.zeros((), y[0].dtype), y))

    @abc.abstractmethod
    def guard(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> Guard:
        """Guard of the mode, positive while the stick or slip lasts, and its time derivative.

        In a slip: ``sign`` times the relative velocity. In a stick (`sign` 0): ``1 - (f / f_max)^2``, where f is the
        friction force needed and f_max the largest one.
        """

    @abc.abstractmethod
    def guard_scale(self, forcing: F, y: State, sign: FloatArray) -> FloatArray:
        """The size of the terms that cancel in the guard: the scale of its round-off."""

    @property
    def coupled(self) -> bool:
        """Whether friction in one contact has an effect on the relative velocity of another."""
        return False

    @abc.abstractmethod
    def at_base_velocity(self, forcing: F, y: State, resting: BoolArray) -> State:
        """The state at `tau` 0 with the relative velocity made exactly zero where contacts are `resting`."""

    def without_memory(self, y: State, sign: FloatArray | None = None) -> "tuple[Any, State]":
        """The model that knows forces and energies in this state, without what friction remembers, and its state.

        `sign`: of the mode in which the state is reached; not given: of what follows.
        """
        return self, y

    def modes_without_memory(self, sign: FloatArray) -> FloatArray:
        """The modes, as that model knows them."""
        return sign

    def entered(self, forcing: F, y: State, before: FloatArray, sign: FloatArray) -> State:
        """The state at `tau` 0 in the modes `sign`, with what begins anew where they are others than `before`.

        At the start of a trajectory both are the same. What friction forces are in the state are at their limits.
        """
        return y

    @abc.abstractmethod
    def decided(self, forcing: F, y: State, question: Question) -> Decision:
        """What friction does at `tau` 0 with the contacts at rest that are asked."""

    def step_limit(self, age: FloatArray, step: FloatScalar, y: State, sign: FloatArray) -> FloatScalar:
        """The longest step to take from `y`, `age` (s) after the last event at rest.

        Transients may need shorter steps at first, and a stick may allow longer ones.
        """
        return step


# A system with one contact under its excitation: the `SwitchedModel` that follows from its slips and its sticks.


class OneContactModel(SwitchedModel[F]):
    """A system with one contact under its excitation.

    Exact dynamics uses its slips, sticks and guards; regularised dynamics its rates under any friction force and the
    relative velocity.
    """

    def slip(self, forcing: F, y: State, h: FloatScalar, sign: FloatScalar) -> tuple[State, FloatScalar | None]:
        """The state after a slip of duration `h` (s) with relative velocity of this `sign`, and its relative error;
        None where the step is known to be short enough.
        """
        raise NotImplementedError("of models whose `flow_and_error` asks for it")

    def stick(self, forcing: F, y: State, h: FloatScalar) -> tuple[State, FloatScalar | None]:
        """The state after a stick of duration `h` (s), and its relative error or None."""
        raise NotImplementedError("of models whose `flow_and_error` asks for it")

    def flow_and_error(
        self, forcing: F, y: State, h: FloatScalar, sign: FloatArray
    ) -> tuple[State, FloatScalar | None]:
        sticking = sign == 0
        # Both modes are computed, one is chosen. A slip over a stick's long step may overflow: it gets no length.
        slid, error = self.slip(forcing, y, jnp.where(sticking, 0, h), sign)
        held, error_held = self.stick(forcing, y, h)
        state = chosen_state(sticking, held, slid)
        if error is None and error_held is None:
            return state, None
        return state, jnp.where(sticking, 0 if error_held is None else error_held, 0 if error is None else error)

    @abc.abstractmethod
    def on_base(self, forcing: F, y: State) -> State:
        """The state at `tau` 0 with the relative velocity made exactly zero."""

    @abc.abstractmethod
    def can_stick(self, forcing: F, y: State) -> BoolScalar:
        """Whether friction can hold a stick at `tau` 0, the relative velocity being zero."""

    @abc.abstractmethod
    def release_sign(self, forcing: F, y: State) -> FloatScalar:
        """The sign of the relative velocity after a release at `tau` 0."""

    def at_base_velocity(self, forcing: F, y: State, resting: BoolArray) -> State:
        """The state at `tau` 0 with the relative velocity made exactly zero where contacts are `resting`."""
        return chosen_state(resting, self.on_base(forcing, y), y)

    def decided(self, forcing: F, y: State, question: Question) -> Decision:
        """What friction does at `tau` 0 with the contact, which asks nobody else."""
        on_base = self.on_base(forcing, y)
        none = jnp.zeros_like(on_base[0])
        guard, rate = self.guard(forcing, none, on_base, none)
        return Decision(self.can_stick(forcing, on_base), self.release_sign(forcing, on_base), guard, rate)

    @property
    @abc.abstractmethod
    def friction(self) -> FrictionLaw:
        """The friction law of the contact."""

    def friction_at(self, y: State) -> FrictionLaw:
        """The friction law by the `relative_velocity` in the state `y`, of which it may depend on the position."""
        return self.friction

    def position(self, y: State) -> FloatScalar:
        """Where the mass is on the ground, m."""
        return y[0]

    def to_inner_law(self, y: State) -> FloatPair | tuple[float, float]:
        """What a law with an inner state, of this contact, takes and gives, by what the engines do.

        Returns:
            Its velocity over the `relative_velocity`, and the coefficient of `rates_under` over its coefficient.
        """
        return 1.0, 1.0

    @abc.abstractmethod
    def rates_under(self, forcing: F, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        """The time derivative of the state under this signed friction coefficient; affine in it."""

    def slip_direction(self, y: State, sign: FloatScalar) -> FloatScalar:
        """The sign that the friction coefficient of `rates_under` has in a slip of this `sign`."""
        return sign

    @abc.abstractmethod
    def relative_acceleration(self, forcing: F, tau: FloatScalar, y: State, rates: State) -> FloatScalar:
        """The time derivative of the relative velocity, where the state changes with `rates`, m/s^2."""

    def effect_of_friction(self, forcing: F, tau: FloatScalar, y: State) -> FloatPair:
        """The relative acceleration without friction, and what a friction coefficient of 1 adds to it, m/s^2."""
        free, under_one = (
            self.relative_acceleration(forcing, tau, y, self.rates_under(forcing, tau, y, jnp.full_like(tau, number)))
            for number in (0.0, 1.0)
        )
        return free, under_one - free

    def holding_coefficient(self, forcing: F, tau: FloatScalar, y: State) -> FloatScalar:
        """The signed friction coefficient that keeps the relative velocity constant; 0 where friction has no effect."""
        free, gain = self.effect_of_friction(forcing, tau, y)
        return jnp.where(gain != 0, -free / jnp.where(gain != 0, gain, 1), 0)

    def coefficient_in(self, forcing: F, y: State, sign: FloatScalar, sticks: BoolScalar) -> FloatScalar:
        """The signed friction coefficient at `tau` 0 in a stick, or in a slip of this sign."""
        none = jnp.zeros_like(y[0])
        velocity = self.relative_velocity(forcing, none, y)
        slip = self.slip_direction(y, sign) * self.friction_at(y).slip_coefficient(velocity)
        return jnp.where(sticks, self.holding_coefficient(forcing, none, y), slip)


# Friction forces and energies: what is stored, supplied and dissipated.


Terms: TypeAlias = dict[str, FloatScalar]
"""Energies (J) or powers (W) by name."""


class Powers(NamedTuple):
    """Powers at one instant, W: what the excitation supplies, and what is turned into heat, each by its name."""

    supplied: Terms
    dissipated: Terms


class HasEnergies(SwitchedModel[F]):
    """A model whose equations are those of a system with an energy."""

    @abc.abstractmethod
    def friction_forces(self, forcing: F, y: State, sign: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The friction force in each contact, against its relative velocity, N, and that velocity, m/s, at `tau` 0.

        Of contacts behind springs those of the sliders.
        """

    def base_shear(self, forcing: F, total: FloatArray) -> FloatScalar:
        """The force that the ground and the base exert on the masses, which have these `total` accelerations, N."""
        raise NotImplementedError("of systems that do not name it")

    def observed(self, forcing: F, y: State, sign: FloatArray) -> State:
        """The numbers that `System.observed` names, at `tau` 0 in the mode of this `sign`."""
        accelerations = self.rates(forcing, jnp.zeros_like(y[0], shape=()), y, sign)[1]
        total = accelerations + cast(Forcing, forcing).ground[0]
        force, velocity = self.friction_forces(forcing, y, sign)
        each = accelerations, total, velocity, -force, self.base_shear(forcing, total)
        return tuple(number for values in each for number in (values if jnp.ndim(values) else (values,)))

    @abc.abstractmethod
    def stored_energies(self, y: State) -> Terms:
        """The energies stored in the state, J."""

    @abc.abstractmethod
    def powers_in(self, forcing: F, y: State, sign: FloatArray) -> Powers:
        """The powers in the state `y` of this mode; their sum is the rate of what is stored."""

    @property
    def fastest_decay(self) -> Scalar:
        """The rate at which the fastest motion in a slip may die out within a step, 1/s; 0 where steps are shorter."""
        return 0.0

    def check_energy(self) -> None:
        """Check that the equations of motion have an energy. Raises ValueError otherwise."""


class EnergyModel(HasEnergies[F], OneContactModel[F]):
    """A model with one contact, whose friction is known in newtons."""

    @abc.abstractmethod
    def friction_force(self, y: State, coefficient: FloatScalar) -> FloatScalar:
        """The friction force under this signed friction coefficient, N: on the mass, of a motor on the cart."""

    def friction_forces(self, forcing: F, y: State, sign: FloatArray) -> tuple[FloatArray, FloatArray]:
        force = self.friction_force(y, self.coefficient_in(forcing, y, sign, sign == 0))
        # The power of friction is linear in the force, and minus the velocity its slope.
        velocity = -self.powers(forcing, y, jnp.ones_like(force)).dissipated["friction"]
        return -force, jnp.where(sign == 0, 0, velocity)

    def powers_in(self, forcing: F, y: State, sign: FloatArray) -> Powers:
        return self.powers(forcing, y, -self.friction_forces(forcing, y, sign)[0])

    @abc.abstractmethod
    def powers(self, forcing: F, y: State, force: FloatScalar) -> Powers:
        """The powers in the state `y` under the friction force `force` (N)."""


def require_energy_model(model: Any, name: str) -> None:
    """Check that friction forces of `model` are known in newtons, not only as shares. Raises ValueError otherwise."""
    holders = [kind for kind in type(model).__mro__ if "stored_energies" in vars(kind)]
    rates = [rate for rate in ("rates", "rates_under") if hasattr(model, rate)]
    if not isinstance(model, HasEnergies) or not keeps(model, holders[0], *rates):
        raise ValueError(
            f"{name} needs a MassSpring, a MotorCart or a LinearStructure, but a simulation of "
            f"{checks.show(getattr(model, 'system', model))} was given: the friction of a system of your own is known "
            "as a share of its largest kinetic force only."
        )
