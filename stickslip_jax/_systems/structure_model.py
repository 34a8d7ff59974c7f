"""A linear structure with dry-friction contacts under its excitation."""

from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._excitation.segments import Segment, added
from .._excitation.smooth import Signal
from .._numerics.small_matrices import Matrix, by_bands, dense, linear_solve, magnitudes, times
from .._types import DType, FloatArray, FloatScalar, Number, State
from .composed_friction import AtAge
from .contact_forces import Gain, Limits
from .contacts_model import ContactsModel, Instant
from .friction import FrictionLaw
from .normal_force import is_function, size_of, values_at
from .switched_model import Segments, base_motion

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
    structure: Any  # a LinearStructure, which makes this model
    matrices: Matrices
    fastest: FloatScalar

    @property
    def contacts(self) -> int:
        return len(self.structure.contacts)

    @property
    def coupled(self) -> bool:
        return not self.structure.uncoupled

    @property
    def time_scales_are_known(self) -> bool:
        given = (self.smooth, *(self.structure.force or ()), *self.structure.normal_forces)
        return all(one.shortest_period is not None for one in given if isinstance(one, Signal))

    def implicit_changes(
        self, forcing: StructureForcing, tau: FloatScalar, y: State, weight: FloatScalar, sides: State
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
        return self.limits_under(self._normal_forces(forcing, tau), velocity)

    def limits_under(self, normal: FloatArray, velocity: FloatArray) -> Limits:
        """The forces that friction can exert at these relative velocities, under these normal forces."""
        laws = tuple(contact.friction for contact in self.structure.contacts)
        return Limits(*(normal[:, None] * _coefficients(laws, velocity)).T)

    @property
    def varying(self) -> tuple[int, ...]:
        return tuple(number for number, one in enumerate(self.structure.normal_forces) if is_function(one))

    def varying_normal_forces(self, forcing: StructureForcing, tau: FloatScalar, y: State) -> FloatArray:
        return self._normal_forces(forcing, tau)[np.array(self.varying)]

    def normal_scale(self, forcing: StructureForcing, y: State) -> FloatArray:
        return jnp.stack([size_of(self.structure.normal_forces[number], forcing.t) for number in self.varying])

    def normal_forces_at(self, forcing: StructureForcing, tau: FloatScalar, y: State) -> FloatArray:
        return self._normal_forces(forcing, tau)

    def _normal_forces(self, forcing: StructureForcing, tau: FloatScalar) -> FloatArray:
        recorded = forcing.normal + tau * forcing.normal_slope
        return values_at(self.structure.normal_forces, forcing.t + tau, recorded)

    def velocity_scale(self, forcing: StructureForcing, y: State) -> FloatArray:
        base = base_motion(self.smooth, forcing.t, forcing.base, forcing.base_slope, jnp.zeros_like(forcing.t))
        of = self._in_precision_of(y)
        return times(magnitudes(of.directions), jnp.abs(y[1])) + jnp.abs(of.on_base * base.velocity)

    def gross_changes(self, forcing: StructureForcing, y: State, h: FloatScalar, friction: FloatArray) -> State:
        x, v = jnp.abs(y[0]), jnp.abs(y[1])
        of = self._in_precision_of(y)
        load = jnp.abs(self._load(forcing, jnp.zeros_like(h))) + times(magnitudes(of.by_force), friction)
        load = load + times(magnitudes(of.stiffness), x)
        if of.damping is not None:
            load = load + times(magnitudes(of.damping), v)
        return h * (v + h * load), h * load

    def _load(self, forcing: StructureForcing, tau: FloatScalar) -> FloatArray:
        """What ground and external forces do to each mass, m/s^2."""
        ground = forcing.ground + tau * forcing.ground_slope
        load = jnp.full((self.structure.size,), -ground)
        if self.structure.force is None:
            return load
        t = forcing.t + tau
        applied = values_at(self.structure.force, t, forcing.load + tau * forcing.load_slope)
        return load + times(in_dtype(self.matrices.inverse_mass, t.dtype), applied)

    def _in_precision_of(self, y: State) -> Matrices:
        return in_dtype(self.matrices, y[0].dtype)


def in_dtype(tree: _Tree, dtype: DType) -> _Tree:
    return jax.tree.map(lambda values: values.astype(dtype), tree)


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
