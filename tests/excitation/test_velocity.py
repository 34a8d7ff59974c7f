"""`base_velocity` of every public motion: against closed forms in numpy, and the base that simulations follow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

import stickslip_jax as ss

T1 = 12.0
TIMES = np.linspace(0.0, T1, 241)
KEY = jax.random.key(4)
SYSTEM = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.5))
POINTS = np.array([0.0, 1.0, 2.5, 6.0, 12.0])
VALUES = np.array([0.1, -0.4, 0.3, 0.3, -0.2])


class Swell:
    """A motion of a user's."""

    def velocity(self, t):
        return jnp.sin(t) * t / 10

    def acceleration(self, t):
        return jnp.cos(t) * t / 10 + jnp.sin(t) / 10


def wave(times):
    """The `SquareWave` with the half period 1.5 s, which begins with what the class says at t = 0."""
    first = float(ss.SquareWave(0.7, 3.0).sample(None, 1.0).velocities[0])
    return first * np.where(np.floor(np.asarray(times) / 1.5) % 2 == 0, 1.0, -1.0)


MOTIONS = {
    "Constant": (ss.Constant(0.3), lambda t: np.full_like(t, 0.3)),
    "SquareWave": (ss.SquareWave(0.7, 3.0), wave),
    "PiecewiseConstant": (
        ss.PiecewiseConstant(POINTS, VALUES),
        lambda t: VALUES[np.searchsorted(POINTS, t, side="right") - 1],
    ),
    "Harmonic": (ss.Harmonic(0.4, 1.1, 0.2, 0.1), lambda t: 0.1 + 0.4 * np.cos(1.1 * t + 0.2)),
    "SumOfHarmonics": (
        ss.SumOfHarmonics([0.4, 0.1], [1.1, 2.3], [0.0, 1.0]),
        lambda t: 0.4 * np.cos(1.1 * t) + 0.1 * np.cos(2.3 * t + 1.0),
    ),
    "Recorded": (ss.Recorded(POINTS, VALUES), lambda t: np.interp(t, POINTS, VALUES)),
    "WithJumps": (
        ss.WithJumps(ss.Harmonic(0.4, 1.1), ss.SquareWave(0.7, 3.0)),
        lambda t: 0.4 * np.cos(1.1 * t) + wave(t),
    ),
    "WithJumps of a record": (
        ss.WithJumps(ss.Recorded(POINTS, VALUES), ss.SquareWave(0.7, 3.0)),
        lambda t: np.interp(t, POINTS, VALUES) + wave(t),
    ),
    "user's": (Swell(), lambda t: np.sin(t) * t / 10),
    "VelocitySegments": (
        ss.VelocitySegments(np.diff(POINTS), VALUES[:-1], np.diff(VALUES) / np.diff(POINTS), may_jump=False),
        lambda t: np.interp(t, POINTS, VALUES),
    ),
}
LAWS = {
    "PoissonSwitching": ss.PoissonSwitching(0.5, 1.0),
    "RandomSteps": ss.RandomSteps(0.5, 1.3),
    "SemiMarkovSwitching": ss.SemiMarkovSwitching(ss.Weibull(1.0, 2.0), ss.Uniform(0.5, 1.5)),
    "GaussianProcess": ss.GaussianProcess(ss.TabulatedSpectrum([0.5, 1.0, 3.0], [0.0, 0.4, 0.0]), cutoff=3.0),
    "RandomPhase": ss.RandomPhase(ss.Harmonic(0.4, 1.1)),
    "WithJumps": ss.WithJumps(ss.RandomPhase(ss.Harmonic(0.4, 1.1)), ss.PoissonSwitching(0.5, 1.0)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTIONS)
def test_closed_forms(name):
    motion, expected = MOTIONS[name]
    off_jumps = TIMES[np.abs((TIMES / 0.75) % 1 - 0.5) < 0.4]  # near a jump round-off decides on which side a time is
    found = ss.base_velocity(motion, off_jumps)
    np.testing.assert_allclose(found, expected(off_jumps), atol=1e-12)
    assert ss.base_velocity(motion, TIMES[:12].reshape(3, 4)).shape == (3, 4)
    assert ss.base_velocity(motion, 0.0).shape == ()
    assert float(ss.base_velocity(motion, 0)) == pytest.approx(expected(np.zeros(1))[0], abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_realisations(name):
    """What simulations follow; of those that jump, by the arrays of the realisation."""
    base = LAWS[name].sample(KEY, T1)
    times = TIMES + 1e-3  # on no jump
    found = np.asarray(ss.base_velocity(base, times[:-1]))
    if isinstance(base, ss.VelocitySteps):
        begins = np.concatenate([[0.0], np.cumsum(base.durations)[:-1]])
        begins = np.where(np.asarray(base.durations) > 0, begins, np.inf)
        here = np.searchsorted(begins, times[:-1], "right") - 1
        np.testing.assert_array_equal(found, np.asarray(base.velocities)[here])
    else:
        signal_of = base.motion if isinstance(base, ss.WithJumps) else base
        expected = np.asarray(jax.vmap(signal_of.value)(jnp.asarray(times[:-1])))
        if isinstance(base, ss.WithJumps):
            expected = expected + np.asarray(base.jumps.velocity(times[:-1]))
        np.testing.assert_allclose(found, expected, atol=1e-12)
    with pytest.raises(ValueError, match=r"must be a realisation, but the random law .*; draw one with base\.sample"):
        ss.base_velocity(LAWS[name], TIMES)


@pytest.mark.slow
def test_it_is_what_simulations_follow():
    base = MOTIONS["WithJumps"][0]
    one = ss.simulate(SYSTEM, base, t1=T1)
    times = TIMES[:-1] + 1e-3
    np.testing.assert_allclose(ss.base_velocity(base, times), one.base_velocity(times), atol=1e-12)


@pytest.mark.slow
def test_at_jumps_and_beyond():
    base = ss.PiecewiseConstant([0.0, 1.0], [0.5, -0.5])
    np.testing.assert_array_equal(ss.base_velocity(base, [0.5, 1.0]), [0.5, -0.5])
    np.testing.assert_array_equal(ss.base_velocity(ss.SquareWave(0.5, 2.0), [1.0]), -wave([0.0]) / 0.7 * 0.5)
    record = ss.Recorded([0.0, 1.0], [0.0, 1.0])
    np.testing.assert_array_equal(ss.base_velocity(record, [-0.1, 0.0, 1.0, 1.1]), [np.nan, 0.0, 1.0, np.nan])


@pytest.mark.slow
def test_under_jax():
    times = jnp.asarray([0.5, 2.0])
    for name in ("Harmonic", "Recorded", "user's", "PiecewiseConstant"):
        motion, expected = MOTIONS[name]
        np.testing.assert_allclose(
            jax.jit(lambda t, m=motion: ss.base_velocity(m, t))(times), expected(times), atol=1e-12
        )
    realized = ss.SquareWave(0.7, 3.0).sample(None, T1)
    np.testing.assert_allclose(jax.jit(lambda t: ss.base_velocity(realized, t))(times), wave(times), atol=1e-12)
    slope = jax.grad(lambda t: ss.base_velocity(MOTIONS["Harmonic"][0], t))(0.7)
    assert float(slope) == pytest.approx(-0.4 * 1.1 * np.sin(1.1 * 0.7 + 0.2), rel=1e-12)
    scaled = jax.grad(lambda a: ss.base_velocity(ss.Recorded(POINTS, a * VALUES), 0.5))(1.0)
    assert float(scaled) == pytest.approx(np.interp(0.5, POINTS, VALUES), rel=1e-12)
    with pytest.raises(ValueError, match=r"the law SquareWave was given; take base\.sample\(None, t1\)"):
        jax.jit(lambda t: ss.base_velocity(ss.SquareWave(0.7, 3.0), t))(times)


@pytest.mark.usefixtures("annotations_unchecked")
@pytest.mark.parametrize(
    ("base", "message"),
    [
        (ss.GroundAcceleration(POINTS, VALUES), "must be a base velocity, but a ground acceleration was given"),
        (ss.SourceVoltage(), "must be a base velocity, but a voltage was given"),
        (lambda t: t, r"Argument base must be a base motion .* make a signal, ss.Signal.of"),
        ("3", "Argument base must be a base motion such as Harmonic"),
    ],
)
def test_bad_input(base, message):
    with pytest.raises(ValueError, match=message):
        ss.base_velocity(base, TIMES)
    with pytest.raises(ValueError, match="Argument times must be real numbers"):
        ss.base_velocity(ss.Constant(1.0), "now")


def test_the_reference_is_a_square_wave():
    np.testing.assert_array_equal(np.abs(wave(TIMES)), 0.7)
    inside = TIMES[np.abs((TIMES / 1.5) % 1 - 0.5) < 0.4]
    np.testing.assert_allclose(wave(inside), wave([0.0])[0] * signal.square(2 * np.pi * inside / 3.0), atol=1e-12)
