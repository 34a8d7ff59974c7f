"""Events of friction that coincide exactly with those of the base, on lattices of instants, against 60 digits.

A mass that meets the base's velocity at the very instant at which that jumps, or where friction gives way at once, has
not stuck: the reference has no stick there, or one of 1e-50 s. The package must neither invent one nor lose others.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf
from reference.event_by_event import trace_reference

import stickslip_jax as ss

DIGITS, NOTHING = 45, 1e-30  # a stick shorter than this (s) is none in exact numbers
LANES, SLOTS, TURN = 200, 10, 6  # durations are multiples of pi / TURN: twelfths of a turn of the spring
RATIOS = np.arange(15, 25) / 10
CLOSE = {np.float64: 1e-7, np.float32: 2e-3}  # where an arc is tangent, the square root of the round-off
BELT = ss.papers.belt_oscillator()


def exact_sticks(mass, stiffness, mu, start, durations, velocities, t1):
    """Start and end of each stick with a length, (sticks, 2), s."""
    with mp.workdps(DIGITS + 15):
        segments = trace_reference(
            mass=mass, stiffness=stiffness, normal_force=1, mu=mpf(mu), durations=durations,
            velocities=[mpf(float(v)) for v in velocities], t1=t1, position0=mpf(start[0]), velocity0=mpf(start[1]),
            digits=DIGITS,
        )  # fmt: skip
        found = [(one.start, one.end) for one in segments if one.side == 0 and one.end - one.start > NOTHING]
    return np.array(found, float).reshape(-1, 2)


def square_wave(ratio, number):
    """Durations of half periods of the paper's belt, of which 60 digits are right, and its velocities."""
    half = mp.pi / (2 * mpf(str(ratio)))
    return [half] * number, [-1.0, 1.0] * (number // 2)


@jax.jit
@jax.vmap
def followed(mu, x, p, durations, velocities, t1):
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(mu))
    one = ss.simulate(system, ss.VelocitySteps(durations, velocities), t1=t1, y0=(x, p))
    return one.sticks.start, one.sticks.end, one.sticks.mask, one.near_grazing_count, one.stick_time


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.slow)])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow)])
def test_all_on_one_lattice(dtype, seed):
    """Starts, velocities, friction and durations on lattices: arrivals and releases fall on jumps, in both orders, on
    edges of the stick band, on rests of the base and on the end of the time.
    """
    source = np.random.default_rng(seed)
    mu, many = source.choice([0.25, 0.5, 1.0], LANES), (LANES, SLOTS)
    x, p = source.integers(-4, 5, LANES) / 2 * mu, source.integers(-2, 3, LANES) / 2
    twelfths, velocities = source.integers(1, 13, many), source.integers(-2, 3, many) / 2
    given = mu, x, p, twelfths * np.pi / TURN, velocities, twelfths.sum(1) * np.pi / TURN
    start, end, mask, near, total = (np.asarray(out) for out in followed(*(one.astype(dtype) for one in given)))
    for lane in range(LANES):
        with mp.workdps(DIGITS + 15):
            durations = [int(number) * mp.pi / TURN for number in twelfths[lane]]
            t1 = int(twelfths[lane].sum()) * mp.pi / TURN
        exact = exact_sticks(1, 1, mu[lane], (x[lane], p[lane]), durations, velocities[lane], t1)
        found = np.stack([start[lane], end[lane]], 1)[mask[lane]]
        assert found.shape == exact.shape, lane
        np.testing.assert_allclose(found, exact, rtol=0, atol=CLOSE[dtype])
        np.testing.assert_allclose(total[lane], np.sum(exact[:, 1] - exact[:, 0]), atol=10 * CLOSE[dtype])
    assert np.sum(near > 0) > LANES // 5  # the search must not be empty
    assert mask.sum() > 3 * LANES


@functools.cache
def square_waves():
    """One sample for each ratio of the paper's belt, with its start, over 200 s."""
    law = ss.SquareWave(1.0, np.pi / RATIOS)
    return ss.simulate_ensemble(BELT, law, t1=200.0, samples=len(RATIOS), y0=(0.0, 1.0), keep="sticks", progress=False)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.5, 2.0, *(pytest.param(r, marks=pytest.mark.slow) for r in (1.6, 1.9, 2.2, 2.4))])
def test_the_belt_of_the_conference_paper_in_exact_numbers(ratio):
    with mp.workdps(60):
        durations, velocities = square_wave(ratio, 320)
    assert len(exact_sticks(1, 4, 1, (0, 1), durations, velocities, 200)) == 0
    assert square_waves().totals.sticks[ratio == RATIOS] == 0


@pytest.mark.slow
def test_no_statistic_of_the_belt_knows_a_stick():
    many = square_waves()
    assert many.sticks.mask.sum() == 0
    assert ss.mean_stick_count(many).value == 0
    assert np.isnan(ss.mean_stick_duration(many).value)
    assert "sticks    0 found" in repr(many)
    np.testing.assert_array_equal(many.totals.slips, 1)
    # Each is told, with the number of half periods in which it is so.
    assert many.near_grazing_samples == len(RATIOS)
    assert "near-grazing: 10 samples" in repr(many)
    setup = ss.papers.square_wave_belt(2.0)
    one = ss.simulate(setup.system, setup.law, t1=setup.t1, y0=setup.y0)
    assert int(one.sticks.count) == 0
    assert int(one.near_grazing_count) == many.totals.near_grazing_count[RATIOS == 2.0] > 50


@pytest.mark.slow
def test_a_sweep_of_the_belt_knows_none():
    found = ss.papers.stick_share_map("square", mu=[1.0], ratios=RATIOS).run(progress=False)
    np.testing.assert_array_equal(found.stick_fraction, 0)
    np.testing.assert_array_equal(found.samples_near_grazing, 1)


@functools.cache
def random_belts(samples):
    """The conference paper's random belt at r = 2, a direction drawn in each half period."""
    law = ss.RandomSteps(1.0, np.pi / 4)
    options = {"key": jax.random.key(0), "y0": (0.0, 0.0), "keep": "sticks", "progress": False}
    return ss.simulate_ensemble(BELT, law, t1=200.0, samples=samples, **options)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [8, pytest.param(100, marks=pytest.mark.slow)])
def test_a_random_belt_on_a_lattice(samples):
    many, checked = random_belts(1000), 0
    for number in range(samples):
        _, base, _ = many.realization(number)
        steps = np.rint(np.asarray(base.durations) * 4 / np.pi).astype(int)
        with mp.workdps(DIGITS + 15):
            durations = [int(count) * mp.pi / 4 for count in steps]
        exact = exact_sticks(1, 4, 1, (0, 0), durations, np.asarray(base.velocities), 200)
        mask = many.sticks.mask[number]
        found = np.stack([many.sticks.start[number], many.sticks.end[number]], 1)[mask]
        # A tangent arrival whose stick is shorter than 1e-6 s may be missed (`_TOUCH_ULPS`), but none is invented.
        for start in found[found[:, 1] - found[:, 0] < 1e-6, 0]:
            assert np.abs(exact[:, 0] - start).min() < 1e-6
        found, exact = (sticks[sticks[:, 1] - sticks[:, 0] > 1e-6] for sticks in (found, exact))
        assert found.shape == exact.shape, number
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-7)
        checked += len(exact)
    assert checked > 50 * samples
    # Before, 463 of 58,054 sticks were shorter than 1 ns, and the mean was 0.26541 s.
    assert abs(ss.mean_stick_duration(many).value - 0.267538) < 1e-6
    assert many.near_grazing_samples > 500


@pytest.mark.slow
def test_the_largest_position_after_friction_gave_way_at_once():
    """From above the mass meets the base where friction gives way, and goes on about 1/2, with the radius 1."""
    base = ss.VelocitySteps(jnp.asarray([10.0]), jnp.asarray([1.0]))
    one = ss.simulate(ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.5)), base, t1=9.0, y0=(-0.5, np.sqrt(2.0)))
    assert int(one.sticks.count) == 0
    assert int(one.near_grazing_count) == 1
    assert float(one.maximum("position")) == pytest.approx(1.5, abs=1e-12)
    assert float(one.minimum("position")) == pytest.approx(-0.5, abs=1e-12)
