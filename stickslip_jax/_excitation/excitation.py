"""The excitation of a system: a smooth part and piecewise-linear parts, as the engines need them."""

from collections.abc import Sequence
from typing import Any, Protocol, TypeAlias, cast, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.errors import ConcretizationTypeError
from jax.typing import DTypeLike
from jaxtyping import Array, PyTree

from .._foundation import checks
from .._foundation.fields import is_of_package
from .._foundation.types import AnyArray, FloatArray, FloatScalar, KeyData, Number, Scalar, Word
from .._numerics.derivatives import NotKnown
from .._numerics.elementary import key_data_of, random_words
from .._uncertainty.inputs import SampledLaw, UserLaw
from .motion import Motion, RandomSignal, Signal, SourceVoltage, UserMotion
from .piecewise_constant import Constant, Interval, PiecewiseConstantLaw, VelocitySteps
from .segments import SegmentLaw, SegmentTable, marked, no_key

# The excitation of a system: a smooth part and piecewise-linear parts, as the switched engine follows them.


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
    jumps: PiecewiseConstantLaw
    takes_jumps = False

    def __check_init__(self):
        if not isinstance(self.jumps, PiecewiseConstantLaw):
            raise checks.refused("jumps", "be a law such as PoissonSwitching", self.jumps)
        if not motion_of(self.motion).takes_jumps:
            raise checks.refused("motion", "be a continuous base velocity such as a Harmonic", self.motion)

    @property
    def is_random(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - that of its parts
        """Whether realisations differ."""
        return self.motion.is_random or self.jumps.is_random

    @property
    def covered_time(self) -> float:
        return self.motion.covered_time

    def sample(self, key: Array | None, t1: Scalar, *, capacity: int | None = None) -> "WithJumps":
        """One realisation that covers ``[0, t1]``; arguments and errors as for the law of the jumps."""
        if key is None and self.is_random:
            raise no_key(self)
        of_segments, of_signal = (None, None) if key is None else (jax.random.fold_in(key, part) for part in (0, 1))
        motion, jumps = self.motion, self.jumps
        if motion.is_random:
            assert of_segments is not None
            is_signal = motion.part_of_excitation == "smooth"
            motion = motion.sample(of_signal if is_signal else jax.random.fold_in(of_segments, _MOTION), t1)
        if not isinstance(jumps, VelocitySteps):
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

    smooth: Signal | RandomSignal | None = None
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


BaseMotion: TypeAlias = Motion | UserBaseMotion | UserLaw | Number
"""Excitation of a system: a law or a realisation of base velocity, ground acceleration or source voltage; a number is a
constant base velocity, m/s."""


def motion_of(base: BaseMotion, name: str = "base") -> Motion:
    """`base`, the argument called `name`, as a motion of the package. Raises ValueError for anything else."""
    if isinstance(base, Motion):
        return base
    if _is_users(base):
        return UserMotion(base)
    if _is_number(base):
        checks.bounded(name, base, "m/s")
        return Constant(base)
    hint = ""
    if callable(base) and not isinstance(base, type):
        hint = "of a function make a signal, ss.Signal.of(function, shortest_period=...)"
    demand = "be a base motion such as Harmonic(...), a law, a constant velocity (m/s), or an object with methods "
    raise checks.refused(name, f"{demand}velocity(t) and acceleration(t)", base, hint)


def realisation_of(base: BaseMotion) -> Motion:
    """The argument called base as a motion of the package. Raises ValueError for a random one too."""
    motion = motion_of(base)
    if motion.is_random:
        raise ValueError(
            f"Argument base must be a realisation, but the random law {type(base).__name__} was given; draw one with "
            "base.sample(key, t1)."
        )
    return motion


def excitation_of(base: BaseMotion, name: str = "base") -> Excitation:
    """The parts of `base`, the argument called `name`. Raises ValueError for what is no motion."""
    motion = motion_of(base, name)
    if isinstance(motion, WithJumps):
        own, (jumps,) = excitation_of(motion.motion), excitation_of(motion.jumps).base
        reseeded = (_Reseeded(law) if law.is_random else law for law in own.base)
        return Excitation(own.smooth, (*reseeded, jumps), has_key_per_part=True)
    if motion.part_of_excitation == "none":
        what = type(motion).__name__
        raise ValueError(f"Argument {name} must be a base motion, but a {what} was given, which is a force.")
    part: Any = motion if motion.part_of_excitation == "smooth" else (motion,)
    return Excitation(**{motion.part_of_excitation: part})


def _is_users(base: object) -> bool:
    is_other = not isinstance(base, (Motion, type))
    return is_other and all(callable(getattr(base, name, None)) for name in ("velocity", "acceleration"))


def _is_number(base: object) -> bool:
    """Whether `base` is a constant velocity."""
    is_array = isinstance(base, (np.generic, np.ndarray, jax.Array)) and np.ndim(base) == 0
    return is_array or (isinstance(base, (int, float)) and not isinstance(base, bool))


def is_random(base: BaseMotion | SampledLaw) -> bool:
    """Whether `base` is a law whose realisations differ, so that one must be drawn before `simulate`."""
    return isinstance(base, (Motion, SampledLaw)) and base.is_random


def law_of(base: BaseMotion) -> BaseMotion | SampledLaw:
    """`base`; a number as a `Constant`, the user's object with a method ``sample(key, t1)`` as a `SampledLaw`."""
    if _is_number(base):
        return motion_of(base, "law")
    draws = callable(getattr(base, "sample", None)) and not hasattr(base, "__array__")  # as tables of pandas do
    is_known = isinstance(base, (Motion, SampledLaw, type)) or _is_users(base)
    return SampledLaw(cast(UserLaw, base)) if draws and not is_known else base


def key_data_for(base: BaseMotion, key: Array | None) -> Array:
    """The data of `key`; zeros if no key is given and nothing is random. Raises ValueError for a missing key."""
    if key is not None:
        return key_data_of(key)
    if is_random(base):
        raise no_key(base)
    return jnp.zeros(2, jnp.uint32)


def _part(key_data: KeyData, number: int) -> tuple[Array, Array]:
    return random_words(key_data, jnp.asarray(np.uint32(number)))


# A user's law of piecewise-constant base velocity as the engines need it: neighbouring velocities differ.


_Present: TypeAlias = tuple[PyTree, Word, FloatScalar, FloatScalar]
"""The memory of a law after an interval, the number of the next one, and the duration and velocity of the interval."""


class Merged(PiecewiseConstantLaw):
    """The same realisations as those of `law`, until `t1` (s); neighbours of equal velocity are one interval.

    An impossible interval has the duration NaN; after it, and after one of duration 0, there are no more. Only laws of
    users need it: those of the package never repeat a velocity.
    """

    law: PiecewiseConstantLaw
    t1: Scalar

    @property
    def is_random(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - that of its law
        """Whether realisations differ."""
        return self.law.is_random

    def capacity(self, t1: Scalar) -> int:
        return self.law.capacity(t1)

    def begin(self, key_data, dtype):
        """Memory: the law's, the number of its next interval, and the length and velocity of the present one, which is
        drawn one step ahead; and when that begins.
        """
        nothing = jnp.full((), jnp.inf, dtype), jnp.zeros((), dtype)
        first = self._following(key_data, (self.law.begin(key_data, dtype), jnp.zeros((), jnp.uint32), *nothing), dtype)
        return first, jnp.zeros((), dtype)

    def draw(self, key_data, number, dtype):
        # Which of the law's intervals come next is in the memory, for some may have been joined.
        return jnp.asarray(key_data[0]), jnp.asarray(key_data[1])

    def next_interval(self, memory, drawn, dtype) -> Interval:
        present, began = memory
        _, _, duration, velocity = present

        def repeats(state):
            (_, _, more, after), total = state
            return (more > 0) & (after == velocity) & (began + total < self.t1)

        def join(state):
            following, total = state
            return self._following(drawn, following, dtype), total + following[2]

        following, total = lax.while_loop(repeats, join, (self._following(drawn, present, dtype), duration))
        # Intervals after the horizon are not checked: they may be impossible.
        counts = began < self.t1
        return jnp.where(counts, total, jnp.inf), jnp.where(counts, velocity, 0), (following, began + total)

    def _following(self, key_data: KeyData, present: _Present, dtype: DTypeLike) -> _Present:
        """The law's memory, number, duration and velocity after the interval with the `present` ones."""
        memory, number, duration, _ = present
        more, velocity, memory = self.law.next_interval(memory, self.law.draw(key_data, number, dtype), dtype)
        more, velocity = jnp.asarray(more, dtype), jnp.asarray(velocity, dtype)
        return memory, number + np.uint32(1), jnp.where(duration > 0, marked(more, velocity), 0), velocity


def merged(base: BaseMotion, t1: Scalar) -> BaseMotion:
    """`base`, in which a law of the user's that jumps is `Merged`."""
    if isinstance(base, WithJumps):
        jumps = merged(base.jumps, t1)
        return base if jumps is base.jumps else eqx.tree_at(lambda whole: whole.jumps, base, jumps)
    return Merged(base, t1) if isinstance(base, PiecewiseConstantLaw) and not is_of_package(base) else base


# The base velocity of any motion at any times.


def base_velocity(base: BaseMotion, times: AnyArray | Sequence[float] | float | int) -> FloatArray:
    """The velocity of a base motion at any times, as `simulate` follows it.

    Args:
        base: A base motion without randomness: a signal such as `Harmonic`, a `Recorded`, a law such as `SquareWave`, a
            realisation ``law.sample(key, t1)``, a `WithJumps` of such, or an object of your own with ``velocity(t)``
            and ``acceleration(t)``.
        times: s, any shape.

    Returns:
        The velocity (m/s) with the shape of `times`; at a jump, the one after it. NaN before t = 0 and after its end
        for a motion in segments, such as a record.

    Raises:
        ValueError: For a random law, a ground acceleration and a voltage; and for a law such as `SquareWave` where
            `times` are traced by a JAX transformation.

    >>> print(ss.base_velocity(ss.Recorded([0.0, 2.0], [0.0, 1.0]), [0.0, 0.5, 2.0]))
    [0.   0.25 1.  ]
    """
    checks.require_threads_of_jax()
    checks.numeric("times", times, ndim=None)
    excitation = excitation_of(realisation_of(base))
    if excitation.ground or isinstance(excitation.smooth, SourceVoltage):
        what = "a ground acceleration" if excitation.ground else "a voltage"
        raise ValueError(
            f"Argument base must be a base velocity, but {what} was given, under which the base is at rest."
        )
    times = jnp.asarray(times, jnp.result_type(float))
    flat = times.reshape(-1)
    # Segments until the last of the times, and one more: it may begin there.
    latest = jnp.max(flat) if checks.is_traced(flat) else float(np.max(np.asarray(flat), initial=0.0))
    smooth, none = excitation.signal, jnp.zeros((), jnp.uint32)
    velocity = jnp.zeros_like(flat)
    if smooth is not None:
        velocity = jax.vmap(lambda time: jnp.asarray(smooth.value(time), time.dtype))(flat)
    for law in excitation.base:
        try:
            number = law.segments(latest)
        except (ConcretizationTypeError, NotKnown):
            raise ValueError(
                "Argument base must be a realisation where times or its numbers are traced by a JAX transformation (it "
                f"is not known then how many segments it has), but the law {type(law).__name__} was given; take "
                "base.sample(None, t1)."
            ) from None
        table = SegmentTable.of(law, (none, none), number + 1, flat.dtype)
        segment = table.at(flat)
        here = segment.value + segment.slope * (flat - segment.begin)
        velocity = velocity + jnp.where((flat >= 0) & (flat <= table.end), here, jnp.nan)
    return velocity.reshape(times.shape)


def way_of_base(base: BaseMotion, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """How far a base motion without randomness moves between these times (s, (times,)), m; zero where it moves none.

    Exact for motions in segments and harmonics; of other signals by Gauss's rule with 10 points in each time.
    """
    excitation, none = excitation_of(realisation_of(base)), jnp.zeros((), jnp.uint32)
    way, smooth, last = np.zeros_like(begin), excitation.signal, float(np.max(end, initial=0.0))
    if smooth is not None and not isinstance(smooth, SourceVoltage):
        way = np.asarray(jax.vmap(smooth.integral)(jnp.asarray(begin), jnp.asarray(end - begin)))
    for law in excitation.base:
        table = SegmentTable.of(law, (none, none), law.segments(last) + 1, begin.dtype)
        segments = jax.tree.map(np.asarray, table.segments)
        lengths = np.diff(np.minimum(np.append(segments.begin, np.inf), last))
        before = np.cumsum(np.append(0.0, segments.value * lengths + segments.slope * lengths**2 / 2))
        for sign, times in ((-1, begin), (1, end)):
            place = np.searchsorted(segments.begin, times, "right") - 1
            within = times - segments.begin[place]
            way = way + sign * (before[place] + (segments.value[place] + segments.slope[place] * within / 2) * within)
    return way
