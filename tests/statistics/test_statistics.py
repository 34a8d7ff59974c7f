"""Statistics of sticks: each number against a brute-force recomputation, each error against the jackknife."""

import math

import numpy as np
import pytest
from scipy import stats
from support.statistics import T1, jackknife_error, made_up_sticks, slips_by_hand, statistics_of, sticks_from

import stickslip_jax as ss

SAMPLES = 400
# The jackknife and the linearised error agree to first order; what is left is of relative order 1 / SAMPLES, larger
# for statistics that look at tails.
CLOSE, TAILS = 0.02, 0.08


@pytest.fixture(scope="module")
def sticks():
    return made_up_sticks(np.random.default_rng(5), SAMPLES)


@pytest.fixture(scope="module")
def statistics(sticks):
    return statistics_of(sticks, parts=7)


def values_by_hand(sticks):
    """All values of every quantity, by plain loops."""
    samples = [list(range(first, first + count)) for first, count in zip(sticks.first, sticks.count, strict=True)]
    durations = [[float(sticks.end[i] - sticks.start[i]) for i in sample] for sample in samples]
    slips = slips_by_hand(sticks, T1)
    return {
        "start": [float(value) for value in sticks.start],
        "duration": [value for sample in durations for value in sample],
        "position": [float(value) for value in sticks.position],
        "slip_duration": [value for sample in slips for value in sample],
        "stick_count": [len(sample) for sample in samples],
        "slip_count": [len(sample) for sample in slips],
        "stick_fraction": [sum(sample) / T1 for sample in durations],
        "own_mean_duration": [sum(sample) / len(sample) for sample in durations if sample],
    }


QUANTITIES = list(values_by_hand(sticks_from([[]])))


@pytest.mark.slow
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_moments_by_brute_force(statistics, sticks, quantity):
    values, of = np.array(values_by_hand(sticks)[quantity]), getattr(statistics, quantity)
    assert of.number == len(values)
    assert of.samples == SAMPLES
    assert (of.smallest, of.largest) == (pytest.approx(values.min()), pytest.approx(values.max()))
    assert of.mean.value == pytest.approx(values.mean(), rel=1e-12, abs=1e-12)
    assert of.variance.value == pytest.approx(values.var(ddof=1), rel=1e-12)
    assert of.standard_deviation.value == pytest.approx(values.std(ddof=1), rel=1e-12)
    assert of.skewness.value == pytest.approx(stats.skew(values), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_histogram_and_entropy_by_brute_force(statistics, sticks, quantity):
    values, of = np.array(values_by_hand(sticks)[quantity], float), getattr(statistics, quantity)
    for bins in (1, 7, 50):
        histogram = of.histogram(bins)
        assert len(histogram.counts) <= bins
        np.testing.assert_allclose(np.diff(histogram.edges), np.diff(histogram.edges)[0], rtol=1e-9)
        # NumPy closes its last bin on the right, so it gets one edge more.
        edges = [*histogram.edges, math.inf]
        np.testing.assert_array_equal(histogram.counts, np.histogram(values, edges)[0][:-1])
        assert histogram.counts.sum() == histogram.number == len(values)
        assert (histogram.density * np.diff(histogram.edges)).sum() == pytest.approx(1)
        share = histogram.counts[histogram.counts > 0] / len(values)
        plain, bias = -sum(p * math.log(p) for p in share), -(len(share) - 1) / (2 * len(values))  # Miller 1955
        assert of.entropy(bins).value == pytest.approx(plain - bias, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 0.9, 1.0])
def test_quantiles_to_their_resolution(statistics, sticks, quantity, share):
    values, of = np.array(values_by_hand(sticks)[quantity], float), getattr(statistics, quantity)
    value = of.quantile(share).value
    if of.is_whole:
        assert value == np.quantile(values, share, method="inverted_cdf")
    else:
        assert of.resolution <= (of.largest - of.smallest) / 2048
        assert np.mean(values <= value + of.resolution) >= share - 1e-12
        assert np.mean(values < value - of.resolution) <= share + 1e-12


MOMENTS = {
    "mean": (lambda sticks: sticks.duration.mean(), CLOSE),
    "variance": (lambda sticks: sticks.duration.var(ddof=1), TAILS),
    "skewness": (lambda sticks: stats.skew(sticks.duration), 3 * TAILS),
}


@pytest.mark.parametrize("name", MOMENTS)
def test_errors_of_pooled_moments_by_jackknife(statistics, sticks, name):
    statistic, close = MOMENTS[name]
    expected = jackknife_error(sticks, statistic)
    assert getattr(statistics.duration, name).standard_error == pytest.approx(expected, rel=close)


def test_errors_treat_realizations_not_sticks_as_independent(statistics, sticks):
    """The sticks of a sample share a factor, so errors as if they were independent would be too small."""
    naive = np.std(sticks.duration, ddof=1) / math.sqrt(len(sticks.duration))
    assert statistics.duration.mean.standard_error > 1.3 * naive


def test_errors_of_histogram_and_entropy_by_jackknife(statistics, sticks):
    histogram = statistics.duration.histogram(12)
    edges, width = [*histogram.edges, math.inf], np.diff(histogram.edges)

    def shares(some):
        counts = np.histogram(some.duration, edges)[0][:-1]
        return counts / counts.sum()

    def entropy(some):
        share = shares(some)
        return -(share[share > 0] * np.log(share[share > 0])).sum()

    filled = histogram.counts > 20
    assert filled.sum() > 2
    errors = jackknife_error(sticks, shares) / width
    np.testing.assert_allclose(histogram.error[filled], errors[filled], rtol=CLOSE)
    np.testing.assert_array_equal(histogram.error[histogram.counts == 0], 0)
    assert statistics.duration.entropy(12).standard_error == pytest.approx(jackknife_error(sticks, entropy), rel=TAILS)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_errors_of_quantiles_by_bootstrap(statistics, sticks, share):
    rng = np.random.default_rng(1)
    first = sticks.first
    durations = [sticks.duration[at : at + count] for at, count in zip(first, sticks.count, strict=True)]
    drawn = [
        np.quantile(np.concatenate([durations[i] for i in rng.integers(SAMPLES, size=SAMPLES)]), share)
        for _ in range(400)
    ]
    # The bootstrap's own error with 400 draws is 1 / sqrt(800) = 3.5 %; both estimates of a quantile's error depend on
    # the density there, known to some 10 %.
    assert statistics.duration.quantile(share).standard_error == pytest.approx(np.std(drawn), rel=0.3)


def test_orders_by_brute_force(statistics, sticks):
    for number in (1, 2, 3):
        at = [first + number - 1 for first, count in zip(sticks.first, sticks.count, strict=True) if count >= number]
        one = statistics.order(number)
        share = len(at) / SAMPLES
        assert one.share.value == share
        assert one.share.standard_error == pytest.approx(math.sqrt(share * (1 - share) / (SAMPLES - 1)))
        for name in ("start", "duration", "position"):
            values, of = getattr(sticks, name)[at], getattr(one, name)
            assert of.number == len(at)
            assert of.mean.value == pytest.approx(values.mean(), rel=1e-12)
            # One value a sample: the textbook error, but for the number of samples that have the stick being random.
            assert of.mean.standard_error == pytest.approx(values.std(ddof=1) / math.sqrt(len(at)), rel=CLOSE)
            assert of.variance.value == pytest.approx(values.var(ddof=1), rel=1e-12)
            assert of.histogram(9).counts.sum() == len(at)


def test_endings_by_brute_force(statistics, sticks):
    shares = {ending: np.mean(sticks.ending == ending) for ending in ss.Ending}
    assert {ending: one.value for ending, one in statistics.endings.items()} == pytest.approx(shares)
    error = jackknife_error(sticks, lambda some: np.mean(some.ending == ss.Ending.RELEASED))
    assert statistics.endings[ss.Ending.RELEASED].standard_error == pytest.approx(error, rel=CLOSE)
    assert statistics.endings[ss.Ending.HORIZON].standard_error == 0


PAIRS = [
    ("duration", "position"),
    ("start", "duration"),
    (("duration", 1), ("duration", 2)),
    (("start", 2), ("position", 1)),
    ("slip_before", "duration"),
]


def pairs_by_hand(sticks, x, y):
    if x == "slip_before":
        before = np.diff(sticks.start, prepend=0.0) - np.append(0.0, sticks.duration[:-1])
        before[sticks.first[sticks.count > 0]] = sticks.start[sticks.first[sticks.count > 0]]
        return before, getattr(sticks, y)
    if isinstance(x, str):
        return getattr(sticks, x), getattr(sticks, y)
    most = max(x[1], y[1])
    first = [first for first, count in zip(sticks.first, sticks.count, strict=True) if count >= most]
    return tuple(getattr(sticks, name)[np.array(first) + order - 1] for name, order in (x, y))


@pytest.mark.parametrize("pair", PAIRS, ids=str)
def test_joint_distributions_by_brute_force(statistics, sticks, pair):
    joint, (x, y) = statistics.joint(*pair), pairs_by_hand(sticks, *pair)
    assert joint.number == joint.retained == len(x)
    assert joint.correlation.value == pytest.approx(stats.pearsonr(x, y).statistic, rel=1e-9)
    assert joint.rank_correlation.value == pytest.approx(stats.spearmanr(x, y).statistic, rel=1e-9)
    histogram = joint.histogram(9)
    edges = [*histogram.x_edges, math.inf], [*histogram.y_edges, math.inf]
    counts = np.histogram2d(x, y, edges)[0][:-1, :-1]
    np.testing.assert_array_equal(histogram.counts, counts)
    area = np.diff(histogram.x_edges)[:, None] * np.diff(histogram.y_edges)
    assert (histogram.density * area).sum() == pytest.approx(1)
    share = counts / counts.sum()
    rows, columns = share.sum(axis=1), share.sum(axis=0)
    information = sum(
        share[i, j] * math.log(share[i, j] / (rows[i] * columns[j])) for i, j in zip(*np.nonzero(share), strict=True)
    )
    bias = (np.sum(counts > 0) - np.sum(rows > 0) - np.sum(columns > 0) + 1) / (2 * len(x))
    assert joint.mutual_information(9).value == pytest.approx(information - bias, rel=1e-9)
    means = joint.conditional_mean(5)
    for index, (low, high) in enumerate(zip(means.edges, [*means.edges[1:-1], math.inf], strict=False)):
        here = (x >= low) & (x < high)
        assert means.counts[index] == here.sum()
        if here.any():
            assert means.mean[index] == pytest.approx(y[here].mean())
        else:
            assert math.isnan(means.mean[index])


@pytest.mark.slow_but_for("('duration', 'position')")
@pytest.mark.parametrize("pair", [PAIRS[0], PAIRS[2]], ids=str)
def test_errors_of_correlations_by_jackknife(statistics, sticks, pair):
    joint = statistics.joint(*pair)
    pearson = jackknife_error(sticks, lambda some: stats.pearsonr(*pairs_by_hand(some, *pair)).statistic)
    spearman = jackknife_error(sticks, lambda some: stats.spearmanr(*pairs_by_hand(some, *pair)).statistic)
    assert joint.correlation.standard_error == pytest.approx(pearson, rel=2 * TAILS)
    assert joint.rank_correlation.standard_error == pytest.approx(spearman, rel=TAILS)
    first = joint.conditional_mean(5)

    def mean_in_first_bin(some):
        x, y = pairs_by_hand(some, *pair)
        return y[(x >= first.edges[0]) & (x < first.edges[1])].mean()

    assert first.error[0] == pytest.approx(jackknife_error(sticks, mean_in_first_bin), rel=CLOSE)


def test_entropies_in_closed_form():
    """Exponential durations of mean 0.5: differential entropy 1 + log 0.5; positions uniform on [0, 1): 0."""
    rng = np.random.default_rng(3)
    sticks = sticks_from(
        [[(20.0 * i, 20.0 * i + rng.exponential(0.5), rng.random(), 0) for i in range(5)] for _ in range(3000)]
    )
    statistics = statistics_of(sticks)
    for of, exact in ((statistics.duration, 1 + math.log(0.5)), (statistics.position, 0.0)):
        # The estimator smooths over sqrt(n) = 120 neighbours on each side, 1 % of the sample: a bias of that order.
        assert abs(of.differential_entropy.value - exact) < 4 * of.differential_entropy.standard_error + 0.01
    entropy = statistics.position.entropy(32)
    bins = len(statistics.position.histogram(32).counts)
    assert abs(entropy.value - math.log(bins)) < 4 * entropy.standard_error


def test_values_that_repeat_are_told_apart():
    """A third of the durations is exactly 0.25; the rest is uniform on [1, 2), with differential entropy 0."""
    rng = np.random.default_rng(4)
    sticks = sticks_from(
        [[(4.0 * i, 4.0 * i + (0.25 if i % 3 == 0 else 1 + rng.random()), 0.0, 0) for i in range(12)]
         for _ in range(500)]
    )  # fmt: skip
    statistics = statistics_of(sticks)
    assert statistics.duration.repeated_share.value == pytest.approx(1 / 3)
    # Where values repeat, round-off of the times (about 1e-14) must not make them look different.
    assert statistics.duration.differential_entropy.value == pytest.approx(0, abs=0.03)
    assert statistics.position.repeated_share.value == 1
    assert math.isnan(statistics.position.differential_entropy.value)
    assert math.isnan(statistics.stick_count.differential_entropy.value)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [pytest.param(np.float32, marks=pytest.mark.slow), np.float64])
def test_values_that_are_close_by_their_number_do_not_repeat(dtype):
    """60,000 values on [1, 2), one in fifty 1.5: in float32 eleven neighbours lie within the round-off of the times."""
    rng = np.random.default_rng(6)
    durations = np.where(rng.random(60_000) < 0.02, 1.5, 1 + rng.random(60_000)).reshape(-1, 20)
    sticks = sticks_from([[(4.0 * i, 4.0 * i + one, 0.0, 0) for i, one in enumerate(row)] for row in durations])
    sticks = sticks._replace(numbers=sticks.numbers.astype(dtype))
    duration = statistics_of(sticks).duration
    # In float32 what lies within 3e-5 of 1.5 cannot be distinguished from it: 4 values.
    assert duration.repeated_share.value == pytest.approx(np.mean(durations == 1.5), abs=2e-4)
    assert duration.differential_entropy.value == pytest.approx(0, abs=0.03)
