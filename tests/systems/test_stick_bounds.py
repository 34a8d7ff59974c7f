"""The longest possible stick of a motor, by its definition: how long friction holds the steady current at a time."""

import math

import jax
import numpy as np
import pytest

import stickslip_jax as ss

VOLTAGES = {
    "positive mean": (1.0, 0.5),
    "negative mean": (-1.0, 0.5),
    "negative amplitude": (1.0, -0.5),
    "no mean": (0.0, 2.0),
    "to both sides, more to the positive": (0.3, 2.0),
    "to both sides, more to the negative": (-0.3, 2.0),
    "constant": (-1.0, 0.0),
    "none": (0.0, 0.0),
}


def longest_hold(system, voltage, angle):
    """The longest run of samples of two periods of the steady current that friction holds, s."""
    number = 200_000
    r, reactance = system.resistance, system.inductance * voltage.angular_frequency
    turns = np.linspace(0, 4 * math.pi, 2 * number, endpoint=False)
    current = voltage.mean / r + voltage.amplitude / math.hypot(r, reactance) * np.sin(turns)
    most = system.mu * system.cart_mass * system.gravity * system.eccentricity * abs(math.sin(angle))
    holds = (np.abs(system.motor_constant * current) <= most) & (most > 0)
    if holds.all():
        return math.inf
    changes = np.flatnonzero(np.diff(np.concatenate([[0], holds, [0]])))
    return max(changes[1::2] - changes[::2], default=0) * 2 * math.pi / number / voltage.angular_frequency


@pytest.mark.slow
@pytest.mark.parametrize("name", VOLTAGES)
def test_by_its_definition(name):
    """The paper's own case is the first: one window about the lowest current."""
    voltage = ss.SourceVoltage(*VOLTAGES[name], 10.0)
    angles = np.array([-2.0, 0.0, 0.05, 0.3, 0.7, 1.2, math.pi / 2, 1.9, 3.5, 4.6, 6.0])
    for mu in (0.0, 0.1, 0.3, 0.5, 1.2):
        system = ss.MotorCart(mu=mu)
        exact = [longest_hold(system, voltage, angle) for angle in angles]
        np.testing.assert_allclose(ss.stick_duration_bound(system, voltage, angles), exact, rtol=0, atol=1e-5)


def test_reversing_the_current_changes_nothing():
    """Friction holds both ways: 0.508278 s at the paper's own numbers. A current that swings through the band, from one
    limit to the other, is held for the time of one passage.
    """
    system = ss.MotorCart(mu=0.5)
    for voltage in (ss.SourceVoltage(), ss.SourceVoltage(-1.0), ss.SourceVoltage(-1.0, -0.5)):
        assert float(ss.stick_duration_bound(system, voltage, math.pi / 2)) == pytest.approx(0.508278, abs=1e-6)
    swing = ss.SourceVoltage(0.0, 5.0, 10.0)
    r, most = system.resistance, 0.5 * 5 * 9.81 * 0.01 / 0.0533
    passage = 2 * math.asin(most / (5.0 / math.hypot(r, 1.88e-3))) / 10
    assert float(ss.stick_duration_bound(system, swing, math.pi / 2)) == pytest.approx(passage, rel=1e-12)


@pytest.mark.slow
def test_sticks_keep_to_it():
    """A current that swings to both sides: sticks outlast the bound by the transient that they begin with at most."""
    system, swing = ss.MotorCart(mu=0.3), ss.SourceVoltage(-0.2, 1.5, 10.0)
    many = ss.simulate_ensemble(
        system, ss.RandomPhase(swing), t1=1.0, samples=64, key=jax.random.key(0),
        y0=(ss.Uniform(0.0, 2 * math.pi), 0.0, 0.0), keep="sticks", progress=False,
    )  # fmt: skip
    start, duration, position, ending = (
        np.asarray(getattr(many.sticks, name)) for name in ("start", "duration", "position", "ending")
    )
    complete = (ending == ss.Ending.RELEASED) & (start > 0)
    excess = duration[complete] - np.asarray(ss.stick_duration_bound(system, swing, position[complete]))
    transient = system.inductance / system.resistance
    assert len(excess) > 100
    assert excess.max() < 10 * transient
    assert (duration[complete] > transient).any()
