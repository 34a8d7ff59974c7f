"""Piecewise-linear functions of time: base velocities, ground accelerations and forces, segment by segment."""

import abc
from collections.abc import Callable
from functools import partial
from typing import ClassVar, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.errors import ConcretizationTypeError
from jax.typing import DTypeLike
from jaxtyping import Array, Float, PyTree, UInt32

from .._compiler.programs import kept_jit
from .._foundation import checks
from .._foundation.fields import Checked
from .._foundation.types import AnyArray, BoolScalar, FloatArray, FloatScalar, IntArray, KeyData, Scalar, Word
from .._numerics.derivatives import NotKnown
from .._numerics.elementary import key_data_of, random_words, uniform
from .motion import Motion

# Intervals that a user's law gives: impossible ones are marked, equal neighbours joined.
#
# An impossible interval (a negative duration, a number that is not finite) gets the duration NaN, from which the
# engines make ``Status.BASE_INVALID``.


Each: TypeAlias = Float[Array, " intervals"]


def marked(duration: FloatArray, *numbers: FloatArray) -> FloatArray:
    """`duration`, NaN where it is negative or where an interval that lasts has a number that is not finite."""
    finite = jnp.ones((), bool)
    for number in numbers:
        finite = finite & jnp.isfinite(number)
    return jnp.where((duration == 0) | ((duration > 0) & finite), duration, jnp.nan)


def joined(durations: Each, velocities: Each) -> tuple[Each, Each]:
    """Durations and velocities of intervals (intervals,): neighbours of equal velocity are one, impossible ones are
    `marked`, and after the first of duration 0 there are none.
    """
    number = len(durations)
    durations = jnp.where(jnp.cumsum(durations == 0) > 0, 0, marked(durations, velocities))
    if number == 1:
        return durations, velocities
    begins = jnp.concatenate([jnp.ones(1, bool), velocities[1:] != velocities[:-1]])
    joint = jnp.cumsum(begins) - 1
    first = jnp.minimum(jnp.searchsorted(joint, jnp.arange(number)), number - 1)
    return jax.ops.segment_sum(durations, joint, number, indices_are_sorted=True), velocities[first]


def check_drawn(law: object, method: str, unit: str, durations: Each, *numbers: Each) -> None:
    """Check segments (segments,) that the `method` of a user's `law` gave. Raises ValueError that names the first
    impossible one; traced ones pass, and show in the status of a simulation.
    """
    if any(checks.is_traced(array) for array in (durations, *numbers)):
        return
    wrong = np.flatnonzero(np.isnan(np.asarray(marked(durations, *numbers))))
    if len(wrong):
        here = ", ".join(f"{float(array[wrong[0]]):g}" for array in numbers)
        raise ValueError(
            f"Method {method} of {type(law).__name__} must give durations above 0 (0: there is no further one) and "
            f"finite numbers, but number {wrong[0]} lasts {float(durations[wrong[0]]):g} s at {here} {unit}."
        )


# Piecewise-linear functions of time: base velocities, ground accelerations and forces, segment by segment.
#
# A law computes segment number i from the key, i, and a memory of the segments before. So a realisation has no fixed
# length, and an ensemble can draw segments while it simulates.


LARGEST_CAPACITY = 2**31
"""Segments of one realisation are numbered in 32 bits."""
BEGINNING = np.uint32(0xFFFFFFFF)
"""Number of the random words that the beginning of a realisation is drawn from."""
_MOST_DOUBLINGS = 6  # of the number of segments, before a realisation is left too short


PerSegment: TypeAlias = Float[Array, " segments"]


Drawn: TypeAlias = tuple[PerSegment, PerSegment, PerSegment]
"""Durations (s), values at the beginnings and slopes of segments."""


class Segment(NamedTuple):
    """One linear segment: ``value + slope (t - begin)`` for t from `begin` to `end` (s)."""

    begin: FloatArray
    end: FloatArray
    value: FloatArray
    slope: FloatArray


DrawnSegment: TypeAlias = tuple[FloatScalar, FloatScalar, FloatScalar, PyTree]
"""Duration (s), value at its beginning and slope (value per s) of a segment, and the memory for the next."""


class SegmentState(NamedTuple):
    """The present segment of one realisation, and what the next follows from; `spent` after the last one."""

    key_data: tuple[Word, Word]
    number: Word
    memory: PyTree
    segment: Segment
    spent: BoolScalar


class SegmentLaw(Checked, Motion):
    """Base class of the laws of piecewise-linear base velocity. Subclass it to write one of your own.

    Segment number i is computed from the key, i, and a memory of the segments before it: so a realisation has no fixed
    length, and an ensemble draws segments while it simulates. Write `segments`, `begin`, `draw` and `next_segment` in
    JAX; `sample` follows. For example a base that accelerates and brakes, to a new speed every few seconds::

        class Ramps(ss.SegmentLaw):
            speed: Annotated[float, ss.Quantity("m/s", above=0)]
            rate: Annotated[float, ss.Quantity("1/s", above=0)]
            is_random = True
            jumps = False

            def segments(self, t1):
                mean = self.rate * t1
                return math.ceil(mean + 6 * math.sqrt(mean) + 12)

            def begin(self, key_data, dtype):
                return jnp.zeros((), dtype)  # the base starts at rest

            def draw(self, key_data, number, dtype):
                u, v = self.uniforms(key_data, number, dtype)
                return ss.Exponential(1 / self.rate).icdf(u), ss.Uniform(-self.speed, self.speed).icdf(v)

            def next_segment(self, memory, drawn, dtype):
                duration, velocity = drawn
                return duration, memory, (velocity - memory) / duration, velocity

        law = Ramps(speed=1.0, rate=0.5)
        ss.simulate_ensemble(system, law, t1=100.0, samples=1000, key=jax.random.key(0))
        ss.simulate(system, law.sample(jax.random.key(0), 100.0), t1=100.0)

    For piecewise-constant velocity subclass `PiecewiseConstantLaw`, which is simulated in closed form, for ground
    accelerations `GroundMotion`.

    Attributes:
        is_random: Whether realisations differ.
        jumps: Whether the velocity (m/s) jumps between segments: a stick on a base whose velocity jumps ends there.
    """

    part_of_excitation = "base"
    jumps: ClassVar[bool]
    is_record: ClassVar[bool] = False  # a list of segments that ends with the motion

    @abc.abstractmethod
    def segments(self, t1: Scalar) -> int:
        """The number of segments that nearly every realisation on ``[0, t1]`` needs at most; `t1` (s) is not traced."""

    def begin(self, key_data: KeyData, dtype: DTypeLike) -> PyTree:
        """The memory before the first segment, drawn by the key data: an array or a tuple of arrays. Default: none."""
        return ()

    @abc.abstractmethod
    def draw(self, key_data: KeyData, number: Word, dtype: DTypeLike) -> PyTree:
        """What is random (or looked up) about segment `number`, from the key data and that number alone."""

    @abc.abstractmethod
    def next_segment(self, memory: PyTree, drawn: PyTree, dtype: DTypeLike) -> DrawnSegment:
        """Duration (s), value at its beginning and slope (value per s) of a segment, and the memory for the next.

        A duration of 0 means that there is no further segment. A negative duration, or a value or slope that is not
        finite, ends the sample with ``Status.BASE_INVALID``.
        """

    def all_segments(self, memory: PyTree, drawn: PyTree, number: int, dtype: DTypeLike) -> Drawn:
        """Durations, values and slopes of the first segments, from the memory before them and what `draw` returned for
        each, along a first axis; zeros after the last.
        """

        def step(carry, drawn_here):
            memory, spent = carry
            duration, value, slope, memory = self.next_segment(memory, drawn_here, dtype)
            spent = spent | (duration == 0)
            duration, value, slope = (jnp.where(spent, 0, jnp.asarray(x, dtype)) for x in (duration, value, slope))
            return (memory, spent), (duration, value, slope)

        return lax.scan(step, (memory, jnp.zeros((), bool)), drawn, length=number)[1]

    @staticmethod
    def uniforms(key_data: KeyData, number: Word | None, dtype: DTypeLike) -> tuple[FloatScalar, FloatScalar]:
        """Two independent random numbers, uniform on (0, 1), for segment `number`; None: for `begin`.

        A `RandomNumber` makes others of them: ``ss.Weibull(2.0, 1.5).icdf(u)``. To draw more than two, or by other
        functions, make a key: ``jax.random.fold_in(jax.random.wrap_key_data(jnp.stack(key_data)), number)``.
        """
        high, low = random_words(key_data, jnp.asarray(BEGINNING if number is None else number))
        return uniform(high, dtype), uniform(low, dtype)

    def sample(self, key: Array | None, t1: Scalar, *, capacity: int | None = None) -> "Motion":
        """One realisation that covers ``[0, t1]``, for `simulate`; a law without randomness is its own.

        Args:
            key: A key from ``jax.random.key(seed)``; None for a law without randomness.
            t1: Duration to cover, s.
            capacity: Number of segments of the realisation. By default enough for it, or under ``vmap`` over keys what
                `segments` says; where that is too few, `simulate` reports ``Status.BASE_TOO_SHORT``. It must be given
                under ``jit`` or ``grad`` when `t1` or the law's parameters are traced.

        Returns:
            `VelocitySegments`.

        Raises:
            ValueError: For a missing or unsuitable key, a `t1` that is not positive, a capacity below 1, and impossible
                segments of a law of your own.
        """
        checks.positive("t1", t1, "s")
        if not self.is_random:
            return self
        key_data, dtype = self.key_data(key), jnp.result_type(float)
        advice = f"find one with {type(self).__name__}(...).segments(t1)"
        known = known_number(self.segments, t1, advice) if capacity is None else capacity
        size = checks.whole_number("capacity", known, maximum=LARGEST_CAPACITY)
        drawn = drawn_segments(self, key_data, size, dtype)
        for _ in range(_MOST_DOUBLINGS if capacity is None else 0):
            # Whether they cover the time, or there are no more, is not known of traced ones. `cumsum` adds them in the
            # order in which a simulation does.
            if checks.is_traced(drawn[0]) or checks.is_traced(t1):
                break
            if not drawn[0][-1] > 0 or float(np.cumsum(np.asarray(drawn[0]))[-1]) >= float(t1):
                break
            size = checks.whole_number("capacity", 2 * size, maximum=LARGEST_CAPACITY)
            drawn = drawn_segments(self, key_data, size, dtype)
        check_drawn(self, "next_segment", "and per s", *drawn)
        return self.realization(*drawn)

    def realization(self, durations: PerSegment, values: PerSegment, slopes: PerSegment) -> "SegmentLaw":
        """The realisation with these segments, arrays (segments,)."""
        return VelocitySegments(durations, values, slopes, self.jumps)

    def key_data(self, key: Array | None) -> UInt32[Array, "2"]:
        """The two 32-bit words of `key`; zeros for a law without randomness. Raises ValueError for a missing key."""
        if not self.is_random:
            return jnp.asarray(np.zeros(2, np.uint32))
        if key is None:
            raise no_key(self)
        return key_data_of(key)


def begins_of(durations: Float[AnyArray, "*batch segments"]) -> Float[Array, "*batch segments"]:
    """Times at which the segments begin that follow one another from t = 0, s."""
    durations = jnp.asarray(durations)
    zero = jnp.zeros_like(durations[..., :1])
    return jnp.concatenate([zero, jnp.cumsum(durations, axis=-1)[..., :-1]], axis=-1)


def index_at(durations: Float[AnyArray, " segments"], t: AnyArray | float) -> IntArray:
    """Which of these segments holds at times `t` (s, any shape); at the instant between two, the second."""
    # Unused segments are moved to infinity, so that the search skips them.
    begins = jnp.where(durations > 0, begins_of(durations), jnp.inf)
    return jnp.clip(jnp.searchsorted(begins, jnp.asarray(t), side="right") - 1, 0)


def looked_up(number: Word, dtype: DTypeLike, durations: AnyArray, *others: AnyArray) -> tuple[FloatScalar, ...]:
    """The duration of segment `number`, 0 after the last, and the `others` of it, of arrays (segments,)."""
    size = np.shape(durations)[-1]
    here = jnp.minimum(number.astype(jnp.int32), size - 1)
    duration, *rest = (jnp.asarray(array, dtype)[here] for array in (durations, *others))
    return jnp.where(number < size, duration, 0), *rest


class GivenSegments(SegmentLaw):
    """Base class of realisations in segments, ``values[i] + slopes[i] (t - times[i])`` for ``durations[i]`` (s).

    Arrays (segments,); the segments follow one another from t = 0, unused ones at the end have duration 0. `may_jump`:
    whether the value jumps between them.
    """

    durations: Float[AnyArray, " segments"] = eqx.field(converter=partial(checks.jax_array, "durations"))
    values: Float[AnyArray, " segments"] = eqx.field(converter=partial(checks.jax_array, "values"))
    slopes: Float[AnyArray, " segments"] = eqx.field(converter=partial(checks.jax_array, "slopes"))
    may_jump: bool = eqx.field(static=True, default=True)
    is_record = True
    only_with: ClassVar = {"value": ("draw", "next_segment")}

    @property
    def jumps(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - that of the law it is drawn from
        """Whether the value jumps between segments."""
        return self.may_jump

    def check_relations(self) -> None:
        arrays = {name: getattr(self, name) for name in ("durations", "values", "slopes")}
        if len({np.shape(array) for array in arrays.values()}) > 1 or np.ndim(self.durations) == 0:
            raise ValueError(
                "Arguments durations, values and slopes must have the same shape (segments,), but they have shapes "
                f"{', '.join(str(np.shape(array)) for array in arrays.values())}."
            )
        if any(checks.is_traced(array) for array in arrays.values()):
            return
        used = np.asarray(self.durations) != 0
        if not np.all(np.asarray(self.durations) >= 0):
            raise checks.refused("durations", "be zero or positive (in s)", self.durations)
        for name in ("values", "slopes"):
            checks.bounded(name, np.asarray(arrays[name])[used], ndim=1)

    @property
    def times(self) -> PerSegment:
        """Times at which the segments begin, s, (segments,)."""
        return begins_of(self.durations)

    def value(self, t: AnyArray | float) -> FloatArray:
        """The value at times `t` (s, any shape); at a jump, the one after it. One realisation only."""
        here = index_at(self.durations, t)
        return jnp.asarray(self.values)[here] + jnp.asarray(self.slopes)[here] * (t - self.times[here])

    def segments(self, t1) -> int:
        return np.shape(self.durations)[-1]

    def draw(self, key_data, number, dtype):
        return looked_up(number, dtype, self.durations, self.values, self.slopes)

    def next_segment(self, memory, drawn, dtype):
        return *drawn, ()


class VelocitySegments(GivenSegments):
    """One realisation of a piecewise-linear base velocity, ``values[i] + slopes[i] (t - times[i])``.

    The segments follow one another from t = 0; unused ones at the end have duration 0. The ``sample`` method of a
    `SegmentLaw` makes them; for a record of your own use `Recorded`.

    Args:
        durations: s, (segments,).
        values: At the beginning of each segment, m/s, (segments,).
        slopes: m/s^2, (segments,).
        may_jump: Whether the velocity jumps between segments, which ends a stick.

    Raises:
        ValueError: For arrays of different shapes, negative durations, and numbers that are not finite.
    """


def first_segment(law: SegmentLaw, key_data: KeyData, dtype: DTypeLike) -> SegmentState:
    """The first segment of the realisation that `key_data` draw."""
    zero = jnp.zeros((), dtype)
    memory = law.begin(key_data, dtype)
    words, none, before = (key_data[0], key_data[1]), jnp.zeros((), jnp.uint32), Segment(zero, zero, zero, zero)
    segment_state = SegmentState(words, none, memory, before, jnp.zeros((), bool))
    return following_segment(law, segment_state, dtype)


def following_segment(law: SegmentLaw, segment_state: SegmentState, dtype: DTypeLike) -> SegmentState:
    """The segment after the present one."""
    drawn = law.draw(segment_state.key_data, segment_state.number, dtype)
    duration, value, slope, memory = law.next_segment(segment_state.memory, drawn, dtype)
    value, slope = (jnp.asarray(number, dtype) for number in (value, slope))
    segment = Segment(segment_state.segment.end, segment_state.segment.end + duration, value, slope)
    spent = ~((duration > 0) & jnp.isfinite(value) & jnp.isfinite(slope))
    return SegmentState(segment_state.key_data, segment_state.number + np.uint32(1), memory, segment, spent)


def segment_at(law: SegmentLaw, first: SegmentState, t: FloatArray) -> SegmentState:
    """The segment that holds at the time `t` (s), from the `first` one; at the instant between two, the second."""
    return lax.while_loop(
        lambda state: (state.segment.end <= t) & ~state.spent,
        lambda state: following_segment(law, state, t.dtype),
        first,
    )


def is_invalid(segment_state: SegmentState) -> BoolScalar:
    """Whether the present segment ended the realisation because it is impossible, and not because its duration is 0."""
    return segment_state.spent & (segment_state.segment.end != segment_state.segment.begin)


def added(t: FloatArray, segments: tuple[Segment, ...]) -> tuple[FloatArray, FloatArray]:
    """Value at `t` and slope of the sum of `segments`."""
    value, slope = jnp.zeros_like(t), jnp.zeros_like(t)
    for segment in segments:
        value, slope = value + segment.value + segment.slope * (t - segment.begin), slope + segment.slope
    return value, slope


def no_key(law: object) -> ValueError:
    """The error that says that a random law needs a key."""
    name = type(law).__name__
    return ValueError(
        f"Argument key must be a key such as jax.random.key(0) for the random law {name}, but None was given."
    )


def known_number(
    number: Callable[[Scalar], int], t1: Scalar, advice: str, name: str = "capacity", of: str = "law's parameters are"
) -> int:
    """The `number` of segments or points until `t1`. Raises ValueError, with `advice`, for traced numbers."""
    try:
        return number(t1)
    except (ConcretizationTypeError, NotKnown):
        raise ValueError(
            f"Argument {name} must be given when t1 or the {of} traced by a JAX transformation (their values are not "
            f"known then); {advice}."
        ) from None


@kept_jit(static_argnames=("number", "dtype"))
def drawn_segments(law: SegmentLaw, key_data: Array, number: int, dtype: DTypeLike) -> Drawn:
    """Durations, values and slopes of the first segments of the realisation that `key_data` draw."""
    words = (key_data[0], key_data[1])
    drawn = jax.vmap(lambda number: law.draw(words, number, dtype))(jnp.arange(number, dtype=jnp.uint32))
    return law.all_segments(law.begin(words, dtype), drawn, number, dtype)


def drawn_sign(first_sign: str, key_data: KeyData, dtype: DTypeLike) -> FloatScalar:
    """1 or -1: the `first_sign`, "positive" or "negative", or a random one drawn by `key_data`."""
    if first_sign != "random":
        return jnp.asarray(1 if first_sign == "positive" else -1, dtype)
    high, _ = random_words(key_data, jnp.asarray(BEGINNING))
    return jnp.where(high < np.uint32(1 << 31), 1, -1).astype(dtype)


# The segments of one realisation in arrays, for look-up by time.


class SegmentTable(eqx.Module):
    """Segments in order of time, arrays (segments,); unused ones begin at infinity.

    Attributes:
        segments: In order of time.
        end: Where the last one ends, s.
        is_invalid: Whether an impossible one follows there.
        jumps: Whether the value jumps between segments.
    """

    segments: Segment
    end: Array
    is_invalid: Array
    jumps: bool = eqx.field(static=True)

    @classmethod
    def of(cls, law: SegmentLaw, key_data: KeyData, number: int, dtype) -> "SegmentTable":
        """The first `number` segments of the realisation that `key_data` draw."""

        def step(segment_state, _):
            segment = segment_state.segment._replace(
                begin=jnp.where(segment_state.spent, jnp.inf, segment_state.segment.begin)
            )
            following = following_segment(law, segment_state, dtype)
            # After the last segment, whatever the law may give.
            following = jax.tree.map(partial(jnp.where, segment_state.spent), segment_state, following)
            return following, segment

        after, segments = lax.scan(step, first_segment(law, key_data, dtype), None, length=number)
        return cls(segments, after.segment.begin, is_invalid(after), law.jumps)

    def at(self, t: FloatArray) -> Segment:
        """The segment at time `t` (s); at the instant between two, the second."""
        index = jnp.clip(jnp.searchsorted(self.segments.begin, t, side="right") - 1, 0)
        return jax.tree.map(lambda values: values[index], self.segments)
