"""The distributions of a random number: their interface, and uniform, normal, log-normal, beta and other families."""

import abc
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import betainc, betaln, ndtr, ndtri
from jax.typing import ArrayLike
from jaxtyping import Float

from .._foundation import checks
from .._foundation.fields import Checked, Quantity
from .._foundation.types import AnyArray, FloatArray, Scalar

# The interface of a distribution, and its restriction to an interval.


_FEWEST_STEPS = 1e4
"""How many probabilities a truncated distribution must have to draw from: its own are wrong by one of them."""

_WIDER = {"float32": ", or switch jax_enable_x64 on", "float64": ""}


class RandomNumber(Checked):
    """Base class of the distributions of a random number. Subclass it to add one.

    Numbers are drawn by inversion, ``icdf(u)`` of a uniform ``u``, so that they change smoothly with the parameters of
    the distribution.
    """

    is_continuous: ClassVar[bool] = True
    """Whether every single value has probability zero, so that the distribution may be `Truncated`."""
    in_lanes: ClassVar[bool] = True
    """Whether `icdf` can be computed while simulating, as the gaps between switches of a base are."""
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
            demand = "be a distribution of stickslip_jax such as Normal(mean, std)"
            hint = "of other distributions give an array of draws"
            raise checks.refused("distribution", demand, self.distribution, hint)
        if not self.distribution.is_continuous:
            hint = "leave out those of its values that are not wanted"
            raise checks.refused("distribution", "be continuous", self.distribution, hint)
        limits = [limit for limit in (self.low, self.high) if limit is not None]
        if any(checks.is_traced(value) for value in (*limits, *self._shares())):
            return
        if len(limits) == 2:
            _check_order(*limits)
        below, above = (float(share) for share in self._shares())
        if not below < above:
            raise ValueError(
                f"Arguments low and high must leave some draws of {checks.show(self.distribution)}, but none lies "
                f"between {self.low} and {self.high}."
            )
        dtype = jnp.result_type(float)
        if above - below < _FEWEST_STEPS * float(jnp.finfo(dtype).eps) * above:
            raise ValueError(
                f"Arguments low and high must leave more draws of {checks.show(self.distribution)}, but only "
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
    def in_lanes(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - that of what is restricted
        return self.distribution.in_lanes


# The distributions of a random number: uniform, normal, log-normal, beta, triangular, exponential, and others.


PerValue: TypeAlias = Float[AnyArray, " values"]

_MOST_VARIATION = 1e50  # of the coefficient of variation of a log-normal number: its square is still a number


class Uniform(RandomNumber):
    """A random number, uniform on ``[low, high]`` and independent in every sample of an ensemble.

    `low`, `high`: the lowest and the highest value, in the unit of the number.

    Raises ValueError unless `low` and `high` are finite and ``low < high``.
    """

    low: Annotated[Scalar, Quantity(meaning="the lowest value")]
    high: Annotated[Scalar, Quantity(meaning="the highest value")]

    def check_relations(self) -> None:
        _check_order(self.low, self.high)

    def icdf(self, u: FloatArray) -> FloatArray:
        return self.low + (self.high - self.low) * u

    def cdf(self, x: ArrayLike) -> FloatArray:
        return jnp.clip((floating(x) - self.low) / (self.high - self.low), 0, 1)

    @property
    def support(self) -> tuple[Scalar, Scalar]:
        return self.low, self.high


class Normal(RandomNumber):
    """A normally distributed number. A few draws lie far from the mean: take `Truncated` for what has bounds.

    `mean`, and the standard deviation `std`, positive: in the unit of the number.

    Raises ValueError for numbers outside these bounds.
    """

    mean: Annotated[Scalar, Quantity(meaning="the mean")]
    std: Annotated[Scalar, Quantity(meaning="the standard deviation", above=0)]

    def icdf(self, u: FloatArray) -> FloatArray:
        return self.mean + self.std * ndtri(u)

    def cdf(self, x: ArrayLike) -> FloatArray:
        return ndtr((floating(x) - self.mean) / self.std)


class LogNormal(RandomNumber):
    """A positive number whose logarithm is normally distributed: ``median exp(log_std z)``.

    - `median`, positive, in the unit of the number: half of the draws lie below.
    - `log_std`, positive: the standard deviation of the natural logarithm; for small ones about the coefficient of
      variation.

    Raises ValueError for numbers outside these bounds.
    """

    shape_numbers: ClassVar[tuple[str, ...]] = ("log_std",)
    median: Annotated[Scalar, Quantity(meaning="half of the draws lie below", above=0)]
    log_std: Annotated[Scalar, Quantity(meaning="standard deviation of the logarithm", above=0)]

    @classmethod
    def from_moments(cls, mean: Scalar, std: Scalar) -> "LogNormal":
        """The one with this mean and this standard deviation, both positive. Raises ValueError for others."""
        checks.require_threads_of_jax()
        checks.positive("mean", mean)
        checks.positive("std", std)
        ratio = std / mean
        if not checks.is_traced(ratio) and not ratio <= _MOST_VARIATION:
            raise ValueError(
                f"Argument std must be at most {_MOST_VARIATION:g} times the mean {mean}, but {std} was given."
            )
        spread = jnp.log1p(ratio**2)
        return cls(mean * jnp.exp(-spread / 2), jnp.sqrt(spread))

    def icdf(self, u: FloatArray) -> FloatArray:
        return self.median * jnp.exp(self.log_std * ndtri(u))

    def cdf(self, x: ArrayLike) -> FloatArray:
        x = floating(x)
        z = jnp.log(jnp.where(x > 0, x, self.median) / self.median) / self.log_std
        return jnp.where(x > 0, ndtr(z), 0.0)

    @property
    def support(self) -> tuple[Scalar, Scalar]:
        return 0.0, math.inf


class Beta(RandomNumber):
    """A number on ``[low, high]`` with a beta distribution: density proportional to ``z^(a-1) (1-z)^(b-1)``.

    - `a`, `b`: the shape, positive. `low`, `high`: in the unit of the number; by default 0 and 1.

    Raises ValueError for numbers outside these bounds, or unless ``low < high``.
    """

    in_lanes = False
    shape_numbers: ClassVar[tuple[str, ...]] = ("a", "b")
    a: Annotated[Scalar, Quantity(meaning="first shape number", above=0)]
    b: Annotated[Scalar, Quantity(meaning="second shape number", above=0)]
    low: Annotated[Scalar, Quantity(meaning="the lowest value")] = 0.0
    high: Annotated[Scalar, Quantity(meaning="the highest value")] = 1.0

    def check_relations(self) -> None:
        _check_order(self.low, self.high)

    def icdf(self, u: FloatArray) -> FloatArray:
        # The upper half from the upper end: where the density is infinite there, much lies closer than rounding to 1.
        a, b, u = _alike(self.a, self.b, u)
        above, below = _beta_quantile(a, b, u), _beta_quantile(b, a, 1 - u)
        width = self.high - self.low
        return jnp.where(u > 0.5, self.high - width * below, self.low + width * above)

    def cdf(self, x: ArrayLike) -> FloatArray:
        x, width = floating(x), self.high - self.low
        a, b, above = _alike(self.a, self.b, jnp.clip((x - self.low) / width, 0, 1))
        below = jnp.clip((self.high - x) / width, 0, 1).astype(above.dtype)
        share = _beta_share(a, b, above)
        return jnp.where((share > 0.5) | (below < 1e-4), 1 - _beta_share(b, a, below), share)

    support = Uniform.support  # pyright: ignore[reportIncompatibleMethodOverride] - of another class


class Triangular(RandomNumber):
    """A number between `low` and `high` whose density rises linearly up to `mode` and falls linearly after it.

    All in the unit of the number. Raises ValueError unless ``low <= mode <= high`` and ``low < high``.
    """

    low: Annotated[Scalar, Quantity(meaning="the lowest value")]
    mode: Annotated[Scalar, Quantity(meaning="the most likely value")]
    high: Annotated[Scalar, Quantity(meaning="the highest value")]

    def check_relations(self) -> None:
        _check_order(self.low, self.high)
        if any(checks.is_traced(value) for value in (self.low, self.mode, self.high)):
            return
        if not np.all((self.low <= self.mode) & (self.mode <= self.high)):
            raise ValueError(
                f"Argument mode must lie between low = {self.low} and high = {self.high}, but {self.mode} was given."
            )

    def icdf(self, u: FloatArray) -> FloatArray:
        width, left, right = self.high - self.low, self.mode - self.low, self.high - self.mode
        rising = u * width < left
        root = jnp.sqrt(width * jnp.where(rising, u * left, (1 - u) * right))
        return jnp.where(rising, self.low + root, self.high - root)

    def cdf(self, x: ArrayLike) -> FloatArray:
        width, left, right = self.high - self.low, self.mode - self.low, self.high - self.mode
        x = jnp.clip(floating(x), self.low, self.high)
        rising = x < self.mode
        part = jnp.where(rising, x - self.low, self.high - x) ** 2
        part = part / (width * jnp.where(rising, jnp.where(left > 0, left, 1), jnp.where(right > 0, right, 1)))
        return jnp.where(rising, part, 1 - part)

    support = Uniform.support  # pyright: ignore[reportIncompatibleMethodOverride] - of another class


class Exponential(RandomNumber):
    """A positive number with density ``exp(-x / mean) / mean``. `mean`: positive, in the unit of the number.

    Raises ValueError for another mean.
    """

    mean: Annotated[Scalar, Quantity(meaning="the mean", above=0)]

    def icdf(self, u: FloatArray) -> FloatArray:
        return -self.mean * jnp.log1p(-u)

    def cdf(self, x: ArrayLike) -> FloatArray:
        return -jnp.expm1(-jnp.maximum(floating(x), 0) / self.mean)

    support = LogNormal.support  # pyright: ignore[reportIncompatibleMethodOverride] - of another class


class Weibull(RandomNumber):
    """A positive number ``x`` that exceeds any value with probability ``exp(-(x / scale)^shape)``.

    `scale`: positive, in the unit of the number. `shape`: positive. Raises ValueError for others.
    """

    shape_numbers: ClassVar[tuple[str, ...]] = ("shape",)
    scale: Annotated[Scalar, Quantity(meaning="37 % of the draws exceed it", above=0)]
    shape: Annotated[Scalar, Quantity(meaning="the exponent", above=0)]

    def icdf(self, u: FloatArray) -> FloatArray:
        return self.scale * (-jnp.log1p(-u)) ** (1 / self.shape)

    def cdf(self, x: ArrayLike) -> FloatArray:
        return -jnp.expm1(-((jnp.maximum(floating(x), 0) / self.scale) ** self.shape))

    support = LogNormal.support  # pyright: ignore[reportIncompatibleMethodOverride] - of another class


class Discrete(RandomNumber):
    """A number that takes one of several values.

    - `values`: (values,), increasing, in the unit of the number.
    - `probabilities`: that of each, zero or positive, with sum 1; by default all the same.

    Raises ValueError for values that do not increase, or probabilities that do not fit.
    """

    is_continuous = False
    values: Annotated[PerValue, Quantity(meaning="the values", ndim=1)] = eqx.field(
        converter=partial(checks.real_array, "values")
    )
    probabilities: Annotated[
        PerValue | None, Quantity(meaning="of the values; not given: equal", ndim=1, at_least=0)
    ] = eqx.field(default=None, converter=lambda v: None if v is None else checks.real_array("probabilities", v))

    def check_relations(self) -> None:
        if not checks.is_traced(self.values) and (len(self.values) == 0 or np.any(np.diff(self.values) <= 0)):
            raise checks.refused("values", "hold increasing numbers", self.values)
        given = self.probabilities
        if given is None or checks.is_traced(given):
            return
        tolerance = 1e-6 if given.dtype == np.float32 else 1e-9
        if len(given) != len(self.values) or abs(float(np.sum(np.asarray(given, float))) - 1) > tolerance:
            demand = f"hold one number for each of the {len(self.values)} values, with sum 1"
            raise checks.refused("probabilities", demand, given)

    def _cumulative(self, dtype) -> FloatArray:
        """The probability of each value or one below it."""
        number = len(self.values)
        if self.probabilities is None:
            return jnp.arange(1, number + 1, dtype=dtype) / number
        total = jnp.cumsum(jnp.asarray(self.probabilities, dtype))
        return total / total[-1]  # exactly 1 at the end, so that no draw is above the last value that is possible

    def icdf(self, u: FloatArray) -> FloatArray:
        u = floating(u)
        place = jnp.sum(u[..., None] > self._cumulative(u.dtype)[(None,) * u.ndim], axis=-1)
        return jnp.asarray(self.values, u.dtype)[jnp.minimum(place, len(self.values) - 1)]

    def cdf(self, x: ArrayLike) -> FloatArray:
        x = floating(x)
        below = jnp.searchsorted(jnp.asarray(self.values, x.dtype), x, side="right")
        return jnp.concatenate([jnp.zeros(1, x.dtype), self._cumulative(x.dtype)])[below]

    @property
    def support(self) -> tuple[Scalar, Scalar]:
        return self.values[0], self.values[-1]


def _check_order(low: Scalar, high: Scalar) -> None:
    if not (checks.is_traced(low) or checks.is_traced(high)) and not np.all(low < high):
        raise ValueError(f"Argument high must be above low = {low}, but {high} was given.")


def _alike(a: ArrayLike, b: ArrayLike, x: ArrayLike) -> Sequence[FloatArray]:
    """All three as arrays of one shape, in the precision of `x`."""
    x = floating(x)
    return jnp.broadcast_arrays(jnp.asarray(a, x.dtype), jnp.asarray(b, x.dtype), x)


@jax.custom_jvp
def _beta_share(a: FloatArray, b: FloatArray, x: FloatArray) -> FloatArray:
    """The regularised incomplete beta function. All three have one shape."""
    return betainc(a, b, x)


@_beta_share.defjvp
def _(primals, tangents):
    a, b, x = primals
    density = jnp.exp((a - 1) * jnp.log(x) + (b - 1) * jnp.log1p(-x) - betaln(a, b))
    slope = jnp.where((x > 0) & (x < 1), tangents[2] * density, 0)
    return _beta_share(a, b, x), slope + _shape_slope(_beta_share, primals, tangents)


@jax.custom_jvp
def _beta_quantile(a: FloatArray, b: FloatArray, u: FloatArray) -> FloatArray:
    """The inverse of the regularised incomplete beta function, which JAX does not have. All three have one shape."""
    return jax.pure_callback(
        _scipy_quantile, jax.ShapeDtypeStruct(u.shape, u.dtype), a, b, u, vmap_method="expand_dims"
    )


def _scipy_quantile(a: AnyArray, b: AnyArray, u: AnyArray) -> np.ndarray:
    from scipy.special import betaincinv  # noqa: PLC0415 - loaded when used

    found = betaincinv(*(np.asarray(value, np.float64) for value in (a, b, u)))
    return np.asarray(found, np.asarray(u).dtype)


@_beta_quantile.defjvp
def _(primals, tangents):
    a, b, u = primals
    x = _beta_quantile(a, b, u)
    log_density = (a - 1) * jnp.log(x) + (b - 1) * jnp.log1p(-x) - betaln(a, b)
    slope = tangents[2] * jnp.exp(-log_density)
    return x, slope + _shape_slope(_beta_quantile, primals, tangents)


def _shape_slope(
    function: Callable[..., FloatArray], primals: tuple[FloatArray, ...], tangents: tuple[FloatArray, ...]
) -> FloatArray:
    """The derivative along the shape numbers. No formula is known: central differences, exact to about ten digits."""
    a, b, x = primals
    step = np.cbrt(jnp.finfo(x.dtype).eps).astype(x.dtype)
    # All four together: what computes them is compiled once.
    factors = np.ones((4, 2), x.dtype) + step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]], x.dtype)
    factors = factors.reshape(4, 2, *(1,) * x.ndim)
    up_a, down_a, up_b, down_b = function(a[None] * factors[:, 0], b[None] * factors[:, 1], jnp.stack([x] * 4))
    return (tangents[0] * (up_a - down_a) / a + tangents[1] * (up_b - down_b) / b) / (2 * step)
