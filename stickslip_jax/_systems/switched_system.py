"""Systems of a user's own: any ordinary differential equations with dry-friction contacts; and how they are checked."""

import abc
import contextlib
import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array

from .._excitation.excitation import Excitation
from .._excitation.motion import Signal
from .._excitation.recorded import ForceSteps
from .._foundation import checks
from .._foundation import lazy_diffrax as diffrax
from .._foundation.fields import keeps
from .._foundation.types import (
    AnyArray,
    ExplicitSolver,
    FloatArray,
    FloatScalar,
    InitialState,
    Number,
    Scalar,
    Solver,
    State,
)
from .dynamic_friction import DynamicFriction
from .memory_models import AgeingContact, AgeingContacts, InnerStates, with_ages
from .structure import is_singular
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
from .users_models import (
    GeneralContactsModel,
    GeneralModel,
    UsersBase,
    compiled_numbers,
    compiled_velocities,
    depends_on_time,
    differs_between,
    numbers_of,
    records_in,
    shares,
    springs_of,
    velocities_of,
)

_MOST_CONTACTS = 64


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

    Numbers of the state that jump where a stick or a slip begins (counters, wear, a slip distance) are given by
    `at_stick` and `at_slip`.

    Springs in front of contacts, such as those of friction dampers, are given by `series_stiffness`.

    Laws with an inner state, such as `LuGre`, are named by `inner_laws`; static friction that grows while a stick lasts
    by `static_ratio_after`.

    The position of a stick is the first number of the state. Figures label their axes by `state_names`; override
    `coordinates` and `look` (a `plot.Look`) to change what they show.

    `simulate` and `simulate_ensemble` raise ValueError for an instance that breaks these rules in the initial state
    with the base at rest. Any base velocity may excite the system, and any ground acceleration if `rates` uses
    ``base.ground``.

    Raises:
        ValueError: For a field with a name that the package uses itself, such as `rates` or `tracks`.
    """

    def check_parts(self) -> None:
        for field in dataclasses.fields(self):
            is_taken = hasattr(SwitchedSystem, field.name) and field.name not in _GIVEN_BY_FIELDS
            if is_taken and field not in dataclasses.fields(SwitchedSystem):
                raise ValueError(
                    f"Argument {field.name} of a {type(self).__name__} must have another name, because {field.name} is "
                    "what the package asks of every system; rename the field."
                )

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
    def series_stiffness(self) -> Number | FloatArray | tuple[Number | None, ...] | None:
        """Springs in front of the contacts, as in friction dampers: sliders without mass at their ends stick and slip.

        One number for all `contacts`, or one for each, None without a spring: by how much `friction` grows with each
        metre (or rad) that the spring is longer. With rates that multiply `friction` by ``mu N`` that is ``k / (mu N)``
        of a spring of k N/m; with `normal_forces`, ``k / mu``. `friction` is then the force of the spring, at most the
        limit; that must not depend on velocities. The elongations, positive where a positive relative velocity made
        them, are part of the state, after the numbers that `state_names` lists; `rates` and the other methods do not
        see them. Dynamics is exact: ``Exact()``.
        """
        return None

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

    def at_stick(
        self, t: FloatScalar, y: State, base: UsersBase, contact: int
    ) -> tuple[FloatScalar | float, ...] | State:
        """The state with which a stick begins: counters, wear, heat, a distance that begins anew; here `y`.

        Asked in every step, and taken where a stick begins; not at the beginning of a simulation, which may go on from
        another. Relative velocities and base must be left as they are. Whether friction holds what comes to rest is
        decided in this state. Derivatives pass through it.

        Args:
            t: Time, s.
            y: The state before, a tuple of scalars.
            base: As of `rates`.
            contact: The number of the contact whose stick begins, from 0; 0 of a system with one.

        Returns:
            As many scalars as the state has.
        """
        return y

    def at_slip(
        self, t: FloatScalar, y: State, base: UsersBase, contact: int
    ) -> tuple[FloatScalar | float, ...] | State:
        """The state with which a slip begins, after a stick or in the other direction; as `at_stick`."""
        return y

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
        begins_anew = not keeps(self, SwitchedSystem, "at_stick", "at_slip")
        # Two motions of which one stops where the other just does not go on from different states.
        return Traits(stops_are_unstable=self.stops_are_unstable or begins_anew, begins_anew=begins_anew)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return *map(Coordinate.of, self.state_names), *self.memory.coordinates

    @property
    def memory(self) -> Memory:
        ages = ()
        if type(self).static_ratio_after is not SwitchedSystem.static_ratio_after:
            ages = (AGE,) if self.contacts is None else ages_of(self.contacts)
        elongations = (Coordinate(f"elongation {i}", "m", f"e_{{{i}}}")
                       for i, spring in enumerate(springs_of(self)) if spring is not None)  # fmt: skip
        return Memory(ages, self.inner_laws, elongations=tuple(elongations))

    @property
    def tracks(self) -> Tracks:
        return Tracks(self.contacts, self._counted)

    @property
    def has_static_ratio(self) -> bool:
        """Whether a static ratio is given."""
        return type(self).static_ratio is not SwitchedSystem.static_ratio

    @property
    def has_normal_forces(self) -> bool:
        """Whether normal forces are given as functions."""
        return type(self).normal_forces is not SwitchedSystem.normal_forces

    @property
    def static_exceeds_kinetic(self) -> bool:
        ratio = self.static_ratio
        if self.memory.ages or checks.is_traced(ratio):
            return True
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
        kind = GeneralModel if self.contacts is None else GeneralContactsModel
        return kind(system=self, smooth=smooth, solver=diffrax.Dopri8() if solver is None else solver)

    def inner_model(self, smooth: Signal | None) -> InnerStates | None:
        if not self.inner_laws:
            return None
        return InnerStates(self.model_without_ages(smooth, None), len(self.state_names), self.inner_laws)

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
        state = (1.0,) * (len(self.state_names) + len(memory.elongations) + len(memory.ages))
        deceleration = None if speed is None or time is None else speed / time
        return Sizes(speed, deceleration, (*state, *memory.state_scales))

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


# Checks of a user's `SwitchedSystem`, as far as it can be checked before it is simulated.


_ONE_CONTACT = (
    "declare the number of dry-friction contacts, contacts = 2, or smooth the force of another one, "
    "F jax.numpy.tanh(v / width) with a small width."
)
_BY_DIRECTION = (
    "where friction differs with the direction of sliding, leave the normal force as it is and give the contact a "
    "Directional friction law, or smooth the step, jax.numpy.tanh(v / width)."
)
_NEARER, _JUMP = 0.1, 0.9  # a rate that changes by as much over a tenth of a small step jumps
_GIVEN_BY_FIELDS = (
    "contacts", "coordinates", "inner_laws", "natural_frequency", "series_stiffness", "shortest_time", "speed_scale",
    "state_names", "static_ratio", "stick_position", "stops_are_unstable",
)  # fmt: skip
"""Properties that a class of a user's own may give by a field as well."""
AFFINE = 1e-3  # of the largest rate: far above round-off in float32, far below any law that is not affine


def check_fields(system: Any) -> None:
    """Check the fields and properties of `system`. Raises ValueError for what does not fit."""
    kind = type(system).__name__
    for path, leaf in jax.tree_util.tree_leaves_with_path(system):
        if not isinstance(leaf, (int, float, np.ndarray, np.generic, jax.Array)):
            field = jax.tree_util.keystr(path).lstrip(".")
            hint = f"declare a field of another kind as {field}: ... = equinox.field(static=True)"
            raise checks.refused(f"{field} of a {kind}", "be a number or an array", leaf, hint)
    if system.has_normal_forces and system.contacts is None:
        raise ValueError(
            f"Argument normal_forces of a {kind} must come with the number of its contacts, but "
            "contacts is None, and nobody would ask for it: declare contacts = 1, or more."
        )
    names = system.state_names
    if not isinstance(names, tuple) or len(names) < 2 or not all(isinstance(name, str) for name in names):
        raise checks.refused(f"state_names of a {kind}", "be a tuple of two names or more", names)
    with checks.traceable(f"The property static_ratio of {kind}"):
        ratio = system.static_ratio
    if system.contacts is None:
        checks.numeric("static_ratio", ratio)
    elif np.shape(ratio) not in ((), (checks.whole_number("contacts", system.contacts, maximum=_MOST_CONTACTS),)):
        raise checks.refused("static_ratio", f"be one number or an array ({system.contacts},)", ratio)
    if not checks.is_traced(ratio) and np.min(np.asarray(ratio)) < 1:
        raise ValueError(
            f"Argument static_ratio must be at least 1, but {ratio} was given: a stick holds at least as "
            "well as a slip."
        )
    if system.memory.ages:
        _check_ages(system)
    _check_inner_laws(system)
    _check_springs(system)
    remembered = system.memory.coordinates
    if remembered and system.coordinates[len(names) :] != remembered:
        raise ValueError(
            f"Argument coordinates of a {kind} must end with the inner states of its laws, the ages of its sticks and "
            "the elongations of its springs: add *self.memory.coordinates."
        )
    for name in ("shortest_time", "speed_scale"):
        with checks.traceable(f"The property {name} of {kind}"):
            value = getattr(system, name)
        if value is not None:
            checks.positive(name, value)


def _check_inner_laws(system: Any) -> None:
    """Check the `inner_laws` of a system, if it has some."""
    kind, laws, number = type(system).__name__, system.inner_laws, system.contacts or 1
    if not isinstance(laws, tuple) or not all(isinstance(law, DynamicFriction) for law in laws):
        demand = "be a tuple of friction laws with an inner state, such as LuGre"
        raise checks.refused(f"inner_laws of a {kind}", demand, laws, "other laws are written in rates")
    if laws and len(laws) != number:
        raise ValueError(
            f"Argument inner_laws of a {kind} must hold a law for each of its contacts, {number}, but {len(laws)} were "
            "given."
        )
    ratio = system.static_ratio
    if laws and (system.memory.ages or (not checks.is_traced(ratio) and np.max(np.asarray(ratio)) > 1)):
        raise ValueError(
            f"Argument inner_laws of a {kind} must come without static_ratio and static_ratio_after, those of exact "
            "sticks, but both were given; keep one of them."
        )


def _check_springs(system: Any) -> None:
    """Check the `series_stiffness` of a system."""
    kind, springs, memory = type(system).__name__, springs_of(system), system.memory
    if all(spring is None for spring in springs):
        return
    if system.contacts is None or memory.ages or memory.laws:
        demand = "come with a number of contacts, contacts = 1 or more, and without inner_laws and static_ratio_after"
        raise checks.refused(f"series_stiffness of a {kind}", demand, system.series_stiffness)
    if len(springs) != system.contacts:
        demand = f"be one number, or {system.contacts}, one for each contact (None without a spring)"
        raise checks.refused(f"series_stiffness of a {kind}", demand, system.series_stiffness)
    for spring in springs:
        if spring is not None:
            checks.positive("series_stiffness", spring)


def _check_ages(system: Any) -> None:
    """Check `static_ratio_after` and the coordinates of a system whose friction grows with the ages of sticks."""
    kind, shape = type(system).__name__, () if system.contacts is None else (system.contacts,)
    with checks.traceable(f"The method static_ratio_after of {kind}"):
        jax.make_jaxpr(system.static_ratio_after)(jnp.zeros(shape))
    now, later = (system.static_ratio_after(jnp.full(shape, age)) for age in (0.0, 1.0))
    if checks.is_traced(now) or checks.is_traced(later):
        return
    now, later = np.asarray(now), np.asarray(later)
    if not np.all(np.isfinite(later) & (later >= now) & (now >= 1)):
        raise ValueError(
            f"Argument static_ratio_after of a {kind} must return finite numbers, at least 1, that do not fall with "
            f"the age, but {checks.show(now)} was returned for the age 0 s, and {checks.show(later)} for 1 s."
        )


def check_motion(system: Any, y0: tuple[Number, ...]) -> None:
    """Check the methods of `system`, a `SwitchedSystem`, in the state `y0` at time 0, with the base at rest.

    Raises ValueError for what they must not return, and for contacts whose motion is not unique.
    """
    kind, zero = type(system).__name__, jnp.zeros(())
    y, base = tuple(jnp.asarray(value, float) for value in y0), UsersBase(zero, zero, zero)
    tried = _kind_of((system, y))
    is_new = tried not in _TRIED
    if is_new:
        _check_methods(system, y, base)
    if any(checks.is_traced(leaf) for leaf in jax.tree.leaves((system, y))):
        return
    # Of another system like one that was tried, only the numbers are looked at, by compiled functions.
    velocities, gradients = (velocities_of if is_new else compiled_velocities)(system, y, base)
    if checks.is_traced(velocities) or checks.is_traced(gradients):  # its class encloses a number that JAX traces
        return
    velocities, gradients = np.asarray(velocities, float), np.asarray(gradients, float)
    near = Near.of(y) if system.contacts is None else Near.of(y, velocities, gradients)
    rates, near_rates, near_forces = (numbers_of if is_new else compiled_numbers)(system, y, base, near.columns)
    if any(map(checks.is_traced, (rates, near_rates, near_forces))):
        return
    near.check(kind, np.asarray(near_rates))
    if system.has_normal_forces:
        near.check(kind, np.asarray(near_forces), "normal_forces", _BY_DIRECTION)
    rigid = np.array([spring is None for spring in springs_of(system)])
    _check_affine(kind, np.asarray(rates, float), gradients, system.contacts, rigid)
    if tried is not None:
        _TRIED[tried] = None
        if len(_TRIED) > _MOST_TRIED:  # the oldest is forgotten
            _TRIED.pop(next(iter(_TRIED)), None)  # another thread may have been first


_MOST_TRIED = 256
_TRIED: dict[Any, None] = {}
"""The kinds of systems whose methods were tried, with their states."""


def _kind_of(tree: Any) -> Any:
    """What can be told of `tree` without its numbers, to be looked up; None where a static field cannot be hashed."""
    leaves, structure = jax.tree.flatten(tree)
    with contextlib.suppress(TypeError):
        hash(structure)
        return structure, tuple((np.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
    return None


def _check_methods(system: Any, y: tuple[Array, ...], base: UsersBase) -> None:
    """Check what the methods of `system` take and return."""
    kind, zero = type(system).__name__, jnp.zeros(())
    check_traceable(system, ("shortest_time", "static_ratio", "speed_scale"))
    for name in ("relative_velocity", "normal_forces") if system.has_normal_forces else ("relative_velocity",):
        check_traceable(system, (name,), zero, y, base)
        _check_number(kind, name, getattr(system, name)(zero, y, base), system.contacts)
    check_belt(system, y, base)
    for name in ("at_stick", "at_slip"):
        with checks.traceable(f"The method {name} of {kind}"):
            after = [getattr(system, name)(zero, y, base, contact) for contact in range(system.contacts or 1)]
        for state in after:
            check_rates(kind, state, len(y), name)
            _check_same_velocity(system, y, base, tuple(state), name)
    given = shares(system.contacts)
    try:
        with checks.traceable(f"The method rates of {kind}"):
            rates = [system.rates(zero, y, base, jnp.asarray(share)) for share in given]
            jax.make_jaxpr(type(system).rates)(_as_traced(system), zero, y, base, jnp.asarray(given[0]))
    except (IndexError, TypeError) as error:
        takes_two = False
        with contextlib.suppress(Exception):  # of a user's code
            takes_two = system.rates(zero, y, base, jnp.zeros(2)) is not None
        if system.contacts is not None or not takes_two:
            raise
        raise ValueError(
            f"Argument rates of a {kind} must take one number as friction, but it takes several; {_ONE_CONTACT}"
        ) from error
    except ValueError as error:  # rates unpacks the state into another number of variables
        if isinstance(error.__cause__, (TypeError, jax.errors.JAXTypeError)):
            raise
        raise ValueError(
            f"Argument rates of a {kind} must accept a state of {len(y)} numbers, but: {error}."
        ) from error
    check_rates(kind, rates[0], len(y))


def _check_number(kind: str, name: str, values: Any, contacts: int | None) -> None:
    """Check that the method `name` returned a number for each of the contacts; a scalar for one contact."""
    listed = isinstance(values, (tuple, list))
    shapes = [np.shape(value) for value in values] if listed else [()] * np.size(values)
    if contacts is not None and (len(shapes) != contacts or any(shapes)):
        demand = f"return {contacts} numbers, one for each of its contacts"
        raise checks.refused(f"{name} of a {kind}", demand, values)
    if contacts is None and (listed or len(shapes) > 1):
        raise ValueError(
            f"Argument {name} of a {kind} must return one number, but {len(shapes)} were given; {_ONE_CONTACT}"
        )
    if contacts is None and not _is_scalar(values):
        raise checks.refused(f"{name} of a {kind}", "return a scalar", values)


def check_traceable(system: Any, names: tuple[str, ...], *args: Any) -> None:
    """Check that JAX can trace the numbers of `system` in these properties, or methods that take `args`.

    Raises ValueError, also for what its known numbers alone do not allow.
    """
    kind = type(system).__name__
    for name in names:
        with checks.traceable(f"The {'method' if args else 'property'} {name} of {kind}"):
            jax.make_jaxpr(partial(_asked, name))(_as_traced(system), *args)


def _asked(name: str, system: Any, *args: Any) -> Any:
    return getattr(system, name)(*args) if args else getattr(system, name)


def _as_traced(system: Any) -> Any:
    """`system` as engines hold it: its numbers are arrays that JAX traces."""
    return jax.tree.map(jnp.asarray, system)


def check_belt(system: Any, y: tuple[Array, ...], base: UsersBase) -> None:
    """Check that the relative velocity does not jump with a `ForceSteps`: sticks would not see it."""

    def is_steps(value):
        return isinstance(value, ForceSteps)

    leaves, tree = jax.tree.flatten(system, is_leaf=is_steps)
    steps = [leaf for leaf in leaves if is_steps(leaf)]

    def velocity(steps):
        own = iter(steps)
        known = jax.tree.unflatten(tree, [next(own) if is_steps(leaf) else leaf for leaf in leaves])
        return known.relative_velocity(jnp.zeros(()), y, base)

    if steps and _uses(velocity, steps):
        raise ValueError(
            f"Argument relative_velocity of a {type(system).__name__} must not use a ForceSteps, which is a force that "
            "jumps; a base that jumps is the argument base, a VelocitySteps."
        )


def _uses(function: Callable[[Any], Any], argument: Any) -> bool:
    """Whether `function` looks at its argument."""
    jaxpr = jax.make_jaxpr(function)(argument).jaxpr
    used = [*jaxpr.outvars, *(atom for equation in jaxpr.eqns for atom in equation.invars)]
    return any(atom is given for atom in used for given in jaxpr.invars)


def check_ground(system: Any) -> None:
    """Check that the rates of `system` use the acceleration of the ground, which excites it. Else raises ValueError."""
    kind, zero = type(system).__name__, jnp.zeros(())
    friction = zero if system.contacts is None else jnp.zeros(system.contacts)

    def rates(ground):
        return system.rates(zero, (zero,) * len(system.state_names), UsersBase(zero, zero, ground), friction)

    with checks.traceable(f"The method rates of {kind}"):
        is_used = _uses(rates, zero)
    if not is_used:
        raise ValueError(
            f"Argument base of a {kind} must be a base velocity, but a ground acceleration was given, and rates does "
            "not use base.ground; subtract it from the rate of each velocity relative to the ground."
        )


def _check_same_velocity(system: Any, y: tuple[Array, ...], base: UsersBase, after: Any, name: str) -> None:
    """Check that the state `after` a method is one with the same relative velocities."""
    old, new = (jnp.asarray(system.relative_velocity(jnp.zeros(()), state, base), float) for state in (y, after))
    if not checks.is_traced(new) and not checks.is_traced(old) and not np.allclose(old, new, rtol=AFFINE):
        raise ValueError(
            f"Argument {name} of a {type(system).__name__} must leave relative velocities as they are, but it makes "
            f"{checks.show(new)} of {checks.show(old)}; impacts are not followed."
        )


def check_rates(kind: str, rates: object, size: int, name: str = "rates") -> None:
    if not isinstance(rates, (tuple, list)) or len(rates) != size:
        shown = f"{len(rates)}" if isinstance(rates, (tuple, list)) else checks.show(rates)
        raise ValueError(
            f"Argument {name} of a {kind} must return a tuple of {size} numbers, one for each of state_names, but "
            f"{shown} was given."
        )
    for number, rate in enumerate(rates):
        if not _is_scalar(rate):
            raise ValueError(
                f"Argument {name} of a {kind} must return scalars, but number {number} of shape {np.shape(rate)} was "
                "given."
            )


class Near:
    """States close to those where a number of the state passes zero, its initial value, another number, or the value
    with which a contact does not slide.

    There the sign of a velocity changes that somebody writes for a contact: nothing must jump there.
    """

    def __init__(self, places: list[tuple[int, float]], columns: tuple[AnyArray, ...]):
        self.places, self.columns = places, columns

    @classmethod
    def of(cls, y: tuple[Array, ...], velocities: npt.ArrayLike = (), gradients: npt.ArrayLike = ()) -> "Near":
        """Those of the initial state `y`: four at each place, two on either side.

        `velocities`, `gradients`: of the contacts (contacts,), and their derivatives by the state (contacts, states).
        """
        values = [float(value) for value in y]
        centres = [{0.0, *values} for _ in y]
        for velocity, gradient in zip(np.asarray(velocities), np.asarray(gradients), strict=True):
            for i in np.flatnonzero(gradient):
                centres[i].add(float(values[i] - velocity / gradient[i]))
        places = [(i, centre) for i, found in enumerate(centres) for centre in sorted(found) if np.isfinite(centre)]
        step = float(np.sqrt(np.finfo(y[0].dtype).eps)) * max(1.0, *map(abs, values))
        near = np.array(values) * np.ones((len(places), 4, 1))
        for row, (i, centre) in zip(near, places, strict=True):
            row[:, i] = centre + step * np.array([-1.0, 1.0, -_NEARER, _NEARER])
        return cls(places, tuple(near.reshape(-1, len(y)).T.astype(y[0].dtype)))

    def check(self, kind: str, found: np.ndarray, name: str = "rates", hint: str = _ONE_CONTACT) -> None:
        """Check the numbers (places, numbers) `found` there by the method `name`: that they do not jump."""
        rates = found.reshape(len(self.places), 4, -1)
        far, close = np.abs(rates[:, 1] - rates[:, 0]), np.abs(rates[:, 3] - rates[:, 2])
        most = np.max(np.abs(rates), axis=(0, 1), where=np.isfinite(rates), initial=0.0)
        jumps = (close > _JUMP * far) & (close > AFFINE * most)
        if not np.any(jumps):
            return
        place, number = (int(index) for index in np.argwhere(jumps)[0])
        state, centre = self.places[place]
        raise ValueError(
            f"Argument {name} of a {kind} must be smooth functions of the state, but {name.replace('_', ' ')[:-1]} "
            f"number {number} jumps from {rates[place, 2, number]:.6g} to {rates[place, 3, number]:.6g} where number "
            f"{state} of the state passes {centre:g}; {hint}"
        )


def _check_affine(kind: str, rates: np.ndarray, gradients: np.ndarray, contacts: int | None, rigid: np.ndarray) -> None:
    """Check that `rates` (shares, states) at the `shares` of friction are affine in them, that friction opposes the
    sliding, and that the `rigid` contacts have one motion. `gradients`: of relative velocities by the state.
    """
    if not np.all(np.isfinite(rates)):
        return  # the status of the simulation reports it
    idle, half, number = rates[0], rates[1], contacts or 1
    effects, backward = rates[2 : 2 + number] - idle, idle - rates[2 + number :]
    bend = np.maximum(np.abs(2 * (half - idle) - np.sum(effects, axis=0)), np.max(np.abs(effects - backward), axis=0))
    size = np.sum(np.abs(effects), axis=0)
    wrong = np.flatnonzero((bend > AFFINE * size) & (bend > 1e-5 * np.max(np.abs(rates), axis=0)))
    if len(wrong):
        form = "a + b friction" if contacts is None else "a + b_0 friction[0] + b_1 friction[1] + ..."
        values = ", ".join(
            f"{rate:.6g} at {' '.join(f'{one:g}' for one in np.atleast_1d(share))}"
            for share, rate in zip(shares(contacts), rates[:, wrong[0]], strict=True)
        )
        raise ValueError(
            f"Argument rates of a {kind} must be affine in friction, {form}, but rate number {wrong[0]} is {values}; "
            "multiply each kinetic friction force by its friction, and nothing else."
        )
    terms = gradients[:, None] * (effects + backward) / 2  # (velocities, frictions, states)
    by_friction, sizes = np.sum(terms, axis=-1), np.sum(np.abs(terms), axis=-1)
    for i, (own, size) in enumerate(zip(np.diag(by_friction), np.diag(sizes), strict=True)):
        if own > AFFINE * size or (contacts is not None and own >= 0):
            name, of = ("friction", "") if contacts is None else (f"friction[{i}]", f" number {i}")
            raise ValueError(
                f"Argument rates of a {kind} must let positive friction act against a positive relative velocity, but "
                f"{name} = 1 changes the rate of relative velocity{of} by {own:.6g}; turn its sign round, or leave out "
                "a contact that moves nothing."
            )
    eigenvalues = np.linalg.eigvalsh(-(by_friction + by_friction.T)[rigid][:, rigid] / 2)
    if contacts is not None and len(eigenvalues) and is_singular(eigenvalues):
        raise ValueError(
            f"Argument rates of a {kind} must have one motion only, but the effects of the friction forces on the "
            "relative velocities are no positive definite matrix (smallest eigenvalue "
            f"{eigenvalues[0]:.4g}): a contact is implied by others, or friction changes its own normal force too "
            "much; join or leave out such contacts."
        )


def _is_scalar(value: object) -> bool:
    return isinstance(value, (int, float, np.generic, np.ndarray, jax.Array)) and np.ndim(value) == 0
