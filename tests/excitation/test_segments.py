"""Laws of one's own, drawn segment by segment, as a user writes them: the example of the documentation is run.

A test with a fixed key gives the same answer for ever. Its bound was fixed beforehand: `CHANCE` is the probability
that a correct law fails it for a key picked blindly.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from support.segments import documented_law

import stickslip_jax as ss
from stickslip_jax._excitation.excitation import excitation_of
from stickslip_jax._excitation.segments import first_segment, following_segment
from stickslip_jax._uncertainty.numbers import leaves_of_numbers, number_at

CHANCE = 1e-3
KEY = jax.random.key(5)
SYSTEM = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.3))
T1 = 20.0


Ramps, USE, NAMES = documented_law()
LAW = Ramps(speed=1.0, rate=0.5)


class Jumping(ss.SegmentLaw):
    """A constant velocity for a random time, then another, drawn with a key of its own."""

    is_random = True
    jumps = True

    def segments(self, t1):
        return 1  # too few

    def begin(self, key_data, dtype):
        return jnp.where(self.uniforms(key_data, None, dtype)[0] < 0.5, 1, -1).astype(dtype)

    def draw(self, key_data, number, dtype):
        key = jax.random.fold_in(jax.random.wrap_key_data(jnp.stack(key_data)), number)
        return jax.random.exponential(key, (), dtype)

    def next_segment(self, memory, drawn, dtype):
        return drawn, memory * 0.7, 0.0, -memory


class Shaking(ss.GroundMotion):
    """A ground acceleration with random values every 0.3 s, which ends after 12 s."""

    is_random = True

    def segments(self, t1):
        return 50

    def begin(self, key_data, dtype):
        return jnp.zeros((), dtype)

    def draw(self, key_data, number, dtype):
        return number, self.uniforms(key_data, number, dtype)[0]

    def next_segment(self, memory, drawn, dtype):
        (number, u), duration = drawn, jnp.asarray(0.3, dtype)
        following = 2 * u - 1
        return jnp.where(number < 40, duration, 0), memory, (following - memory) / duration, following


def sticks_of(one):
    number = int(one.sticks.count)
    return [np.asarray(column)[:number] for column in (one.sticks.start, one.sticks.end, one.sticks.position)]


def sticks_in(many, sample):
    number, flat = int(many.flat_sticks.count[sample]), many.flat_sticks
    first = int(many.flat_sticks.count[:sample].sum())
    return [column[first : first + number] for column in (flat.start, flat.end, flat.position)]


@pytest.fixture(scope="module")
def many():
    return ss.simulate_ensemble(SYSTEM, LAW, t1=T1, samples=256, key=KEY, keep="sticks")


class TestExample:
    @pytest.mark.slow
    def test_it_runs(self, capsys):
        """As it is written, but for the number of samples."""
        names = NAMES | {"system": SYSTEM}
        exec(USE.replace("samples=1000", "samples=8").replace("t1=100.0", "t1=20.0"), names)
        assert isinstance(names["law"], ss.SegmentLaw)

    def test_durations_and_velocities_have_the_distributions_it_states(self):
        segments = LAW.sample(KEY, 1.0, capacity=20_000)
        durations, values = np.asarray(segments.durations), np.asarray(segments.values)
        assert stats.kstest(durations, stats.expon(scale=2.0).cdf).pvalue > CHANCE
        assert stats.kstest(values[1:], stats.uniform(-1, 2).cdf).pvalue > CHANCE
        assert stats.spearmanr(durations[:-1], values[1:]).pvalue > CHANCE

    @pytest.mark.slow
    def test_velocity_is_continuous_and_linear(self):
        segments = LAW.sample(KEY, T1)
        times, values = np.asarray(segments.times), np.asarray(segments.values)
        assert times[-1] > T1
        inside = np.linspace(0, T1, 777)
        assert np.asarray(segments.value(inside)) == pytest.approx(np.interp(inside, times, values), abs=1e-12)
        assert segments.jumps is False


class TestSample:
    @pytest.mark.slow
    def test_repeats_each_sample_of_an_ensemble(self, many):
        assert many.finished == 256
        assert sum(len(sticks_in(many, sample)[0]) for sample in range(12)) > 12
        for sample in range(12):
            _, base, y0 = many.realization(sample)
            one = ss.simulate(SYSTEM, base, t1=T1, y0=y0)
            for mine, other in zip(sticks_of(one), sticks_in(many, sample), strict=True):
                assert mine == pytest.approx(other, abs=1e-12)  # time steps are compiled differently

    @pytest.mark.slow
    def test_moves_the_mass_as_a_record_of_the_same_motion(self):
        base = LAW.sample(jax.random.fold_in(KEY, 3), T1)
        record = ss.Recorded(np.asarray(base.times), np.asarray(base.values))
        one, other = (ss.simulate(SYSTEM, motion, t1=T1) for motion in (base, record))
        assert sticks_of(one)[0].size > 0
        for mine, expected in zip(sticks_of(one), sticks_of(other), strict=True):
            assert mine == pytest.approx(expected, abs=1e-11)

    @pytest.mark.slow
    def test_jumps_as_steps_in_closed_form(self):
        """A law of steps, by time steps, is the same motion as `VelocitySteps`, in whole intervals."""
        base = Jumping().sample(KEY, T1)
        assert float(np.asarray(base.durations).sum()) > T1  # more than `segments` says
        steps = ss.VelocitySteps(base.durations, base.values)
        one, other = ss.simulate(SYSTEM, base, t1=T1), ss.simulate(SYSTEM, steps, t1=T1)
        assert sticks_of(one)[0].size >= 2
        for mine, expected in zip(sticks_of(one), sticks_of(other), strict=True):
            assert mine == pytest.approx(expected, abs=1e-9)

    @pytest.mark.slow
    def test_a_larger_capacity_continues_it(self):
        short, long = (LAW.sample(KEY, T1, capacity=size) for size in (20, 33))
        for name in ("durations", "values", "slopes"):
            assert getattr(short, name).tolist() == getattr(long, name)[:20].tolist()

    @pytest.mark.slow
    def test_too_few_segments_are_reported(self):
        one = ss.simulate(SYSTEM, LAW.sample(KEY, T1, capacity=3), t1=T1)
        assert int(one.status) == ss.Status.BASE_TOO_SHORT

    @pytest.mark.slow
    def test_under_vmap_it_has_the_segments_of_the_law(self):
        batch = jax.vmap(lambda key: Jumping().sample(key, T1))(jax.random.split(KEY, 4))
        assert batch.durations.shape == (4, 1)
        batch = jax.jit(jax.vmap(lambda key: LAW.sample(key, T1)))(jax.random.split(KEY, 4))
        assert batch.durations.shape == (4, LAW.segments(T1))
        alone = LAW.sample(jax.random.split(KEY, 4)[2], T1)
        assert batch.values[2].tolist() == alone.values.tolist()

    def test_derivative(self):
        """Velocities are in proportion to `speed`, durations to ``1 / rate``."""

        def motion(speed, rate):
            segments = Ramps(speed, rate).sample(KEY, T1, capacity=20)
            return segments.values, segments.durations

        (values, durations), (d_values, _) = jax.jvp(motion, (1.5, 0.5), (1.0, 0.0))
        assert np.asarray(d_values) == pytest.approx(np.asarray(values) / 1.5, abs=1e-14)
        _, (_, d_durations) = jax.jvp(motion, (1.5, 0.5), (0.0, 1.0))
        assert np.asarray(d_durations) == pytest.approx(-np.asarray(durations) / 0.5, abs=1e-12)

    def test_float32(self):
        with jax.enable_x64(False):
            base = LAW.sample(KEY, T1)
        assert base.durations.dtype == base.slopes.dtype == np.float32
        assert float(base.durations.sum()) >= T1


def test_a_law_without_randomness_is_its_own_realization():
    record = ss.Recorded([0.0, 30.0], [0.0, 1.0])
    assert record.sample(None, T1) is record


@pytest.mark.slow
def test_ground_motion():
    """Its realisation is the record of the same accelerations, and ends where the law has no further segment."""
    base = Shaking().sample(KEY, 10.0)
    assert int(np.count_nonzero(base.durations)) == 40
    values = np.append(np.asarray(base.values)[:40], float(base.values[39] + 0.3 * base.slopes[39]))
    record = ss.GroundAcceleration(0.3 * np.arange(41), values)
    one, other = (ss.simulate(SYSTEM, motion, t1=10.0) for motion in (base, record))
    assert sticks_of(one)[0].size > 0
    for mine, expected in zip(sticks_of(one), sticks_of(other), strict=True):
        assert mine == pytest.approx(expected, abs=1e-9)


class TestWithJumps:
    law = ss.WithJumps(LAW, ss.PoissonSwitching(0.4, 0.5))

    def test_motion_and_jumps_are_independent(self):
        """Both draw gaps of mean 2 s: with the same key data they would jump at the same times."""
        base = self.law.sample(KEY, T1)
        shared = min(base.motion.durations.size, base.jumps.durations.size)
        ranks = [np.asarray(part.durations)[:shared] for part in (base.motion, base.jumps)]
        assert stats.spearmanr(*ranks).pvalue > CHANCE
        assert not np.isclose(*ranks).any()

    def test_an_ensemble_draws_the_segments_of_its_samples(self):
        excitation, key_data = excitation_of(self.law), jax.random.key_data(KEY)
        own = excitation.segment_key_data(key_data)
        base = self.law.sample(KEY, T1)
        for law, part in zip(excitation.base, (base.motion, base.jumps), strict=True):
            state = first_segment(law, own, jnp.float64)
            for number in range(3):
                assert float(state.segment.end - state.segment.begin) == pytest.approx(float(part.durations[number]))
                state = following_segment(law, state, jnp.float64)


PLACES = {
    "speed": (LAW, ("speed",)),
    "motion": (ss.WithJumps(LAW, ss.PoissonSwitching(0.4, 0.5)), ("motion", "rate")),
    "jumps": (ss.WithJumps(LAW, ss.PoissonSwitching(0.4, 0.25)), ("jumps", "rate")),
    "smooth": (ss.WithJumps(ss.Harmonic(0.3, 2.0), ss.PoissonSwitching(0.4, 0.5)), ("motion", "amplitude")),
    "phase": (ss.RandomPhase(ss.Harmonic(0.3, 2.0)), ("signal", "amplitude")),
    "ground": (ss.KanaiTajimi(1.5), ("rms",)),
    "process": (ss.GaussianProcess(ss.KanaiTajimiSpectrum(2.5), 30.0), ("spectrum", "intensity")),
}


@pytest.mark.parametrize("case", PLACES)
def test_parameters_of_laws_are_found_in_their_excitation(case):
    law, path = PLACES[case]
    (leaf,) = leaves_of_numbers(excitation_of, law, (path,))
    assert jax.tree.leaves(excitation_of(law))[leaf] == number_at(law, path)


@pytest.mark.slow
def test_sensitivity_by_finite_differences(many):
    """Of the mean number of sticks by `speed`: the difference of two ensembles of the same key."""
    found = ss.sensitivity(
        ss.mean_stick_count, SYSTEM, LAW, wrt="law.speed", t1=T1, samples=256, key=KEY, step=0.1,
        estimator="finite-difference",
    )  # fmt: skip
    up, down = (
        ss.simulate_ensemble(SYSTEM, Ramps(speed, 0.5), t1=T1, samples=256, key=KEY, keep="sticks")
        for speed in (1.1, 0.9)
    )
    assert abs(found.derivative) > found.standard_error
    assert found.derivative == pytest.approx(
        float((up.flat_sticks.count - down.flat_sticks.count).mean() / 0.2), rel=1e-9
    )
    assert found.value == pytest.approx(many.flat_sticks.count.mean(), rel=1e-9)


BAD = {
    "no key": (lambda: LAW.sample(None, 1.0), r"key must be .* for the random law Ramps, but None"),
    "t1": (lambda: LAW.sample(KEY, -1.0), r"t1 must be positive \(in s\), but -1.0"),
    "capacity": (lambda: LAW.sample(KEY, 1.0, capacity=0), r"capacity must be a whole number of at least 1, but 0"),
    "traced": (
        lambda: jax.jit(lambda t1: LAW.sample(KEY, t1))(1.0),
        r"capacity must be given when t1 or the law's parameters are traced .*Ramps\(\.\.\.\)\.segments\(t1\)",
    ),
    "shapes": (
        lambda: ss.VelocitySegments(np.ones(3), np.ones(2), np.ones(3)),
        r"durations, values and slopes must have the same shape \(segments,\), but .* \(3,\), \(2,\), \(3,\)",
    ),
    "durations": (lambda: ss.VelocitySegments(-np.ones(1), np.ones(1), np.ones(1)), r"durations must be zero or pos"),
    "values": (lambda: ss.VelocitySegments(np.ones(1), np.full(1, np.nan), np.ones(1)), r"values must be finite"),
    "law": (
        lambda: ss.simulate(SYSTEM, LAW, t1=1.0),
        r"base must be a realisation, but the random law Ramps was given; draw one with base.sample\(key, t1\)",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input(case, annotations_unchecked):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()
