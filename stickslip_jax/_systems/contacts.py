"""Dry-friction contacts, and the normal forces in them, which may be functions of time."""

import dataclasses
import math
from typing import Annotated, Any, TypeAlias, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._excitation.motion import Harmonic, Motion, Signal, SumOfHarmonics
from .._excitation.recorded import ForceSteps, Recorded
from .._foundation import checks
from .._foundation.fields import Checked, Quantity, is_distribution
from .._foundation.types import (
    FloatArray,
    FloatScalar,
    Number,
    Scalar,
)
from .._numerics.matrices import WRITTEN_OUT, stacked
from .friction import FrictionLaw, require_law
from .switched_model import later

# Normal forces of contacts: numbers, or functions of time.


NormalForce: TypeAlias = Number | Signal | Recorded | ForceSteps
"""N: a number, or a function of time."""
_PIECES = Recorded, ForceSteps
_FUNCTIONS = Signal, *_PIECES
_Tree = TypeVar("_Tree")


@dataclasses.dataclass(frozen=True, repr=False)
class ForceQuantity(Quantity):
    """A number, or a function of time."""

    def is_function(self, value: object) -> bool:
        return isinstance(value, _FUNCTIONS)

    def check(self, name: str, value: object) -> None:
        is_other = isinstance(value, Motion) or (callable(value) and not is_distribution(value))
        if is_other and not self.is_function(value):
            hint = "of a function of your own make a signal, ss.Signal.of(function, shortest_period=...)"
            demand = f"be a number (in {self.unit}), a Signal such as Harmonic, a Recorded or a ForceSteps"
            raise checks.refused(name, demand, value, hint)
        super().check(name, value)


def is_function(force: NormalForce | None) -> bool:
    """Whether it varies in time."""
    return isinstance(force, _FUNCTIONS)


def recorded_in(forces: tuple[NormalForce | None, ...]) -> tuple[Recorded | ForceSteps, ...]:
    """Those that are piecewise linear in time."""
    return tuple(one for one in forces if isinstance(one, _PIECES))


def force_at(force: NormalForce | None, times: FloatArray) -> FloatArray:
    """Its values at `times` (s), (times,), N."""
    if isinstance(force, Signal):
        return jax.vmap(force.value)(times)
    return force.value(times) if isinstance(force, _PIECES) else jnp.full_like(times, 0.0 if force is None else force)


Forces: TypeAlias = tuple[NormalForce | None, ...] | FloatArray
"""Several; an array where all are numbers of one `Alike`."""
Recordings: TypeAlias = tuple[tuple[FloatScalar, FloatScalar], ...]
"""Values and slopes, at a time, of those forces of several that are `recorded_in` them."""


def values_at(forces: Forces, t: FloatScalar, recorded: Recordings, tau: FloatScalar | float = 0.0) -> FloatArray:
    """Forces (forces,) at the time ``t + tau`` (s), N, of which None is zero; `recorded`: at `t`."""
    if not isinstance(forces, tuple):
        return forces.astype(t.dtype)
    values, pieces = [], iter(recorded)
    for one in forces:
        if isinstance(one, Signal):
            values.append(one.value(t + tau))
        elif isinstance(one, _PIECES):
            values.append(later(next(pieces), tau))
        else:
            values.append(0.0 if one is None else one)
    return jnp.stack([jnp.asarray(value, t.dtype) for value in values])


def rates_at(forces: Forces, t: FloatScalar, recorded: Recordings) -> FloatArray:
    """The time derivatives (forces,) of `forces` at the time `t`."""
    if not isinstance(forces, tuple):
        return jnp.zeros(forces.shape, t.dtype)
    pieces = iter(recorded)
    rates = [
        one.rate(t) if isinstance(one, Signal) else next(pieces)[1] if isinstance(one, _PIECES) else 0.0
        for one in forces
    ]
    return jnp.stack([jnp.asarray(rate, t.dtype) for rate in rates])


def power_series_of(forces: Forces, t: FloatScalar, recorded: Recordings, terms: int) -> list[FloatArray | None]:
    """The coefficients (forces,) of the power series of `forces` in the time since `t`; None where all are zero.

    Signals must be harmonic.
    """
    if not len(forces):
        return [None] * terms
    if not isinstance(forces, tuple):
        return [values_at(forces, t, recorded), *[None] * (terms - 1)]
    harmonic = [cast(Harmonic | SumOfHarmonics, one) for one in forces if isinstance(one, Signal)]
    waves, pieces = iter([one.power_series(t, terms) for one in harmonic]), iter(recorded)
    none = jnp.zeros_like(t)
    each = [
        next(waves) if isinstance(one, Signal) else (none, next(pieces)[1]) if isinstance(one, _PIECES) else (none,)
        for one in forces
    ]
    highest = max(map(len, each))
    series = [jnp.stack([own[k] if k < len(own) else none for own in each]) for k in range(1, highest)]
    return [values_at(forces, t, recorded), *series, *[None] * (terms - highest)]


def size_of(normal_force: NormalForce, t: FloatScalar) -> FloatScalar:
    """The size of the terms that add up to its value at the time `t` (s): the scale of its round-off at zero."""
    largest = largest_of(normal_force)
    if largest is not None:
        return jnp.asarray(largest, t.dtype)
    signal = cast(Signal, normal_force)
    radian = 0.0 if signal.shortest_period is None else jnp.minimum(signal.shortest_period / (2 * math.pi), jnp.abs(t))
    # What oscillates is as large as its curvature says where it is zero.
    return jnp.abs(signal.value(t)) + jnp.abs(signal.curvature(t)) * radian**2


def largest_of(normal_force: NormalForce) -> Scalar | None:
    """The largest size that it has at any time, N, or an upper bound of it; None where that is not known."""
    # Known numbers stay known, under jit too.
    xp: Any = jnp if checks.holds_traced(normal_force) else np
    if isinstance(normal_force, _PIECES):
        return xp.max(xp.abs(xp.asarray(normal_force.values, float)))
    if not isinstance(normal_force, Signal):
        return xp.abs(xp.asarray(normal_force, float))
    if not normal_force.is_harmonic:
        return None
    tones: Any = normal_force
    return jnp.sum(jnp.abs(jnp.atleast_1d(jnp.asarray(tones.tones[0], float)))) + jnp.abs(
        jnp.asarray(tones.mean, float)
    )


def periods_of(normal_forces: Forces) -> dict[str, Scalar | None]:
    """The shortest period (s) of each that is a smooth function of time, by what it is called."""
    return {
        f"shortest period of normal force {number}": one.shortest_period
        for number, one in enumerate(normal_forces)
        if isinstance(one, Signal)
    }


# One dry-friction contact of a structure with several.


def numbers_of(values: Any) -> Any:
    """Numbers of a sequence as an array of NumPy; arrays, traced or not, as they are, and what is to be refused."""
    try:
        return np.asarray(checks.numbers("", values), float) if isinstance(values, (list, tuple)) else values
    except ValueError:
        return values


def entries_of(values: Any) -> Any:
    """A list as a tuple; anything else as it is."""
    return tuple(values) if isinstance(values, list) else values


SeriesStiffness = Annotated[Number | None, Quantity("N/m", above=0, meaning="of a spring in front of the contact")]


def check_spring(series_stiffness: SeriesStiffness, law: FrictionLaw) -> None:
    """Raises ValueError for a spring in front of a contact whose friction is not constant in either direction."""
    if series_stiffness is not None and (not law.constant or law.grows or law.inner_state is not None):
        raise checks.refused(
            "series_stiffness",
            f"be None for {checks.show(law)}: a slider without mass jumps where friction depends on its speed or age",
            series_stiffness,
            "take Coulomb, or give the slider a mass of its own",
        )


class Contact(Checked):
    """A dry-friction contact of a `LinearStructure`.

    Its relative velocity is ``direction . velocities - on_base * base velocity``. The friction force acts against it on
    the masses, in proportion to `direction`.

    Args:
        direction: (d,), what each velocity of the structure contributes to the relative velocity.
        normal_force: N, positive; or a function of time: a `Signal` such as `Harmonic`, a `Recorded` or a `ForceSteps`.
            While that is zero or negative the contact is open: there is no friction, and it does not stick.
        friction: The friction law, such as `Coulomb(mu)`.
        on_base: How much of the base velocity is subtracted: 1 for a mass that rubs on the base, 0 for a contact
            between two masses, or with the ground.
        series_stiffness: N/m, of a spring in front of the contact, as in the elements of Jenkins and Iwan and in
            friction dampers: a slider without mass, which sticks while the spring's force is within the limit. What
            sticks and slips is the slider; the elongation of its spring is a further number of the state, zero at first
            unless given; one beyond the limit slips to it at once. For laws with one constant coefficient in either
            direction. None: no spring.
        normal_stiffness: (d,), by how much the normal force grows with each position of the structure, N/m, as where
            a spring or pad presses; the contact is open where that makes it zero or negative. None: with none.
        radius: m, positive, of a pendulum bearing (the effective radius): besides friction, ``normal_force / radius``
            times the relative displacement ``direction . positions`` pulls the masses back, along `direction`, while
            the contact is closed. Positions are then relative to the ground, which a `GroundAcceleration` shakes:
            unless `on_base` is 0, a base that moves is refused. None: flat.

    Raises:
        ValueError: If a number is out of its range or not finite, `friction` is no friction law, or there is a spring
            in front of one that depends on the speed or the age.
    """

    direction: Any = eqx.field(converter=numbers_of)
    normal_force: Annotated[
        NormalForce,
        ForceQuantity("N", above=0, hint="a contact that opens has a function of time, such as a ForceSteps"),
    ]
    friction: FrictionLaw
    on_base: Annotated[Number, Quantity("", meaning="share of the base velocity that is subtracted")] = 1.0
    series_stiffness: SeriesStiffness = None
    normal_stiffness: Annotated[
        Any, Quantity("N/m", meaning="growth of the normal force with each position", ndim=1)
    ] = eqx.field(default=None, converter=numbers_of)
    radius: Annotated[Number | None, Quantity("m", above=0, meaning="of a pendulum bearing")] = None

    def check_parts(self) -> None:
        checks.bounded("direction", self.direction, ndim=1)
        require_law("friction", self.friction)
        check_spring(self.series_stiffness, self.friction)

    @property
    def has_varying_normal_force(self) -> bool:
        """Whether the normal force changes with time or with the positions."""
        return is_function(self.normal_force) or self.normal_stiffness is not None

    @property
    def swings_differently(self) -> bool:
        """Whether it is a pendulum whose stiffness changes with time or with the positions."""
        return self.radius is not None and self.has_varying_normal_force

    @property
    def curvature(self) -> Scalar:
        """Of a pendulum ``1 / radius``, 1/m; of a flat contact 0."""
        return 0.0 if self.radius is None else 1 / self.radius

    @classmethod
    def of_mass(
        cls,
        index: int,
        masses: int,
        normal_force: NormalForce,
        friction: FrictionLaw,
        series_stiffness: Number | None = None,
        radius: Number | None = None,
    ) -> "Contact":
        """The contact of mass number `index` (from 0) of `masses` with the base."""
        unit = _unit(index, masses)
        return cls(unit, normal_force, friction, series_stiffness=series_stiffness, radius=radius)

    @classmethod
    def between(
        cls,
        first: int,
        second: int,
        masses: int,
        normal_force: NormalForce,
        friction: FrictionLaw,
        series_stiffness: Number | None = None,
    ) -> "Contact":
        """The contact of mass number `first` with mass number `second` (from 0) of `masses`."""
        return cls(_unit(first, masses) - _unit(second, masses), normal_force, friction, 0.0, series_stiffness)


def as_one(trees: tuple[_Tree, ...]) -> _Tree | None:
    """Trees that differ by their numbers alone as one, whose numbers are arrays (trees, ...); None of others."""
    if len({(jax.tree.structure(one), tuple(map(np.shape, jax.tree.leaves(one)))) for one in trees}) > 1:
        return None
    return jax.tree.map(lambda *leaves: stacked(leaves, jnp.result_type(float)), *trees)


class Alike(eqx.Module):
    """Many contacts that differ by their numbers alone, as `each`, whose numbers are arrays (number, ...).

    JAX would trace, and XLA compile, the numbers of a thousand contacts one by one.
    """

    each: Contact
    number: int = eqx.field(static=True)

    @staticmethod
    def of(contacts: tuple[Contact, ...]) -> "tuple[Contact, ...] | Alike":
        """`contacts` as one, if they are many and alike, else as they are."""
        first = contacts[0]
        remembers = first.friction.grows or first.friction.inner_state is not None
        if len(contacts) <= WRITTEN_OUT or remembers or first.has_varying_normal_force:
            return contacts
        each = as_one(contacts)
        return contacts if each is None else Alike(each, len(contacts))

    def __len__(self) -> int:
        return self.number


def kinds_in(contacts: "tuple[Contact, ...] | Alike") -> tuple[Contact, ...]:
    """All, or the one of those that are alike."""
    return contacts if isinstance(contacts, tuple) else (contacts.each,)


def laws_in(contacts: "tuple[Contact, ...] | Alike") -> tuple[FrictionLaw, ...]:
    """The friction laws of all, or the one of those that are alike."""
    return tuple(one.friction for one in kinds_in(contacts))


def _unit(index: int, masses: int) -> np.ndarray:
    checks.whole_number("index", index, minimum=0, maximum=masses - 1)
    unit = np.zeros(masses)
    unit[index] = 1
    return unit
