"""Suites of records: every sample is the simulation of its record times its scale."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._ensemble import encoding
from stickslip_jax._excitation.suites import RecordSuite

KEY, T1, METHOD = jax.random.key(0), 4.0, ss.Exact(max_steps=4096)
OUTPUTS = {"peak": lambda one: one.peak("position"), "end": lambda one: one.final_state[0]}


def record(seed, points, step):
    """Noise that dies out: zero at its end, so that it is continuous there."""
    random, times = np.random.default_rng(seed), np.arange(points) * step
    noise = np.convolve(random.normal(size=points), np.ones(5) / 3, "same")
    return ss.GroundAcceleration(times, 4.0 * noise * np.sin(np.pi * times / times[-1]) ** 2 * (times < times[-1]))


IRREGULAR = ss.GroundAcceleration([0.0, 0.3, 0.4, 1.0, 1.7, 1.75], [0.0, 3.0, -2.5, 4.0, -1.0, 0.0])
RECORDS = [record(1, 120, 0.02), IRREGULAR, record(2, 61, 0.05)]
EVEN = [record(3, 80, 0.025), record(4, 150, 0.02)]


def slider(mu=0.1, stiffness=3.0):
    return ss.MassSpring(mass=1.0, stiffness=stiffness, normal_force=9.81, friction=ss.Coulomb(mu))


def quiet(motion, scale=1.0, t1=T1):
    """The same record times a scale, with a last point of no acceleration at t1."""
    times = np.append(motion.times, t1)
    return ss.GroundAcceleration(times, scale * np.append(motion.accelerations, 0.0))


def run(suite, system=None, **changed):
    options = {"t1": T1, "samples": len(suite), "keep": "totals", "method": METHOD, "outputs": OUTPUTS} | changed
    return ss.simulate_ensemble(slider() if system is None else system, suite, **options)


class TestSamples:
    @pytest.mark.slow_for("irregular")
    @pytest.mark.parametrize("records", [RECORDS, EVEN], ids=["irregular", "equally spaced"])
    def test_each_is_the_simulation_of_its_record_times_its_scale(self, records):
        many = run(ss.RecordSuite(records).at_scales([1.0, 0.5]))
        assert many.finished == 2 * len(records)
        for number, (scale, motion) in enumerate((scale, motion) for scale in (1.0, 0.5) for motion in records):
            one = ss.simulate(slider(), quiet(motion, scale), t1=T1, method=METHOD)
            assert many.output_values["end"][number] == pytest.approx(float(one.final_state[0]), abs=1e-13)
            assert many.output_values["peak"][number] == pytest.approx(float(one.peak("position")), abs=1e-13)

    @pytest.mark.slow
    def test_the_ground_moves_as_its_acceleration_says(self):
        """Free of friction and spring, a mass has minus the velocity of the ground: the integral of straight lines."""
        suite = ss.RecordSuite(RECORDS, scale=[1.0, -2.0, 0.5])
        ends = run(suite, slider(0.0, 0.0), outputs={"speed": lambda one: one.final_state[1]}).output_values["speed"]
        expected = [-s * np.trapezoid(m.accelerations, m.times) for s, m in zip(suite.scale, RECORDS, strict=True)]
        np.testing.assert_allclose(ends, expected, rtol=0, atol=1e-13)

    def test_the_result_says_which_record_and_scale_each_had(self):
        values = run(ss.RecordSuite(EVEN).at_scales([1.0, 2.0, 4.0])).input_values
        assert values["record"].tolist() == [0, 1, 0, 1, 0, 1]
        assert values["scale"].tolist() == [1, 1, 2, 2, 4, 4]

    def test_scales_multiply_those_of_the_suite(self):
        suite = ss.RecordSuite(EVEN, scale=[0.5, 3.0]).at_scales([1.0, 2.0])
        assert suite.scale.tolist() == [0.5, 3.0, 1.0, 6.0]
        assert len(suite) == 4

    @pytest.mark.slow
    def test_one_of_them_by_its_number(self):
        suite = ss.RecordSuite(RECORDS).at_scales([1.0, 0.5])
        one = ss.simulate(slider(), suite[4], t1=T1, method=METHOD)
        assert float(one.final_state[0]) == pytest.approx(run(suite).output_values["end"][4], abs=1e-13)
        assert suite.motion(4).times.tolist() == IRREGULAR.times.tolist()
        assert suite.motion(4).accelerations.tolist() == (0.5 * IRREGULAR.accelerations).tolist()
        np.testing.assert_allclose(ss.RecordSuite(EVEN).motion(1).times, EVEN[1].times, rtol=0, atol=1e-15)
        with pytest.raises(IndexError, match=r"number must be below the 6 samples, but 6 was given"):
            suite[6]

    @pytest.mark.slow
    def test_a_realization_repeats_its_sample(self):
        many = run(ss.RecordSuite(EVEN, ss.Uniform(0.5, 1.0), "random"), samples=5, key=KEY)
        system, base, y0 = many.realization(3)
        one = ss.simulate(system, base, t1=T1, y0=y0, method=METHOD)
        assert float(one.final_state[0]) == pytest.approx(many.output_values["end"][3], abs=1e-13)

    def test_durations(self):
        suite = ss.RecordSuite(RECORDS)
        np.testing.assert_allclose(suite.records.durations, [2.38, 1.75, 3.0], rtol=1e-15)
        np.testing.assert_allclose(ss.RecordSuite(EVEN).records.durations, [1.975, 2.98], rtol=1e-15)
        assert suite.duration == 3.0
        np.testing.assert_array_equal(suite.records.peaks, [np.max(np.abs(one.accelerations)) for one in RECORDS])


class TestRandom:
    @pytest.mark.slow
    def test_records_and_scales_are_drawn(self):
        values = run(ss.RecordSuite(RECORDS, ss.LogNormal(1.0, 0.3), "random"), samples=600, key=KEY).input_values
        counts = np.bincount(values["record"].astype(int), minlength=3)
        assert counts.sum() == 600
        assert np.sum((counts - 200) ** 2 / 200) < 13.8  # chi squared of two degrees of freedom: 1 in 1000
        assert abs(np.mean(np.log(values["scale"]))) < 3.3 * 0.3 / np.sqrt(600)

    def test_sample_draws_an_entry(self):
        suite = ss.RecordSuite(EVEN, scale=[0.5, 2.0])
        keys = jax.random.split(KEY, 100)

        def entry(key):
            one = suite.sample(key, T1)
            return one.record, one.scale

        record, scale = jax.vmap(entry)(keys)
        assert 25 < float(np.sum(record)) < 75
        np.testing.assert_array_equal(scale, np.where(np.asarray(record) == 0, 0.5, 2.0))
        drawn = ss.RecordSuite(EVEN, ss.Uniform(0.5, 1.0), "random").sample(KEY, T1)
        assert float(drawn.record) in (0.0, 1.0)
        assert 0.5 <= float(drawn.scale) <= 1.0
        assert drawn.sample(None, T1) is drawn
        with pytest.raises(ValueError, match="key must be a key"):
            suite.sample(None, T1)


class TestTransformations:
    @pytest.mark.slow
    def test_under_vmap_and_jit(self):
        suite = ss.RecordSuite(EVEN).at_scales([1.0, 0.5])
        end = lambda i: ss.simulate(slider(), suite[i], t1=T1, method=METHOD).final_state[0]  # noqa: E731
        together = jax.jit(jax.vmap(end))(jnp.arange(4))
        np.testing.assert_allclose(together, run(suite).output_values["end"], rtol=0, atol=1e-13)

    @pytest.mark.slow
    def test_derivatives_by_friction_and_scale(self):
        suite = ss.RecordSuite(EVEN)

        def mean(mu, scale):
            def end(i):
                base = ss.RecordSuite(suite.records, scale, i.astype(float))
                return ss.simulate(slider(mu), base, t1=T1, method=METHOD).final_state[0]

            return jnp.mean(jax.vmap(end)(jnp.arange(2)))

        found = jax.grad(mean, (0, 1))(0.1, 1.0)
        for place, h in ((0, 1e-6), (1, 1e-6)):
            up, down = ([x + s * h * (i == place) for i, x in enumerate((0.1, 1.0))] for s in (1, -1))
            ends = [np.mean([_end(*at, one) for one in EVEN]) for at in (up, down)]
            assert float(found[place]) == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-5)


def _end(mu, scale, motion):
    return float(ss.simulate(slider(mu), quiet(motion, scale), t1=T1, method=METHOD).final_state[0])


class TestStorage:
    def test_records_are_stored_once(self):
        """The numbers of a sample are those of its record and its scale."""
        suite = ss.RecordSuite(RECORDS).at_scales(np.ones(200))
        assert suite.records is ss.RecordSuite(suite.records).records
        assert sum(np.size(leaf) for leaf in (suite.record, suite.scale)) == 2 * 600

    @pytest.mark.slow
    def test_a_large_suite_runs_in_a_native_loop(self):
        """A warning would say that XLA does not compile one."""
        times = np.arange(20_000) * 0.01
        suite = ss.RecordSuite([ss.GroundAcceleration(times, np.sin(3 * times + i)) for i in range(100)])
        many = run(suite, t1=0.5)
        assert many.finished == 100
        one = ss.simulate(slider(), suite.motion(77), t1=0.5, method=METHOD)
        assert many.output_values["end"][77] == pytest.approx(float(one.final_state[0]), abs=1e-13)

    @pytest.mark.slow
    @pytest.mark.parametrize("most", [2**20, 10], ids=["stored", "known by a check sum"])
    def test_a_sweep_goes_on_in_its_folder(self, tmp_path, monkeypatch, most):
        monkeypatch.setattr(encoding, "_MOST_POINTS", most)
        suite = ss.RecordSuite(EVEN)

        def sweep(suite, values):
            options = {"t1": T1, "samples": 2, "keep": "totals", "method": METHOD, "outputs": OUTPUTS}
            return ss.Sweep(slider(), suite, over={"mu": values}, **options).run(tmp_path / "sweep", progress=False)

        first, both = sweep(suite, [0.1]), sweep(suite, [0.1, 0.2])
        assert float(first.end_mean[0]) == float(both.end_mean[0])
        expected = np.mean([_end(0.2, 1.0, one) for one in EVEN])
        assert float(both.end_mean[1]) == pytest.approx(expected, abs=1e-13)
        with pytest.raises(ss.SweepError, match="holds a sweep with other numbers"):
            sweep(ss.RecordSuite(EVEN, 1.5), [0.1])
        many = run(suite)
        loaded = ss.load(many.save(tmp_path / "many.nc"))
        assert (type(loaded.law) is RecordSuite) == (most > 10)
        if most > 10:
            assert repr(loaded.law) == repr(suite)
            assert repr(loaded.realization(1).base) == repr(many.realization(1).base)


class TestReading:
    def test_a_folder(self, tmp_path):
        (tmp_path / "b.csv").write_text("0.0,1.0\n0.5,-2.0\n")
        (tmp_path / "a.AT2").write_text(
            "PEER\nACCELERATION TIME SERIES IN UNITS OF G\nNPTS= 3, DT= .01 SEC\n 0.0 0.5 -0.25\n"
        )
        (tmp_path / "notes.txt").write_text("none")
        suite = ss.RecordSuite(tmp_path)
        assert suite.names == ("a", "b")
        np.testing.assert_allclose(suite.motion(0).accelerations, np.array([0.0, 0.5, -0.25]) * 9.80665)
        assert suite.motion(1).accelerations.tolist() == [1.0, -2.0]
        assert repr(suite).startswith("RecordSuite(2 records of 0.02 to 0.5 s, 2 samples, check sum ")


@pytest.mark.usefixtures("annotations_unchecked")
class TestRefusals:
    @pytest.mark.parametrize("records", [[], [1.0], None, "no such folder", ss.Constant(1.0), {"a": RECORDS[0]}])
    def test_records(self, records):
        with pytest.raises(ValueError, match=r"records must be a list of GroundAccelerations, or the name of a folder"):
            ss.RecordSuite(records)

    def test_numbers(self):
        with pytest.raises(ValueError, match=r"record and scale must have one number for each sample, but .*at_scales"):
            ss.RecordSuite(EVEN, [1.0, 2.0, 3.0])
        with pytest.raises(ValueError, match=r"record must be the number of one of 2 records, from 0, but 2.0 was"):
            run(ss.RecordSuite(EVEN, record=[0, 2]))
        with pytest.raises(ValueError, match=r"record must be one of 'random', but 'all' was given"):
            ss.RecordSuite(EVEN, record="all")
        with pytest.raises(ValueError, match=r"law.record must hold one number for each of the 3 samples"):
            run(ss.RecordSuite(EVEN), samples=3)
        with pytest.raises(ValueError, match=r"base.record must be one number here"):
            ss.simulate(slider(), ss.RecordSuite(EVEN), t1=T1)
        with pytest.raises(ValueError, match=r"record must be known for each sample here, but Discrete"):
            ss.RecordSuite(EVEN, record="random").at_scales([1.0])
