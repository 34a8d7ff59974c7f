"""Tests of independence and of identical distribution, combined into one verdict, and the values that they take."""

import dataclasses
import itertools
import math
import warnings
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import Float, Int
from scipy import optimize, stats

from .._dynamics.sticks import FlatSticks
from .._foundation import checks
from .._foundation.types import Ending
from .distribution import wrapped
from .estimate import StickSource
from .quantities import IN_A_CYCLE, MOST_ORDERS, TESTED, TestedQuantity

# Values of a quantity in order of time within each sample, without the bias from the end of the simulation.
#
# The simulation ends at t1 and cuts the stick or slip that is under way. One that begins shortly before t1 is complete
# only if it is short. So the complete ones alone are too short on average, more so the later they come in order, and a
# long one leaves less time for the next. Tests would take both for a drift of the distribution, or for dependence. All
# sticks, or slips, that begin before ``t1 - L`` are known up to the length L, and whether one begins before a given
# instant depends on what happened earlier, not on its own duration. L is the longest one, but at most half of the time:
# the more samples, the longer the longest, until nothing would be left. What lasts longer is censored at L for all
# orders alike, so that the tests for complete values hold. (Tests that take values censored at different times, such as
# the log-rank test, would use the sticks after ``t1 - L`` too, but find differences of hazards in proportion only.)


class Sequences(NamedTuple):
    """The values of one quantity, sample after sample, those of a sample in order of time.

    - `values`: (values,). `first`, `count`: index of each sample's first value, and its number of values, (samples,).
    - `remark`: a sentence that says how many values were used and left out.
    """

    values: Float[np.ndarray, " values"]
    first: Int[np.ndarray, " samples"]
    count: Int[np.ndarray, " samples"]  # pyright: ignore[reportIncompatibleMethodOverride] - the name in CF conventions
    remark: str


def sequences_of(source: StickSource, quantity: str, starts_before: float | None) -> Sequences:
    """The values of `quantity` that begin before `starts_before` (s; None: ``t1 - L``, as explained above).

    Arguments, and errors raised, as in `identically_distributed`.
    """
    checks.chosen("quantity", quantity, TESTED)
    if not (isinstance(starts_before, float) and starts_before == math.inf) and starts_before is not None:
        checks.numeric("starts_before", starts_before)
    given: object = source if isinstance(source, FlatSticks) else getattr(source, "numbered_sticks", lambda: None)()
    if not isinstance(given, FlatSticks):
        raise ValueError(
            "Argument source must be the result of simulate_ensemble or its flat_sticks, "
            f"but {type(source).__name__} was given."
        )
    shapes = [np.shape(column) for column in (*given.numbers, given.ending)]
    if any(shape != (given.count.sum(),) for shape in shapes):
        raise ValueError(
            f"Argument source must have as many sticks as its counts add up to, {given.count.sum()}, "
            f"but arrays of shapes {', '.join(map(str, shapes))} were given."
        )
    if not (np.all(np.isfinite(given.start)) and np.all(np.isfinite(given.end))):
        raise ValueError("Argument source must have finite starts and ends, but some are NaN or infinite.")
    sticks = given._replace(count=given.count.astype(np.int64), numbers=given.numbers.astype(np.float64))
    horizon, owner = float(np.max(sticks.end, initial=0.0)), sticks.sample
    values, begin, length, longest, exists, complete = _known(sticks, quantity, horizon)
    # However many samples there are, half of the time is left. What lasts longer than the other half counts as that; or
    # where something else is asked that is known only after it, it is left out, of all orders alike.
    limit = min(float(longest), horizon / 2) if starts_before is None else math.inf
    before = horizon - limit if starts_before is None else float(starts_before)
    lasts_long = exists & (begin < before) & (length > limit)
    if quantity in ("duration", "slip_duration"):
        used, values = exists & (begin < before) & (complete | lasts_long), np.minimum(values, limit)
    else:
        used = complete & (begin < before) & ~lasts_long
    values = values[used]
    if not np.all(np.isfinite(values)):
        raise ValueError(f"Argument source must have finite {plural(quantity)}, but some are NaN or infinite.")
    # Rounded to multiples of a power of two that is at least 256 times the round-off: in periodic motion all sticks are
    # equally long up to that, and tests by rank would find a pattern in it.
    is_time = quantity in ("duration", "slip_start", "slip_duration")
    scale = horizon if is_time else np.max(np.abs(values), initial=0.0)
    if error := scale * float(np.finfo(given.numbers.dtype).eps):
        grid = math.ldexp(1.0, math.frexp(256 * error)[1])
        values = grid * np.round(values / grid)
    count = np.bincount(owner[used], minlength=len(sticks.count))
    remark = f"Used {len(values)} {plural(quantity)}"
    if left := int(exists.sum()) - len(values):
        late = "" if before == math.inf else f"begin at {max(before, 0):.4g} s or later, or "
        remark += f"; left out {left}, which {late}are cut by the end of the simulation"
    if long := int(lasts_long.sum()):
        what = "count as that" if quantity in ("duration", "slip_duration") else "are left out with what follows them"
        remark += f"; {long} that last longer than {limit:.4g} s {what}"
    return Sequences(values, np.cumsum(count) - count, count, remark + ".")


def _known(sticks: FlatSticks, quantity: str, horizon: float) -> tuple[Any, ...]:
    """The values of a quantity, each known from a stick or slip: the values; when that begins; how long it lasts; the
    longest such one; whether there is such a value; and whether the simulation did not cut it.
    """
    owner, start, end = sticks.sample, sticks.start, sticks.end
    # The slip after each stick. That after the last one of a sample is cut; there is none if that stick itself was cut.
    is_cut, is_last = sticks.ending == Ending.HORIZON, np.diff(owner, append=-1) != 0
    slips = ~(is_last & is_cut)
    slip = np.where(slips, np.where(is_last, horizon, np.append(start[1:], 0.0)) - end, 0.0)
    longest = np.max(slip, initial=0.0)
    if quantity == "slip_duration":  # from the slip itself
        return slip, end, slip, longest, slips, ~is_last
    if quantity not in ("duration", "slip_start"):  # known when the stick starts: from the slip before
        begin, every = np.where(np.diff(owner, prepend=-1) != 0, 0.0, np.roll(end, 1)), np.ones(len(start), bool)
        return getattr(sticks, quantity), begin, start - begin, longest, every, every
    duration, complete = sticks.duration, ~is_cut
    longest = np.max(duration, initial=0.0)
    if quantity == "slip_start":  # from the stick before the slip
        return end, start, duration, longest, complete, complete
    return duration, start, duration, longest, np.ones(len(start), bool), complete


def plural(quantity: str) -> str:
    """A tested quantity in sentences: "stick durations"."""
    label = TESTED[quantity].label
    return f"values of the {label}" if label.endswith("the stick") else f"{label}s"


# The Anderson-Darling test of k samples, with p-values of any size.
#
# Scholz and Stephens 1987, Journal of the American Statistical Association 82, 918. The statistic is scipy's. Tables of
# critical values, as there, end at 0.25 and 0.001; here the p-value is computed from the limiting distribution itself.


def anderson_darling(groups: list[np.ndarray]) -> tuple[float, float]:
    """Normalised statistic and p-value for two or more groups of values, arrays (n_i,) of at least 5 each.

    Ties count by midranks. The statistic is standardised by its exact mean and variance for these group sizes, then
    compared with the limiting distribution, standardised likewise. If all values are equal the result is (0, 1).
    """
    values, degrees = np.concatenate(groups), len(groups) - 1
    if np.all(values == values[0]):
        return 0.0, 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of its p-value, which ends at 0.25 and 0.001
        normalized = float(cast(Any, stats.anderson_ksamp(groups)).statistic)
    # The limit is sum_j X_j / (j (j + 1)), X_j chi-square of k - 1 degrees: mean k - 1, variance below.
    limit_deviation = math.sqrt(2 * degrees * (math.pi**2 / 3 - 3))
    return normalized, limit_tail(degrees + normalized * limit_deviation, degrees)


def limit_tail(x: float, degrees: int) -> float:
    """P(Q > x) for ``Q = sum over j >= 1 of X_j / (j (j + 1))``, X_j independent chi-square variables of `degrees`.

    Q has the moment generating function ``M(s) = (-2 pi s / cos(pi q / 2))^(degrees / 2)``, ``q = sqrt(1 + 8 s)``
    (Anderson and Darling 1952, Annals of Mathematical Statistics 23, 193), with its singularities on s >= 1. So
    ``P(Q > x) = 1 / (2 pi i) int M(s) exp(-s x) / s ds`` along the parabola ``s = 1 - (a - i u)^2`` around them, on
    which the integrand falls off like exp(-x u^2): the trapezoidal rule then gives nearly all digits, in the tail too.
    """
    if x <= 0.05 * degrees:  # P(Q <= x) is below 1e-8 there, and the integrand falls off slowly
        return 1.0

    def slope(c):  # derivative of the logarithm of the integrand on the real axis
        q = math.sqrt(1 + 8 * c)
        return degrees / 2 * (1 / c + 2 * math.pi * math.tan(math.pi * q / 2) / q) - x - 1 / c

    # The parabola crosses the axis where the integrand is smallest there, so that little cancels.
    saddle = np.asarray(optimize.brentq(slope, 1e-6, 1 - 1e-12), float).item()
    root, step = math.sqrt(1 - saddle), math.sqrt((50 + 2 * degrees) / x) / 400
    one_step = root - 1j * step * np.arange(401)
    s = 1 - one_step**2
    ratio = -2 * math.pi * s / np.cos(math.pi / 2 * np.sqrt(1 + 8 * s))
    logarithm = degrees / 2 * (np.log(np.abs(ratio)) + 1j * np.unwrap(np.angle(ratio))) - s * x
    integrand = (np.exp(logarithm) / s * 2j * one_step).imag
    return float(np.clip((integrand.sum() - integrand[0] / 2) * step / math.pi, 0, 1))


# Several hypothesis tests combined into one answer, with a bound on the probability of any false rejection.


@dataclasses.dataclass(frozen=True, repr=False)
class HypothesisTest:
    """One test of one hypothesis.

    - `name`: of the test, with the orders or bins it used. `statistic`: its value; the function that made the test says
      which statistic.
    - `p_value`: probability of a statistic at least as extreme if the hypothesis holds; NaN if there was no test.
    - `effect`: size of the deviation from the hypothesis, in the measure `effect_name`; unlike the p-value it does not
      shrink with the number of samples. `effect_error`: its standard error, NaN where none is given.
    - `sizes`: number of values, or pairs of values, in each group.
    - `reason`: why the test could not be made, else empty.
    - `parts`: the tests that this one combines; its p-value is then the smallest of theirs, adjusted by Holm's method.
    """

    name: str
    statistic: float = math.nan
    p_value: float = math.nan
    effect: float = math.nan
    effect_name: str = ""
    effect_error: float = math.nan
    sizes: tuple[int, ...] = ()
    reason: str = ""
    parts: "tuple[HypothesisTest, ...]" = ()

    @property
    def made(self) -> bool:
        """Whether there is a p-value."""
        return not math.isnan(self.p_value)

    @property
    def smallest_p_value(self) -> float:
        """The smallest p-value of its `parts`, not adjusted; its own where it has none."""
        return min((part.p_value for part in self.parts), default=self.p_value)

    def line(self, adjusted: float | None = None) -> str:
        """The test on one line; `adjusted` is its p-value adjusted for all tests made with it."""
        if not self.made:
            return f"{self.name}: not made, {self.reason}"
        error = "" if math.isnan(self.effect_error) else f" +- {self.effect_error:.2g}"
        own = _shown(self.p_value)
        if self.parts:
            own = f"smallest {_shown(self.smallest_p_value)}, adjusted for its {len(self.parts)} tests {own}"
        together = "" if adjusted is None else f", adjusted for all tests {_shown(adjusted)}"
        return f"{self.name}: {own}{together}; {self.effect_name} {self.effect:.3g}{error}"

    def __repr__(self) -> str:
        return self.line()


@dataclasses.dataclass(frozen=True, repr=False)
class Verdict:
    """The answer to one question, by one or several tests.

    - `question`: in words. `significance`: largest probability that any test rejects a true hypothesis.
    - `tests`: in the order in which the docstring of the function names them.
    - `samples`: number of samples given. `values`: number of values of the quantity used.
    - `reason`: why nothing can be decided, else empty.
    - `remarks`: sentences on which values were used and which were left out.
    """

    question: str
    significance: float
    tests: tuple[HypothesisTest, ...]
    samples: int
    values: int
    reason: str = ""
    remarks: tuple[str, ...] = ()

    @property
    def adjusted_p_values(self) -> tuple[float, ...]:
        """The p-value of each test, adjusted by Holm's method (see `holm`); NaN for tests that could not be made."""
        return holm([test.p_value for test in self.tests])

    @property
    def p_value(self) -> float:
        """The smallest of the adjusted p-values; NaN if no test was made.

        It answers the question as a whole. Near 1 it says no more than that no test found anything: each test's own
        ``tests[i].p_value`` is what is spread evenly from 0 to 1 where the hypothesis holds.
        """
        return min((p for p in self.adjusted_p_values if not math.isnan(p)), default=math.nan)

    @property
    def rejected(self) -> bool | None:
        """True: rejected at this significance. False: no evidence against it. None: not decided, for `reason`."""
        if self.p_value <= self.significance:
            return True
        return None if self.reason else False

    def __repr__(self) -> str:
        level = f"at the {100 * self.significance:g} % level"
        answers = {
            True: f"Rejected {level}.",
            False: f"No evidence against it {level}.",
            None: f"Not decided: {self.reason}.",
        }
        answer = answers[self.rejected]
        rows = [test.line(p) for test, p in zip(self.tests, self.adjusted_p_values, strict=True)]
        told = [wrapped(row, "  ", "    ") for row in (*rows, *self.remarks)]
        return "\n".join([wrapped(f"{self.question} {answer}", "", "    "), *told])


def _shown(p_value: float) -> str:
    return "p < 1e-300" if p_value < 1e-300 else f"p = {p_value:.2g}"


def holm(p_values: Sequence[float] | np.ndarray) -> tuple[float, ...]:
    """P-values adjusted for several tests: rejecting those up to ``a`` is wrong with probability at most ``a``.

    Holm's method (1979, Scandinavian Journal of Statistics 6, 65): the i-th smallest of n p-values is multiplied by
    n - i + 1, and is at least as large as the adjusted one before it.

    Args:
        p_values: Numbers in [0, 1]; NaN (no test) stays NaN.
    """
    given = np.array(p_values, float)
    adjusted = np.full(given.shape, np.nan)
    order = np.argsort(given)[: np.count_nonzero(~np.isnan(given))]  # NaN are sorted to the end
    adjusted[order] = np.minimum(np.maximum.accumulate(np.arange(len(order), 0, -1) * given[order]), 1)
    return tuple(float(p) for p in adjusted)


def check_significance(significance: float) -> None:
    """Raise ValueError unless `significance` is a number between 0 and 1."""
    checks.numeric("significance", significance)
    if not 0 < significance < 1:
        raise checks.refused("significance", "lie between 0 and 1", significance)


# Test whether the values of the first, second, third, ... stick of a motion are identically distributed.


FEWEST_VALUES = 5
"""Smaller groups are left out: their Anderson-Darling statistic is still far from its limiting distribution."""


def identically_distributed(
    source: StickSource,
    quantity: TestedQuantity = "duration",
    *,
    orders: int | Iterable[int] = 5,
    significance: float = 0.05,
    starts_before: float | None = None,
) -> Verdict:
    """Test whether the values of all orders (first, second and so on in a sample) have the same distribution.

    Sample i gives its value of one order only, the one with index i modulo the number of orders. So all values that are
    compared come from different samples and are independent, whatever the dependence within a sample. The question is
    that of Lima and Sampaio (2017, introduction).

    The tests: that of Anderson and Darling on all orders at once (statistic: normalised; effect: the largest difference
    between the means of two orders, in standard deviations within an order); then that of Kolmogorov and Smirnov on
    every pair of orders, by Holm's method (effect: the largest distance between two distribution functions; `parts`
    holds the test of each pair). Orders for which fewer than 5 samples give a value are left out; the answer is None if
    fewer than two remain. Values that are all equal, as in periodic motion, are identically distributed; differences of
    a few hundred rounding errors are ignored.

    Args:
        source: An `Ensemble` with ``keep="statistics"`` (its retained samples) or ``"sticks"``, or its ``flat_sticks``.
            Which stick of an ensemble is the first is set by its ``count_initial_rest``; of ``flat_sticks`` all are
            numbered.
        quantity: "duration" of the sticks (s), "position" of the mass at their start (m), "slip_duration", that of the
            slip after each stick (s); or the instants "start" and "slip_start" at which a stick, or the slip after it,
            begins (s). Instants increase with the order, so they are neither identically distributed nor independent;
            tests on them show by how much.
        orders: Their number, from the first on, or a sequence of at least two different ones.
        significance: Largest probability, in (0, 1), of rejecting a true hypothesis.
        starts_before: Only values that begin before this instant (s) are used; a position begins with the slip before
            it. By default the end of the simulation minus the longest value, so that none is cut, but not before its
            middle: what lasts longer than half of the time counts as that half. With ``math.inf`` all complete values
            are used; these are too short on average, more so for later orders, and the tests detect it if many are cut.

    Raises:
        ValueError: For another source, an ensemble that kept only totals, and arguments outside these bounds.
    """
    check_significance(significance)
    wanted = _orders(orders)
    sequences = sequences_of(source, quantity, starts_before)
    samples = len(sequences.count)
    member = np.arange(samples) % len(wanted)
    order = np.array(wanted)[member]
    has = sequences.count >= order
    at = sequences.first + order - 1
    groups = [sequences.values[at[has & (member == index)]] for index in range(len(wanted))]
    kept = {order: group for order, group in zip(wanted, groups, strict=True) if len(group) >= FEWEST_VALUES}
    remarks = [sequences.remark, f"Each of the {samples} samples gives a value of one order; {has.sum()} have one."]
    if left := [str(order) for order in wanted if order not in kept]:
        remarks.append(f"Orders left out, with fewer than {FEWEST_VALUES} values: {', '.join(left)}.")
    reason = ""
    if len(kept) < 2:
        need, fewer = FEWEST_VALUES * len(wanted), f"; orders=2 needs {2 * FEWEST_VALUES}" * (len(wanted) > 2)
        reason = f"needs {FEWEST_VALUES} samples for each of {len(wanted)} orders, {need}; {samples} given{fewer}"
        if samples >= need:
            reason = f"two orders need {FEWEST_VALUES} values; {has.sum()} of {samples} samples have a value of theirs"
        tests = tuple(HypothesisTest(name, reason=reason) for name in ("Anderson-Darling", "Kolmogorov-Smirnov"))
    else:
        tests = (_all_at_once(kept), _by_pairs(kept))
    question = f"Are the {plural(quantity)} of all orders identically distributed?"
    return Verdict(question, significance, tests, samples, len(sequences.values), reason, tuple(remarks))


def _orders(orders: Any) -> tuple[int, ...]:
    if not hasattr(orders, "__len__") or checks.dimensions(orders) == 0:
        return tuple(range(1, checks.whole_number("orders", orders, minimum=2, maximum=MOST_ORDERS) + 1))
    if isinstance(orders, (bytes, bytearray)):
        raise checks.refused("orders", "be whole numbers", orders)
    few = orders[: MOST_ORDERS + 1]
    chosen = sorted({checks.whole_number(f"orders[{at}]", order) for at, order in enumerate(few)})
    if not 2 <= len(chosen) == len(orders):
        raise checks.refused("orders", "hold at least two different whole numbers", orders)
    return tuple(chosen)


def _all_at_once(groups: dict[int, np.ndarray]) -> HypothesisTest:
    statistic, p_value = anderson_darling(list(groups.values()))
    sizes = np.array([len(group) for group in groups.values()])
    means = np.array([group.mean() for group in groups.values()])
    # Less the first value, so that a group of equal values has the deviation 0 exactly.
    squares = sum(len(group) * (group - group[0]).var() for group in groups.values())
    deviation = math.sqrt(squares / (sizes.sum() - len(sizes)))
    spread = float(np.ptp(means))
    effect = spread / deviation if deviation > 0 else math.copysign(math.inf, spread) if spread else 0.0
    return HypothesisTest(
        f"Anderson-Darling, orders {', '.join(map(str, groups))}", statistic, p_value, effect,
        "largest difference of means (in standard deviations)", sizes=tuple(sizes.tolist()),
    )  # fmt: skip


def _by_pairs(groups: dict[int, np.ndarray]) -> HypothesisTest:
    pairs = []
    for (a, first), (b, second) in itertools.combinations(groups.items(), 2):
        # The cost of the exact distribution is the product of the sizes; the limiting one is close beyond 100 each.
        method = "exact" if len(first) * len(second) <= 10_000 else "asymp"
        with warnings.catch_warnings():
            # Where round-off takes an exact p-value above 1, scipy warns and takes the limiting one, also about 1.
            warnings.simplefilter("ignore", RuntimeWarning)
            distance, p_value = np.asarray(stats.ks_2samp(first, second, method=method), float).tolist()
        name, sizes = f"Kolmogorov-Smirnov, orders {a} and {b}", (len(first), len(second))
        pairs.append(HypothesisTest(name, distance, p_value, distance, "distance", sizes=sizes))
    farthest = max(pairs, key=lambda pair: pair.effect)
    return HypothesisTest(
        f"Kolmogorov-Smirnov, {len(pairs)} pairs of orders", farthest.statistic,
        min(holm([pair.p_value for pair in pairs])), farthest.effect, "largest distance",
        sizes=tuple(len(group) for group in groups.values()), parts=tuple(pairs),
    )  # fmt: skip


# Tests whether values that follow each other, of one quantity or two, are independent; and identically distributed.


FEWEST_PAIRS = 10
"""The least number of pairs, or of samples that have pairs, for a test of independence."""
FEWEST_EXPECTED = 5
"""Smallest expected count in a cell of the chi-square test (Cochran's rule)."""


_MOST = 10**6  # of the order of a value


def independent(
    source: StickSource,
    quantity: TestedQuantity | tuple[TestedQuantity, TestedQuantity] = "duration",
    *,
    lag: int = 1,
    first: int = 1,
    bins: int = 5,
    significance: float = 0.05,
    starts_before: float | None = None,
) -> Verdict:
    """Test whether values of one sample that follow each other are independent: of one quantity, or one of each of two.

    The tests; none of them takes a drift of the distribution with the order for dependence:

    1. Spearman's rank correlation of the values of orders `first` and ``first + lag``, one pair from each sample that
       has both. The pairs are independent, so the p-value (Student's t) holds whatever the dependence within a sample.
    2. Chi-square of the same pairs in a table of `bins` x `bins` quantiles (of all values, or of each quantity of two);
       effect: Cramer's V. With few pairs there are fewer bins, and neighbouring bins are joined until the expected
       count of each cell is at least 5. Finds dependence without correlation.
    3. Serial rank correlation: all pairs of all samples from `first` on, ranked among the pairs of the same orders.
       Pairs of one sample may be dependent, so the variance is that of sums over samples (statistic: Student's t with
       one degree of freedom fewer than there are samples with pairs). Also finds a factor that all values of a sample
       share.

    A test needs 10 pairs (the third: 10 samples with pairs) and values that are not all equal; the answer is None if no
    test could be made.

    Args:
        source: An `Ensemble` with ``keep="statistics"`` (its retained samples) or ``"sticks"``, or its ``flat_sticks``.
        quantity: One of "duration", "position", "slip_duration", "start" and "slip_start": do its values depend on each
            other? Or two, the earlier first:
            ``("duration", "slip_duration")`` asks whether a stick and the slip after it are independent, and
            ``("slip_duration", "duration")`` whether a slip and the stick after it are.
        lag: 1 pairs each value with the next, 2 with the one after that, and so on.
        first: Order of the first value that counts as the earlier one. The first two tests take this pair of each
            sample, the third this one and all later.
        bins: Number of quantile bins of each value in the chi-square test, at least 2.
        significance: Largest probability, in (0, 1), of rejecting a true hypothesis.
        starts_before: Only pairs whose later value begins before this instant (s) are used; by default the end of the
            simulation minus the longest value, or its middle. That depends on the earlier value: it does not make
            independent values dependent, but where they are, fewer long ones remain, which makes the effect smaller;
            without it (``math.inf``) a long value leaves less time for the next.

    Raises:
        ValueError: As `identically_distributed`.
    """
    check_significance(significance)
    lag, first = checks.whole_number("lag", lag, maximum=_MOST), checks.whole_number("first", first, maximum=_MOST)
    bins = checks.whole_number("bins", bins, minimum=2, maximum=1000)
    earlier, later = quantity if isinstance(quantity, tuple) and len(quantity) == 2 else (quantity, quantity)
    sources = [sequences_of(source, earlier, starts_before)]
    alike = earlier == later
    if not alike:
        sources.append(sequences_of(source, later, starts_before))
    # The next of the other kind may belong to the same stick.
    shift = lag - (IN_A_CYCLE.index(earlier) < IN_A_CYCLE.index(later))
    # All pairs of an earlier and a later value, sample after sample, those of a sample in order of time.
    counts = np.maximum(np.minimum(sources[0].count, sources[-1].count - shift) - first + 1, 0)
    order = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + first  # of the earlier one
    early, late = (
        one.values[np.repeat(one.first, counts) + order - 1 + ahead]
        for one, ahead in ((sources[0], 0), (sources[-1], shift))
    )
    names = f"{TESTED[earlier].label} {first} and {TESTED[later].label} {first + shift}"
    apart = "them" if lag == 1 else f"{lag} apart"
    question = f"Are the {plural(earlier)} independent of the {plural(later)} that follow {apart}?"
    if alike:
        names = f"orders {first} and {first + shift}"
        question = f"Are the {plural(earlier)}, {'consecutive' if lag == 1 else apart}, independent?"

    # The pair of each sample that comes first, for two tests.
    one_each = order == first
    tests = (
        *_tests_of_pairs(early[one_each], late[one_each], names, bins, alike),
        serial_correlation(early, late, order, counts),
    )
    reason = "" if any(test.made for test in tests) else tests[0].reason
    having = f"{one_each.sum()} of {len(counts)} samples have {'values of ' * alike}{names}."
    values = sum(len(one.values) for one in sources)
    remarks = (*dict.fromkeys(one.remark for one in sources), having)
    return Verdict(question, significance, tests, len(counts), values, reason, remarks)


def independent_and_identical(
    source: StickSource,
    quantity: TestedQuantity = "duration",
    *,
    orders: int | Iterable[int] = 5,
    lag: int = 1,
    first: int = 1,
    significance: float = 0.05,
    starts_before: float | None = None,
) -> Verdict:
    """Test whether the values are independent and identically distributed, by all tests of both properties.

    The tests are those of `identically_distributed`, then those of `independent`. The probability that any of the five
    rejects a true hypothesis is at most `significance`, by Holm's method. The answer is None if nothing is rejected and
    one of the two questions cannot be decided. Question: Lima and Sampaio 2017, introduction.

    Args:
        source: An `Ensemble` with ``keep="statistics"`` (its retained samples) or ``"sticks"``, or its ``flat_sticks``.
        quantity: "duration" of the sticks (s), "position" of the mass at their start (m), "slip_duration" (s), or the
            instants "start" and "slip_start" (s).
        orders: Those whose distributions are compared: their number, from the first on, or a sequence of them.
        lag: Which values are paired: 1 each with the next, 2 with the one after that, and so on.
        first: Order of the first value that counts as the earlier one of a pair.
        significance: Largest probability, in (0, 1), of rejecting a true hypothesis.
        starts_before: Only values that begin before this instant (s) are used; by default the end of the simulation
            minus the longest value, or its middle.

    Raises:
        ValueError: For what either of the two refuses.
    """
    options = {"significance": significance, "starts_before": starts_before}
    parts = (
        identically_distributed(source, quantity, orders=orders, **options),
        independent(source, quantity, lag=lag, first=first, **options),
    )
    tests = tuple(test for part in parts for test in part.tests)
    remarks = tuple(dict.fromkeys(remark for part in parts for remark in part.remarks))
    reason = "; ".join(dict.fromkeys(part.reason for part in parts if part.reason))
    question = f"Are the {plural(quantity)} independent and identically distributed?"
    return Verdict(question, significance, tests, parts[0].samples, parts[0].values, reason, remarks)


def _tests_of_pairs(
    early: np.ndarray, late: np.ndarray, names: str, bins: int, pooled: bool
) -> tuple[HypothesisTest, HypothesisTest]:
    """Spearman's and the chi-square test of independent pairs.

    The latter counts pairs in quantile bins, pooled or of each side, joined until cells expect enough. Which bins are
    joined depends only on the sums over rows and columns, which carry no information on dependence.
    """
    spearman, chi_square, sizes, reason = f"Spearman, {names}", "Chi-square", (len(early),), ""
    if len(early) < FEWEST_PAIRS:
        reason = f"fewer than {FEWEST_PAIRS} samples have such a pair"
    elif np.ptp(early) == 0 or np.ptp(late) == 0:
        reason = "all values of one order are equal"
    if reason:
        none = HypothesisTest(spearman, sizes=sizes, reason=reason)
        return none, dataclasses.replace(none, name=chi_square)
    correlation, p_value = np.asarray(stats.spearmanr(early, late), float).tolist()
    of_ranks = HypothesisTest(spearman, correlation, p_value, correlation, "rank correlation", sizes=sizes)

    bins = max(2, min(bins, math.isqrt(len(early) // FEWEST_EXPECTED)))
    both = np.concatenate([early, late])
    sides = ((both, early), (both, late)) if pooled else ((early, early), (late, late))
    edges = [np.unique(np.quantile(of, np.arange(1, bins) / bins)) for of, _ in sides]
    place = [np.searchsorted(own, values, "left") for own, (_, values) in zip(edges, sides, strict=True)]
    shape = [len(own) + 1 for own in edges]
    table = np.bincount(place[0] * shape[1] + place[1], minlength=shape[0] * shape[1]).reshape(shape)
    while min(table.shape) >= 2:
        sums = table.sum(axis=1), table.sum(axis=0)
        if sums[0].min() * sums[1].min() >= FEWEST_EXPECTED * len(early):
            break
        axis = int(sums[1].min() < sums[0].min())
        if table.shape[axis] == 2 < table.shape[1 - axis]:
            axis = 1 - axis
        smallest = int(sums[axis].argmin())
        beside = [at for at in (smallest - 1, smallest + 1) if 0 <= at < len(sums[axis])]
        start = min(smallest, min(beside, key=lambda at: sums[axis][at]))
        table = np.add.reduceat(table, [at for at in range(len(sums[axis])) if at != start + 1], axis=axis)
    chi_square = f"Chi-square, {table.shape[0]} x {table.shape[1]} quantile bins"
    if min(table.shape) < 2:
        reason = f"a cell would expect fewer than {FEWEST_EXPECTED}"
        return of_ranks, HypothesisTest(chi_square, sizes=sizes, reason=reason)
    statistic, p_value = np.asarray(stats.chi2_contingency(table, correction=False)[:2], float).tolist()
    cramer = math.sqrt(statistic / (table.sum() * (min(table.shape) - 1)))
    return of_ranks, HypothesisTest(chi_square, statistic, p_value, cramer, "Cramer's V", sizes=sizes)


def serial_correlation(early: np.ndarray, late: np.ndarray, order: np.ndarray, counts: np.ndarray) -> HypothesisTest:
    """Rank correlation of all pairs, ranked separately for each order; its error from sums over samples.

    `early`, `late`, `order` of the former: (pairs,). `counts`: the number of pairs of each sample.
    """
    having = counts > 0
    pairs, samples = int(counts.sum()), int(having.sum())
    name, sizes = f"Serial rank correlation, {pairs} pairs in {samples} samples", (pairs, samples)
    if samples < FEWEST_PAIRS:
        return HypothesisTest(name, sizes=sizes, reason=f"fewer than {FEWEST_PAIRS} samples have such a pair")
    a, b = _scores(early, order), _scores(late, order)
    norms = math.sqrt(a @ a), math.sqrt(b @ b)
    if min(norms) == 0:
        return HypothesisTest(name, sizes=sizes, reason="all values of one order are equal")
    a, b = a / norms[0], b / norms[1]
    correlation = float(a @ b)
    begin = (np.cumsum(counts) - counts)[having]  # of the pairs of each sample

    # If the values are independent, sums over samples are uncorrelated and have the mean 0, so that the sum of their
    # squares estimates the variance. The factor n / (n - 1) is that of the variance of Spearman's correlation of n
    # pairs, over the mean of a^2 b^2: ranks add up to zero.
    number = np.bincount(order)[order]
    shares = np.add.reduceat(a * b * np.sqrt(number / np.maximum(number - 1, 1)), begin)
    # z = sum / sqrt(sum of squares) of n shares is Student's t of the same shares but for this change of scale.
    z = correlation / math.sqrt(shares @ shares) if correlation else 0.0
    rest = samples - z * z
    statistic = z * math.sqrt((samples - 1) / rest) if rest > 0 else math.copysign(math.inf, z)
    p_value = 2 * float(stats.t.sf(abs(statistic), samples - 1))

    # r = sum(a b) / sqrt(sum(a^2) sum(b^2)), both roots being 1 now, changes with the weight of one sample by its part
    # of sum(a b) - r (sum(a^2) + sum(b^2)) / 2, which holds for dependent values, too.
    parts = np.add.reduceat(a * b - correlation * (a**2 + b**2) / 2, begin)
    error = math.sqrt(samples / (samples - 1) * float(parts @ parts))
    return HypothesisTest(name, statistic, p_value, correlation, "rank correlation", error, sizes)


def _scores(values: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Rank of each value among those of its order, midranks for ties, centred and scaled to (-1, 1)."""
    by_value = np.argsort(values)
    small = order.astype(np.uint16) if order.max() < 1 << 16 else order  # 16-bit numbers are sorted by radix
    sorting = by_value[np.argsort(small[by_value], kind="stable")]
    order, values = order[sorting], values[sorting]
    changes = np.diff(order) != 0
    number = np.bincount(order)
    place = np.arange(len(order)) - (np.cumsum(number) - number)[order]
    # Runs of equal values of one order share the mean of their places.
    runs = np.concatenate([[0], np.flatnonzero(changes | (np.diff(values) != 0)) + 1])
    length = np.diff(np.append(runs, len(order)))
    middle = np.repeat(place[runs] + (length - 1) / 2, length)
    scores = np.empty(len(order))
    scores[sorting] = (2 * middle + 1) / number[order] - 1
    return scores
