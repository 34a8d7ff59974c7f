"""The test for white residuals, against its known distribution."""

import numpy as np
from scipy import stats

from stickslip_jax._calibration.record import whiteness


def test_p_values_of_white_noise_are_uniform():
    rng = np.random.default_rng(0)
    found = [whiteness("x", rng.normal(size=500)).p_value for _ in range(400)]
    assert stats.kstest(found, "uniform").pvalue > 0.01


def test_residuals_that_go_on_are_found_and_gaps_left_out():
    rng = np.random.default_rng(2)
    noise = rng.normal(size=400)
    noise[1:] += 0.8 * noise[:-1]
    test = whiteness("x", noise)
    assert test.p_value < 1e-6
    assert 0.35 < test.effect < 0.6
    with_gaps = np.full(500, np.nan)
    with_gaps[:400] = noise
    assert whiteness("x", with_gaps) == test
    few = whiteness("x", noise[:10])
    assert not few.made
    assert "fewer than 20" in few.reason
