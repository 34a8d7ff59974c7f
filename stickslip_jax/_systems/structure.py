"""Linear structures with dry-friction contacts: masses, springs and dampers as matrices."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .. import _diffrax as diffrax
from .._excitation.excitation import Excitation
from .._excitation.random import RandomPhase, RandomSignal
from .._excitation.recorded import Recorded
from .._excitation.segments import SegmentLaw
from .._excitation.smooth import Signal
from .._fields import with_fields
from .._numerics.primal import without_derivatives
from .._numerics.small_matrices import WRITTEN_OUT, dense, largest_eigenvalue, linear_solve
from .._types import BoolScalar, ExplicitSolver, FloatArray, FloatScalar, Number, Scalar, Solver
from .ageing_model import AgeingContacts, with_ages
from .composed_friction import least
from .contact import Contact, entries_of, numbers_of
from .contact_forces import Uncoupled
from .dynamic_friction import DynamicFriction
from .inner_states import InnerStates, inner_laws_of
from .layouts import blocks, disks, storeys
from .mechanism import Mechanism, bars
from .normal_force import NormalForce, largest_of, periods_of, recorded_in
from .structure_arcs import ArcsModel
from .structure_checks import check_structure, is_uncoupled
from .structure_model import Matrices, StructureModel
from .system import PERIOD, SOFT, SOLVED, Coordinate, TimeScale, ages_of, shortest_period
from .with_contacts import WithContacts

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
        contacts: Up to 64, each a `Contact`.
        force: External forces, N (or N m): for each mass None, a number, a `Signal` or a `Recorded`; None for no
            forces.
        uncoupled: Whether friction in one contact has no effect on the relative velocity of another, which is faster.
            Found from the numbers; to be given only where JAX traces the masses or directions.
        rotates: Whether the positions are angles in rad, and the masses inertias. Directions of contacts are then
            radii in m.
        drawn_as: How `plot.animate` draws it: "blocks" in a row on a belt, "storeys" of a building over its base mat,
            or "bars", one for each coordinate. With `rotates` it is always drawn as disks in a row.

    Raises:
        ValueError: For a mass that is singular, matrices that are not symmetric or of another size, contacts that
            couple nothing or imply each other, and another `drawn_as`.
    """

    mass: Any = eqx.field(converter=numbers_of)
    stiffness: Any = eqx.field(converter=numbers_of)
    damping: Any = eqx.field(default=None, converter=numbers_of)
    contacts: tuple[Contact, ...] = eqx.field(default=(), converter=entries_of)
    force: tuple[Signal | Recorded | Number | None, ...] | None = eqx.field(default=None, converter=entries_of)
    uncoupled: bool | None = eqx.field(static=True, default=None)
    rotates: bool = eqx.field(static=True, default=False)
    drawn_as: str = eqx.field(static=True, default=BARS, kw_only=True)

    def __post_init__(self):
        # Equinox converts the fields after this.
        contacts, force = entries_of(self.contacts), entries_of(self.force)
        _checks.chosen("drawn_as", self.drawn_as, _DRAWN_AS)
        check_structure(self.mass, self.stiffness, self.damping, contacts, force)
        if self.uncoupled is None:
            object.__setattr__(self, "uncoupled", is_uncoupled(self.mass, contacts))

    @property
    def contact_count(self) -> int | None:
        return len(self.contacts)

    @property
    def normal_forces(self) -> tuple[NormalForce, ...]:
        """The normal force of each contact."""
        return tuple(contact.normal_force for contact in self.contacts)

    @property
    def recorded_normal_forces(self) -> tuple[SegmentLaw, ...]:
        return recorded_in(self.normal_forces)

    @property
    def recorded_loads(self) -> tuple[Recorded, ...]:
        return tuple(force for force in self.force or () if isinstance(force, Recorded))

    @property
    def size(self) -> int:
        """The number d of masses."""
        return np.shape(self.mass)[0]

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        name, unit, symbol = ("angle", "rad", r"\varphi") if self.rotates else ("position", "m", "x")
        rate = "angular velocity" if self.rotates else "velocity"
        numbers = range(1, self.size + 1)
        positions = [Coordinate(f"{name} {i}", unit, f"{symbol}_{{{i}}}") for i in numbers]
        rates = (Coordinate(f"{rate} {i}", f"{unit}/s", rf"\dot {symbol}_{{{i}}}") for i in numbers)
        return *positions, *rates, *self.ages, *self.inner_states

    @property
    def inner_laws(self) -> tuple[DynamicFriction, ...]:
        return inner_laws_of(tuple(contact.friction for contact in self.contacts))

    @property
    def ages(self) -> tuple[Coordinate, ...]:
        return ages_of(len(self.contacts)) if any(contact.friction.grows for contact in self.contacts) else ()

    @property
    def stick_position(self) -> Coordinate:
        if self.counted_contact == "all":
            return super().stick_position
        return Coordinate("relative displacement when the stick starts", "m")

    def switched_model(self, smooth: Signal | None, solver: ExplicitSolver | None) -> "StructureModel | AgeingContacts":
        kind = ArcsModel if solver is None and self._has_arcs(smooth) else StructureModel
        solver = diffrax.Dopri8() if solver is None else solver
        matrices = self.matrices
        model = kind(solver=solver, smooth=smooth, structure=self, matrices=matrices, fastest=matrices.fastest)
        times = [contact.friction.growth_time for contact in self.contacts if contact.friction.grows]
        return with_ages(model, 2 * self.size, bool(times), least(*times))

    def inner_model(self, smooth: Signal | None) -> InnerStates | None:
        if not self.inner_laws:
            return None
        matrices = self.matrices
        model = StructureModel(
            solver=diffrax.Dopri8(), smooth=smooth, structure=self, matrices=matrices, fastest=matrices.fastest
        )
        return InnerStates(model, self.inner_laws, 2 * self.size)

    def _has_arcs(self, smooth: Signal | RandomSignal | None) -> bool:
        """Whether every mode is linear with constant coefficients, under forces of which power series are known."""
        smooth = smooth.signal if isinstance(smooth, RandomPhase) else smooth
        functions = (smooth, *(self.force or ()), *self.normal_forces)
        of_time = [one for one in functions if isinstance(one, (Signal, RandomSignal))]
        are_known = all(isinstance(one, Signal) and one.is_harmonic for one in of_time)
        return are_known and all(contact.friction.constant for contact in self.contacts)

    @property
    def matrices(self) -> Matrices:
        """What the equations of motion need of linear algebra."""
        directions = jnp.stack([jnp.asarray(contact.direction, float) for contact in self.contacts])
        by_force = _inverse_times(self.mass, directions.T)
        return Matrices(
            inverse_mass=_inverse_times(self.mass, jnp.eye(self.size)),
            stiffness=_inverse_times(self.mass, _matrix(self.stiffness)),
            damping=None if self.damping is None else _inverse_times(self.mass, _matrix(self.damping)),
            directions=directions,
            by_force=by_force,
            # Contacts that share no mass, directly or through the mass matrix, have no effect on each other.
            gain=Uncoupled.of(jnp.sum(directions.T * by_force, axis=0)) if self.uncoupled else directions @ by_force,
            on_base=jnp.stack([jnp.asarray(contact.on_base, float) for contact in self.contacts]),
            fastest=self.fastest,
        )

    def ready(self) -> "LinearStructure":
        if type(self) is not LinearStructure:  # a user's subclass may have methods of its own
            return self
        return with_fields(self, ReadyStructure, known=self.matrices.by_bands())

    @property
    def redundant(self) -> BoolScalar | None:
        if self.uncoupled or not any(_checks.is_traced(contact.direction) for contact in self.contacts):
            return None
        matrices = self.matrices
        gain = dense(matrices.directions) @ dense(matrices.by_force)
        size = jnp.sqrt(jnp.abs(jnp.diagonal(gain)))
        inverse = linear_solve(gain / (size[:, None] * size[None, :]), jnp.eye(len(self.contacts)))
        is_unique = jnp.max(jnp.abs(inverse)) < 1 / (64 * jnp.finfo(gain.dtype).eps)
        return jnp.all(jnp.isfinite(gain)) & ~is_unique

    @property
    def compiles_natively(self) -> bool:
        return max(self.size, len(self.contacts)) <= WRITTEN_OUT

    @property
    def fastest(self) -> FloatScalar:
        """The highest natural angular frequency or rate of decay or growth, rad/s, of the structure without friction.

        Sticks only constrain it, which raises none of them. A scale, without derivatives: masses without springs have
        equal eigenvalues, which have none.
        """
        lowest = 1e-3 * jnp.sqrt(jnp.finfo(float).tiny)
        mass, stiffness, damping = without_derivatives((self.mass, self.stiffness, self.damping))
        squared = largest_eigenvalue(_inverse_times(mass, _matrix(stiffness)))
        decay = 0.0 if damping is None else largest_eigenvalue(_inverse_times(mass, _matrix(damping)))
        return jnp.maximum(jnp.maximum(jnp.sqrt(squared), decay), lowest)

    def time_scales(self, excitation: Excitation, solver: Solver | None) -> dict[str, TimeScale]:
        times = {"shortest natural period or decay time": 2 * np.pi / self.fastest, **self.driving_times(excitation)}
        steps = PERIOD if solver is None and self._has_arcs(excitation.smooth) else SOLVED
        return {name: TimeScale(time, steps) for name, time in times.items()}

    def driving_times(self, excitation: Excitation) -> dict[str, Scalar | None]:
        signals = [force for force in self.force or () if isinstance(force, Signal)]
        return {
            "shortest period of the base motion": shortest_period(excitation),
            **{f"shortest period of force {number}": signal.shortest_period for number, signal in enumerate(signals)},
            **periods_of(self.normal_forces),
        }

    @property
    def has_fixed_time_scales(self) -> bool:
        return True

    @property
    def static_exceeds_kinetic(self) -> bool:
        return any(contact.friction.static_exceeds_kinetic for contact in self.contacts)

    @property
    def contact_scales(self) -> tuple[FloatArray | None, FloatArray | None]:
        """Of each contact; the speed is what friction changes in the time of one radian of the masses it pushes."""
        of, held = self.matrices, []
        for contact in self.contacts:
            normal = largest_of(contact.normal_force)
            if normal is None:
                return None, None
            held.append(contact.friction.static * normal)
        gain = jnp.sum(dense(of.directions).T * dense(of.by_force), axis=0)
        deceleration = jnp.stack([jnp.asarray(force, float) for force in held]) * gain
        return deceleration * self._clocks, deceleration

    @property
    def _clocks(self) -> FloatArray:
        """The time of one radian of the motion that each contact causes, or 1 s where there is hardly a spring."""
        of = self.matrices
        directions, by_force = dense(of.directions), dense(of.by_force)
        pull = jnp.sum(directions.T * (dense(of.stiffness) @ by_force), axis=0)
        squared = pull / jnp.sum(directions.T * by_force, axis=0)
        swings = squared > SOFT**2
        return jnp.where(swings, 1 / jnp.sqrt(jnp.where(swings, squared, 1)), 1.0)

    def state_scales(self, excitation: Excitation) -> tuple[Scalar, ...]:
        speed, _ = self.contact_scales
        if speed is None:
            return super().state_scales(excitation)
        clocks = self._clocks
        motion = (jnp.max(speed * clocks),) * self.size + (jnp.max(speed),) * self.size
        memory = (*(jnp.max(clocks) for _ in self.ages), *(law.state_scale for law in self.inner_laws))
        return motion + memory

    @property
    def body_name(self) -> str:
        return "structure"

    def mechanism(self, state: tuple[np.ndarray, ...], base: np.ndarray) -> Mechanism:
        positions, stiffness = state[: self.size], np.asarray(_matrix(self.stiffness))
        directions = np.stack([np.asarray(contact.direction) for contact in self.contacts])
        if self.rotates:
            on_base = np.array([float(contact.on_base) for contact in self.contacts])
            return disks(positions, base, stiffness, directions, on_base)
        on = tuple(tuple(np.flatnonzero(column).tolist()) for column in directions.T)
        if self.drawn_as == BLOCKS:
            return blocks(positions, base, stiffness, on)
        if self.drawn_as == STOREYS:
            return storeys(positions, base, on)
        return bars(self._names_and_units, state, (*on, *on, *((),) * (len(state) - 2 * self.size)))


class ReadyStructure(LinearStructure):
    """A `LinearStructure` whose matrices are `known`; a change of its numbers does not change them."""

    known: Matrices | None = eqx.field(default=None, kw_only=True)

    @property
    def matrices(self) -> Matrices:
        assert self.known is not None
        return self.known


def _matrix(values: Any) -> FloatArray:
    values = jnp.asarray(values, float)
    return jnp.diag(values) if values.ndim == 1 else values


def _inverse_times(mass: Any, matrix: FloatArray) -> FloatArray:
    mass = jnp.asarray(mass, float)
    return matrix / mass[:, None] if mass.ndim == 1 else linear_solve(mass, matrix)
