"""Gaussian processes have the variance, spectrum and distribution that they promise, at every time.

A test with a fixed key gives the same answer for ever. Its bound was fixed beforehand: `CHANCE` is the probability
that a correct law fails it for a key picked blindly.
"""

import itertools
import math
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, signal, stats

import stickslip_jax as ss
from stickslip_jax._excitation.excitation import excitation_of

CHANCE = 1e-3
KEY = jax.random.key(4)
SAMPLES = 20_000
SYSTEM = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.4))
GROUND = {"intensity": 0.8, "ground_frequency": 3.0, "ground_damping": 0.3}
FILTER = {"filter_frequency": 0.6, "filter_damping": 0.5}
FREQUENCIES, DENSITIES = np.array([0.3, 1.0, 2.0, 5.0]), np.array([0.0, 0.5, 0.2, 0.0])


def bump(w):
    return 0.3 * jnp.exp(-((w - 1.5) ** 2))


def kanai_tajimi(w):
    """By the transfer function of the layer, from the rock's to the surface's acceleration."""
    layer = (1 + 2j * 0.3 * w / 3) / (1 - (w / 3) ** 2 + 2j * 0.3 * w / 3)
    return 0.8 * abs(layer) ** 2


def clough_penzien(w):
    """The same, then through the high-pass filter."""
    high_pass = (1j * w / 0.6) ** 2 / (1 - (w / 0.6) ** 2 + 2j * 0.5 * w / 0.6)
    return kanai_tajimi(w) * abs(high_pass) ** 2


LAWS = {
    "function": (ss.GaussianProcess(bump, 5.0, harmonics=32), lambda w: 0.3 * np.exp(-((w - 1.5) ** 2))),
    "Kanai-Tajimi": (ss.GaussianProcess(ss.KanaiTajimiSpectrum(**GROUND), 9.0), kanai_tajimi),
    "Clough-Penzien": (ss.GaussianProcess(ss.CloughPenzienSpectrum(**GROUND, **FILTER), 9.0), clough_penzien),
    "velocity": (
        ss.GaussianProcess(ss.VelocitySpectrum(ss.CloughPenzienSpectrum(**GROUND, **FILTER)), 9.0),
        lambda w: clough_penzien(w) / w**2,
    ),
    "table": (
        ss.GaussianProcess(ss.TabulatedSpectrum(FREQUENCIES, DENSITIES), 4.0),
        lambda w: np.interp(w, FREQUENCIES, DENSITIES, left=0, right=0),
    ),
}
LAW = LAWS["function"][0]
JUMPING = ss.WithJumps(LAW, ss.PoissonSwitching(0.4, 0.5))


def integral(density, cutoff, lag=0.0):
    parts = np.unique(np.concatenate([np.linspace(0, cutoff, 10), FREQUENCIES[cutoff > FREQUENCIES]]))
    return sum(
        integrate.quad(lambda w: density(w) * math.cos(w * lag), low, high)[0]
        for low, high in itertools.pairwise(parts)
    )


@cache
def values(harmonics, times, samples=SAMPLES):
    """Of realisations of `LAW` with so many harmonics, (samples, times)."""
    law = ss.GaussianProcess(bump, 5.0, harmonics=harmonics)
    keys = jax.random.split(KEY, samples)
    return np.asarray(jax.jit(jax.vmap(lambda key: jax.vmap(law.sample(key).value)(jnp.asarray(times))))(keys))


def far(scores):
    """Whether one of these standard normal scores is too large to be chance."""
    return np.max(np.abs(scores)) > stats.norm.isf(CHANCE / 2 / np.size(scores))


class TestSpectra:
    @pytest.mark.slow
    @pytest.mark.parametrize("case", LAWS)
    def test_density(self, case):
        law, density = LAWS[case]
        frequencies = np.array([[0.2, 0.9], [1.7, 3.9]])
        assert np.asarray(law.spectral_density(frequencies)) == pytest.approx(density(frequencies), rel=1e-12)
        assert np.asarray(law.spectral_density(np.array([law.cutoff + 0.1, -1.0]))).tolist() == [0, 0]

    @pytest.mark.parametrize("case", LAWS)
    def test_variance_is_the_integral_up_to_the_cutoff(self, case):
        law, density = LAWS[case]
        assert float(law.variance) == pytest.approx(integral(density, law.cutoff), rel=1e-9)

    @pytest.mark.slow_for("table")
    @pytest.mark.parametrize("case", LAWS)
    def test_covariance(self, case):
        """The spectrum is taken as constant in parts of at most 0.009 rad/s.

        A part of width h where the density changes by d changes the covariance by at most ``d lag h^2 / 12``, and their
        sum is less than ``lag h^2 / 12`` times all rises and falls of the density together.
        """
        law, density = LAWS[case]
        lags = np.array([0.0, 0.7, 3.0, 8.0])
        expected = np.array([integral(density, law.cutoff, lag) for lag in lags.tolist()])
        turns = np.abs(np.diff(density(np.linspace(1e-9, law.cutoff, 20_001)))).sum()
        errors = np.abs(np.asarray(law.covariance(lags)) - expected)
        assert np.all(errors < turns * lags * 0.009**2 / 12 + 1e-9 * expected[0])

    def test_kanai_tajimi_in_closed_form(self):
        """Without a cutoff ``pi intensity w_g (1 + 4 z^2) / (4 z)``; beyond it about ``4 z^2 w_g^2 intensity / w``."""
        law = ss.GaussianProcess(ss.KanaiTajimiSpectrum(**GROUND), 400.0)
        tail = 4 * 0.3**2 * 3.0**2 * 0.8 / 400.0
        assert float(law.variance) + tail == pytest.approx(math.pi * 0.8 * 3 * (1 + 0.36) / 1.2, rel=1e-5)

    @pytest.mark.slow
    def test_rms_scales_it(self):
        law = ss.GaussianProcess(bump, 5.0, rms=0.5)
        assert float(law.variance) == 0.25
        assert float(law.covariance(0.0)) == pytest.approx(0.25, rel=1e-12)
        shape = float(LAW.spectral_density(1.0)) / float(LAW.variance)
        assert float(law.spectral_density(1.0)) == pytest.approx(0.25 * shape, rel=1e-12)
        one, other = law.sample(KEY), ss.GaussianProcess(bump, 5.0).sample(KEY)
        factor = 0.5 / math.sqrt(float(LAW.variance))
        assert np.asarray(one.amplitudes) == pytest.approx(factor * np.asarray(other.amplitudes), rel=1e-12)


class TestDistribution:
    TIMES = (0.0, 0.4, 1.1, 2.5, 2 * math.pi * 32 / 5.0, 1000.0, 1000.4)

    @pytest.mark.slow
    @pytest.mark.parametrize("harmonics", [1, 32])
    def test_each_value_is_gaussian(self, harmonics):
        """With one harmonic too; at t = 0 as at any other time."""
        expected = stats.norm(0, math.sqrt(integral(LAWS["function"][1], 5.0)))
        for column in (0, 3, 5):
            assert stats.kstest(values(harmonics, self.TIMES)[:, column], expected.cdf).pvalue > CHANCE / 3

    @pytest.mark.slow
    @pytest.mark.parametrize("harmonics", [1, 32])
    def test_covariances(self, harmonics):
        """Of values at different times: those of the spectrum, by the lag alone, and no period of ``2 pi n / cutoff``.

        Products have the variance ``R(0)^2 + R(lag)^2``, and at most 2 R(0)^2 / harmonics more, by the spread of the
        frequencies.
        """
        found = values(harmonics, self.TIMES)
        pairs = [(i, j) for i in range(len(self.TIMES)) for j in range(i, len(self.TIMES))]
        lags = [abs(self.TIMES[i] - self.TIMES[j]) for i, j in pairs]
        expected = np.array([float(LAW.covariance(lag)) for lag in lags])
        seen = np.array([(found[:, i] * found[:, j]).mean() for i, j in pairs])
        largest = float(LAW.variance) ** 2
        assert not far((seen - expected) / np.sqrt((largest * (1 + 2 / harmonics) + expected**2) / SAMPLES))
        assert seen[0] == pytest.approx(float(LAW.variance), rel=0.05)

    @pytest.mark.slow
    def test_fourth_moments(self):
        """``<v(0)^2 v(t)^2> = R(0)^2 + 2 R(t)^2``, but for less than ``2 R(0)^2 / harmonics``."""
        found = values(32, self.TIMES)
        for column in (1, 2, 3):
            products = found[:, 0] ** 2 * found[:, column] ** 2
            expected = float(LAW.variance) ** 2 + 2 * float(LAW.covariance(self.TIMES[column])) ** 2
            error = stats.norm.isf(CHANCE / 6) * products.std() / math.sqrt(SAMPLES)
            assert abs(products.mean() - expected) < error + 2 * float(LAW.variance) ** 2 / 32

    @pytest.mark.slow
    def test_spectrum_by_welch(self):
        """The mean of 300 estimates, against what Welch's method makes of the covariances of the spectrum.

        The estimates at neighbouring frequencies are correlated; the bound of the largest of many scores holds for
        dependent ones too.
        """
        step, length, segment = 0.25, 1024, 128
        times = tuple((step * np.arange(length)).tolist())
        found = values(128, times, 300)
        frequencies, estimates = signal.welch(found, 1 / step, nperseg=segment, detrend=False, axis=1)
        window = signal.get_window("hann", segment)
        covariances = np.array([float(x) for x in LAW.covariance(step * np.arange(segment))])
        overlaps = np.array([(window[: segment - lag] * window[lag:]).sum() for lag in range(segment)])
        phases = np.cos(2 * math.pi * np.outer(frequencies, step * np.arange(segment)))
        two_sided = step * (phases * np.where(np.arange(segment), 2, 1) * covariances * overlaps).sum(axis=1)
        expected = two_sided / (window**2).sum() * np.where((frequencies > 0) & (frequencies < 0.5 / step), 2, 1)
        scores = (estimates.mean(axis=0) - expected) / (estimates.std(axis=0, ddof=1) / math.sqrt(300))
        band = (frequencies > 0.05) & (frequencies < 0.55)  # where the spectrum is more than what the window leaks
        assert band.sum() > 12
        assert not far(scores[band])
        # And it is the density itself, over frequencies in Hz: 2 pi times that over angular frequencies.
        top = 2 * math.pi * float(bump(2 * math.pi * 0.25))
        assert estimates.mean(axis=0)[np.argmin(abs(frequencies - 0.25))] == pytest.approx(top, rel=0.05)

    @pytest.mark.slow
    def test_averages_over_a_sample(self):
        """The mean square over 60 s of a sample varies from sample to sample as that of the process:
        variance ``4 / T^2 integral (T - lag) R(lag)^2``.
        """
        duration, number = 60.0, LAW.enough_harmonics(60.0)
        lags = np.linspace(0, duration, 4001)
        covariances = np.asarray(LAW.covariance(lags))
        expected = 4 / duration**2 * integrate.simpson((duration - lags) * covariances**2, x=lags)
        times = tuple(np.linspace(0, duration, 301).tolist())
        ratio, few = ((values(n, times, 4000) ** 2).mean(axis=1).var() / expected for n in (number, number // 4))
        assert 0.9 < ratio < 1.25
        assert few > 1.5

    def test_samples_differ(self):
        one, other = (LAW.sample(jax.random.key(seed)) for seed in (0, 1))
        for name in ("amplitudes", "angular_frequencies", "phases"):
            assert not np.isclose(getattr(one, name), getattr(other, name)).any()

    @pytest.mark.slow
    def test_float32(self):
        with jax.enable_x64(False):
            one = LAW.sample(KEY)
            assert one.amplitudes.dtype == one.angular_frequencies.dtype == np.float32
        other = LAW.sample(KEY)
        assert np.asarray(one.angular_frequencies) == pytest.approx(np.asarray(other.angular_frequencies), rel=1e-5)


class TestSimulation:
    def test_step_follows_the_cutoff(self):
        """In simulations of one sample too, whose own fastest harmonic is slower."""
        one = LAW.sample(KEY)
        assert float(LAW.shortest_period) == float(one.shortest_period) == pytest.approx(2 * math.pi / 5.0)
        assert float(np.max(one.angular_frequencies)) < 4.9
        with pytest.raises(ValueError, match=r"step must be at most 0.1257 s, 0.1 times the shortest"):
            ss.simulate(SYSTEM, one, t1=1.0, method=ss.Exact(step=0.13))
        with pytest.raises(ValueError, match=r"step must be at most 0.1257 s, 0.1 times the shortest"):
            ss.simulate_ensemble(SYSTEM, LAW, t1=1.0, samples=2, key=KEY, method=ss.Exact(step=0.13))

    def test_under_jumps_an_ensemble_draws_the_motion_of_its_samples(self):
        excitation, base = excitation_of(JUMPING), JUMPING.sample(KEY, 5.0)
        one = excitation.realized(jax.random.key_data(KEY), jnp.float64)
        for name in ("amplitudes", "angular_frequencies", "phases"):
            assert np.asarray(getattr(one, name)) == pytest.approx(np.asarray(getattr(base.motion, name)), rel=1e-14)

    @pytest.mark.slow
    @pytest.mark.parametrize("law", [LAW, pytest.param(JUMPING, marks=pytest.mark.slow)], ids=["alone", "with jumps"])
    def test_sample_repeats_each_sample_of_an_ensemble(self, law):
        """But for the rounding of the frequencies."""
        many = ss.simulate_ensemble(SYSTEM, law, t1=20.0, samples=64, key=KEY, keep="sticks")
        assert many.finished == 64
        first = np.append(0, np.cumsum(many.flat_sticks.count))
        for number in range(4):
            _, base, y0 = many.realization(number)
            one = ss.simulate(SYSTEM, base, t1=20.0, y0=y0)
            count, mine = int(one.sticks.count), slice(first[number], first[number + 1])
            assert many.flat_sticks.start[mine] == pytest.approx(np.asarray(one.sticks.start)[:count], abs=1e-11)
            assert many.flat_sticks.end[mine] == pytest.approx(np.asarray(one.sticks.end)[:count], abs=1e-11)
        assert first[4] > 4

    @pytest.mark.slow
    def test_derivative(self):
        """Of a value by the parameters of the spectrum, the random numbers held fixed."""

        def value(damping, cutoff, rms):
            spectrum = ss.KanaiTajimiSpectrum(1.0, 3.0, damping)
            return ss.GaussianProcess(spectrum, cutoff, rms=rms, harmonics=16).sample(KEY).value(jnp.asarray(2.0))

        at = np.array([0.3, 8.0, 0.7])
        found = jax.jit(jax.grad(value, argnums=(0, 1, 2)))(*at)
        for number, slope in enumerate(found):
            step = 1e-6 * np.eye(3)[number]
            assert float(slope) == pytest.approx(float(value(*(at + step)) - value(*(at - step))) / 2e-6, rel=1e-5)


def test_a_function_with_parameters_may_be_differentiated():
    class Peak(ss.PowerSpectrum):
        center: float

        def density(self, angular_frequency):
            return jnp.exp(-((angular_frequency - self.center) ** 2))

    def variance(center):
        return ss.GaussianProcess(Peak(center), 5.0).variance

    # The derivative of the integral from 0 to 5: the difference of its ends.
    assert float(jax.grad(variance)(1.5)) == pytest.approx(math.exp(-(1.5**2)) - math.exp(-(3.5**2)), rel=1e-9)


BAD = {
    "kind": (lambda: ss.GaussianProcess(3.0, 5.0), r"spectrum must be a spectrum such as .* but 3.0 was given"),
    "negative": (lambda: ss.GaussianProcess(lambda w: -w, 5.0), r"spectrum must be finite and zero or positive up to"),
    "infinite": (lambda: ss.GaussianProcess(lambda w: 1 / (w - w), 5.0), r"spectrum must be finite and zero or posi"),
    "zero": (lambda: ss.GaussianProcess(lambda w: 0 * w, 5.0), r"spectrum must be finite .* not zero everywhere"),
    "sharp": (
        lambda: ss.GaussianProcess(ss.KanaiTajimiSpectrum(ground_damping=1e-5), 40.0),
        r"spectrum must vary little within a 1024th of the cutoff, 0.0391 rad/s",
    ),
    "velocity of white noise": (
        lambda: ss.GaussianProcess(ss.VelocitySpectrum(ss.KanaiTajimiSpectrum()), 40.0),
        r"spectrum must .* fade towards 0 if it is a VelocitySpectrum",
    ),
    "acceleration": (lambda: ss.VelocitySpectrum("CP"), r"acceleration must be a spectrum such as .* but 'CP'"),
    "cutoff": (lambda: ss.GaussianProcess(bump, 0.0), r"cutoff must be positive \(in rad/s\), but 0.0"),
    "rms": (lambda: ss.GaussianProcess(bump, 5.0, rms=-1.0), r"rms must be positive \(in m/s\), but -1.0"),
    "harmonics": (
        lambda: ss.GaussianProcess(bump, 5.0, harmonics=0),
        r"harmonics must be a whole number of at le",
    ),
    "table": (
        lambda: ss.TabulatedSpectrum([0.0, 1.0], [1.0]),
        r"must have the same length of at least 2, but",
    ),
    "order": (lambda: ss.TabulatedSpectrum([1.0, 1.0], [1.0, 2.0]), r"angular_frequencies must increase, but"),
    "law": (
        lambda: ss.simulate(SYSTEM, LAW, t1=1.0),
        r"base must be a realisation, but the random law Gaussian",
    ),
    "motor": (
        lambda: ss.simulate_ensemble(ss.MotorCart(), LAW, t1=1.0, samples=2, key=KEY),
        r"base of a MotorCart must be a SourceVoltage",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input(case, annotations_unchecked):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()
