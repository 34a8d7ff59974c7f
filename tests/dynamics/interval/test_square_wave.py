"""Stick share of a steady period under a square-wave base: the exact values behind Lima and Sampaio's figures."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.interval import SQUARE_WAVE_SHARES

import stickslip_jax as ss

OMEGA = 2.0
PERIODS = 400


@pytest.fixture(scope="module")
def table():
    """All ratios side by side: the period, the last simulation, stick time one and two periods before its end."""

    def simulate(ratio):
        period = 2 * jnp.pi / (ratio * OMEGA)
        base = ss.SquareWave(speed=1.0, period=period).sample(None, PERIODS * period, capacity=2 * PERIODS + 1)
        system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
        runs = [
            ss.simulate(system, base, t1=count * period, y0=(0.0, 1.0)) for count in (PERIODS - 2, PERIODS - 1, PERIODS)
        ]
        return period, [run.stick_time for run in runs], runs[-1].sticks, runs[-1].status

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(simulate))(jnp.asarray(list(SQUARE_WAVE_SHARES))))


@pytest.mark.slow
def test_all_lanes_finish(table):
    assert table[3].tolist() == [ss.Status.FINISHED] * len(SQUARE_WAVE_SHARES)


@pytest.mark.slow
def test_share_of_the_last_period(table):
    """0.02 percentage points: the table's rounding (0.005) and what a slowly settling orbit still lacks."""
    period, (_, before, total), *_ = table
    shares = dict(zip(SQUARE_WAVE_SHARES, (100 * (total - before) / period).tolist(), strict=True))
    assert shares == pytest.approx(SQUARE_WAVE_SHARES, abs=0.02)


@pytest.mark.slow
def test_share_from_the_recorded_sticks(table):
    """The same share, from start and end of the sticks that fall into the last period."""
    period, (_, before, total), sticks, _ = table
    first = (PERIODS - 1) * period[:, None]
    inside = np.where(sticks.mask, np.maximum(sticks.end - np.maximum(sticks.start, first), 0), 0).sum(axis=1)
    # Instants near t1 = 400 periods carry a round-off of 1e-13 of a period.
    assert inside == pytest.approx(total - before, abs=1e-10)


@pytest.mark.slow
def test_the_last_periods_are_alike(table):
    """What is measured is a steady state: the last two periods hold the same stick share."""
    period, (two_before, before, total), *_ = table
    assert np.max(np.abs((total - before) - (before - two_before)) / period) < 2e-4
