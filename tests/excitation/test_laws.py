"""The random laws draw what they promise: distribution tests with fixed keys, and exact properties.

A test with a fixed key gives the same answer for ever. Its bound was fixed beforehand: `CHANCE` is the probability
that a correct law fails it for a key picked blindly.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import stickslip_jax as ss

CHANCE = 1e-3
DRAWS = 20_000


def sample(law, seed=0, t1=1.0, capacity=DRAWS):
    base = law.sample(jax.random.key(seed), t1, capacity=capacity)
    return np.asarray(base.durations), np.asarray(base.velocities)


def samples(law, lanes, capacity, seed=1):
    """The first intervals of many realisations."""
    keys = jax.random.split(jax.random.key(seed), lanes)
    base = jax.jit(jax.vmap(lambda key: law.sample(key, 1.0, capacity=capacity)))(keys)
    return np.asarray(base.durations), np.asarray(base.velocities)


def steps_of(durations, velocities, interval):
    """The run lengths drawn at once, written out again as one level a step."""
    counts = np.rint(durations / interval).astype(int)
    np.testing.assert_allclose(durations, counts * interval, rtol=1e-12)
    assert counts.min() >= 1
    return np.repeat(velocities, counts)


class TestPoissonSwitching:
    law = ss.PoissonSwitching(speed=0.7, rate=2.5)

    @pytest.mark.parametrize("seed", [0, 1])
    def test_gaps_are_exponential(self, seed):
        gaps, _ = sample(self.law, seed)
        assert stats.kstest(gaps, stats.expon(scale=1 / 2.5).cdf).pvalue > CHANCE

    @pytest.mark.parametrize("number", [0, 1, 7])
    def test_gaps_across_keys_are_exponential(self, number):
        gaps, _ = samples(self.law, DRAWS, 8)
        assert stats.kstest(gaps[:, number], stats.expon(scale=1 / 2.5).cdf).pvalue > CHANCE

    def test_neighboring_gaps_are_independent(self):
        gaps, _ = sample(self.law, 3)
        lagged = stats.spearmanr(gaps[:-1], gaps[1:])
        assert lagged.pvalue > CHANCE
        many, _ = samples(self.law, DRAWS, 2)
        assert stats.spearmanr(many[:, 0], many[:, 1]).pvalue > CHANCE

    def test_counts_are_poisson(self):
        """Switches before t = 3: mean and variance both 7.5 (chi-square of the count's histogram)."""
        gaps, _ = samples(self.law, DRAWS, 40, seed=5)
        counts = (np.cumsum(gaps, axis=1) < 3).sum(axis=1)
        edges = np.arange(2, 15)
        seen = np.bincount(np.clip(counts, 2, 14), minlength=15)[2:]
        law = stats.poisson(7.5)
        odds = law.pmf(edges)
        odds[0], odds[-1] = law.cdf(2), law.sf(13)
        assert stats.chisquare(seen, DRAWS * odds).pvalue > CHANCE

    def test_first_sign_is_a_fair_coin(self):
        _, velocities = samples(self.law, DRAWS, 1)
        heads = int((velocities[:, 0] > 0).sum())
        assert stats.binomtest(heads, DRAWS, 0.5).pvalue > CHANCE

    def test_first_sign_and_first_gap_are_independent(self):
        gaps, velocities = samples(self.law, DRAWS, 1, seed=9)
        up = velocities[:, 0] > 0
        assert stats.ks_2samp(gaps[up, 0], gaps[~up, 0]).pvalue > CHANCE

    @pytest.mark.parametrize(("first_sign", "first"), [("positive", 0.7), ("negative", -0.7)])
    def test_signs_alternate_from_the_chosen_one(self, first_sign, first):
        law = ss.PoissonSwitching(speed=0.7, rate=2.5, first_sign=first_sign)
        _, velocities = sample(law, capacity=50)
        assert velocities.tolist() == [first, -first] * 25

    def test_signs_alternate_from_a_random_one(self):
        _, velocities = samples(self.law, 20, 50)
        assert np.all(np.abs(velocities) == 0.7)
        assert np.all(velocities[:, 1:] == -velocities[:, :-1])

    def test_gaps_scale_with_the_rate(self):
        gaps, _ = sample(ss.PoissonSwitching(1.0, 1.0), 4, capacity=100)
        faster, _ = sample(ss.PoissonSwitching(1.0, 8.0), 4, capacity=100)
        assert (gaps / 8).tolist() == faster.tolist()

    def test_float32_gaps_are_exponential(self):
        with jax.enable_x64(False):
            gaps, _ = sample(self.law, 6)
            assert gaps.dtype == np.float32
        assert np.all(gaps > 0)
        assert stats.kstest(gaps, stats.expon(scale=1 / 2.5).cdf).pvalue > CHANCE

    def test_default_capacity_covers_every_realization_tried(self):
        keys = jax.random.split(jax.random.key(8), 5000)
        reached = jax.jit(jax.vmap(lambda key: self.law.sample(key, 20.0).durations.sum()))(keys)
        assert float(reached.min()) >= 20.0


class TestRandomSteps:
    interval = 0.25
    odds = (0.2, 0.5, 0.3)
    coin = ss.RandomSteps(speed=2.0, interval=0.25)
    three = ss.RandomSteps(speed=2.0, interval=0.25, levels=(-1.0, 0.0, 1.5), probabilities=(0.2, 0.5, 0.3))

    def geometric_pvalue(self, counts, stay):
        """Chi-square of run lengths against the geometric law of leaving with chance ``1 - stay`` each step."""
        law = stats.geom(1 - stay)
        last = int(law.isf(20 / len(counts))) + 1
        seen = np.bincount(np.minimum(counts, last), minlength=last + 1)[1:]
        expected = law.pmf(np.arange(1, last + 1))
        expected[-1] = law.sf(last - 1)
        return stats.chisquare(seen, len(counts) * expected).pvalue

    def test_run_lengths_are_geometric(self):
        durations, _ = sample(self.coin)
        counts = np.rint(durations / self.interval).astype(int)
        assert self.geometric_pvalue(counts, 0.5) > CHANCE

    def test_run_lengths_of_each_level_are_geometric(self):
        durations, velocities = sample(self.three, 2)
        counts = np.rint(durations / self.interval).astype(int)
        for level, chance in zip((-2.0, 0.0, 3.0), self.odds, strict=True):
            assert self.geometric_pvalue(counts[velocities == level], chance) > CHANCE

    @pytest.mark.slow
    def test_neighboring_velocities_differ(self):
        for law in (self.coin, self.three):
            _, velocities = samples(law, 20, 200)
            assert np.all(velocities[:, 1:] != velocities[:, :-1])

    def test_first_level_follows_the_odds(self):
        _, velocities = samples(self.three, DRAWS, 1)
        seen = [(velocities[:, 0] == level).sum() for level in (-2.0, 0.0, 3.0)]
        assert sum(seen) == DRAWS
        assert stats.chisquare(seen, DRAWS * np.asarray(self.odds)).pvalue > CHANCE

    def test_steps_are_independent_draws(self):
        """Written out step by step, single levels and pairs of neighbours follow the odds and their products."""
        steps = steps_of(*sample(self.three, 3), self.interval)[: 3 * DRAWS // 2]
        assert len(steps) == 3 * DRAWS // 2
        level = np.searchsorted([-2.0, 0.0, 3.0], steps)
        counts = np.bincount(level, minlength=3)
        assert stats.chisquare(counts, len(level) * np.asarray(self.odds)).pvalue > CHANCE
        pairs = np.bincount(3 * level[::2] + level[1::2], minlength=9)
        assert stats.chisquare(pairs, len(level) / 2 * np.outer(self.odds, self.odds).ravel()).pvalue > CHANCE
        distant = np.bincount(3 * level[:-3:4] + level[3::4], minlength=9)
        assert stats.chisquare(distant, distant.sum() * np.outer(self.odds, self.odds).ravel()).pvalue > CHANCE

    def test_a_given_step_follows_the_odds(self):
        """Step number 6 across many keys: no bias from drawing runs at once."""
        durations, velocities = samples(self.three, DRAWS, 12, seed=4)
        ends = np.cumsum(np.rint(durations / self.interval), axis=1)
        assert np.all(ends[:, -1] > 6)
        sixth = velocities[np.arange(DRAWS), (ends <= 6).sum(axis=1)]
        seen = [(sixth == level).sum() for level in (-2.0, 0.0, 3.0)]
        assert stats.chisquare(seen, DRAWS * np.asarray(self.odds)).pvalue > CHANCE

    def test_jumps_follow_the_odds_of_the_other_levels(self):
        _, velocities = sample(self.three, 5)
        level = np.searchsorted([-2.0, 0.0, 3.0], velocities)
        for present in range(3):
            following = np.bincount(level[1:][level[:-1] == present], minlength=3)
            others = [index for index in range(3) if index != present]
            expected = np.asarray(self.odds)[others] / (1 - self.odds[present])
            assert following[present] == 0
            assert stats.chisquare(following[others], following.sum() * expected).pvalue > CHANCE

    def test_share_of_time_at_each_level(self):
        """The share of the first 8000 steps, independent draws: standard error sqrt(p (1 - p) / 8000)."""
        steps = steps_of(*sample(self.three, 6), self.interval)[:8000]
        for level, chance in zip((-2.0, 0.0, 3.0), self.odds, strict=True):
            z = (np.mean(steps == level) - chance) / np.sqrt(chance * (1 - chance) / 8000)
            assert abs(z) < stats.norm.isf(CHANCE / 2)

    def test_default_capacity_always_suffices(self):
        """Even where every step changes the level there is one interval a step."""
        keys = jax.random.split(jax.random.key(8), 2000)
        reached = jax.jit(jax.vmap(lambda key: self.coin.sample(key, 10.0).durations.sum()))(keys)
        assert float(reached.min()) >= 10.0


class TestGivenMotions:
    def test_square_wave(self):
        base = ss.SquareWave(speed=1.5, period=0.8).sample(None, 4.0)
        assert np.asarray(base.durations).tolist() == [0.4] * len(base.durations)
        assert np.asarray(base.times) == pytest.approx(0.4 * np.arange(len(base.durations)), abs=1e-15)
        assert float(base.durations.sum()) >= 4.0
        assert np.asarray(base.velocity(jnp.array([0.0, 0.39, 0.41, 0.79, 0.81]))).tolist() == [
            -1.5,
            -1.5,
            1.5,
            1.5,
            -1.5,
        ]

    def test_constant_lasts_for_ever(self):
        base = ss.Constant(-0.3).sample(None, 4.0, capacity=3)
        assert np.asarray(base.durations).tolist() == [np.inf, 0.0, 0.0]
        assert np.asarray(base.velocity(jnp.array([0.0, 1e9]))).tolist() == [-0.3, -0.3]

    def test_piecewise_constant_merges_equal_neighbors(self):
        law = ss.PiecewiseConstant(jnp.array([0.0, 1.0, 1.5, 4.0, 5.0]), jnp.array([1.0, 1.0, 0.0, 0.0, 1.0]))
        base = law.sample(None, 9.0)
        assert np.asarray(base.durations).tolist() == [1.5, 3.5, np.inf, 0.0, 0.0]
        assert np.asarray(base.velocities)[:3].tolist() == [1.0, 0.0, 1.0]

    def test_velocity_at_any_time(self):
        """At a jump the velocity after it; any shape; spare slots never show; the last velocity lasts."""
        base = ss.VelocitySteps(jnp.array([1.0, 2.0, 0.5, 0.0, 0.0]), jnp.array([3.0, -1.0, 2.0, 9.0, 9.0]))
        times = jnp.array([[0.0, 0.999, 1.0], [2.9, 3.0, 99.0]])
        assert np.asarray(base.velocity(times)).tolist() == [[3.0, 3.0, -1.0], [-1.0, 2.0, 2.0]]
        assert float(base.velocity(1.0)) == -1.0
        assert np.asarray(base.times).tolist() == [0.0, 1.0, 3.0, 3.5, 3.5]


LAWS = [
    ss.PoissonSwitching(speed=0.7, rate=2.5),
    ss.RandomSteps(speed=2.0, interval=0.25),
    ss.RandomSteps(speed=2.0, interval=0.25, levels=(-1.0, 0.0, 1.5), probabilities=(0.2, 0.5, 0.3)),
]


def assert_same_base(one, other):
    assert np.asarray(one.durations).tolist() == np.asarray(other.durations).tolist()
    assert np.asarray(one.velocities).tolist() == np.asarray(other.velocities).tolist()


@pytest.mark.parametrize("law", LAWS, ids=lambda law: f"{type(law).__name__}")
class TestEveryRandomLaw:
    @pytest.mark.slow_but_for("PoissonSwitching")
    def test_larger_sample_begins_with_the_smaller(self, law):
        small, large = (sample(law, 3, capacity=capacity) for capacity in (17, 300))
        for little, much in zip(small, large, strict=True):
            assert little.tolist() == much[:17].tolist()

    @pytest.mark.slow_but_for("PoissonSwitching")
    def test_intervals_come_one_after_the_other(self, law):
        """Drawn one by one, each from its own number, as an ensemble does: the same realisation."""
        key_data = law.key_data(jax.random.key(3))
        memory = law.begin(key_data, jnp.float64)
        whole = zip(*sample(law, 3, capacity=6), strict=True)
        for number, expected in enumerate(whole):
            drawn = law.draw(key_data, jnp.uint32(number), jnp.float64)
            duration, velocity, memory = law.next_interval(memory, drawn, jnp.float64)
            assert (float(duration), float(velocity)) == pytest.approx(expected, rel=1e-15)

    def test_same_key_same_realization(self, law):
        assert_same_base(law.sample(jax.random.key(1), 9.0), law.sample(jax.random.key(1), 9.0))

    def test_different_keys_differ(self, law):
        one, other = law.sample(jax.random.key(1), 9.0), law.sample(jax.random.key(2), 9.0)
        assert np.asarray(one.durations).tolist() != np.asarray(other.durations).tolist()

    def test_legacy_keys_give_the_same(self, law):
        assert_same_base(law.sample(jax.random.PRNGKey(1), 9.0), law.sample(jax.random.key(1), 9.0))

    def test_other_generators_are_refused(self, law):
        for name in ("rbg", "unsafe_rbg"):
            with pytest.raises(ValueError, match=r"Argument key must be .*threefry key"):
                law.sample(jax.random.key(0, impl=name), 9.0)

    def test_key_is_required(self, law):
        with pytest.raises(ValueError, match=r"Argument key must be a key such as jax\.random\.key"):
            law.sample(None, 9.0)

    def test_capacity_is_required_when_t1_is_traced(self, law):
        with pytest.raises(ValueError, match="Argument capacity must be given"):
            jax.jit(lambda t1: law.sample(jax.random.key(0), t1))(9.0)

    def test_capacity_is_required_when_the_law_is_traced(self, law):
        with pytest.raises(ValueError, match="Argument capacity must be given"):
            jax.jit(lambda traced: traced.sample(jax.random.key(0), 9.0))(law)

    def test_traced_keys_need_no_capacity(self, law):
        compiled = jax.jit(lambda key: law.sample(key, 9.0))(jax.random.key(4))
        plain = law.sample(jax.random.key(4), 9.0)
        assert np.asarray(compiled.durations) == pytest.approx(np.asarray(plain.durations), rel=1e-15)

    @pytest.mark.slow
    def test_vmap_gives_each_key_its_own(self, law):
        keys = jax.random.split(jax.random.key(11), 3)
        many = jax.vmap(lambda key: law.sample(key, 9.0))(keys)
        for index in range(3):
            alone = law.sample(keys[index], 9.0)
            assert np.asarray(many.durations)[index] == pytest.approx(np.asarray(alone.durations), rel=1e-15)
