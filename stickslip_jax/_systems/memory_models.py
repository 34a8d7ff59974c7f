"""Systems whose contacts remember: the ages of sticks, slip distances, and friction laws with inner states, as numbers
of the state; and the friction law that weakens with the slip distance.
"""

import abc
from functools import partial
from typing import Annotated, Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array

from .._foundation.fields import Quantity
from .._foundation.types import BoolArray, BoolScalar, DType, FloatArray, FloatScalar, Number, Scalar, State
from .._numerics.matrices import stacked
from .._numerics.steps import relative_error, runge_kutta_step
from .dynamic_friction import DieterichRuina, DynamicFriction
from .friction import FrictionLaw, MadeOfLaws, static_at_least
from .switched_model import Decision, F, Guard, OneContactModel, Question, Segments, SwitchedModel

# What a contact remembers, as further numbers of the state.


class _Remembering(eqx.Module):
    """The model `inner` with `size` numbers in its state, followed by what its contacts remember: one array of as many
    numbers as are `remembered`, or a scalar.
    """

    inner: Any  # a OneContactModel or a ContactsModel
    size: int = eqx.field(static=True)

    @property
    def contacts(self) -> int | None:
        """As of every model."""
        return self.inner.contacts

    @property
    def remembered(self) -> int | None:
        """How many numbers are remembered; None: one, a scalar."""
        return self.contacts

    @property
    def varying(self) -> tuple[int, ...]:
        """As of every model."""
        return self.inner.varying

    def start(self, y0: tuple[Number, ...] | FloatArray, dtype: DType) -> State:
        """The state with these numbers, one for each coordinate of the system."""
        remembered = jnp.stack([jnp.asarray(value, dtype) for value in y0[self.size :]])
        return *self.inner.start(y0[: self.size], dtype), remembered if self.remembered else remembered[0]

    def numbers(self, y: State) -> State:
        """The numbers of the state `y`, one for each coordinate of the system."""
        remembered = (y[-1],) if self.remembered is None else tuple(y[-1][i] for i in range(self.remembered))
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

    def entered(self, forcing: F, y: State, before: FloatArray, sign: FloatArray) -> State:
        return *self.inner.entered(forcing, y[:-1], before, sign), y[-1]

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

    def without_memory(self, y: State, sign: FloatArray | None = None) -> tuple[Any, State]:
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


# Friction that weakens with the distance of the present slip, a further number of the state.
#
# Where a contact slips its friction coefficient is linear in this distance, up to the one at which it is weak, and from
# there on constant. Coming there is an event: after the modes of the `inner` model there is one more for each contact,
# +1 while it weakens, with the guard how far it has to go, and -1 when it is weak. So each step has smooth rates.


class SlipWeakening(FrictionLaw):
    """Friction that falls with the distance of the present slip, as in models of ruptures and earthquakes.

    The friction coefficient is ``static - (static - dynamic) min(s / distance, 1)``. The slip distance s (m) grows in a
    slip by the size of the relative velocity, also where that reverses, and begins anew at zero with each stick, or
    where a normal force opens the contact. A stick holds up to ``static * normal_force``: it is healed at once.

    With `healing` a stick begins as weak as the slip ended and grows stronger: s, at most `distance` then, falls as
    ``exp(-age / healing)``, and the next slip goes on from what is left.

    The slip distances are part of the state: they follow its other numbers, and are zero in an initial state without
    them. One block on a spring slips suddenly if ``stiffness < (static - dynamic) normal_force / distance``.

    Sources: Ida 1972, Cohesive force across the tip of a longitudinal-shear crack and Griffith's specific surface
    energy, J. Geophys. Res. 77, 3796; Andrews 1976, Rupture velocity of plane strain shear cracks, J. Geophys. Res. 81,
    5679. Healing, as of the state variable of Ampuero and Ben-Zion 2008 at rest, Cracks, pulses and macroscopic
    asymmetry of dynamic rupture on a bimaterial interface with velocity-weakening friction, Geophys. J. Int. 173, 674.

    Args:
        static: The friction coefficient of a stick that is healed, and of a slip as it begins, positive.
        dynamic: That of a slip longer than `distance`, zero or positive, at most `static`.
        distance: The slip over which the coefficient falls, m, positive.
        healing: The time constant, s, positive, with which sticks grow stronger; None: at once.

    Raises:
        ValueError: For numbers outside these bounds.

    >>> law = ss.SlipWeakening(0.6, 0.4, distance=0.02)
    >>> block = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=law)
    >>> one = ss.simulate(block, ss.Constant(1e-6), t1=60.0, y0=(0.15 - 1e-6, 1e-6))
    >>> print(f"{float(one.final_state[0]):.4f} m")  # after a slip from 0.15 m
    0.0613 m
    """

    static: Annotated[Number, Quantity(meaning="friction coefficient of a healed stick", above=0)] = eqx.field()  # pyright: ignore[reportIncompatibleVariableOverride] - instances have it
    dynamic: Annotated[Number, Quantity(meaning="friction coefficient of a long slip", at_least=0)]
    distance: Annotated[Number, Quantity("m", "slip over which the coefficient falls", above=0)]
    healing: Annotated[
        Number | None, Quantity("s", "time constant of sticks that grow stronger; not given: they do at once", above=0)
    ] = None

    def check_relations(self) -> None:
        static_at_least(self.dynamic, self.static, "Argument static", "dynamic")

    @property
    def inner_state(self) -> str:
        return "slip distance in m"

    @property
    def speed_scale(self) -> Scalar | None:
        return np.inf

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        """The friction coefficient of a long slip."""
        return self.dynamic

    def after_slip(self, slip: FloatArray) -> FloatArray:
        """The friction coefficient after this slip distance, m, at most `distance`."""
        return self.static - (self.static - self.dynamic) / self.distance * slip


# The field hides the property of the base class, which could not be set.
SlipWeakening.static = None  # pyright: ignore[reportAttributeAccessIssue]
abc.update_abstractmethods(SlipWeakening)


class _AfterSlip(MadeOfLaws):
    """A `SlipWeakening` after a `slip` (m) if the contact slips, and after the distance `rested` if it sticks."""

    law: SlipWeakening
    slip: FloatArray
    rested: FloatArray

    @property
    def static(self) -> Scalar:
        return self.law.after_slip(self.rested)

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        return self.law.after_slip(self.slip)


def weakening_laws_of(laws: tuple[FrictionLaw, ...]) -> tuple[SlipWeakening, ...]:
    """Those of the `laws` of all contacts that weaken with the slip distance. Raises ValueError where others age."""
    weakening = tuple(law for law in laws if isinstance(law, SlipWeakening))
    if weakening and any(law.grows for law in laws):
        raise ValueError(
            "Argument contacts must not have both SlipWeakening and Ageing friction, but they have: the structure "
            "remembers slip distances, or ages of sticks; sticks that grow stronger are SlipWeakening(healing=...) too."
        )
    return weakening


class WeakeningContacts(_Remembering, SwitchedModel[F]):
    """A structure whose friction may be `SlipWeakening`, and the slip distances (contacts,) of its contacts."""

    @property
    def coupled(self) -> bool:
        return self.inner.coupled

    @property
    def has_sliders(self) -> bool:
        return self.inner.has_sliders

    @property
    def time_scales_are_known(self) -> bool:
        return self.inner.time_scales_are_known

    @property
    def _laws(self) -> dict[int, SlipWeakening]:
        """The laws that weaken, by the number of the contact."""
        laws = (contact.friction for contact in self.inner.structure.contacts)
        return {number: law for number, law in enumerate(laws) if isinstance(law, SlipWeakening)}

    def _of_laws(self, values: dict[int, Scalar], others: float, like: FloatArray) -> FloatArray:
        """The `values` of contacts by their numbers, among all, (contacts,)."""
        return stacked([values.get(number, others) for number in range(len(like))], like.dtype)

    def _distances(self, y: State) -> FloatArray:
        """The slips over which contacts weaken, m; infinite for other laws."""
        return self._of_laws({number: law.distance for number, law in self._laws.items()}, np.inf, y[-1])

    def _decay(self, y: State) -> FloatArray:
        """The rates at which sticks heal, 1/s; zero where they do at once."""
        rates = {i: 1 / law.healing for i, law in self._laws.items() if law.healing is not None}
        return self._of_laws(rates, 0.0, y[-1])

    def _rested(self, y: State) -> FloatArray:
        """The slip distances with which sticks begin, m."""
        return jnp.where(self._decay(y) > 0, jnp.minimum(y[-1], self._distances(y)), 0)

    def _split(self, of_modes: Array) -> tuple[Array, Array]:
        """Those of the inner model's modes, and those of how contacts weaken."""
        place = len(of_modes) - (self.contacts or 0)
        return of_modes[:place], of_modes[place:]

    def _with(self, of_inner: Array, of_weakening: Any) -> Array:
        rest = jnp.broadcast_to(jnp.asarray(of_weakening, of_inner.dtype), (self.contacts or 0,))
        return jnp.concatenate([of_inner, rest])

    def _slipping(self, sign: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Which contacts slip, closed, and the signs of all, (contacts,)."""
        of_inner, _ = self._split(sign)
        own = self.inner._own(of_inner)
        return (own != 0) & ~self.inner._is_open(of_inner), own

    def _weakened_by(self, y: State, sign: FloatArray) -> FloatArray:
        """The slip distances that count in the modes `sign`: no more than those at which contacts are weak."""
        weakens = ~self._slipping(sign)[0] | (self._split(sign)[1] > 0)
        return jnp.where(weakens, y[-1], self._distances(y))

    def after_slip(self, slip: FloatArray, rested: FloatArray) -> Any:
        """The inner model whose contacts have slipped by `slip` (m), or have `rested`."""
        laws = [_AfterSlip(law, slip[number], rested[number]) for number, law in self._laws.items()]
        numbers = tuple(self._laws)
        return eqx.tree_at(lambda model: [model.structure.contacts[i].friction for i in numbers], self.inner, laws)

    def _in_mode(self, y: State, sign: FloatArray) -> Any:
        slip = self._weakened_by(y, sign)
        return self.after_slip(slip, slip)

    def flow_and_error(
        self, forcing: F, y: State, h: FloatScalar, sign: FloatArray
    ) -> tuple[State, FloatScalar | None]:
        rates = Partial(type(self).rates, self, forcing, sign=sign)
        reached, error = runge_kutta_step(rates, y, h, solver=self.inner.solver)
        slips, own = self._slipping(sign)
        gross = self.inner._gross_changes(forcing, y[:-1], h)
        gross = *gross, h * self.inner.velocity_scale(forcing, y[:-1])
        moved = self.inner._held(forcing, h, reached[:-1], own == 0)
        healed = jnp.where(slips, reached[-1], y[-1] * jnp.exp(-h * self._decay(y)))
        return (*moved, healed), relative_error(error, y, reached, gross)

    def rates(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        moving = self._in_mode(y, sign).rates(forcing, tau, y[:-1], self._split(sign)[0])
        (slips, own), velocity = self._slipping(sign), self.relative_velocity(forcing, tau, y)
        return *moving, jnp.where(slips, own * velocity, -y[-1] * self._decay(y))

    def stuck(self, sign: FloatArray) -> BoolArray:
        return self.inner.stuck(self._split(sign)[0])

    def at_rest(self, forcing: F, y: State, times: float = 1.0) -> BoolArray:
        return self._with(self.inner.at_rest(forcing, y[:-1], times), False)

    def slip_sign(self, forcing: F, y: State) -> FloatArray:
        return self._with(self.inner.slip_sign(forcing, y[:-1]), jnp.where(y[-1] < self._distances(y), 1, -1))

    def after(
        self, forcing: F, y: State, sign: FloatArray, landed: BoolArray, ended: BoolArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        (of_inner, weakens), (landed_inner, is_weak) = self._split(sign), self._split(landed)
        of_inner, contacts, changed = self.inner.after(forcing, y[:-1], of_inner, landed_inner, ended)
        # What sticks weakens as soon as it slips. Friction has no jump where that ends: nobody need be asked.
        weakens = jnp.where(self._slipping(sign)[0], jnp.where(is_weak, -1, weakens), 1)
        return self._with(of_inner, weakens), self._with(contacts, False), self._with(changed, False)

    def guard(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> Guard:
        of_inner, weakens = self._split(sign)
        distances, rate = self._distances(y), self.rates(forcing, tau, y, sign)[-1]

        def after(slip: Array) -> Guard:
            return self.after_slip(slip, slip).guard(forcing, tau, y[:-1], of_inner)

        slips, _ = self._slipping(sign)
        weakening = jnp.where(slips & (weakens < 0), 0, rate)
        (guard, own_rate), (by_slip, _) = jax.jvp(after, (self._weakened_by(y, sign),), (weakening,))
        ends = slips & (weakens > 0) & jnp.isfinite(distances)
        left = jnp.where(ends, jnp.where(ends, distances, 0) - y[-1], 1)
        return self._with(guard, left), self._with(own_rate + by_slip, jnp.where(ends, -rate, 0))

    def guard_scale(self, forcing: F, y: State, sign: FloatArray) -> FloatArray:
        distances = self._distances(y)
        size = jnp.where(jnp.isfinite(distances), distances + y[-1], 1)
        return self._with(self.inner.guard_scale(forcing, y[:-1], self._split(sign)[0]), size)

    def at_base_velocity(self, forcing: F, y: State, resting: BoolArray) -> State:
        return *self.inner.at_base_velocity(forcing, y[:-1], self._split(resting)[0]), y[-1]

    def entered(self, forcing: F, y: State, before: FloatArray, sign: FloatArray) -> State:
        modes = (self._split(of)[0] for of in (before, sign))
        moving = self._in_mode(y, sign).entered(forcing, y[:-1], *modes)
        return *moving, jnp.where(self._slipping(sign)[0], y[-1], self._rested(y))

    def decided(self, forcing: F, y: State, question: Question) -> Decision:
        of_inner, (_, weakens) = Question(*(self._split(part)[0] for part in question)), self._split(question.sign)
        slip = self._weakened_by(y, question.sign)
        # What comes to rest is held by what a stick has that begins there.
        rested = jnp.where(self.inner._own(of_inner.asked), self._rested(y), slip)
        found = self.after_slip(slip, rested).decided(forcing, y[:-1], of_inner)
        return Decision(
            self._with(found.holds, False), self._with(found.release_sign, weakens),
            self._with(found.guard, jnp.inf), self._with(found.guard_rate, 0),
        )  # fmt: skip

    def step_limit(self, age: FloatArray, step: FloatScalar, y: State, sign: FloatArray) -> FloatScalar:
        heals = ~self._slipping(sign)[0] & (self._decay(y) > 0)
        longest = jnp.where(heals, _SHARE / jnp.where(heals, self._decay(y), 1), jnp.inf)
        return jnp.minimum(self.inner.step_limit(age, step, y[:-1], self._split(sign)[0]), jnp.min(longest))

    def without_memory(self, y: State, sign: FloatArray | None = None) -> tuple[Any, State]:
        if not y:
            return self.inner, y
        slip = jnp.minimum(y[-1], self._distances(y))
        return self.after_slip(slip, slip), y[:-1]

    def modes_without_memory(self, sign: FloatArray) -> FloatArray:
        return self._split(sign)[0]


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

    def __check_init__(self):
        steps = [law for law in self.laws if isinstance(law, DieterichRuina) and law.normal_stress is not None]
        if steps and isinstance(self.inner, OneContactModel):
            raise ValueError(
                f"Argument normal_stress must be None in this system, but {steps[0]} was given: its normal force is "
                "not known in N; take a MassSpring, a LinearStructure, or a SwitchedSystem with normal_forces."
            )

    @property
    def remembered(self) -> int | None:
        number = sum(self._numbers)
        return number if self.contacts or number > 1 else None

    @property
    def _numbers(self) -> list[int]:
        """How many numbers the inner state of each law has."""
        return [len(law.inner_states) for law in self.laws]

    def _states(self, forcing: Any, tau: FloatScalar, y: State) -> list[FloatArray]:
        """The inner states of several contacts, as they count under the normal forces."""
        normal, ends = self.inner.normal_forces_at(forcing, tau, y[:-1]), np.cumsum(self._numbers)
        own = [y[-1][end - n : end] if n > 1 else y[-1][end - 1] for n, end in zip(self._numbers, ends, strict=True)]
        return [law.at_normal_force(own[i], normal[i]) for i, law in enumerate(self.laws)]

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
        states = self._states(forcing, tau, y)
        return jnp.stack([law.coefficient(states[i], velocity[i]) for i, law in enumerate(self.laws)])

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
        states = self._states(forcing, tau, y)
        inner_rates = jnp.hstack([law.rate(states[i], velocity[i]) for i, law in enumerate(self.laws)])
        return *(a + b for a, b in zip(now.rates, by_friction, strict=True)), inner_rates
