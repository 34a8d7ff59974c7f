"""A mass without a spring: what is infinite, what every method makes of it, ensembles and derivatives of means."""

import math
import warnings

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax._excitation.excitation import excitation_of

BLOCK = ss.MassSpring(mass=1.0, stiffness=0.0, normal_force=1.0, friction=ss.Coulomb(0.5))
LAW = ss.PoissonSwitching(speed=1.0, rate=1.0)
RUN = {"t1": 20.0, "key": jax.random.key(2), "y0": (0.0, 0.3)}
TONE = ss.Harmonic(0.3, 2.0)


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-5, 1e-7])
def test_pulses_far_shorter_than_a_step(width):
    """A triangular pulse with the velocity v at rest before it: the release on its rise, and the way until the stop."""
    v, holds = 0.2, 0.5
    slope = v / width**2
    late = width - holds / slope  # from the release to the peak
    way, speed = slope * late**3 / 6, slope * late**2 / 2
    start = slope * width - holds  # of what accelerates the block at the peak
    way = way + speed * width + start * width**2 / 2 - slope * width**3 / 6
    speed = speed + start * width - slope * width**2 / 2
    pulse = ss.GroundAcceleration([0.0, 1.0, 1.0 + width, 1.0 + 2 * width, 6.0], [0.0, 0.0, v / width, 0.0, 0.0])
    one = ss.simulate(BLOCK, pulse, t1=6.0, method=ss.Exact(max_steps=768))
    # The points of the record are exact to their last digits, 2.2e-16 s.
    rel = max(1e-9, 4e-16 / width)
    assert float(one.final_state[0]) == pytest.approx(-way - speed**2 / (2 * holds), rel=rel)
    assert float(one.sticks.end[0]) == pytest.approx(1.0 + holds / slope, abs=1e-15)
    assert int(one.near_grazing_count) == 0


def test_what_is_infinite():
    assert BLOCK.stick_half_width == math.inf
    assert BLOCK.natural_frequency is None
    assert BLOCK.look.slip_center is None
    assert float(BLOCK.angular_frequency) == 0
    assert all(np.isfinite(float(scale)) for scale in BLOCK.sizes(excitation_of(ss.Constant(0.0)))[:2])
    with pytest.raises(ValueError, match="Argument stiffness must "):
        ss.MassSpring(1.0, -1.0, 1.0, ss.Coulomb(0.5))


@pytest.mark.parametrize("name", ["r", "w"])
def test_ratios_to_the_natural_frequency_are_refused(name):
    law = ss.SquareWave(1.0, 2.0) if name == "r" else LAW
    with pytest.raises(ValueError, match="natural frequency"):
        ss.Sweep(BLOCK, law, over={name: [0.5, 1.0]}, t1=10.0, samples=2, key=jax.random.key(0))


def mean(value: ss.Estimate) -> float:
    return float(value.value)


@pytest.mark.slow
def test_ensembles_of_both_exact_engines_agree():
    one = ss.simulate_ensemble(BLOCK, LAW, samples=64, keep="sticks", **RUN)
    other = ss.simulate_ensemble(BLOCK, LAW, samples=64, keep="sticks", method=ss.Exact(step=0.5), **RUN)
    for statistic in (ss.mean_stick_count, ss.stick_fraction, ss.mean_stick_duration, ss.mean_slip_duration):
        assert mean(statistic(one)) == pytest.approx(mean(statistic(other)), rel=1e-11)
    assert mean(ss.mean_stick_count(one)) > 3


@pytest.mark.slow
@pytest.mark.parametrize("step", [pytest.param(None, marks=pytest.mark.slow), 1e-3])
def test_smoothed_friction_comes_near(step):
    exact = ss.simulate_ensemble(BLOCK, LAW, samples=64, **RUN)
    smooth = ss.simulate_ensemble(BLOCK, LAW, samples=64, method=ss.Regularized(1e-5, step=step), **RUN)
    assert smooth.status_counts[ss.Status.FINISHED] == 64
    assert mean(ss.stick_fraction(smooth)) == pytest.approx(mean(ss.stick_fraction(exact)), rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("method", [ss.Exact(), pytest.param(ss.Exact(step=0.2), marks=pytest.mark.slow)])
def test_some_samples_without_a_spring(method):
    """An array with zeros, and each sample as alone."""
    springs = np.array([0.0, 1.0, 0.0, 4.0])
    system = ss.MassSpring(1.0, springs, 1.0, ss.Coulomb(0.5))
    many = ss.simulate_ensemble(system, LAW, samples=4, method=method, **RUN)
    times = []
    for i in range(4):
        own, base, y0 = many.realization(i)
        assert float(own.stiffness) == springs[i]
        times.append(float(ss.simulate(own, base, t1=20.0, y0=y0, method=method).stick_time))
    assert mean(ss.stick_fraction(many)) == pytest.approx(np.mean(times) / 20.0, rel=1e-10)


@pytest.mark.slow
def test_a_start_on_the_base_is_a_stick_from_the_first_instant():
    """For every stiffness, to the last bit: it is the initial rest, which is not counted."""
    system = ss.MassSpring(1.0, ss.LogNormal(median=4.0, log_std=0.1), 1.0, ss.Coulomb(1.0))
    many = ss.simulate_ensemble(system, LAW, t1=5.0, samples=300, key=jax.random.key(0), y0=(0.0, 1.0), keep="sticks")
    starts = np.asarray(many.sticks.start)[np.asarray(many.sticks.mask)]
    assert np.sum(starts == 0) > 100
    assert np.min(starts[starts > 0]) > 1e-9


@pytest.mark.slow
def test_steps_of_a_traced_stiffness_that_is_zero():
    def final(stiffness):
        system = ss.MassSpring(1.0, stiffness, 1.0, ss.Coulomb(0.5), damping=0.1)
        return ss.simulate(system, TONE, t1=10.0, method=ss.Exact(max_steps=600)).final_state[0]

    value, slope = jax.jit(jax.value_and_grad(final))(0.0)
    ahead = final(1e-6)
    assert float(slope) == pytest.approx(float((ahead - value) / 1e-6), rel=1e-4)


@pytest.mark.slow
def test_the_derivative_of_a_mean_by_friction():
    """The corrected derivative against a difference with the same base motions."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # few sticks vanish: there is no crossing without a spring
        found = ss.sensitivity(ss.stick_fraction, BLOCK, LAW, wrt="mu", samples=4096, **RUN)
    ends = [
        mean(ss.stick_fraction(ss.simulate_ensemble(
            ss.MassSpring(1.0, 0.0, 1.0, ss.Coulomb(mu)), LAW, samples=4096, keep="totals", **RUN)))
        for mu in (0.49, 0.51)
    ]  # fmt: skip
    assert float(found.derivative) == pytest.approx((ends[1] - ends[0]) / 0.02, rel=0.02)


@pytest.mark.slow
def test_harmonic_forces_push_a_free_mass():
    """Without friction: ``x'' = F cos(w t + phase)``."""
    force = ss.Harmonic(2.0, 3.0, 0.4, offset=0.1)
    free = ss.MassSpring(2.0, 0.0, 1.0, ss.Coulomb(0.0), force=force)
    one = ss.simulate(free, ss.Constant(0.0), t1=5.0, y0=(0.2, 0.3))
    w, gain, drift = 3.0, 1.0 / 9.0, 0.3 + math.sin(0.4) * -1.0 / 3.0
    exact = 0.2 + gain * (math.cos(0.4) - math.cos(w * 5 + 0.4)) + drift * 5 + 0.025 * 25
    assert float(one.final_state[0]) == pytest.approx(exact, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "base", ["steps", *(pytest.param(base, marks=pytest.mark.slow) for base in ("tone", "ground"))]
)
def test_figures(base):
    """Without warnings; there is no stick band to draw."""
    motions = {
        "steps": LAW.sample(jax.random.key(0), 20.0),
        "tone": TONE,
        "ground": ss.GroundAcceleration(np.array([0.0, 1.0, 2.0, 20.0]), np.array([0.0, 4.0, 0.0, 0.0])),
    }
    one = ss.simulate(BLOCK, motions[base], t1=20.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for draw in (plot.phase_portrait, plot.time_history, plot.energies):
            draw(one)
            plt.gcf().canvas.draw()
            plt.close("all")
    with pytest.raises(ValueError, match="Argument abscissa must be 'position' for"):
        plot.phase_portrait(one, abscissa="position_times_omega")
    assert jnp.all(jnp.isfinite(one.evaluate(jnp.linspace(0.0, 20.0, 50))[0]))


@pytest.mark.slow
@pytest.mark.parametrize("method", [ss.Exact(), ss.Exact(step=0.3), ss.Exact(step=0.77)])
@pytest.mark.parametrize("stiffness", [0.0, 1e-20, 1e-12])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_turning_points_of_a_parabola(method, stiffness, way):
    """Friction turns the mass round at v^2 / (2 mu g), far from the belt's velocity; and derivatives of that place."""

    def turns_at(numbers):
        mu, speed = numbers
        system = ss.MassSpring(1.0, stiffness, 1.0, ss.Coulomb(mu))
        one = ss.simulate(system, ss.Constant(-5.0 * way), t1=6.0, y0=(0.0, way * speed), method=method)
        return one.maximum("position") if way > 0 else -one.minimum("position")

    for speed in (1.0, 1.1, 1.3, 1.37):
        found, (by_mu, by_speed) = jax.value_and_grad(turns_at)(jnp.array([0.5, speed]))
        np.testing.assert_allclose(found, speed**2, rtol=1e-11)
        np.testing.assert_allclose([by_mu, by_speed], [-2 * speed**2, 2 * speed], rtol=1e-9)
