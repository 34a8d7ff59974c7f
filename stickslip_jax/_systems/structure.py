"""Linear structures with dry-friction contacts: masses, springs and dampers as matrices, and their motion."""

import math
from functools import reduce
from operator import add
from typing import Any, ClassVar, NamedTuple, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._compiler.programs import kept_jit
from .._excitation.excitation import Excitation
from .._excitation.motion import Harmonic, RandomPhase, RandomSignal, Signal, SumOfHarmonics
from .._foundation import checks
from .._foundation import lazy_diffrax as diffrax
from .._foundation.fields import with_fields
from .._foundation.types import (
    BoolScalar,
    DType,
    ExplicitSolver,
    FloatArray,
    FloatScalar,
    Number,
    Solver,
    State,
)
from .._numerics.derivatives import without_derivatives
from .._numerics.matrices import (
    WRITTEN_OUT,
    Matrix,
    by_bands,
    dense,
    largest_eigenvalue,
    linear_solve,
    magnitudes,
    stacked,
    times,
)
from .contacts import (
    Alike,
    Contact,
    ContactsModel,
    Forces,
    Gain,
    InMode,
    Instant,
    Limits,
    NormalForce,
    Uncoupled,
    acceleration,
    as_one,
    entries_of,
    holding,
    is_function,
    largest_of,
    laws_in,
    numbers_of,
    periods_of,
    power_series_of,
    rates_at,
    recorded_in,
    size_of,
    solved,
    values_at,
)
from .friction import AtAge, FrictionLaw, least
from .layouts import blocks, disks, storeys
from .memory_models import AgeingContacts, InnerStates, inner_laws_of, with_ages
from .switched_model import Along, Forcing, Form, later, of_form
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
    if any(checks.is_traced(value) for value in (mass, *(contact.direction for contact in contacts))):
        return False
    gain = _gain(mass, contacts)
    return bool(np.all(gain == np.diag(np.diag(gain))))


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
        if not checks.is_traced(contact.direction) and not np.any(np.asarray(contact.direction)):
            raise ValueError(
                f"Argument direction of contact {number} must not be zero: such a contact moves with no mass."
            )
    if any(checks.is_traced(contact.direction) for contact in contacts):
        return  # `LinearStructure.redundant` tells the status
    # Contacts are independent if their directions are, whatever the masses.
    eigenvalues = np.linalg.eigvalsh(_gain(np.ones(size) if checks.is_traced(mass) else mass, contacts))
    if is_singular(eigenvalues):
        raise ValueError(
            "Argument contacts must be independent of each other, but the relative velocity of one is implied by "
            "others (their directions are linearly dependent); join contacts with the same direction in one."
        )


# A linear structure with dry-friction contacts under its excitation.


_Tree = TypeVar("_Tree")


class Matrices(NamedTuple):
    """What a `LinearStructure` needs of linear algebra.

    - `inverse_mass`, and from the left by it: `stiffness`, `damping`, `by_force` (the `directions` of the contacts).
    - `gain`: see `contact_forces`. `fastest`: see `LinearStructure.fastest`.
    """

    inverse_mass: Matrix
    stiffness: Matrix
    damping: Matrix | None
    directions: Matrix
    by_force: Matrix
    gain: Gain
    on_base: FloatArray
    fastest: FloatScalar

    def by_bands(self) -> "Matrices":
        """The same, large matrices with few bands by these: of ten blocks in a row, 28 of the 100 stiffnesses."""
        products = {
            name: by_bands(getattr(self, name)) for name in ("inverse_mass", "stiffness", "directions", "by_force")
        }
        return self._replace(damping=None if self.damping is None else by_bands(self.damping), **products)


class StructureModel(ContactsModel):
    """A `LinearStructure` on a base. State: positions (d,) and velocities (d,)."""

    smooth: Signal | None
    structure: Any  # a LinearStructure, which makes this model
    matrices: Matrices

    @property
    def fastest(self) -> FloatScalar:
        return self.matrices.fastest

    @property
    def contacts(self) -> int:
        return len(self.structure.contacts)

    @property
    def coupled(self) -> bool:
        return not self.structure.uncoupled

    @property
    def time_scales_are_known(self) -> bool:
        given = (self.smooth, *self.structure.functions)
        return all(one.shortest_period is not None for one in given if isinstance(one, Signal))

    def implicit_changes(
        self, forcing: Forcing, tau: FloatScalar, y: State, weight: FloatScalar, sides: State
    ) -> State:
        of, (of_position, of_velocity) = self._in_precision_of(y), sides
        matrix = jnp.eye(self.structure.size, dtype=weight.dtype) + weight**2 * dense(of.stiffness)
        if of.damping is not None:
            matrix = matrix + weight * dense(of.damping)
        velocity = linear_solve(matrix, of_velocity - weight * times(of.stiffness, of_position))
        return of_position + weight * velocity, velocity

    def at_age(self, age: FloatArray) -> "StructureModel":
        laws = [contact.friction for contact in self.structure.contacts]
        aged = [AtAge(law, age[i]) for i, law in enumerate(laws)]
        return eqx.tree_at(lambda model: [contact.friction for contact in model.structure.contacts], self, aged)

    def start(self, y0: tuple[Number, ...] | FloatArray, dtype: DType) -> State:
        size = self.structure.size
        values = stacked(y0, dtype) if isinstance(y0, tuple) else y0.astype(dtype)
        return values[:size], values[size:]

    def numbers(self, y: State) -> State:
        return tuple(part[..., i] for part in y for i in range(self.structure.size))

    def stick_position(self, y: State) -> FloatArray:
        return jnp.append(times(self._in_precision_of(y).directions, y[0]), y[0][0])

    def instant(self, forcing: Forcing, tau: FloatScalar, y: State) -> Instant:
        base, of = forcing.base_at(self.smooth, tau), self._in_precision_of(y)
        pull = self._load(forcing, tau) - times(of.stiffness, y[0])
        if of.damping is not None:
            pull = pull - times(of.damping, y[1])
        velocity = times(of.directions, y[1]) - of.on_base * base.velocity
        drift = times(of.directions, pull) - of.on_base * base.acceleration
        return Instant((y[1], pull), velocity, drift, of.gain)

    def effect(self, forcing: Forcing, tau: FloatScalar, y: State, force: FloatArray) -> State:
        return jnp.zeros_like(y[0]), -times(self._in_precision_of(y).by_force, force)

    def limits(self, forcing: Forcing, tau: FloatScalar, y: State, velocity: FloatArray) -> Limits:
        return self.limits_under(self.normal_forces_at(forcing, tau, y), velocity)

    def limits_under(self, normal: FloatArray, velocity: FloatArray) -> Limits:
        """The forces that friction can exert at these relative velocities, under these normal forces."""
        return Limits(*(normal[:, None] * _coefficients(self.structure.contacts, velocity)).T)

    @property
    def varying(self) -> tuple[int, ...]:
        forces = self.structure.normal_forces
        return tuple(i for i, one in enumerate(forces) if is_function(one)) if isinstance(forces, tuple) else ()

    def normal_scale(self, forcing: Forcing, y: State) -> FloatArray:
        return jnp.stack([size_of(self.structure.normal_forces[number], forcing.t) for number in self.varying])

    def normal_forces_at(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        return values_at(self.structure.normal_forces, forcing.t, forcing.normal, tau)

    def velocity_scale(self, forcing: Forcing, y: State) -> FloatArray:
        base, of = forcing.base_at(self.smooth, jnp.zeros_like(forcing.t)), self._in_precision_of(y)
        return times(magnitudes(of.directions), jnp.abs(y[1])) + jnp.abs(of.on_base * base.velocity)

    def gross_changes(self, forcing: Forcing, y: State, h: FloatScalar, friction: FloatArray) -> State:
        x, v = jnp.abs(y[0]), jnp.abs(y[1])
        of = self._in_precision_of(y)
        load = jnp.abs(self._load(forcing, jnp.zeros_like(h))) + times(magnitudes(of.by_force), friction)
        load = load + times(magnitudes(of.stiffness), x)
        if of.damping is not None:
            load = load + times(magnitudes(of.damping), v)
        return h * (v + h * load), h * load

    def _load(self, forcing: Forcing, tau: FloatScalar) -> FloatArray:
        """What ground and external forces do to each mass, m/s^2."""
        load = jnp.full((self.structure.size,), -later(forcing.ground, tau))
        if self.structure.force is None:
            return load
        applied = values_at(self.structure.force, forcing.t, forcing.force, tau)
        return load + times(in_dtype(self.matrices.inverse_mass, forcing.t.dtype), applied)

    def _in_precision_of(self, y: State) -> Matrices:
        return in_dtype(self.matrices, y[0].dtype)


def in_dtype(tree: _Tree, dtype: DType) -> _Tree:
    return jax.tree.map(lambda values: values.astype(dtype), tree)


def _coefficients(contacts: tuple[Contact, ...] | Alike, velocity: FloatArray) -> FloatArray:
    """The friction coefficients (contacts, 4) of slips forward and backward and of sticks that break into them."""

    def of_one(law: FrictionLaw, v: FloatScalar) -> FloatArray:
        one = jnp.ones_like(v)
        values = [law.continued_coefficient(v, one), law.continued_coefficient(-v, -one)]
        values += [law.stick_limit(one), law.stick_limit(-one)]
        return jnp.stack([jnp.asarray(value, v.dtype) for value in values])

    laws = laws_in(contacts)
    same = laws[0] if isinstance(contacts, Alike) else as_one(laws)
    if same is not None:  # the same law with other numbers
        return jax.vmap(of_one)(same, velocity)
    return jnp.stack([of_one(law, velocity[i]) for i, law in enumerate(laws)])


# A linear structure whose modes are linear with constant coefficients: their motion as power series.


# Terms that reach round-off in the longest steps allowed, a tenth of the shortest period: a term is at most r^k / k!,
# r = 0.63 without damping, and with it 1.02 (where the decay rate is as high as the frequency).
_TERMS = {8: (16, 18), 4: (10, 11)}
_TERMS_OF_SLOPE = 12  # to 1e-7 of it: an extreme is wrong by the square of what its instant is


class ArcsModel(StructureModel):
    """A `StructureModel` with constant friction coefficients, whose excitation is piecewise linear or harmonic.

    Each mode is linear then, with constant coefficients: a step is the power series of its solution, summed to
    round-off, for any damping and with masses that no spring holds.
    """

    has_kinks: ClassVar[bool] = False
    has_short_steps: ClassVar[bool] = True

    def flow_and_error(self, forcing: Forcing, y: State, h: FloatScalar, sign: FloatArray) -> tuple[State, None]:
        reached = tuple(reduce(add, reversed(series)) for series in _series(self, forcing, y, h, sign))
        return self._held(forcing, h, reached, self._own(sign) == 0), None

    def along(self, forcing: Forcing, y: State, h: FloatScalar, sign: FloatArray, forms: tuple[Form, ...]) -> Along:
        of_numbers = self.numbers(tuple(jnp.stack(series) for series in _series(self, forcing, y, h, sign)))
        terms = jnp.stack([of_form(form, of_numbers) for form in forms], axis=-1)
        length = jnp.where(h > 0, h, 1)

        def at(tau: FloatArray) -> tuple[FloatArray, FloatArray]:
            share, value, slope = tau / length, jnp.zeros_like(tau), jnp.zeros_like(tau)
            for power in reversed(range(len(terms))):
                value = value * share + terms[power]
            for power in reversed(range(1, min(len(terms), _TERMS_OF_SLOPE))):
                slope = slope * share + power * terms[power]
            return value, slope / length

        return at

    def _sources(
        self, held: "_Held", forcing: Forcing, y: State, sign: FloatArray, terms: int
    ) -> list[FloatArray | None]:
        """The coefficients in the power series of accelerations (masses,) that do not depend on the state."""
        t, of, none = forcing.t, held.of, jnp.zeros_like(forcing.t)
        # Constant friction coefficients: at any relative velocity.
        share = self._closed(self.limits_under(jnp.ones_like(of.on_base), jnp.zeros_like(of.on_base)), sign)
        slip = share.slip(self._own(sign))
        normal = power_series_of(self.structure.normal_forces, t, forcing.normal, terms)
        load = power_series_of(self.structure.force or (), t, forcing.force, terms)
        base: tuple[FloatArray | None, ...] = (None,) * (terms + 1)
        if self.smooth is not None:
            base = cast(Harmonic | SumOfHarmonics, self.smooth).power_series(t, terms + 1)
        sources: list[FloatArray | None] = []
        for k, (of_normal, of_load, of_base) in enumerate(zip(normal, load, base[1:], strict=True)):
            parts = [] if of_normal is None else [-times(of.by_force, slip * of_normal)]
            if k < 2:
                parts.append(jnp.full_like(y[0], -forcing.ground[k]))
            if of_load is not None:
                parts.append(times(of.inverse_mass, of_load))
            found = [held(reduce(add, parts))] if parts else []
            # The sticks follow the base.
            following = none if of_base is None else (k + 1) * of_base
            if k == 0 or of_base is not None:
                found.append(held.by(of.on_base * (following + (forcing.base[1] if k == 0 else none))))
            sources.append(reduce(add, found) if found else None)
        return sources

    def in_mode(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatArray) -> tuple[InMode, InMode]:
        of, own, sticks = self._in_precision_of(y), self._own(sign), self._own(sign) == 0
        now = self.instant(forcing, tau, y)
        t, normal = forcing.t + tau, self.normal_forces_at(forcing, tau, y)
        normal_rate = rates_at(self.structure.normal_forces, t, forcing.normal)
        limits, changing = (
            self._closed(self.limits_under(forces, now.velocity), sign) for forces in (normal, normal_rate)
        )
        force = solved(now.gain, now.drift, limits.slip(own), sticks)
        moving = now.rates[1] - times(of.by_force, force)
        # The rate of what ground and external forces do to each mass, m/s^3.
        load = jnp.full((self.structure.size,), -forcing.ground[1])
        if self.structure.force is not None:
            load = load + times(of.inverse_mass, rates_at(self.structure.force, t, forcing.force))
        pull = load - times(of.stiffness, y[1])
        if of.damping is not None:
            pull = pull - times(of.damping, moving)
        drift = times(of.directions, pull)
        if self.smooth is not None:
            drift = drift - of.on_base * self.smooth.curvature(t)
        rate = solved(now.gain, drift, changing.slip(own), sticks)
        velocity = acceleration(now.gain, now.drift, force)
        (middle, limit), (middle_rate, limit_rate) = (forces.band(force) for forces in (limits, changing))
        return (
            InMode(now.velocity, force - middle, limit, self._varying(normal)),
            InMode(velocity, rate - middle_rate, limit_rate, self._varying(normal_rate)),
        )

    def _varying(self, normal: FloatArray) -> FloatArray | None:
        return normal[np.array(self.varying)] if self.varying else None


@eqx.filter_jit  # traced once, so that `sharing` recognises it where it is asked for again
def _series(
    model: ArcsModel, forcing: Forcing, y: State, h: FloatScalar, sign: FloatArray
) -> tuple[list[FloatArray], list[FloatArray]]:
    """The terms of the power series of positions and velocities, (masses,) each, after the time `h` (s)."""
    of, sticks = model._in_precision_of(y), model._own(sign) == 0
    terms = _TERMS[h.dtype.itemsize][of.damping is not None]
    held = _Held(of, holding(of.gain, sticks))
    sources = model._sources(held, forcing, y, sign, terms)
    x, v, power = [y[0]], [y[1]], jnp.ones_like(h)
    for k, source in enumerate(sources):
        pull = times(of.stiffness, x[k])
        if of.damping is not None:
            pull = pull + times(of.damping, v[k])
        rate = -held(pull)
        if source is not None:
            rate = rate + power * source
        share = (1 / (k + 1)) * h
        x.append(share * v[k])
        v.append(share * rate)
        power = power * h
    return x, v


class _Held(NamedTuple):
    """A structure whose sticks are held by friction; `hold`: see `holding`."""

    of: Matrices
    hold: FloatArray

    def __call__(self, accelerations: FloatArray) -> FloatArray:
        """`accelerations` (masses,) without what the friction of sticks takes away."""
        return accelerations - self.by(times(self.of.directions, accelerations))

    def by(self, relative: FloatArray) -> FloatArray:
        """What the friction of sticks does, where they would have these `relative` accelerations (contacts,)."""
        force = times(self.hold, relative) if self.hold.ndim > 1 else self.hold * relative
        return times(self.of.by_force, force)


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
    def memory(self) -> Memory:
        laws = laws_in(self.contacts)
        return Memory(ages_of(len(laws)) if any(law.grows for law in laws) else (), inner_laws_of(laws))

    @property
    def stick_position(self) -> Coordinate:
        if self.counted_contact == "all":
            return super().stick_position
        return Coordinate("relative displacement when the stick starts", "m")

    def switched_model(self, smooth: Signal | None, solver: ExplicitSolver | None) -> "StructureModel | AgeingContacts":
        kind = ArcsModel if solver is None and self._has_arcs(smooth) else StructureModel
        model = kind(diffrax.Dopri8() if solver is None else solver, smooth, self, self.matrices)
        times = [law.growth_time for law in laws_in(self.contacts) if law.grows]
        return with_ages(model, 2 * self.size, bool(times), least(*times))

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
        return are_known and all(law.constant for law in laws_in(self.contacts))

    @property
    def matrices(self) -> Matrices:
        """What the equations of motion need of linear algebra."""
        directions = stacked([contact.direction for contact in self.contacts], jnp.result_type(float))
        by_force = _inverse_times(self.mass, directions.T)
        return Matrices(
            inverse_mass=_inverse_times(self.mass, jnp.eye(self.size)),
            stiffness=_inverse_times(self.mass, _matrix(self.stiffness)),
            damping=None if self.damping is None else _inverse_times(self.mass, _matrix(self.damping)),
            directions=directions,
            by_force=by_force,
            # Contacts that share no mass, directly or through the mass matrix, have no effect on each other.
            gain=Uncoupled.of(jnp.sum(directions.T * by_force, axis=0)) if self.uncoupled else directions @ by_force,
            on_base=stacked([contact.on_base for contact in self.contacts], jnp.result_type(float)),
            fastest=self.fastest,
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
        gain = dense(matrices.directions) @ dense(matrices.by_force)
        size = jnp.sqrt(jnp.abs(jnp.diagonal(gain)))
        inverse = linear_solve(gain / (size[:, None] * size[None, :]), jnp.eye(len(self.contacts)))
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
        numbers = self.mass, self.stiffness, self.damping
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
        gain = jnp.sum(directions.T * by_force, axis=0)
        # The time of one radian of the motion that each contact causes, or 1 s where there is hardly a spring.
        squared = jnp.sum(directions.T * (dense(of.stiffness) @ by_force), axis=0) / gain
        swings = squared > SOFT**2
        clocks = jnp.where(swings, 1 / jnp.sqrt(jnp.where(swings, squared, 1)), 1.0)
        deceleration = jnp.stack([jnp.asarray(force, float) for force in held]) * gain
        speed, memory = deceleration * clocks, self.memory
        motion = (jnp.max(speed * clocks),) * self.size + (jnp.max(speed),) * self.size
        of_memory = (*(jnp.max(clocks) for _ in memory.ages), *(law.state_scale for law in memory.laws))
        return Sizes(speed, deceleration, (*motion, *of_memory))

    @property
    def look(self) -> Look:
        return Look("structure", self._mechanism)

    def _mechanism(self, state: tuple[np.ndarray, ...], base: np.ndarray) -> Mechanism:
        positions, stiffness = state[: self.size], np.asarray(_matrix(self.stiffness))
        directions = np.stack([np.asarray(contact.direction) for contact in self.contacts])
        on_base = np.array([float(contact.on_base) for contact in self.contacts])
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


def _lowest() -> float:
    return 1e-3 * math.sqrt(jnp.finfo(jnp.result_type(float)).tiny)


def _matrix(values: Any) -> FloatArray:
    values = jnp.asarray(values, float)
    return jnp.diag(values) if values.ndim == 1 else values


def _inverse_times(mass: Any, matrix: FloatArray) -> FloatArray:
    mass = jnp.asarray(mass, float)
    return matrix / mass[:, None] if mass.ndim == 1 else linear_solve(mass, matrix)
