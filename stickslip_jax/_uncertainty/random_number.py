"""The interface of a distribution, and its restriction to an interval."""

import abc
import math
from typing import Annotated, ClassVar

import jax.numpy as jnp
from jax.typing import ArrayLike

from .. import _checks
from .._fields import Checked, Quantity
from .._types import FloatArray, Scalar

_FEWEST_STEPS = 1e4
"""How many probabilities a truncated distribution must have to draw from: its own are wrong by one of them."""

_WIDER = {"float32": ", or switch jax_enable_x64 on", "float64": ""}


class RandomNumber(Checked):
    """Base class of the distributions of a random number. Subclass it to add one.

    Numbers are drawn by inversion, ``icdf(u)`` of a uniform ``u``, so that they change smoothly with the parameters of
    the distribution.
    """

    may_be_random: ClassVar[bool] = False
    shape_numbers: ClassVar[tuple[str, ...]] = ()  # its numbers without a unit; others have that of the draws
    rests_on: ClassVar = {"support": ("icdf",)}
    only_with: ClassVar = {"icdf": ("cdf",)}

    @abc.abstractmethod
    def icdf(self, u: FloatArray) -> FloatArray:
        """The number below which a draw lies with probability `u`, for each entry of `u` in (0, 1)."""

    @abc.abstractmethod
    def cdf(self, x: ArrayLike) -> FloatArray:
        """The probability of a draw below or at `x`."""

    @property
    def support(self) -> tuple[Scalar, Scalar]:
        """The interval that holds all draws."""
        return -math.inf, math.inf

    @property
    def is_continuous(self) -> bool:
        """Whether every single value has probability zero, so that the distribution may be `Truncated`."""
        return True

    @property
    def in_lanes(self) -> bool:
        """Whether `icdf` can be computed while simulating, as the gaps between switches of a base are."""
        return True


def floating(x: ArrayLike) -> FloatArray:
    """`x` as an array of floating-point numbers, in its own precision if it has one, at least single precision."""
    x = jnp.asarray(x)
    return x.astype(jnp.promote_types(jnp.result_type(x, float), jnp.float32))


class Truncated(RandomNumber):
    """A distribution restricted to an interval: draws outside it are not possible, the others keep their proportions.

    - `distribution`: what is restricted, a continuous distribution such as a `Normal`.
    - `low`, `high`: the interval, in the unit of the number; None for no limit on that side.

    Raises ValueError unless ``low < high`` and enough draws lie between them: far out in the upper tail, where
    probabilities round to 1, draws would take few values only.
    """

    distribution: RandomNumber
    low: Annotated[Scalar | None, Quantity(meaning="the lowest value; not given: no limit")] = None
    high: Annotated[Scalar | None, Quantity(meaning="the highest value; not given: no limit")] = None

    def check_relations(self) -> None:
        if not isinstance(self.distribution, RandomNumber):
            raise ValueError(
                "Argument distribution must be a distribution of stickslip_jax such as Normal(mean, std), but "
                f"{_checks.show(self.distribution)} was given; of other distributions give an array of draws."
            )
        if not self.distribution.is_continuous:
            raise _checks.refused(
                "distribution", "be continuous", self.distribution, "leave out those of its values that are not wanted"
            )
        limits = [limit for limit in (self.low, self.high) if limit is not None]
        if any(_checks.is_traced(value) for value in (*limits, *self._shares())):
            return
        if len(limits) == 2 and not limits[0] < limits[1]:
            raise ValueError(f"Argument high must be above low = {self.low}, but {self.high} was given.")
        below, above = (float(share) for share in self._shares())
        if not below < above:
            raise ValueError(
                f"Arguments low and high must leave some draws of {_checks.show(self.distribution)}, but none lies "
                f"between {self.low} and {self.high}."
            )
        dtype = jnp.result_type(float)
        if above - below < _FEWEST_STEPS * float(jnp.finfo(dtype).eps) * above:
            raise ValueError(
                f"Arguments low and high must leave more draws of {_checks.show(self.distribution)}, but only "
                f"{above - below:.2g} of them lie between {self.low} and {self.high}, and {dtype} tells too few of "
                f"their probabilities apart; take limits nearer to the median{_WIDER[dtype.name]}."
            )

    def _shares(self) -> tuple[FloatArray | float, FloatArray | float]:
        """The probabilities of a draw below `low`, and below `high`, without the restriction."""
        below = 0.0 if self.low is None else self.distribution.cdf(self.low)
        return below, 1.0 if self.high is None else self.distribution.cdf(self.high)

    def icdf(self, u: FloatArray) -> FloatArray:
        u = floating(u)
        below, above = (jnp.asarray(share, u.dtype) for share in self._shares())
        # Round-off must not lead outside.
        low, high = (jnp.asarray(limit, u.dtype) for limit in self.support)
        return jnp.clip(self.distribution.icdf(below + (above - below) * u), low, high)

    def cdf(self, x: ArrayLike) -> FloatArray:
        x = floating(x)
        below, above = (jnp.asarray(share, x.dtype) for share in self._shares())
        return jnp.clip((self.distribution.cdf(x) - below) / (above - below), 0, 1)

    @property
    def support(self) -> tuple[Scalar, Scalar]:
        low, high = self.distribution.support
        return (low if self.low is None else jnp.maximum(low, self.low)), (
            high if self.high is None else jnp.minimum(high, self.high)
        )

    @property
    def in_lanes(self) -> bool:
        return self.distribution.in_lanes
