"""Systems whose contacts have friction laws with inner states, which are further numbers of the state.

Such friction is smooth: the rates of the state follow from it everywhere, and there are no modes.
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .._types import Array, DType, FloatArray, FloatScalar, Number, State
from .contacts_model import ContactsModel
from .dynamic_friction import DieterichRuina, DynamicFriction
from .friction import FrictionLaw
from .one_contact import OneContactModel


def inner_laws_of(laws: tuple[FrictionLaw, ...]) -> tuple[DynamicFriction, ...]:
    """Those of the `laws` of all contacts that have an inner state. Raises ValueError where only some have one."""
    inner = tuple(law for law in laws if isinstance(law, DynamicFriction))
    if 0 < len(inner) < len(laws):
        raise ValueError(
            f"Argument contacts must all have friction laws with an inner state, or none, but {len(inner)} of "
            f"{len(laws)} have one: a mass that rubs on two of them sticks exactly, or it does not."
        )
    return inner


class InnerStates(eqx.Module):
    """The model `inner` with `size` numbers in its state, followed by the inner states of the `laws` of its contacts.

    With several contacts they are one array (contacts,), with one contact a scalar. `speed`: which number of the state
    is the velocity of the one contact, but for that of its base, if one is.
    """

    inner: OneContactModel | ContactsModel
    laws: tuple[DynamicFriction, ...]
    size: int = eqx.field(static=True)
    speed: int | None = eqx.field(static=True, default=None)

    @property
    def contacts(self) -> int | None:
        """As of every model."""
        return self.inner.contacts

    @property
    def varying(self) -> tuple[int, ...]:
        """The contacts of a list whose normal forces vary."""
        return self.inner.varying if isinstance(self.inner, ContactsModel) else ()

    def start(self, y0: tuple[Number, ...], dtype: DType) -> State:
        """The state with these numbers, one for each coordinate of the system."""
        states = jnp.stack([jnp.asarray(value, dtype) for value in y0[self.size :]])
        return *self.inner.start(y0[: self.size], dtype), states if self.contacts else states[0]

    def numbers(self, y: State) -> State:
        """The numbers of the state `y`, one for each coordinate of the system."""
        states = (y[-1],) if self.contacts is None else tuple(y[-1][i] for i in range(len(self.laws)))
        return *self.inner.numbers(y[:-1]), *states

    def forcing(self, t: FloatScalar, segments: Any) -> Any:
        """The excitation from time t (s) on, until a segment ends."""
        return self.inner.forcing(t, segments)

    def stick_position(self, y: State) -> FloatArray:
        """What is recorded as the position of a stick."""
        return self.inner.stick_position(y[:-1])

    def relative_velocity(self, forcing: Any, tau: FloatScalar, y: State) -> FloatArray:
        """The relative velocity of each contact, m/s."""
        return self.inner.relative_velocity(forcing, tau, y[:-1])

    def slip_of_law(self, y: State) -> FloatArray:
        """The slip of the law over that of the one contact; not zero."""
        assert isinstance(self.inner, OneContactModel)
        share = jnp.abs(jnp.asarray(self.inner.to_inner_law(y[:-1])[0], y[0].dtype))
        return jnp.maximum(share, jnp.finfo(share.dtype).eps)

    @property
    def spans_decades(self) -> bool:
        """Whether `with_logarithm` applies: the speed falls over so many decades that an error of it says nothing."""
        return self.speed is not None and isinstance(self.laws[0], DieterichRuina)

    def with_logarithm(self, forcing: Any, y: State) -> State:
        """The state `y` with the logarithm of the relative velocity in place of the velocity."""
        return self._replaced(y, self._law.logarithm(y[-1], self.relative_velocity(forcing, jnp.zeros_like(y[0]), y)))

    def without_logarithm(self, forcing: Any, y: State) -> State:
        """The state of which `with_logarithm` made `y`."""
        velocity = self._law.slip_velocity(y[-1], self._law.direct * y[self.speed or 0])
        still = self._replaced(y, jnp.zeros_like(velocity))
        return self._replaced(y, velocity - self.relative_velocity(forcing, jnp.zeros_like(velocity), still))

    def rates_with_logarithm(self, forcing: Any, y: State) -> State:
        """The time derivative of a state `with_logarithm`."""
        assert isinstance(self.inner, OneContactModel)
        logarithm, tau = y[self.speed or 0], jnp.zeros_like(y[0])
        coefficient, now = self._law.direct * logarithm, self.without_logarithm(forcing, y)
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
        assert isinstance(self.inner, ContactsModel)
        return self.inner.varying_normal_forces(forcing, tau, y[:-1])

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
