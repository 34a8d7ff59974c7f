"""A user's system under its excitation: what drives it, and the model of one with several contacts."""

from collections.abc import Iterable
from functools import lru_cache, partial
from itertools import repeat
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._excitation.motion import Signal
from .._excitation.recorded import ForceSteps, Recorded
from .._excitation.segments import added
from .._foundation.types import BoolArray, ExplicitSolver, FloatArray, FloatScalar, State
from .._numerics.derivatives import without_derivatives
from .._numerics.matrices import is_positive_definite, linear_solve
from .._numerics.steps import gross_changes
from .contacts import ContactsModel, Instant, Limits, Uncoupled
from .switched_model import Segments, base_motion

# What drives a user's `SwitchedSystem` from one instant on: its base, the ground, and the records in its fields.


S = TypeVar("S")


class UsersBase(NamedTuple):
    """The base at one instant, as a user's methods are given it; zeros for a base and a ground at rest.

    - `velocity`, `acceleration`: of the base, m/s and m/s^2 (or rad/s and rad/s^2).
    - `ground`: the acceleration of the ground, m/s^2.
    """

    velocity: FloatScalar
    acceleration: FloatScalar
    ground: FloatScalar


class GeneralForcing(NamedTuple):
    """The piecewise-linear parts of base velocity (m/s) and ground acceleration (m/s^2) from time `t` on, and the
    values of the records in the fields of the system: each with its slope.
    """

    t: FloatScalar
    base: FloatScalar
    base_slope: FloatScalar
    ground: FloatScalar
    ground_slope: FloatScalar
    records: tuple[tuple[FloatScalar, FloatScalar], ...]

    @classmethod
    def of(cls, t: FloatScalar, segments: Segments) -> "GeneralForcing":
        """The forcing from `t` on, until one of the present segments ends."""
        records = tuple(added(t, (segment,)) for segment in segments.force)
        return cls(t, *added(t, segments.base), *added(t, segments.ground), records)

    def base_at(self, smooth: Signal | None, tau: FloatScalar) -> UsersBase:
        """The base `tau` (s) later, of velocity ``smooth`` plus the linear part."""
        base = base_motion(smooth, self.t, self.base, self.base_slope, tau)
        return UsersBase(base.velocity, base.acceleration, self.ground + tau * self.ground_slope)

    def seen_at(self, system: S, t: FloatScalar) -> S:
        """The `system` whose records have their value at `t` on their present segments, without a search in them."""
        if not self.records:
            return system
        return with_records_at(system, t, [value + (t - self.t) * slope for value, slope in self.records])


def with_records_at(system: S, t: FloatScalar, values: Iterable[FloatScalar]) -> S:
    """The `system` whose records have these `values` at `t`."""
    now, (leaves, tree) = iter(values), jax.tree.flatten(system, is_leaf=is_record)
    return jax.tree.unflatten(tree, [_SeenAt(leaf, t, next(now)) if is_record(leaf) else leaf for leaf in leaves])


def is_record(value: object) -> bool:
    """Whether `value` is piecewise linear in time, at given times."""
    return isinstance(value, (Recorded, ForceSteps))


def records_in(system: Any) -> tuple[Recorded | ForceSteps, ...]:
    """The records in the fields of `system`."""
    return tuple(leaf for leaf in jax.tree.leaves(system, is_leaf=is_record) if is_record(leaf))


class _SeenAt:
    """A record at the time `t` that a user's method is given: its value there is that of the present segment.

    At its ends a step sees the same segment as inside. At other times the record is asked.
    """

    def __init__(self, record: Recorded | ForceSteps, t: FloatScalar, now: FloatScalar):
        self._record, self._t, self._now = record, t, now

    # It is one of these to isinstance, as methods that take numbers too ask.
    @property
    def __class__(self) -> type:  # pyright: ignore[reportIncompatibleMethodOverride]
        return type(self._record)

    def value(self, t: Any) -> Any:
        return self._now if t is self._t else self._record.value(t)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._record, name)


# Whether what a user's methods return depends on time by itself.


def differs_between(system: Any, y0: Any, times: np.ndarray, others: np.ndarray) -> bool:
    """Whether rates, relative velocities or normal forces of `system`, its base at rest, are others at `times` than at
    `others` (s), near the state `y0`: not in it, where a number may be zero.
    """
    start, zero = np.asarray(y0, float), jnp.zeros(())
    state = tuple(jnp.asarray(start + (0.3 + 0.1 * np.arange(len(start))) * (1 + np.abs(start))))
    base = UsersBase(zero, zero, zero)
    friction = jnp.full(() if system.contacts is None else (system.contacts,), 0.5)

    def at(t):
        rates = [system.rates(t, state, base, share * friction) for share in (0.0, 1.0)]
        forces = system.normal_forces(t, state, base) if system.has_normal_forces else ()
        parts = jax.tree.leaves((rates, system.relative_velocity(t, state, base), forces))
        return jnp.concatenate([jnp.ravel(jnp.asarray(part, float)) for part in parts])

    first, second = (np.asarray(jax.vmap(at)(jnp.asarray(values))) for values in (times, others))
    scale = np.max(np.abs(first), axis=0)
    return bool(np.any(np.abs(first - second) > np.sqrt(np.finfo(first.dtype).eps) * scale))


def depends_on_time(system: Any) -> bool:
    """Whether what the methods of `system` return depends on time otherwise than by its base and its records."""
    leaves, structure = jax.tree.flatten(system)
    kind = structure, tuple(jax.ShapeDtypeStruct(jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)
    try:
        return _depends_on_time(*kind)
    except TypeError:  # a static field cannot be hashed
        return _depends_on_time.__wrapped__(*kind)


@lru_cache(maxsize=256)
def _depends_on_time(structure: Any, leaves: tuple[jax.ShapeDtypeStruct, ...]) -> bool:
    def at(t, numbers):
        given: Any = jax.tree.unflatten(structure, numbers)
        zero, system = jnp.zeros(()), with_records_at(given, t, repeat(jnp.zeros(())))
        base, y = UsersBase(zero, zero, zero), (zero,) * len(given.state_names)
        friction = jnp.zeros(() if given.contacts is None else (given.contacts,))
        forces = system.normal_forces(t, y, base) if given.has_normal_forces else ()
        return system.rates(t, y, base, friction), system.relative_velocity(t, y, base), forces

    try:  # what does not depend on t stays without the axis of a batch of times
        jax.eval_shape(jax.vmap(at, (0, None), out_axes=None), jnp.zeros(2), leaves)
    except ValueError:
        return True
    return False


# A user's system with several contacts under its excitation.


class GeneralContactsModel(ContactsModel[GeneralForcing]):
    """A `SwitchedSystem` with several contacts, on a base of velocity ``smooth(t)`` plus piecewise-linear parts."""

    system: Any  # a SwitchedSystem, which makes this model
    smooth: Signal | None
    solver: ExplicitSolver
    fastest: FloatScalar
    age: FloatArray | None = None

    def at_age(self, age: FloatArray) -> "GeneralContactsModel":
        return eqx.tree_at(lambda model: model.age, self, age, is_leaf=lambda leaf: leaf is None)

    @property
    def contacts(self) -> int:
        assert self.system.contacts is not None
        return self.system.contacts

    @property
    def coupled(self) -> bool:
        return True

    def forcing(self, t: FloatScalar, segments: Segments) -> GeneralForcing:
        return GeneralForcing.of(t, segments)

    def time(self, forcing: GeneralForcing) -> FloatScalar:
        return forcing.t

    def stick_position(self, y: State) -> FloatArray:
        return jnp.broadcast_to(y[0], (self.contacts + 1,))

    def instant(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> Instant:
        t, base = self._base_at(forcing, tau)
        idle, by_friction = self._affine(forcing, t, y, base)
        # The relative velocities depend on the base's velocity only, whose rate is its acceleration.
        none = jnp.zeros_like(t)
        moving = (jnp.ones_like(t), idle, UsersBase(base.acceleration, none, none))
        velocity, drift = jax.jvp(partial(self._velocities, forcing), (t, y, base), moving)

        def along(effect: State) -> FloatArray:
            return jax.jvp(lambda y: self._velocities(forcing, t, y, base), (y,), (effect,))[1]

        return Instant(idle, velocity, drift, -jax.vmap(along, out_axes=1)(by_friction))

    def effect(self, forcing: GeneralForcing, tau: FloatScalar, y: State, force: FloatArray) -> State:
        _, by_friction = self._affine(forcing, *self._at(forcing, tau, y))
        return tuple(jnp.sum(force * each) for each in by_friction)

    def rates(self, forcing: GeneralForcing, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        """The rates, continued smoothly to beyond the ends of slips.

        The last Runge-Kutta step of a slip may have stages slightly beyond its end. Friction that depends on the
        absolute relative velocity has a kink there, which would cost the order: beyond, rates are extrapolated from the
        mirror image of the state.
        """
        t, base = self._base_at(forcing, tau)
        velocity, own = self._velocities(forcing, t, y, base), self._own(sign)
        beyond = (own * velocity < 0) & ~self._is_open(sign)
        gradients = jax.jacrev(lambda y: self._velocities(forcing, t, y, base))(y)
        rows = jnp.stack(gradients, axis=-1)  # (contacts, states)
        both = beyond[:, None] & beyond[None, :]
        matrix = jnp.where(both, rows @ rows.T, jnp.eye(len(own), dtype=t.dtype))
        shift = rows.T @ jnp.where(beyond, linear_solve(matrix, jnp.where(beyond, velocity, 0)), 0)
        end, image = (tuple(value - k * shift[i] for i, value in enumerate(y)) for k in (1, 2))
        here, there = (super(GeneralContactsModel, self).rates(forcing, tau, state, sign) for state in (end, image))
        passed = jnp.any(beyond)
        return tuple(jnp.where(passed, 2 * a - b, b) for a, b in zip(here, there, strict=True))

    def limits(self, forcing: GeneralForcing, tau: FloatScalar, y: State, velocity: FloatArray) -> Limits:
        normal = self._normal_forces(forcing, tau, y)
        ratio = self.system.static_ratio if self.age is None else self.system.static_ratio_after(self.age)
        static = normal * jnp.broadcast_to(jnp.asarray(ratio, normal.dtype), normal.shape)
        return Limits(normal, normal, static, static)

    @property
    def varying(self) -> tuple[int, ...]:
        return tuple(range(self.contacts)) if self.system.has_normal_forces else ()

    def varying_normal_forces(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> FloatArray:
        return self._normal_forces(forcing, tau, y)

    def normal_forces_at(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> FloatArray:
        return self._normal_forces(forcing, tau, y)

    def normal_scale(self, forcing: GeneralForcing, y: State) -> FloatArray:
        t, base = self._base_at(forcing, jnp.zeros_like(y[0]))

        def rate(t: FloatScalar) -> FloatArray:
            return jax.jvp(lambda t: self._normal(forcing, t, y, base), (t,), (jnp.ones_like(t),))[1]

        # What oscillates in time is as large as its curvature says where it is zero.
        bend = jax.jvp(rate, (t,), (jnp.ones_like(t),))[1] / self.fastest**2
        slopes = jax.jacrev(lambda numbers: self._normal(forcing, t, *numbers))((y, base))
        terms = jax.tree.map(lambda slope, number: jnp.abs(slope * number), slopes, (y, base))
        return jnp.abs(self._normal(forcing, t, y, base)) + jnp.abs(bend) + sum(jax.tree.leaves(terms))

    def velocity_scale(self, forcing: GeneralForcing, y: State) -> FloatArray:
        t, base = self._base_at(forcing, jnp.zeros_like(y[0]))
        slopes = jax.jacrev(lambda y: self._velocities(forcing, t, y, base))(y)
        by_base = jax.jacfwd(lambda v: self._velocities(forcing, t, y, base._replace(velocity=v)))(base.velocity)
        by_state = sum(jnp.abs(slope * value) for slope, value in zip(slopes, y, strict=True))
        return jnp.abs(self._velocities(forcing, t, y, base)) + jnp.abs(by_base * base.velocity) + by_state

    def gross_changes(self, forcing: GeneralForcing, y: State, h: FloatScalar, friction: FloatArray) -> State:
        model, forcing, y, h = without_derivatives((self, forcing, y, h))
        t, base = model._base_at(forcing, jnp.zeros_like(h))
        none = jnp.zeros_like(friction)
        slopes = jax.jacfwd(partial(model._rates, forcing, t), argnums=(0,))(y, base, none)
        _, by_friction = model._affine(forcing, t, y, base)
        by_contacts = [jnp.sum(jnp.abs(each) * friction) for each in by_friction]
        (by_state,) = zip(*slopes, strict=True)
        return gross_changes(h, y, model._rates(forcing, t, y, base, none), by_state, tuple(by_contacts))

    def at_base_velocity(self, forcing: GeneralForcing, y: State, resting: BoolArray) -> State:
        """As of every model; NaN where the contacts have no unique motion, because friction would drive itself."""
        y = super().at_base_velocity(forcing, y, resting)
        gain = self.instant(forcing, jnp.zeros_like(y[0]), y).gain
        assert not isinstance(gain, Uncoupled)
        return jnp.where(is_positive_definite((gain + gain.T) / 2), y[0], jnp.nan), *y[1:]

    def _at(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> tuple[FloatScalar, State, UsersBase]:
        t, base = self._base_at(forcing, tau)
        return t, y, base

    def _base_at(self, forcing: GeneralForcing, tau: FloatScalar) -> tuple[FloatScalar, UsersBase]:
        return forcing.t + tau, forcing.base_at(self.smooth, tau)

    def _rates(self, forcing: GeneralForcing, t: FloatScalar, y: State, base: UsersBase, friction: FloatArray) -> State:
        return tuple(jnp.asarray(rate, t.dtype) for rate in forcing.seen_at(self.system, t).rates(t, y, base, friction))

    def _affine(
        self, forcing: GeneralForcing, t: FloatScalar, y: State, base: UsersBase
    ) -> tuple[State, tuple[FloatArray, ...]]:
        """The rates without friction, and what one unit of friction in each contact adds, each (contacts,)."""
        none = jnp.zeros(self.contacts, t.dtype)

        def along(direction):
            return jax.jvp(lambda friction: self._rates(forcing, t, y, base, friction), (none,), (direction,))

        return jax.vmap(along, out_axes=(None, 0))(jnp.eye(self.contacts, dtype=t.dtype))

    def _velocities(self, forcing: GeneralForcing, t: FloatScalar, y: State, base: UsersBase) -> FloatArray:
        return _stacked(forcing.seen_at(self.system, t).relative_velocity(t, y, base), t)

    def _normal(self, forcing: GeneralForcing, t: FloatScalar, y: State, base: UsersBase) -> FloatArray:
        return _stacked(forcing.seen_at(self.system, t).normal_forces(t, y, base), t)

    def _normal_forces(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> FloatArray:
        if not self.system.has_normal_forces:
            return jnp.ones(self.contacts, y[0].dtype)
        return self._normal(forcing, *self._at(forcing, tau, y))


def _stacked(values: Any, t: FloatScalar) -> FloatArray:
    """The numbers of a sequence or an array as an array."""
    if isinstance(values, (tuple, list)):
        return jnp.stack([jnp.asarray(value, t.dtype) for value in values])
    return jnp.asarray(values, t.dtype)
