"""Sticks against the slips that follow them: joint distributions and tests of independence of two quantities."""

import math

import numpy as np
import pytest
from scipy import stats
from support.independence import autoregressive, flat, spearman_of
from support.statistics import T1, made_up_sticks, statistics_of, sticks_from

from stickslip_jax import Ending
from stickslip_jax._dynamics.sticks import with_columns
from stickslip_jax._statistics.independence import independent


@pytest.fixture(scope="module")
def sticks():
    """Of 80 samples; the last stick of every third is cut by the horizon."""
    sticks = made_up_sticks(np.random.default_rng(3), 80)
    last = (sticks.first + sticks.count - 1)[sticks.count > 0][::3]
    end, ending = sticks.end.copy(), sticks.ending.copy()
    end[last], ending[last] = T1, Ending.HORIZON
    return with_columns(sticks, end=end)._replace(ending=ending)


def by_hand(sticks):
    """(start, duration, slip start, slip duration or None) of each stick of each sample, by a loop."""
    found = []
    for first, count in zip(sticks.first, sticks.count, strict=True):
        sample = []
        for at in range(first, first + count):
            until = sticks.start[at + 1] if at + 1 < first + count else T1
            has = sticks.ending[at] != Ending.HORIZON
            slip = (sticks.end[at], until - sticks.end[at]) if has else (None, None)
            sample.append({"start": sticks.start[at], "duration": sticks.end[at] - sticks.start[at],
                           "slip_start": slip[0], "slip_duration": slip[1]})  # fmt: skip
        found.append(sample)
    return found


@pytest.mark.parametrize(
    ("x", "y"), [("duration", "slip_duration"), ("slip_start", "start"), ("slip_duration", "slip_start")]
)
def test_joint_with_the_slip_after_the_same_stick(sticks, x, y):
    pairs = [(one[x], one[y]) for sample in by_hand(sticks) for one in sample]
    pairs = np.array([pair for pair in pairs if None not in pair], float)
    joint = statistics_of(sticks).joint(x, y)
    np.testing.assert_array_equal(np.stack([joint.x.values, joint.y.values], axis=1), pairs)
    assert joint.number == len(pairs) < len(sticks.start)
    assert joint.rank_correlation.value == pytest.approx(stats.spearmanr(*pairs.T).statistic, rel=1e-9)


@pytest.mark.parametrize(
    ("x", "y"),
    [
        (("slip_duration", 1), ("duration", 2)),
        (("duration", 3), ("slip_duration", 3)),
        (("slip_start", 2), ("start", 1)),
    ],
    ids=str,
)
def test_joint_by_order(sticks, x, y):
    samples = [sample for sample in by_hand(sticks) if len(sample) >= max(x[1], y[1])]
    pairs = [(sample[x[1] - 1][x[0]], sample[y[1] - 1][y[0]]) for sample in samples]
    pairs = np.array([pair for pair in pairs if None not in pair], float)
    joint = statistics_of(sticks).joint(x, y)
    np.testing.assert_array_equal(np.stack([joint.x.values, joint.y.values], axis=1), pairs)
    assert f"slip after stick {x[1]}" in joint.labels[0] or f"slip after stick {y[1]}" in joint.labels[1]


def test_sticks_that_touch_have_no_slip_between_them():
    sticks = sticks_from([[(1.0, 2.0, 0.0, 0), (2.0, 3.0, 0.0, 0)]])
    assert statistics_of(sticks).joint("duration", "slip_duration").y.values.tolist() == [T1 - 3.0]


@pytest.mark.parametrize("first", [1, 3])
@pytest.mark.parametrize(
    ("quantities", "lag", "shift"),
    [
        (("duration", "slip_duration"), 1, 0),
        (("duration", "slip_duration"), 2, 1),
        (("slip_duration", "duration"), 1, 1),
        (("slip_duration", "slip_duration"), 1, 1),
        (("start", "slip_duration"), 1, 0),
    ],
)
def test_numbers_by_loops(sticks, quantities, lag, shift, first):
    """Pairs, ranks of each order, their products, and the squares of the samples' shares, sum by sum."""
    samples = []
    for sample in by_hand(sticks):
        durations = [one[quantities[1]] for one in sample]
        if quantities[1] == "slip_duration":
            durations = durations[: -1 or None]  # that after the last stick is cut
        early = [one[quantities[0]] for one in sample]
        if quantities[0] == "slip_duration":
            early = early[:-1]
        if quantities[1] == "duration" and sample and sample[-1]["slip_start"] is None:
            durations = durations[:-1]
        pairs = list(zip(early, durations[shift:], strict=False))
        samples.append(pairs[first - 1 :])
    verdict = independent(sticks, quantities, lag=lag, first=first, bins=2, starts_before=math.inf)
    firsts = np.array([sample[0] for sample in samples if sample])
    expected = stats.spearmanr(*firsts.T)
    assert (verdict.tests[0].effect, verdict.tests[0].p_value) == pytest.approx((expected.statistic, expected.pvalue))
    ours = verdict.tests[1]
    same = quantities[0] == quantities[1]
    medians = np.full(2, np.median(firsts)) if same else np.median(firsts, axis=0)
    over = firsts > medians
    table = [[np.sum(np.all(over == (early, late), axis=1)) for late in (0, 1)] for early in (0, 1)]
    expected = stats.chi2_contingency(table, correction=False)
    assert (ours.statistic, ours.p_value) == pytest.approx((expected.statistic, expected.pvalue))
    above, squares, shares = 0.0, np.zeros(2), np.zeros(len(samples))
    for order in range(max(map(len, samples))):
        having = [number for number, pairs in enumerate(samples) if len(pairs) > order]
        ranks = stats.rankdata([samples[number][order] for number in having], axis=0).T
        a, b = (2 * ranks - 1) / len(having) - 1
        above += a @ b
        squares += a @ a, b @ b
        shares[having] += a * b * (math.sqrt(len(having) / (len(having) - 1)) if len(having) > 1 else 1)
    serial = verdict.tests[2]
    assert serial.sizes == (sum(map(len, samples)), sum(map(bool, samples)))
    assert serial.effect == pytest.approx(above / math.sqrt(squares[0] * squares[1]))
    z, number = above / math.sqrt(shares @ shares), serial.sizes[1]
    assert serial.statistic == pytest.approx(z * math.sqrt((number - 1) / (number - z**2)))


def correlation_of_cut_pairs(rng, samples=100_000, horizon=25.0):
    """Of many more such samples: pairs of a stick and the slip after it that begins before the middle of the time, that
    slip no longer than the other half. Ranked by order; of all orders together.
    """
    noise = rng.normal(size=(2, samples, 12))
    stick, slip = np.exp(noise[0]), np.exp(0.6 * noise[0] + 0.8 * noise[1])
    ends = 1.0 + np.cumsum(stick, axis=1) + np.pad(np.cumsum(slip, axis=1)[:, :-1], ((0, 0), (1, 0)))
    shared, sizes = 0.0, 0
    for order in range(12):
        used = ends[:, order] < horizon / 2
        if used.sum() > 1:
            shared += used.sum() * stats.spearmanr(stick[used, order], np.minimum(slip[used, order], 12.5)).statistic
            sizes += used.sum()
    return shared / sizes


def test_known_dependence_is_found_where_it_is():
    """Slips that depend on the stick before them, sticks that depend on nothing; whole, and cut at the horizon."""
    rng = np.random.default_rng(4)
    noise = rng.normal(size=(2, 800 * 12))
    durations, before = np.exp(noise[0]), np.exp(0.6 * noise[0] + 0.8 * noise[1])
    whole = flat(np.full(800, 12), durations, np.append(1.0, before[:-1]))
    serial = independent(whole, ("duration", "slip_duration"), starts_before=math.inf).tests[2]
    assert abs(serial.effect - spearman_of(0.6)) < 4 * serial.effect_error
    sticks = flat(np.full(800, 12), durations, np.append(1.0, before[:-1]), horizon=25.0)
    after = independent(sticks, ("duration", "slip_duration"))
    assert after.rejected
    # After a long stick less time is left: fewer of these are among the pairs, which makes the correlation smaller.
    cut = after.tests[2]
    assert cut.effect < serial.effect
    assert abs(cut.effect - correlation_of_cut_pairs(rng)) < 4 * cut.effect_error
    assert str(after).startswith("Are the stick durations independent of the slip durations that follow them? Rejected")
    assert "Spearman, stick duration 1 and slip duration 1: p" in str(after)
    assert "have stick duration 1 and slip duration 1." in str(after)
    assert independent(sticks, ("slip_duration", "duration")).rejected is False
    assert independent(sticks, ("duration", "slip_duration"), lag=2).rejected is False


def test_the_third_test_begins_with_the_first_order_asked_for():
    """Dependent at the beginning, independent from the fourth value on."""
    rng = np.random.default_rng(5)
    values = rng.normal(size=(300, 12))
    values[:, :4] = autoregressive(rng, 300, 4, np.full(300, 0.9))
    sticks = flat(np.full(300, 12), np.exp(values).ravel())
    assert independent(sticks, starts_before=math.inf).tests[2].p_value < 1e-10
    later = independent(sticks, first=4, starts_before=math.inf).tests[2]
    assert later.sizes == (300 * 8, 300)
    assert later.p_value > 1e-3


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize("quantity", [("duration", "length"), ("duration", "duration", "duration"), ("duration",)])
def test_bad_pairs(sticks, quantity):
    with pytest.raises(ValueError, match=r"^Argument quantity must be one of"):
        independent(sticks, quantity)
