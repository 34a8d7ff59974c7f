"""The friction oscillator of the siconos tutorials: from 12 m and 6 m/s to its rest, exactly, by both engines."""

import math

import numpy as np
import pytest

import stickslip_jax as ss

PUBLISHED = {0.43: 13.31777943672665, 100.0: 0.682044}
"""Times (s) and positions of their reference, by time steps of 0.01 s: the largest, and the rest."""


@pytest.mark.parametrize("method", [ss.Exact(), ss.Exact(step=0.1)], ids=["intervals", "steps"])
def test_rest_of_the_friction_oscillator(method):
    """Half circles about -1 and 1, each turn 2 nearer: turns at ``sqrt(205) - 1 - 2 i``, rest at ``15 - sqrt(205)``."""
    system = ss.MassSpring(mass=1.0, stiffness=1.0, normal_force=1.0, friction=ss.Coulomb(1.0))
    one = ss.simulate(system, ss.Constant(0.0), t1=100.0, y0=(12.0, 6.0), method=method)
    first = math.atan2(6, 13)  # the angle to the first turn
    turns = first + math.pi * np.arange(8)
    radius = math.sqrt(205)
    expected = (-1.0) ** np.arange(8) * (radius - 1 - 2 * np.arange(8))
    positions, velocities = (np.asarray(values) for values in one.evaluate(turns))
    np.testing.assert_allclose(positions, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(velocities, 0, atol=1e-12)
    assert float(one.final_state[0]) == pytest.approx(15 - radius, abs=1e-13)
    assert int(one.sticks.count) == 1
    assert float(one.sticks.start[0]) == pytest.approx(turns[-1], abs=1e-12)
    for time, position in PUBLISHED.items():
        assert float(one.evaluate(time)[0]) == pytest.approx(position, abs=2e-4)  # their step is 0.01 s
