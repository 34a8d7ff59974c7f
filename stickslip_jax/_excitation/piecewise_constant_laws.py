"""Laws of piecewise-constant base velocity."""

import math
from collections.abc import Iterable
from functools import partial
from typing import Annotated, TypeAlias

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .. import _checks
from .._fields import Choice, Quantity
from .._numerics.known import largest, smallest
from .._numerics.random_bits import exponential, random_words, uniform
from .._types import AnyArray, Array, Float, IntArray, Number, Scalar
from .interval_checks import marked
from .piecewise_constant import Interval, PiecewiseConstantLaw
from .segments import BEGINNING, drawn_sign

PerInterval: TypeAlias = Float[AnyArray, " intervals"]


class Constant(PiecewiseConstantLaw):
    """A base that moves with constant velocity.

    Args:
        speed: The velocity, m/s, of either sign; 0 for a base at rest.

    Raises:
        ValueError: If it is not finite.
    """

    speed: Annotated[Number, Quantity("m/s", "signed")]
    is_random = False

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
    is_random = False

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
    first_sign: Annotated[
        str, Choice(("random", "positive", "negative"), "of the velocity: random, positive or negative")
    ] = eqx.field(static=True, default="random")
    is_random = True
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
    """A given base motion: ``velocities[i]`` from ``times[i]`` until ``times[i + 1]``; the last one has no end.

    Args:
        times: s, increasing, the first one 0, (intervals,).
        velocities: m/s, as many. Equal neighbours are merged.

    Raises:
        ValueError: For times that do not increase from 0, different lengths, or numbers that are not finite.
    """

    times: Annotated[PerInterval, Quantity("s", "start of each interval; the first is 0", ndim=1)] = eqx.field(
        converter=partial(_checks.real_array, "times")
    )
    velocities: Annotated[PerInterval, Quantity("m/s", "during each interval", ndim=1)] = eqx.field(
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


def _choose(draw: Float[Array, ""], cumulative: Float[Array, " cells"]) -> IntArray:
    """Index of the cell of the ``cumulative`` probabilities that holds the uniform ``draw``."""
    return jnp.minimum(jnp.sum(draw > cumulative, axis=-1), cumulative.shape[-1] - 1)


def _floats(name: str, values: Iterable[float]) -> tuple[float, ...]:
    _checks.numeric(name, values, ndim=1)
    return tuple(float(value) for value in values)
