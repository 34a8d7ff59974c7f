"""Friction that differs with the direction of slip; and friction that differs from place to place: the law, and a mass
whose mode ends where it comes to another region.
"""

import abc
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._foundation import checks
from .._foundation.fields import Quantity, is_distribution, varies_within, with_fields
from .._foundation.types import BoolArray, DType, FloatArray, FloatScalar, Number, Scalar, State
from .friction import Coulomb, FrictionLaw, MadeOfLaws, least, most, require_law
from .switched_model import NOISE_ULPS, Decision, F, Guard, OneContactModel, Question, SwitchedModel

# Friction by direction: one law for each.


class ByDirection(MadeOfLaws):
    """Base class of laws with another law in each direction of slip."""

    @property
    @abc.abstractmethod
    def ways(self) -> tuple[FrictionLaw, FrictionLaw]:
        """The laws of slips forward, and backward."""

    @property
    def constant(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances only
        return all(law.constant for law in self.ways)

    @property
    def static_exceeds_kinetic(self) -> bool:
        return any(law.static_exceeds_kinetic for law in self.ways)

    @property
    def speed_scale(self) -> Scalar | None:
        return least(*(law.speed_scale for law in self.ways))

    @property
    def viscous_slope(self) -> Scalar:
        return most(*(law.viscous_slope for law in self.ways))

    @property
    def static(self) -> Scalar:
        return most(*(law.static for law in self.ways))

    def static_after(self, age: FloatArray | float) -> Scalar | FloatArray:
        return jnp.maximum(*(law.static_after(age) for law in self.ways))

    @property
    def grows(self) -> bool:
        return any(law.grows for law in self.ways)

    @property
    def growth_time(self) -> Scalar | None:
        return least(*(law.growth_time for law in self.ways if law.grows))

    def kinetic(self, speed: FloatArray) -> Scalar | FloatArray:
        """The larger one of the two coefficients."""
        return jnp.maximum(*(law.kinetic(speed) for law in self.ways))

    def in_direction(self, velocity: FloatArray) -> FrictionLaw:
        forward, backward = self.ways
        return _Chosen(forward.in_direction(velocity), backward.in_direction(velocity), velocity > 0)


class Directional(ByDirection):
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
            require_law(name, getattr(self, name), may_remember=False)

    def has_varying_parts(self) -> bool:
        return varies_within(self.ways)

    @property
    def ways(self) -> tuple[FrictionLaw, FrictionLaw]:
        return self.forward, self.backward


class OneWay(ByDirection):
    """A contact that slips in one direction and holds in the other: a freewheel, a ratchet, blocks that do not return.

    Slips with a positive relative velocity (of the mass, relative to what it rubs on; of a clutch, where the second of
    its inertias is the faster one) have the law `forward`. Against slips backward it holds up to `capacity` times the
    normal force: choose that far above all loads, and it holds any of them. Round-off of forces grows with it: of a
    capacity of 1000, 1e-13 of the normal force. What is pushed back by more, or starts with a negative velocity, is
    stopped by that force. For a contact that slips backward alone take ``Directional(Coulomb(1000.0), law)``.

    Args:
        forward: The law of slips, and of sticks that would break into them; by default without friction.
        capacity: The largest force that it holds against slips backward, over the normal force, positive.

    Raises:
        ValueError: If `forward` is no friction law, or for a capacity out of range.

    >>> hub = ss.FrictionDisk(normal_force=100.0, friction=ss.OneWay())
    >>> pedals = ss.ForceSteps([0.0, 3.0], [4.2, -0.1])  # N m: they drive for 3 s
    >>> bicycle = ss.drivetrain([0.1, 2.0], clutches=[hub], torque=(pedals, -0.4))
    >>> one = ss.simulate(bicycle, ss.Constant(0.0), t1=4.0)
    >>> print([f"{speed:.3f}" for speed in one.final_state[2:]], one.sticks.end[0])
    ['4.429', '5.229'] 3.0
    """

    forward: FrictionLaw = Coulomb(0.0)
    capacity: Annotated[Number, Quantity(meaning="held backward, over the normal force", above=0)] = 1000.0

    def check_parts(self) -> None:
        require_law("forward", self.forward, may_remember=False)

    def has_varying_parts(self) -> bool:
        return varies_within(self.forward)

    @property
    def ways(self) -> tuple[FrictionLaw, FrictionLaw]:
        return self.forward, with_fields(Coulomb(0.0), Coulomb, mu=self.capacity)  # also of many contacts at once

    @property
    def speed_scale(self) -> Scalar | None:
        # Systems take the largest force for that of slips, in which it is `capacity / forward.static` times less.
        own, held = self.forward.speed_scale, self.forward.static
        return own if own is None or self.forward.constant else own * self.capacity / most(held, 1e-9 * self.capacity)


class _Chosen(MadeOfLaws):
    """One of two laws, by a number that JAX may trace."""

    first: FrictionLaw
    second: FrictionLaw
    takes_first: BoolArray

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


# Friction by place: the law.

Carrier: TypeAlias = Literal["base", "ground"]
"""What the places are marked on."""


class FrictionByPlace(FrictionLaw):
    """Piecewise uniform friction: between given places it has a law of its own, and jumps there.

    A place of the base, such as a mark on a belt, moves with it: where the mass is on the base is a further number of
    the state, its *place* (m), the mass's position less the way of the base. It is zero in an initial state without it.
    A place of the ground, such as one along a rail, is a position of the mass. The friction changes when the mass comes
    to another region: that is an event like the others, in a slip, or in a stick that is carried along the ground.

    The conference paper of Lima and Sampaio names belts that are piecewise uniform.

    Args:
        places: Where the friction jumps, m, increasing.
        laws: The friction laws of the regions between them, all of one kind with the same numbers given, such as
            `Coulomb`: one more than there are places, or with a `period` as many, each from its place to the next.
        period: After which the regions repeat themselves, m, larger than the last place less the first; None: not.
        on: "base" (the default) or "ground".

    Raises:
        ValueError: For places that do not increase, another number of laws, laws of several kinds or with an inner
            state, and a period that is too short.

    >>> belt = ss.FrictionByPlace((0.0, 0.3), (ss.Coulomb(0.8), ss.Coulomb(0.4)), period=1.0)
    >>> system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=belt)
    >>> one = ss.simulate(system, ss.Constant(0.2), t1=20.0)
    >>> print(f"{float(one.final_state[2]):.3f}")  # the place on the belt, m
    -3.878
    """

    places: tuple[Number, ...]
    laws: tuple[FrictionLaw, ...]
    period: Annotated[Number | None, Quantity("m", "after which the regions repeat themselves", above=0)] = None
    on: Carrier = eqx.field(static=True, default="base", kw_only=True)
    differs_by_place = True
    rests_on: ClassVar = {"constant": (), "static_exceeds_kinetic": (), "speed_scale": ()}

    def check_parts(self) -> None:
        checks.chosen("on", self.on, get_args(Carrier))
        for name in ("places", "laws"):
            if not isinstance(getattr(self, name), tuple) or not getattr(self, name):
                raise checks.refused(name, "be a tuple with one entry or more", getattr(self, name))
        for at, place in enumerate(self.places):
            if not is_distribution(place):
                checks.numeric(f"places[{at}]", place)
        for at, law in enumerate(self.laws):
            require_law(f"laws[{at}]", law, may_remember=False)
        regions = len(self.places) + (self.period is None)
        if len(self.laws) != regions:
            raise checks.refused("laws", f"hold {regions} laws, one for each region", self.laws)
        kinds = {(type(law), *(name for name, held in vars(law).items() if held is None)) for law in self.laws}
        if len(kinds) > 1 or any(law.grows or law.depends_on_direction for law in self.laws):
            raise checks.refused(
                "laws",
                "be of one kind with the same numbers given, alike in both directions, without ageing",
                self.laws,
            )

    def check_relations(self) -> None:
        known = [place for place in self.places if not checks.is_traced(place)]
        if len(known) < len(self.places):
            return
        if np.any(np.diff(np.asarray(known, float)) <= 0):
            raise checks.refused("places", "increase", self.places)
        if self.period is not None and not checks.is_traced(self.period) and not varies_within((self.period,)):
            checks.bounded("period", self.period, "m", above=float(known[-1] - known[0]))

    def has_varying_parts(self) -> bool:
        return any(map(is_distribution, self.places)) or varies_within(self.laws)

    @property
    def constant(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances only
        return all(law.constant for law in self.laws)

    @property
    def static_exceeds_kinetic(self) -> bool:
        return any(law.static_exceeds_kinetic for law in self.laws)

    @property
    def speed_scale(self) -> Scalar | None:
        return least(*(law.speed_scale for law in self.laws))

    @property
    def static(self) -> Scalar:
        """The largest of all regions."""
        return jnp.max(jnp.stack([jnp.asarray(law.static, float) for law in self.laws]))

    def kinetic(self, speed: FloatArray) -> FloatArray:
        """The largest of all regions."""
        return jnp.max(jnp.stack([jnp.asarray(law.kinetic(speed), float) for law in self.laws]), axis=0)

    def in_region(self, region: FloatArray) -> FrictionLaw:
        """The law of one region, a whole number from 0 below the first place on (with a period: from it on)."""
        index = jnp.asarray(region).astype(jnp.int32)
        index = index % len(self.laws) if self.period is not None else jnp.clip(index, 0, len(self.laws) - 1)
        return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf, float) for leaf in leaves])[index], *self.laws)

    def static_at(self, place: FloatArray) -> Scalar:
        """The static friction coefficient at one place, m."""
        return self.in_region(self.region_of(place)).static

    def region_of(self, place: FloatArray) -> FloatArray:
        """The number of the region at a `place`, m; at a border the one above it."""
        borders = jnp.stack([jnp.asarray(one, place.dtype) for one in self.places])
        if self.period is None:
            return jnp.searchsorted(borders, place, side="right", method="compare_all").astype(place.dtype)
        turns = jnp.floor((place - borders[0]) / self.period)
        inside = place - turns * self.period
        return turns * len(self.laws) + jnp.searchsorted(borders, inside, side="right", method="compare_all") - 1

    def ends_of(self, region: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The places (m) at which a region begins and ends, infinite where it does not."""
        borders = [jnp.asarray(one, region.dtype) for one in self.places]
        if self.period is None:
            table = jnp.stack([jnp.full_like(region, -jnp.inf), *borders, jnp.full_like(region, jnp.inf)])
            index = jnp.clip(region.astype(jnp.int32), 0, len(borders))
            return table[index], table[index + 1]
        table, number = jnp.stack([*borders, borders[0] + self.period]), len(borders)
        turns = jnp.floor(region / number)
        index = (region - turns * number).astype(jnp.int32)
        return table[index] + turns * self.period, table[index + 1] + turns * self.period


# A mass on places of different friction.
#
# Its mode is that of the mass in the region where it is, and the region: an array (3,) of the sign of the contact and
# twice a number that stands for the region. The guards of the last two are how far it is to both ends of the region.
# So each step has one friction law, and ends where another begins.

_OFFSET = 0.5  # of the number that stands for a region: 0 would be a stick


class PlacedContact(SwitchedModel[F]):
    """The model `inner` of one contact, with the friction of the region where the mass is.

    Its state is that of `inner`, and with places of the base the place.
    """

    inner: Any  # a OneContactModel with a system
    law: FrictionByPlace
    steps_may_be_long: ClassVar[bool] = False

    @property
    def has_kinks(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - asked of instances only
        return self.inner.has_kinks

    @property
    def time_scales_are_known(self) -> bool:
        return self.inner.time_scales_are_known

    @property
    def friction(self) -> FrictionLaw:
        """The law, of all regions."""
        return self.law

    def forcing(self, t: FloatScalar, segments: Any) -> Any:
        return self.inner.forcing(t, segments)

    def start(self, y0: tuple[Number, ...] | FloatArray, dtype: DType) -> State:
        return tuple(jnp.asarray(value, dtype) for value in y0)

    def stuck(self, sign: FloatArray) -> BoolArray:
        return sign[0] == 0

    def within(self, region: FloatArray) -> OneContactModel[F]:
        """The model in one region, given by the number that stands for it."""
        friction = self.law.in_region(jnp.floor(region))
        return eqx.tree_at(lambda model: model.system.friction, self.inner, friction)

    def without_memory(self, y: State, sign: FloatArray | None = None) -> tuple[OneContactModel[F], State]:
        """The model in the region of the state `y`, on a border that of the mode, and its state."""
        if not y:
            return self.inner, y
        return self.within(self.law.region_of(self.place(y)) + _OFFSET if sign is None else sign[1]), self._own(y)

    def modes_without_memory(self, sign: FloatArray) -> FloatArray:
        return sign[0]

    def _own(self, y: State) -> State:
        """The state of the `inner` model."""
        return y[:-1] if self.law.on == "base" else y

    def place(self, y: State) -> FloatArray:
        """Where the mass is: on the base, or on the ground."""
        return y[-1] if self.law.on == "base" else self.inner.position(y)

    def _place_rate(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> FloatArray:
        if self.law.on == "ground":
            return jax.jvp(self.inner.position, (y,), (self.inner.rates(forcing, tau, y, sign[0]),))[1]
        return jnp.where(sign[0] == 0, 0, self.inner.relative_velocity(forcing, tau, self._own(y)))

    def flow_and_error(
        self, forcing: F, y: State, h: FloatScalar, sign: FloatArray
    ) -> tuple[State, FloatScalar | None]:
        own = self._own(y)
        reached, error = self.within(sign[1]).flow_and_error(forcing, own, h, sign[0])
        if self.law.on == "ground":
            return reached, error
        carried = self.inner.stick(forcing, own, h)[0][0] - y[0]
        return (*reached, jnp.where(sign[0] == 0, y[-1], y[-1] + (reached[0] - y[0]) - carried)), error

    def rates(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> State:
        own = self.within(sign[1]).rates(forcing, tau, self._own(y), sign[0])
        return own if self.law.on == "ground" else (*own, self._place_rate(forcing, tau, y, sign))

    def relative_velocity(self, forcing: F, tau: FloatScalar, y: State) -> FloatArray:
        return self.inner.relative_velocity(forcing, tau, self._own(y))

    def at_rest(self, forcing: F, y: State, times: float = 1.0) -> BoolArray:
        return _with(self.inner.at_rest(forcing, self._own(y), times), False)

    def slip_sign(self, forcing: F, y: State) -> FloatArray:
        none, slips = jnp.zeros_like(y[0]), self.inner.slip_sign(forcing, self._own(y))
        return _with(slips, self._region(y, self._place_rate(forcing, none, y, jnp.stack([slips, slips]))))

    def _region(self, y: State, direction: FloatArray) -> FloatArray:
        """What stands for the region of a state: on a border, within its round-off, that to which the mass moves."""
        place = self.place(y)
        size = jnp.max(jnp.abs(jnp.stack([jnp.asarray(one, place.dtype) for one in (0.0, *self.law.places)])))
        few = NOISE_ULPS * jnp.finfo(place.dtype).eps * (size + self._terms(y))
        return self.law.region_of(place + few * jnp.sign(direction)) + _OFFSET

    def after(
        self, forcing: F, y: State, sign: FloatArray, landed: BoolArray, ended: BoolArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        next_one = sign[1] + landed[2].astype(y[0].dtype) - landed[1].astype(y[0].dtype)
        # A stick on a border that does not carry the mass along is in the region to which it would break.
        own = self._own(y)
        slips = self.inner.slip_direction(own, jnp.where(sign[0] == 0, self.inner.release_sign(forcing, own), sign[0]))
        direction = slips * self.inner.to_inner_law(own)[0]
        if self.law.on == "ground":
            moves = self._place_rate(forcing, jnp.zeros_like(y[0]), y, sign)
            direction = jnp.where(moves == 0, direction, moves)
        region = jnp.where(landed[0] | ended, self._region(y, direction), next_one)
        # What a stick can hold, and the force in a slip, is another there: the contact is asked.
        moved = region != sign[1]
        return _with(sign[0], region), _with(landed[0] & ~moved, False), _with(moved, False)

    def guard(self, forcing: F, tau: FloatScalar, y: State, sign: FloatArray) -> Guard:
        guard, rate = self.within(sign[1]).guard(forcing, tau, self._own(y), sign[0])
        low, high = self.law.ends_of(jnp.floor(sign[1]))
        place, moves = self.place(y), self._place_rate(forcing, tau, y, sign)
        guards, rates = [guard], [rate]
        for way, end in ((1, low), (-1, high)):
            ends = jnp.isfinite(end) & (moves != 0)  # what stays where it is comes to no other region
            guards.append(jnp.where(ends, way * (place - jnp.where(ends, end, 0)), 1))
            rates.append(jnp.where(ends, way * moves, 0))
        return jnp.stack(guards), jnp.stack(rates)

    def guard_scale(self, forcing: F, y: State, sign: FloatArray) -> FloatArray:
        ends = (jnp.where(jnp.isfinite(end), end, 0) for end in self.law.ends_of(jnp.floor(sign[1])))
        sizes = [jnp.abs(end) + self._terms(y) for end in ends]
        return jnp.stack([self.within(sign[1]).guard_scale(forcing, self._own(y), sign[0]), *sizes])

    def _terms(self, y: State) -> FloatArray:
        """The size of what the place is made of: the scale of its round-off."""
        own = self._own(y)
        slopes = jax.grad(self.inner.position)(own)
        at = (jnp.abs(slope * number) for slope, number in zip(slopes, own, strict=True))
        return jnp.abs(self.place(y)) + sum(at, jnp.zeros_like(y[0]))

    def at_base_velocity(self, forcing: F, y: State, resting: BoolArray) -> State:
        own = self._own(y)
        return *self.inner.at_base_velocity(forcing, own, resting[0]), *y[len(own) :]

    def decided(self, forcing: F, y: State, question: Question) -> Decision:
        region = question.sign[1]
        found = self.within(region).decided(forcing, self._own(y), Question(*(own[0] for own in question)))
        return Decision(
            _with(found.holds, False), _with(found.release_sign, region), _with(found.guard, jnp.inf),
            _with(found.guard_rate, 0.0),
        )  # fmt: skip

    def step_limit(self, age: FloatArray, step: FloatScalar, y: State, sign: FloatArray) -> FloatScalar:
        return self.inner.step_limit(age[0] if age.ndim else age, step, self._own(y), sign[0])


def _with(own: Any, region: Any) -> Any:
    """What belongs to the contact, and twice what belongs to the region."""
    own = jnp.asarray(own)
    return jnp.stack([own, *(jnp.asarray(region, own.dtype),) * 2])
