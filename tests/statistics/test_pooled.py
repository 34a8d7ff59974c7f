"""What is pooled: sticks without the initial rest unless it counts, angles within their period; everywhere alike."""

import math

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax._dynamics.sticks import within_period

SAMPLES = 200


@pytest.fixture(scope="module", params=[False, True], ids=["rest left out", "rest counted"])
def motors(request):
    """Motors that start at rest: every sample begins with a stick; they turn on average more than once."""
    return ss.simulate_ensemble(
        ss.MotorCart(mu=0.35), ss.RandomPhase(ss.SourceVoltage()), t1=2.0, samples=SAMPLES, key=jax.random.key(1),
        y0=(ss.Uniform(0.0, 2 * math.pi), 0.0, 0.0), keep="sticks", count_initial_rest=request.param,
    )  # fmt: skip


@pytest.fixture(scope="module")
def pooled(motors):
    """Start, duration, angle and ending of each stick that is pooled, found one by one."""
    flat, counted = motors.flat_sticks, motors.numbering.count_initial_rest
    chosen = np.array([counted or start > 0 for start in flat.start])
    assert np.sum(flat.start == 0) == SAMPLES
    return {name: getattr(flat, name)[chosen] for name in ("start", "duration", "position", "ending")}


def test_every_pooled_mean_is_of_the_same_sticks(motors, pooled):
    statistics = motors.statistics
    for name in ("start", "duration", "position"):
        of = getattr(statistics, name)
        assert of.number == len(pooled[name])
        assert of.mean.value == pytest.approx(pooled[name].mean(), rel=1e-12)
        assert (of.smallest, of.largest) == (pooled[name].min(), pooled[name].max())
    assert ss.mean_stick_duration(motors).value == pytest.approx(pooled["duration"].mean(), rel=1e-12)
    assert ss.mean_stick_duration(motors).standard_error == pytest.approx(
        statistics.duration.mean.standard_error, rel=1e-9
    )
    share = np.mean(pooled["ending"] == ss.Ending.HORIZON)
    assert statistics.endings[ss.Ending.HORIZON].value == pytest.approx(share)
    _, row = (line for line in repr(motors.summary()).splitlines() if line.startswith("stick duration"))
    assert row.endswith(f"{len(pooled['duration']):,}")


def test_joint_distributions_and_figures_are_of_the_same_sticks(motors, pooled):
    complete = pooled["ending"] != ss.Ending.HORIZON
    assert motors.statistics.joint("duration", "position").number == len(pooled["duration"])
    assert motors.statistics.joint("start", "position").number == len(pooled["duration"])
    label = plot.histogram(motors).get_legend().get_texts()[0].get_text()
    assert label.startswith(f"{complete.sum():,} sticks")
    points = np.asarray(plot.stick_map(motors).collections[0].get_offsets())
    assert sorted(points[:, 1]) == sorted(pooled["duration"][complete])
    assert f"{len(pooled['duration']):,} values" in (
        plot.histogram(motors.statistics.duration).get_legend().get_texts()[0].get_text()
    )


def test_numbers_of_samples_hold_every_stick(motors):
    """The number of sticks and the stick fraction are those of the whole of [0, t1]."""
    flat = motors.flat_sticks
    assert motors.statistics.stick_count.mean.value == pytest.approx(len(flat.start) / SAMPLES)
    assert ss.mean_stick_count(motors).value == pytest.approx(len(flat.start) / SAMPLES)
    assert ss.stick_fraction(motors).value == pytest.approx(flat.duration.sum() / SAMPLES / 2.0)
    assert motors.statistics.slip_duration.number == motors.totals.slips.sum() == len(motors.to_xarray().slip)
    counted = motors.numbering.count_initial_rest
    own = [
        row[mask][0 if counted else 1 :] for row, mask in zip(motors.sticks.duration, motors.sticks.mask, strict=True)
    ]
    expected = np.mean([durations.mean() for durations in own if len(durations)])
    assert motors.statistics.own_mean_duration.mean.value == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
def test_angles_stay_in_a_circle_everywhere(motors):
    """They are those of the simulations modulo 2 pi, in sums, histograms, tables and files."""
    flat = motors.flat_sticks
    found = []
    for number in range(4):
        _, base, y0 = motors.realization(number)
        one = ss.simulate(motors.system, base, t1=2.0, y0=y0)
        found.append(np.asarray(one.sticks.position)[np.asarray(one.sticks.mask)])
    assert np.concatenate(found).max() > 2 * np.pi
    first = flat.count[:4].sum()
    # Compiled apart; the angle at an event amplifies the last places by less than 1e5.
    np.testing.assert_allclose(flat.position[:first], np.mod(np.concatenate(found), 2 * np.pi), atol=1e-10)
    assert 0 <= flat.position.min() < flat.position.max() < 2 * np.pi
    assert motors.statistics.position.largest < 2 * np.pi
    for histogram in (
        motors.statistics.position.histogram(50).edges,
        motors.statistics.joint("duration", "position").histogram(64).y_edges,
        motors.statistics.to_xarray().position_bin_bounds.to_numpy(),
    ):
        assert np.max(histogram) < 2 * np.pi + 0.2  # the last bin reaches beyond by less than its width
    assert ss.first_stick(motors).position[ss.first_stick(motors).mask].max() < 2 * np.pi
    assert float(motors.to_xarray().stick_position.max()) < 2 * np.pi


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_folding_by_hand(dtype):
    period = 2 * math.pi
    angles = np.array([0.0, 1.0, 6.25, 7.0, -1.0, -1e-12, 8.1, 100.0], dtype)
    folded = within_period(angles, period)
    assert folded.dtype == dtype
    assert np.all((folded >= 0) & (folded < dtype(period)))
    assert folded[:3].tolist() == angles[:3].tolist()
    np.testing.assert_allclose(np.exp(1j * folded), np.exp(1j * angles.astype(float)), atol=100 * np.finfo(dtype).eps)
