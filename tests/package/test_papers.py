"""The papers' set-ups: their numbers, and what is told of their figures."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.interval import SQUARE_WAVE_SHARES

import stickslip_jax as ss
from stickslip_jax import papers

TABLE = SQUARE_WAVE_SHARES | {1.5: 0.0}


@pytest.fixture(scope="module")
def share():
    return jax.jit(jax.vmap(papers.steady_stick_share))


@pytest.mark.slow
def test_steady_share_reproduces_the_figure(share):
    """0.02 percentage points: the table's rounding (0.005) and what a slowly settling motion still lacks."""
    shares = np.asarray(share(jnp.asarray(list(TABLE))))
    assert dict(zip(TABLE, (100 * shares).tolist(), strict=True)) == pytest.approx(TABLE, abs=0.02)


@pytest.mark.slow
def test_the_share_is_steady(share):
    """One period earlier it is the same to 1e-6, far below what the figure shows; motion settles geometrically."""
    ratios = jnp.linspace(0.1, 2.5, 49)
    before = jax.jit(jax.vmap(lambda ratio: papers.steady_stick_share(ratio, periods=399)))(ratios)
    assert np.asarray(share(ratios)) == pytest.approx(np.asarray(before), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("belt", ["square", "harmonic"])
def test_steady_shares_of_a_map(belt):
    """By the sweep, and of each motion alone, the last period of it; long before the motion is steady too."""
    ratios, frictions = [0.7, 1.2], [0.5, 1.0]
    sweep = papers.stick_share_map(belt, mu=frictions, ratios=ratios, t1=300.0, y0=(0.1, 0.0), steady=True)
    found = sweep.run(progress=False).steady_share_mean
    make = {"square": papers.square_wave_belt, "harmonic": papers.harmonic_belt}[belt]
    for mu, ratio in itertools.product(frictions, ratios):
        one = ss.simulate(*make(ratio, mu)[:2], 300.0, (0.1, 0.0))
        last = 300.0 - math.pi / ratio
        sticks = [(a, b) for a, b in zip(one.sticks.start, one.sticks.end, strict=True) if b > last]
        expected = sum(float(b) - max(float(a), last) for a, b in sticks) * ratio / math.pi
        assert float(found.sel(mu=mu, r=ratio)) == pytest.approx(expected, abs=1e-10)
    if belt == "square":
        shares = [papers.steady_stick_share(ratio, mu, (0.1, 0.0)) for mu in frictions for ratio in ratios]
        assert found.values.ravel() == pytest.approx(np.array(shares), abs=1e-3)


def test_belts_without_a_period():
    with pytest.raises(ValueError, match="Argument steady must be False for a belt without a period"):
        papers.stick_share_map("random", steady=True)


@pytest.mark.slow
def test_share_has_a_derivative(share):
    value, slope = jax.jit(jax.value_and_grad(papers.steady_stick_share))(1.1)
    step = 1e-5
    shares = share(jnp.array([1.1 - step, 1.1 + step]))
    assert value == pytest.approx(0.2585, abs=1e-4)
    # Central difference: truncation about step^2 = 1e-10, round-off about 1e-13 / step = 1e-8.
    assert slope == pytest.approx(float(shares[1] - shares[0]) / (2 * step), abs=1e-6)


def test_numbers_of_the_conference_paper():
    system, law, t1, y0 = papers.square_wave_belt(1.25)
    assert (system.mass, system.stiffness, system.normal_force, system.friction.mu) == (1.0, 4.0, 1.0, 1.0)
    assert isinstance(law, ss.SquareWave)
    assert law.speed == 1.0
    # r = f_b / (omega / 2 pi) with omega = 2 rad/s
    assert float(law.period) == pytest.approx(2 * math.pi / (1.25 * 2))
    assert (t1, y0) == (200.0, (0.0, 1.0))


def test_random_belt_has_both_starts():
    setup = papers.random_belt(0.5)
    assert isinstance(setup.law, ss.RandomSteps)
    assert setup.law.levels == (-1.0, 1.0)
    assert float(setup.law.interval) == pytest.approx(2 * math.pi)
    assert setup.y0 == (0.0, 0.0)
    assert papers.random_belt(0.5, y0=(0.0, 1.0)).y0 == (0.0, 1.0)


@pytest.mark.slow
def test_set_ups_run():
    setup = papers.square_wave_belt(1.2)
    one = jax.jit(lambda base: ss.simulate(setup.system, base, t1=setup.t1, y0=setup.y0))(
        setup.law.sample(None, setup.t1)
    )
    assert int(one.status) == ss.Status.FINISHED
    assert 0.3 < float(one.stick_fraction) < 0.4


def test_motor_cart_without_a_friction_coefficient(annotations_unchecked):
    with pytest.raises(ValueError, match=r"\AArgument mu must be zero or positive, but None was given"):
        papers.motor_cart(None)


@pytest.mark.parametrize("ratio", [0.0, -1.0, math.nan, "1"])
@pytest.mark.parametrize("make", [papers.square_wave_belt, papers.random_belt, papers.steady_stick_share])
def test_bad_ratios(make, ratio, annotations_unchecked):
    with pytest.raises(ValueError, match="Argument ratio must be"):
        make(ratio)


@pytest.mark.parametrize("periods", [0, 1.5, True])
def test_bad_numbers_of_periods(periods, annotations_unchecked):
    with pytest.raises(ValueError, match="Argument periods must be a whole number of at least 1"):
        papers.steady_stick_share(1.0, periods=periods)


@pytest.mark.slow
def test_constant_belt_holds_the_mass_until_the_spring_wins():
    """It starts at the belt's speed in the middle, sticks for mu n / (k v), and never again (physics: tangent slip)."""
    found = papers.stick_share_map("constant").run(progress=False)
    expected = found.mu.values * 1.0 / (4.0 * 1.0) / 200.0
    assert found.stick_fraction.dims == ("mu",)
    assert found.stick_fraction.values == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
def test_square_belt_sticks_as_in_the_figure():
    """What is added from 1000 to 1025 periods of r = 1 (pi s each) is whole periods of r = 0.8, 1.0 and 1.2 too."""
    times = [1000 * math.pi, 1025 * math.pi]
    totals = [
        t1 * papers.stick_share_map("square", mu=[1.0], ratios=[0.8, 1.0, 1.2], t1=t1).run(progress=False)
        .stick_fraction.sel(mu=1.0)
        for t1 in times
    ]  # fmt: skip
    shares = 100 * (totals[1] - totals[0]) / (times[1] - times[0])
    assert shares.values == pytest.approx([TABLE[0.8], TABLE[1.0], TABLE[1.2]], abs=0.02)


@pytest.mark.slow
def test_harmonic_belt_in_resonance_carries_the_mass():
    """At r = 1 the belt moves as the free mass would, which starts with its velocity: friction has nothing to do."""
    found = papers.stick_share_map("harmonic", mu=[0.1, 1.0], ratios=[1.0]).run(progress=False)
    assert found.stick_fraction.values == pytest.approx(np.ones((2, 1)), abs=1e-12)


def test_sweeps_are_of_the_papers_systems(annotations_unchecked):
    random = papers.stick_share_map("random", mu=[1.0], ratios=[0.5], samples=10).plan.setting_at(0)
    assert (random.system, random.law) == papers.random_belt(0.5)[:2]
    harmonic = papers.stick_share_map("harmonic", mu=[1.0], ratios=[0.5]).plan.setting_at(0)
    assert float(harmonic.law.angular_frequency) == pytest.approx(0.5 * 2)
    analysis = papers.parametric_analysis()
    assert (analysis.points, analysis.plan.samples, analysis.plan.t1) == (64, 10_000, 200.0)
    assert analysis.plan.points.values(63) == pytest.approx((2.0, 5.0))
    with pytest.raises(ValueError, match=r"Argument belt must be one of 'constant', .*, but 'triangular' was given"):
        papers.stick_share_map("triangular")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mu", "ratio", "holds"),
    [(1.0, 1.2, True), (0.5, 1.2, False), (0.3, 1.1, False), (0.4, 1.1, True), (2.9, 2.0, False)],
)
def test_harmonic_belt_sticks_for_ever_where_friction_can_hold_the_mass(mu, ratio, holds):
    """The force that a stick needs has the amplitude ``m v0 omega |r - 1/r|`` = 2 N |r - 1/r| once it is centred."""
    assert (mu >= 2 * abs(ratio - 1 / ratio)) == holds
    setup = papers.harmonic_belt(ratio, mu)
    one = ss.simulate(setup.system, setup.law, t1=setup.t1, y0=setup.y0)
    last = int(one.sticks.count) - 1
    for_ever = int(one.sticks.ending[last]) == ss.Ending.HORIZON and float(one.sticks.duration[last]) > setup.t1 / 2
    assert for_ever == holds


@pytest.mark.parametrize("make", [papers.constant_belt, lambda mu: papers.square_wave_belt(1.0, mu),
                                  lambda mu: papers.random_belt(1.0, mu=mu), papers.belt_oscillator])  # fmt: skip
def test_friction_of_the_set_ups_is_free(make, annotations_unchecked):
    found = make(0.3)
    assert getattr(found, "system", found).friction.mu == 0.3
    with pytest.raises(ValueError, match="Argument mu must be"):
        make(-1.0)
