"""What is reported of a motion and of the same motion in a mirror; of a cart also half a turn on."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import stickslip_jax as ss

SPRING = (1.3, 2.0, 1.5, ss.Coulomb(0.4, 0.5), 0.3)
BELT = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(0.8))
JUMPS, SPEEDS = np.array([0.0, 1.1, 2.7, 4.0]), np.array([0.5, -0.3, 0.8, -0.5])
MOTOR = ss.MotorCart(mu=0.5)
# A set-up with its start, the same in a mirror, what that does to positions (None: half a turn) and to forces.
MIRRORS = {
    "mass": (
        (ss.MassSpring(*SPRING, ss.Harmonic(1.0, 0.7, 0.2, 0.1)), ss.Harmonic(1.0, 1.1, 0.3, 0.2), (0.7, 0.4)),
        (ss.MassSpring(*SPRING, ss.Harmonic(-1.0, 0.7, 0.2, -0.1)), ss.Harmonic(-1.0, 1.1, 0.3, -0.2), (-0.7, -0.4)),
        -1, -1, 20.0,
    ),
    "belt": (
        (BELT, ss.PiecewiseConstant(JUMPS, SPEEDS), (0.1, 0.3)),
        (BELT, ss.PiecewiseConstant(JUMPS, -SPEEDS), (-0.1, -0.3)),
        -1, -1, 8.0,
    ),
    "reversed voltage": (
        (MOTOR, ss.SourceVoltage(1.0, 0.5, 10.0, 0.4), (0.7, 5.0, 0.1)),
        (MOTOR, ss.SourceVoltage(-1.0, -0.5, 10.0, 0.4), (-0.7, -5.0, -0.1)),
        -1, 1, 1.0,
    ),
    "half a turn": (
        (MOTOR, ss.SourceVoltage(1.0, 0.5, 10.0, 0.4), (0.7, 5.0, 0.1)),
        (MOTOR, ss.SourceVoltage(1.0, 0.5, 10.0, 0.4), (0.7 + math.pi, 5.0, 0.1)),
        None, -1, 1.0,
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", MIRRORS)
def test_symmetries(name):
    """Sticks, friction force, energies and the stick band."""
    (system, base, y0), (other_system, other_base, other_y0), place, force, t1 = MIRRORS[name]
    one, other = ss.simulate(system, base, t1=t1, y0=y0), ss.simulate(other_system, other_base, t1=t1, y0=other_y0)
    times = np.linspace(0, t1, 101)
    mask = np.asarray(one.sticks.mask)
    assert mask.sum() >= 2
    np.testing.assert_array_equal(np.asarray(other.sticks.mask), mask)
    for column in ("start", "end", "ending"):
        found, same = (np.asarray(getattr(each.sticks, column))[mask] for each in (other, one))
        assert_allclose(found, same, rtol=0, atol=1e-9)
    position, turned = (np.asarray(each.sticks.position)[mask] for each in (one, other))
    assert_allclose(turned, position + math.pi if place is None else place * position, rtol=0, atol=1e-9)
    way, other_way = (np.asarray(each.sticks.slip_displacement)[mask] for each in (one, other))
    assert_allclose(other_way, way * (place or 1), rtol=0, atol=1e-9)
    assert_allclose(other.friction_force(times), force * np.asarray(one.friction_force(times)), rtol=0, atol=1e-7)
    for part, same in zip(other.energies(times)[:3], one.energies(times)[:3], strict=True):
        for term, values in part.items():
            assert_allclose(values, same[term], rtol=0, atol=1e-9, err_msg=term)
    bands = []
    for each in (one, other):
        state = tuple(map(jnp.asarray, each.evaluate(times)))
        none = jnp.zeros_like(state[0])
        bands.append(each.system.look.stick_band(jnp.asarray(times), state, none, none, 0.0))
    (low, high), (other_low, other_high) = bands
    if place == -1:
        other_low, other_high = -other_high, -other_low
    assert_allclose(other_low, low, rtol=0, atol=1e-8)
    assert_allclose(other_high, high, rtol=0, atol=1e-8)
