"""Piecewise-constant base velocities: the base class of their laws, the laws, and realisations."""

import abc
import math
from collections.abc import Iterable
from functools import partial
from typing import Annotated, ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Float, PyTree

from .._foundation import checks
from .._foundation.fields import Choice, Quantity, is_distribution, is_of_package, keeps
from .._foundation.types import AnyArray, FloatArray, FloatScalar, Number, Scalar
from .._numerics.derivatives import largest, smallest
from .._numerics.elementary import exponential, fine_uniform, random_words
from .._uncertainty.families import Discrete, RandomNumber, Truncated
from .segments import (
    BEGINNING,
    LARGEST_CAPACITY,
    Drawn,
    Each,
    SegmentLaw,
    begins_of,
    check_drawn,
    drawn_segments,
    drawn_sign,
    index_at,
    joined,
    known_number,
    looked_up,
    marked,
)

# Piecewise-constant base velocities: the base class of their laws, and realisations.
#
# A law gives the intervals of a realisation one after the other: `draw` computes what is random about interval i from
# the key and i alone, and `next_interval` makes its duration and velocity of that. So a realisation has no fixed
# length: a larger capacity only continues it, and an ensemble can draw intervals while it simulates.


Interval: TypeAlias = tuple[FloatScalar, FloatScalar, PyTree]
"""Duration (s), velocity (m/s), and the memory for the next interval."""


class PiecewiseConstantLaw(SegmentLaw):
    """Base class of the laws of piecewise-constant base velocity. Subclass it to add one."""

    jumps = True
    takes_jumps = False
    has_exponential_gaps: ClassVar[bool] = False  # of mean 1 / rate, independent of all else
    is_never_at_rest: ClassVar[bool] = False  # known to be so
    rests_on: ClassVar = {
        "all_intervals": ("next_interval",),
        "has_exponential_gaps": ("draw", "next_interval"),
        "is_never_at_rest": ("begin", "next_interval"),
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

    def all_segments(self, memory: PyTree, drawn: PyTree, number: int, dtype: DTypeLike) -> Drawn:
        durations, velocities = self.all_intervals(memory, drawn, number, dtype)
        return durations, velocities, jnp.zeros_like(velocities)

    def segments(self, t1: Scalar) -> int:
        return self.capacity(t1)

    def next_segment(self, memory: PyTree, drawn: PyTree, dtype: DTypeLike):
        duration, velocity, memory = self.next_interval(memory, drawn, dtype)
        return duration, velocity, jnp.zeros((), dtype), memory

    @abc.abstractmethod
    def capacity(self, t1: Scalar) -> int:
        """The number of intervals that nearly every realisation on ``[0, t1]`` (s) needs at most."""

    def sample(self, key: Array | None, t1: Scalar, *, capacity: int | None = None) -> "VelocitySteps":
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
        checks.positive("t1", t1, "s")
        if capacity is None:
            capacity = known_number(self.checked_capacity, t1, f"find one with {type(self).__name__}(...).capacity(t1)")
        capacity = checks.whole_number("capacity", capacity, maximum=LARGEST_CAPACITY)
        durations, velocities, _ = drawn_segments(self, self.key_data(key), capacity, jnp.result_type(float))
        if not is_of_package(self):
            check_drawn(self, "next_interval", "m/s", durations, velocities)
            durations, velocities = joined(durations, velocities)
        return VelocitySteps.of_distinct(durations, velocities)

    def realized_until(self, t1: Scalar) -> "VelocitySteps":
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


def _as_array(name: str, values: object) -> Array:
    if not isinstance(values, (np.ndarray, jax.Array)):
        raise checks.refused(name, "be an array", values)
    return checks.jax_array(name, values)


class VelocitySteps(PiecewiseConstantLaw):
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

    durations: Float[Array, "*batch intervals"] = eqx.field(converter=partial(_as_array, "durations"))
    velocities: Float[Array, "*batch intervals"] = eqx.field(converter=partial(_as_array, "velocities"))

    def __post_init__(self):
        durations, velocities = self.durations, self.velocities
        if not (isinstance(durations, jax.Array) and isinstance(velocities, jax.Array)):
            return
        if durations.ndim > 0 and durations.shape == velocities.shape and self._is_unchecked:
            join = jnp.vectorize(joined, signature="(n),(n)->(n),(n)")
            self.durations, self.velocities = join(durations, velocities)

    @property
    def _is_unchecked(self) -> bool:
        return checks.is_traced(self.durations) or checks.is_traced(self.velocities) or self.durations.ndim > 1

    @classmethod
    def of_distinct(cls, durations: Array, velocities: Array) -> "VelocitySteps":
        """Intervals of which is known that neighbours differ: they are taken as they are."""
        made = object.__new__(cls)
        object.__setattr__(made, "durations", durations)
        object.__setattr__(made, "velocities", velocities)
        return made

    def check_relations(self) -> None:
        if self.durations.shape != self.velocities.shape or self.durations.ndim == 0:
            raise ValueError(
                "Arguments durations and velocities must have the same shape (intervals,), but they have shapes "
                f"{self.durations.shape} and {self.velocities.shape}."
            )
        if self._is_unchecked:
            return
        durations = np.asarray(self.durations)
        if not np.all(durations >= 0):
            raise checks.refused("durations", "be zero or positive", durations)
        if np.any((durations[1:] > 0) & (durations[:-1] == 0)):
            raise ValueError(
                "Argument durations must be 0 in unused intervals at the end only, but an interval of duration 0 has "
                f"one after it that lasts: {checks.show(durations)}; leave it out."
            )
        lasting = np.asarray(self.velocities)[durations > 0]
        checks.bounded("velocities", lasting, ndim=1)
        if np.any(lasting[1:] == lasting[:-1]):
            raise ValueError(
                "Argument velocities must change from interval to interval, but two neighbours are equal; "
                "use PiecewiseConstant(times, velocities), which merges them."
            )

    def capacity(self, t1) -> int:
        return self.durations.shape[-1]

    def draw(self, key_data, number, dtype):
        return looked_up(number, dtype, self.durations, self.velocities)

    def next_interval(self, memory, drawn, dtype):
        return *drawn, ()

    def realized_until(self, t1: Scalar) -> "VelocitySteps":
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


# Laws of piecewise-constant base velocity.


PerInterval: TypeAlias = Float[AnyArray, " intervals"]


class Constant(PiecewiseConstantLaw):
    """A base that moves with constant velocity.

    Args:
        speed: The velocity, m/s, of either sign; 0 for a base at rest.

    Raises:
        ValueError: If it is not finite.
    """

    speed: Annotated[Number, Quantity("m/s", "signed")]

    def draw(self, key_data, number, dtype):
        return number == 0

    def next_interval(self, memory, drawn, dtype) -> Interval:
        return jnp.where(drawn, jnp.inf, 0.0).astype(dtype), jnp.asarray(self.speed, dtype), ()

    def capacity(self, t1: Scalar) -> int:
        return 1

    @property
    def repeats_after(self) -> Number:
        return 0.0


class SquareWave(PiecewiseConstantLaw):
    """A square wave: ``-speed`` in the first half of each period, ``+speed`` in the second.

    Source: Lima and Sampaio, conference paper, equation 4.

    Args:
        speed: m/s, positive.
        period: s, positive. The frequency ratio r of the papers gives ``period = 2 pi / (r * omega)``.

    Raises:
        ValueError: If a number is not positive and finite.
    """

    speed: Annotated[Number, Quantity("m/s", above=0)]
    period: Annotated[Number, Quantity("s", above=0)]
    is_never_at_rest = True

    def begin(self, key_data, dtype):
        return -jnp.ones((), dtype)

    def draw(self, key_data, number, dtype):
        return ()

    def next_interval(self, memory, drawn, dtype) -> Interval:
        return jnp.asarray(self.period / 2, dtype), memory * self.speed, -memory

    def capacity(self, t1: Scalar) -> int:
        return math.ceil(2 * largest(t1) / smallest(self.period)) + 1

    @property
    def repeats_after(self) -> Number:
        return self.period


FirstSign: TypeAlias = Annotated[
    str, Choice(("random", "positive", "negative"), "of the velocity: random, positive or negative")
]


class PoissonSwitching(PiecewiseConstantLaw):
    """``+speed`` or ``-speed``, the sign changing at the points of a Poisson process (Lima and Sampaio 2017).

    The durations are independent exponential variables of mean ``1 / rate``; for a fixed key they scale by that mean.

    Args:
        speed: m/s, positive.
        rate: The mean number of sign changes per second, 1/s, positive.
        first_sign: "random" (a fair coin, the default), "positive" or "negative".

    Raises:
        ValueError: For numbers that are not positive and finite and for another `first_sign`.
    """

    speed: Annotated[Number, Quantity("m/s", above=0)]
    rate: Annotated[Number, Quantity("1/s", "mean number of switches per second", above=0)]
    first_sign: FirstSign = eqx.field(static=True, default="random")
    is_random = True
    is_never_at_rest = True
    has_exponential_gaps = True

    def begin(self, key_data, dtype):
        return drawn_sign(self.first_sign, key_data, dtype)

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
    """A new velocity every `interval` seconds, drawn independently from a finite set (conference paper, section 4).

    Equal velocities in a row are drawn as one long interval: its number of steps is geometric, and the next level has
    the probabilities of the others.

    Args:
        speed: m/s, positive.
        interval: s, positive (the papers' ``1 / f_b``).
        levels: At least two different numbers; the velocities are ``speed * levels``. By default -1 and +1.
        probabilities: Those of the levels, each at least 1e-6, with sum 1. By default equal.

    Raises:
        ValueError: For numbers outside these bounds.
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
        return _chosen(self.uniforms(key_data, None, dtype)[0], jnp.asarray(self.level_probabilities, dtype))

    def draw(self, key_data, number, dtype):
        return self.uniforms(key_data, number, dtype)

    def next_interval(self, memory, drawn, dtype) -> Interval:
        shares = jnp.asarray(self.level_probabilities, dtype)
        # Row i: the probabilities of the next level when the present one, i, is excluded.
        others = jnp.where(jnp.eye(len(self.levels), dtype=bool), 0, shares[None, :] / (1 - shares[:, None]))
        for_length, for_next = drawn
        steps = jnp.floor(jnp.log(for_length) / jnp.log(shares)[memory]) + 1
        velocity = self.speed * jnp.asarray(self.levels, dtype)[memory]
        return steps * self.interval, velocity, _chosen(for_next, others[memory])

    def capacity(self, t1: Scalar) -> int:
        return math.ceil(largest(t1) / smallest(self.interval)) + 1


class PiecewiseConstant(PiecewiseConstantLaw):
    """A given base motion: ``velocities[i]`` from ``times[i]`` until ``times[i + 1]``; the last one has no end.

    Args:
        times: s, increasing, the first one 0, (intervals,).
        velocities: m/s, as many. Equal neighbours are merged.

    Raises:
        ValueError: For times that do not increase from 0, different lengths, or numbers that are not finite.
    """

    times: Annotated[PerInterval, Quantity("s", "start of each interval; the first is 0", ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "times")
    )
    velocities: Annotated[PerInterval, Quantity("m/s", "during each interval", ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "velocities")
    )

    def check_relations(self) -> None:
        checks.same_length(1, times=self.times, velocities=self.velocities)
        checks.increasing_from_zero("times", self.times)

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


def _floats(name: str, values: Iterable[float]) -> tuple[float, ...]:
    checks.numeric(name, values, ndim=1)
    return tuple(float(value) for value in values)


# Semi-Markov switching: a piecewise-constant base velocity whose gaps and speeds have any distribution.


_CHANCE = 1e-9  # bound of the probability that a realisation needs more intervals than `capacity`
_CELLS = 1024  # of the quantiles that `capacity` looks at


class SemiMarkovSwitching(PiecewiseConstantLaw):
    """A base velocity that switches after independent gaps of any distribution, to speeds of any distribution.

    A switch takes place at t = 0: the first gap has the distribution of all others, and not that of the rest of a gap
    that began earlier. (For an `Exponential` gap there is no difference, and the law is `PoissonSwitching`.) Gaps that
    are shorter than the rounding of time are lengthened to it. Source of the name: a process that jumps between states
    after times of any distribution (Cinlar 1975, "Introduction to stochastic processes", chapter 10).

    Args:
        gap: Distribution of the time between switches, s, such as ``Weibull(scale=2.0, shape=1.5)``, whose draws are
            all positive.
        speed: m/s; a positive number, the same for all samples, or a distribution that each interval draws anew.
        alternating: True (the default) for velocities ``+speed`` and ``-speed`` in turn; `speed` is then positive.
            False for velocities drawn from the distribution `speed` with their signs. Each is then drawn on condition
            that it differs from the one before, which only matters for `Discrete` speeds: a value of probability p is
            then in the long run that of a share of all intervals in proportion to ``p (1 - p)``. (A distribution of
            your own may draw a velocity twice in a row: then both gaps are one interval.)
        first_sign: "random" (a fair coin, the default), "positive" or "negative", where the signs alternate.

    Raises:
        ValueError: For gaps or speeds that need not be positive, distributions of other packages, those whose quantiles
            cannot be computed while simulating (`Beta`), and numbers outside these bounds.
    """

    gap: RandomNumber
    speed: Number | RandomNumber
    alternating: bool = eqx.field(static=True, default=True)
    first_sign: FirstSign = eqx.field(static=True, default="random")
    own_distributions = ("gap", "speed")
    is_random = True

    def check_relations(self) -> None:
        _check_distribution("gap", self.gap, "s", positive=True)
        if isinstance(self.speed, RandomNumber):
            _check_distribution("speed", self.speed, "m/s", positive=self.alternating)
            if self.alternating or self.speed.is_continuous:
                return
            if not keeps(self.speed, Discrete, "icdf"):  # its values and probabilities are not known
                raise ValueError(
                    "Argument speed must be continuous or a Discrete, and no other distribution of single values, "
                    f"where alternating is False, but {checks.show(self.speed)} was given."
                )
            assert isinstance(self.speed, Discrete)
            shares = self.speed.probabilities
            number = len(self.speed.values) if shares is None or checks.is_traced(shares) else np.count_nonzero(shares)
            if number < 2:  # neighbouring velocities cannot differ
                raise checks.refused("speed", "have two or more values with positive probabilities", self.speed)
            return
        if is_distribution(self.speed):
            _check_distribution("speed", self.speed, "m/s", positive=True)
        checks.positive("speed", self.speed, "m/s")
        if not self.alternating:
            raise ValueError(
                f"Argument alternating must be True where speed is a number, but False and {checks.show(self.speed)} "
                "were given; give speed a distribution of velocities."
            )

    def begin(self, key_data, dtype):
        """Memory: the time of the switch (s), and the sign, the index of a `Discrete` velocity or the last velocity."""
        time = jnp.zeros((), dtype)
        if self.alternating:
            return time, drawn_sign(self.first_sign, key_data, dtype)
        if not isinstance(self.speed, Discrete):
            return time, jnp.full((), jnp.nan, dtype)
        words = random_words(key_data, jnp.asarray(BEGINNING))
        return time, _chosen(fine_uniform(*words, dtype), _shares(self.speed, dtype))

    def draw(self, key_data, number, dtype):
        """The gap (s), and the speed or what the next `Discrete` velocity is chosen by."""
        twice = number * np.uint32(2)
        gap = jnp.asarray(self.gap.icdf(fine_uniform(*random_words(key_data, twice), dtype)), dtype)
        if not isinstance(self.speed, RandomNumber):
            return gap, jnp.asarray(self.speed, dtype)
        deviate = fine_uniform(*random_words(key_data, twice + np.uint32(1)), dtype)
        if isinstance(self.speed, Discrete) and not self.alternating:
            return gap, deviate
        return gap, jnp.asarray(self.speed.icdf(deviate), dtype)

    def next_interval(self, memory, drawn, dtype) -> Interval:
        (time, before), (gap, speed) = memory, drawn
        info, is_known = jnp.finfo(dtype), is_of_package((self.gap, self.speed))
        if not is_known:  # what a user's distribution draws need not fit its cdf
            impossible = (gap < 0) | ~(speed > 0) if self.alternating else gap < 0
            gap = jnp.where(impossible, jnp.nan, gap)
        # A time to which the gap adds nothing would end the realisation.
        gap = jnp.maximum(gap, jax.lax.stop_gradient(4 * float(info.eps) * time + float(info.tiny)))
        if self.alternating:
            return gap, before * speed, (time + gap, -before)
        if isinstance(self.speed, Discrete):
            shares = _shares(self.speed, dtype)
            others = jnp.where(jnp.arange(len(shares)) == before, 0, shares)
            velocity = jnp.asarray(self.speed.values, dtype)[before]
            return gap, velocity, (time + gap, _chosen(speed, others / jnp.sum(others), before))
        if not is_known:  # it may draw a velocity again; such neighbours are joined
            return gap, speed, (time + gap, speed)
        # Two equal draws have no probability, but for rounding: then the last digit changes.
        drawn_speed = jax.lax.stop_gradient(speed)
        higher = jnp.nextafter(drawn_speed, jnp.full((), jnp.inf, dtype))
        velocity = speed + jnp.where(drawn_speed == before, higher - drawn_speed, 0)
        return gap, velocity, (time + gap, jax.lax.stop_gradient(velocity))

    def capacity(self, t1: Scalar) -> int:
        """The number of intervals that realisations on ``[0, t1]`` (s) need more of with a probability below 1e-9.

        n gaps together are shorter than t1 with a probability of at most ``exp(s t1) M(s)^n`` for every s > 0, where
        M(s) is the mean of ``exp(-s gap)`` (Chernoff 1952). M(s) is bounded from above by the quantiles at the lower
        ends of cells of equal probability.
        """
        for leaf in jax.tree.leaves(self.gap):
            if checks.is_traced(leaf):
                float(jnp.sum(leaf))  # raises what the caller explains
        with jax.ensure_compile_time_eval():
            middle = np.asarray(self.gap.icdf(jnp.arange(1, _CELLS) / _CELLS), float)
            shortest = max(float(self.gap.support[0]), 0.0)
        above = np.concatenate([[0.0], np.maximum(middle - shortest, 0)])
        horizon, mean = float(t1), shortest + above.mean()
        if not mean > 0:
            raise checks.refused("gap", "hold numbers that can be told from 0", self.gap)
        rates = np.geomspace(1e-4 / mean, 1e3 * max(1 / mean, 1 / horizon), 200)
        decay = rates * shortest - np.log(np.exp(-rates[:, None] * above[None]).mean(axis=1))
        return math.ceil(float(np.min((rates * horizon - math.log(_CHANCE)) / decay))) + 1


def _check_distribution(name: str, given: object, unit: str, *, positive: bool) -> None:
    """Check the distribution of gaps or speeds. Raises ValueError for one that cannot be drawn while simulating."""
    what = f"Argument {name} must be a distribution of {'positive numbers' if positive else 'velocities'} (in {unit})"
    if not isinstance(given, RandomNumber):
        raise ValueError(
            f"{what} of stickslip_jax, such as Weibull(scale, shape), but {checks.show(given)} was given; of another "
            "distribution give the quantiles as a RandomNumber of your own, with icdf and cdf."
        )
    if not given.in_lanes:
        raise ValueError(
            f"{what} whose quantiles can be computed while simulating, but {checks.show(given)} was given; take a "
            "Triangular, a LogNormal or a Truncated one."
        )
    if not positive or any(map(checks.is_traced, jax.tree.leaves(given))):
        return
    if not isinstance(given, Truncated):
        # Whether the support shows that all draws are positive, without JAX: a study's file is read before it starts.
        lowest = float(given.support[0])
        if lowest > 0 or (lowest == 0 and not isinstance(given, Discrete)):
            return
    with jax.ensure_compile_time_eval():
        below = float(given.cdf(0.0))
    if below > 0:
        raise ValueError(
            f"{what}, but {checks.show(given)} was given, of whose draws {below:.2g} are zero or negative; "
            "Truncated(..., low=...) leaves them out."
        )


def _shares(values: Discrete, dtype: DTypeLike) -> Float[Array, " values"]:
    """The probabilities of the values."""
    if values.probabilities is None:
        return jnp.full(len(values.values), 1 / len(values.values), dtype)
    return jnp.asarray(values.probabilities, dtype)


def _chosen(deviate: FloatArray, shares: FloatArray, excluded: Array | int = -1) -> Array:
    """Index of the value that the uniform `deviate` chooses; `excluded`: one of probability 0."""
    index = jnp.sum(deviate > jnp.cumsum(shares)[:-1])
    # Rounded, the sum of the others may lie just below the deviate.
    return jnp.where(index == excluded, index - 1, index)
