"""Intervals and errors are honest: coverage by simulation, the memoryless identity, predicted accuracies reached."""

import dataclasses
import math

import jax
import numpy as np
import pytest
from scipy import stats
from support.statistics import statistics_of, sticks_from

import stickslip_jax as ss
from stickslip_jax._numerics.sums import Moments
from stickslip_jax._statistics.ensemble_statistics import OrderStatistics

SYSTEM = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
POISSON = ss.PoissonSwitching(speed=1.0, rate=1.0)
GROUPS, SIZE = 1000, 50
STATISTICS = [ss.stick_fraction, ss.mean_stick_count, ss.mean_stick_duration]


@pytest.fixture(scope="module")
def many():
    """Samples for many small studies; their mean stands for the truth, with an error 1 / sqrt(1000) of a study's."""
    return ss.simulate_ensemble(
        SYSTEM, POISSON, t1=40.0, samples=GROUPS * SIZE, key=jax.random.key(11), y0=(0.0, 1.0), keep="sticks"
    )


def small_studies(many, number):
    """Ensembles of `SIZE` samples each."""
    totals, at = many.retained.totals, np.concatenate([[0], np.cumsum(many.finished_sticks().count)])
    sticks = many.finished_sticks()
    for first in range(0, number * SIZE, SIZE):
        rows, own = totals[first : first + SIZE], slice(at[first], at[first + SIZE])
        some = type(sticks)(sticks.count[first : first + SIZE], sticks.numbers[:, own], sticks.ending[own])
        yield dataclasses.replace(
            many, moments=Moments.of(rows), retained=many.retained._replace(sticks=some, totals=rows)
        )


def assert_covers(hits, level):
    """As often as promised: binomial error, 4 standard deviations."""
    rate, error = np.mean(hits), math.sqrt(level * (1 - level) / len(hits))
    assert abs(rate - level) < 4 * error, f"covers {rate:.3f} of {level}"


@pytest.mark.slow_but_for("stick_fraction-0.95")
@pytest.mark.parametrize("level", [0.9, 0.95])
@pytest.mark.parametrize("statistic", STATISTICS, ids=lambda statistic: statistic.__name__)
def test_t_intervals_cover_as_often_as_they_promise(many, statistic, level):
    truth, hits = statistic(many).value, []
    for study in small_studies(many, GROUPS):
        low, high = statistic(study).interval(level)
        hits.append(low <= truth <= high)
    assert_covers(hits, level)


def few_sticks(number, size, sticks):
    """Totals of small studies: a Poisson number of sticks in each sample, with exponential durations of mean 1 s."""
    rng = np.random.default_rng(12)
    count = rng.poisson(sticks, (number, size))
    time = rng.gamma(np.maximum(count, 1)) * (count > 0)
    return np.stack([time, count, count, 0.0 * count, 0.0 * count], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize(("size", "sticks"), [(20, 0.4), (20, 3.0), (100, 0.4)])
def test_mean_durations_of_few_sticks(many, size, sticks):
    """Eight sticks do not determine how many there are: Student's t misses one time in six, nearly always below."""
    totals, hits, plain = few_sticks(600, size, sticks), [], []
    for rows in totals[(totals[..., 1] > 0).sum(axis=1) > 1]:  # with less than two of them there is no error
        found = ss.mean_stick_duration(dataclasses.replace(many, moments=Moments.of(rows)))
        low, high = found.interval()
        hits.append(low <= 1 <= high)
        plain.append(abs(found.value - 1) <= stats.t.ppf(0.975, size - 1) * found.standard_error)
    assert_covers(hits, 0.95)
    if size * sticks < 10:
        assert np.mean(plain) < 0.86


@pytest.mark.parametrize("sticks", [0.1, 0.4, 3.0])
def test_intervals_of_ratios_are_fieller_s(many, sticks):
    """All ratios r for which (stick time - r number) is on average 0, as scipy's t test of single samples has it."""
    unbounded = 0
    for rows in few_sticks(8, 20, sticks):
        if np.count_nonzero(rows[:, 1]) < 2:  # no error
            continue
        found = ss.mean_stick_duration(dataclasses.replace(many, moments=Moments.of(rows)))

        def p_value(ratio, rows=rows):
            return float(stats.ttest_1samp(rows[:, 0] - ratio * rows[:, 1], 0).pvalue)

        for level, (low, high) in ((level, found.interval(level)) for level in (0.5, 0.95)):
            for end, inside, far in ((low, 1e-3, -1e9), (high, -1e-3, 1e9)):
                if math.isfinite(end):
                    assert p_value(end) == pytest.approx(1 - level, rel=1e-6)
                    assert p_value(end - inside) < 1 - level < p_value(end + inside)
                else:
                    assert p_value(far) > 1 - level
                    unbounded += 1
    assert (unbounded > 0) == (sticks == 0.1)


def test_intervals_of_means_of_all_sticks():
    """The same from sticks as from totals, and shown where it is not symmetric."""
    rng = np.random.default_rng(5)
    samples = [[(2.0 * i, 2.0 * i + rng.exponential(), 0.0, 0) for i in range(rng.poisson(0.4))] for _ in range(20)]
    sticks = sticks_from(samples)
    rows = np.array([(sum(b - a for a, b, *_ in one), len(one)) for one in samples])
    mean = statistics_of(sticks, t1=40.0, rest=True).duration.mean
    low, high = mean.interval()
    for end in (low, high):
        p_value = stats.ttest_1samp(rows[:, 0] - end * rows[:, 1], 0).pvalue
        assert p_value == pytest.approx(0.05, rel=1e-6)
    assert mean.without_name().endswith(f" s (95 %: {low:.4g} to {high:.4g})")


@pytest.mark.parametrize("sticks", [1, 3])
def test_all_sticks_in_one_sample(many, sticks):
    """They tell nothing of their spread over samples: there is no error, rather than one of 1e-17."""
    rng = np.random.default_rng(6)
    samples = [[] for _ in range(20)]
    samples[7] = [(2.0 * i, 2.0 * i + rng.uniform(), 0.0, 0) for i in range(1, sticks + 1)]
    time = sum(end - start for start, end, *_ in samples[7])
    rows = np.zeros((20, 5))
    rows[7, :2] = time, sticks
    mean = ss.mean_stick_duration(dataclasses.replace(many, moments=Moments.of(rows)))
    for found in (mean, statistics_of(sticks_from(samples), t1=40.0, rest=True).duration.mean):
        assert found.value == pytest.approx(time / sticks)
        assert math.isnan(found.standard_error)
        assert np.all(np.isnan(found.interval()))
    rows[8, :2] = 0.5, 1
    assert ss.mean_stick_duration(dataclasses.replace(many, moments=Moments.of(rows))).standard_error > 0


@pytest.mark.parametrize("having", [0, 1, 13, 20])
def test_intervals_of_shares_are_exact(having):
    """As scipy's of Clopper and Pearson; where all have it, not all need to."""
    found = OrderStatistics.of(2, "stick", having, 20, {}, "a key").share
    expected = stats.binomtest(having, 20).proportion_ci(0.95, "exact")
    assert found.interval() == pytest.approx((expected.low, expected.high), rel=1e-10)


@pytest.mark.slow
def test_mutual_information_of_independent_pairs_is_zero():
    """Without correction it is 0.34 for these: more than ten of its errors. Default bins, and too many of them."""
    rng, found = np.random.default_rng(3), []
    for _ in range(40):
        samples = [[(5.0 * i, 5.0 * i + rng.uniform(), rng.uniform(), 0) for i in range(3)] for _ in range(200)]
        joint = statistics_of(sticks_from(samples), t1=40.0).joint("duration", "position")
        found.append(joint.mutual_information())
    values = np.array([one.value for one in found])
    assert abs(values.mean()) < 4 * values.std() / math.sqrt(len(values)) + 1e-3  # of second order: cells^2 / number^2
    assert values.std() == pytest.approx(np.mean([one.standard_error for one in found]), rel=0.5)
    assert "7 x 7" in found[0].name or "8 x 8" in found[0].name
    fine = joint.mutual_information(20)
    assert "(few pairs: too large)" in fine.name


@pytest.mark.slow
@pytest.mark.parametrize("statistic", STATISTICS, ids=lambda statistic: statistic.__name__)
def test_bootstrap_intervals_cover_as_often_as_they_promise(many, statistic):
    truth, hits = statistic(many).value, []
    for number, study in enumerate(small_studies(many, 250)):
        low, high = ss.bootstrap_interval(statistic, study, level=0.9, resamples=300, seed=number)
        hits.append(low <= truth <= high)
    assert_covers(hits, 0.9)


@pytest.mark.slow
def test_bootstrap_intervals_are_those_of_samples_drawn_again(many):
    """A share p of n scores lies below a quantile that is off by ``sqrt(p (1 - p) / n)`` in p: 4 of these here.

    The scores written out: samples drawn one by one, the ratio of their totals and its error by the textbook. Of all
    small studies the most skewed: there neither the t interval nor the bootstrap's mirror image passes.
    """

    def pooled(totals):
        time, count = totals[..., 0], totals[..., 1]
        ratio = time.sum(axis=-1) / count.sum(axis=-1)
        rest = time - ratio[..., None] * count
        return ratio, rest.std(axis=-1, ddof=1) / count.mean(axis=-1) / math.sqrt(SIZE), stats.skew(rest, axis=-1)

    totals = many.retained.totals  # the last two columns: of the initial rest, which is not counted
    groups = (totals[:, :2] - totals[:, 3:]).reshape(GROUPS, SIZE, 2)
    number = int(np.argmax(np.abs(pooled(groups)[2])))
    study, resamples, own = list(small_studies(many, number + 1))[-1], 8000, 20_000
    value, error, _ = pooled(groups[number])
    again, errors, _ = pooled(groups[number][np.random.default_rng(2).integers(SIZE, size=(own, SIZE))])
    low, high = ss.bootstrap_interval(ss.mean_stick_duration, study, level=0.9, resamples=resamples)
    for end, share in ((low, 0.95), (high, 0.05)):
        off = 4 * math.sqrt(share * (1 - share) * (1 / resamples + 1 / own))
        least, most = np.quantile((again - value) / errors, (share - off, share + off))
        assert least < (value - end) / error < most


@pytest.mark.slow
def test_errors_of_distributions_are_honest(many):
    """Scores of estimates of small studies against those of all samples have mean 0 and standard deviation 1."""

    def estimates(told):
        return told.duration.mean, told.duration.variance, told.slip_duration.mean, told.own_mean_duration.mean

    truth = [one.value for one in estimates(many.statistics)]
    found = [estimates(statistics_of(one.finished_sticks(), t1=40.0, rest=False)) for one in small_studies(many, 200)]
    for exact, column in zip(truth, zip(*found, strict=True), strict=True):
        scores = [(one.value - exact) / one.standard_error for one in column]
        # Of 200 scores the mean has error 1 / sqrt(200) = 0.071, their spread 1 / sqrt(400) = 0.05; errors from 50
        # samples make scores wider, by 2 % for normal values.
        assert abs(np.mean(scores)) < 4 * 0.071
        assert abs(np.std(scores) - 1.02) < 4 * 0.05


# Friction, speed, rate: w = speed / (a omega) from 0.5 to 5 and rate / omega from 0.1 to 1.5.
POINTS = [(1.0, 1.0, 1.0), (1.0, 0.25, 0.2), (0.4, 1.0, 3.0), (2.0, 1.0, 0.6), (1.0, 2.0, 1.5), (0.7, 0.5, 0.4)]


@pytest.mark.slow
@pytest.mark.parametrize(("mu", "speed", "rate"), POINTS)
def test_sticks_ended_by_a_switch_number_rate_times_stick_time(mu, speed, rate):
    """A Poisson base has no memory: while the mass sticks, switches come at their rate, whatever went before."""
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=mu))
    law = ss.PoissonSwitching(speed=speed, rate=rate)
    many = ss.simulate_ensemble(
        system, law, t1=60.0, samples=20_000, key=jax.random.key(3), y0=(0.0, 0.3), keep="sticks"
    )
    sticks = many.flat_sticks
    switched = np.bincount(sticks.sample, weights=sticks.ending == ss.Ending.BASE_SWITCHED, minlength=many.samples)
    excess = switched - rate * many.totals.stick_time
    assert switched.sum() > 2000
    assert abs(excess.mean()) < 4 * excess.std() / math.sqrt(many.samples)
    share, told = many.statistics.endings[ss.Ending.BASE_SWITCHED], ss.mean_stick_count(many)
    assert share.value * told.value == pytest.approx(switched.mean())


@pytest.mark.parametrize("statistic", [ss.stick_fraction, ss.mean_stick_duration], ids=lambda one: one.__name__)
def test_convergence_predicts_the_samples_that_an_error_takes(many, statistic):
    found = ss.convergence(statistic, many)
    assert found.numbers[0] == 2
    assert found.numbers[-1] == len(many.retained.totals)
    assert found.values[-1] == pytest.approx(statistic(many).value)
    low, high = found.band(0.9)
    assert np.all((high - low)[5:] > 0)
    # The standard error from so many samples is the wanted share of the value, to what 1000 samples tell of a spread.
    number = found.samples_for(0.01)
    totals = many.retained.totals[:number]
    reached = statistic(dataclasses.replace(many, moments=Moments.of(totals)))
    assert reached.standard_error / reached.value == pytest.approx(0.01, rel=4 / math.sqrt(2 * number) + 0.02)


def test_running_values_are_those_of_the_first_samples(many):
    found = ss.convergence(ss.mean_stick_duration, many, points=5)
    for number, value, error in zip(found.numbers, found.values, found.errors, strict=True):
        part = dataclasses.replace(many, moments=Moments.of(many.retained.totals[:number]))
        one = ss.mean_stick_duration(part)
        assert (value, error) == (pytest.approx(one.value, rel=1e-9), pytest.approx(one.standard_error, rel=1e-6))


def test_joint_histograms_converge_with_the_root_of_the_number(many):
    found = ss.histogram_convergence(many, bins=10)
    assert found.distances[-1] < found.distances[3] < found.distances[0] <= 1
    assert found.slope == pytest.approx(-0.5, abs=0.1)
    half = found.samples_for(found.distances[-1] / 2)
    assert half == pytest.approx(4 * found.numbers[-1], rel=0.01)
