"""Figures of calibrations."""

import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax import plot

TIMES = np.linspace(0, 12, 121)


@pytest.fixture(scope="module")
def found():
    base, system = ss.Constant(50.0), ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.7))
    clean = np.array(ss.simulate(system, base, t1=12.0, y0=(0.3, 0.1)).evaluate(TIMES)[0])
    seen = clean + 0.01 * np.random.default_rng(0).normal(size=len(TIMES))
    seen[10] = np.nan
    return ss.calibrate(system, base, TIMES, {"position": seen}, wrt="mu", windows=2)


@pytest.mark.slow
def test_motion_of_each_window_and_residuals(found):
    upper, lower = plot.calibration(found)
    dots, *lines = upper.lines
    there = np.isfinite(found.measured[0])
    np.testing.assert_array_equal(dots.get_xdata(), found.times[there])
    np.testing.assert_array_equal(dots.get_ydata(), found.measured[0, there])
    assert len(lines) == found.windows == 2
    drawn = np.concatenate([line.get_ydata() for line in lines])
    np.testing.assert_array_equal(drawn, found.fitted[0, there])
    assert lines[1].get_xdata()[0] == found.start_times[1]
    np.testing.assert_allclose(lower.lines[0].get_ydata(), found.residuals[0, there] / found.noise["position"])
    assert upper.get_ylabel() == "position (m)"
    assert lower.get_xlabel() == "time $t$ (s)"


@pytest.mark.slow
def test_a_part_of_the_record(found):
    upper, _ = plot.calibration(found, channel="position", window=(3.0, 5.0))
    times = upper.lines[0].get_xdata()
    assert times[0] >= 3.0
    assert times[-1] <= 5.0
    assert upper.get_xlim() == (3.0, 5.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"channel": "velocity"}, "Argument channel must be one of 'position'"),
        ({"window": (3.0, 1.0)}, "Argument window must be"),
        ({"axes": ()}, "Argument axes must hold two matplotlib Axes"),
    ],
)
def test_bad_input(found, changed, message):
    with pytest.raises(ValueError, match=message):
        plot.calibration(found, **changed)
