"""Laws of piecewise-constant base velocity: how realisations are drawn.

A law gives the intervals of a realisation one after the other: `draw` computes what is random about interval i from the
key and i alone, and `next_interval` makes its duration and velocity of that. So a realisation has no fixed length:
a larger capacity only continues it, and an ensemble can draw intervals while it simulates.
"""

import abc
import math
from functools import partial
from typing import Annotated, Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.errors import ConcretizationTypeError

from .. import _checks
from .._fields import Choice, Quantity, is_of_package
from .._numerics.known import NotKnown, largest, smallest
from .._numerics.random_bits import exponential, random_words, uniform
from .._types import AnyArray, Array, FloatArray, KeyData, Number, Scalar
from .interval_checks import check_drawn, joined, marked
from .segments import BEGINNING, LARGEST_CAPACITY, SegmentLaw, checked_capacity
from .velocity_steps import VelocitySteps

Interval = tuple[FloatArray, FloatArray, Any]


class PiecewiseConstantLaw(SegmentLaw):
    """Base class of the laws of piecewise-constant base velocity. Subclass it to add one."""

    jumps = True
    has_exponential_gaps: ClassVar[bool] = False  # of mean 1 / rate, independent of all else
    rests_on: ClassVar = {"all_intervals": ("next_interval",), "has_exponential_gaps": ("draw", "next_interval")}
    only_with: ClassVar = {"next_segment": ("next_interval",)}

    @abc.abstractmethod
    def begin(self, key_data: KeyData, dtype) -> Any:
        """The memory before the first interval (for example the first sign), drawn by the key data."""

    @abc.abstractmethod
    def draw(self, key_data: KeyData, number: Array, dtype) -> Any:
        """What is random (or looked up) about interval `number`, from the key data and that number alone."""

    @abc.abstractmethod
    def next_interval(self, memory: Any, drawn: Any, dtype) -> Interval:
        """Duration (s) and velocity (m/s) of an interval, and the memory for the next.

        Neighbours of equal velocity count as one interval. A duration of 0 means that there is no further interval. A
        negative duration, or a velocity that is not finite, ends the sample with ``Status.BASE_INVALID``.
        """

    def all_intervals(self, memory: Any, drawn: Any, number: int, dtype) -> tuple[FloatArray, FloatArray]:
        """Durations (s) and velocities (m/s) of the first `number` intervals, (number,), one after the other.

        `memory`: that before the first. `drawn`: what `draw` returned for each, along a first axis. Override it where
        all can be computed at once, which is faster.
        """

        def step(memory, drawn_here):
            duration, velocity, memory = self.next_interval(memory, drawn_here, dtype)
            return memory, (duration, velocity)

        return lax.scan(step, memory, drawn, length=number)[1]

    def segments(self, t1: Scalar) -> int:
        return self.capacity(t1)

    def next_segment(self, memory: Any, drawn: Any, dtype):
        duration, velocity, memory = self.next_interval(memory, drawn, dtype)
        return duration, velocity, jnp.zeros((), dtype), memory

    @abc.abstractmethod
    def capacity(self, t1: Scalar) -> int:
        """The number of intervals that nearly every realisation on ``[0, t1]`` (s) needs at most."""

    def sample(self, key: Array | None, t1: Scalar, *, capacity: int | None = None) -> VelocitySteps:
        """One realisation that covers ``[0, t1]``.

        - `key`: a key from ``jax.random.key(seed)``; None for a law without randomness.
        - `t1`: duration to cover, s.
        - `capacity`: number of intervals of the realisation. By default enough for nearly all (about one random
          realisation in 10^9 needs more; `simulate` then reports ``Status.BASE_TOO_SHORT``). It must be given under
          ``jit`` or ``grad`` when `t1` or the law's parameters are traced.

        Raises ValueError for a missing or unsuitable key, a `t1` that is not positive, a capacity below 1, and
        intervals of a law of your own that cannot be.
        """
        _checks.positive("t1", t1, "s")
        if capacity is None:
            capacity = self._capacity_or_explain(t1)
        checked_capacity(capacity)
        durations, velocities = _sample(self, self.key_data(key), capacity, jnp.result_type(float))
        if not is_of_package(self):
            check_drawn(self, "next_interval", "m/s", durations, velocities)
            durations, velocities = joined(durations, velocities)
        return VelocitySteps(durations, velocities)

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

    def _capacity_or_explain(self, t1: Scalar) -> int:
        try:
            return self.checked_capacity(t1)
        except (ConcretizationTypeError, NotKnown):
            raise ValueError(
                "Argument capacity must be given when t1 or the law's parameters are traced by a JAX transformation "
                f"(their values are not known then); find one with {type(self).__name__}(...).capacity(t1)."
            ) from None


class Constant(PiecewiseConstantLaw):
    """A base that moves with constant velocity.

    `speed`: the velocity, m/s, of either sign; 0 for a base at rest. Raises ValueError if it is not finite.
    """

    speed: Annotated[Number, Quantity("m/s", "signed")]
    is_random = False

    def begin(self, key_data, dtype):
        return ()

    def draw(self, key_data, number, dtype):
        return number == 0

    def next_interval(self, memory, drawn, dtype) -> Interval:
        return jnp.where(drawn, jnp.inf, 0.0).astype(dtype), jnp.asarray(self.speed, dtype), ()

    def capacity(self, t1: Scalar) -> int:
        return 1


class SquareWave(PiecewiseConstantLaw):
    """A square wave: ``-speed`` in the first half of each period, ``+speed`` in the second.

    - `speed`: m/s, positive. `period`: s, positive. The frequency ratio r of the papers gives
      ``period = 2 pi / (r * omega)``.

    Raises ValueError if a number is not positive and finite. Source: Lima and Sampaio, conference paper, eq. 4.
    """

    speed: Annotated[Number, Quantity("m/s", above=0)]
    period: Annotated[Number, Quantity("s", above=0)]
    is_random = False

    def begin(self, key_data, dtype):
        return -jnp.ones((), dtype)

    def draw(self, key_data, number, dtype):
        return ()

    def next_interval(self, memory, drawn, dtype) -> Interval:
        return jnp.asarray(self.period / 2, dtype), memory * self.speed, -memory

    def capacity(self, t1: Scalar) -> int:
        return math.ceil(2 * largest(t1) / smallest(self.period)) + 1


class PoissonSwitching(PiecewiseConstantLaw):
    """``+speed`` or ``-speed``, the sign changing at the points of a Poisson process (Lima and Sampaio 2017).

    - `speed`: m/s, positive. `rate`: the mean number of sign changes per second, 1/s, positive.
    - `first_sign`: "random" (a fair coin, the default), "positive" or "negative".

    The durations are independent exponential variables of mean ``1 / rate``; for a fixed key they scale by that mean.
    Raises ValueError for numbers that are not positive and finite and for another `first_sign`.
    """

    speed: Annotated[Number, Quantity("m/s", above=0)]
    rate: Annotated[Number, Quantity("1/s", "mean number of switches per second", above=0)]
    first_sign: Annotated[
        str, Choice(("random", "positive", "negative"), "of the velocity: random, positive or negative")
    ] = eqx.field(static=True, default="random")
    is_random = True
    has_exponential_gaps = True

    def begin(self, key_data, dtype):
        if self.first_sign != "random":
            return jnp.asarray(1 if self.first_sign == "positive" else -1, dtype)
        high, _ = random_words(key_data, jnp.asarray(BEGINNING))
        return jnp.where(high < np.uint32(1 << 31), 1, -1).astype(dtype)

    def draw(self, key_data, number, dtype):
        return exponential(*random_words(key_data, number), dtype)

    def next_interval(self, memory, drawn, dtype) -> Interval:
        return drawn * (1 / self.rate), memory * self.speed, -memory

    def all_intervals(self, memory, drawn, number, dtype):
        signs = memory * jnp.where(jnp.arange(number) % 2 == 0, 1, -1).astype(dtype)
        return drawn * (1 / self.rate), signs * self.speed

    def capacity(self, t1: Scalar) -> int:
        # Six standard deviations above the Poisson mean; the last term covers the skewness of small means.
        mean = largest(self.rate) * largest(t1)
        return math.ceil(mean + 6 * math.sqrt(mean) + 12)


class RandomSteps(PiecewiseConstantLaw):
    """A new velocity every `interval` seconds, each drawn independently from a finite set (conference paper, s. 4).

    - `speed`: m/s, positive. `interval`: s, positive (the papers' ``1 / f_b``).
    - `levels`: at least two different numbers; the velocities are ``speed * levels``. By default -1 and +1.
    - `probabilities`: those of the levels, each at least 1e-6, with sum 1. By default equal.

    Equal velocities in a row are drawn as one long interval: its number of steps is geometric, and the next level has
    the probabilities of the others. Raises ValueError for numbers outside these bounds.
    """

    speed: Annotated[Number, Quantity("m/s", above=0)]
    interval: Annotated[Number, Quantity("s", "time between draws of the velocity", above=0)]
    levels: Annotated[tuple[float, ...], Quantity(meaning="the velocities are speed times these", ndim=1)] = eqx.field(
        static=True, default=(-1.0, 1.0), converter=lambda v: _floats("levels", v)
    )
    probabilities: Annotated[tuple[float, ...] | None, Quantity(meaning="of the levels; not given: equal", ndim=1)] = (
        eqx.field(static=True, default=None, converter=lambda v: None if v is None else _floats("probabilities", v))
    )
    is_random = True

    def check_relations(self) -> None:
        if len(self.levels) < 2 or len(set(self.levels)) < len(self.levels):
            raise ValueError(f"Argument levels must hold two or more different numbers, but {self.levels} was given.")
        shares = self.level_probabilities
        if len(shares) != len(self.levels) or min(shares) < 1e-6 or abs(sum(shares) - 1) > 1e-9:
            raise ValueError(
                f"Argument probabilities must hold one number of at least 1e-6 for each of the {len(self.levels)} "
                f"levels, summing to 1, but {self.probabilities} was given."
            )

    @property
    def level_probabilities(self) -> tuple[float, ...]:
        """Probabilities of the levels, also where `probabilities` is None."""
        return (1 / len(self.levels),) * len(self.levels) if self.probabilities is None else self.probabilities

    def begin(self, key_data, dtype):
        high, _ = random_words(key_data, jnp.asarray(BEGINNING))
        return _choose(uniform(high, dtype), jnp.cumsum(jnp.asarray(self.level_probabilities, dtype)))

    def draw(self, key_data, number, dtype):
        high, low = random_words(key_data, number)
        return uniform(high, dtype), uniform(low, dtype)

    def next_interval(self, memory, drawn, dtype) -> Interval:
        shares = jnp.asarray(self.level_probabilities, dtype)
        # Row i: the probabilities of the next level when the present one, i, is excluded.
        others = jnp.where(jnp.eye(len(self.levels), dtype=bool), 0, shares[None, :] / (1 - shares[:, None]))
        for_length, for_next = drawn
        steps = jnp.floor(jnp.log(for_length) / jnp.log(shares)[memory]) + 1
        velocity = self.speed * jnp.asarray(self.levels, dtype)[memory]
        return steps * self.interval, velocity, _choose(for_next, jnp.cumsum(others, axis=1)[memory])

    def capacity(self, t1: Scalar) -> int:
        return math.ceil(largest(t1) / smallest(self.interval)) + 1


class PiecewiseConstant(PiecewiseConstantLaw):
    """A given base motion: ``velocities[i]`` from ``times[i]`` until ``times[i + 1]``; the last one lasts for ever.

    - `times`: s, increasing, the first one 0, (intervals,).
    - `velocities`: m/s, as many. Equal neighbours are merged.

    Raises ValueError for times that do not increase from 0, different lengths, or numbers that are not finite.
    """

    times: Annotated[AnyArray, Quantity("s", "start of each interval; the first is 0", ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "times")
    )
    velocities: Annotated[AnyArray, Quantity("m/s", "during each interval", ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "velocities")
    )
    is_random = False

    def check_relations(self) -> None:
        if np.shape(self.times) != np.shape(self.velocities) or len(self.times) == 0:
            raise ValueError(
                "Arguments times and velocities must have the same length of at least 1, but they have shapes "
                f"{np.shape(self.times)} and {np.shape(self.velocities)}."
            )
        _checks.increasing_from_zero("times", self.times)

    def begin(self, key_data, dtype):
        return ()

    def draw(self, key_data, number, dtype):
        times, velocities = jnp.asarray(self.times, dtype), jnp.asarray(self.velocities, dtype)
        # Neighbours of equal velocity are one interval: interval i begins at the i-th change of velocity.
        found = jnp.cumsum(jnp.concatenate([jnp.ones(1, bool), velocities[1:] != velocities[:-1]]))
        begin, end = (jnp.searchsorted(found, (number + np.uint32(later)).astype(found.dtype)) for later in (1, 2))
        last = len(times) - 1
        until = jnp.where(end > last, jnp.inf, times[jnp.minimum(end, last)])
        begin = jnp.minimum(begin, last)
        # Numbers that JAX traced when they were given were not checked.
        duration = until - times[begin]
        duration = jnp.where((duration > 0) & (times[0] == 0), marked(duration, velocities[begin]), jnp.nan)
        return jnp.where(number.astype(found.dtype) < found[-1], duration, 0), velocities[begin]

    def next_interval(self, memory, drawn, dtype) -> Interval:
        return *drawn, ()

    def capacity(self, t1: Scalar) -> int:
        return len(self.times)


@partial(jax.jit, static_argnames=("capacity", "dtype"))
def _sample(law: PiecewiseConstantLaw, key_data: Array, capacity: int, dtype) -> tuple[FloatArray, FloatArray]:
    """Durations and velocities of the first `capacity` intervals."""
    drawn = jax.vmap(lambda number: law.draw(key_data, number, dtype))(jnp.arange(capacity, dtype=jnp.uint32))
    return law.all_intervals(law.begin(key_data, dtype), drawn, capacity, dtype)


def _choose(draw: Array, cumulative: Array) -> Array:
    """Index of the cell of the ``cumulative`` probabilities that holds the uniform ``draw``."""
    return jnp.minimum(jnp.sum(draw > cumulative, axis=-1), cumulative.shape[-1] - 1)


def _floats(name: str, values: Any) -> tuple[float, ...]:
    _checks.numeric(name, values, ndim=1)
    return tuple(float(value) for value in values)
