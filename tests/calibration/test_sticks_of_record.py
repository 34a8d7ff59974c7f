"""Sticks in measured speeds: those of exact motions come back within bounds by step and threshold; what is refused."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stickslip_jax as ss

SPEED, MU, MU_STATIC, OMEGA, T1 = 0.2, 0.3, 0.5, 1.0, 70.0


def below_threshold(threshold):
    """How long the slip of a unit mass under a unit normal force is slower than this, at either of its ends, s.

    It begins at ``x = MU_STATIC / OMEGA^2`` and swings around ``MU / OMEGA^2``, so that its relative velocity is
    ``R cos(OMEGA t + phi) - SPEED`` with ``R cos(phi) = SPEED``, the same from either end.
    """
    phase = np.arctan2((MU_STATIC - MU) / OMEGA, SPEED)
    return (np.arccos((SPEED - threshold) * np.cos(phase) / SPEED) - phase) / OMEGA


@pytest.fixture(scope="module")
def motion():
    system = ss.MassSpring(1.0, OMEGA**2, 1.0, ss.Coulomb(MU, MU_STATIC))
    return ss.simulate(system, ss.Constant(SPEED), t1=T1, y0=(0.0, SPEED))


@pytest.mark.parametrize("step", [0.02, 0.1, 0.21])
@pytest.mark.parametrize("threshold", [1e-3, 0.01, 0.05])
def test_sticks_of_an_exact_motion_come_back(motion, step, threshold):
    """Within a step, and outwards by the time that the slip itself is slower than the threshold."""
    times = np.arange(0.0, T1 + step / 2, step)
    times = times[times <= T1]
    speed = np.asarray(motion.evaluate(times)[1]) - SPEED
    found = ss.sticks_of_record(times, speed, threshold, minimum_duration=0.5)
    mask = np.asarray(motion.sticks.mask)
    start, end = (np.asarray(column)[mask] for column in (motion.sticks.start, motion.sticks.end))
    end = np.minimum(end, times[-1])
    single = start.dtype == np.float32
    assert len(start) > 10
    assert len(found.start) == len(start)
    slack = 1e-4 if single else 1e-9
    early = below_threshold(threshold) + step + slack
    assert np.all(found.start - start >= -early)
    assert np.all(found.start - start <= step + slack)
    assert np.all(end - found.end >= -early)
    assert np.all(end - found.end <= step + slack)
    assert found.start[0] == 0
    assert found.end[-1] == found.t1 or end[-1] < found.t1


def test_what_passes_through_zero_is_left_out_by_its_duration():
    """It is slow for 2 threshold / acceleration: at zero crossings of sin t, whose slope is 1, for twice the threshold.

    A chord of steps of h is up to h^2 / 24 flatter.
    """
    times = np.linspace(0.0, 100.0, 10_001)
    crossings = ss.sticks_of_record(times + 7.0, np.sin(times + 0.3), 0.02, minimum_duration=0.0)
    assert len(crossings.start) == np.floor((100.3) / np.pi)
    np.testing.assert_allclose(crossings.end - crossings.start, 2 * np.arcsin(0.02), rtol=1e-4)
    assert len(ss.sticks_of_record(times, np.sin(times + 0.3), 0.02, minimum_duration=0.041).start) == 0
    assert ss.sticks_of_record(times, np.sin(times), 0.02).minimum_duration == pytest.approx(0.02)


RECORDS = st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=30)


@settings(max_examples=200, deadline=None)
@given(RECORDS, st.floats(0.05, 2.0), st.integers(-3, 3), st.integers(-3, 3), st.integers(0, 2**16))
def test_invariants(values, threshold, time_power, speed_power, seed):
    """Slow is what the line through the samples is, looked at densely; scales and the sign of the speed do not matter;
    and the record backwards has the sticks backwards.
    """
    speed = np.array(values)
    times = np.cumsum(np.random.default_rng(seed).uniform(1.0, 1.9, len(speed)))
    times -= times[0]
    found = ss.sticks_of_record(times, speed, threshold, 0.0)
    dense = np.linspace(0.0, times[-1], 4001)
    slow = np.any((dense[:, None] >= found.start) & (dense[:, None] <= found.end), axis=1)
    level = np.abs(np.interp(dense, times, speed))
    assert np.all(slow[level < threshold - 1e-9])
    assert not np.any(slow[level > threshold + 1e-9])
    assert np.all(found.start[1:] > found.end[:-1])
    # Powers of two lose no digit.
    a, b = 2.0**time_power, 2.0**speed_power
    other = ss.sticks_of_record(a * times, -b * speed, b * threshold, 0.0)
    np.testing.assert_array_equal(other.start, a * found.start)
    np.testing.assert_array_equal(other.end, a * found.end)
    back = ss.sticks_of_record(times[-1] - times[::-1], speed[::-1], threshold, 0.0)
    long = found.end - found.start > 1e-9
    long_back = back.end - back.start > 1e-9
    np.testing.assert_allclose(back.start[long_back], (times[-1] - found.end[long])[::-1], atol=1e-12)
    np.testing.assert_allclose(back.end[long_back], (times[-1] - found.start[long])[::-1], atol=1e-12)


def test_several_records_make_an_ensemble(motion):
    """As each does alone; records of clocks that differ by less than a step are cut to the shortest."""
    step = 0.05
    rows = []
    for first in (0.0, 3.0, 11.0):
        at = first + np.arange(0.0, 20.0, step)
        rows.append((at, np.asarray(motion.evaluate(at)[1], float) - SPEED))
    rows[1] = (rows[1][0] * 1.0001, rows[1][1])
    found = ss.sticks_of_record([at for at, _ in rows], [speed for _, speed in rows], 0.01, 0.5)
    assert found.samples == 3
    assert found.t1 == pytest.approx(20.0 - step)
    for number, (at, speed) in enumerate(rows):
        alone = ss.sticks_of_record(at, speed, 0.01, 0.5)
        own = found.sample == number
        np.testing.assert_array_equal(found.start[own], alone.start)
        np.testing.assert_array_equal(found.end[own], np.minimum(alone.end, found.t1))
    many = ss.Ensemble.from_sticks(found, t1=found.t1, samples=found.samples)
    np.testing.assert_array_equal(many.finished_sticks().start, found["start"])
    assert many.samples == 3
    both = ss.sticks_of_record(rows[0][0], np.stack([rows[0][1], -rows[0][1]]), 0.01, 0.5)
    np.testing.assert_array_equal(both.start[both.sample == 0], both.start[both.sample == 1])


def test_plateau():
    """Noise below the threshold, slips far above it: a plateau; a speed that dwells at no level: none."""
    rng = np.random.default_rng(0)
    times = np.arange(0.0, 100.0, 0.01)
    slips = np.where(np.mod(times, 2.0) < 1.0, 1.0, 0.0)
    found = ss.sticks_of_record(times, slips + rng.uniform(-0.01, 0.01, len(times)), 0.05)
    assert len(found.start) == 50
    least, most = found.plateau
    assert 0.01 < least < 0.02
    assert most == found.thresholds[-1]
    shown = str(found)
    assert "A plateau: from" in shown
    assert "50 sticks in 1 x" in shown
    drowned = ss.sticks_of_record(times, rng.normal(size=len(times)), 0.1, 0.0)
    assert "No plateau" in str(drowned)
    low, high = drowned.plateau
    assert low <= 0.1 <= high
    none = ss.sticks_of_record(times, 10 + slips, 0.05)
    assert "No plateau" in str(none)
    assert not len(none.start)
    assert np.all(none.counts == 0)
    assert np.all(np.isnan(none.mean_durations))


@pytest.mark.parametrize(
    ("times", "speed", "words"),
    [
        ([0.0, 1.0, 2.0], [0.0, np.nan, 1.0], r"speed must be finite, but at 1 s it is nan; make a record"),
        ([0.0, 1.0, 2.0, 9.0], [0.0] * 4, r"times must have no gap, but 7 s follow 2 s, and a step is 1 s"),
        ([0.0, 1.0, 1.0], [0.0] * 3, r"times must increase"),
        ([0.0, 1.0, np.inf], [0.0] * 3, r"times must be finite"),
        ([0.0, 1.0], [0.0] * 3, r"speed must hold one number for each of at least two times"),
        ([[0.0, 1.0], [0.0, 1.0]], [0.0, 0.0], r"times must be given once, or for each of 1 records of speed, but"),
        ([[0.0, 1.0], np.arange(9.0)], [np.zeros(2), np.zeros(9)], r"times must last equally long, not 1 to 8 s"),
        ([0.0, 1.0], [[0.0, 1.0], [0.0, "a"]], r"Argument speed"),
    ],
)
def test_what_is_refused(times, speed, words):
    with pytest.raises(ValueError, match=words):
        ss.sticks_of_record(times, speed, 0.1)


def test_the_verdict_says_how_many_samples_it_needs():
    def many(samples, sticks):
        start = np.tile(np.arange(sticks) * 2.0, samples)
        table = {"sample": np.repeat(np.arange(samples), sticks), "start": start, "end": start + 0.5 + 0.01 * start}
        return ss.Ensemble.from_sticks(table, t1=30.0, samples=samples)

    told = ss.independent_and_identical(many(11, 7))
    assert "needs 5 samples for each of 5 orders, 25; 11 given; orders=2 needs 10" in told.reason
    two = ss.identically_distributed(many(9, 7), orders=2)
    assert two.reason == "needs 5 samples for each of 2 orders, 10; 9 given"
    few = ss.identically_distributed(many(30, 2), orders=(8, 9))
    assert few.reason == "two orders need 5 values; 0 of 30 samples have a value of theirs"


@pytest.mark.slow
def test_calibration_by_what_is_found():
    """Speeds of 100 motions on a random belt, ten noisy milliseconds apart: the friction that they were made with."""
    step, t1, noise = 0.01, 60.0, 2e-4
    rng = np.random.default_rng(1)

    def model(mu):
        system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))
        return system, ss.PoissonSwitching(speed=0.7, rate=0.9)

    start = (ss.Uniform(-0.5, 0.5), ss.Uniform(-0.5, 0.5))
    experiment = ss.simulate_ensemble(*model(1.2), t1=t1, samples=100, key=jax.random.key(0), y0=start, keep="sticks")
    times, speeds = np.arange(0.0, t1, step), []
    for number in range(experiment.samples):
        system, base, y0 = experiment.realization(number)
        one = ss.simulate(system, base, t1=t1, y0=y0, method=ss.Exact(max_steps=512))
        relative = np.asarray(one.evaluate(times)[1]) - np.asarray(ss.base_velocity(base, times))
        speeds.append(relative + noise * rng.normal(size=len(times)))
    found = ss.sticks_of_record(times, speeds, 2e-3)
    recorded = ss.Ensemble.from_sticks(found, t1=found.t1, samples=found.samples)
    # What is shorter than two steps is lost, and it is short: the stick time is compared.
    fit = ss.calibrate_sticks(
        *model(0.9), recorded, wrt="mu", samples=4096, key=jax.random.key(1), y0=start,
        moments=[ss.mean_total_stick_time],
    )  # fmt: skip
    assert abs(fit["mu"].value - 1.2) < 3 * fit["mu"].standard_error
    assert fit["mu"].standard_error < 0.05
    assert not ss.independent_and_identical(recorded).reason
