"""Linear structures with dry-friction contacts: masses, springs and dampers as matrices."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _diffrax as diffrax
from .._excitation.excitation import Excitation
from .._excitation.recorded import Recorded
from .._excitation.segments import Segment, SegmentLaw, added
from .._excitation.smooth import Signal
from .._fields import with_fields
from .._numerics.primal import without_derivatives
from .._types import DType, ExplicitSolver, FloatArray, FloatScalar, Number, Scalar, Solver, State
from .contact import Contact, entries_of, numbers_of
from .contact_forces import WRITTEN_OUT, Limits, times
from .contacts_model import ContactsModel, Instant
from .friction import FrictionLaw
from .normal_force import NormalForce, is_function, periods_of, recorded_in, size_of, values_at
from .structure_checks import check_structure, is_uncoupled
from .switched_model import Segments, base_motion
from .system import SOLVED, Coordinate, TimeScale, shortest_period
from .with_contacts import WithContacts


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

    Raises:
        ValueError: For a mass that is singular, matrices that are not symmetric or of another size, contacts that
            couple nothing or imply each other.
    """

    mass: Any = eqx.field(converter=numbers_of)
    stiffness: Any = eqx.field(converter=numbers_of)
    damping: Any = eqx.field(default=None, converter=numbers_of)
    contacts: tuple[Contact, ...] = eqx.field(default=(), converter=entries_of)
    force: tuple[Signal | Recorded | Number | None, ...] | None = eqx.field(default=None, converter=entries_of)
    uncoupled: bool | None = eqx.field(static=True, default=None)
    rotates: bool = eqx.field(static=True, default=False)

    def __post_init__(self):
        # Equinox converts the fields after this.
        contacts, force = entries_of(self.contacts), entries_of(self.force)
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
        return (*positions, *(Coordinate(f"{rate} {i}", f"{unit}/s", rf"\dot {symbol}_{{{i}}}") for i in numbers))

    @property
    def stick_position(self) -> Coordinate:
        if self.counted_contact == "all":
            return super().stick_position
        return Coordinate("relative displacement when the stick starts", "m")

    def switched_model(self, smooth: Signal | None, solver: ExplicitSolver | None) -> "StructureModel":
        solver = diffrax.Dopri8() if solver is None else solver
        matrices = self.matrices
        return StructureModel(solver=solver, smooth=smooth, structure=self, matrices=matrices, fastest=matrices.fastest)

    @property
    def matrices(self) -> "Matrices":
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
            gain=jnp.sum(directions.T * by_force, axis=0) if self.uncoupled else directions @ by_force,
            on_base=jnp.stack([jnp.asarray(contact.on_base, float) for contact in self.contacts]),
            fastest=self.fastest,
        )

    def ready(self) -> "LinearStructure":
        if type(self) is not LinearStructure:  # a user's subclass may have methods of its own
            return self
        return with_fields(self, ReadyStructure, known=self.matrices)

    @property
    def compiles_natively(self) -> bool:
        return max(self.size, len(self.contacts)) <= WRITTEN_OUT

    @property
    def fastest(self) -> FloatScalar:
        """The highest natural angular frequency or decay rate, rad/s, of the structure without friction.

        Sticks only constrain it, which raises none of them. A scale, without derivatives: masses without springs have
        equal eigenvalues, which have none.
        """
        lowest = 1e-3 * jnp.sqrt(jnp.finfo(float).tiny)
        mass, stiffness, damping = without_derivatives((self.mass, self.stiffness, self.damping))
        squared = _largest_eigenvalue(mass, stiffness)
        decay = 0.0 if damping is None else _largest_eigenvalue(mass, damping)
        return jnp.maximum(jnp.maximum(jnp.sqrt(jnp.maximum(squared, 0)), decay), lowest)

    def time_scales(self, excitation: Excitation, solver: Solver | None) -> dict[str, TimeScale]:
        signals = [force for force in self.force or () if isinstance(force, Signal)]
        scales = {
            "shortest natural period or decay time": TimeScale(2 * np.pi / self.fastest, SOLVED),
            "shortest period of the base motion": TimeScale(shortest_period(excitation), SOLVED),
        }
        for number, signal in enumerate(signals):
            scales[f"shortest period of force {number}"] = TimeScale(signal.shortest_period, SOLVED)
        return scales | {name: TimeScale(period, SOLVED) for name, period in periods_of(self.normal_forces).items()}

    @property
    def contact_scales(self) -> tuple[Scalar | None, Scalar | None]:
        return None, None

    @property
    def body_name(self) -> str:
        return "structure"


class Matrices(NamedTuple):
    """What a `LinearStructure` needs of linear algebra.

    - `inverse_mass`, and from the left by it: `stiffness`, `damping`, `by_force` (the `directions` of the contacts).
    - `gain`: see `contact_forces`. `fastest`: see `LinearStructure.fastest`.
    """

    inverse_mass: FloatArray
    stiffness: FloatArray
    damping: FloatArray | None
    directions: FloatArray
    by_force: FloatArray
    gain: FloatArray
    on_base: FloatArray
    fastest: FloatScalar


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
    return matrix / mass[:, None] if mass.ndim == 1 else jnp.linalg.solve(mass, matrix)


def _largest_eigenvalue(mass: Any, matrix: Any) -> FloatScalar:
    """Of ``matrix x = lambda mass x``, by Cholesky's decomposition of the mass."""
    root = jnp.linalg.cholesky(_matrix(mass))
    half = jax.scipy.linalg.solve_triangular(root, _matrix(matrix), lower=True)
    return jnp.linalg.eigvalsh(jax.scipy.linalg.solve_triangular(root, half.T, lower=True))[-1]


class StructureForcing(NamedTuple):
    """The piecewise-linear parts of base velocity (m/s) and ground acceleration (m/s^2) from time `t` on, and of normal
    forces and loads: N, one for each that is a record or steps.
    """

    t: FloatScalar
    base: FloatScalar
    base_slope: FloatScalar
    ground: FloatScalar
    ground_slope: FloatScalar
    normal: FloatArray
    normal_slope: FloatArray
    load: FloatArray
    load_slope: FloatArray


class StructureModel(ContactsModel[StructureForcing]):
    """A `LinearStructure` on a base. State: positions (d,) and velocities (d,)."""

    smooth: Signal | None
    structure: LinearStructure
    matrices: Matrices
    fastest: FloatScalar

    @property
    def contacts(self) -> int:
        return len(self.structure.contacts)

    @property
    def coupled(self) -> bool:
        return not self.structure.uncoupled

    def start(self, y0: tuple[Number, ...], dtype: DType) -> State:
        size = self.structure.size
        values = jnp.stack([jnp.asarray(value, dtype) for value in y0])
        return values[:size], values[size:]

    def numbers(self, y: State) -> State:
        return tuple(part[i] for part in y for i in range(self.structure.size))

    def stick_position(self, y: State) -> FloatArray:
        return jnp.append(times(self._in_precision_of(y).directions, y[0]), y[0][0])

    def time(self, forcing: StructureForcing) -> FloatScalar:
        return forcing.t

    def forcing(self, t: FloatScalar, segments: Segments) -> StructureForcing:
        recorded = (*_each(t, segments.normal), *_each(t, segments.force))
        return StructureForcing(t, *added(t, segments.base), *added(t, segments.ground), *recorded)

    def instant(self, forcing: StructureForcing, tau: FloatScalar, y: State) -> Instant:
        base = base_motion(self.smooth, forcing.t, forcing.base, forcing.base_slope, tau)
        of = self._in_precision_of(y)
        pull = self._load(forcing, tau) - times(of.stiffness, y[0])
        if of.damping is not None:
            pull = pull - times(of.damping, y[1])
        velocity = times(of.directions, y[1]) - of.on_base * base.velocity
        drift = times(of.directions, pull) - of.on_base * base.acceleration
        return Instant((y[1], pull), velocity, drift, of.gain)

    def effect(self, forcing: StructureForcing, tau: FloatScalar, y: State, force: FloatArray) -> State:
        return jnp.zeros_like(y[0]), -times(self._in_precision_of(y).by_force, force)

    def limits(self, forcing: StructureForcing, tau: FloatScalar, y: State, velocity: FloatArray) -> Limits:
        laws = tuple(contact.friction for contact in self.structure.contacts)
        forces = self._normal_forces(forcing, tau)[:, None] * _coefficients(laws, velocity)
        return Limits(*forces.T)

    @property
    def varying(self) -> tuple[int, ...]:
        return tuple(number for number, one in enumerate(self.structure.normal_forces) if is_function(one))

    def varying_normal_forces(self, forcing: StructureForcing, tau: FloatScalar, y: State) -> FloatArray:
        return self._normal_forces(forcing, tau)[np.array(self.varying)]

    def normal_scale(self, forcing: StructureForcing, y: State) -> FloatArray:
        now = self._normal_forces(forcing, jnp.zeros_like(forcing.t))
        return jnp.stack([size_of(self.structure.normal_forces[number], now[number]) for number in self.varying])

    def _normal_forces(self, forcing: StructureForcing, tau: FloatScalar) -> FloatArray:
        recorded = forcing.normal + tau * forcing.normal_slope
        return values_at(self.structure.normal_forces, forcing.t + tau, recorded)

    def velocity_scale(self, forcing: StructureForcing, y: State) -> FloatArray:
        base = base_motion(self.smooth, forcing.t, forcing.base, forcing.base_slope, jnp.zeros_like(forcing.t))
        of = self._in_precision_of(y)
        return times(jnp.abs(of.directions), jnp.abs(y[1])) + jnp.abs(of.on_base * base.velocity)

    def gross_changes(self, forcing: StructureForcing, y: State, h: FloatScalar, friction: FloatArray) -> State:
        x, v = jnp.abs(y[0]), jnp.abs(y[1])
        of = self._in_precision_of(y)
        load = jnp.abs(self._load(forcing, jnp.zeros_like(h))) + times(jnp.abs(of.by_force), friction)
        load = load + times(jnp.abs(of.stiffness), x)
        if of.damping is not None:
            load = load + times(jnp.abs(of.damping), v)
        return h * (v + h * load), h * load

    def _load(self, forcing: StructureForcing, tau: FloatScalar) -> FloatArray:
        """What ground and external forces do to each mass, m/s^2."""
        ground = forcing.ground + tau * forcing.ground_slope
        load = jnp.full((self.structure.size,), -ground)
        if self.structure.force is None:
            return load
        t = forcing.t + tau
        applied = values_at(self.structure.force, t, forcing.load + tau * forcing.load_slope)
        return load + times(self.matrices.inverse_mass.astype(t.dtype), applied)

    def _in_precision_of(self, y: State) -> Matrices:
        return jax.tree.map(lambda values: values.astype(y[0].dtype), self.matrices)


def _each(t: FloatScalar, segments: tuple[Segment, ...]) -> tuple[FloatArray, FloatArray]:
    """The values and slopes of segments at the time `t`, (segments,) each; there may be none."""
    values, slopes = [t[None][:0]], [t[None][:0]]
    for segment in segments:
        value, slope = added(t, (segment,))
        values.append(value[None])
        slopes.append(slope[None])
    return jnp.concatenate(values), jnp.concatenate(slopes)


def _coefficients(laws: tuple[FrictionLaw, ...], velocity: FloatArray) -> FloatArray:
    """The friction coefficients (contacts, 4) of slips forward and backward and of sticks that break into them."""

    def of_one(law: FrictionLaw, v: FloatScalar) -> FloatArray:
        one = jnp.ones_like(v)
        values = [law.continued_coefficient(v, one), law.continued_coefficient(-v, -one)]
        values += [law.stick_limit(one), law.stick_limit(-one)]
        return jnp.stack([jnp.asarray(value, v.dtype) for value in values])

    if len({jax.tree.structure(law) for law in laws}) == 1:  # the same law with other numbers
        stacked = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf, float) for leaf in leaves]), *laws)
        return jax.vmap(of_one)(stacked, velocity)
    return jnp.stack([of_one(law, velocity[i]) for i, law in enumerate(laws)])
