"""A number estimated from samples, with its error: it can be computed with like a number; what it is estimated
from.
"""

import dataclasses
import html
import math
import operator
import re
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, SupportsFloat, TypeAlias, cast, runtime_checkable

import numpy as np

from .._dynamics.sticks import FlatSticks
from .._foundation import checks
from .._foundation.types import Status
from .._numerics.sums import Moments

# Units of products and quotients of estimates.


_FACTOR = re.compile(r"([^\d\s/^*()-]+)(?:\^?(-?\d+))?")


def unit_of_product(one: str, other: str, power: int = 1) -> str:
    """The unit of a quantity in `one` times a quantity in `other` to the `power` 1 or -1, such as "m/s" times "s": "m".

    Units that are no products of powers, such as "s per stick", stay as they are, in parentheses.
    """
    powers = _powers(one)
    for name, exponent in _powers(other).items():
        powers[name] = powers.get(name, 0) + power * exponent
    above, below = (
        [name if abs(n) == 1 else f"{name}^{abs(n)}" for name, n in powers.items() if sign * n > 0] for sign in (1, -1)
    )
    if not below:
        return " ".join(above) or "1"
    return f"{' '.join(above) or '1'}/{below[0] if len(below) == 1 else '(' + ' '.join(below) + ')'}"


def same_unit(one: str, other: str) -> bool:
    """Whether two units are the same, however their factors are ordered."""
    return _powers(one) == _powers(other)


def _powers(unit: str) -> dict[str, int]:
    """The exponent of each factor."""
    powers: dict[str, int] = {}
    for place, part in enumerate(unit.split("/")):
        for factor in part.strip().removeprefix("(").removesuffix(")").replace("*", " ").split():
            found = _FACTOR.fullmatch(factor)
            if found and factor != "per":
                exponent = int(found[2] or 1) * (-1 if place else 1)
                powers[found[1]] = powers.get(found[1], 0) + exponent
            elif factor != "1":
                return {f"({unit.strip().removeprefix('(').removesuffix(')')})": 1}
    return {name: exponent for name, exponent in powers.items() if exponent}


# A number estimated from samples, with its error: it can be computed with like a number.


DEFAULT_LEVEL = 0.95
"""The level of intervals that are asked for without one, everywhere in the package."""

_SYMMETRIC = 0.15  # halves of an interval that differ by less of its width are shown as one error
_LONGEST_NAME = 100  # letters: a combination with a longer name only says of how many estimates it is
_ROUND_OFF = 1e-15  # what is left, relative to each, of two derivatives that cancel


@dataclasses.dataclass(frozen=True, eq=False)
class SharedErrors:
    """The covariance of several estimates from the same samples, in their units, (estimates, estimates)."""

    covariance: np.ndarray


class RatioOfMeans(NamedTuple):
    """What else the interval of a ratio of two means needs (Fieller 1954): a denominator that few samples determine
    makes it longer on the side of large ratios. Both are over the squared mean of the denominator.

    - `variance`: of the denominator's mean. `covariance`: of that with the mean of (numerator - ratio x denominator).
    """

    variance: float
    covariance: float

    def interval(self, estimate: "Estimate", level: float) -> tuple[float, float]:
        """All ratios from which numerator and denominator deviate by no more than Student's t allows.

        In units of the denominator's mean, that of (numerator - (r + d) denominator) is -d where r is the estimate. It
        is within t of its standard errors if ``d^2 <= t^2 (s^2 - 2 w d + v d^2)``: s is the standard error of r, v the
        variance and w the covariance. Where the denominator itself is not surely positive, no ratio is too large.
        """
        t = float(quantile_of_t(estimate.samples - 1, level))
        certain, middle = 1 - t**2 * self.variance, -(t**2) * self.covariance
        square = (t * estimate.standard_error) ** 2
        if square == 0:
            return estimate.value, estimate.value
        root = math.sqrt(max(middle**2 + certain * square, 0.0))
        low = -square / (middle + root) if root > 0 and middle + root > 0 else -math.inf
        return estimate.value + low, estimate.value + (square / (root - middle) if certain > 0 else math.inf)


class Share(NamedTuple):
    """That the estimate is the share of its samples that have something, whose interval is that of Clopper and Pearson
    (1934): it does not end where all samples or none have it.
    """

    def interval(self, estimate: "Estimate", level: float) -> tuple[float, float]:
        """The shares with which no fewer, and no more, samples have it with a probability above (1 - level) / 2."""
        from scipy import special  # noqa: PLC0415 - adds a filter of warnings

        having, tail = round(estimate.value * estimate.samples), (1 - level) / 2
        without = estimate.samples - having
        low = float(special.betaincinv(having, without + 1, tail)) if having else 0.0
        return low, float(special.betaincinv(having + 1, without, 1 - tail)) if without else 1.0


class _Source(NamedTuple):
    """An estimate from samples, which others are computed from.

    `shared`: the errors of estimates from the same samples, and its place among them, where these are known.
    """

    origin: Hashable
    name: str
    value: float
    standard_error: float
    samples: int
    shared: tuple[SharedErrors, int] | None = None


class Computable:
    """What can be computed with like a number: an `Estimate`, or what has one as its `estimate`."""

    __array_ufunc__ = None  # arithmetic with NumPy's numbers is left to these methods

    def __float__(self) -> float:
        return float(_estimate_of(self).value)

    def __neg__(self) -> "Estimate":
        own = _estimate_of(self)
        return _combined(f"-{_inside(own)}", -own.value, own.unit, (-1.0, own))

    def __pos__(self) -> "Estimate":
        return _estimate_of(self)

    def __abs__(self) -> "Estimate":
        own = _estimate_of(self)
        return _combined(f"|{own.name}|", abs(own.value), own.unit, (math.copysign(1.0, own.value), own))

    def __add__(self, other: object) -> "Estimate":
        return _computed(_sum, self, other, "+")

    def __radd__(self, other: object) -> "Estimate":
        if isinstance(other, int) and other == 0:  # where sum() begins
            return _estimate_of(self)
        return _computed(_sum, other, self, "+")

    def __sub__(self, other: object) -> "Estimate":
        return _computed(_sum, self, other, "-")

    def __rsub__(self, other: object) -> "Estimate":
        return _computed(_sum, other, self, "-")

    def __mul__(self, other: object) -> "Estimate":
        return _computed(_product, self, other)

    def __rmul__(self, other: object) -> "Estimate":
        return _computed(_product, other, self)

    def __truediv__(self, other: object) -> "Estimate":
        return _computed(_quotient, self, other)

    def __rtruediv__(self, other: object) -> "Estimate":
        return _computed(_quotient, other, self)

    def __lt__(self, other: object) -> bool:
        return _computed(_compared, self, other, operator.lt)

    def __le__(self, other: object) -> bool:
        return _computed(_compared, self, other, operator.le)

    def __gt__(self, other: object) -> bool:
        return _computed(_compared, self, other, operator.gt)

    def __ge__(self, other: object) -> bool:
        return _computed(_compared, self, other, operator.ge)


def _estimate_of(given: Any) -> Any:
    """The estimate of what has one; other things as they are."""
    has_one = isinstance(given, Computable) and not isinstance(given, Estimate)
    return cast(Any, given).estimate if has_one else given


def _computed(how: Callable[..., Any], one: object, other: object, *options: Any) -> Any:
    """What `how` computes of two numbers, of which one or both have errors; NotImplemented for other things."""
    pair = _estimate_of(one), _estimate_of(other)
    return how(*pair, *options) if all(map(_is_number, pair)) else NotImplemented


@dataclasses.dataclass(frozen=True)
class Estimate(Computable):
    """An estimate: its value and standard error (one standard deviation), both in `unit`.

    - `samples`: the number of independent samples it is from. A value or error that these do not determine is NaN.
    - An infinite error: the samples do not determine the value, as that of a number which a calibration cannot tell.
    - `origin`: which random numbers it is from; for estimates of an ensemble, its key. By default its own.
    - `kind`: what its interval follows from, where that is not Student's t about the value.

    It is a number where one is asked for (``float(estimate)`` is its value), and can be added, subtracted, multiplied
    and divided, with numbers and with other estimates; ``f"{estimate:.3f}"`` formats the value. A plain number that is
    added is in the estimate's unit; units are multiplied and divided too.

    Errors are propagated to first order. An estimate knows what it was computed from, so that ``e - e`` is 0 with the
    error 0, and ``e + e`` has twice the error of e. Estimates of different origin, such as those of two ensembles with
    different keys, are taken to be independent. Two different estimates of one origin are not, and how they are
    correlated is not known: what is computed from both has a value, but the error NaN. (It is known of the results of
    one call of `sensitivity`.) Of a combination `samples` is such that `interval` has the degrees of freedom of Welch
    and Satterthwaite, rounded down.

    ``<``, ``<=``, ``>`` and ``>=`` compare values, which says nothing about significance: for that, see whether
    ``(a - b).interval()`` holds 0. ``==`` asks whether two estimates are the same in all that they say.
    """

    name: str
    value: float
    standard_error: float
    unit: str
    samples: int
    origin: Hashable = dataclasses.field(default_factory=object, compare=False, repr=False)
    kind: RatioOfMeans | Share | None = dataclasses.field(default=None, compare=False, repr=False)
    _slopes: Mapping[_Source, float] | None = dataclasses.field(default=None, init=False, compare=False, repr=False)

    _shared: tuple[SharedErrors, int] | None = dataclasses.field(default=None, init=False, compare=False, repr=False)

    def interval(self, level: float = DEFAULT_LEVEL) -> tuple[float, float]:
        """Confidence interval at `level`; NaN without error.

        By Student's t with ``samples - 1`` degrees of freedom; of a ratio of two means, such as the mean duration of
        all sticks, by Fieller's method, which is the same for many samples; of a share of the samples, Clopper and
        Pearson's. Printing shows the interval of level 0.95 where it is not symmetric about the value. For few samples
        with few, skewed values `bootstrap_interval` comes closer to `level`.

        Raises:
            ValueError: Unless ``0 < level < 1``.
        """
        check_level(level)
        if self.samples < 2 or math.isnan(self.standard_error):
            return math.nan, math.nan
        if self.kind is not None:
            return self.kind.interval(self, level)
        half_width = float(quantile_of_t(self.samples - 1, level)) * self.standard_error
        return self.value - half_width, self.value + half_width

    def __format__(self, how: str) -> str:
        return format(self.value, how) if how else str(self)

    def __str__(self) -> str:
        return f"{self.name}: {self.without_name()}"

    def __repr__(self) -> str:
        return f"<{self}>"

    def _repr_html_(self) -> str:
        shown = html.escape(self.without_name().replace("+-", "±"))
        return f"<span>{html.escape(self.name)}: <b>{shown}</b></span>"

    def without_name(self) -> str:
        """Value, standard error and unit, as far as they are known."""
        if math.isnan(self.value):
            return f"not defined (no such event in {self.samples} samples)"
        unit = "" if self.unit == "1" else f" {self.unit}"
        if math.isnan(self.standard_error):
            why = "no error from one sample" if self.samples < 2 else "error not known"
            # Of estimates whose errors are known, but not their correlation.
            if self._slopes and all(math.isfinite(source.standard_error) for source in self._slopes):
                why = "error not known: of estimates from the same random numbers"
            return f"{self.value:.6g}{unit} ({why})"
        if math.isinf(self.standard_error):
            return f"{self.value:.2g}{unit} (not determined)"
        shown = f"{format_with_error(self.value, self.standard_error)}{unit}"
        if self.kind is None or self.samples < 2:
            return shown
        low, high = self.interval()
        below, above = self.value - low, high - self.value
        if abs(above - below) <= _SYMMETRIC * (above + below):
            return shown
        return f"{shown} ({DEFAULT_LEVEL:.0%}: {low:.4g} to {high:.4g})".replace("%", " %")


def quantile_of_t(freedom: Any, level: float) -> Any:
    """How many standard errors the interval of Student's t extends to either side; `freedom`: a number or an array."""
    from scipy import special  # noqa: PLC0415 - adds a filter of warnings

    return special.stdtrit(freedom, (1 + level) / 2)


def check_level(level: float) -> None:
    """Raise ValueError unless ``0 < level < 1``."""
    checks.numeric("level", level)
    if not 0 < level < 1:
        raise ValueError(f"Argument level must lie between 0 and 1, such as 0.95, but {level} was given.")


def format_with_error(value: float, error: float) -> str:
    """``value +- error``, the error to two digits and the value to the same decimal place."""
    if not (math.isfinite(error) and error > 0 and math.isfinite(value)):
        return f"{value:.6g} +- {error:.2g}"
    decimals = max(0, 1 - math.floor(math.log10(error)))
    if decimals > 9:
        return f"{value:.6g} +- {error:.2g}"
    return f"{value:.{decimals}f} +- {error:.{decimals}f}"


def _is_number(other: object) -> bool:
    """Whether an estimate can be computed with `other`: an estimate, or a real number that JAX does not trace."""
    if isinstance(other, Estimate):
        return True
    if isinstance(other, (bool, str, bytes)) or other is None or checks.is_traced(other):
        return False
    array = np.asarray(other)
    return array.ndim == 0 and array.dtype.kind in "iuf"


def _inside(other: SupportsFloat) -> str:
    """The name of a number or an estimate in the name of a combination."""
    if not isinstance(other, Estimate):
        return f"{float(other):.6g}"
    return other.name if other._slopes is None else f"({other.name})"


def _one_unit(one: SupportsFloat, other: SupportsFloat, what: str) -> str:
    """The unit of both numbers; a plain number has that of the other. Raises ValueError where they differ."""
    units = [number.unit for number in (one, other) if isinstance(number, Estimate)]
    if not same_unit(units[0], units[-1]):
        raise ValueError(
            f"Estimates must have one unit to be {what}, but {checks.show(units[0])} and {checks.show(units[-1])} "
            "were given; multiply or divide one by a quantity that has the missing unit."
        )
    return units[0]


def _compared(one: SupportsFloat, other: SupportsFloat, how: Callable[[float, float], bool]) -> bool:
    _one_unit(one, other, "compared")
    return how(float(one), float(other))


def _sum(one: SupportsFloat, other: SupportsFloat, sign: str) -> Estimate:
    unit, slope = _one_unit(one, other, "added or subtracted"), 1.0 if sign == "+" else -1.0
    value = float(one) + slope * float(other)
    return _combined(f"{_inside(one)} {sign} {_inside(other)}", value, unit, (1.0, one), (slope, other))


def _product(one: SupportsFloat, other: SupportsFloat) -> Estimate:
    unit = unit_of_product(_unit_of(one), _unit_of(other))
    a, b = float(one), float(other)
    return _combined(f"{_inside(one)} * {_inside(other)}", a * b, unit, (b, one), (a, other))


def _quotient(one: SupportsFloat, other: SupportsFloat) -> Estimate:
    unit = unit_of_product(_unit_of(one), _unit_of(other), -1)
    a, b = float(one), float(other)
    if b == 0 and isinstance(one, Estimate) and not isinstance(other, Estimate):
        raise ZeroDivisionError(f"The estimate {one.name!r} was divided by zero.")
    inverse = 1 / b if b else math.nan
    return _combined(f"{_inside(one)} / {_inside(other)}", a * inverse, unit, (inverse, one), (-a * inverse**2, other))


def _unit_of(other: SupportsFloat) -> str:
    return other.unit if isinstance(other, Estimate) else "1"


def _combined(name: str, value: float, unit: str, *parts: tuple[float, SupportsFloat]) -> Estimate:
    """The estimate `value` with the error that follows from its derivatives by `parts`, (derivative, part) each."""
    slopes: dict[_Source, float] = {}  # the derivatives by the estimates from samples that the parts come from
    estimates = [(slope, part) for slope, part in parts if isinstance(part, Estimate)]
    for slope, part in estimates:
        numbers = float(part.value), float(part.standard_error), part.samples
        itself = {_Source(part.origin, part.name, *numbers, part._shared): 1.0}
        for source, inner in (itself if part._slopes is None else part._slopes).items():
            before, more = slopes.get(source, 0.0), slope * inner
            slopes[source] = 0.0 if abs(before + more) <= _ROUND_OFF * abs(more) else before + more
    slopes = {source: slope for source, slope in slopes.items() if slope != 0}
    if len(name) > _LONGEST_NAME:
        name = f"combination of {len(slopes)} estimates"
    error, samples = _error_and_samples(slopes, min(part.samples for _, part in estimates))
    combined = Estimate(name, value, error, unit, samples)
    object.__setattr__(combined, "_slopes", slopes)
    return combined


def _error_and_samples(slopes: Mapping[_Source, float], fewest: int) -> tuple[float, int]:
    """The standard error of a combination, and one more than its degrees of freedom (Welch 1947), rounded down.

    `fewest`: the samples where there is no error. NaN where two of the sources are of one origin.
    """
    uncertain = {source: slope for source, slope in slopes.items() if source.standard_error != 0}
    if not uncertain:
        return 0.0, fewest
    together: dict[Hashable, list[_Source]] = {}  # those of which the covariance is known
    for source in uncertain:
        together.setdefault(source if source.shared is None else source.shared[0], []).append(source)
    groups = list(together.values())
    if len({sources[0].origin for sources in groups}) < len(groups):
        return math.nan, fewest
    variances = [_variance(sources, uncertain) for sources in groups]
    total = math.fsum(variances)
    if not (math.isfinite(total) and total > 0 and all(source.samples > 1 for source in uncertain)):
        return math.sqrt(total) if total >= 0 else math.nan, fewest
    shares = [variance / total for variance in variances]
    freedom = 1 / sum(share**2 / (sources[0].samples - 1) for share, sources in zip(shares, groups, strict=True))
    return math.sqrt(total), max(2, math.floor(freedom * (1 + 1e-12)) + 1)


def _variance(sources: list[_Source], slopes: Mapping[_Source, float]) -> float:
    """The variance of the sum of some sources times their slopes; of several, the covariance is known."""
    first = sources[0]
    if len(sources) == 1 or first.shared is None:
        return (slopes[first] * first.standard_error) ** 2
    own = [source.shared[1] for source in sources if source.shared is not None]
    weights = np.array([slopes[source] for source in sources])
    covariance = first.shared[0].covariance[np.ix_(own, own)]
    if lost := np.count_nonzero(np.isinf(np.diag(covariance))):
        return math.inf if lost == 1 else math.nan  # several may be determined together, as their ratio
    return max(float(weights @ covariance @ weights), 0.0)


def shared_estimate(
    name: str, value: float, standard_error: float, unit: str, samples: int, origin: Hashable,
    shared: tuple[SharedErrors, int] | None,
) -> Estimate:  # fmt: skip
    """An estimate whose correlation with others from the same samples is known, if it is `shared` with them."""
    estimate = Estimate(name, value, standard_error, unit, samples, origin)
    object.__setattr__(estimate, "_shared", shared)
    return estimate


def correlated_estimates(
    names: Sequence[str], values: Iterable[float], units: Sequence[str], covariance: np.ndarray, samples: int
) -> list[Estimate]:
    """Estimates from the same samples, with their `covariance` (estimates, estimates) in their units."""
    origin, shared = object(), SharedErrors(covariance)
    about = zip(names, values, np.sqrt(np.diag(covariance)), units, strict=True)
    return [
        shared_estimate(name, float(value), float(error), unit, samples, origin, (shared, place))
        for place, (name, value, error, unit) in enumerate(about)
    ]


# What the statistics need of an ensemble, and the check that it is one.


@runtime_checkable
class EnsembleLike(Protocol):
    """The result of `simulate_ensemble`, as far as its statistics use it; see `Ensemble`."""

    @property
    def t1(self) -> float: ...
    @property
    def moments(self) -> Moments: ...
    @property
    def status_counts(self) -> dict[Status, int]: ...
    def finished_sticks(self) -> FlatSticks: ...
    def numbered_sticks(self) -> FlatSticks: ...
    def require_sticks(self) -> FlatSticks: ...


StickSource: TypeAlias = EnsembleLike | FlatSticks
"""An `Ensemble`, or the sticks of many samples themselves."""


Statistic: TypeAlias = Callable[[Any], Estimate]
"""A function of an ensemble's totals, such as `stick_fraction`."""


def require_ensemble(ensemble: object) -> Any:
    """`ensemble` itself, an `Ensemble`. Raises ValueError if it is no result of `simulate_ensemble`."""
    if not hasattr(ensemble, "status_counts") or not hasattr(ensemble, "moments"):
        hint = "a single simulation has .stick_fraction, .sticks and .slips itself"
        if hasattr(ensemble, "of_contact"):
            hint = "of several contacts give one, .of_contact(0), or all together, .of_all_contacts()"
        raise checks.refused("ensemble", "be the result of simulate_ensemble", ensemble, hint)
    return ensemble


def origin_of(ensemble: EnsembleLike) -> Hashable:
    """What the samples of an ensemble have in common with those of others: its key; without one, their own means."""
    key_data = getattr(ensemble, "key_data", None)
    if key_data is not None:
        return tuple(int(word) for word in key_data)
    moments = ensemble.moments
    return ("no key", float(ensemble.t1), int(moments.number), *map(float, moments.mean))


def by_totals(statistic: Statistic, ensemble: object) -> tuple[np.ndarray, Estimate, Callable[[Moments], Estimate]]:
    """The totals of the retained samples, and the estimates from all samples and from other moments of their totals.

    Raises ValueError for an ensemble without sticks, and unless `statistic` is a function that returns an `Estimate`.
    """
    whole = require_ensemble(ensemble)
    whole.finished_sticks()  # refuses an ensemble that has none
    if not callable(statistic) or isinstance(statistic, type):
        raise checks.refused("statistic", "be a function such as stick_fraction or mean_stick_duration", statistic)
    found: object = statistic(whole)
    if not isinstance(found, Estimate):
        raise ValueError(
            "Argument statistic must be a function that returns an Estimate, such as stick_fraction or "
            f"mean_stick_duration, but it returned {checks.show(found)}."
        )
    return whole.retained.totals, found, lambda moments: statistic(dataclasses.replace(whole, moments=moments))


# Confidence intervals by resampling whole samples, for skewed statistics where Student's t is too crude.


_AT_ONCE = 2**22  # random weights: 32 MB


def bootstrap_interval(
    statistic: Statistic, ensemble: EnsembleLike, *, level: float = DEFAULT_LEVEL, resamples: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """The bootstrap-t confidence interval of a statistic at `level` (Efron and Tibshirani 1993, section 12.5).

    Whole samples are drawn with replacement, never single sticks, because the sticks of one sample are dependent. The
    deviation of each resample is divided by the resample's own standard error, which accounts for skewness.

    Args:
        statistic: A function of an ensemble's totals such as `stick_fraction` or `mean_stick_duration`.
        ensemble: An `Ensemble` with ``keep="statistics"`` or ``"sticks"``. The draws are from its retained samples; the
            interval is for all its samples.
        level: The probability that the interval holds the true value.
        resamples: Their number.
        seed: Of the draws.

    Returns:
        The two ends, in the unit of the statistic; NaN, NaN where the statistic or its error is not defined.

    Raises:
        ValueError: For other arguments.
    """
    check_level(level)
    checks.whole_number("resamples", resamples, minimum=100, maximum=10**7)
    totals, whole, estimate_from = by_totals(statistic, ensemble)
    number = len(totals)
    if number < 2 or not whole.standard_error > 0:
        return math.nan, math.nan
    center = estimate_from(Moments.of(totals)).value
    rng = np.random.default_rng(checks.whole_number("seed", seed, minimum=0))
    middle = totals.mean(axis=0)
    rows = totals - middle
    products = (rows[:, :, None] * rows[:, None, :]).reshape(number, -1)
    at_once = max(1, _AT_ONCE // number)
    scores = np.empty(resamples)
    for first in range(0, resamples, at_once):
        weights = rng.multinomial(number, np.full(number, 1 / number), size=min(at_once, resamples - first))
        # How often each resample holds each row: moments of the resamples are sums with these weights.
        means, squares = weights @ rows / number, weights @ products
        for index, (mean, square) in enumerate(zip(means, squares, strict=True), first):
            scatter = square.reshape(len(mean), -1) - number * np.outer(mean, mean)
            one = estimate_from(Moments(number, middle + mean, scatter))
            scores[index] = (one.value - center) / one.standard_error if one.standard_error > 0 else math.nan
    if not np.any(np.isfinite(scores)):  # all samples are the same
        return math.nan, math.nan
    low, high = np.nanquantile(scores, ((1 + level) / 2, (1 - level) / 2))
    return whole.value - float(low) * whole.standard_error, whole.value - float(high) * whole.standard_error
