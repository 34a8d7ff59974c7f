"""Offsets and delays of channels and of a record's clock, as numbers to fit, and what is said where they are needed."""

import warnings

import numpy as np
import pytest

import stickslip_jax as ss

TIMES, NOISE = np.linspace(0, 20, 401), 0.003
BASE = ss.SquareWave(0.5, 5.0)
SYSTEM, GUESS = (ss.MassSpring(1.0, k, 1.0, ss.Coulomb(mu)) for mu, k in ((0.7, 4.0), (0.6, 3.6)))
BOTH = ("mu", "stiffness")


@pytest.fixture(scope="module")
def motion():
    return ss.simulate(SYSTEM, BASE, t1=20.0, y0=(0.3, 0.1))


def shown(motion, clock=0.0, number=0, delay=0.0, offset=0.0, seed=0):
    """Times by a late clock, and a coordinate by a late sensor whose zero is elsewhere, with noise."""
    times = TIMES[clock + delay <= TIMES]
    clean = np.asarray(motion.evaluate(times - clock - delay)[number])
    return times, clean + offset + NOISE * np.random.default_rng(seed).normal(size=len(times))


def fit(times, measured, wrt, **options):
    """The calibration, and all that it warned of."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        found = ss.calibrate(GUESS, BASE, times, measured, wrt=wrt, **options)
    return found, " ".join(found.remarks)


def assert_found(found, **truth):
    for name, value in truth.items():
        one = found[name.replace("__", ".")]
        assert abs(one.value - value) < 4 * one.standard_error < 0.02


@pytest.mark.slow
def test_a_late_clock(motion):
    """Numbers far outside of all their errors, until the delay is searched too; in windows as well."""
    times, seen = shown(motion, clock=0.1)
    off, said = fit(times, {"position": seen}, BOTH)
    for name, true, error in zip(BOTH, (0.7, 4.0), np.sqrt(np.diag(off.covariance_by_blocks)), strict=True):
        assert abs(off[name].value - true) > 4 * max(error, off[name].standard_error)
    assert "First of all the model, a clock, a zero or a unit may be wrong" in said
    assert "clock.delay, about 0.1" in said
    for windows in (None, 4):
        found, said = fit(times, {"position": seen}, (*BOTH, "clock.delay"), windows=windows)
        assert not said
        assert_found(found, mu=0.7, clock__delay=0.1)
        # The variance of a frequency goes with the third power of the time in which the phase is its own: four windows
        # of a quarter, each of which begins in a state of its own, tell at least 4 / 4^3 of what the whole tells.
        if windows is None:
            assert_found(found, stiffness=4.0)
            whole = found["stiffness"].standard_error
        assert abs(found["stiffness"].value - 4.0) < 4 * found["stiffness"].standard_error < 4 * 4 * whole
        assert found["clock.delay"].unit == "s"
        # The longest delay is left out at both ends: a quarter of the period by the first guess, 2 pi / sqrt(3.6).
        kept, longest = times[np.isfinite(found.residuals[0])], np.pi / 2 / np.sqrt(3.6)
        np.testing.assert_allclose(kept[[0, -1]], [0.1 + longest, 20 - longest], atol=0.06)


@pytest.mark.slow
def test_a_sensor_whose_zero_is_elsewhere(motion):
    times, seen = shown(motion, offset=0.02)
    _, said = fit(times, {"position": seen}, BOTH)
    assert "position.offset, about 0.02 m, would lower chi-squared" in said
    found, said = fit(times, {"position": seen}, (*BOTH, "position.offset"))
    assert not said
    assert_found(found, mu=0.7, stiffness=4.0, position__offset=0.02)
    assert found["position.offset"].unit == "m"
    assert np.all(np.isfinite(found.residuals))


@pytest.mark.slow
def test_one_late_channel_of_two(motion):
    times, position = shown(motion, delay=0.05)
    velocity = shown(motion, number=1, seed=1)[1][-len(times) :]
    found, said = fit(times, {"position": position, "velocity": velocity}, (*BOTH, "position.delay"))
    assert not said
    assert_found(found, mu=0.7, stiffness=4.0, position__delay=0.05)


@pytest.mark.slow
def test_millimetres_for_metres(motion):
    times, seen = shown(motion)
    _, said = fit(times, {"position": 1000 * seen}, "mu", noise={"position": 1000 * NOISE})
    assert "What was measured of position scatters by 2.7e+02 m, the motion with the first guesses by 0.2" in said
    assert "First of all the model, a clock, a zero or a unit may be wrong" in said


@pytest.mark.parametrize(
    ("wrt", "times", "message"),
    [
        (("clock.delay", "clock.delay"), TIMES, "Argument wrt must be a parameter's name or several different ones"),
        (("clock.delay", "position.delay"), TIMES, "Argument wrt must leave one channel without a delay of its own"),
        ("clock.delay", np.array([0.0, 0.5, 19.5, 20.0]), "Argument times must hold measurements more than"),
        (("velocity.offset", "mu"), TIMES, "Argument wrt must name one of"),
    ],
)
def test_bad_input(wrt, times, message):
    with pytest.raises(ValueError, match=message):
        ss.calibrate(GUESS, BASE, times, {"position": np.sin(times)}, wrt=wrt)
