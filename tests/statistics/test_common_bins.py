"""Histograms and entropies in bins that several ensembles share."""

import jax
import numpy as np
import pytest

import stickslip_jax as ss


@pytest.fixture(scope="module")
def ensembles():
    def run(mu):
        system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu))
        law, key = ss.PoissonSwitching(1.0, 1.5), jax.random.key(1)
        return ss.simulate_ensemble(system, law, t1=30.0, samples=400, key=key, keep="sticks")

    return [run(mu) for mu in (0.4, 1.0, 2.0)]


@pytest.mark.parametrize("bins", [1, 7, 50])
def test_counts_are_those_of_the_sticks(ensembles, bins):
    durations = [one.statistics.duration for one in ensembles]
    common = ss.common_bins(durations, bins)
    assert bins / 2 <= len(common.edges) - 1 <= bins
    for one, of in zip(ensembles, durations, strict=True):
        expected, _ = np.histogram(one.numbered_sticks().duration, common.edges)
        histogram = of.histogram(common)
        np.testing.assert_array_equal(histogram.counts, expected)
        np.testing.assert_array_equal(histogram.edges, common.edges)
        share = expected[expected > 0] / expected.sum()
        bias = -(len(share) - 1) / (2 * expected.sum())
        assert of.entropy(common).value == pytest.approx(-np.sum(share * np.log(share)) - bias, rel=1e-12, abs=1e-15)


def test_without_values_all_bins_are_empty(ensembles):
    none = ss.simulate_ensemble(
        ensembles[0].system, ensembles[0].law, t1=30.0, samples=2, key=jax.random.key(1), y0=(50.0, 0.0), keep="sticks"
    ).statistics.duration
    assert none.number == 0
    common = ss.common_bins([none, ensembles[0].statistics.duration])
    assert not np.any(none.histogram(common).counts)
    with pytest.raises(ValueError, match=r"distributions must have a value among them, but all of them are empty"):
        ss.common_bins([none])


@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_input(ensembles):
    few, many = (ensembles[number].statistics.duration for number in (0, 2))
    with pytest.raises(ValueError, match=r"bins must hold all values of stick duration, from .* with common_bins"):
        many.histogram(ss.common_bins([few]))
    with pytest.raises(ValueError, match=r"distributions must be a list of distributions in one unit"):
        ss.common_bins([few, ensembles[0].statistics.stick_count])
    with pytest.raises(ValueError, match=r"distributions must be a list of distributions"):
        ss.common_bins(ensembles)
    with pytest.raises(ValueError, match=r"bins must be a whole number of at least 1, but 0 was given"):
        ss.common_bins([few], 0)
