"""A user's system under its excitation: what drives it, and how it slips and sticks.

Slips and sticks are integrated; their ends follow from the rates. With the relative velocity ``sigma(t, y, base)`` and
``rates = a + b friction``, one unit of friction changes ``sigma'`` by ``gain = grad sigma . b`` (negative). In a stick,
friction is the share u of the kinetic force that keeps ``sigma' = 0`` (Filippov's sliding field); the stick
lasts while ``|u| <= static_ratio``. Where friction has no effect on sigma (``gain = 0``) nothing sticks.
"""

from collections.abc import Iterable
from functools import lru_cache, partial
from itertools import repeat
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from .._excitation.motion import Signal
from .._excitation.recorded import ForceSteps, Recorded
from .._excitation.segments import added
from .._foundation.types import BoolArray, BoolScalar, ExplicitSolver, FloatArray, FloatScalar, Scalar, State
from .._numerics.derivatives import without_derivatives
from .._numerics.matrices import is_positive_definite, linear_solve
from .._numerics.steps import gross_changes, relative_error, runge_kutta_step
from .contacts import ContactsModel, Instant, Limits, Uncoupled
from .friction import Coulomb, FrictionLaw
from .switched_model import FloatPair, OneContactModel, Segments, SwitchedModel, base_motion, with_change

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


# A user's system under its excitation.


class _OfUser(SwitchedModel[GeneralForcing]):
    """A `SwitchedSystem` on a base of velocity ``smooth(t)`` plus piecewise-linear parts."""

    system: Any  # a SwitchedSystem, which makes this model
    smooth: Signal | None
    solver: ExplicitSolver
    age: FloatArray | None = eqx.field(default=None, kw_only=True)

    def at_age(self, age: FloatArray) -> Any:
        return eqx.tree_at(lambda model: model.age, self, age, is_leaf=lambda leaf: leaf is None)

    @property
    def _static_ratio(self) -> Scalar | FloatArray:
        return self.system.static_ratio if self.age is None else self.system.static_ratio_after(self.age)

    def forcing(self, t: FloatScalar, segments: Segments) -> GeneralForcing:
        return GeneralForcing.of(t, segments)

    def base_at(self, forcing: GeneralForcing, tau: FloatScalar) -> tuple[FloatScalar, UsersBase, UsersBase]:
        """The time, the base and its time derivative, `tau` later."""
        t, base = forcing.t + tau, forcing.base_at(self.smooth, tau)
        jerk = jnp.zeros_like(t) if self.smooth is None else jnp.asarray(self.smooth.curvature(t), t.dtype)
        return t, base, UsersBase(base.acceleration, jerk, forcing.ground_slope)

    def _rates(self, forcing: GeneralForcing, t: FloatScalar, y: State, base: UsersBase, friction: FloatArray) -> State:
        return tuple(jnp.asarray(rate, t.dtype) for rate in forcing.seen_at(self.system, t).rates(t, y, base, friction))


# With one contact.


_NEWTON_STEPS = 2  # to relative velocity zero; where it is linear in the state, one is exact
_LEAST_GAIN = 64  # units in the last place of the terms of the gain; a smaller gain is round-off


class _Contact(NamedTuple):
    """The effect of friction at one instant.

    Attributes:
        idle: Rates without friction.
        by_friction: What one unit of friction adds to them.
        drift: The rate of the relative velocity without friction.
        has_effect: Whether friction has an effect on the relative velocity.
        gain: What one unit of friction adds to its rate.
        per_gain: ``1 / gain``, 0 where friction has no effect.
    """

    idle: State
    by_friction: State
    drift: FloatScalar
    has_effect: BoolScalar
    gain: FloatScalar
    per_gain: FloatScalar

    @property
    def share(self) -> FloatScalar:
        """The friction, as a share of the kinetic force, that keeps the relative velocity constant."""
        return -self.drift * self.per_gain


class GeneralModel(_OfUser, OneContactModel[GeneralForcing]):
    """A `SwitchedSystem` with one contact, whose relative velocity and friction are scalars."""

    def slip(self, forcing: GeneralForcing, y: State, h: FloatScalar, sign: FloatScalar) -> tuple[State, FloatScalar]:
        rates = Partial(type(self).slip_rates, self, forcing, sign=sign)
        slid, error = runge_kutta_step(rates, y, h, solver=self.solver)
        return slid, relative_error(error, y, slid, self._gross_changes(forcing, y, h))

    def stick(self, forcing: GeneralForcing, y: State, h: FloatScalar) -> tuple[State, FloatScalar]:
        rates = Partial(type(self).stick_rates, self, forcing)
        held, error = runge_kutta_step(rates, y, h, solver=self.solver)
        return self._held(forcing, h, held), relative_error(error, y, held, self._gross_changes(forcing, y, h))

    def rates(self, forcing: GeneralForcing, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        slid, held = self.slip_rates(forcing, tau, y, sign), self.stick_rates(forcing, tau, y)
        return tuple(jnp.where(sign == 0, a, b) for a, b in zip(held, slid, strict=True))

    def slip_rates(self, forcing: GeneralForcing, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        """The rates of a slip of this sign, continued smoothly to beyond the end of the slip.

        The last Runge-Kutta step of a slip may have stages slightly beyond its end. Friction that depends on the
        absolute relative velocity has a kink there, which would cost the order: beyond, rates are extrapolated from the
        mirror image of the state.
        """
        t, base, _ = self.base_at(forcing, tau)
        sigma, gradient = self._gradient(forcing, t, y, base)
        steep = sum(part * part for part in gradient)
        beyond = (sign * sigma < 0) & (steep > 0)
        shift = jnp.where(beyond, sigma / jnp.where(beyond, steep, 1), 0)
        end, image = (tuple(v - k * shift * g for v, g in zip(y, gradient, strict=True)) for k in (1, 2))
        here, there = self._rates(forcing, t, end, base, sign), self._rates(forcing, t, image, base, sign)
        return tuple(jnp.where(beyond, 2 * a - b, b) for a, b in zip(here, there, strict=True))

    def stick_rates(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> State:
        """The sliding field: the rates under the friction that keeps the relative velocity."""
        contact = self._contact(forcing, *self.base_at(forcing, tau)[:2], y)
        return tuple(a + contact.share * b for a, b in zip(contact.idle, contact.by_friction, strict=True))

    def guard(self, forcing: GeneralForcing, tau: FloatScalar, y: State, sign: FloatScalar) -> FloatPair:
        t, base, base_rates = self.base_at(forcing, tau)
        one = jnp.ones_like(t)

        slid = self.slip_rates(forcing, tau, y, sign)
        sigma, sigma_rate = jax.jvp(partial(self._sigma, forcing), (t, y, base), (one, slid, base_rates))

        def share_of(t, y, base):
            contact = self._contact(forcing, t, base, y)
            return contact.share / jnp.asarray(self._static_ratio, t.dtype), contact.has_effect

        held = self.stick_rates(forcing, tau, y)
        share, share_rate, has_effect = jax.jvp(share_of, (t, y, base), (one, held, base_rates), has_aux=True)
        sticking = sign == 0
        stick = jnp.where(has_effect, 1 - share * share, -1)
        stick_rate = jnp.where(has_effect, -2 * share * share_rate, 0)
        return jnp.where(sticking, stick, sign * sigma), jnp.where(sticking, stick_rate, sign * sigma_rate)

    def guard_scale(self, forcing: GeneralForcing, y: State, sign: FloatScalar) -> FloatScalar:
        t, base, _ = self.base_at(forcing, jnp.zeros_like(y[0]))
        sigma, gradient = self._gradient(forcing, t, y, base)
        by_base = jax.grad(lambda v: self._sigma(forcing, t, y, base._replace(velocity=v)))(base.velocity)
        slip = jnp.abs(sigma) + jnp.abs(by_base * base.velocity)
        slip = slip + sum(jnp.abs(part * value) for part, value in zip(gradient, y, strict=True))
        if self.system.shortest_time is not None:
            contact = self._contact(forcing, t, base, y)
            change = sum(jnp.abs(part * rate) for part, rate in zip(gradient, contact.idle, strict=True))
            slip = with_change(slip, change + jnp.abs(contact.gain), 2 * np.pi / self.system.shortest_time, t)
        return jnp.where(sign == 0, 2.0, slip)

    def on_base(self, forcing: GeneralForcing, y: State) -> State:
        return self._held(forcing, jnp.zeros_like(y[0]), y)

    def can_stick(self, forcing: GeneralForcing, y: State) -> BoolScalar:
        contact = self._contact(forcing, *self.base_at(forcing, jnp.zeros_like(y[0]))[:2], y)
        return contact.has_effect & (jnp.abs(contact.share) <= self._static_ratio)

    def release_sign(self, forcing: GeneralForcing, y: State) -> FloatScalar:
        # Without friction the relative velocity would change faster than friction can prevent.
        contact = self._contact(forcing, *self.base_at(forcing, jnp.zeros_like(y[0]))[:2], y)
        return jnp.where(contact.drift > 0, 1, -1).astype(y[0].dtype)

    @property
    def friction(self) -> FrictionLaw:
        """Coulomb's law, its coefficient a share of the kinetic force."""
        return Coulomb(1.0, self.system.static_ratio if self.system.has_static_ratio else None)

    def rates_under(self, forcing: GeneralForcing, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        t, base, _ = self.base_at(forcing, tau)
        return self._rates(forcing, t, y, base, coefficient)

    def relative_velocity(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> FloatScalar:
        t, base, _ = self.base_at(forcing, tau)
        return self._sigma(forcing, t, y, base)

    def relative_acceleration(self, forcing: GeneralForcing, tau: FloatScalar, y: State, rates: State) -> FloatScalar:
        t, base, base_rates = self.base_at(forcing, tau)
        return jax.jvp(partial(self._sigma, forcing), (t, y, base), (jnp.ones_like(t), rates, base_rates))[1]

    def _gross_changes(self, forcing: GeneralForcing, y: State, h: FloatScalar) -> State:
        """The sum of the changes of each number of the state in the time `h` by each term of its rate alone."""
        model, forcing, y, h = without_derivatives((self, forcing, y, h))
        t, base, _ = model.base_at(forcing, jnp.zeros_like(h))
        none = jnp.zeros_like(t)
        slopes = jax.jacfwd(partial(model._rates, forcing, t), argnums=(0, 2))(y, base, none)
        return gross_changes(h, y, model._rates(forcing, t, y, base, none), *zip(*slopes, strict=True))

    def _sigma(self, forcing: GeneralForcing, t: FloatScalar, y: State, base: UsersBase) -> FloatScalar:
        return jnp.asarray(forcing.seen_at(self.system, t).relative_velocity(t, y, base), t.dtype)

    def _gradient(
        self, forcing: GeneralForcing, t: FloatScalar, y: State, base: UsersBase
    ) -> tuple[FloatScalar, State]:
        """The relative velocity and its gradient with respect to the state."""
        return jax.value_and_grad(lambda y: self._sigma(forcing, t, y, base))(y)

    def _contact(self, forcing: GeneralForcing, t: FloatScalar, base: UsersBase, y: State) -> _Contact:
        # Rates are affine in friction: their derivative is what friction adds, without cancellation.
        idle, by_friction = jax.jvp(
            lambda friction: self._rates(forcing, t, y, base, friction), (jnp.zeros_like(t),), (jnp.ones_like(t),)
        )
        _, gradient = self._gradient(forcing, t, y, base)
        # The relative velocity depends on the base's velocity only, whose rate is its acceleration.
        none = jnp.zeros_like(t)
        moving = (jnp.ones_like(t), idle, UsersBase(base.acceleration, none, none))
        _, drift = jax.jvp(partial(self._sigma, forcing), (t, y, base), moving)
        terms = [part * rate for part, rate in zip(gradient, by_friction, strict=True)]
        gain, size = sum(terms, jnp.zeros_like(t)), sum(map(jnp.abs, terms), jnp.zeros_like(t))
        has_effect = gain < -_LEAST_GAIN * jnp.finfo(t.dtype).eps * size
        per_gain = jnp.where(has_effect, 1 / jnp.where(has_effect, gain, -1), 0)
        return _Contact(idle, by_friction, drift, has_effect, gain, per_gain)

    def _held(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> State:
        """`y`, moved in the direction in which friction acts until the relative velocity is zero."""
        t, base, _ = self.base_at(forcing, tau)
        for _ in range(_NEWTON_STEPS):
            contact = self._contact(forcing, t, base, y)
            friction = self._sigma(forcing, t, y, base) * contact.per_gain
            y = tuple(value - friction * effect for value, effect in zip(y, contact.by_friction, strict=True))
        return y


# With several contacts.


class GeneralContactsModel(_OfUser, ContactsModel[GeneralForcing]):
    """A `SwitchedSystem` with several contacts, whose relative velocities and friction are arrays (contacts,)."""

    solver: ExplicitSolver
    fastest: FloatScalar

    @property
    def contacts(self) -> int:
        assert self.system.contacts is not None
        return self.system.contacts

    @property
    def coupled(self) -> bool:
        return True

    def time(self, forcing: GeneralForcing) -> FloatScalar:
        return forcing.t

    def stick_position(self, y: State) -> FloatArray:
        return jnp.broadcast_to(y[0], (self.contacts + 1,))

    def instant(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> Instant:
        t, base, _ = self.base_at(forcing, tau)
        idle, by_friction = self._affine(forcing, t, y, base)
        # The relative velocities depend on the base's velocity only, whose rate is its acceleration.
        none = jnp.zeros_like(t)
        moving = (jnp.ones_like(t), idle, UsersBase(base.acceleration, none, none))
        velocity, drift = jax.jvp(partial(self._velocities, forcing), (t, y, base), moving)

        def along(effect: State) -> FloatArray:
            return jax.jvp(lambda y: self._velocities(forcing, t, y, base), (y,), (effect,))[1]

        return Instant(idle, velocity, drift, -jax.vmap(along, out_axes=1)(by_friction))

    def effect(self, forcing: GeneralForcing, tau: FloatScalar, y: State, force: FloatArray) -> State:
        t, base, _ = self.base_at(forcing, tau)
        _, by_friction = self._affine(forcing, t, y, base)
        return tuple(jnp.sum(force * each) for each in by_friction)

    def rates(self, forcing: GeneralForcing, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        """The rates, continued smoothly to beyond the ends of slips.

        The last Runge-Kutta step of a slip may have stages slightly beyond its end. Friction that depends on the
        absolute relative velocity has a kink there, which would cost the order: beyond, rates are extrapolated from the
        mirror image of the state.
        """
        t, base, _ = self.base_at(forcing, tau)
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
        static = normal * jnp.broadcast_to(jnp.asarray(self._static_ratio, normal.dtype), normal.shape)
        return Limits(normal, normal, static, static)

    @property
    def varying(self) -> tuple[int, ...]:
        return tuple(range(self.contacts)) if self.system.has_normal_forces else ()

    def varying_normal_forces(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> FloatArray:
        return self._normal_forces(forcing, tau, y)

    def normal_forces_at(self, forcing: GeneralForcing, tau: FloatScalar, y: State) -> FloatArray:
        return self._normal_forces(forcing, tau, y)

    def normal_scale(self, forcing: GeneralForcing, y: State) -> FloatArray:
        t, base, _ = self.base_at(forcing, jnp.zeros_like(y[0]))

        def rate(t: FloatScalar) -> FloatArray:
            return jax.jvp(lambda t: self._normal(forcing, t, y, base), (t,), (jnp.ones_like(t),))[1]

        # What oscillates in time is as large as its curvature says where it is zero.
        bend = jax.jvp(rate, (t,), (jnp.ones_like(t),))[1] / self.fastest**2
        slopes = jax.jacrev(lambda numbers: self._normal(forcing, t, *numbers))((y, base))
        terms = jax.tree.map(lambda slope, number: jnp.abs(slope * number), slopes, (y, base))
        return jnp.abs(self._normal(forcing, t, y, base)) + jnp.abs(bend) + sum(jax.tree.leaves(terms))

    def velocity_scale(self, forcing: GeneralForcing, y: State) -> FloatArray:
        t, base, _ = self.base_at(forcing, jnp.zeros_like(y[0]))
        slopes = jax.jacrev(lambda y: self._velocities(forcing, t, y, base))(y)
        by_base = jax.jacfwd(lambda v: self._velocities(forcing, t, y, base._replace(velocity=v)))(base.velocity)
        by_state = sum(jnp.abs(slope * value) for slope, value in zip(slopes, y, strict=True))
        return jnp.abs(self._velocities(forcing, t, y, base)) + jnp.abs(by_base * base.velocity) + by_state

    def gross_changes(self, forcing: GeneralForcing, y: State, h: FloatScalar, friction: FloatArray) -> State:
        model, forcing, y, h = without_derivatives((self, forcing, y, h))
        t, base, _ = model.base_at(forcing, jnp.zeros_like(h))
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
        t, base, _ = self.base_at(forcing, tau)
        return self._normal(forcing, t, y, base)


def _stacked(values: Any, t: FloatScalar) -> FloatArray:
    """The numbers of a sequence or an array as an array."""
    if isinstance(values, (tuple, list)):
        return jnp.stack([jnp.asarray(value, t.dtype) for value in values])
    return jnp.asarray(values, t.dtype)
