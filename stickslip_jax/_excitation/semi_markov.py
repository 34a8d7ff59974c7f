"""Semi-Markov switching: a piecewise-constant base velocity whose gaps and speeds have any distribution."""

import math
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from .. import _checks
from .._claims import keeps
from .._fields import Choice, is_of_package
from .._numerics.random_bits import fine_uniform, random_words
from .._types import Array, Float, FloatArray, Number, Scalar
from .._uncertainty.families import Discrete
from .._uncertainty.random_number import RandomNumber, Truncated
from .piecewise_constant import Interval, PiecewiseConstantLaw
from .segments import BEGINNING, drawn_sign

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
    first_sign: Annotated[
        str, Choice(("random", "positive", "negative"), "of the velocity: random, positive or negative")
    ] = eqx.field(static=True, default="random")
    own_distributions = ("gap", "speed")
    is_random = True

    def check_relations(self) -> None:
        _checks.truth("alternating", self.alternating)
        _check_distribution("gap", self.gap, "s", positive=True)
        if isinstance(self.speed, RandomNumber):
            _check_distribution("speed", self.speed, "m/s", positive=self.alternating)
            if not self.alternating:
                _check_values(self.speed)
            return
        if any(callable(getattr(self.speed, name, None)) for name in ("icdf", "ppf", "sample")):
            _check_distribution("speed", self.speed, "m/s", positive=True)
        _checks.positive("speed", self.speed, "m/s")
        if not self.alternating:
            raise ValueError(
                f"Argument alternating must be True where speed is a number, but False and {_checks.show(self.speed)} "
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
            if _checks.is_traced(leaf):
                float(jnp.sum(leaf))  # raises what the caller explains
        with jax.ensure_compile_time_eval():
            middle = np.asarray(self.gap.icdf(jnp.arange(1, _CELLS) / _CELLS), float)
            shortest = max(float(self.gap.support[0]), 0.0)
        above = np.concatenate([[0.0], np.maximum(middle - shortest, 0)])
        horizon, mean = float(t1), shortest + above.mean()
        if not mean > 0:
            raise _checks.refused("gap", "hold numbers that can be told from 0", self.gap)
        rates = np.geomspace(1e-4 / mean, 1e3 * max(1 / mean, 1 / horizon), 200)
        decay = rates * shortest - np.log(np.exp(-rates[:, None] * above[None]).mean(axis=1))
        return math.ceil(float(np.min((rates * horizon - math.log(_CHANCE)) / decay))) + 1


def _check_distribution(name: str, given: object, unit: str, *, positive: bool) -> None:
    """Check the distribution of gaps or speeds. Raises ValueError for one that cannot be drawn while simulating."""
    what = f"Argument {name} must be a distribution of {'positive numbers' if positive else 'velocities'} (in {unit})"
    if not isinstance(given, RandomNumber):
        raise ValueError(
            f"{what} of stickslip_jax, such as Weibull(scale, shape), but {_checks.show(given)} was given; of another "
            "distribution give the quantiles as a RandomNumber of your own, with icdf and cdf."
        )
    if not given.in_lanes:
        raise ValueError(
            f"{what} whose quantiles can be computed while simulating, but {_checks.show(given)} was given; take a "
            "Triangular, a LogNormal or a Truncated one."
        )
    if any(_checks.is_traced(leaf) for leaf in jax.tree.leaves(given)):
        return
    if not positive or _is_positive(given):
        return
    with jax.ensure_compile_time_eval():
        below = float(given.cdf(0.0))
    if below > 0:
        raise ValueError(
            f"{what}, but {_checks.show(given)} was given, of whose draws {below:.2g} are zero or negative; "
            "Truncated(..., low=...) leaves them out."
        )


def _is_positive(given: RandomNumber) -> bool:
    """Whether the support shows that all draws are positive, without JAX: a study's file is read before it starts."""
    if isinstance(given, Truncated):
        return False
    lowest = float(given.support[0])
    return lowest > 0 or (lowest == 0 and not isinstance(given, Discrete))


def _check_values(speed: RandomNumber) -> None:
    """Check that neighbouring velocities from `speed` can differ."""
    if speed.is_continuous:
        return
    if not keeps(speed, Discrete, "icdf"):  # its values and probabilities are not known
        raise ValueError(
            "Argument speed must be continuous or a Discrete, and no other distribution of single values, where "
            f"alternating is False, but {_checks.show(speed)} was given."
        )
    assert isinstance(speed, Discrete)
    shares = speed.probabilities
    if _checks.is_traced(shares):
        return
    if (len(speed.values) if shares is None else np.count_nonzero(np.asarray(shares))) < 2:
        raise _checks.refused("speed", "have two or more values with positive probabilities", speed)


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
