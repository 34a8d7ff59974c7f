"""Base speeds at which the mean number of sticks has no derivative: why, how it shows, and that a warning says so."""

import math

import jax
import pytest

import stickslip_jax as ss


def oscillator(w):
    """Omega = 2 rad/s; at base speed 1 m/s the dimensionless speed is w."""
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(4 / (2 * w)))


@pytest.mark.parametrize("k", [2, 4])
def test_farthest_point_of_the_circle_leads_to_the_edge(k):
    """A mass at rest at ``z = 1 + w``, the farthest point of the circle on which it left a stick; the base reverses.

    It comes to the base velocity at ``z = 2 sqrt(1 + w) - 1``, that is 2 k - 1 at w = k^2 - 1. Each crossing takes 2
    off, so that it comes in the end to the edge at which sticks are released, for k = 2 with the first crossing. At a
    slightly smaller w a short stick begins there; at a greater one it crosses, and has its stick a revolution later.
    """
    starts = []
    for w in (k * k - 1 - 1e-4, k * k - 1 + 1e-4):
        half_width = 1 / (2 * w)
        one = ss.simulate(oscillator(w), ss.Constant(-1.0), t1=30.0, y0=((1 + w) * half_width, 0.0))
        assert int(one.sticks.count) == 1
        assert float(one.sticks.position[0]) / half_width == pytest.approx(-1, abs=1e-4)
        assert float(one.sticks.duration[0]) < 1e-4
        starts.append(float(one.sticks.start[0]))
    assert starts[1] - starts[0] == pytest.approx(math.pi, abs=1e-2)


@pytest.mark.slow
def test_slope_of_the_count_grows_as_steps_shrink():
    """At w = 3 by one over the square root of the step: 30 times shorter, 30**0.5 = 5.5 times steeper in the limit."""
    law, slopes = ss.PoissonSwitching(3.0, 0.5), []
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(1.0))
    for step in (0.03, 0.001):
        slopes.append(
            ss.sensitivity(
                ss.mean_stick_count, system, law, wrt="mu", t1=400.0, samples=100_000, key=jax.random.key(0),
                y0=(0.0, 0.5), estimator="finite-difference", step=step,
            )
        )  # fmt: skip
    assert slopes[0].derivative == pytest.approx(67.6, abs=4 * slopes[0].standard_error + 0.05)
    assert slopes[1].derivative == pytest.approx(214, abs=4 * slopes[1].standard_error + 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("w", [pytest.param(1.0, marks=pytest.mark.slow), 2.0, 3.0])
def test_special_base_speeds_are_told(w):
    """The slope of the mean count depends on the step there; that by the rate exists."""
    a = 1 / (2 * w)
    y0 = (ss.Uniform(-a - 0.3, a + 0.3), ss.Uniform(-0.9, 0.9))
    options = {"t1": 20.0, "samples": 2_048, "key": jax.random.key(0), "y0": y0}
    system, law = oscillator(w), ss.PoissonSwitching(1.0, 1.0)
    with pytest.warns(RuntimeWarning, match=f"w = .* is exactly {w:g}, .* with respect to speed, mu: its slope"):
        ss.sensitivity(ss.mean_stick_count, system, law, wrt=("speed", "rate", "mu"), **options)
    ss.sensitivity(ss.mean_stick_count, system, law, wrt="rate", **options)
