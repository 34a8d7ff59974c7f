"""The excitation of a system: a smooth part and piecewise-linear parts, as the switched engine follows them."""

from typing import Any, Protocol, TypeAlias, cast, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._numerics.random_bits import key_data_of, random_words
from .._types import Array, FloatArray, KeyData, Number, Scalar
from .._uncertainty.sampled_law import SampledLaw, UserLaw
from .motion import Motion, Parts, Path
from .piecewise_constant import PiecewiseConstantLaw, VelocitySteps
from .random import RandomSignal
from .segments import SegmentLaw
from .smooth import Signal, UserMotion

_MOTION = 1  # number of the key data of a random motion in segments, among those of the jumps


class WithJumps(Motion):
    """A base velocity that is the sum of a continuous motion and of one that jumps.

    Args:
        motion: A `Signal` such as `Harmonic`, a `RandomPhase`, a `GaussianProcess`, a `Recorded`, a `SegmentLaw` or a
            motion of your own.
        jumps: A law such as `PoissonSwitching`, or a realisation of one.

    Raises:
        ValueError: For anything else.
    """

    motion: Any = eqx.field(converter=lambda v: UserMotion(v) if _is_users(v) else v)
    jumps: PiecewiseConstantLaw | VelocitySteps
    takes_jumps = False

    def __check_init__(self):
        if not isinstance(self.jumps, (PiecewiseConstantLaw, VelocitySteps)):
            raise _checks.refused("jumps", "be a law such as PoissonSwitching", self.jumps)
        if not motion_of(self.motion).takes_jumps:
            raise _checks.refused("motion", "be a continuous base velocity such as a Harmonic", self.motion)

    @property
    def is_random(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - that of its parts
        """Whether realisations differ."""
        return self.motion.is_random or self.jumps.is_random

    def parts(self) -> Parts:
        smooth, base, *_ = self.motion.parts()
        base = tuple(_Reseeded(law) if law.is_random else law for law in base)
        return Parts(smooth, base + self.jumps.parts().base, has_key_per_part=True)

    def path_in_excitation(self, path: Path) -> Path:
        part, *rest = path
        if part == "jumps":
            return "base", -1, *rest
        is_reseeded = self.motion.is_random and self.motion.parts().base
        return self.motion.path_in_excitation(("law", *rest) if is_reseeded else tuple(rest))

    @property
    def covered_time(self) -> float:
        return self.motion.covered_time

    def sample(self, key: Array | None, t1: Scalar, *, capacity: int | None = None) -> "WithJumps":
        """One realisation that covers ``[0, t1]``; arguments and errors as for the law of the jumps."""
        if key is None and self.is_random:
            raise ValueError("Argument key must be a key such as jax.random.key(0), but None was given.")
        of_segments, of_signal = (None, None) if key is None else (jax.random.fold_in(key, part) for part in (0, 1))
        motion, jumps = self.motion, self.jumps
        if motion.is_random:
            assert of_segments is not None
            is_signal = motion.parts().smooth is not None
            motion = motion.sample(of_signal if is_signal else jax.random.fold_in(of_segments, _MOTION), t1)
        if isinstance(jumps, PiecewiseConstantLaw):
            jumps = jumps.sample(of_segments, t1, capacity=capacity)
        return WithJumps(motion, jumps)


class _Reseeded(SegmentLaw):
    """A random law, added to another: it draws from other key data than that."""

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

    Attributes:
        smooth: The smooth part (base velocity or voltage), None if there is none.
        base: Piecewise-linear parts of the base velocity.
        ground: Piecewise-linear parts of the ground acceleration.
        has_key_per_part: Whether each part draws from other key data.
    """

    smooth: Signal | RandomSignal | None
    base: tuple[SegmentLaw, ...] = ()
    ground: tuple[SegmentLaw, ...] = ()
    has_key_per_part: bool = eqx.field(static=True, default=False)

    @property
    def signal(self) -> Signal | None:
        """The smooth part of an excitation that is not random."""
        assert not isinstance(self.smooth, RandomSignal)
        return self.smooth

    def realized(self, key_data: KeyData, dtype) -> Signal | None:
        """The smooth part of the realisation that `key_data` draw."""
        if isinstance(self.smooth, RandomSignal):
            return self.smooth.realized(_part(key_data, 1) if self.has_key_per_part else key_data, dtype)
        return self.signal

    def segment_key_data(self, key_data: KeyData) -> KeyData:
        """The key data for `base` and `ground`."""
        return _part(key_data, 0) if self.has_key_per_part else key_data


@runtime_checkable
class UserBaseMotion(Protocol):
    """A user-defined base motion: any object with these methods of the time `t` (s)."""

    def velocity(self, t: FloatArray) -> Number:
        """The base velocity, m/s."""

    def acceleration(self, t: FloatArray) -> Number:
        """Its time derivative, m/s^2."""


BaseMotion: TypeAlias = Motion | UserBaseMotion | UserLaw
"""Excitation of a system: a law or a realisation of base velocity, ground acceleration or source voltage."""


def motion_of(base: BaseMotion, name: str = "base") -> Motion:
    """`base`, the argument called `name`, as a motion of the package. Raises ValueError for anything else."""
    if isinstance(base, Motion):
        return base
    if _is_users(base):
        return UserMotion(base)
    raise ValueError(
        f"Argument {name} must be a base motion such as Harmonic(...) or a law, or an object with methods velocity(t) "
        f"and acceleration(t), but {_checks.show(base)} was given."
    )


def excitation_of(base: BaseMotion, name: str = "base") -> Excitation:
    """The parts of `base`, the argument called `name`. Raises ValueError for what is no motion."""
    return Excitation(*motion_of(base, name).parts())


def path_in_excitation(base: BaseMotion, path: Path) -> Path:
    """The path in ``excitation_of(base)`` of the number that has the `path` in `base`."""
    return base.path_in_excitation(path) if isinstance(base, Motion) else ("smooth", "motion", *path)


def _is_users(base: object) -> bool:
    is_other = not isinstance(base, (Motion, type))
    return is_other and all(callable(getattr(base, name, None)) for name in ("velocity", "acceleration"))


def is_random(base: BaseMotion | SampledLaw) -> bool:
    """Whether `base` is a law whose realisations differ, so that one must be drawn before `simulate`."""
    return isinstance(base, (Motion, SampledLaw)) and base.is_random


def law_of(base: BaseMotion) -> BaseMotion | SampledLaw:
    """`base`; an object of the user's with a method ``sample(key, t1)`` as a `SampledLaw`."""
    draws = callable(getattr(base, "sample", None)) and not hasattr(base, "__array__")  # as tables of pandas do
    is_known = isinstance(base, (Motion, SampledLaw, type)) or _is_users(base)
    return SampledLaw(cast(UserLaw, base)) if draws and not is_known else base


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


def _part(key_data: KeyData, number: int) -> tuple[Array, Array]:
    return random_words(key_data, jnp.asarray(np.uint32(number)))
