"""The periodic stick-slip example of nosnoc (Dieci and Lopez 2009, example 6.1): its orbit, against scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stickslip_jax as ss

# nosnoc's examples/periodic_slip_stick/periodic_slip_stick_codim1.m: belt, initial state, horizon.
BELT, START, HORIZON = 0.2, (-0.8, -1.0), 40.0


def slip(y0, below, t1=HORIZON):
    """The path of a mass that starts from `y0` `below` or above the belt's velocity, until it meets it, by scipy."""

    def meets(t, y):
        return y[1] - BELT

    def field(t, y):
        return y[1], -y[0] + (1 / (1.2 - y[1]) if below else -1 / (0.8 + y[1]))

    meets.terminal, meets.direction = True, 1 if below else -1
    return solve_ivp(field, (0, t1), y0, "DOP853", rtol=1e-13, atol=1e-14, max_step=0.02, events=meets)


@pytest.fixture(scope="module")
def expected():
    """Starts, ends and positions of the sticks up to the horizon, and the state there."""
    first = slip(START, below=True)
    crossing = first.y[0, -1]
    assert crossing < -1  # the spring pulls with more than the largest friction force: no stick
    second = slip((crossing, BELT), below=False)
    periodic = slip((1.0, BELT), below=True)  # after every stick: it ends where the spring pulls with 1
    starts, positions = [first.t[-1] + second.t[-1]], [second.y[0, -1]]
    ends = [starts[0] + (1 - positions[0]) / BELT]
    while ends[-1] + periodic.t[-1] < HORIZON:
        starts.append(ends[-1] + periodic.t[-1])
        positions.append(periodic.y[0, -1])
        ends.append(starts[-1] + (1 - positions[-1]) / BELT)
    return starts, ends, positions, slip((1.0, BELT), below=True, t1=HORIZON - ends[-1]).y[:, -1]


def test_sticks_and_slips_are_those_of_scipy(expected):
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.VelocityWeakening(mu_static=1.0, weakening=1.0))
    one = ss.simulate(system, ss.Constant(BELT), t1=HORIZON, y0=START)
    sticks, mask = one.sticks, np.asarray(one.sticks.mask)
    found = [np.asarray(values)[mask] for values in (sticks.start, sticks.end, sticks.position)]
    np.testing.assert_allclose(found, expected[:3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.final_state, expected[3], rtol=0, atol=1e-9)
    assert [ss.Ending(code) for code in np.asarray(sticks.ending)[mask]] == [ss.Ending.RELEASED] * 4
    # What docs/validation.md says.
    start, end, position = found
    np.testing.assert_allclose(np.diff(start)[1:], 9.230770458082, rtol=0, atol=1e-10)
    np.testing.assert_allclose(start[1:] - end[:-1], 4.703364997942, rtol=0, atol=1e-10)
    np.testing.assert_allclose(position[1:], 0.094518907972, rtol=0, atol=1e-10)
