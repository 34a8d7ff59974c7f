"""The distributions of a random number: quantiles, probabilities and derivatives against scipy.stats."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as some
from scipy import stats

import stickslip_jax as ss

U = np.array([1e-10, 1e-4, 0.01, 0.1, 0.25, 0.5, 0.6, 0.9, 0.99, 0.9999, 1 - 1e-10])


def truncated(make, number):
    """The last two of the parameters are the limits."""
    return lambda *p: ss.Truncated(make(*p[:number]), p[number], p[number + 1])


def cut(frozen, number):
    """The quantiles of scipy's distribution between two limits."""

    class Cut:
        def __init__(self, *p):
            self.whole, (self.low, self.high) = frozen(*p[:number]), p[number:]

        def ppf(self, u):
            low, high = self.whole.cdf(self.low), self.whole.cdf(self.high)
            return self.whole.ppf(low + (high - low) * u)

        def cdf(self, x):
            low, high = self.whole.cdf(self.low), self.whole.cdf(self.high)
            return np.clip((self.whole.cdf(x) - low) / (high - low), 0, 1)

    return Cut


def scipy_normal(mean, std):
    return stats.norm(mean, std)


def scipy_log_normal(median, log_std):
    return stats.lognorm(s=log_std, scale=median)


def scipy_beta(a, b, low=0.0, high=1.0):
    return stats.beta(a, b, low, high - low)


# Ours, scipy's, and parameters; the mode of the triangle, where it has a corner, is none of the quantiles of U.
CASES = {
    "Uniform": (ss.Uniform, lambda low, high: stats.uniform(low, high - low), (-0.2, 1.7)),
    "Normal": (ss.Normal, scipy_normal, (0.5, 0.1)),
    "LogNormal": (ss.LogNormal, scipy_log_normal, (4.0, 0.3)),
    "Beta": (ss.Beta, scipy_beta, (2.0, 3.5, -1.0, 2.0)),
    "Beta, most at the ends": (ss.Beta, scipy_beta, (0.4, 0.7, 0.0, 1.0)),
    "Triangular": (
        ss.Triangular, lambda low, mode, high: stats.triang((mode - low) / (high - low), low, high - low),
        (0.2, 0.53, 1.4),
    ),
    "Exponential": (ss.Exponential, lambda mean: stats.expon(scale=mean), (2.5,)),
    "Weibull": (ss.Weibull, lambda scale, shape: stats.weibull_min(shape, scale=scale), (2.0, 1.7)),
    "Truncated Normal": (truncated(ss.Normal, 2), cut(scipy_normal, 2), (0.5, 0.2, 0.2, 1.0)),
    "Truncated LogNormal": (truncated(ss.LogNormal, 2), cut(scipy_log_normal, 2), (4.0, 0.3, 3.0, 6.0)),
    "Truncated Beta": (truncated(ss.Beta, 2), cut(scipy_beta, 2), (2.0, 3.5, 0.1, 0.8)),
}  # fmt: skip
CASE = pytest.mark.parametrize("name", CASES)


def spread(frozen) -> float:
    return float(frozen.ppf(0.9) - frozen.ppf(0.1))


@pytest.mark.slow
@CASE
def test_quantiles_and_probabilities_are_those_of_scipy(name):
    make, reference, numbers = CASES[name]
    ours, frozen = make(*numbers), reference(*numbers)
    x = frozen.ppf(U)
    # The last one: there 1 - u has only six digits.
    np.testing.assert_allclose(ours.icdf(jnp.asarray(U))[:-1], x[:-1], rtol=1e-12, atol=1e-13 * spread(frozen))
    np.testing.assert_allclose(ours.icdf(jnp.asarray(U))[-1], x[-1], rtol=1e-6)
    np.testing.assert_allclose(ours.cdf(x), frozen.cdf(x), rtol=3e-12, atol=1e-15)
    low, high = (float(limit) for limit in ours.support)
    assert np.all((x >= low) & (x <= high))
    outside = np.array([low - 1, high + 1])
    outside = outside[np.isfinite(outside)]
    np.testing.assert_array_equal(ours.cdf(outside), (outside > low).astype(float))


def slope_of_scipy(reference, numbers, index, u):
    """The derivative of scipy's quantiles by a parameter: central differences, Richardson's error h^4."""

    def difference(step):
        up, down = (list(numbers) for _ in range(2))
        up[index], down[index] = numbers[index] + step, numbers[index] - step
        return (reference(*up).ppf(u) - reference(*down).ppf(u)) / (2 * step)

    step = 1e-3 * (abs(numbers[index]) or 1.0)
    return (4 * difference(step / 2) - difference(step)) / 3


@pytest.mark.slow
@CASE
def test_derivatives_of_quantiles_by_every_parameter(name):
    """Under jit, forward and backward."""
    make, reference, numbers = CASES[name]
    u = U[2:-2]
    icdf = lambda p: make(*p).icdf(jnp.asarray(u))  # noqa: E731
    values = tuple(jnp.asarray(number) for number in numbers)
    forward, backward = jax.jit(jax.jacfwd(icdf))(values), jax.jit(jax.jacrev(icdf))(values)
    size = spread(reference(*numbers))
    for index in range(len(numbers)):
        expected = slope_of_scipy(reference, numbers, index, u)
        np.testing.assert_allclose(forward[index], expected, rtol=1e-8, atol=1e-8 * size)
        np.testing.assert_allclose(backward[index], forward[index], rtol=1e-12, atol=1e-12 * size)


@pytest.mark.slow
@CASE
def test_derivatives_of_quantiles_by_u_are_one_over_the_density(name):
    """The density by scipy's cdf on both sides of the quantile."""
    make, reference, numbers = CASES[name]
    u, ours, frozen = U[2:-2], make(*numbers), reference(*numbers)
    slope = jax.vmap(jax.grad(ours.icdf))(jnp.asarray(u))
    x = frozen.ppf(u)
    step = 1e-3 * np.minimum(u, 1 - u) / np.asarray(1 / slope)

    def difference(step):
        return (frozen.cdf(x + step) - frozen.cdf(x - step)) / (2 * step)

    np.testing.assert_allclose(1 / slope, (4 * difference(step / 2) - difference(step)) / 3, rtol=1e-7)
    np.testing.assert_allclose(jax.vmap(jax.grad(ours.cdf))(jnp.asarray(x)) * slope, 1.0, rtol=1e-9)


@pytest.mark.slow
@CASE
def test_vmap_over_parameters_that_are_as_many_as_the_numbers(name):
    """Each row belongs to its own parameters, also where a row is as long as the batch."""
    make, reference, numbers = CASES[name]
    factors = np.linspace(1.0, 1.1, len(U))
    batch = np.asarray(numbers)[None] * factors[:, None]
    found = jax.jit(jax.vmap(lambda p: make(*p).icdf(jnp.asarray(U))))(jnp.asarray(batch))
    expected = np.stack([reference(*row).ppf(U) for row in batch])
    np.testing.assert_allclose(found[:, :-1], expected[:, :-1], rtol=1e-12, atol=1e-13 * spread(reference(*numbers)))


@pytest.mark.slow
@CASE
def test_float32_stays_float32_and_is_as_exact_as_it_can_be(name):
    """Even in a process with float64. The error is that of u times the slope of the quantile, and a few last digits."""
    make, reference, numbers = CASES[name]
    u = np.asarray(U[1:-2], np.float32)
    ours, frozen = make(*numbers), reference(*numbers)
    found = jax.jit(ours.icdf)(jnp.asarray(u))
    assert found.dtype == jnp.float32
    assert ours.cdf(found).dtype == jnp.float32
    eps, exact = float(np.finfo(np.float32).eps), frozen.ppf(u.astype(float))
    wide = u.astype(float)
    slope = (frozen.ppf(wide * (1 + 1e-6)) - frozen.ppf(wide * (1 - 1e-6))) / (2e-6 * wide)
    bound = 4 * eps * (slope + spread(frozen) + max(abs(number) for number in numbers) + np.abs(exact))
    assert np.all(np.abs(np.asarray(found, float) - exact) <= bound)
    # Probabilities of numbers that are wrong by a last digit are wrong by that times the density.
    of = np.asarray(found, float)
    np.testing.assert_allclose(
        ours.cdf(found), frozen.cdf(of), atol=float(np.max(8 * eps * (1 + (np.abs(of) + 2) / slope)))
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ours", "frozen"),
    [
        (ss.Triangular(1.0, 1.0, 3.0), stats.triang(0.0, 1.0, 2.0)),
        (ss.Triangular(1.0, 3.0, 3.0), stats.triang(1.0, 1.0, 2.0)),
    ],
    ids=["falling", "rising"],
)
def test_triangles_with_a_right_angle(ours, frozen):
    np.testing.assert_allclose(ours.icdf(jnp.asarray(U)), frozen.ppf(U), rtol=1e-12)
    x = np.linspace(0.5, 3.5, 13)
    np.testing.assert_allclose(ours.cdf(x), frozen.cdf(x), rtol=1e-12, atol=1e-15)
    slopes = jax.vmap(jax.grad(ours.icdf))(jnp.asarray(U[2:-2]))
    np.testing.assert_allclose(slopes, 1 / frozen.pdf(frozen.ppf(U[2:-2])), rtol=1e-10)


def test_log_normal_from_moments():
    made = ss.LogNormal.from_moments(mean=2.0, std=0.7)
    frozen = scipy_log_normal(float(made.median), float(made.log_std))
    assert frozen.mean() == pytest.approx(2.0, rel=1e-12)
    assert frozen.std() == pytest.approx(0.7, rel=1e-12)


VALUES, PROBABILITIES = (0.2, 0.5, 0.6, 1.5), (0.1, 0.2, 0.0, 0.7)


@pytest.mark.slow
@pytest.mark.parametrize("probabilities", [None, PROBABILITIES], ids=["equal", "given"])
def test_discrete(probabilities):
    """Also on the steps themselves: a draw lies at or below the value with probability u."""
    ours = ss.Discrete(VALUES, probabilities)
    frozen = stats.rv_discrete(values=(VALUES, probabilities or (0.25,) * 4))
    u = np.concatenate([U, [0.25, 0.75, 0.05, 0.3 - 1e-9, 0.3 + 1e-9]])
    for draw in (ours.icdf, jax.jit(jax.vmap(lambda u: ours.icdf(u)))):  # noqa: PLW0108 - the method has no hash
        np.testing.assert_array_equal(draw(jnp.asarray(u)), frozen.ppf(u))
    x = np.array([-1.0, 0.2, 0.3, 0.5, 0.55, 0.6, 1.0, 1.5, 2.0])
    np.testing.assert_allclose(ours.cdf(x), frozen.cdf(x), rtol=1e-15, atol=1e-15)
    assert ours.support == (0.2, 1.5)
    assert not ours.is_continuous
    between = np.array(
        [[0.05, 0.2, 0.29], [0.31, 0.6, 0.9]]
    )  # no steps: which side they are on, the last digit decides
    narrow = ours.icdf(jnp.asarray(between, jnp.float32))
    assert narrow.dtype == jnp.float32
    np.testing.assert_array_equal(narrow, np.float32(frozen.ppf(between)))


@pytest.mark.slow
def test_discrete_never_draws_what_has_no_probability():
    """Ten times 0.1 is below 1 in float64, and above 1 in float32: neither is refused, nor draws the last value."""
    tenths = np.append(np.full(10, 0.1), 0.0)
    for dtype in (np.float64, np.float32):
        ours = ss.Discrete(np.arange(11.0), jnp.asarray(tenths, dtype))
        last = np.nextafter(dtype(1), dtype(0))
        assert float(ours.icdf(jnp.asarray([last]))[0]) == 9.0


@pytest.mark.slow
def test_derivative_by_the_values_of_a_discrete_number():
    slope = jax.jacfwd(lambda values: ss.Discrete(values).icdf(jnp.asarray([0.1, 0.6])))(jnp.asarray(VALUES))
    np.testing.assert_array_equal(slope, [[1, 0, 0, 0], [0, 0, 1, 0]])


def test_a_distribution_of_ones_own_can_be_truncated():
    class Rayleigh(ss.RandomNumber):
        scale: float

        def icdf(self, u):
            return self.scale * jnp.sqrt(-2 * jnp.log1p(-u))

        def cdf(self, x):
            return -jnp.expm1(-((jnp.maximum(x, 0) / self.scale) ** 2) / 2)

    ours, frozen = ss.Truncated(Rayleigh(2.0), high=3.0), stats.rayleigh(scale=2.0)
    np.testing.assert_allclose(ours.icdf(jnp.asarray(U[:-1])), frozen.ppf(frozen.cdf(3.0) * U[:-1]), rtol=1e-12)
    assert ours.in_lanes
    assert not ss.Truncated(ss.Beta(2.0, 2.0), low=0.1).in_lanes


def test_one_side_may_be_open():
    frozen = stats.truncnorm(-np.inf, 1.0)
    np.testing.assert_allclose(
        ss.Truncated(ss.Normal(0.0, 1.0), high=1.0).icdf(jnp.asarray(U)), frozen.ppf(U), rtol=1e-9
    )
    np.testing.assert_allclose(ss.Truncated(ss.Normal(0.0, 1.0)).icdf(jnp.asarray(U)), stats.norm.ppf(U), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.usefixtures("annotations_unchecked")
def test_whole_numbers_serve_as_parameters():
    """Also under derivatives, which JAX has none of for integers."""
    slope = jax.grad(lambda u: ss.Beta(2, 1).icdf(u))(jnp.asarray(0.25))
    assert float(slope) == pytest.approx(1.0, rel=1e-12)  # of the square root
    assert float(ss.Uniform(0, 2).icdf(jnp.asarray(0.25))) == 0.5


FINITE = some.floats(-100, 100)
WIDTH = some.floats(1e-3, 100)
SHAPE = some.floats(0.3, 20)
SHARE = some.floats(0, 1)
MADE = some.one_of(
    some.builds(lambda low, width: ss.Uniform(low, low + width), FINITE, WIDTH),
    some.builds(ss.Normal, FINITE, WIDTH),
    some.builds(ss.LogNormal, WIDTH, some.floats(0.01, 2)),
    some.builds(lambda a, b, low, width: ss.Beta(a, b, low, low + width), SHAPE, SHAPE, FINITE, WIDTH),
    some.builds(lambda low, share, width: ss.Triangular(low, low + share * width, low + width), FINITE, SHARE, WIDTH),
    some.builds(ss.Exponential, WIDTH),
    some.builds(ss.Weibull, WIDTH, SHAPE),
)
GRID = np.linspace(0.01, 0.99, 15)


@pytest.mark.slow
@given(MADE, some.floats(0.05, 0.45), some.floats(0.55, 0.95), some.booleans())
@hypothesis_settings(max_examples=20)
def test_probability_of_the_quantile_is_u(distribution, lowest, highest, restrict):
    """And quantiles increase and stay within the support: for any parameters, restricted or not."""
    if restrict:
        low, high = (float(limit) for limit in distribution.icdf(jnp.asarray([lowest, highest])))
        distribution = ss.Truncated(distribution, low, high)
    x = np.asarray(distribution.icdf(jnp.asarray(GRID)))
    low, high = (float(limit) for limit in distribution.support)
    assert np.all((x >= low) & (x <= high))
    # Where x is far from zero and the distribution narrow, u comes back to the digits that x keeps of it.
    steps = np.diff(x)
    assert np.all(steps >= 0)
    lost = np.spacing(np.abs(x).max()) / max(steps.min(), np.finfo(float).tiny) * 4
    np.testing.assert_allclose(distribution.cdf(x), GRID, atol=max(1e-11, lost), rtol=0)


@pytest.mark.slow
@given(FINITE, WIDTH, some.integers(0, 2**32 - 1))
def test_uniform_draws_never_leave_the_interval(low, width, word):
    """At the ends too, where round-off could lead outside, in float64 and float32."""
    for dtype, u in ((np.float64, (word + 0.5) * 2.0**-32), (np.float32, ((word >> 9) + 0.5) * 2.0**-23)):
        low_in, high_in = dtype(low), dtype(low + width)
        if low_in < high_in:
            x = ss.Uniform(jnp.asarray(low_in), jnp.asarray(high_in)).icdf(jnp.asarray(u, dtype))
            assert low_in <= x <= high_in


@pytest.mark.slow
def test_beta_with_most_of_its_weight_at_an_end():
    """In single precision: 1 less the nearest number below it is 6e-8, and 5 % of the draws lie beyond that."""
    scipys = stats.beta(30.0, 0.2, -1.0, 2.0)
    beta = ss.Beta(30.0, 0.2, -1.0, 1.0)
    x = np.array([-0.5, 0.5, 0.9, 0.999, 1 - 2.0**-20, 1 - 2.0**-24, 1.0], np.float32)
    np.testing.assert_allclose(beta.cdf(x), scipys.cdf(x.astype(float)), rtol=2e-5)
    u = np.array([1e-3, 0.3, 0.6, 0.9, 0.93, 0.9375], np.float32)
    np.testing.assert_allclose(beta.icdf(jnp.asarray(u)), scipys.ppf(u.astype(float)), rtol=0, atol=1e-7)
    other = ss.Beta(0.2, 30.0, -1.0, 1.0)  # in a mirror
    np.testing.assert_allclose(other.cdf(-x), stats.beta(0.2, 30.0, -1.0, 2.0).cdf(-x.astype(float)), rtol=2e-5)
    for function, at in (
        (lambda a, at: ss.Beta(a, 0.2, -1.0, 1.0).cdf(at), 0.9),
        (lambda a, at: ss.Beta(a, 0.2, -1.0, 1.0).icdf(at), 0.6),
    ):
        slope = jax.grad(function)(30.0, jnp.asarray(at))
        ends = [
            scipys.dist.cdf(at, a, 0.2, -1.0, 2.0) if at == 0.9 else scipys.dist.ppf(at, a, 0.2, -1.0, 2.0)
            for a in (29.97, 30.03)
        ]
        assert float(slope) == pytest.approx((ends[1] - ends[0]) / 0.06, rel=2e-3)
