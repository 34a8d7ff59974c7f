"""Springs so soft that the closed form loses the motion: a warning says so, and an integration does not."""

import diffrax
import jax
import numpy as np
import pytest

import stickslip_jax as ss

GROUND = ss.GroundAcceleration(np.array([0.0, 1.0, 2.0, 20.0]), np.array([0.0, 4.0, 0.0, 0.0]))
INTEGRATED = ss.Exact(step=0.1, solver=diffrax.Dopri8())


def block(stiffness, damping=None):
    return ss.MassSpring(1.0, stiffness, 1.0, ss.Coulomb(1.0), damping=damping)


def final(system, base=GROUND, method=INTEGRATED):
    return float(ss.simulate(system, base, t1=20.0, method=method).final_state[0])


def test_an_integration_has_the_motion_without_a_spring():
    """It slides from 1 m/s^2 of the ground on, until friction has stopped it (Newmark 1965)."""
    times = np.linspace(0.25, 6, 2_000_001)
    rate = np.interp(times, GROUND.times, GROUND.accelerations) - 1
    speed = np.concatenate([[0], np.cumsum((rate[1:] + rate[:-1]) / 2) * (times[1] - times[0])])
    stop = np.argmax(speed[1:] < 0) + 1
    travel = np.trapezoid(speed[:stop], times[:stop])
    assert final(block(1e-14)) == pytest.approx(-travel, rel=1e-9)


@pytest.mark.parametrize("base", [GROUND, ss.SquareWave(1.0, 2.0)])
def test_closed_form_warns(base):
    with pytest.warns(
        RuntimeWarning, match=r"The natural period, 6\.28e\+06 s, is so long beside t1 = 20 s that the closed form"
    ):
        ss.simulate(block(1e-12), base, t1=20.0)


def test_an_ensemble_warns():
    with pytest.warns(RuntimeWarning, match="is so long beside t1"):
        ss.simulate_ensemble(block(1e-12), ss.PoissonSwitching(1.0, 1.0), t1=5.0, samples=3, key=jax.random.key(0))


def test_softness_that_costs_no_digits_does_not_warn():
    assert final(block(1e-8), method=ss.Exact()) == pytest.approx(final(block(1e-8)), rel=1e-7)
