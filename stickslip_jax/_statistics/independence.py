"""Tests whether values that follow each other, of one quantity or two, are independent; and identically distributed."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy import stats

from .. import _checks
from .complete_values import plural, sequences_of
from .identical import identically_distributed
from .quantities import IN_A_CYCLE, TESTED, TestedQuantity
from .source import StickSource
from .verdicts import HypothesisTest, Verdict, check_significance

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
    2. Chi-square of the same pairs in a table of `bins` x `bins` quantiles (of one quantity: pooled, of two: of each);
       effect: Cramer's V. With few pairs there are fewer bins, and neighbouring bins are joined until the expected
       count of each cell is at least 5. Finds dependence without correlation.
    3. Serial rank correlation: all pairs of all samples from `first` on, ranked among the pairs of the same orders.
       Pairs of one sample may be dependent, so the variance is that of sums over samples (statistic: Student's t with
       one degree of freedom fewer than there are samples with pairs). Also finds a factor that all values of a sample
       share.

    A test needs 10 pairs (the third: 10 samples with pairs) and values that are not all equal; the answer is None if no
    test could be made.

    Args:
        source: As in `identically_distributed`.
        quantity: One as in `identically_distributed`: do its values depend on each other? Or two, the earlier first:
            ``("duration", "slip_duration")`` asks whether a stick and the slip after it are independent, and
            ``("slip_duration", "duration")`` whether a slip and the stick after it are.
        lag: 1 pairs each value with the next, 2 with the one after that, and so on.
        first: Order of the first value that counts as the earlier one. The first two tests take this pair of each
            sample, the third this one and all later.
        bins: Number of quantile bins of each value in the chi-square test, at least 2.
        significance: As in `identically_distributed`.
        starts_before: As there, for the later value of a pair. That depends on the earlier value, but does not make
            independent values dependent; without it (``math.inf``) a long value leaves less time for the next.

    Raises:
        ValueError: As `identically_distributed`.
    """
    check_significance(significance)
    lag, first = _checks.whole_number("lag", lag, maximum=_MOST), _checks.whole_number("first", first, maximum=_MOST)
    bins = _checks.whole_number("bins", bins, minimum=2, maximum=1000)
    earlier, later = quantity if isinstance(quantity, tuple) and len(quantity) == 2 else (quantity, quantity)
    pairs, remarks, values = _pairs(source, (earlier, later), lag, first, starts_before)
    at = np.flatnonzero(pairs.order == first)
    early, late = pairs.early[at], pairs.late[at]
    chi_square = _chi_square(early, late, bins, pooled=earlier == later)
    tests = (_spearman(early, late, pairs.names), chi_square, _serial(pairs))
    reason = "" if any(test.made for test in tests) else tests[0].reason
    given = len(pairs.count)
    remarks = (*remarks, f"{len(at)} of {given} samples have {'values of ' * (earlier == later)}{pairs.names}.")
    asked = _question(earlier, later, lag)
    return Verdict(asked, significance, tests, given, values, reason, remarks)


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

    Arguments as for `identically_distributed` and `independent`. The probability that any of the five tests (in that
    order) rejects a true hypothesis is at most `significance`, by Holm's method. The answer is None if nothing is
    rejected and one of the two questions cannot be decided. Question: Lima and Sampaio 2017, introduction. Raises
    ValueError as they do.
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


def _question(earlier: str, later: str, lag: int) -> str:
    if earlier == later:
        return f"Are the {plural(earlier)}, {'consecutive' if lag == 1 else f'{lag} apart'}, independent?"
    apart = "them" if lag == 1 else f"{lag} apart"
    return f"Are the {plural(earlier)} independent of the {plural(later)} that follow {apart}?"


class _Pairs(NamedTuple):
    """All pairs of an earlier and a later value, sample after sample, those of a sample in order of time.

    - `early`, `late`: the values; `order`: that of the earlier one in its sample, from `first` on; (pairs,).
    - `count`: number of pairs of each sample, (samples,). `names`: of the pair that comes first.
    """

    early: np.ndarray
    late: np.ndarray
    order: np.ndarray
    count: np.ndarray  # pyright: ignore[reportIncompatibleMethodOverride] - the name in CF conventions
    names: str


def _pairs(
    source: StickSource, quantities: tuple[str, str], lag: int, first: int, starts_before: float | None
) -> tuple[_Pairs, tuple[str, ...], int]:
    """The pairs, remarks on the values that were used and left out, and the number of those that were used."""
    alike = quantities[0] == quantities[1]
    earlier = sequences_of(source, quantities[0], starts_before)
    later = earlier if alike else sequences_of(source, quantities[1], starts_before)
    places = [IN_A_CYCLE.index(quantity) for quantity in quantities]
    shift = lag - (places[0] < places[1])  # the next of the other kind may belong to the same stick
    count = np.maximum(np.minimum(earlier.count, later.count - shift) - first + 1, 0)
    order = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + first
    at = [np.repeat(one.first, count) + order - 1 for one in (earlier, later)]
    names = f"orders {first} and {first + shift}"
    if not alike:
        names = " and ".join(
            f"{TESTED[quantity].label} {number}"
            for quantity, number in zip(quantities, (first, first + shift), strict=True)
        )
    pairs = _Pairs(earlier.values[at[0]], later.values[at[1] + shift], order, count, names)
    values = len(earlier.values) + (0 if alike else len(later.values))
    return pairs, tuple(dict.fromkeys((earlier.remark, later.remark))), values


def _too_few(early: np.ndarray, late: np.ndarray) -> str:
    if len(early) < FEWEST_PAIRS:
        return f"fewer than {FEWEST_PAIRS} samples have such a pair"
    return "all values of one order are equal" if np.ptp(early) == 0 or np.ptp(late) == 0 else ""


def _spearman(early: np.ndarray, late: np.ndarray, names: str) -> HypothesisTest:
    name, sizes = f"Spearman, {names}", (len(early),)
    if reason := _too_few(early, late):
        return HypothesisTest(name, sizes=sizes, reason=reason)
    correlation, p_value = np.asarray(stats.spearmanr(early, late), float).tolist()
    return HypothesisTest(name, correlation, p_value, correlation, "rank correlation", sizes=sizes)


def _chi_square(early: np.ndarray, late: np.ndarray, bins: int, pooled: bool) -> HypothesisTest:
    sizes = (len(early),)
    if reason := _too_few(early, late):
        return HypothesisTest("Chi-square", sizes=sizes, reason=reason)
    table = _table(early, late, bins, pooled)
    shape = " x ".join(map(str, table.shape))
    name = f"Chi-square, {shape} quantile bins"
    if min(table.shape) < 2:
        return HypothesisTest(name, sizes=sizes, reason=f"a cell would expect fewer than {FEWEST_EXPECTED}")
    statistic, p_value = np.asarray(stats.chi2_contingency(table, correction=False)[:2], float).tolist()
    cramer = math.sqrt(statistic / (table.sum() * (min(table.shape) - 1)))
    return HypothesisTest(name, statistic, p_value, cramer, "Cramer's V", sizes=sizes)


def _table(early: np.ndarray, late: np.ndarray, bins: int, pooled: bool) -> np.ndarray:
    """Counts of pairs in quantile bins, pooled or of each side, joined until cells expect enough.

    Which bins are joined depends only on the sums over rows and columns, which carry no information on dependence.
    """
    bins = max(2, min(bins, math.isqrt(len(early) // FEWEST_EXPECTED)))
    both = np.concatenate([early, late])
    sides = ((both, early), (both, late)) if pooled else ((early, early), (late, late))
    edges = [np.unique(np.quantile(of, np.arange(1, bins) / bins)) for of, _ in sides]
    place = [np.searchsorted(own, values, "left") for own, (_, values) in zip(edges, sides, strict=True)]
    shape = [len(own) + 1 for own in edges]
    table = np.bincount(place[0] * shape[1] + place[1], minlength=shape[0] * shape[1]).reshape(shape)
    while True:
        sums = table.sum(axis=1), table.sum(axis=0)
        if sums[0].min() * sums[1].min() >= FEWEST_EXPECTED * len(early) or min(table.shape) < 2:
            return table
        axis = int(sums[1].min() < sums[0].min())
        if table.shape[axis] == 2 < table.shape[1 - axis]:
            axis = 1 - axis
        smallest = int(sums[axis].argmin())
        beside = [at for at in (smallest - 1, smallest + 1) if 0 <= at < len(sums[axis])]
        start = min(smallest, min(beside, key=lambda at: sums[axis][at]))
        table = np.add.reduceat(table, [at for at in range(len(sums[axis])) if at != start + 1], axis=axis)


def _serial(among: _Pairs) -> HypothesisTest:
    """Rank correlation of all pairs, ranked separately for each order; its error from sums over samples."""
    counts = among.count
    having = counts > 0
    pairs, samples = int(counts.sum()), int(having.sum())
    name, sizes = f"Serial rank correlation, {pairs} pairs in {samples} samples", (pairs, samples)
    if samples < FEWEST_PAIRS:
        return HypothesisTest(name, sizes=sizes, reason=f"fewer than {FEWEST_PAIRS} samples have such a pair")
    order = among.order
    a, b = _scores(among.early, order), _scores(among.late, order)
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
