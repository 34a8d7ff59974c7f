"""Semi-Markov switching draws the gaps and velocities that it promises, and switches often enough for any time.

A test with a fixed key gives the same answer for ever. Its bound was fixed beforehand: `CHANCE` is the probability
that a correct law fails it for a key picked blindly.
"""

import math

import jax
import numpy as np
import pytest
from scipy import stats

import stickslip_jax as ss

CHANCE = 1e-3
DRAWS = 20_000
KEY = jax.random.key(11)
SYSTEM = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.4))


def sample(law, seed=0, capacity=DRAWS):
    base = law.sample(jax.random.key(seed), 1.0, capacity=capacity)
    return np.asarray(base.durations), np.asarray(base.velocities)


def firsts(law, capacity=3, lanes=DRAWS):
    """The first intervals of many realisations."""
    keys = jax.random.split(jax.random.key(1), lanes)
    base = jax.jit(jax.vmap(lambda key: law.sample(key, 1.0, capacity=capacity)))(keys)
    return np.asarray(base.durations), np.asarray(base.velocities)


GAPS = {
    "exponential": (ss.Exponential(0.4), stats.expon(scale=0.4)),
    "Weibull": (ss.Weibull(2.0, 1.5), stats.weibull_min(1.5, scale=2.0)),
    "log-normal": (ss.LogNormal(1.5, 0.6), stats.lognorm(0.6, scale=1.5)),
    "uniform": (ss.Uniform(0.5, 0.8), stats.uniform(0.5, 0.3)),
    "truncated": (ss.Truncated(ss.Normal(1.0, 0.5), low=0.2), stats.truncnorm(-1.6, np.inf, 1.0, 0.5)),
}


class TestGaps:
    @pytest.mark.slow
    @pytest.mark.parametrize("case", GAPS)
    def test_distribution(self, case):
        gap, expected = GAPS[case]
        gaps, _ = sample(ss.SemiMarkovSwitching(gap, 1.0))
        assert stats.kstest(gaps, expected.cdf).pvalue > CHANCE
        assert stats.spearmanr(gaps[:-1], gaps[1:]).pvalue > CHANCE

    def test_distribution_of_the_first_and_the_third_across_keys(self):
        gap, expected = GAPS["Weibull"]
        gaps, _ = firsts(ss.SemiMarkovSwitching(gap, 1.0))
        for number in (0, 2):
            assert stats.kstest(gaps[:, number], expected.cdf).pvalue > CHANCE

    def test_discrete(self):
        gaps, _ = sample(ss.SemiMarkovSwitching(ss.Discrete([0.5, 1.0, 4.0], [0.2, 0.5, 0.3]), 1.0))
        values, counts = np.unique(gaps, return_counts=True)
        assert values.tolist() == [0.5, 1.0, 4.0]
        assert stats.chisquare(counts, DRAWS * np.array([0.2, 0.5, 0.3])).pvalue > CHANCE

    def test_float32(self):
        with jax.enable_x64(False):
            gaps, velocities = sample(ss.SemiMarkovSwitching(ss.Weibull(2.0, 1.5), ss.LogNormal(1.0, 0.2)))
        assert gaps.dtype == velocities.dtype == np.float32
        assert stats.kstest(gaps, stats.weibull_min(1.5, scale=2.0).cdf).pvalue > CHANCE

    def test_time_goes_on_however_short_the_gaps(self):
        """One gap in 60 is shorter than the rounding of a time of 1 s, some are too short for a number."""
        law = ss.SemiMarkovSwitching(ss.Weibull(1e-3, 0.11), 1.0)
        gaps, _ = sample(law, capacity=2000)
        drawn = stats.weibull_min(0.11, scale=1e-3)
        assert drawn.cdf(2.0**-53) > 0.03
        times = np.cumsum(gaps[gaps.cumsum() < 1e6])
        assert np.all(np.diff(times) > 0)
        long = gaps[gaps > 1e-8]
        share = drawn.sf(1e-8)
        assert abs(len(long) - 2000 * share) < 4 * math.sqrt(2000 * share * (1 - share))


class TestVelocities:
    def test_numbers_alternate(self):
        _, velocities = sample(ss.SemiMarkovSwitching(ss.Exponential(1.0), 0.7, first_sign="negative"), capacity=40)
        assert velocities.tolist() == [-0.7, 0.7] * 20

    def test_first_sign_is_a_fair_coin(self):
        _, velocities = firsts(ss.SemiMarkovSwitching(ss.Exponential(1.0), 0.7))
        assert stats.binomtest(int((velocities[:, 0] > 0).sum()), DRAWS, 0.5).pvalue > CHANCE

    def test_distribution_of_alternating_speeds(self):
        gaps, velocities = sample(ss.SemiMarkovSwitching(ss.Exponential(1.0), ss.LogNormal(1.0, 0.5)))
        assert np.all(np.sign(velocities[1:]) == -np.sign(velocities[:-1]))
        assert stats.kstest(np.abs(velocities), stats.lognorm(0.5).cdf).pvalue > CHANCE
        assert stats.spearmanr(np.abs(velocities[:-1]), np.abs(velocities[1:])).pvalue > CHANCE
        assert stats.spearmanr(gaps, np.abs(velocities)).pvalue > CHANCE

    def test_distribution_of_signed_velocities(self):
        law = ss.SemiMarkovSwitching(ss.Exponential(1.0), ss.Normal(0.2, 0.5), alternating=False)
        gaps, velocities = sample(law)
        assert stats.kstest(velocities, stats.norm(0.2, 0.5).cdf).pvalue > CHANCE
        assert stats.spearmanr(velocities[:-1], velocities[1:]).pvalue > CHANCE
        assert stats.spearmanr(gaps, velocities).pvalue > CHANCE
        assert np.all(np.diff(velocities) != 0)

    def test_gaps_are_the_same_whatever_the_speeds(self):
        laws = [ss.SemiMarkovSwitching(ss.Exponential(1.0), speed) for speed in (1.0, ss.Uniform(0.5, 1.0))]
        one, other = (sample(law, capacity=30)[0].tolist() for law in laws)
        assert one == other


class TestDiscreteVelocities:
    levels, odds = np.array([-1.0, 0.0, 1.5]), np.array([0.2, 0.5, 0.3])
    law = ss.SemiMarkovSwitching(ss.Exponential(1.0), ss.Discrete([-1.0, 0.0, 1.5], [0.2, 0.5, 0.3]), alternating=False)

    def test_each_is_drawn_from_the_others(self):
        """Transitions from i to j with probability ``p_j / (1 - p_i)``."""
        _, velocities = sample(self.law)
        index = np.searchsorted(self.levels, velocities)
        assert np.all(index[1:] != index[:-1])
        for before in range(3):
            following = index[1:][index[:-1] == before]
            counts = np.delete(np.bincount(following, minlength=3), before)
            others = np.delete(self.odds, before)
            assert stats.chisquare(counts, len(following) * others / others.sum()).pvalue > CHANCE

    def test_first_has_the_probabilities_given(self):
        _, velocities = firsts(self.law)
        counts = np.bincount(np.searchsorted(self.levels, velocities[:, 0]), minlength=3)
        assert stats.chisquare(counts, DRAWS * self.odds).pvalue > CHANCE

    def test_long_run_shares(self):
        """In proportion to p (1 - p): z-scores by the spread of 50 parts of a long realisation."""
        _, velocities = sample(self.law, 3)
        parts = (velocities.reshape(50, -1)[..., None] == self.levels).mean(axis=1)
        expected = self.odds * (1 - self.odds) / np.sum(self.odds * (1 - self.odds))
        scores = (parts.mean(axis=0) - expected) / (parts.std(axis=0, ddof=1) / math.sqrt(50))
        assert np.max(np.abs(scores)) < stats.t(49).isf(CHANCE / 6)


class TestAgainstPoisson:
    """With exponential gaps it is `PoissonSwitching`, drawn by other numbers."""

    def test_number_of_switches(self):
        gaps, _ = firsts(ss.SemiMarkovSwitching(ss.Exponential(0.4), 1.0), capacity=40)
        counts = (np.cumsum(gaps, axis=1) < 3).sum(axis=1)
        law = stats.poisson(7.5)
        odds = law.pmf(np.arange(2, 15))
        odds[0], odds[-1] = law.cdf(2), law.sf(13)
        seen = np.bincount(np.clip(counts, 2, 14), minlength=15)[2:]
        assert stats.chisquare(seen, DRAWS * odds).pvalue > CHANCE

    @pytest.mark.slow
    def test_statistics_of_sticks(self):
        laws = ss.SemiMarkovSwitching(ss.Exponential(0.8), 1.0), ss.PoissonSwitching(1.0, 1.25)
        runs = [
            ss.simulate_ensemble(SYSTEM, law, t1=30.0, samples=8192, key=jax.random.key(seed), keep="totals")
            for seed, law in enumerate(laws)
        ]
        assert all(run.finished == 8192 for run in runs)
        means = np.array([run.moments.mean[:3] for run in runs])
        variances = np.array([np.diag(run.moments.scatter)[:3] for run in runs]) / 8192**2
        scores = (means[0] - means[1]) / np.sqrt(variances.sum(axis=0))
        assert np.all(means > 0)
        assert np.max(np.abs(scores)) < stats.norm.isf(CHANCE / 6)

    @pytest.mark.slow
    def test_sensitivities(self):
        """By the mean gap, ``-rate^2`` times that by the rate; and by the speed."""
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(4 / 2.8))
        y0 = ss.Uniform(-0.65, 0.65), ss.Uniform(-0.9, 0.9)
        case = {"t1": 50.0, "y0": y0, "samples": 16_384, "estimator": "corrected"}
        law, poisson = ss.SemiMarkovSwitching(ss.Exponential(0.5), 1.0), ss.PoissonSwitching(1.0, 2.0)
        pairs = {"gap.mean": ("rate", -4.0), "law.speed": ("law.speed", 1.0)}
        found = ss.sensitivity(ss.mean_stick_count, system, law, key=jax.random.key(1), wrt=tuple(pairs), **case)
        expected = ss.sensitivity(
            ss.mean_stick_count, system, poisson, key=jax.random.key(2), wrt=("rate", "law.speed"), **case
        )
        for name, (other, factor) in pairs.items():
            error = math.hypot(found[name].standard_error, factor * expected[other].standard_error)
            assert abs(found[name].derivative - factor * expected[other].derivative) < 4 * error
            if name == "law.speed":
                assert abs(found[name].derivative) > 10 * error


class TestCapacity:
    @pytest.mark.parametrize("t1", [0.1, 3.0, 40.0, 5000.0])
    def test_exponential(self, t1):
        """Exactly: more than n intervals are needed if a Poisson number is n or more."""
        number = ss.SemiMarkovSwitching(ss.Exponential(0.4), 1.0).capacity(t1)
        switches = stats.poisson(t1 / 0.4)
        assert switches.sf(number - 1) < 1e-9
        assert number < 1.1 * switches.isf(1e-9) + 12  # and it is not far too many

    @pytest.mark.parametrize("t1", [3.0, 40.0, 1000.0])
    def test_two_gaps(self, t1):
        """Exactly: n gaps of 0.1 s or 2 s last n / 10 s, and 1.9 s more for each of a binomial number."""
        number = ss.SemiMarkovSwitching(ss.Discrete([0.1, 2.0], [0.7, 0.3]), 1.0).capacity(t1)

        def chance(number):
            return stats.binom(number, 0.3).cdf(math.ceil((t1 - 0.1 * number) / 1.9 - 1e-9) - 1)

        assert chance(number) < 1e-9
        assert chance(number * 0.8 // 1 - 12) > 1e-12 or number < 45

    @pytest.mark.slow_but_for("Weibull")
    @pytest.mark.parametrize("case", GAPS)
    def test_covers_every_realization_tried(self, case):
        law = ss.SemiMarkovSwitching(GAPS[case][0], 1.0)
        keys = jax.random.split(jax.random.key(8), 4000)
        reached = jax.jit(jax.vmap(lambda key: law.sample(key, 25.0).durations.sum()))(keys)
        assert float(reached.min()) >= 25.0

    @pytest.mark.slow
    def test_numbers_in_a_compiled_function_are_known(self):
        def reached(key):
            law = ss.SemiMarkovSwitching(ss.Truncated(ss.Normal(1.0, 0.5), low=0.2), ss.Uniform(0.5, 1.0))
            return law.sample(key, 25.0).durations.sum()

        assert float(jax.jit(reached)(KEY)) >= 25.0

    def test_traced(self):
        with pytest.raises(ValueError, match=r"capacity must be given when t1 or the law's parameters are traced"):
            jax.jit(lambda mean: ss.SemiMarkovSwitching(ss.Exponential(mean), 1.0).sample(KEY, 1.0))(0.4)


@pytest.mark.slow
def test_sample_repeats_each_sample_of_an_ensemble():
    """To the last bit, as it does for the other laws of piecewise-constant velocity."""
    law = ss.SemiMarkovSwitching(ss.Weibull(2.0, 1.5), ss.Uniform(0.5, 1.0))
    many = ss.simulate_ensemble(SYSTEM, law, t1=30.0, samples=64, key=KEY, keep="sticks")
    first = np.append(0, np.cumsum(many.flat_sticks.count))
    for number in range(8):
        _, base, y0 = many.realization(number)
        one = ss.simulate(SYSTEM, base, t1=30.0, y0=y0)
        count = int(one.sticks.count)
        mine = slice(first[number], first[number + 1])
        assert many.flat_sticks.start[mine] == pytest.approx(np.asarray(one.sticks.start)[:count], abs=1e-13)
        assert many.flat_sticks.end[mine] == pytest.approx(np.asarray(one.sticks.end)[:count], abs=1e-13)
    assert first[8] > 8


GAP = ss.Exponential(1.0)
BAD = {
    "a number": (lambda: ss.SemiMarkovSwitching(1.0, 1.0), r"gap must be a distribution of positive numbers \(in s\)"),
    "scipy": (
        lambda: ss.SemiMarkovSwitching(stats.expon(), 1.0),
        r"gap must be .* of stickslip_jax, such as Weibull.*give the quantiles as a RandomNumber of your own",
    ),
    "may be negative": (lambda: ss.SemiMarkovSwitching(ss.Normal(1.0, 0.5), 1.0), r"gap .* of whose draws 0.023 are"),
    "may be zero": (
        lambda: ss.SemiMarkovSwitching(ss.Discrete([0.0, 1.0]), 1.0),
        r"gap .* whose draws 0.5 are",
    ),
    "beta": (lambda: ss.SemiMarkovSwitching(ss.Beta(2.0, 3.0), 1.0), r"gap .* can be computed while simulating"),
    "speed": (lambda: ss.SemiMarkovSwitching(GAP, -1.0), r"speed must be positive \(in m/s\), but -1.0 was given"),
    "speeds of scipy": (lambda: ss.SemiMarkovSwitching(GAP, stats.uniform()), r"speed must be a distribution of posit"),
    "signed speed": (lambda: ss.SemiMarkovSwitching(GAP, ss.Normal(0.0, 1.0)), r"speed must be .* of whose draws 0.5"),
    "speed of no sign": (
        lambda: ss.SemiMarkovSwitching(GAP, 1.0, alternating=False),
        r"alternating must be True where speed is a number, but False and 1.0 were given",
    ),
    "one value": (
        lambda: ss.SemiMarkovSwitching(GAP, ss.Discrete([1.0, 2.0], [1.0, 0.0]), alternating=False),
        r"speed must have two or more values with positive probabilities",
    ),
    "alternating": (lambda: ss.SemiMarkovSwitching(GAP, 1.0, alternating=1), r"alternating must be True or False"),
    "first sign": (lambda: ss.SemiMarkovSwitching(GAP, 1.0, first_sign="up"), r"first_sign must be 'random'"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input(case, annotations_unchecked):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()
