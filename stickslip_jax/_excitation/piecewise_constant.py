"""Piecewise-constant base velocities: the base class of their laws, and realisations.

A law gives the intervals of a realisation one after the other: `draw` computes what is random about interval i from the
key and i alone, and `next_interval` makes its duration and velocity of that. So a realisation has no fixed length:
a larger capacity only continues it, and an ensemble can draw intervals while it simulates.
"""

import abc
from functools import partial
from typing import ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Float, PyTree

from .. import _checks
from .._fields import is_of_package
from .._types import AnyArray, FloatArray, FloatScalar, Scalar
from .interval_checks import Each, check_drawn, joined
from .motion import Motion, Parts
from .segments import LARGEST_CAPACITY, SegmentLaw, begins_of, index_at, known_number


def _as_jax(name: str, values: PyTree) -> PyTree:
    return _checks.jax_array(name, values) if isinstance(values, (np.ndarray, jax.Array)) else values


class VelocitySteps(Motion):
    """One realisation of a piecewise-constant base velocity: ``velocities[i]`` (m/s) for ``durations[i]`` (s).

    The intervals follow one another from t = 0. Neighbouring velocities differ; unused intervals at the end have
    duration 0. The last duration may be infinite. Where JAX traces the numbers, and for many realisations at once,
    equal neighbours are merged, and impossible intervals show in the status of each simulation. The ``sample`` method
    of the laws makes them; for a base motion of your own use `PiecewiseConstant`.

    Args:
        durations: s, (intervals,).
        velocities: m/s, as many.

    Raises:
        ValueError: For arrays of different shapes, negative durations, a duration of 0 before the end, velocities that
            are not finite or equal to their neighbour's.
    """

    durations: Float[Array, "*batch intervals"] = eqx.field(converter=partial(_as_jax, "durations"))
    velocities: Float[Array, "*batch intervals"] = eqx.field(converter=partial(_as_jax, "velocities"))

    part_of_excitation = "base"
    is_piecewise_constant = True
    takes_jumps = False

    def __post_init__(self):
        durations, velocities = self.durations, self.velocities
        if not (isinstance(durations, jax.Array) and isinstance(velocities, jax.Array)):
            return
        if durations.ndim > 0 and durations.shape == velocities.shape and self._are_unchecked():
            join = jnp.vectorize(joined, signature="(n),(n)->(n),(n)")
            self.durations, self.velocities = join(durations, velocities)

    def _are_unchecked(self) -> bool:
        return _checks.is_traced(self.durations) or _checks.is_traced(self.velocities) or self.durations.ndim > 1

    @classmethod
    def of_distinct(cls, durations: Array, velocities: Array) -> "VelocitySteps":
        """Intervals of which is known that neighbours differ: they are taken as they are."""
        made = object.__new__(cls)
        object.__setattr__(made, "durations", durations)
        object.__setattr__(made, "velocities", velocities)
        return made

    def __check_init__(self):
        for name in ("durations", "velocities"):
            value = getattr(self, name)
            if not isinstance(value, jax.Array):
                raise _checks.refused(name, "be an array", value)
        if self.durations.shape != self.velocities.shape or self.durations.ndim == 0:
            raise ValueError(
                "Arguments durations and velocities must have the same shape (intervals,), but they have shapes "
                f"{self.durations.shape} and {self.velocities.shape}."
            )
        if self._are_unchecked():
            return
        durations = np.asarray(self.durations)
        if not np.all(durations >= 0):
            raise _checks.refused("durations", "be zero or positive", durations)
        if np.any((durations[1:] > 0) & (durations[:-1] == 0)):
            raise ValueError(
                "Argument durations must be 0 in unused intervals at the end only, but an interval of duration 0 has "
                f"one after it that lasts: {_checks.show(durations)}; leave it out."
            )
        lasting = np.asarray(self.velocities)[durations > 0]
        _checks.bounded("velocities", lasting, ndim=1)
        if np.any(lasting[1:] == lasting[:-1]):
            raise ValueError(
                "Argument velocities must change from interval to interval, but two neighbours are equal; "
                "use PiecewiseConstant(times, velocities), which merges them."
            )

    def parts(self) -> Parts:
        return Parts(base=(GivenSteps(self),))

    def realized_until(self, t1: Scalar) -> Motion:
        if self.durations.ndim != 1:
            raise ValueError(
                f"Argument base must be one realisation, but it has durations of shape {self.durations.shape}; "
                "use jax.vmap over the realisations, or simulate_ensemble."
            )
        return self

    @property
    def times(self) -> Float[Array, " intervals"]:
        """Times at which the intervals begin, s."""
        return begins_of(self.durations)

    def velocity(self, time: AnyArray | float) -> FloatArray:
        """Base velocity at the given times (any shape), m/s; at a jump, the one after it. One realisation only."""
        return self.velocities[index_at(self.durations, time)]


Interval: TypeAlias = tuple[FloatScalar, FloatScalar, PyTree]
"""Duration (s), velocity (m/s), and the memory for the next interval."""


class PiecewiseConstantLaw(SegmentLaw):
    """Base class of the laws of piecewise-constant base velocity. Subclass it to add one."""

    jumps = True
    is_piecewise_constant = True
    takes_jumps = False
    has_exponential_gaps: ClassVar[bool] = False  # of mean 1 / rate, independent of all else
    rests_on: ClassVar = {
        "all_intervals": ("next_interval",),
        "has_exponential_gaps": ("draw", "next_interval"),
        "repeats_after": ("begin", "draw", "next_interval"),
    }
    only_with: ClassVar = {"next_segment": ("next_interval",)}

    @property
    def gap_rate(self) -> str | None:
        """The name of the number that is the rate of exponential gaps; None where gaps are others."""
        return "rate" if self.has_exponential_gaps else None

    @abc.abstractmethod
    def next_interval(self, memory: PyTree, drawn: PyTree, dtype: DTypeLike) -> Interval:
        """Duration (s) and velocity (m/s) of an interval, and the memory for the next.

        Neighbours of equal velocity count as one interval. A duration of 0 means that there is no further interval. A
        negative duration, or a velocity that is not finite, ends the sample with ``Status.BASE_INVALID``.
        """

    def all_intervals(self, memory: PyTree, drawn: PyTree, number: int, dtype: DTypeLike) -> tuple[Each, Each]:
        """Durations and velocities of the first intervals, one after the other.

        Override it where all can be computed at once, which is faster.

        Args:
            memory: That before the first interval.
            drawn: What `draw` returned for each, along a first axis.
            number: How many intervals.
            dtype: Of the results.

        Returns:
            Durations (s) and velocities (m/s), (number,).
        """

        def step(memory, drawn_here):
            duration, velocity, memory = self.next_interval(memory, drawn_here, dtype)
            return memory, (duration, velocity)

        return lax.scan(step, memory, drawn, length=number)[1]

    def segments(self, t1: Scalar) -> int:
        return self.capacity(t1)

    def next_segment(self, memory: PyTree, drawn: PyTree, dtype: DTypeLike):
        duration, velocity, memory = self.next_interval(memory, drawn, dtype)
        return duration, velocity, jnp.zeros((), dtype), memory

    @abc.abstractmethod
    def capacity(self, t1: Scalar) -> int:
        """The number of intervals that nearly every realisation on ``[0, t1]`` (s) needs at most."""

    def sample(self, key: Array | None, t1: Scalar, *, capacity: int | None = None) -> VelocitySteps:
        """One realisation that covers ``[0, t1]``.

        Args:
            key: A key from ``jax.random.key(seed)``; None for a law without randomness.
            t1: Duration to cover, s.
            capacity: Number of intervals of the realisation. By default enough for nearly all (about one random
                realisation in 10^9 needs more; `simulate` then reports ``Status.BASE_TOO_SHORT``). It must be given
                under ``jit`` or ``grad`` when `t1` or the law's parameters are traced.

        Raises:
            ValueError: For a missing or unsuitable key, a `t1` that is not positive, a capacity below 1, and impossible
                intervals of a law of your own.
        """
        _checks.positive("t1", t1, "s")
        if capacity is None:
            capacity = known_number(self.checked_capacity, t1, f"find one with {type(self).__name__}(...).capacity(t1)")
        capacity = _checks.whole_number("capacity", capacity, maximum=LARGEST_CAPACITY)
        durations, velocities = _sample(self, self.key_data(key), capacity, jnp.result_type(float))
        if not is_of_package(self):
            check_drawn(self, "next_interval", "m/s", durations, velocities)
            durations, velocities = joined(durations, velocities)
        return VelocitySteps.of_distinct(durations, velocities)

    def realized_until(self, t1: Scalar) -> VelocitySteps:
        return self.sample(None, t1)

    def checked_capacity(self, t1: Scalar) -> int:
        """The `capacity`. Raises ValueError for more intervals than 32 bits can number."""
        try:
            capacity = self.capacity(t1)
        except OverflowError:
            capacity = LARGEST_CAPACITY + 1
        if capacity > LARGEST_CAPACITY:
            raise ValueError(
                f"Argument t1 must be shorter: {t1} s hold more than {LARGEST_CAPACITY} intervals of {self!r}."
            )
        return capacity


class GivenSteps(PiecewiseConstantLaw):
    """A realisation of a base velocity that jumps, as a law with this one realisation."""

    steps: VelocitySteps
    is_random = False

    def capacity(self, t1) -> int:
        return self.steps.durations.shape[-1]

    def draw(self, key_data, number, dtype):
        size = self.steps.durations.shape[-1]
        here = jnp.minimum(number.astype(jnp.int32), size - 1)
        duration = jnp.where(number < size, self.steps.durations[here], 0)
        return duration.astype(dtype), self.steps.velocities[here].astype(dtype)

    def next_interval(self, memory, drawn, dtype):
        return *drawn, ()


@partial(jax.jit, static_argnames=("capacity", "dtype"))
def _sample(law: PiecewiseConstantLaw, key_data: Array, capacity: int, dtype: DTypeLike) -> tuple[Each, Each]:
    """Durations and velocities of the first `capacity` intervals."""
    drawn = jax.vmap(lambda number: law.draw(key_data, number, dtype))(jnp.arange(capacity, dtype=jnp.uint32))
    return law.all_intervals(law.begin(key_data, dtype), drawn, capacity, dtype)
