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
from jaxtyping import Array

from .._compiler.programs import kept_jit
from .._excitation.motion import Signal
from .._excitation.recorded import ForceSteps, Recorded
from .._foundation.types import (
    AnyArray,
    BoolArray,
    BoolScalar,
    ExplicitSolver,
    FloatArray,
    FloatScalar,
    Scalar,
    State,
)
from .._numerics.derivatives import without_derivatives
from .._numerics.matrices import is_positive_definite, linear_solve, sum_of
from .._numerics.steps import gross_changes, relative_error, runge_kutta_step
from .contacts_model import ContactsModel, Instant, Limits, Uncoupled
from .friction import Coulomb, FrictionLaw
from .switched_model import (
    Decision,
    FloatPair,
    Forcing,
    OneContactModel,
    Question,
    SwitchedModel,
    chosen_state,
    later,
    with_change,
)

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


def springs_of(system: Any) -> tuple[Any, ...]:
    """The `series_stiffness` of each contact of a `SwitchedSystem`; None of one without a spring."""
    given, contacts = system.series_stiffness, system.contacts or 1
    if isinstance(given, (tuple, list)):
        return tuple(given)
    return (given,) * contacts if given is None or np.ndim(given) == 0 else tuple(given[i] for i in range(len(given)))


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


# What a user's methods return, for checks of them.


def shares(contacts: int | None) -> np.ndarray:
    """Shares of the friction forces at which rates show whether they are affine: none, half of all, and each alone,
    forward and backward; (shares,), or (shares, contacts) of several.
    """
    if contacts is None:
        return np.array([0.0, 0.5, 1.0, -1.0])
    units = np.eye(contacts)
    return np.stack([0 * units[0], 0.5 * np.ones(contacts), *units, *-units])


def velocities_of(system: Any, y: tuple[Array, ...], base: UsersBase) -> tuple[Array, Array]:
    """The relative velocities of the contacts (contacts,), and their derivatives by the state (contacts, states)."""

    def of(state: Array) -> Array:
        found = system.relative_velocity(jnp.zeros(()), tuple(state), base)
        return jnp.stack([jnp.asarray(velocity, float) for velocity in (found if system.contacts else (found,))])

    state = jnp.stack(y)
    return of(state), jax.jacfwd(of)(state)


def numbers_of(
    system: Any, y: tuple[Array, ...], base: UsersBase, columns: tuple[AnyArray, ...]
) -> tuple[Array, Array, Array]:
    """The rates (shares, states) at the `shares` of friction; rates under all of it, and normal forces, in the states
    whose numbers are the `columns` of a `Near`, (places, numbers).
    """
    zero, given = jnp.zeros(()), shares(system.contacts)

    def rates(friction: Array, *state: AnyArray) -> Array:
        return jnp.stack([jnp.asarray(rate, float) for rate in system.rates(zero, state, base, friction)])

    def forces(*state: AnyArray) -> Array:
        given = system.normal_forces(zero, state, base) if system.has_normal_forces else ()
        return jnp.stack([zero, *(jnp.asarray(force, float) for force in given)])[1:]

    found = jnp.stack([rates(jnp.asarray(share), *y) for share in given])
    near = jax.vmap(partial(rates, jnp.ones(given.shape[1:])))(*columns)
    return found, near, jax.vmap(forces)(*columns)


compiled_velocities, compiled_numbers = kept_jit(velocities_of), kept_jit(numbers_of)


# A user's system under its excitation.


class _OfUser(SwitchedModel[Forcing]):
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

    def _contact_modes(self, sign: FloatArray) -> FloatArray:
        """The signs of all contacts; of open ones that of none."""
        return sign

    def entered(self, forcing: Forcing, y: State, before: FloatArray, sign: FloatArray) -> State:
        old, new = self._contact_modes(before), self._contact_modes(sign)
        return self._begun(forcing, y, (new == 0) & (old != 0), (jnp.abs(new) == 1) & (new != old))

    def _begun(self, forcing: Forcing, y: State, sticks: BoolArray, slips: BoolArray | None = None) -> State:
        """The state after the begins of these sticks and slips, one contact after the other."""
        if not self.system.traits.begins_anew:
            return y
        t, base, _ = self.base_at(forcing, jnp.zeros_like(y[0]))
        system, none = self._seen_at(forcing, t), jnp.zeros_like(sticks)
        for begins, method in ((sticks, system.at_stick), (none if slips is None else slips, system.at_slip)):
            for contact in range(self.contacts or 1):
                after = tuple(jnp.asarray(value, t.dtype) for value in method(t, y, base, contact))
                y = chosen_state(jnp.atleast_1d(begins)[contact], after, y)
        return y

    def base_at(self, forcing: Forcing, tau: FloatScalar) -> tuple[FloatScalar, UsersBase, UsersBase]:
        """The time, the base and its time derivative, `tau` later."""
        t, base = forcing.t + tau, UsersBase(*forcing.base_at(self.smooth, tau), later(forcing.ground, tau))
        jerk = jnp.zeros_like(t) if self.smooth is None else jnp.asarray(self.smooth.curvature(t), t.dtype)
        return t, base, UsersBase(base.acceleration, jerk, forcing.ground[1])

    def _seen_at(self, forcing: Forcing, t: FloatScalar) -> Any:
        """The system whose records have their value at `t` on their present segments, without a search in them."""
        if not forcing.force:
            return self.system
        return with_records_at(self.system, t, [later(record, t - forcing.t) for record in forcing.force])

    def relative_velocity(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        return self._velocity(forcing, *self.base_at(forcing, tau)[:2], y)

    def velocity_scale(self, forcing: Forcing, y: State) -> FloatArray:
        """The size of the terms that cancel in the relative velocity of each contact."""
        t, base, _ = self.base_at(forcing, jnp.zeros_like(y[0]))

        def under(velocity: FloatScalar) -> FloatArray:
            return self._velocity(forcing, t, base._replace(velocity=velocity), y)

        velocity, gradient = self._gradient(forcing, t, base, y)
        _, by_base = jax.jvp(under, (base.velocity,), (jnp.ones_like(t),))
        by_state = sum(jnp.abs(part * value) for part, value in zip(gradient, y, strict=True))
        return jnp.abs(velocity) + jnp.abs(by_base * base.velocity) + by_state

    def gross_changes(self, forcing: Forcing, y: State, h: FloatScalar, friction: FloatArray) -> State:
        """The changes of the state in the time `h` by each term of its rates alone, under the largest `friction`."""
        model, forcing, y, h = without_derivatives((self, forcing, y, h))
        t, base, _ = model.base_at(forcing, jnp.zeros_like(h))
        idle, by_friction = model._affine(forcing, t, base, y)
        slopes = jax.jacfwd(partial(model._rates, forcing, t, base))
        alone, rubbing = slopes(y, jnp.zeros_like(friction)), slopes(y, friction)
        # Of heat and slip distances, products of friction and relative velocities, all is round-off in a stick.
        by_state = jax.tree.map(lambda a, b: jnp.abs(a) + jnp.abs(b - a), alone, rubbing)
        by_contacts = tuple(sum_of(jnp.abs(each) * friction) for each in by_friction)
        return gross_changes(h, y, idle, by_state, by_contacts)

    def _rates(self, forcing: Forcing, t: FloatScalar, base: UsersBase, y: State, friction: FloatArray) -> State:
        rates = self._seen_at(forcing, t).rates(t, y, base, friction)
        return tuple(jnp.asarray(rate, t.dtype) for rate in rates)

    def _velocity(self, forcing: Forcing, t: FloatScalar, base: UsersBase, y: State) -> FloatArray:
        return _stacked(self._seen_at(forcing, t).relative_velocity(t, y, base), t)

    def _gradient(self, forcing: Forcing, t: FloatScalar, base: UsersBase, y: State) -> tuple[FloatArray, State]:
        """The relative velocity of each contact, and its gradient with respect to the state."""
        velocity = partial(self._velocity, forcing, t, base)
        return jax.value_and_grad(velocity)(y) if self.contacts is None else (velocity(y), jax.jacrev(velocity)(y))

    def _affine(self, forcing: Forcing, t: FloatScalar, base: UsersBase, y: State) -> tuple[State, State]:
        """The rates without friction, and what one unit of friction adds to each; in each of several contacts."""
        # Rates are affine in friction: their derivative is what friction adds, without cancellation.
        rates, contacts = partial(self._rates, forcing, t, base, y), self.contacts
        if contacts is None:
            return jax.jvp(rates, (jnp.zeros_like(t),), (jnp.ones_like(t),))
        along = partial(jax.jvp, rates, (jnp.zeros(contacts, t.dtype),))
        return jax.vmap(lambda unit: along((unit,)), out_axes=(None, 0))(jnp.eye(contacts, dtype=t.dtype))

    def _drift(
        self, forcing: Forcing, t: FloatScalar, base: UsersBase, y: State, idle: State
    ) -> tuple[FloatArray, FloatArray]:
        """The relative velocity of each contact, and its rate without friction, where the state has `idle` rates."""
        # It depends on the base's velocity only, whose rate is its acceleration.
        none = jnp.zeros_like(t)
        moving = jnp.ones_like(t), UsersBase(base.acceleration, none, none), idle
        return jax.jvp(partial(self._velocity, forcing), (t, base, y), moving)


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


class GeneralModel(_OfUser, OneContactModel[Forcing]):
    """A `SwitchedSystem` with one contact, whose relative velocity and friction are scalars."""

    def slip(self, forcing: Forcing, y: State, h: FloatScalar, sign: FloatScalar) -> tuple[State, FloatScalar]:
        return self._stepped(forcing, y, h, Partial(type(self).slip_rates, self, forcing, sign=sign))

    def stick(self, forcing: Forcing, y: State, h: FloatScalar) -> tuple[State, FloatScalar]:
        held, error = self._stepped(forcing, y, h, Partial(type(self).stick_rates, self, forcing))
        return self._held(forcing, h, held), error

    def _stepped(self, forcing: Forcing, y: State, h: FloatScalar, rates: Partial) -> tuple[State, FloatScalar]:
        """The state after a step of one mode, and its relative error."""
        reached, error = runge_kutta_step(rates, y, h, solver=self.solver)
        return reached, relative_error(error, y, reached, self.gross_changes(forcing, y, h, jnp.ones_like(h)))

    def rates(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        slid, held = self.slip_rates(forcing, tau, y, sign), self.stick_rates(forcing, tau, y)
        return tuple(jnp.where(sign == 0, a, b) for a, b in zip(held, slid, strict=True))

    def slip_rates(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatScalar) -> State:
        """The rates of a slip of this sign, continued smoothly to beyond the end of the slip.

        The last Runge-Kutta step of a slip may have stages slightly beyond its end. Friction that depends on the
        absolute relative velocity has a kink there, which would cost the order: beyond, rates are extrapolated from the
        mirror image of the state.
        """
        t, base, _ = self.base_at(forcing, tau)
        sigma, gradient = self._gradient(forcing, t, base, y)
        steep = sum(part * part for part in gradient)
        beyond = (sign * sigma < 0) & (steep > 0)
        shift = jnp.where(beyond, sigma / jnp.where(beyond, steep, 1), 0)
        end, image = (tuple(v - k * shift * g for v, g in zip(y, gradient, strict=True)) for k in (1, 2))
        here, there = self._rates(forcing, t, base, end, sign), self._rates(forcing, t, base, image, sign)
        return tuple(jnp.where(beyond, 2 * a - b, b) for a, b in zip(here, there, strict=True))

    def stick_rates(self, forcing: Forcing, tau: FloatScalar, y: State) -> State:
        """The sliding field: the rates under the friction that keeps the relative velocity."""
        contact = self._contact(forcing, *self.base_at(forcing, tau)[:2], y)
        return tuple(a + contact.share * b for a, b in zip(contact.idle, contact.by_friction, strict=True))

    def guard(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatScalar) -> FloatPair:
        t, base, base_rates = self.base_at(forcing, tau)
        one = jnp.ones_like(t)

        slid = self.slip_rates(forcing, tau, y, sign)
        sigma, sigma_rate = jax.jvp(partial(self._velocity, forcing), (t, base, y), (one, base_rates, slid))

        def share_of(t, base, y):
            contact = self._contact(forcing, t, base, y)
            return contact.share / jnp.asarray(self._static_ratio, t.dtype), contact.has_effect

        held = self.stick_rates(forcing, tau, y)
        share, share_rate, has_effect = jax.jvp(share_of, (t, base, y), (one, base_rates, held), has_aux=True)
        sticking = sign == 0
        stick = jnp.where(has_effect, 1 - share * share, -1)
        stick_rate = jnp.where(has_effect, -2 * share * share_rate, 0)
        return jnp.where(sticking, stick, sign * sigma), jnp.where(sticking, stick_rate, sign * sigma_rate)

    def guard_scale(self, forcing: Forcing, y: State, sign: FloatScalar) -> FloatScalar:
        slip = self.velocity_scale(forcing, y)
        if self.system.shortest_time is not None:
            t, base, _ = self.base_at(forcing, jnp.zeros_like(y[0]))
            contact, (_, gradient) = self._contact(forcing, t, base, y), self._gradient(forcing, t, base, y)
            change = sum(jnp.abs(part * rate) for part, rate in zip(gradient, contact.idle, strict=True))
            slip = with_change(slip, change + jnp.abs(contact.gain), 2 * np.pi / self.system.shortest_time, t)
        return jnp.where(sign == 0, 2.0, slip)

    def on_base(self, forcing: Forcing, y: State) -> State:
        return self._held(forcing, jnp.zeros_like(y[0]), y)

    def decided(self, forcing: Forcing, y: State, question: Question) -> Decision:
        # What comes to rest is held by what it is as a stick.
        y = self._begun(forcing, y, question.asked & (question.sign != 0))
        return OneContactModel.decided(self, forcing, y, question)

    def can_stick(self, forcing: Forcing, y: State) -> BoolScalar:
        contact = self._contact(forcing, *self.base_at(forcing, jnp.zeros_like(y[0]))[:2], y)
        return contact.has_effect & (jnp.abs(contact.share) <= self._static_ratio)

    def release_sign(self, forcing: Forcing, y: State) -> FloatScalar:
        # Without friction the relative velocity would change faster than friction can prevent.
        contact = self._contact(forcing, *self.base_at(forcing, jnp.zeros_like(y[0]))[:2], y)
        return jnp.where(contact.drift > 0, 1, -1).astype(y[0].dtype)

    @property
    def friction(self) -> FrictionLaw:
        """Coulomb's law, its coefficient a share of the kinetic force."""
        return Coulomb(1.0, self.system.static_ratio if self.system.has_static_ratio else None)

    def rates_under(self, forcing: Forcing, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        t, base, _ = self.base_at(forcing, tau)
        return self._rates(forcing, t, base, y, coefficient)

    def relative_acceleration(self, forcing: Forcing, tau: FloatScalar, y: State, rates: State) -> FloatScalar:
        t, base, base_rates = self.base_at(forcing, tau)
        return jax.jvp(partial(self._velocity, forcing), (t, base, y), (jnp.ones_like(t), base_rates, rates))[1]

    def _contact(self, forcing: Forcing, t: FloatScalar, base: UsersBase, y: State) -> _Contact:
        idle, by_friction = self._affine(forcing, t, base, y)
        (_, gradient), (_, drift) = self._gradient(forcing, t, base, y), self._drift(forcing, t, base, y, idle)
        terms = [part * rate for part, rate in zip(gradient, by_friction, strict=True)]
        gain, size = sum(terms, jnp.zeros_like(t)), sum(map(jnp.abs, terms), jnp.zeros_like(t))
        has_effect = gain < -_LEAST_GAIN * jnp.finfo(t.dtype).eps * size
        per_gain = jnp.where(has_effect, 1 / jnp.where(has_effect, gain, -1), 0)
        return _Contact(idle, by_friction, drift, has_effect, gain, per_gain)

    def _held(self, forcing: Forcing, tau: FloatScalar, y: State) -> State:
        """`y`, moved in the direction in which friction acts until the relative velocity is zero."""
        t, base, _ = self.base_at(forcing, tau)
        for _ in range(_NEWTON_STEPS):
            contact = self._contact(forcing, t, base, y)
            friction = self._velocity(forcing, t, base, y) * contact.per_gain
            y = tuple(value - friction * effect for value, effect in zip(y, contact.by_friction, strict=True))
        return y


# With several contacts.


_SLOWEST = 1e-150  # rad/s, where the system gives no time scale


class GeneralContactsModel(_OfUser, ContactsModel):
    """A `SwitchedSystem` with several contacts, whose relative velocities and friction are arrays (contacts,)."""

    @property
    def fastest(self) -> FloatScalar:
        shortest = self.system.shortest_time
        return jnp.asarray(_SLOWEST if shortest is None else 2 * np.pi / shortest, float)

    @property
    def contacts(self) -> int:
        assert self.system.contacts is not None
        return self.system.contacts

    @property
    def coupled(self) -> bool:
        return True

    def _contact_modes(self, sign: FloatArray) -> FloatArray:
        return jnp.where(self._is_open(sign), 2, self._own(sign))

    # With springs in front of contacts the state ends with their elongations, which the user's methods do not see.

    @property
    def elastic(self) -> np.ndarray:
        return np.array([spring is not None for spring in springs_of(self.system)])

    def softness(self, y: State) -> FloatArray:
        return jnp.stack([jnp.asarray(0 if one is None else 1 / one, y[0].dtype) for one in springs_of(self.system)])

    def elongations(self, y: State) -> FloatArray:
        places = np.where(self.elastic, np.cumsum(self.elastic) - 1, -1)
        return jnp.append(jnp.stack(y[len(self.system.state_names) :]), 0)[places]

    def following(
        self, forcing: Forcing, tau: FloatScalar, y: State, way: FloatArray, rates: State | None = None
    ) -> FloatArray:
        """As of every model; `rates`: of the state, by default those without the friction of rigid contacts."""
        if not self.system.has_normal_forces:
            return jnp.zeros_like(way)
        t, base, base_rates = self.base_at(forcing, tau)
        moving = jnp.ones_like(t), base_rates, self.instant(forcing, tau, y).rates if rates is None else rates
        return way * jax.jvp(partial(self._normal, forcing), (t, base, y), moving)[1] * self.softness(y)

    def _with_elongations(self, y: State, of_springs: FloatArray) -> State:
        return *self._of_user(y), *(of_springs[i] for i in np.flatnonzero(self.elastic))

    def _of_user(self, y: State) -> State:
        return y[: len(self.system.state_names)]

    def _rates(self, forcing: Forcing, t: FloatScalar, base: UsersBase, y: State, friction: FloatArray) -> State:
        if not self.has_sliders:
            return super()._rates(forcing, t, base, y, friction)
        softness = self.softness(y)
        force = self.elongations(y) / jnp.where(softness > 0, softness, 1)
        rates = super()._rates(forcing, t, base, self._of_user(y), jnp.where(self.elastic, force, friction))
        return self._with_elongations(rates, self._velocity(forcing, t, base, y))

    def _velocity(self, forcing: Forcing, t: FloatScalar, base: UsersBase, y: State) -> FloatArray:
        return super()._velocity(forcing, t, base, self._of_user(y))

    def _begun(self, forcing: Forcing, y: State, sticks: BoolArray, slips: BoolArray | None = None) -> State:
        own = self._of_user(y)
        return *super()._begun(forcing, own, sticks, slips), *y[len(own) :]

    def entered(self, forcing: Forcing, y: State, before: FloatArray, sign: FloatArray) -> State:
        y = super().entered(forcing, y, before, sign)
        return self._with_elongations(y, self._at_limits(forcing, y, sign)) if self.has_sliders else y

    def decided(self, forcing: Forcing, y: State, question: Question) -> Decision:
        # What comes to rest is held by what it is as a stick.
        y = self._begun(forcing, y, self._own(question.asked) & (self._contact_modes(question.sign) != 0))
        return ContactsModel.decided(self, forcing, y, question)

    def stick_position(self, y: State) -> FloatArray:
        return jnp.broadcast_to(y[0], (self.contacts + 1,))

    def instant(self, forcing: Forcing, tau: FloatScalar, y: State) -> Instant:
        t, base, _ = self.base_at(forcing, tau)
        idle, by_friction = self._affine(forcing, t, base, y)
        velocity, drift = self._drift(forcing, t, base, y, idle)

        def along(effect: State) -> FloatArray:
            return jax.jvp(partial(self._velocity, forcing, t, base), (y,), (effect,))[1]

        return Instant(idle, velocity, drift, -jax.vmap(along, out_axes=1)(by_friction))

    def effect(self, forcing: Forcing, tau: FloatScalar, y: State, force: FloatArray) -> State:
        t, base, _ = self.base_at(forcing, tau)
        _, by_friction = self._affine(forcing, t, base, y)
        return tuple(jnp.sum(force * each) for each in by_friction)

    def rates(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        """The rates, continued smoothly to beyond the ends of slips.

        The last Runge-Kutta step of a slip may have stages slightly beyond its end. Friction that depends on the
        absolute relative velocity has a kink there, which would cost the order: beyond, rates are extrapolated from the
        mirror image of the state.
        """
        t, base, _ = self.base_at(forcing, tau)
        (velocity, gradients), own = self._gradient(forcing, t, base, y), self._own(sign)
        beyond = self._rigid(own * velocity < 0) & ~self._is_open(sign)
        rows = jnp.stack(gradients, axis=-1)  # (contacts, states)
        both = beyond[:, None] & beyond[None, :]
        matrix = jnp.where(both, rows @ rows.T, jnp.eye(len(own), dtype=t.dtype))
        shift = rows.T @ jnp.where(beyond, linear_solve(matrix, jnp.where(beyond, velocity, 0)), 0)
        end, image = (tuple(value - k * shift[i] for i, value in enumerate(y)) for k in (1, 2))
        here, there = (self._rates_in(forcing, tau, state, sign) for state in (end, image))
        passed = jnp.any(beyond)
        return tuple(jnp.where(passed, 2 * a - b, b) for a, b in zip(here, there, strict=True))

    def _rates_in(self, forcing: Forcing, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        rates = super().rates(forcing, tau, y, sign)
        if not self.has_sliders:
            return rates
        following = self.following(forcing, tau, y, self._own(sign), rates)
        return self._with_elongations(rates, self._elongating(self.elongations(rates), following, sign))

    def limits(self, forcing: Forcing, tau: FloatScalar, y: State, velocity: FloatArray) -> Limits:
        normal = self.normal_forces_at(forcing, tau, y)
        static = normal * jnp.broadcast_to(jnp.asarray(self._static_ratio, normal.dtype), normal.shape)
        return Limits(normal, normal, static, static)

    @property
    def varying(self) -> tuple[int, ...]:
        return tuple(range(self.contacts)) if self.system.has_normal_forces else ()

    def normal_forces_at(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        if not self.system.has_normal_forces:
            return jnp.ones(self.contacts, y[0].dtype)
        return self._normal(forcing, *self.base_at(forcing, tau)[:2], y)

    def varying_normal_forces(self, forcing: Forcing, tau: FloatScalar, y: State) -> FloatArray:
        return self.normal_forces_at(forcing, tau, y)

    def normal_scale(self, forcing: Forcing, y: State) -> FloatArray:
        t, base, _ = self.base_at(forcing, jnp.zeros_like(y[0]))

        def rate(t: FloatScalar) -> FloatArray:
            return jax.jvp(lambda t: self._normal(forcing, t, base, y), (t,), (jnp.ones_like(t),))[1]

        # What oscillates in time is as large as its curvature says where it is zero.
        bend = jax.jvp(rate, (t,), (jnp.ones_like(t),))[1] / self.fastest**2
        slopes = jax.jacrev(partial(self._normal, forcing, t), argnums=(0, 1))(base, y)
        terms = jax.tree.map(lambda slope, number: jnp.abs(slope * number), slopes[::-1], (y, base))
        return jnp.abs(self._normal(forcing, t, base, y)) + jnp.abs(bend) + sum(jax.tree.leaves(terms))

    def at_base_velocity(self, forcing: Forcing, y: State, resting: BoolArray) -> State:
        """As of every model; NaN where the contacts have no unique motion, because friction would drive itself."""
        y = super().at_base_velocity(forcing, y, resting)
        gain = self.instant(forcing, jnp.zeros_like(y[0]), y).gain
        assert not isinstance(gain, Uncoupled)
        gain = jnp.where(self.elastic[:, None] | self.elastic, np.eye(self.contacts), gain)  # of the rigid ones
        return jnp.where(is_positive_definite((gain + gain.T) / 2), y[0], jnp.nan), *y[1:]

    def _normal(self, forcing: Forcing, t: FloatScalar, base: UsersBase, y: State) -> FloatArray:
        return _stacked(self._seen_at(forcing, t).normal_forces(t, self._of_user(y), base), t)


def _stacked(values: Any, t: FloatScalar) -> FloatArray:
    """The numbers of a sequence or an array as an array."""
    if isinstance(values, (tuple, list)):
        return jnp.stack([jnp.asarray(value, t.dtype) for value in values])
    return jnp.asarray(values, t.dtype)
