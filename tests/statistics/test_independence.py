"""Independent and identically distributed? The tests' false-alarm rates and their power.

Repeats have fixed seeds. A rate found in R repeats has the standard error sqrt(a (1 - a) / R) around the nominal a;
bounds are 4 of these, which a correct test misses once in 16,000.
"""

import math

import numpy as np
import pytest
from scipy import stats
from support.independence import autoregressive, cut, drift, flat, iid, rows, shared, spearman_of

from stickslip_jax._statistics.independence import holm, identically_distributed, independent, independent_and_identical

REPEATS = 500
CHANCE = 1e-3  # for distribution tests of p-values: a correct test fails them this often, for a seed picked blindly


def repeated(design, ask, repeats=REPEATS):
    """p-values (repeats, tests), the last column that of the verdict, and how many are rejected at 5 %."""
    verdicts = [ask(design(np.random.default_rng([7, number]))) for number in range(repeats)]
    p_values = np.array([[test.p_value for test in verdict.tests] + [verdict.p_value] for verdict in verdicts])
    return p_values, sum(bool(verdict.rejected) for verdict in verdicts)


def check_rates(p_values, at_most=False):
    for level in (0.05, 0.1):
        bound = 4 * math.sqrt(level * (1 - level) / len(p_values))
        rates = (p_values <= level).mean(axis=0)
        assert np.all(rates <= level + bound)
        assert at_most or np.all(rates >= level - bound)


def check_uniform(p_values):
    for column in p_values.T:
        assert stats.kstest(column, "uniform").pvalue > CHANCE


class TestFalseAlarms:
    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("design", "repeats"),
        [
            (iid, REPEATS),
            *(pytest.param(*case, marks=pytest.mark.slow) for case in ((cut, REPEATS), (iid, 4000), (cut, 4000))),
        ],
    )
    def test_independent_and_identical(self, design, repeats):
        """All five tests at their nominal rate; Holm's rule, over pairs of orders and over tests, keeps below it."""
        p_values, false_alarms = repeated(design, independent_and_identical, repeats)
        check_rates(p_values[:, [0, 2, 3, 4]])
        check_rates(p_values[:, [1, 5]], at_most=True)
        check_uniform(p_values[:, [0, 2, 4]])
        assert false_alarms <= repeats * 0.05 + 4 * math.sqrt(repeats * 0.05 * 0.95)

    @pytest.mark.slow
    def test_a_drift_is_no_dependence(self):
        p_values, _ = repeated(drift, lambda sticks: independent(sticks, starts_before=math.inf))
        check_rates(p_values[:, :3])
        check_uniform(p_values[:, [0, 2]])

    @pytest.mark.slow
    def test_dependence_is_no_drift(self):
        """Each sample is asked for one order, so its dependent sticks never meet."""
        p_values, _ = repeated(shared, identically_distributed)
        check_rates(p_values[:, [0]])
        check_uniform(p_values[:, [0]])
        check_rates(p_values[:, 1:], at_most=True)

    @pytest.mark.slow
    def test_one_pair_of_orders(self):
        """With two orders the Kolmogorov-Smirnov test is one test, whose p-values are a little too large by steps."""
        p_values, _ = repeated(iid, lambda sticks: identically_distributed(sticks, orders=2))
        check_rates(p_values[:, [1]])

    @pytest.mark.slow
    def test_errors_are_clustered(self):
        """A coin gives each sample r = 0.6 or r = -0.6: no correlation, but pairs of one sample hang together.

        z has the standard deviation 1, to 1 / sqrt(2 R). By the number of pairs alone it would be above 2 here.
        """

        def tested(rng):
            values = autoregressive(rng, 200, 12, rng.choice([0.6, -0.6], 200))
            return independent(rows(np.exp(values)), starts_before=math.inf).tests[2]

        tests = [tested(np.random.default_rng([8, number])) for number in range(REPEATS)]
        z = np.array([test.statistic for test in tests])
        effects = np.array([test.effect for test in tests])
        bound = 4 / math.sqrt(2 * REPEATS)
        assert abs(np.std(z) - 1) < bound
        assert abs(np.mean([test.effect_error for test in tests]) / np.std(effects) - 1) < bound
        assert np.std(effects) * math.sqrt(tests[0].sizes[0]) > 2
        check_rates(np.array([[test.p_value] for test in tests]))

    def test_what_the_end_of_the_simulation_does(self):
        """Without the default for `starts_before`, sticks cut short at the end look like dependence."""
        count = np.full(20_000, 20)
        rng = np.random.default_rng(3)
        sticks = flat(count, rng.gamma(2, 1, count.sum()), rng.exponential(1, count.sum()), horizon=20.0)
        assert independent_and_identical(sticks).rejected is False
        naive = independent_and_identical(sticks, starts_before=math.inf)
        assert naive.rejected
        assert naive.tests[4].p_value < 1e-6
        assert naive.tests[4].effect < 0
        assert independent_and_identical(sticks, starts_before=5.0).rejected is False


class TestPower:
    @pytest.mark.parametrize("lag", [1, 2])
    def test_autoregressive(self, lag):
        """Effects as they must be: Spearman's of a normal copula, and phi = 2 / pi asin(r) of a median split.

        1 / sqrt(n) is the standard error of both for r = 0; it is less for others.
        """
        samples, correlation = 4000, 0.6**lag
        values = autoregressive(np.random.default_rng(lag), samples, 10, np.full(samples, 0.6))
        verdict = independent(rows(np.exp(values)), lag=lag, first=3, bins=2, starts_before=math.inf)
        spearman, square, serial = verdict.tests
        assert verdict.rejected
        assert max(test.p_value for test in verdict.tests) < 1e-6
        assert abs(spearman.effect - spearman_of(correlation)) < 4 / math.sqrt(samples)
        assert abs(square.effect - 2 / math.pi * math.asin(correlation)) < 4 / math.sqrt(samples)
        assert abs(serial.effect - spearman_of(correlation)) < 4 * serial.effect_error
        assert spearman.sizes == square.sizes == (samples,)
        assert serial.sizes == (samples * (10 - lag - 2), samples)

    @pytest.mark.parametrize("lag", [1, 5])
    def test_factor_shared_within_a_sample(self, lag):
        """Half the variance of the logarithm is the sample's: r = 0.5 at any lag."""
        tests = independent(shared(np.random.default_rng(1)), lag=lag).tests
        assert tests[2].p_value < 1e-6
        assert abs(tests[2].effect - spearman_of(0.5)) < 4 * tests[2].effect_error

    def test_dependence_without_correlation(self):
        """The next one is the distance from the median: chi-square sees it, correlations cannot."""
        early = np.random.default_rng(2).uniform(size=3000)
        spearman, square, _ = independent(rows(np.stack([early, np.abs(2 * early - 1)], axis=1))).tests
        assert abs(spearman.effect) < 4 / math.sqrt(3000)
        assert square.p_value < 1e-100
        assert square.effect > 0.5

    def test_equal_durations_are_as_dependent_as_can_be(self):
        values = np.random.default_rng(2).uniform(size=(500, 1)) * np.ones(2)
        assert [test.effect for test in independent(rows(values)).tests] == pytest.approx([1, 1, 1], abs=1e-12)

    def test_drift_of_the_law(self):
        """Exponential durations of the means 1, 1, 1, 1, s: the farthest distance is at x = s ln(s) / (s - 1).

        A distance has at most the error sqrt(1 / (4 n) + 1 / (4 m)); the difference of means, in within-order standard
        deviations of sqrt((4 + s^2) / 5), at most that of two means with s.
        """
        s, samples = 1.5, 20_000
        durations = np.random.default_rng(4).exponential(1, (samples, 5)) * [1, 1, 1, 1, s]
        verdict = identically_distributed(rows(durations), starts_before=math.inf)
        together, pairs = verdict.tests
        assert verdict.rejected
        assert together.sizes == (samples // 5,) * 5
        assert max(together.p_value, pairs.p_value) < 1e-6
        truth = s ** (-1 / (s - 1)) - s ** (-s / (s - 1))
        # The largest of several distances and differences lies a little above a single one: 5 errors, not 4.
        assert abs(pairs.effect - truth) < 5 * math.sqrt(2 / (4 * samples / 5))
        deviation = math.sqrt((4 + s**2) / 5)
        assert abs(together.effect - (s - 1) / deviation) < 5 * math.sqrt((1 + s**2) / (samples / 5)) / deviation
        others = [part.p_value for part in pairs.parts if not part.name.endswith("and 5")]
        assert len(others) == 6
        assert min(holm(others)) > CHANCE
        assert independent(rows(durations)).rejected is False

    def test_more_samples_find_more(self):
        """Also where the end of the simulation cuts: the longest of more samples is longer, and none may be lost."""
        p_values = []
        for samples in (1000, 3000, 10_000, 30_000):
            rng = np.random.default_rng(samples)
            durations = rng.exponential(1, (samples, 15)) * np.where(np.arange(15) == 2, 1.2, 1.0)
            sticks = flat(np.full(samples, 15), durations.ravel(), rng.gamma(2, 0.5, durations.size), horizon=25.0)
            p_values.append(identically_distributed(sticks).p_value)
        assert np.all(np.diff(p_values) < 0)
        assert p_values[0] > 1e-3
        assert p_values[-1] < 1e-12

    @pytest.mark.slow
    def test_seldom_missed(self):
        """300 samples suffice; what is 100 % in truth is never missed in 50 repeats."""

        def dependent(rng):
            return rows(np.exp(autoregressive(rng, 300, 8, np.full(300, 0.4))))

        def drifting(rng):
            return rows(rng.gamma(2, 1, (300, 5)) * [1, 1, 1, 1, 2])

        for design in (dependent, drifting):
            _, found = repeated(design, lambda sticks: independent_and_identical(sticks, starts_before=math.inf), 50)
            assert found == 50
