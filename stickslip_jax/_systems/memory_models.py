"""Systems whose contacts remember: the ages of sticks, and friction laws with inner states, as numbers of the
state.
"""

from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._foundation.types import BoolArray, BoolScalar, DType, FloatArray, FloatScalar, Number, Scalar, State
from .dynamic_friction import DieterichRuina, DynamicFriction
from .friction import FrictionLaw
from .switched_model import Decision, F, Guard, OneContactModel, Question, Segments, SwitchedModel

# What a contact remembers, as further numbers of the state.


class _Remembering(eqx.Module):
    """The model `inner` with `size` numbers in its state, followed by what its contacts remember: with several one
    array (contacts,), with one contact a scalar.
    """

    inner: Any  # a OneContactModel or a ContactsModel
    size: int = eqx.field(static=True)

    @property
    def contacts(self) -> int | None:
        """As of every model."""
        return self.inner.contacts

    @property
    def varying(self) -> tuple[int, ...]:
        """As of every model."""
        return self.inner.varying

    def start(self, y0: tuple[Number, ...] | FloatArray, dtype: DType) -> State:
        """The state with these numbers, one for each coordinate of the system."""
        remembered = jnp.stack([jnp.asarray(value, dtype) for value in y0[self.size :]])
        return *self.inner.start(y0[: self.size], dtype), remembered if self.contacts else remembered[0]

    def numbers(self, y: State) -> State:
        """The numbers of the state `y`, one for each coordinate of the system."""
        remembered = (y[-1],) if self.contacts is None else tuple(y[-1][i] for i in range(self.contacts))
        return *self.inner.numbers(y[:-1]), *remembered

    def forcing(self, t: FloatScalar, segments: Segments) -> Any:
        """The excitation from time t (s) on, until a segment ends."""
        return self.inner.forcing(t, segments)

    def stick_position(self, y: State) -> FloatArray:
        """What is recorded as the position of a stick."""
        return self.inner.stick_position(y[:-1])

    def relative_velocity(self, forcing: Any, tau: FloatScalar, y: State) -> FloatArray:
        """The relative velocity of each contact, m/s."""
        return self.inner.relative_velocity(forcing, tau, y[:-1])


# Systems whose contacts remember how long they have stuck: the ages of sticks as further numbers of the state.
#
# An age grows at the rate 1 in a stick, and is zero in a slip. What a stick can hold depends on it; nothing else does.


_SHARE = 0.5  # of a stick's age, and of the growth time of its law, that a step may last: a logarithm grows so
_IN_A_STEP = 1 / 16  # of a step: the growth time of a law that does not say it

M = TypeVar("M", bound=SwitchedModel)


def with_ages(model: SwitchedModel, size: int, grows: bool, growth_time: Scalar | None) -> Any:
    """The `model`, of `size` numbers, with ages of its sticks, if they matter: if the static friction `grows`."""
    if not grows:
        return model
    kind = AgeingContact if isinstance(model, OneContactModel) else AgeingContacts
    return kind(model, size, growth_time)


class _WithAges(_Remembering, SwitchedModel[F]):
    """The model `inner`, whose sticks grow stronger over the `growth_time` (s), with their ages."""

    growth_time: Scalar | None

    @property
    def steps_may_be_long(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances
        return self.inner.steps_may_be_long

    @property
    def coupled(self) -> bool:
        return self.inner.coupled

    def stuck(self, sign: FloatArray) -> BoolArray:
        return self.inner.stuck(sign)

    def flow_and_error(
        self, forcing: F, y: State, h: FloatScalar, sign: FloatArray
    ) -> tuple[State, FloatScalar | None]:
        reached, error = self.inner.flow_and_error(forcing, y[:-1], h, sign)
        return (*reached, jnp.where(self._stuck(sign), y[-1] + h, 0)), error

    def rates(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        return *self.inner.rates(forcing, tau, y[:-1], sign), self._stuck(sign).astype(y[0].dtype)

    def at_rest(self, forcing: F, y: State, times: float = 1.0) -> BoolArray:
        return self.inner.at_rest(forcing, y[:-1], times)

    def noise(self, forcing: F, y: State, sign: FloatArray) -> FloatArray:
        return self.inner.noise(forcing, y[:-1], sign)

    def after(
        self, forcing: F, y: State, sign: FloatArray, landed: BoolArray, ended: BoolArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        return self.inner.after(forcing, y[:-1], sign, landed, ended)

    def slip_sign(self, forcing: F, y: State) -> FloatArray:
        return self.inner.slip_sign(forcing, y[:-1])

    def guard(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> Guard:
        def by_age(age: Array) -> Guard:
            return self.inner.at_age(age).guard(forcing, tau, y[:-1], sign)

        (guard, rate), (growth, _) = jax.jvp(by_age, (y[-1],), (self._stuck(sign).astype(y[0].dtype),))
        return guard, rate + growth

    def guard_scale(self, forcing: F, y: State, sign: FloatArray) -> FloatArray:
        return self.inner.guard_scale(forcing, y[:-1], sign)

    def at_base_velocity(self, forcing: F, y: State, resting: BoolArray) -> State:
        return *self.inner.at_base_velocity(forcing, y[:-1], resting), y[-1]

    def step_limit(self, age: FloatArray, step: FloatScalar, y: State, sign: FloatArray) -> FloatScalar:
        time = _IN_A_STEP * step if self.growth_time is None else self.growth_time
        longest = jnp.where(self._stuck(sign), _SHARE * (y[-1] + time), jnp.inf)
        return jnp.minimum(self.inner.step_limit(age, step, y[:-1], sign), jnp.min(longest))

    def without_memory(self, y: State) -> tuple[Any, State]:
        return self.inner, y[:-1]

    def _stuck(self, sign: FloatArray) -> BoolArray:
        """Which contacts stick."""
        stuck = self.inner.stuck(sign)
        return stuck if self.contacts is None else stuck[:-1]


class AgeingContacts(_WithAges[F]):
    """A system with several contacts, and ages (contacts,) of their sticks."""

    def decided(self, forcing: F, y: State, question: Question) -> Decision:
        return self.inner.at_age(y[-1]).decided(forcing, y[:-1], question)


class AgeingContact(_WithAges[F], OneContactModel[F]):  # pyright: ignore[reportIncompatibleVariableOverride] - as above
    """A system with one contact, and the age of its stick."""

    def on_base(self, forcing: F, y: State) -> State:
        return *self.inner.on_base(forcing, y[:-1]), y[-1]

    def can_stick(self, forcing: F, y: State) -> BoolScalar:
        return self.inner.at_age(y[-1]).can_stick(forcing, y[:-1])

    def release_sign(self, forcing: F, y: State) -> FloatScalar:
        return self.inner.release_sign(forcing, y[:-1])

    @property
    def time_scales_are_known(self) -> bool:
        return self.inner.time_scales_are_known

    @property
    def friction(self) -> FrictionLaw:
        return self.inner.friction

    def friction_at(self, y: State) -> FrictionLaw:
        return self.inner.friction_at(y[:-1])

    def rates_under(self, forcing: F, tau: FloatScalar, y: State, coefficient: FloatScalar) -> State:
        return *self.inner.rates_under(forcing, tau, y[:-1], coefficient), jnp.zeros_like(y[-1])

    def slip_direction(self, y: State, sign: FloatScalar) -> FloatScalar:
        return self.inner.slip_direction(y[:-1], sign)

    def relative_acceleration(self, forcing: F, tau: FloatScalar, y: State, rates: State) -> FloatScalar:
        return self.inner.relative_acceleration(forcing, tau, y[:-1], rates[:-1])


# Systems whose contacts have friction laws with inner states, which are further numbers of the state.
#
# Such friction is smooth: the rates of the state follow from it everywhere, and there are no modes.


def inner_laws_of(laws: tuple[FrictionLaw, ...]) -> tuple[DynamicFriction, ...]:
    """Those of the `laws` of all contacts that have an inner state. Raises ValueError where only some have one."""
    inner = tuple(law for law in laws if isinstance(law, DynamicFriction))
    if 0 < len(inner) < len(laws):
        raise ValueError(
            f"Argument contacts must all have friction laws with an inner state, or none, but {len(inner)} of "
            f"{len(laws)} have one: a mass that rubs on two of them sticks exactly, or it does not."
        )
    return inner


class InnerStates(_Remembering):
    """The model `inner` with the inner states of the `laws` of its contacts.

    `speed`: which number of the state is the velocity of the one contact, but for that of its base, if one is.
    """

    laws: tuple[DynamicFriction, ...]
    speed: int | None = eqx.field(static=True, default=None)

    def slip_of_law(self, y: State) -> FloatArray:
        """The slip of the law over that of the one contact; not zero."""
        share = jnp.abs(jnp.asarray(self.inner.to_inner_law(y[:-1])[0], y[0].dtype))
        return jnp.maximum(share, jnp.finfo(share.dtype).eps)

    @property
    def spans_decades(self) -> bool:
        """Whether `with_logarithm` applies: the speed falls over so many decades that an error of it says nothing."""
        return self.speed is not None and isinstance(self.laws[0], DieterichRuina)

    def with_logarithm(self, forcing: Any, y: State) -> State:
        """The state `y` with the logarithm of the relative velocity in place of the velocity."""
        return self._replaced(y, self._law.logarithm(y[-1], self.relative_velocity(forcing, jnp.zeros_like(y[0]), y)))

    def without_logarithm(self, forcing: Any, tau: FloatScalar, y: State) -> State:
        """The state of which `with_logarithm` made `y`."""
        velocity = self._law.slip_velocity(y[-1], self._law.direct * y[self.speed or 0])
        still = self._replaced(y, jnp.zeros_like(velocity))
        return self._replaced(y, velocity - self.relative_velocity(forcing, tau, still))

    def rates_with_logarithm(self, forcing: Any, tau: FloatScalar, y: State) -> State:
        """The time derivative of a state `with_logarithm`."""
        logarithm = y[self.speed or 0]
        coefficient, now = self._law.direct * logarithm, self.without_logarithm(forcing, tau, y)
        rates = self.inner.rates_under(forcing, tau, now[:-1], coefficient)
        rates = *rates, jnp.asarray(self._law.rate(y[-1], self._law.slip_velocity(y[-1], coefficient)))
        velocity = partial(self.relative_velocity, forcing)
        _, acceleration = jax.jvp(velocity, (tau, now), (jnp.ones_like(tau), rates))
        return self._replaced(rates, self._law.logarithm_rate(y[-1], logarithm, acceleration, rates[-1]))

    @property
    def _law(self) -> DieterichRuina:
        assert isinstance(self.laws[0], DieterichRuina)
        return self.laws[0]

    def _replaced(self, y: State, value: FloatArray) -> State:
        return tuple(value if i == self.speed else number for i, number in enumerate(y))

    def varying_normal_forces(self, forcing: Any, tau: FloatScalar, y: State) -> FloatArray:
        """The normal forces that vary, N."""
        return self.inner.varying_normal_forces(forcing, tau, y[:-1])

    def among_all(self, varying: Array, others: Any) -> Array:
        """As of a `SwitchedModel`."""
        return self.inner.among_all(varying, others)

    def coefficients(self, forcing: Any, tau: FloatScalar, y: State) -> Array:
        """The friction coefficient in each contact, as the rates of the `inner` model take it."""
        velocity = self.relative_velocity(forcing, tau, y)
        if isinstance(self.inner, OneContactModel):
            to_law, from_law = self.inner.to_inner_law(y[:-1])
            return jnp.asarray(from_law * self.laws[0].coefficient(y[-1], to_law * velocity))
        return jnp.stack([law.coefficient(y[-1][i], velocity[i]) for i, law in enumerate(self.laws)])

    def rates(self, forcing: Any, tau: FloatScalar, y: State) -> State:
        """The time derivative of the state."""
        velocity, coefficients = self.relative_velocity(forcing, tau, y), self.coefficients(forcing, tau, y)
        if isinstance(self.inner, OneContactModel):
            rates = self.inner.rates_under(forcing, tau, y[:-1], coefficients)
            return *rates, jnp.asarray(self.laws[0].rate(y[-1], self.inner.to_inner_law(y[:-1])[0] * velocity))
        now = self.inner.instant(forcing, tau, y[:-1])
        # An open contact has no friction; its inner state goes on with the motion.
        force = coefficients * jnp.maximum(self.inner.normal_forces_at(forcing, tau, y[:-1]), 0)
        by_friction = self.inner.effect(forcing, tau, y[:-1], force)
        inner_rates = jnp.stack([law.rate(y[-1][i], velocity[i]) for i, law in enumerate(self.laws)])
        return *(a + b for a, b in zip(now.rates, by_friction, strict=True)), inner_rates
