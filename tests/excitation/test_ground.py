"""Artificial accelerograms have the distribution that they promise, and are the same however they are drawn.

A test with a fixed key gives the same answer for ever. Its bound was fixed beforehand: `CHANCE` is the probability
that a correct law fails it for a key picked blindly.
"""

import math
from functools import cache

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from scipy import integrate, stats

from stickslip_jax._excitation.gaussian import KanaiTajimi
from stickslip_jax._excitation.recorded import GroundAcceleration

CHANCE = 1e-3
KEY = jax.random.key(0)
NUMBERS = {"ground_frequency": 15.0, "ground_damping": 0.4, "rise": 0.3, "plateau": 0.5, "decay": 1.5, "interval": 0.02}
LAW = KanaiTajimi(2.0, **NUMBERS)
# Full envelope from t = 0.1 on, without end.
STEADY = KanaiTajimi(2.0, **(NUMBERS | {"rise": 0.1, "decay": 0.0}))
FULL = 5  # the first sample of `STEADY` at full envelope
LANES = 50_000


def accelerations(law, lanes, points, seed=1):
    """The first samples of many realisations, (lanes, points)."""
    keys = jax.random.split(jax.random.key(seed), lanes)
    return np.asarray(jax.jit(jax.vmap(lambda key: law.sample(key, 1.0, points=points).accelerations))(keys))


@cache
def steady():
    """Samples of `STEADY` at full envelope, (LANES, 64)."""
    return accelerations(STEADY, LANES, FULL + 64)[:, FULL:]


def spectrum(omega):
    """The spectrum of Kanai and Tajimi, two-sided, m^2/s^3."""
    ratio, zeta = omega / 15.0, 0.4
    white = float(STEADY.spectral_density)
    return white * (1 + 4 * zeta**2 * ratio**2) / ((1 - ratio**2) ** 2 + 4 * zeta**2 * ratio**2)


@cache
def covariance(steps):
    """Of two samples so many steps apart, m^2/s^4: the integral of ``spectrum(omega) cos(omega lag)``."""
    if steps == 0:
        return 2 * integrate.quad(spectrum, 0, np.inf)[0]
    return 2 * integrate.quad(spectrum, 0, np.inf, weight="cos", wvar=steps * 0.02, limlst=200)[0]


def far(scores):
    """Whether one of these standard normal scores is too large to be chance."""
    return np.max(np.abs(scores)) > stats.norm.isf(CHANCE / 2 / np.size(scores))


class TestDistribution:
    def test_spectrum(self):
        omega = np.array([[0.0, 3.0], [-15.0, 200.0]])
        assert np.asarray(STEADY.spectrum(omega)) == pytest.approx(spectrum(omega), rel=1e-14)

    def test_spectrum_holds_the_variance(self):
        assert covariance(0) == pytest.approx(4.0, rel=1e-8)

    @pytest.mark.slow
    def test_covariances(self):
        """The mean of N independent products of jointly normal numbers: variance ``(R(0)^2 + R(lag)^2) / N``."""
        lags = np.array([0, 1, 2, 5, 10, 20, 63])
        seen = (steady()[:, 0, None] * steady()[:, lags]).mean(axis=0)
        expected = np.array([covariance(lag) for lag in lags.tolist()])
        assert not far((seen - expected) / np.sqrt((4.0**2 + expected**2) / LANES))

    @pytest.mark.slow
    def test_power_spectrum(self):
        """The mean periodogram of N realisations; one term's variance is at most twice its mean squared."""
        seen = (np.abs(np.fft.rfft(steady())) ** 2).mean(axis=0)
        # The mean of a periodogram is the transform of the covariances, each as often as it occurs.
        weighted = np.array([(64 - lag) * covariance(lag) for lag in range(64)])
        expected = 2 * np.fft.rfft(weighted).real - weighted[0]
        assert not far((seen / expected - 1) * math.sqrt(LANES / 2))

    @pytest.mark.slow
    def test_standard_deviation_follows_the_envelope(self):
        """From the first sample to the last: the mean of N squares has the relative variance ``2 / N``."""
        points = 69
        drawn = accelerations(LAW, LANES, points, seed=3)
        assert np.all(drawn[:, 0] == 0)
        expected = (2.0 * np.asarray(LAW.envelope(0.02 * np.arange(1, points)))) ** 2
        assert not far(((drawn[:, 1:] ** 2).mean(axis=0) / expected - 1) * math.sqrt(LANES / 2))

    def test_mean_is_zero(self):
        assert not far(steady().mean(axis=0) / 2.0 * math.sqrt(LANES))

    @pytest.mark.parametrize("number", [0, 1, 63])
    def test_samples_are_normal(self, number):
        assert stats.kstest(steady()[:, number], stats.norm(scale=2.0).cdf).pvalue > CHANCE

    @pytest.mark.slow
    def test_float32_samples_are_normal(self):
        with jax.enable_x64(False):
            drawn = accelerations(STEADY, 20_000, 31, seed=6)[:, 30]
        assert drawn.dtype == np.float32
        assert stats.kstest(drawn, stats.norm(scale=2.0).cdf).pvalue > CHANCE

    def test_keys_are_independent(self):
        drawn = steady()[:, 30]
        assert stats.spearmanr(drawn[:-1], drawn[1:]).pvalue > CHANCE


def test_envelope():
    times = np.array([[0.0, 0.15, 0.3], [0.5, 0.8, 1.8]])
    assert np.asarray(LAW.envelope(times)) == pytest.approx(np.array([[0, 0.25, 1], [1, 1, math.exp(-1.5)]]), abs=1e-15)
    assert float(STEADY.envelope(1e6)) == 1.0


@pytest.mark.parametrize("damping", [0.01, 0.6, 0.999])
@pytest.mark.parametrize("angle", [1e-5, 0.157, 1.0])
def test_one_step_is_exact(damping, angle):
    """Against the matrix exponential and the Cholesky factor of ``I - transition transition^T``, with 40 digits."""
    law = KanaiTajimi(rms=1.0, ground_frequency=2.0, ground_damping=damping, interval=angle / 2)
    zero, one = jnp.zeros(()), jnp.ones(())

    def state(x, v, first, second):
        x, v, _ = law.next_segment((x, v, zero), (first, second, one, one), jnp.float64)[3]
        return float(x), float(v)

    with mpmath.workdps(40):
        turned = mpmath.expm(mpmath.matrix([[0, 1], [-1, -2 * mpmath.mpf(damping)]]) * mpmath.mpf(angle))
        noise = mpmath.cholesky(mpmath.eye(2) - turned * turned.T)
        expected = np.array(
            mpmath.matrix([[*turned[0, :], *noise[0, :]], [*turned[1, :], *noise[1, :]]]).tolist(), float
        )
    units = [[one if column == place else zero for place in range(4)] for column in range(4)]
    seen = np.array([state(*unit) for unit in units]).T
    assert seen == pytest.approx(expected, rel=1e-11, abs=1e-15)


def pieces(law, count, dtype):
    """Begins, ends, values and slopes of the first pieces, drawn one after the other as a simulation does."""
    key_data = jax.random.key_data(KEY)

    def step(state, number):
        begin, memory = state
        duration, value, slope, memory = law.next_segment(memory, law.draw(key_data, number, dtype), dtype)
        return (begin + duration, memory), (begin, begin + duration, value, slope)

    begin = (jnp.zeros((), dtype), law.begin(key_data, dtype))
    _, drawn = jax.lax.scan(step, begin, jnp.arange(count, dtype=jnp.uint32))
    return tuple(np.asarray(part) for part in drawn)


class TestRealization:
    @pytest.mark.slow
    def test_pieces_are_the_sample(self):
        sample = LAW.sample(KEY, 3.0)
        times, values = np.asarray(sample.times), np.asarray(sample.accelerations)
        begin, end, value, slope = pieces(LAW, len(times) - 1, jnp.float64)
        assert begin == pytest.approx(times[:-1], abs=1e-14)
        assert end == pytest.approx(times[1:], abs=1e-14)
        assert value == pytest.approx(values[:-1], abs=1e-12)
        assert value + slope * (end - begin) == pytest.approx(values[1:], abs=1e-12)

    @pytest.mark.slow
    def test_pieces_keep_time_in_float32(self):
        """Added up one by one, 10,000 pieces end on the sampling time, to its last digit or two."""
        _, end, value, slope = pieces(LAW, 10_000, jnp.float32)
        assert end[-1] == pytest.approx(200.0, abs=4e-5)
        assert {part.dtype for part in (end, value, slope)} == {np.dtype(np.float32)}

    @pytest.mark.slow
    def test_covers_the_time_asked_for(self):
        for t1 in (2.97, 2.98, 3.0):
            sample = LAW.sample(KEY, t1)
            assert isinstance(sample, GroundAcceleration)
            assert float(sample.times[0]) == 0
            assert t1 <= float(sample.duration) < t1 + 3 * 0.02
        with jax.enable_x64(False):
            for t1 in (3.0, 77.7):
                assert float(LAW.sample(KEY, t1).duration) >= t1

    @pytest.mark.slow
    def test_longer_sample_begins_with_the_shorter(self):
        short, long = LAW.sample(KEY, 0.7), LAW.sample(KEY, 3.0)
        size = len(short.times)
        assert np.asarray(long.times)[:size].tolist() == np.asarray(short.times).tolist()
        assert np.asarray(long.accelerations)[:size] == pytest.approx(np.asarray(short.accelerations), abs=1e-13)

    def test_same_key_same_realization(self):
        one, same, legacy = (LAW.sample(key, 3.0) for key in (KEY, jax.random.key(0), jax.random.PRNGKey(0)))
        other = LAW.sample(jax.random.key(1), 3.0)
        assert one.accelerations.tolist() == same.accelerations.tolist() == legacy.accelerations.tolist()
        assert one.accelerations.tolist() != other.accelerations.tolist()

    def test_rms_is_a_scale(self):
        one = LAW.sample(KEY, 3.0).accelerations
        double = KanaiTajimi(4.0, **NUMBERS).sample(KEY, 3.0)
        assert np.asarray(double.accelerations) == pytest.approx(2 * np.asarray(one), rel=1e-12)

    def test_float32_is_the_same_motion(self):
        exact = np.asarray(LAW.sample(KEY, 3.0).accelerations)
        with jax.enable_x64(False):
            single = LAW.sample(KEY, 3.0).accelerations
        assert single.dtype == np.float32
        assert np.asarray(single) == pytest.approx(exact, abs=2e-3)


class TestTransformations:
    @pytest.mark.slow
    def test_jit(self):
        plain = LAW.sample(KEY, 3.0)
        compiled = jax.jit(lambda key: LAW.sample(key, 3.0))(KEY)
        traced = jax.jit(lambda law, t1: law.sample(KEY, t1, points=len(plain.times)))(LAW, 3.0)
        for other in (compiled, traced):
            assert np.asarray(other.times) == pytest.approx(np.asarray(plain.times), abs=1e-14)
            assert np.asarray(other.accelerations) == pytest.approx(np.asarray(plain.accelerations), abs=1e-12)

    @pytest.mark.slow
    def test_vmap_gives_each_key_its_own(self):
        keys = jax.random.split(KEY, 3)
        many = jax.vmap(lambda key: LAW.sample(key, 3.0))(keys)
        for index in range(3):
            alone = LAW.sample(keys[index], 3.0)
            assert np.asarray(many.accelerations)[index] == pytest.approx(np.asarray(alone.accelerations), abs=1e-12)

    @pytest.mark.parametrize(
        "draw", [lambda t1: LAW.sample(KEY, t1), lambda h: KanaiTajimi(1.0, interval=h).sample(KEY, 1.0)]
    )
    def test_points_are_required_when_they_cannot_be_counted(self, draw):
        with pytest.raises(
            ValueError, match=r"\AArgument points must be given when t1 or the law's interval is traced"
        ):
            jax.jit(draw)(0.01)

    @pytest.mark.slow
    def test_derivative_with_respect_to_rms(self):
        motion = lambda rms: KanaiTajimi(rms, **NUMBERS).sample(KEY, 3.0).accelerations  # noqa: E731
        assert np.asarray(jax.jacrev(motion)(2.0)) == pytest.approx(np.asarray(motion(2.0)) / 2.0, rel=1e-12, abs=1e-15)

    @pytest.mark.slow
    def test_derivatives_agree_with_differences(self):
        """Central differences: their error is of the order ``(1e-4)^2``."""
        numbers = {"rms": 2.0, **NUMBERS}
        motion = jax.jit(lambda numbers: KanaiTajimi(**numbers).sample(KEY, 3.0, points=152).accelerations)
        derivatives = jax.jacfwd(motion)(numbers)
        assert np.asarray(derivatives["rms"]) == pytest.approx(np.asarray(motion(numbers)) / 2.0, rel=1e-12, abs=1e-15)
        # Rise and plateau end on samples: there a difference sees the mean of the slopes before and behind.
        smooth = ~np.isin(np.arange(152), [15, 40])
        for name, value in numbers.items():
            step = 1e-4 * value
            above, below = (motion(numbers | {name: value + change}) for change in (step, -step))
            difference = np.asarray(above - below)[smooth] / (2 * step)
            assert np.asarray(derivatives[name])[smooth] == pytest.approx(difference, rel=1e-4, abs=1e-4), name


NAN, INF = float("nan"), float("inf")
BAD = {
    "rms": [0.0, -1.0, NAN, "1", None, [[1.0]]],
    "ground_frequency": [0.0, -1.0, INF, "1"],
    "ground_damping": [0.0, -0.1, 1.0, 1.5, NAN, np.float32(1.0)],
    "rise": [0.0, -1.0, NAN],
    "plateau": [-1.0, INF, None],
    "decay": [-1.0, NAN, "1"],
    "interval": [0.0, -0.01, NAN, 0.07, jnp.asarray(0.07)],
}


@pytest.mark.usefixtures("annotations_unchecked")
class TestBadArguments:
    @pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in BAD.items() for value in values])
    def test_numbers(self, name, value):
        with pytest.raises(ValueError, match=rf"\AArgument {name} must be .*, but .* was given.*\.\Z"):
            KanaiTajimi(**({"rms": 1.0} | {name: value}))

    def test_bounds_themselves_are_allowed(self):
        assert float(KanaiTajimi(1, rise=1, plateau=0, decay=0).envelope(2)) == 1
        assert KanaiTajimi(1.0, ground_frequency=10.0, interval=0.1).interval == 0.1

    @pytest.mark.parametrize("value", [0.0, -1.0, NAN, "1", None])
    def test_t1(self, value):
        with pytest.raises(ValueError, match=r"\AArgument t1 must be .*, but .* was given\.\Z"):
            LAW.sample(KEY, value)

    @pytest.mark.parametrize("value", [1e99, 1e12])
    def test_more_samples_than_can_be_numbered(self, value):
        with pytest.raises(ValueError, match=r"\AArgument t1 must be shorter: .*\.\Z"):
            LAW.sample(KEY, value)

    @pytest.mark.parametrize("value", [1, 0, -3, 2.5, "3", True, 2**31 + 1])
    def test_points(self, value):
        with pytest.raises(ValueError, match=r"\AArgument points must be .*, but .* was given\.\Z"):
            LAW.sample(KEY, 1.0, points=value)

    @pytest.mark.parametrize("value", [None, 0, "key", np.zeros(3, np.uint32), jax.random.key(0, impl="rbg")])
    def test_key(self, value):
        with pytest.raises(ValueError, match=r"\AArgument key must be .*, but .* was given\.\Z"):
            LAW.sample(value, 1.0)
