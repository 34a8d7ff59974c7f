"""The sensitivity of a single stick: that of the first one's mean duration, found from recorded sequences of sticks."""

import math

import jax
import numpy as np
import pytest

import stickslip_jax as ss

MU, LAW, FIRST = 4 / 2.8, ss.PoissonSwitching(1.0, 2.0), ss.StickDuration(1, count_initial_rest=True)
HALF = 1 / 2.8 + 0.3  # starts lie on and beyond the stick band
RUN = {"t1": 12.0, "y0": (ss.Uniform(-HALF, HALF), ss.Uniform(-0.9, 0.9))}
AGREE = 4.0  # combined standard errors: passed by chance once in 16,000 independent comparisons


def system(mu):
    return ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(mu))


@pytest.fixture(scope="module")
def first_duration():
    """Mean duration of the first stick, corrected."""
    return ss.sensitivity(
        FIRST, system(MU), LAW, wrt="mu", samples=4_096, key=jax.random.key(11), estimator="corrected", **RUN
    )


@pytest.mark.slow
def test_first_duration(first_duration):
    differences = ss.sensitivity(
        FIRST, system(MU), LAW, wrt="mu", samples=16_384, key=jax.random.key(12), step=0.01,
        estimator="finite-difference", **RUN,
    )  # fmt: skip
    error = math.hypot(first_duration.standard_error, differences.standard_error)
    assert abs(first_duration.derivative - differences.derivative) < AGREE * error
    assert math.isnan(differences.pathwise)


def first_sticks(samples, seed, mu=MU):
    many = ss.simulate_ensemble(system(mu), LAW, samples=samples, key=jax.random.key(seed), keep="sticks", **RUN)
    return ss.first_stick(many, count_initial_rest=True)


@pytest.mark.slow
def test_first_duration_between_ensembles(first_duration):
    """Differences of two ensembles with common random numbers, which compile nothing of the sensitivities."""
    step, samples, values, parts = 0.01, 16_384, [], []
    for change in (-step, step):
        first = first_sticks(samples, 12, MU * (1 + change))
        values.append(first.duration[first.mask].mean())
        # What each sample adds to the mean's error; the same numbers at both ends, so that most of it cancels.
        parts.append(np.where(first.mask, first.duration - values[-1], 0) / first.mask.mean())
    width = 2 * step * MU
    slope, error = np.diff(values)[0] / width, np.std(parts[1] - parts[0]) / math.sqrt(samples) / width
    assert abs(first_duration.derivative - slope) < AGREE * math.hypot(first_duration.standard_error, error)
    assert first_duration.sticks_in_window > 100
    assert first_duration.relative_bandwidth > 0


@pytest.mark.slow
def test_values_are_those_of_the_ensemble(first_duration):
    """The statistic itself comes from the same samples as `simulate_ensemble`'s."""
    first = first_sticks(4_096, 11)
    assert first_duration.value == pytest.approx(first.duration[first.mask].mean(), rel=1e-12)
