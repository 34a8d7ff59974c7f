"""The excitation of a system: a smooth part and piecewise-linear parts, as the switched engine follows them."""

import math
from typing import Any, Protocol, TypeAlias, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._claims import keeps
from .._numerics.random_bits import key_data_of, random_words
from .._types import Array, KeyData, Scalar
from .ground import GroundAcceleration, GroundMotion
from .piecewise_constant import PiecewiseConstantLaw
from .random import RandomSignal
from .recorded import Recorded
from .sampled import SampledLaw, UserLaw
from .segments import SegmentLaw
from .smooth import Signal, UserMotion
from .velocity_steps import VelocitySteps
from .voltage import SourceVoltage

_SEGMENTS = "draw", "next_segment"  # a record that is continued by another rule has another length
_MOTION = 1  # number of the key data of a random motion in segments, among those of the jumps


class WithJumps(eqx.Module):
    """A base velocity that is the sum of a continuous motion and of one that jumps.

    - `motion`: a `Signal` such as `Harmonic`, a `RandomPhase`, a `GaussianProcess`, a `Recorded`, a `SegmentLaw` or a
      motion of your own.
    - `jumps`: a law such as `PoissonSwitching`, or a realisation of one.

    Raises ValueError for anything else.
    """

    motion: Any = eqx.field(converter=lambda v: UserMotion(v) if _is_users(v) else v)
    jumps: PiecewiseConstantLaw | VelocitySteps

    def __check_init__(self):
        if not isinstance(self.jumps, (PiecewiseConstantLaw, VelocitySteps)):
            raise ValueError(
                f"Argument jumps must be a law such as PoissonSwitching, but {_checks.show(self.jumps)} was given."
            )
        if isinstance(self.motion, (PiecewiseConstantLaw, VelocitySteps, GroundMotion, WithJumps, SourceVoltage)):
            raise ValueError(
                "Argument motion must be a continuous base velocity such as a Harmonic, but "
                f"{_checks.show(self.motion)} was given."
            )
        excitation_of(self.motion)

    def sample(self, key: Array | None, t1: Scalar, *, capacity: int | None = None) -> "WithJumps":
        """One realisation that covers ``[0, t1]``; arguments and errors as for the law of the jumps."""
        if key is None and is_random(self):
            raise ValueError("Argument key must be a key such as jax.random.key(0), but None was given.")
        motion, jumps = self.motion, self.jumps
        own = [None, None] if key is None else [jax.random.fold_in(key, part) for part in (0, 1)]
        if isinstance(motion, RandomSignal) and own[1] is not None:
            motion = motion.sample(own[1], t1)
        elif isinstance(motion, SegmentLaw) and motion.is_random and own[0] is not None:
            motion = motion.sample(jax.random.fold_in(own[0], _MOTION), t1)
        if isinstance(jumps, PiecewiseConstantLaw):
            jumps = jumps.sample(own[0], t1, capacity=capacity)
        return WithJumps(motion, jumps)


class GivenSteps(PiecewiseConstantLaw):
    """A realisation of a base velocity that jumps, as a law with this one realisation."""

    steps: VelocitySteps
    is_random = False

    def capacity(self, t1) -> int:
        return self.steps.durations.shape[-1]

    def begin(self, key_data, dtype):
        return ()

    def draw(self, key_data, number, dtype):
        size = self.steps.durations.shape[-1]
        here = jnp.minimum(number.astype(jnp.int32), size - 1)
        duration = jnp.where(number < size, self.steps.durations[here], 0)
        return duration.astype(dtype), self.steps.velocities[here].astype(dtype)

    def next_interval(self, memory, drawn, dtype):
        return *drawn, ()


class _Apart(SegmentLaw):
    """A random law that draws from key data of its own, where it is added to another."""

    law: SegmentLaw
    is_random = True

    @property
    def jumps(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - that of its law
        return self.law.jumps

    def segments(self, t1) -> int:
        return self.law.segments(t1)

    def begin(self, key_data, dtype):
        return self.law.begin(_part(key_data, _MOTION), dtype)

    def draw(self, key_data, number, dtype):
        return self.law.draw(_part(key_data, _MOTION), number, dtype)

    def next_segment(self, memory, drawn, dtype):
        return self.law.next_segment(memory, drawn, dtype)


class Excitation(eqx.Module):
    """The parts of a base motion, ground motion or voltage.

    - `smooth`: the smooth part (base velocity or voltage), None if there is none.
    - `base`: piecewise-linear parts of the base velocity; `ground`: of the ground acceleration.
    - `parts_differ`: whether each part draws from key data of its own.
    """

    smooth: Signal | RandomSignal | None
    base: tuple[SegmentLaw, ...] = ()
    ground: tuple[SegmentLaw, ...] = ()
    parts_differ: bool = eqx.field(static=True, default=False)

    @property
    def signal(self) -> Signal | None:
        """The smooth part of an excitation that is not random."""
        assert not isinstance(self.smooth, RandomSignal)
        return self.smooth

    def realized(self, key_data: KeyData, dtype) -> Signal | None:
        """The smooth part of the realisation that `key_data` draw."""
        if isinstance(self.smooth, RandomSignal):
            return self.smooth.realized(_part(key_data, 1) if self.parts_differ else key_data, dtype)
        return self.signal

    def segment_key_data(self, key_data: KeyData) -> KeyData:
        """The key data for `base` and `ground`."""
        return _part(key_data, 0) if self.parts_differ else key_data


@runtime_checkable
class UserBaseMotion(Protocol):
    """A user-defined base motion: any object with these methods of the time `t` (s)."""

    def velocity(self, t: Any) -> Any:
        """The base velocity, m/s."""

    def acceleration(self, t: Any) -> Any:
        """Its time derivative, m/s^2."""


BaseMotion: TypeAlias = SegmentLaw | VelocitySteps | Signal | RandomSignal | WithJumps | UserBaseMotion | UserLaw
"""Excitation of a system: a law or a realisation of base velocity, ground acceleration or source voltage."""


def excitation_of(base: Any, name: str = "base") -> Excitation:
    """The parts of `base`, the argument called `name`. Raises ValueError for anything else."""
    if isinstance(base, VelocitySteps):
        return Excitation(None, (GivenSteps(base),))
    if isinstance(base, GroundMotion):
        return Excitation(None, (), (base,))
    if isinstance(base, SegmentLaw):
        return Excitation(None, (base,))
    if isinstance(base, (Signal, RandomSignal)):
        return Excitation(base)
    if isinstance(base, WithJumps):
        motion, jumps = excitation_of(base.motion), excitation_of(base.jumps)
        apart = tuple(_Apart(law) if law.is_random else law for law in motion.base)
        return Excitation(motion.smooth, apart + jumps.base, parts_differ=True)
    if _is_users(base):
        return Excitation(UserMotion(base))
    raise ValueError(
        f"Argument {name} must be a base motion such as Harmonic(...) or a law, or an object with methods velocity(t) "
        f"and acceleration(t), but {_checks.show(base)} was given."
    )


def path_in_excitation(base: BaseMotion, path: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """Where in ``excitation_of(base)`` the number is that `base` has at `path`."""
    if isinstance(base, WithJumps):
        part, *rest = path
        if part == "jumps":
            return "base", -1, *rest
        apart = isinstance(base.motion, SegmentLaw) and base.motion.is_random
        return path_in_excitation(base.motion, ("law", *rest) if apart else tuple(rest))
    if isinstance(base, GroundMotion):
        return "ground", 0, *path
    if isinstance(base, SegmentLaw):
        return "base", 0, *path
    if isinstance(base, (Signal, RandomSignal)):
        return "smooth", *path
    return "smooth", "motion", *path  # a user's object, wrapped


def _is_users(base: Any) -> bool:
    known = isinstance(base, (SegmentLaw, VelocitySteps, Signal, RandomSignal, type))
    return not known and all(callable(getattr(base, name, None)) for name in ("velocity", "acceleration"))


def is_random(base: BaseMotion) -> bool:
    """Whether `base` is a law whose realisations differ, so that one must be drawn before `simulate`."""
    if isinstance(base, WithJumps):
        return is_random(base.motion) or is_random(base.jumps)
    return isinstance(base, (RandomSignal, SampledLaw)) or (isinstance(base, SegmentLaw) and base.is_random)


def law_of(base: Any) -> Any:
    """`base`; an object of the user's with a method ``sample(key, t1)`` as a `SampledLaw`."""
    known = isinstance(base, (SegmentLaw, VelocitySteps, Signal, RandomSignal, WithJumps, SampledLaw, type))
    draws = callable(getattr(base, "sample", None)) and not hasattr(base, "__array__")  # as tables of pandas do
    return base if known or _is_users(base) or not draws else SampledLaw(base)


def key_data_for(base: BaseMotion, key: Array | None) -> Array:
    """The data of `key`; zeros if no key is given and nothing is random. Raises ValueError for a missing key."""
    if key is not None:
        return key_data_of(key)
    if is_random(base):
        raise ValueError(
            f"Argument key must be a key such as jax.random.key(0) for the random law {type(base).__name__}, but None "
            "was given."
        )
    return jnp.zeros(2, jnp.uint32)


def longest_time(base: BaseMotion) -> float:
    """Duration of a recorded motion, s; infinity for one that is not recorded, or whose times are traced."""
    if isinstance(base, WithJumps):
        return min(longest_time(base.motion), longest_time(base.jumps))
    record: Any = base
    times = record.times if any(keeps(base, kind, *_SEGMENTS) for kind in (Recorded, GroundAcceleration)) else None
    return math.inf if times is None or _checks.is_traced(times) else float(times[-1])


def _part(key_data: KeyData, number: int) -> tuple[Array, Array]:
    return random_words(key_data, jnp.asarray(np.uint32(number)))
