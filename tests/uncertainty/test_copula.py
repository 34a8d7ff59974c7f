"""A Gaussian copula: correlations by z-scores and closed forms, uniform marginals, derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import stickslip_jax as ss

NAMES = ("mu", "stiffness", "y0[0]")
CORRELATION = np.array([[1.0, 0.6, -0.3], [0.6, 1.0, 0.2], [-0.3, 0.2, 1.0]])
SAMPLES = 40_000


@pytest.fixture(scope="module")
def drawn():
    """Independent numbers, and what the copula makes of them."""
    u = np.random.default_rng(5).uniform(size=(SAMPLES, 3))
    return u, np.asarray(eqx.filter_jit(ss.GaussianCopula(NAMES, CORRELATION).correlated)(jnp.asarray(u)))


def test_normal_scores_are_those_of_the_cholesky_factor(drawn):
    u, v = drawn
    expected = stats.norm.cdf(stats.norm.ppf(u) @ np.linalg.cholesky(CORRELATION).T)
    np.testing.assert_allclose(v, expected, rtol=1e-12)
    np.testing.assert_allclose(v[:, 0], u[:, 0], rtol=1e-12)


def test_correlations_of_normal_scores(drawn):
    """Fisher's transformation of a sample correlation is normal with standard deviation 1 / sqrt(n - 3)."""
    found = np.corrcoef(stats.norm.ppf(drawn[1]).T)[np.triu_indices(3, 1)]
    exact = CORRELATION[np.triu_indices(3, 1)]
    z = (np.arctanh(found) - np.arctanh(exact)) * np.sqrt(SAMPLES - 3)
    assert np.all(np.abs(z) < 4)


def test_every_number_stays_uniform(drawn):
    """By the test of Kolmogorov and Smirnov."""
    for column in drawn[1].T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3
    assert np.all((drawn[1] > 0) & (drawn[1] < 1))


@pytest.mark.slow
def test_rank_correlations_are_those_asked_for():
    """Spearman's correlation of a sample, its standard error from 20 batches."""
    ranks = np.array([[1.0, 0.7, -0.4], [0.7, 1.0, 0.0], [-0.4, 0.0, 1.0]])
    copula = ss.GaussianCopula.from_spearman(NAMES, ranks)
    np.testing.assert_allclose(copula.correlation, 2 * np.sin(np.pi * ranks / 6), rtol=1e-15)
    u = np.random.default_rng(6).uniform(size=(SAMPLES, 3))
    v = copula.correlated(jnp.asarray(u)).reshape(20, -1, 3)
    # Distributions that only increase leave ranks as they are.
    x = np.stack([ss.Weibull(2.0, 0.7).icdf(v[..., 0]), ss.Normal(0.0, 1.0).icdf(v[..., 1]), v[..., 2]], axis=-1)
    found = np.array([stats.spearmanr(batch).statistic[np.triu_indices(3, 1)] for batch in x])
    z = (found.mean(axis=0) - ranks[np.triu_indices(3, 1)]) / (found.std(axis=0, ddof=1) / np.sqrt(20))
    assert np.all(np.abs(z) < stats.t.ppf(1 - 1e-4, 19))


@pytest.mark.slow
def test_no_correlation_changes_nothing():
    u = np.random.default_rng(7).uniform(size=(50, 2))
    found = ss.GaussianCopula(("a", "b"), np.eye(2)).correlated(jnp.asarray(u))
    np.testing.assert_allclose(found, u, rtol=1e-12)


@pytest.mark.slow
def test_derivatives_by_numbers_and_by_a_correlation():
    """Against the closed form: with normal scores x and y = r x + sqrt(1 - r^2) e, dy/dr = x - r e / sqrt(1 - r^2)."""
    u, r = np.array([0.2, 0.7]), 0.4
    x, e = stats.norm.ppf(u)

    def second(u, r):
        matrix = jnp.stack([jnp.stack([1.0, r]), jnp.stack([r, 1.0])])
        return ss.GaussianCopula(("a", "b"), matrix).correlated(u)[1]

    y = r * x + np.sqrt(1 - r**2) * e
    by_u, by_r = jax.jit(jax.grad(second, argnums=(0, 1)))(jnp.asarray(u), jnp.asarray(r))
    expected = stats.norm.pdf(y) * np.array([r, np.sqrt(1 - r**2)]) / stats.norm.pdf([x, e])
    np.testing.assert_allclose(by_u, expected, rtol=1e-10)
    np.testing.assert_allclose(by_r, stats.norm.pdf(y) * (x - r * e / np.sqrt(1 - r**2)), rtol=1e-10)


@pytest.mark.slow
def test_one_sample_is_the_same_alone_and_among_others(drawn):
    """To the last bit: ensembles are cut into chunks anywhere."""
    u, v = drawn
    correlated = eqx.filter_jit(ss.GaussianCopula(NAMES, CORRELATION).correlated)
    for rows in (slice(0, 7), slice(100, 356)):
        np.testing.assert_array_equal(correlated(jnp.asarray(u[rows])), v[rows])
    np.testing.assert_array_equal(jax.vmap(correlated)(jnp.asarray(u[:7])), v[:7])


@pytest.mark.slow
def test_float32_stays_within_zero_and_one():
    """The largest and smallest numbers of float32 draws, correlated with each other."""
    near = np.float32([2.0**-24, 1 - 2.0**-24])
    u = jnp.asarray(np.stack(np.meshgrid(near, near, near), axis=-1).reshape(-1, 3))
    found = ss.GaussianCopula(NAMES, CORRELATION).correlated(u)
    assert found.dtype == jnp.float32
    assert np.all((found > 0) & (found < 1))
    assert np.all(np.isfinite(ss.Normal(0.0, 1.0).icdf(found)))
