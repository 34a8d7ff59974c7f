"""Friction laws made of others: one for each direction of slip; a static friction that grows while the stick lasts."""

import abc
from collections.abc import Callable
from functools import reduce
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._foundation import checks
from .._foundation.fields import Checked, Quantity, varies_within
from .._foundation.types import BoolArray, FloatArray, Number, Scalar
from .friction import FrictionLaw, traceable

_AGES = np.array([1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6])  # s, at which a user's growth is looked at


class Directional(FrictionLaw):
    """Friction that differs between the two directions of slip, as measured devices often show.

    Args:
        forward: The law of slips with positive relative velocity (of the mass, relative to what it rubs on), and of
            sticks that would break into them.
        backward: That of negative relative velocity.

    Raises:
        ValueError: If one is no friction law.
    """

    forward: FrictionLaw
    backward: FrictionLaw

    def check_parts(self) -> None:
        for name in ("forward", "backward"):
            _require_law(name, getattr(self, name))

    def has_varying_parts(self) -> bool:
        return varies_within((self.forward, self.backward))

    def check_relations(self) -> None:
        """Each law has checked itself."""

    @property
    def constant(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances only
        return self.forward.constant and self.backward.constant

    @property
    def static_exceeds_kinetic(self) -> bool:
        return self.forward.static_exceeds_kinetic or self.backward.static_exceeds_kinetic

    @property
    def speed_scale(self) -> Scalar | None:
        return least(self.forward.speed_scale, self.backward.speed_scale)

    @property
    def viscous_slope(self) -> Scalar:
        return _most(self.forward.viscous_slope, self.backward.viscous_slope)

    @property
    def static(self) -> Scalar:
        return _most(self.forward.static, self.backward.static)

    def static_after(self, age: FloatArray | float) -> Scalar | FloatArray:
        return jnp.maximum(self.forward.static_after(age), self.backward.static_after(age))

    @property
    def grows(self) -> bool:
        return self.forward.grows or self.backward.grows

    @property
    def growth_time(self) -> Scalar | None:
        return least(*(law.growth_time for law in (self.forward, self.backward) if law.grows))

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        """The larger one of the two coefficients."""
        return jnp.maximum(self.forward.kinetic(speed), self.backward.kinetic(speed))

    def in_direction(self, velocity: FloatArray) -> FrictionLaw:
        return _Chosen(self.forward.in_direction(velocity), self.backward.in_direction(velocity), velocity > 0)


class _Chosen(FrictionLaw):
    """One of two laws, by a number that JAX may trace."""

    first: FrictionLaw
    second: FrictionLaw
    takes_first: BoolArray

    def check_relations(self) -> None:
        """Each law has checked itself."""

    @property
    def constant(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances only
        return self.first.constant and self.second.constant

    @property
    def static_exceeds_kinetic(self) -> bool:
        return self.first.static_exceeds_kinetic or self.second.static_exceeds_kinetic

    @property
    def static(self) -> Scalar:
        return jnp.where(self.takes_first, self.first.static, self.second.static)

    def static_after(self, age: FloatArray | float) -> Scalar | FloatArray:
        return jnp.where(self.takes_first, self.first.static_after(age), self.second.static_after(age))

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return jnp.where(self.takes_first, self.first.kinetic(speed), self.second.kinetic(speed))


class Growth(Checked):
    """Base class of what is added to the static friction coefficient while a stick lasts.

    Args:
        amount: The size of what is added.
        time: Over which it is added, s.
    """

    amount: Annotated[Number, Quantity(meaning="what is added to the static friction coefficient", at_least=0)]
    time: Annotated[Number, Quantity("s", "over which it is added", above=0)]

    @abc.abstractmethod
    def __call__(self, age: FloatArray | float) -> FloatArray:
        """What a stick has gained that has lasted `age` (s)."""


class ExponentialGrowth(Growth):
    """Growth towards a limit: ``amount (1 - exp(-age / time))``.

    Args:
        amount: What is added in the end, zero or positive.
        time: The time constant, s, positive.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    def __call__(self, age: FloatArray | float) -> FloatArray:
        return -self.amount * jnp.expm1(-age / self.time)


class LogarithmicGrowth(Growth):
    """Growth without a limit, ``amount log(1 + age / time)``, as measured on rock, paper and metals.

    Source: Dieterich 1972, Time-dependent friction in rocks, J. Geophys. Res. 77, 3690 (there with the logarithm to the
    base 10: its coefficient is 2.303 times `amount`).

    Args:
        amount: What is added each time the age becomes 2.718 times as large, zero or positive.
        time: The age, s, positive, up to which there is hardly any growth.

    Raises:
        ValueError: For numbers outside these bounds.
    """

    def __call__(self, age: FloatArray | float) -> FloatArray:
        return self.amount * jnp.log1p(age / self.time)


class Ageing(FrictionLaw):
    """Static friction that grows while a stick lasts; slips are those of another law.

    A stick of the age tau (the time since it began, s) holds up to ``(static + growth(tau)) * normal_force``, where
    `static` is that of `law`. The ages of sticks are part of the state: they follow its other numbers, and are zero in
    an initial state without them.

    Args:
        law: The friction law of slips, and of sticks that have just begun.
        growth: What is added to its static coefficient: an `ExponentialGrowth`, a `LogarithmicGrowth`, or a smooth
            function of the age (s, a scalar) that JAX can trace, zero at the age zero and nowhere negative.

    Raises:
        ValueError: For what is no friction law, or for a growth that cannot be called or does not fit.

    >>> law = ss.Ageing(ss.Coulomb(0.3), ss.LogarithmicGrowth(0.02, time=0.1))
    >>> print(f"{law.static_after(10.0):.4f}")
    0.3923
    """

    law: FrictionLaw
    growth: Callable[[FloatArray], FloatArray] = eqx.field(converter=traceable)
    holds_users_code = True

    def check_parts(self) -> None:
        _require_law("law", self.law)
        if not callable(self.growth) or isinstance(self.growth, type):
            raise checks.refused("growth", "be a LogarithmicGrowth, or a function of the stick's age", self.growth)

    def has_varying_parts(self) -> bool:
        return varies_within((self.law, self.growth))

    def check_relations(self) -> None:
        if type(self.growth) in (ExponentialGrowth, LogarithmicGrowth):
            return
        with checks.traceable("Argument growth of Ageing"):
            jax.make_jaxpr(self.growth)(jnp.zeros(()))
        checks.bounded("growth(0)", self.growth(jnp.zeros(())), at_least=0, below=1e-9)
        for age in _AGES:
            checks.non_negative(f"growth({age:g})", self.growth(jnp.asarray(age)))

    @property
    def constant(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances only
        return self.law.constant

    @property
    def speed_scale(self) -> Scalar | None:
        return self.law.speed_scale

    @property
    def viscous_slope(self) -> Scalar:
        return self.law.viscous_slope

    @property
    def static(self) -> Scalar:
        return self.law.static

    def static_after(self, age: FloatArray | float) -> Scalar | FloatArray:
        return self.law.static_after(age) + self.growth(jnp.asarray(age))

    @property
    def growth_time(self) -> Scalar | None:
        own = self.growth.time if isinstance(self.growth, Growth) else None
        return least(own, self.law.growth_time) if self.law.grows else own

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return self.law.kinetic(speed)

    @property
    def depends_on_direction(self) -> bool:
        return self.law.depends_on_direction

    def in_direction(self, velocity: FloatArray) -> FrictionLaw:
        return Ageing(self.law.in_direction(velocity), self.growth) if self.depends_on_direction else self


class AtAge(FrictionLaw):
    """A law whose sticks have all lasted `age` (s)."""

    law: FrictionLaw
    age: FloatArray

    def check_relations(self) -> None:
        """The law has checked itself."""

    @property
    def constant(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances only
        return self.law.constant

    @property
    def static(self) -> Scalar:
        return self.law.static_after(self.age)

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return self.law.kinetic(speed)

    def in_direction(self, velocity: FloatArray) -> FrictionLaw:
        return AtAge(self.law.in_direction(velocity), self.age)


def _require_law(name: str, value: object) -> None:
    if not isinstance(value, FrictionLaw):
        raise checks.refused(name, "be a friction law such as Coulomb(mu=0.3)", value)
    if value.inner_state is not None:
        raise checks.refused(name, "be a friction law without an inner state, such as Coulomb(mu=0.3)", value)


def least(*values: Scalar | None) -> Scalar | None:
    """The least of the values; None where one is not known, or there are none."""
    known = [value for value in values if value is not None]
    if len(known) < len(values) or not known:
        return None
    if all(isinstance(value, (int, float)) for value in known):
        return min(known)
    return reduce(jnp.minimum, known)  # as a stack, numbers without a type of their own would get one


def _most(one: Scalar, other: Scalar) -> Scalar:
    """The larger one of two numbers."""
    are_numbers = isinstance(one, (int, float)) and isinstance(other, (int, float))
    return max(one, other) if are_numbers else jnp.maximum(one, other)
