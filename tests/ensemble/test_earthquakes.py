"""Incremental dynamic analysis, spectra and fragility, against closed forms and references of their own."""

import math

import jax
import numpy as np
import pytest
from scipy import linalg, optimize, stats

import stickslip_jax as ss
from stickslip_jax._excitation.reading import STANDARD_GRAVITY as G

LEVELS, COUNTS = np.array([0.2, 0.3, 0.4, 0.6, 0.7, 0.8, 0.9, 1.0]), np.array([0, 0, 0, 4, 6, 13, 12, 16])
"""The example of Baker's program fn_mle_pc (2015): collapses of 40 records at each level."""


def record(seed, points=150, step=0.02):
    random, times = np.random.default_rng(seed), np.arange(points) * step
    noise = np.convolve(random.normal(size=points), np.ones(5) / 3, "same")
    return ss.GroundAcceleration(times, 4.0 * noise * np.sin(np.pi * times / times[-1]) ** 2)


RECORDS = [record(1), record(2, points=100, step=0.025)]


def peak_of_oscillator(motion, period, damping, t1, parts=100):
    """The largest displacement by the exact step of a linear system under a force that grows linearly, `parts` to a
    step of the record, and the parabola through the largest three.
    """
    w = 2 * math.pi / period
    times = np.append(motion.times, np.arange(motion.times[-1] + 0.01, t1, 0.01))
    force = -np.append(motion.accelerations, np.zeros(len(times) - len(motion.times)))
    positions, state = [0.0], np.zeros(2)
    for start, step in zip(range(len(times) - 1), np.diff(times), strict=True):
        slope = (force[start + 1] - force[start]) / step
        if start + 1 == len(motion.times):
            slope, force[start] = 0.0, 0.0  # the record ends: its last value is no acceleration any more
        system = np.zeros((4, 4))
        system[:2, :2], system[1, 2], system[2, 3] = [[0, 1], [-w * w, -2 * damping * w]], 1.0, 1.0
        move, augmented = linalg.expm(system * step / parts), np.array([*state, force[start], slope])
        for _ in range(parts):
            augmented = move @ augmented
            positions.append(augmented[0])
        state = augmented[:2]
    found = np.abs(positions)
    at = int(np.argmax(found[1:-1])) + 1
    a, b, c = found[at - 1 : at + 2]
    return b + (c - a) ** 2 / (8 * (2 * b - a - c))


class TestResponseSpectrum:
    @pytest.mark.slow
    def test_against_the_matrix_exponential(self):
        periods = [0.3, 1.1]
        found = ss.response_spectrum(RECORDS, periods, damping=0.05, progress=False)
        assert dict(found.sizes) == {"record": 2, "period": 2}
        for i, motion in enumerate(RECORDS):
            for j, period in enumerate(periods):
                expected = peak_of_oscillator(motion, period, 0.05, 2.98 + 1.1)
                assert float(found.displacement[i, j]) == pytest.approx(expected, rel=1e-9)
        w = 2 * np.pi / np.array(periods)
        np.testing.assert_allclose(found.pseudo_velocity, w * found.displacement, rtol=1e-14)
        np.testing.assert_allclose(found.pseudo_acceleration, w**2 * found.displacement, rtol=1e-14)
        assert found.pseudo_acceleration.attrs["units"] == "m/s^2"

    @pytest.mark.slow
    def test_a_stiff_oscillator_has_the_acceleration_of_the_ground(self):
        suite = ss.RecordSuite(RECORDS, scale=[1.0, 3.0])
        found = ss.response_spectrum(suite, [0.002], progress=False).pseudo_acceleration[:, 0]
        np.testing.assert_allclose(found, suite.records.peaks * [1.0, 3.0], rtol=0.02)


class TestSlidingSpectrum:
    def test_a_flat_slider_has_the_closed_form(self):
        """Under an acceleration that falls from a at t = 0 to zero at T, the block slides at once and stops where the
        integral of the acceleration beyond ``mu g`` is zero.
        """
        a, duration, mu = 6.0, 1.0, np.array([0.35, 0.5])
        motion = ss.GroundAcceleration([0.0, duration], [a, 0.0])
        found = ss.sliding_spectrum(motion, [np.inf], mu, t1=2.0, progress=False)
        beyond, slope = a - mu * G, a / duration
        stop = 2 * beyond / slope
        assert np.all(stop < duration)
        slid = beyond * stop**2 / 2 - slope * stop**3 / 6
        np.testing.assert_allclose(found.largest_displacement[0, 0], slid, rtol=1e-12)
        np.testing.assert_allclose(found.residual_displacement[0, 0], -slid, rtol=1e-12)

    @pytest.mark.slow
    def test_each_is_the_simulation_of_its_slider(self):
        found = ss.sliding_spectrum(RECORDS, [0.8, 2.0], [0.05, 0.2], damping=0.02, t1=4.0, progress=False)
        assert found.largest_displacement.dims == ("record", "period", "mu")
        at = {"record": "1", "period": 2.0, "mu": 0.05}
        system = ss.MassSpring(1.0, math.pi**2, G, ss.Coulomb(0.05), damping=0.04 * math.pi)
        one = ss.simulate(system, ss.RecordSuite(RECORDS)[1], t1=4.0)
        assert float(found.largest_displacement.sel(at)) == pytest.approx(float(one.peak("position")), abs=1e-13)
        assert float(found.residual_displacement.sel(at)) == pytest.approx(float(one.final_state[0]), abs=1e-13)

    @pytest.mark.slow
    def test_an_elastoplastic_oscillator_by_a_slider_behind_a_spring(self):
        """The recipe of the guide. A constant acceleration a pushes a mass whose spring yields at the force ``mu m g``:
        it swings to the yield displacement u, and from there, at the speed v, it goes on against a constant force.
        """
        a, w, mu = 2.0, 3.0, 0.15
        limit = mu * G
        u = limit / w**2
        v = math.sqrt(2 * a * u - (w * u) ** 2)
        elastoplastic = ss.MassSpring(1.0, 0.0, G, ss.Coulomb(mu), series_stiffness=w**2)
        motion = ss.GroundAcceleration([0.0, 10.0], [-a, -a])
        # Beyond the yield point the mass is pushed by a - limit, which is positive: up to t it moves that far.
        elastic = math.acos(1 - u * w**2 / a) / w
        t = elastic + 1.0
        one = ss.simulate(elastoplastic, ss.RecordSuite(motion)[0], t1=t)
        assert float(one.final_state[0]) == pytest.approx(u + v + (a - limit) / 2, rel=1e-12)


class TestIncrementalDynamicAnalysis:
    @pytest.mark.slow
    def test_table(self):
        system = ss.MassSpring(1.0, 9.0, 9.81, ss.Coulomb(0.05))
        outputs = {"peak": ss.Output(lambda one: one.peak("position"), unit="m")}
        scales = np.array([0.5, 1.0, 2.0])
        table = ss.incremental_dynamic_analysis(
            system, RECORDS, scales=scales, outputs=outputs, period=1.1, progress=False
        )
        assert table.peak.dims == ("scale", "record")
        one = ss.simulate(system, ss.RecordSuite(RECORDS, 2.0)[1], t1=2.98)
        assert float(table.peak.sel(scale=2.0, record="1")) == pytest.approx(float(one.peak("position")), abs=1e-13)
        np.testing.assert_allclose(table.peak_quantile.sel(quantile=0.5), table.peak.mean("record"), rtol=1e-14)
        pga = [np.max(np.abs(one.accelerations)) for one in RECORDS]
        np.testing.assert_allclose(table.pga, scales[:, None] * np.array(pga)[None], rtol=1e-14)
        spectrum = ss.response_spectrum(RECORDS, [1.1], progress=False).pseudo_acceleration[:, 0]
        np.testing.assert_allclose(table.spectral_acceleration, scales[:, None] * spectrum.values[None], rtol=1e-12)
        assert table.peak.attrs["units"] == "m"
        assert {"pga", "spectral_acceleration", "peak", "peak_quantile"} == set(table.data_vars)


class TestFragility:
    def test_bakers_example(self):
        """Against a direct search for the largest binomial likelihood, as in his program."""
        found = ss.fragility(LEVELS, COUNTS, trials=40)

        def minus_log_likelihood(at):
            return -np.sum(stats.binom.logpmf(COUNTS, 40, stats.norm.cdf(np.log(LEVELS / at[0]) / at[1])))

        options = {"xatol": 1e-11, "fatol": 1e-13, "maxiter": 4000}
        expected = optimize.minimize(minus_log_likelihood, [0.8, 0.4], method="Nelder-Mead", options=options).x
        np.testing.assert_allclose([found.median, found.dispersion], expected, rtol=1e-7)
        # The errors are those of the curvature there, by finite differences.
        h, at = 1e-4, np.array([math.log(found.median), found.dispersion])
        value = lambda d: minus_log_likelihood([math.exp(at[0] + d[0]), at[1] + d[1]])  # noqa: E731
        e = h * np.eye(2)
        curvature = [[(value(a + b) - value(a - b) - value(b - a) + value(-a - b)) / (4 * h * h) for b in e] for a in e]
        np.testing.assert_allclose(found.covariance, np.linalg.inv(curvature), rtol=1e-5)
        assert repr(found).startswith("fragility of 51 exceedances in 320: median 1.076 +- 0.077, dispersion 0.429")

    def test_counts_and_single_analyses_are_one(self):
        each = np.arange(40)[None] < COUNTS[:, None]
        cloud, stripes = ss.fragility(LEVELS[:, None], each), ss.fragility(LEVELS, COUNTS, trials=40)
        assert cloud.median == pytest.approx(stripes.median, rel=1e-12)
        np.testing.assert_allclose(cloud.covariance, stripes.covariance, rtol=1e-10)

    def test_the_unit_of_intensity_does_not_matter(self):
        one, other = (ss.fragility(unit * LEVELS, COUNTS, trials=40) for unit in (1.0, 1e-6))
        assert other.median == pytest.approx(1e-6 * one.median, rel=1e-10)
        assert other.dispersion == pytest.approx(one.dispersion, rel=1e-10)

    def test_curve(self):
        found = ss.fragility(LEVELS, COUNTS, trials=40)
        assert found.probability(found.median) == pytest.approx(0.5, abs=1e-15)
        np.testing.assert_allclose(found.probability(found.quantile([0.1, 0.9])), [0.1, 0.9], rtol=1e-12)
        assert found.probability(0.0) == 0.0
        low, high = found.interval(LEVELS)
        assert np.all(low < found.probability(LEVELS))
        assert np.all(found.probability(LEVELS) < high)
        # At the median only its own error matters.
        low, high = found.interval(found.median, level=0.6827)
        away = stats.norm.ppf((1 + 0.6827) / 2) * found.median_error / found.median / found.dispersion
        np.testing.assert_allclose([low, high], stats.norm.cdf([-away, away]), rtol=1e-12)
        table = found.to_pandas([0.5, 1.0])
        assert table.columns.tolist() == ["intensity", "probability", "low", "high"]
        assert len(found.to_pandas()) == 50

    def test_coverage(self):
        """Of 400 fits to 150 analyses each; z scores with biases of the order of 1/sqrt(150)."""
        random, theta, beta, scores, held = np.random.default_rng(5), 1.2, 0.5, [], []
        at = np.array([0.6, 1.2, 2.4])
        true = stats.norm.cdf(np.log(at / theta) / beta)
        for _ in range(400):
            x = np.exp(0.8 * random.normal(size=150))
            found = ss.fragility(x, random.random(150) < stats.norm.cdf(np.log(x / theta) / beta))
            low, high = found.interval(at)
            held.append((low <= true) & (true <= high))
            scores.append([math.log(found.median / theta) / math.sqrt(found.covariance[0, 0]),
                           (found.dispersion - beta) / found.dispersion_error])  # fmt: skip
        assert np.all(np.abs(np.mean(scores, axis=0)) < [0.2, 0.4])
        assert np.all(np.abs(np.std(scores, axis=0) - 1) < 0.2)
        assert np.all(np.abs(np.mean(held, axis=0) - 0.95) < 0.035)  # 3.3 standard deviations

    @pytest.mark.slow
    def test_errors_of_whole_records(self):
        """Each record has one capacity: at every scale above it, it exceeds. Single analyses are not independent."""
        random, scales, scores, naive = np.random.default_rng(7), np.geomspace(0.3, 5.0, 9)[:, None], [], []
        for _ in range(400):
            exceeds = scales > 1.2 * np.exp(0.5 * random.normal(size=60))
            found = ss.fragility(scales, exceeds, records=np.arange(60))
            scores.append(math.log(found.median / 1.2) / math.sqrt(found.covariance[0, 0]))
            naive.append(math.log(found.median / 1.2) / math.sqrt(ss.fragility(scales, exceeds).covariance[0, 0]))
        assert abs(np.std(scores) - 1) < 0.15
        assert np.std(naive) > 1.4

    @pytest.mark.parametrize(("exceeds", "trials", "said"), [
        (np.zeros(8), 40, r"exceeds must hold analyses that exceed the limit and others .*none of 320 do; take other"),
        (np.full(8, 40), 40, r"and others that do not, but all of 320 do"),
        (LEVELS > 0.5, None, r"overlap, but all analyses below 0.6 stay within the limit and none above does, so that"),
        (LEVELS < 0.5, None, r"overlap, but all analyses below 0.6 exceed it and none above does"),
        (np.array([1, 0, 1, 1, 0, 1, 0, 0]), None, r"must become more probable as the intensity grows, but the fitted"),
        (COUNTS, 10, r"exceeds must hold whole numbers from 0 to the trials"),
        (COUNTS, None, r"exceeds must hold truth values"),
        (COUNTS, np.full(8, 40.5), r"trials must hold whole numbers of at least 1"),
        (np.ones(7), None, r"must have shapes that fit that of exceeds, \(7,\), but \(8,\), \(\)"),
    ])  # fmt: skip
    def test_refusals(self, exceeds, trials, said):
        with pytest.raises(ValueError, match=said):
            ss.fragility(LEVELS, exceeds, trials=trials)


@pytest.mark.usefixtures("annotations_unchecked")
def test_refusals():
    with pytest.raises(
        ValueError, match=r"periods must be between 1e-06 and 1e\+06 s, or infinite .*, but 0.0 was given"
    ):
        ss.response_spectrum(RECORDS, [0.0])
    with pytest.raises(ValueError, match=r"periods must be finite, but .*sliding_spectrum takes flat sliders"):
        ss.response_spectrum(RECORDS, [np.inf], progress=False)
    with pytest.raises(ValueError, match=r"mu\[0\] must be zero or positive"):
        ss.sliding_spectrum(RECORDS, [1.0], [-0.1])
    with pytest.raises(ValueError, match=r"damping must be .*below 1"):
        ss.sliding_spectrum(RECORDS, [1.0], [0.1], damping=1.0)
    with pytest.raises(ValueError, match=r"intensity must hold finite positive numbers"):
        ss.fragility([0.0, 1.0], [True, False])
    with pytest.raises(ValueError, match=r"records must name at least 3 records"):
        ss.fragility([1.0, 2.0, 3.0, 4.0], [False, True, False, True], records=[0, 0, 1, 1])
    with pytest.raises(ValueError, match=r"level must be"):
        ss.fragility(LEVELS, COUNTS, trials=40).interval(1.0, level=1.0)
    with pytest.raises(ValueError, match=r"record must be known for each sample here"):
        ss.response_spectrum(ss.RecordSuite(RECORDS, record="random"), [1.0])
    assert jax.config.read("jax_enable_x64")


@pytest.mark.parametrize(
    "values", [np.ma.array([1.0, 2.0, 3.0, 4.0], mask=[0, 0, 1, 0]), np.array([1.0, 2.0, 3.0, 4j])]
)
def test_fragility_of_what_is_no_number(values):
    """Masked entries and imaginary parts are not dropped without a word."""
    with pytest.raises(ValueError, match="Argument intensity must be real numbers"):
        ss.fragility(values, [0, 1, 0, 1])
    with pytest.raises(ValueError, match="Argument exceeds must be real numbers"):
        ss.fragility([1.0, 2.0, 3.0, 4.0], np.ma.array([False, True, False, True], mask=[0, 0, 1, 0]))
