"""A linear structure with dry-friction contacts under its excitation, as the engines integrate it."""

from collections.abc import Callable
from functools import reduce
from operator import add
from typing import Any, ClassVar, NamedTuple, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._excitation.motion import Harmonic, Signal, SumOfHarmonics
from .._foundation.types import DType, FloatArray, FloatScalar, Number, State
from .._numerics.matrices import Matrix, by_bands, dense, inner, linear_solve, magnitudes, stacked, times
from .contacts import (
    Alike,
    Contact,
    as_one,
    laws_in,
    power_series_of,
    rates_at,
    size_of,
    values_at,
)
from .contacts_model import ContactsModel, Gain, InMode, Instant, Limits, acceleration, holding, solved
from .friction import AtAge, FrictionLaw
from .switched_model import Along, Forcing, Form, HasEnergies, Powers, Terms, later, of_form

# What a model of a structure needs of linear algebra, and its rates.


_Tree = TypeVar("_Tree")


class Matrices(NamedTuple):
    """What a `LinearStructure` needs of linear algebra.

    - `inverse_mass`, and from the left by it: `stiffness`, `damping`, `by_force` of friction (the `directions` of the
      contacts), and `by_springs`, for each elongation of a spring in front of one; the latter two are zero for contacts
      with and without a spring.
    - `gain`: see `contact_forces`. `fastest`: see `LinearStructure.fastest`.
    - `softness`: of the springs, m/N, zero where there is none.
    - `by_position`: of the normal forces, by positions, N/m, (contacts, d); `None` where there are none.
    - `by_pendulum`: of normal forces times relative displacements in pendulums whose stiffness varies, 1/m, from the
      left by the inverse mass; `None` where there are none. Other pendulums are part of `stiffness`.
    """

    inverse_mass: Matrix
    stiffness: Matrix
    damping: Matrix | None
    directions: Matrix
    by_force: Matrix
    gain: Gain
    on_base: FloatArray
    fastest: FloatScalar
    by_springs: Matrix | None = None
    softness: FloatArray | None = None
    by_position: FloatArray | None = None
    by_pendulum: FloatArray | None = None

    def by_bands(self) -> "Matrices":
        """The same, large matrices with few bands by these: of ten blocks in a row, 28 of the 100 stiffnesses."""
        products = {
            name: by_bands(getattr(self, name))
            for name in ("inverse_mass", "stiffness", "directions", "by_force", "by_springs")
            if getattr(self, name) is not None
        }
        return self._replace(damping=None if self.damping is None else by_bands(self.damping), **products)


class StructureModel(ContactsModel, HasEnergies[Forcing]):
    """A `LinearStructure` on a base. State: positions (d,) and velocities (d,), and where there are springs in front of
    contacts their elongations (contacts,), zero of the other contacts.
    """

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
        if self.matrices.by_pendulum is not None:
            return super().implicit_changes(forcing, tau, y, weight, sides)
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
        moving = values[:size], values[size : 2 * size]
        if not self.has_sliders:
            return moving
        places = np.where(self.elastic, np.cumsum(self.elastic) - 1, -1)
        return *moving, jnp.append(values[2 * size :], 0)[places]

    def numbers(self, y: State) -> State:
        moving = tuple(part[..., i] for part in y[:2] for i in range(self.structure.size))
        return moving if not self.has_sliders else (*moving, *(y[2][..., i] for i in np.flatnonzero(self.elastic)))

    def stick_position(self, y: State) -> FloatArray:
        place = times(self._in_precision_of(y).directions, y[0])
        return jnp.append(place if not self.has_sliders else place - y[2], y[0][0])

    @property
    def elastic(self) -> np.ndarray:
        return self.structure.elastic

    def elongations(self, y: State) -> FloatArray:
        return y[2]

    def following(self, forcing: Forcing, tau: FloatScalar, y: State, way: FloatArray) -> FloatArray:
        rates = self.normal_rates_at(forcing, tau, y)
        return self.limits_under(rates, jnp.zeros_like(rates)).slip(way) * self.softness(y)

    def softness(self, y: State) -> FloatArray:
        softness = self._in_precision_of(y).softness
        assert softness is not None
        return softness

    def rates(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        rates = super().rates(forcing, tau, y, sign)
        if not self.has_sliders:
            return rates
        return *rates[:2], self._elongating(rates[2], self.following(forcing, tau, y, self._own(sign)), sign)

    def entered(self, forcing: Forcing, y: State, before: FloatArray, sign: FloatArray) -> State:
        return (*y[:2], self._at_limits(forcing, y, sign)) if self.has_sliders else y

    def instant(self, forcing: Forcing, tau: FloatScalar, y: State) -> Instant:
        base, of = forcing.base_at(self.smooth, tau), self._in_precision_of(y)
        pull = self._load(forcing, tau) - times(of.stiffness, y[0])
        if of.damping is not None:
            pull = pull - times(of.damping, y[1])
        if of.by_springs is not None:
            pull = pull - times(of.by_springs, y[2])
        pull = pull - self._swinging(forcing, tau, y)
        velocity = times(of.directions, y[1]) - of.on_base * base.velocity
        drift = times(of.directions, pull) - of.on_base * base.acceleration
        elongating = () if not self.has_sliders else (jnp.where(self.elastic, velocity, 0),)
        return Instant((y[1], pull, *elongating), velocity, drift, of.gain)

    def effect(self, forcing: Forcing, tau: FloatScalar, y: State, force: FloatArray) -> State:
        return jnp.zeros_like(y[0]), -times(self._in_precision_of(y).by_force, force), *map(jnp.zeros_like, y[2:])

    def limits(self, forcing: Forcing, tau: FloatScalar, y: State, velocity: FloatArray) -> Limits:
        return self.limits_under(self.normal_forces_at(forcing, tau, y), velocity)

    def limits_under(self, normal: FloatArray, velocity: FloatArray) -> Limits:
        """The forces that friction can exert at these relative velocities, under these normal forces."""
        return Limits(*(normal[:, None] * _coefficients(self.structure.contacts, velocity)).T)

    @property
    def varying(self) -> tuple[int, ...]:
        each = self.structure.contacts
        return () if isinstance(each, Alike) else tuple(i for i, one in enumerate(each) if one.has_varying_normal_force)

    def normal_scale(self, forcing: Forcing, y: State) -> FloatArray:
        scales = jnp.stack([size_of(self.structure.normal_forces[number], forcing.t) for number in self.varying])
        of = self._in_precision_of(y)
        if of.by_position is None:
            return scales
        return scales + times(jnp.abs(of.by_position[np.array(self.varying)]), jnp.abs(y[0]))

    def normal_forces_at(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        given, of = values_at(self.structure.normal_forces, forcing.t, forcing.normal, tau), self._in_precision_of(y)
        return given if of.by_position is None else given + times(of.by_position, y[0])

    def normal_rates_at(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        """The time derivatives of the normal forces, N/s."""
        given, of = rates_at(self.structure.normal_forces, forcing.t + tau, forcing.normal), self._in_precision_of(y)
        return given if of.by_position is None else given + times(of.by_position, y[1])

    def velocity_scale(self, forcing: Forcing, y: State) -> FloatArray:
        base, of = forcing.base_at(self.smooth, jnp.zeros_like(forcing.t)), self._in_precision_of(y)
        return times(magnitudes(of.directions), jnp.abs(y[1])) + jnp.abs(of.on_base * base.velocity)

    def gross_changes(self, forcing: Forcing, y: State, h: FloatScalar, friction: FloatArray) -> State:
        x, v = jnp.abs(y[0]), jnp.abs(y[1])
        of = self._in_precision_of(y)
        load = jnp.abs(self._load(forcing, jnp.zeros_like(h))) + times(magnitudes(of.by_force), friction)
        load = load + times(magnitudes(of.stiffness), x)
        if of.by_pendulum is not None:
            normal = jnp.abs(self.normal_forces_at(forcing, jnp.zeros_like(h), y))
            load = load + times(jnp.abs(of.by_pendulum), normal * times(magnitudes(of.directions), x))
        if of.damping is not None:
            load = load + times(magnitudes(of.damping), v)
        if of.by_springs is None:
            return h * (v + h * load), h * load
        load = load + times(magnitudes(of.by_springs), jnp.abs(y[2]))
        return h * (v + h * load), h * load, h * self.velocity_scale(forcing, y)

    def friction_forces(self, forcing: Forcing, y: State, sign: FloatArray) -> tuple[FloatArray, FloatArray]:
        none, own = jnp.zeros_like(forcing.t), self._own(sign)
        now = self.instant(forcing, none, y)
        limits = self._limits(forcing, none, y, now.velocity, sign)
        force = solved(now.gain, now.drift, limits.slip(own), self._rigid(own == 0))
        velocity = now.velocity
        if self.has_sliders:
            of = self.sliders(forcing, none, y, sign)
            force, velocity = (jnp.where(self.elastic, *pair) for pair in ((of.force, force), (of.velocity, velocity)))
        return force, jnp.where(own == 0, 0, velocity)

    def base_shear(self, forcing: Forcing, total: FloatArray) -> FloatScalar:
        # Of the load, the ground's acceleration is no force in the frame at rest.
        applied = self._load(forcing, jnp.zeros_like(forcing.t)) + forcing.ground[0]
        return jnp.sum(_product(self.structure.mass, total - applied))

    def stored_energies(self, y: State) -> Terms:
        of, (x, v) = self.structure, y[:2]
        elastic = inner(x, _product(of.mass, times(self._in_precision_of(y).stiffness, x)))  # of pendulums, too
        if self.has_sliders:
            softness = self.softness(y)
            elastic = elastic + jnp.sum(jnp.where(softness > 0, y[2] ** 2 / jnp.where(softness > 0, softness, 1), 0))
        return {"kinetic": inner(v, _product(of.mass, v)) / 2, "elastic": elastic / 2}

    def powers_in(self, forcing: Forcing, y: State, sign: FloatArray) -> Powers:
        (force, velocity), of, v = self.friction_forces(forcing, y, sign), self.structure, y[1]
        none = jnp.zeros_like(forcing.t)
        base = -inner(force, self._in_precision_of(y).on_base) * forcing.base_at(self.smooth, none).velocity
        damping = jnp.zeros_like(base) if of.damping is None else inner(v, _product(of.damping, v))
        # Pendulums under normal forces that vary store no energy of their own: what presses on them works.
        load = self._load(forcing, none) - self._swinging(forcing, none, y)
        supplied = {"base": base, "load": inner(v, _product(of.mass, load))}
        return Powers(supplied, {"friction": inner(force, velocity), "damping": damping})

    def _swinging(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        """How the pendulums whose stiffness varies decelerate each mass, m/s^2; open ones do not."""
        of = self._in_precision_of(y)
        if of.by_pendulum is None:
            return jnp.zeros_like(y[0])
        normal = jnp.maximum(self.normal_forces_at(forcing, tau, y), 0)
        return times(of.by_pendulum, normal * times(of.directions, y[0]))

    def _load(self, forcing: Forcing, tau: FloatScalar) -> FloatArray:
        """What ground and external forces do to each mass, m/s^2."""
        load = jnp.full((self.structure.size,), -later(forcing.ground, tau))
        if self.structure.force is None:
            return load
        applied = values_at(self.structure.force, forcing.t, forcing.force, tau)
        return load + times(in_dtype(self.matrices.inverse_mass, forcing.t.dtype), applied)

    def _in_precision_of(self, y: State) -> Matrices:
        return in_dtype(self.matrices, y[0].dtype)


def _product(matrix: Any, vector: FloatArray) -> FloatArray:
    """A matrix, or its diagonal, times a vector."""
    matrix = jnp.asarray(matrix, vector.dtype)
    return matrix * vector if matrix.ndim == 1 else times(matrix, vector)


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
        reached = tuple(reduce(add, reversed(series)) for series in _series(self, forcing, y, h, sign) if series)
        return self._held(forcing, h, reached, self._own(sign) == 0), None

    def dense(self, forcing: Forcing, y: State, h: FloatScalar, sign: FloatArray) -> Callable[[FloatScalar], State]:
        series, length = _series(self, forcing, y, h, sign), jnp.where(h > 0, h, 1)

        def at(tau: FloatScalar) -> State:
            share = tau / length
            return tuple(reduce(lambda value, term: value * share + term, reversed(one)) for one in series if one)

        return at

    def along(self, forcing: Forcing, y: State, h: FloatScalar, sign: FloatArray, forms: tuple[Form, ...]) -> Along:
        of_numbers = self.numbers(tuple(jnp.stack(series) for series in _series(self, forcing, y, h, sign) if series))
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

    def slip_coefficients(self, sign: FloatArray) -> FloatArray:
        """The friction coefficients, with their signs, (contacts,); 0 in sticks and open contacts."""
        own = self._own(sign)
        return self._closed(self.limits_under(jnp.ones_like(own), jnp.zeros_like(own)), sign).slip(own)

    def _sources(
        self, held: "_Held", forcing: Forcing, y: State, sign: FloatArray, terms: int
    ) -> list[FloatArray | None]:
        """The coefficients in the power series of accelerations (masses,) that do not depend on the state."""
        t, of, none, slip = forcing.t, held.of, jnp.zeros_like(forcing.t), self.slip_coefficients(sign)
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

    def _elongating_series(
        self, forcing: Forcing, y: State, sign: FloatArray, terms: int
    ) -> list[tuple[FloatArray, FloatArray | None]]:
        """The coefficients in the power series of the rates of elongations (contacts,): in sticks those of the base's
        part of the relative velocities, in slips those of the limits.
        """
        t, reach = forcing.t, self.slip_coefficients(sign) * self.softness(y)
        normal = power_series_of(self.structure.normal_forces, t, forcing.normal, terms + 1)
        base: tuple[FloatArray | None, ...] = (None,) * terms
        if self.smooth is not None:
            base = cast(Harmonic | SumOfHarmonics, self.smooth).power_series(t, terms)
        linear = (*forcing.base, *(jnp.zeros_like(t),) * (terms - 2))
        return [
            (part if smooth is None else part + smooth, None if growth is None else (k + 1) * reach * growth)
            for k, (part, smooth, growth) in enumerate(zip(linear, base, normal[1:], strict=True))
        ]

    def in_mode(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatArray) -> tuple[InMode, InMode]:
        of, own = self._in_precision_of(y), self._own(sign)
        sticks = self._rigid(own == 0)
        now = self.instant(forcing, tau, y)
        t, normal = forcing.t + tau, self.normal_forces_at(forcing, tau, y)
        normal_rate = self.normal_rates_at(forcing, tau, y)
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
        if of.by_springs is not None:
            pull = pull - times(of.by_springs, self.rates(forcing, tau, y, sign)[2])
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
) -> tuple[list[FloatArray], list[FloatArray], list[FloatArray]]:
    """The terms of the power series of positions and velocities, (masses,) each, after the time `h` (s); and of the
    elongations (contacts,), if there are any.
    """
    of, sticks = model._in_precision_of(y), model._rigid(model._own(sign) == 0)
    terms = _TERMS[h.dtype.itemsize][of.damping is not None]
    held = _Held(of, holding(of.gain, sticks))
    sources = model._sources(held, forcing, y, sign, terms)
    x, v, power = [y[0]], [y[1]], jnp.ones_like(h)
    stretching = [] if of.by_springs is None else model._elongating_series(forcing, y, sign, terms)
    e, follows = list(y[2:]), (model._own(sign) == 0) & ~model._is_open(sign)
    slip = model.slip_coefficients(sign)
    for k, source in enumerate(sources):
        pull = times(of.stiffness, x[k])
        if of.by_springs is not None:
            pull = pull + times(of.by_springs, e[k])
        if of.by_position is not None:
            pull = pull + times(of.by_force, slip * times(of.by_position, x[k]))
        if of.damping is not None:
            pull = pull + times(of.damping, v[k])
        rate = -held(pull)
        if source is not None:
            rate = rate + power * source
        share = (1 / (k + 1)) * h
        if stretching:
            (of_base, of_limit), held_to = stretching[k], times(of.directions, v[k])
            limit = jnp.zeros_like(e[0]) if of_limit is None else power * of_limit
            if of.by_position is not None and of.softness is not None:
                limit = limit + slip * of.softness * times(of.by_position, v[k])
            stretch = jnp.where(follows, held_to - of.on_base * (power * of_base), limit)
            e.append(jnp.where(model.elastic, share * stretch, 0))
        x.append(share * v[k])
        v.append(share * rate)
        power = power * h
    return x, v, e


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
