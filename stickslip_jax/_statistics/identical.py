"""Test whether the values of the first, second, third, ... stick of a motion are identically distributed."""

import itertools
import math
import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy import stats

from .. import _checks
from .accumulator import MOST_ORDERS
from .anderson_darling import anderson_darling
from .complete_values import plural, sequences_of
from .quantities import TestedQuantity
from .source import StickSource
from .verdicts import HypothesisTest, Verdict, check_significance, holm

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
            it. By default the end of the simulation minus the longest value, so that none is cut; where the motion
            comes to rest for good, that leaves no value. With ``math.inf`` all complete values are used; these are too
            short on average, more so for later orders, and the tests detect it if many are cut.

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
    if len(kept) >= 2:
        tests, reason = (_all_at_once(kept), _by_pairs(kept)), ""
    else:
        reason = f"fewer than two orders have {FEWEST_VALUES} values"
        names = ("Anderson-Darling", "Kolmogorov-Smirnov")
        tests = tuple(HypothesisTest(name, reason=reason) for name in names)
    question = f"Are the {plural(quantity)} of all orders identically distributed?"
    return Verdict(question, significance, tests, samples, len(sequences.values), reason, tuple(remarks))


def _orders(orders: Any) -> tuple[int, ...]:
    if not hasattr(orders, "__len__") or _checks.dimensions(orders) == 0:
        return tuple(range(1, _checks.whole_number("orders", orders, minimum=2, maximum=MOST_ORDERS) + 1))
    if isinstance(orders, (bytes, bytearray)):
        raise _checks.refused("orders", "be whole numbers", orders)
    few = orders[: MOST_ORDERS + 1]
    chosen = sorted({_checks.whole_number(f"orders[{at}]", order) for at, order in enumerate(few)})
    if not 2 <= len(chosen) == len(orders):
        raise ValueError(
            f"Argument orders must hold at least two different whole numbers, but {_checks.show(orders)} was given."
        )
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
        f"Anderson-Darling, orders {', '.join(map(str, groups))}",
        statistic,
        p_value,
        effect,
        "largest difference of means (in standard deviations)",
        sizes=tuple(int(size) for size in sizes),
    )


def _by_pairs(groups: dict[int, np.ndarray]) -> HypothesisTest:
    pairs = tuple(_pair(a, b, groups[a], groups[b]) for a, b in itertools.combinations(groups, 2))
    farthest = max(pairs, key=lambda pair: pair.effect)
    return HypothesisTest(
        f"Kolmogorov-Smirnov, {len(pairs)} pairs of orders",
        farthest.statistic,
        min(holm([pair.p_value for pair in pairs])),
        farthest.effect,
        "largest distance",
        sizes=tuple(len(group) for group in groups.values()),
        parts=pairs,
    )


def _pair(a: int, b: int, first: np.ndarray, second: np.ndarray) -> HypothesisTest:
    # The cost of the exact distribution is the product of the sizes; the limiting one is close beyond a hundred each.
    method = "exact" if len(first) * len(second) <= 10_000 else "asymp"
    with warnings.catch_warnings():
        # Where round-off takes an exact p-value above 1, scipy warns and takes the limiting one, also about 1.
        warnings.simplefilter("ignore", RuntimeWarning)
        distance, p_value = np.asarray(stats.ks_2samp(first, second, method=method), float).tolist()
    name, sizes = f"Kolmogorov-Smirnov, orders {a} and {b}", (len(first), len(second))
    return HypothesisTest(name, distance, p_value, distance, "distance", sizes=sizes)
