"""Linear structures with dry-friction contacts: masses, springs and dampers as matrices, and their motion."""

import math
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._compiler.programs import kept_jit
from .._excitation.excitation import Excitation
from .._excitation.motion import RandomPhase, RandomSignal, Signal
from .._excitation.piecewise_constant import VelocitySteps
from .._excitation.segments import SegmentLaw
from .._foundation import checks
from .._foundation import lazy_diffrax as diffrax
from .._foundation.fields import with_fields
from .._foundation.types import (
    BoolScalar,
    ExplicitSolver,
    FloatArray,
    FloatScalar,
    Solver,
)
from .._numerics.derivatives import without_derivatives
from .._numerics.matrices import (
    WRITTEN_OUT,
    dense,
    largest_eigenvalue,
    linear_solve,
    stacked,
)
from .contacts import (
    Alike,
    Contact,
    Forces,
    NormalForce,
    entries_of,
    is_function,
    kinds_in,
    largest_of,
    laws_in,
    numbers_of,
    periods_of,
    recorded_in,
)
from .contacts_model import Uncoupled
from .friction import least
from .layouts import blocks, disks, storeys
from .memory_models import (
    AgeingContacts,
    InnerStates,
    WeakeningContacts,
    inner_laws_of,
    weakening_laws_of,
    with_ages,
)
from .structure_models import ArcsModel, Matrices, StructureModel
from .system import (
    PERIOD,
    SOFT,
    SOLVED,
    Coordinate,
    Look,
    Mechanism,
    Memory,
    RecordedForces,
    Sizes,
    TimeScale,
    TimeScales,
    Tracks,
    Traits,
    WithContacts,
    ages_of,
    bars,
    observed_of,
    shortest_period,
)

# Checks of the arguments of a `LinearStructure`.


MOST_CONTACTS = 1000
_MOST_DAMPED, _MOST_IN_CACHE = 6, 40  # masses, of which 256 lanes move in lock step
_ROUND_OFF = 1e-10  # of the largest entry of a matrix
_LEAST = 1e-12  # the smallest eigenvalue over the largest: a smaller one is round-off


def check_structure(mass: Any, stiffness: Any, damping: Any, contacts: Any, force: Any) -> None:
    """Raises ValueError for matrices and contacts that do not fit each other, or have no unique motion."""
    size = _check_matrix("mass", mass, None)
    _check_matrix("stiffness", stiffness, size)
    if damping is not None:
        _check_matrix("damping", damping, size)
    if not checks.is_traced(mass):
        values = np.asarray(mass, float)
        eigenvalues = np.sort(values) if values.ndim == 1 else np.linalg.eigvalsh(values)
        if is_singular(eigenvalues):
            raise ValueError(
                f"Argument mass must be positive definite, but its smallest eigenvalue is {eigenvalues[0]:.4g} beside "
                f"the largest, {eigenvalues[-1]:.4g}; leave out coordinates without mass."
            )
    _check_contacts(mass, contacts, size)
    check_forces("force", force, size)


def check_forces(name: str, forces: Any, size: int) -> None:
    """Raises ValueError unless `forces` is None, or a tuple with one for each of `size` masses."""
    if forces is None:
        return
    if not isinstance(forces, tuple) or len(forces) != size:
        raise checks.refused(name, f"be a tuple of {size} forces, one for each mass (None for no force)", forces)
    for number, part in enumerate(forces):
        if part is not None and not is_function(part):
            try:
                checks.bounded(f"{name}[{number}]", part)
            except ValueError:
                demand = "be a number, a Signal, a Recorded, a ForceSteps or None"
                raise checks.refused(f"{name}[{number}]", demand, part) from None


def is_uncoupled(mass: Any, contacts: tuple[Contact, ...]) -> bool:
    """Whether no two contacts have an effect on each other; False where it is not known."""
    contacts = rigid_of(contacts)
    if any(checks.is_traced(value) for value in (mass, *(contact.direction for contact in contacts))):
        return not contacts
    gain = _gain(mass, contacts) if contacts else np.zeros((0, 0))
    return bool(np.all(gain == np.diag(np.diag(gain))))


def rigid_of(contacts: tuple[Contact, ...]) -> tuple[Contact, ...]:
    """Those without springs."""
    return tuple(contact for contact in contacts if contact.series_stiffness is None)


def is_singular(eigenvalues: np.ndarray) -> bool:
    """Whether the smallest of these, in order, is not positive, but for round-off."""
    return bool(eigenvalues[0] <= _LEAST * eigenvalues[-1])


def _gain(mass: Any, contacts: tuple[Contact, ...]) -> np.ndarray:
    directions = np.stack([np.asarray(contact.direction, float) for contact in contacts])
    mass = np.asarray(mass, float)
    by_force = directions.T / mass[:, None] if mass.ndim == 1 else np.linalg.solve(mass, directions.T)
    return directions @ by_force


def numbers_in(name: str, value: Any) -> Any:
    """`value` as an array of numbers; a traced one as it is. Raises ValueError for anything else."""
    if checks.is_traced(value):
        return value
    try:
        return np.asarray(checks.numbers(name, value), float)
    except ValueError:
        demand = "hold real numbers, no distributions and nothing masked; make an array of traced ones by jnp.array"
        raise checks.refused(name, demand, value) from None


def _check_matrix(name: str, value: Any, size: int | None) -> int:
    shape = np.shape(numbers_in(name, value))
    square = len(shape) == 1 or (len(shape) == 2 and shape[0] == shape[1])
    if not square or shape[0] == 0 or (size is not None and shape[0] != size):
        many = "d" if size is None else str(size)
        raise ValueError(
            f"Argument {name} must be a symmetric matrix ({many}, {many}) or its diagonal ({many},), but an array of "
            f"shape {shape} was given."
        )
    if checks.is_traced(value):
        return shape[0]
    matrix = np.asarray(value, float)
    if not np.all(np.abs(matrix) <= checks.LARGEST):
        raise checks.refused(name, f"hold finite numbers of a size up to {checks.LARGEST}", value)
    if matrix.ndim == 2 and np.max(np.abs(matrix - matrix.T)) > _ROUND_OFF * np.max(np.abs(matrix)):
        i, j = np.unravel_index(np.argmax(np.abs(matrix - matrix.T)), matrix.shape)
        raise ValueError(
            f"Argument {name} must be symmetric, but its entries [{i}, {j}] and [{j}, {i}] are {matrix[i, j]:g} and "
            f"{matrix[j, i]:g}."
        )
    return shape[0]


def _check_contacts(mass: Any, contacts: Any, size: int) -> None:
    if not isinstance(contacts, tuple) or not contacts or not all(isinstance(c, Contact) for c in contacts):
        raise checks.refused("contacts", "be a tuple of one Contact or more", contacts)
    if len(contacts) > MOST_CONTACTS:
        raise ValueError(f"Argument contacts must hold at most {MOST_CONTACTS}, but {len(contacts)} were given.")
    for number, contact in enumerate(contacts):
        if np.shape(contact.direction) != (size,):
            raise ValueError(
                f"Argument direction of contact {number} must hold {size} numbers, one for each mass, but "
                f"{np.shape(contact.direction)[0]} were given."
            )
        if contact.normal_stiffness is not None and np.shape(contact.normal_stiffness) != (size,):
            raise ValueError(
                f"Argument normal_stiffness of contact {number} must hold {size} numbers, one for each position, but "
                f"{np.shape(contact.normal_stiffness)[0]} were given."
            )
        if not checks.is_traced(contact.direction) and not np.any(np.asarray(contact.direction)):
            raise ValueError(
                f"Argument direction of contact {number} must not be zero: such a contact moves with no mass."
            )
    contacts = rigid_of(contacts)
    if not contacts or any(checks.is_traced(contact.direction) for contact in contacts):
        return  # `LinearStructure.redundant` tells the status
    # Contacts are independent if their directions are, whatever the masses.
    eigenvalues = np.linalg.eigvalsh(_gain(np.ones(size) if checks.is_traced(mass) else mass, contacts))
    if is_singular(eigenvalues):
        raise ValueError(
            "Argument contacts must be independent of each other, but the relative velocity of one is implied by "
            "others (their directions are linearly dependent); join contacts with the same direction in one."
        )


# Linear structures with dry-friction contacts: masses, springs and dampers as matrices.


BARS, BLOCKS, STOREYS = _DRAWN_AS = ("bars", "blocks", "storeys")


class LinearStructure(WithContacts):
    """Masses, springs and dampers with several dry-friction contacts: ``M x'' + C x' + K x = f + sum of friction``.

    The state is the d positions, then the d velocities. Every stick of every contact is found; `Simulation.sticks` has
    a column `contact`, and `Simulation.of_contact` the sticks of one of them. Positions of sticks are the relative
    displacements ``direction . positions``.

    Args:
        mass: kg (or kg m^2), (d, d) symmetric and positive definite, or (d,) for a diagonal one.
        stiffness: N/m (or N m/rad), (d, d) symmetric, or (d,); zeros for masses without springs.
        damping: N s/m (or N m s/rad), likewise; None is zero.
        contacts: Up to 1000, each a `Contact`.
        force: External forces, N (or N m): for each mass None, a number, a `Signal`, a `Recorded` or a `ForceSteps`;
            None for no forces.
        uncoupled: Whether friction in one contact has no effect on the relative velocity of another, which is faster.
            Found from the numbers; to be given only where JAX traces the masses or directions.
        rotates: Whether the positions are angles in rad, and the masses inertias. Directions of contacts are then
            radii in m.
        drawn_as: How `plot.animate` draws it: "blocks" in a row on a belt, "storeys" of a building over its base mat,
            or "bars", one for each coordinate. By default blocks where each contact is one of a mass with the base, as
            `Contact.of_mass`, and springs join neighbours only, else bars. With `rotates` always disks in a row.

    Raises:
        ValueError: For a mass that is singular, matrices that are not symmetric or of another size, contacts that
            couple nothing or imply each other, and another `drawn_as`.
    """

    mass: Any = eqx.field(converter=numbers_of)
    stiffness: Any = eqx.field(converter=numbers_of)
    damping: Any = eqx.field(default=None, converter=numbers_of)
    contacts: tuple[Contact, ...] = eqx.field(default=(), converter=entries_of)
    force: tuple[NormalForce | None, ...] | None = eqx.field(default=None, converter=entries_of)
    uncoupled: bool | None = eqx.field(static=True, default=None)
    rotates: bool = eqx.field(static=True, default=False)
    drawn_as: str | None = eqx.field(static=True, default=None, kw_only=True)

    def __post_init__(self):
        # Equinox converts the fields after this.
        contacts, force = entries_of(self.contacts), entries_of(self.force)
        if self.drawn_as is not None:
            checks.chosen("drawn_as", self.drawn_as, _DRAWN_AS)
        check_structure(self.mass, self.stiffness, self.damping, contacts, force)
        if self.uncoupled is None:
            object.__setattr__(self, "uncoupled", is_uncoupled(self.mass, contacts))

    @property
    def tracks(self) -> Tracks:
        return Tracks(len(self.contacts), self._counted)

    @property
    def normal_forces(self) -> Forces:
        """The normal force of each contact."""
        return tuple(contact.normal_force for contact in self.contacts)

    @property
    def functions(self) -> tuple[NormalForce, ...]:
        """The forces that are functions of time."""
        normal = self.normal_forces if isinstance(self.normal_forces, tuple) else ()
        return tuple(one for one in (*(self.force or ()), *normal) if one is not None and is_function(one))

    @property
    def recorded(self) -> RecordedForces:
        normal = self.normal_forces if isinstance(self.normal_forces, tuple) else ()
        return RecordedForces(recorded_in(self.force or ()), recorded_in(normal))

    @property
    def neighbours(self) -> np.ndarray:
        """Of which contacts a mass is the same, or joined by a spring, (contacts, contacts), true or false."""
        touched = np.stack([np.asarray(contact.direction) != 0 for contact in self.contacts]).astype(int)
        joined = (np.asarray(_matrix(self.stiffness)) != 0) | np.eye(self.size, dtype=bool)
        return touched @ joined @ touched.T > 0

    @property
    def shares_of_base(self) -> np.ndarray:
        """How much of the base's way is in the relative displacement of each contact, (contacts,)."""
        return np.array([float(contact.on_base) for contact in self.contacts])

    @property
    def size(self) -> int:
        """The number d of masses."""
        return np.shape(self.mass)[0]

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        name, unit, symbol = ("angle", "rad", r"\varphi") if self.rotates else ("position", "m", "x")
        rate = "angular velocity" if self.rotates else "velocity"
        numbers = range(self.size)  # as those of contacts and of y0
        positions = [Coordinate(f"{name} {i}", unit, f"{symbol}_{{{i}}}") for i in numbers]
        rates = (Coordinate(f"{rate} {i}", f"{unit}/s", rf"\dot {symbol}_{{{i}}}") for i in numbers)
        return *positions, *rates, *self.memory.coordinates

    @property
    def observed(self) -> tuple[Coordinate, ...]:
        return observed_of(range(self.size), range(len(self.contacts)), rotates=self.rotates)

    @property
    def memory(self) -> Memory:
        laws, elastic = laws_in(self.contacts), np.flatnonzero(self.elastic)
        springs = tuple(Coordinate(f"elongation {i}", "m", f"e_{{{i}}}") for i in elastic)
        ages = ages_of(len(laws)) if any(law.grows for law in laws) else ()
        weakening = range(len(laws)) if weakening_laws_of(laws) else ()
        slips = tuple(Coordinate(f"slip distance {i}", "m", f"s_{{{i}}}") for i in weakening)
        return Memory(ages, inner_laws_of(laws), elongations=springs, slips=slips)

    @property
    def elastic(self) -> np.ndarray:
        """Which contacts have springs in front of them, (contacts,)."""
        return np.array([contact.series_stiffness is not None for contact in self.contacts])

    @property
    def stick_position(self) -> Coordinate:
        if self.counted_contact == "all":
            return super().stick_position
        return Coordinate("relative displacement when the stick starts", "m")

    def switched_model(
        self, smooth: Signal | None, solver: ExplicitSolver | None
    ) -> "StructureModel | AgeingContacts | WeakeningContacts":
        kind = ArcsModel if solver is None and self._has_arcs(smooth) else StructureModel
        model = kind(diffrax.Dopri8() if solver is None else solver, smooth, self, self.matrices)
        times = [law.growth_time for law in laws_in(self.contacts) if law.grows]
        moving = 2 * self.size + len(self.memory.elongations)
        if self.memory.slips:
            return WeakeningContacts(model, moving)
        return with_ages(model, moving, bool(times), least(*times))

    def inner_model(self, smooth: Signal | None) -> InnerStates | None:
        laws = self.memory.laws
        if not laws:
            return None
        return InnerStates(StructureModel(diffrax.Dopri8(), smooth, self, self.matrices), 2 * self.size, laws)

    def _has_arcs(self, smooth: Signal | RandomSignal | None) -> bool:
        """Whether every mode is linear with constant coefficients, under forces of which power series are known."""
        smooth = smooth.signal if isinstance(smooth, RandomPhase) else smooth
        of_time = [one for one in (smooth, *self.functions) if isinstance(one, (Signal, RandomSignal))]
        are_known = all(isinstance(one, Signal) and one.is_harmonic for one in of_time)
        are_constant = all(one.friction.constant and not one.swings_differently for one in kinds_in(self.contacts))
        return are_known and are_constant

    def check_excitation(self, excitation: Excitation) -> None:
        super().check_excitation(excitation)
        swings = any(one.radius is not None and _is_not_zero(one.on_base) for one in kinds_in(self.contacts))
        if swings and (excitation.smooth is not None or any(map(_moves, excitation.base))):
            raise ValueError(
                "Argument base must be at rest under a contact with a radius, but it moves: a pendulum bearing pulls "
                "towards where positions are zero, those relative to the ground; take a GroundAcceleration, or a "
                "contact with on_base=0."
            )

    @property
    def matrices(self) -> Matrices:
        """What the equations of motion need of linear algebra."""
        directions = stacked([contact.direction for contact in self.contacts], jnp.result_type(float))
        by_force, by_springs, softness = _inverse_times(self.mass, directions.T), None, None
        by_position, by_pendulum, stiffness = None, None, _matrix(self.stiffness)
        if any(one.radius is not None for one in self.contacts):
            varies = np.array([one.has_varying_normal_force for one in self.contacts])
            curvatures = stacked([one.curvature for one in self.contacts], directions.dtype)
            # Where the normal force is a number, a pendulum is one more spring.
            given = [0.0 if one.has_varying_normal_force else one.normal_force for one in self.contacts]
            springs = curvatures * stacked(given, directions.dtype)
            stiffness = stiffness + directions.T @ (springs[:, None] * directions)
            if any(one.swings_differently for one in self.contacts):
                by_pendulum = by_force * jnp.where(varies, curvatures, 0)[None, :]
        if any(contact.normal_stiffness is not None for contact in self.contacts):
            rows = [contact.normal_stiffness for contact in self.contacts]
            by_position = stacked([np.zeros(self.size) if row is None else row for row in rows], directions.dtype)
        if np.any(self.elastic):
            given = [contact.series_stiffness for contact in self.contacts]
            springs = stacked([0.0 if one is None else one for one in given], directions.dtype)
            softness = jnp.where(self.elastic, 1 / jnp.where(self.elastic, springs, 1), 0)
            by_force, by_springs = by_force * ~self.elastic[None, :], by_force * springs[None, :]
        return Matrices(
            inverse_mass=_inverse_times(self.mass, jnp.eye(self.size)),
            stiffness=_inverse_times(self.mass, stiffness),
            damping=None if self.damping is None else _inverse_times(self.mass, _matrix(self.damping)),
            directions=directions,
            by_force=by_force,
            # Contacts that share no mass, directly or through the mass matrix, have no effect on each other.
            gain=Uncoupled.of(jnp.sum(directions.T * by_force, axis=0)) if self.uncoupled else directions @ by_force,
            on_base=stacked([contact.on_base for contact in self.contacts], jnp.result_type(float)),
            fastest=self.fastest,
            by_springs=by_springs,
            softness=softness,
            by_position=by_position,
            by_pendulum=by_pendulum,
        )

    def ready(self) -> "LinearStructure":
        if type(self) is not LinearStructure:  # a user's subclass may have methods of its own
            return self
        return with_fields(self, ReadyStructure, known=self.matrices.by_bands(), contacts=Alike.of(self.contacts))

    @property
    def redundant(self) -> BoolScalar | None:
        if self.uncoupled or not any(checks.is_traced(contact.direction) for contact in self.contacts):
            return None
        matrices = self.matrices
        rigid = np.flatnonzero(~self.elastic)
        gain = (dense(matrices.directions) @ dense(matrices.by_force))[rigid][:, rigid]
        size = jnp.sqrt(jnp.abs(jnp.diagonal(gain)))
        inverse = linear_solve(gain / (size[:, None] * size[None, :]), jnp.eye(len(gain)))
        is_unique = jnp.max(jnp.abs(inverse)) < 1 / (64 * jnp.finfo(gain.dtype).eps)
        return jnp.all(jnp.isfinite(gain)) & ~is_unique

    @property
    def traits(self) -> Traits:
        # Of eight contacts some operation is so large that XLA gives it to several threads, and refuses the loop.
        native = self.size <= WRITTEN_OUT and len(self.contacts) < WRITTEN_OUT
        # Measured; XLA gives what is as large as these dampers to several threads, and refuses the native loop.
        is_large = self.size > (_MOST_DAMPED if native and self.damping is not None else _MOST_IN_CACHE)
        return Traits(compiles_natively=native, lanes=64 if is_large else 256)

    @property
    def fastest(self) -> FloatScalar:
        """The highest natural angular frequency or rate of decay or growth, rad/s, of the structure without friction.

        Sticks only constrain it, which raises none of them. A scale, without derivatives: masses without springs have
        equal eigenvalues, which have none.
        """
        stiffness = self.stiffness
        beside = [(one.series_stiffness, one.normal_stiffness, one.radius) for one in self.contacts]
        others = [one for one, of in zip(self.contacts, beside, strict=True) if any(part is not None for part in of)]
        xp: Any = jnp if any(map(checks.is_traced, jax.tree.leaves((stiffness, others)))) else np
        if others:
            stiffness = xp.asarray(stiffness, float)
            stiffness = xp.diag(stiffness) if stiffness.ndim == 1 else stiffness
        for one in others:
            w = xp.asarray(one.direction, float)
            if one.series_stiffness is not None:  # while the slider sticks
                stiffness = stiffness + one.series_stiffness * xp.outer(w, w)
            largest = None if one.radius is None else largest_of(one.normal_force)
            if largest is not None:
                stiffness = stiffness + largest * one.curvature * xp.outer(w, w)
            if one.normal_stiffness is not None:
                # Friction acts as the matrix mu w a^T, no more than mu (r w w^T + a a^T / r) does, r = |a| / |w|.
                a = xp.asarray(one.normal_stiffness, float)
                ratio = xp.maximum(xp.sqrt(xp.sum(a * a) / xp.sum(w * w)), _LEAST)
                stiffness = stiffness + one.friction.static * (ratio * xp.outer(w, w) + xp.outer(a, a) / ratio)
        numbers = self.mass, stiffness, self.damping
        if any(map(checks.is_traced, numbers)):
            return _fastest(*without_derivatives(numbers))
        return _fastest_known(*numbers)

    def time_scales(self, excitation: Excitation, solver: Solver | None) -> TimeScales:
        signals = [force for force in self.force or () if isinstance(force, Signal)]
        driving = {
            "shortest period of the base motion": shortest_period(excitation),
            **{f"shortest period of force {number}": signal.shortest_period for number, signal in enumerate(signals)},
            **periods_of(self.normal_forces),
        }
        steps = PERIOD if solver is None and self._has_arcs(excitation.smooth) else SOLVED
        fastest = self.fastest
        fastest = fastest if checks.is_traced(fastest) else float(fastest)
        times = {"shortest natural period or decay time": 2 * np.pi / fastest, **driving}
        return TimeScales({name: TimeScale(time, steps) for name, time in times.items()}, driving, are_all=True)

    @property
    def static_exceeds_kinetic(self) -> bool:
        return any(law.static_exceeds_kinetic for law in laws_in(self.contacts))

    def sizes(self, excitation: Excitation) -> Sizes:
        """Of each contact; the speed is what friction changes in the time of one radian of the masses it pushes."""
        of, held = self.matrices, []
        for contact in self.contacts:
            normal = largest_of(contact.normal_force)
            if normal is None:
                return Sizes(None, None, (1.0,) * len(self.coordinates))
            held.append(contact.friction.static * normal)
        directions, by_force = dense(of.directions), dense(of.by_force)
        if of.by_springs is not None and of.softness is not None:
            by_force = by_force + dense(of.by_springs) * of.softness[None, :]
        gain = jnp.sum(directions.T * by_force, axis=0)
        # The time of one radian of the motion that each contact causes, or 1 s where there is hardly a spring.
        squared = jnp.sum(directions.T * (dense(of.stiffness) @ by_force), axis=0) / gain
        swings = squared > SOFT**2
        clocks = jnp.where(swings, 1 / jnp.sqrt(jnp.where(swings, squared, 1)), 1.0)
        deceleration = jnp.stack([jnp.asarray(force, float) for force in held]) * gain
        speed, memory = deceleration * clocks, self.memory
        motion = (jnp.max(speed * clocks),) * self.size + (jnp.max(speed),) * self.size
        of_memory = (*(jnp.max(speed * clocks) for _ in memory.elongations), *(jnp.max(clocks) for _ in memory.ages))
        of_slips = (jnp.max(speed * clocks) for _ in memory.slips)
        of_memory = (*of_memory, *of_slips, *memory.state_scales)
        return Sizes(speed, deceleration, (*motion, *of_memory))

    @property
    def look(self) -> Look:
        return Look("structure", self._mechanism)

    def _mechanism(self, state: tuple[np.ndarray, ...], base: np.ndarray) -> Mechanism:
        positions, stiffness = state[: self.size], np.asarray(_matrix(self.stiffness))
        directions = np.stack([np.asarray(contact.direction) for contact in self.contacts])
        on_base = self.shares_of_base
        if self.rotates:
            return disks(positions, base, stiffness, directions, on_base)
        on = tuple(tuple(np.flatnonzero(column).tolist()) for column in directions.T)
        touched = np.count_nonzero(directions, axis=1)
        is_row = np.all(touched == 1) and np.all(on_base) and not np.any(np.triu(stiffness, 2))
        if self.drawn_as == BLOCKS or (self.drawn_as is None and is_row):
            return blocks(positions, base, stiffness, on)
        if self.drawn_as == STOREYS:
            return storeys(positions, base, on)
        return bars(self.coordinates, state, (*on, *on, *((),) * (len(state) - 2 * self.size)))


class ReadyStructure(LinearStructure):
    """A `LinearStructure` whose matrices are `known`; a change of its numbers does not change them."""

    contacts: Any = eqx.field(default=(), converter=entries_of)  # or `Alike`
    known: Matrices | None = eqx.field(default=None, kw_only=True)

    @property
    def elastic(self) -> np.ndarray:
        if not isinstance(self.contacts, Alike):
            return super().elastic
        return np.full(len(self.contacts), self.contacts.each.series_stiffness is not None)

    @property
    def normal_forces(self) -> Forces:
        if not isinstance(self.contacts, Alike):
            return super().normal_forces
        return cast(FloatArray, self.contacts.each.normal_force)

    @property
    def matrices(self) -> Matrices:
        assert self.known is not None
        return self.known

    @property
    def fastest(self) -> FloatScalar:
        return self.matrices.fastest


def _fastest_known(mass: Any, stiffness: Any, damping: Any) -> FloatScalar:
    mass = np.asarray(mass, float)
    scales = np.diag(1 / np.sqrt(mass)) if mass.ndim == 1 else np.linalg.inv(np.linalg.cholesky(mass))

    def largest(matrix: Any) -> float:
        values = np.asarray(matrix, float)
        values = np.diag(values) if values.ndim == 1 else values
        return np.max(np.abs(np.linalg.eigvalsh(scales @ values @ scales.T)))

    fastest = max(math.sqrt(largest(stiffness)), 0.0 if damping is None else largest(damping))
    return jnp.asarray(max(fastest, _lowest()), float)


@kept_jit
def _fastest(mass: Any, stiffness: Any, damping: Any) -> FloatScalar:
    squared = largest_eigenvalue(_inverse_times(mass, _matrix(stiffness)))
    decay = 0.0 if damping is None else largest_eigenvalue(_inverse_times(mass, _matrix(damping)))
    return jnp.maximum(jnp.maximum(jnp.sqrt(squared), decay), _lowest())


def _moves(base: SegmentLaw) -> bool:
    """Whether it is known that this part of the base moves."""
    return _is_not_zero(base.velocities if isinstance(base, VelocitySteps) else getattr(base, "speed", 1.0))


def _is_not_zero(numbers: Any) -> bool:
    return not checks.is_traced(numbers) and bool(np.any(np.asarray(numbers) != 0))


def _lowest() -> float:
    return 1e-3 * math.sqrt(jnp.finfo(jnp.result_type(float)).tiny)


def _matrix(values: Any) -> FloatArray:
    values = jnp.asarray(values, float)
    return jnp.diag(values) if values.ndim == 1 else values


def _inverse_times(mass: Any, matrix: FloatArray) -> FloatArray:
    mass = jnp.asarray(mass, float)
    return matrix / mass[:, None] if mass.ndim == 1 else linear_solve(mass, matrix)
