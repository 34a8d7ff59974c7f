"""Histograms and entropies of whole numbers: every number has a bin of its own, however many numbers there are."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import StepPatch
from scipy import stats
from support.statistics import statistics_of, sticks_from

import stickslip_jax as ss
from stickslip_jax._numerics.sums import DyadicCounts, PowerSums
from stickslip_jax._statistics.distribution import BINS, Clusters, Distribution


@pytest.fixture(scope="module")
def made():
    """Samples of up to 149 sticks each, and the numbers of the sticks."""
    numbers = np.random.default_rng(8).integers(0, 150, 300)
    return numbers, statistics_of(
        sticks_from(
            [[(k + 0.2, k + 0.5, 0.0, 0) for k in range(n)] for n in numbers],
        ),
        200.0,
    )


def entropy_of(counts):
    """By scipy, and what Miller (1955) adds for few values."""
    return stats.entropy(counts) + (np.count_nonzero(counts) - 1) / (2 * np.sum(counts))


def test_entropy_is_that_of_the_numbers(made):
    numbers, statistics = made
    _, counts = np.unique(numbers, return_counts=True)
    assert statistics.stick_count.entropy().value == pytest.approx(entropy_of(counts), rel=1e-12)
    assert str(statistics.stick_count.entropy()).startswith("entropy of number of sticks: ")
    # One bin after the other, of so many numbers as asked for, is still to be had, and says so.
    joined = np.histogram(numbers, np.arange(0, 153, 3))[0]
    assert statistics.stick_count.entropy(50).value == pytest.approx(entropy_of(joined), rel=1e-12)
    assert statistics.stick_count.entropy(50).name.startswith("entropy of the histogram in 50 bins of 3 numbers each")


def test_histogram_counts_every_number(made):
    numbers, statistics = made
    histogram = statistics.stick_count.histogram()
    np.testing.assert_array_equal(histogram.counts, np.bincount(numbers)[numbers.min() :])
    np.testing.assert_array_equal(histogram.edges[:-1], np.arange(numbers.min(), numbers.max() + 1))
    assert len(statistics.duration.histogram().counts) <= 50  # others are as they were


def test_bins_in_common(made):
    _, statistics = made
    few = statistics_of(sticks_from([[(1.0, 2.0, 0.0, 0)]] * 5))
    bins = ss.common_bins([statistics.stick_count, few.stick_count])
    np.testing.assert_array_equal(np.diff(bins.edges), 1)
    assert statistics.stick_count.entropy(bins).value == statistics.stick_count.entropy().value
    assert few.stick_count.entropy(bins).value == 0


def test_summary_labelled_arrays_and_figures_do_the_same(made):
    numbers, statistics = made
    value = entropy_of(np.unique(numbers, return_counts=True)[1])
    assert f"{value:.4g}" in str(statistics)
    data = statistics.to_xarray()
    np.testing.assert_array_equal(data.stick_count_count_in_bin, np.bincount(numbers)[numbers.min() :])
    ax = ss.plot.histogram(statistics.stick_count)
    edges = next(patch for patch in ax.patches if isinstance(patch, StepPatch)).get_data().edges
    np.testing.assert_array_equal(edges, np.arange(numbers.min(), numbers.max() + 2) - 0.5)
    plt.close("all")


def test_numbers_beyond_the_bins_share_them():
    """Of more than 8192 numbers, two share a bin, and the name of the entropy says so."""
    numbers = np.random.default_rng(9).integers(0, 16_000, 2000).astype(float)
    numbers[:2] = 0, 15_999
    bins, own = DyadicCounts.of(numbers, BINS, finest=0), Clusters(numbers, np.arange(2000), 2000, 2000)
    of = Distribution("number", "1", 2000, PowerSums.of(numbers), bins, own, is_whole=True)
    _, counts = np.unique(numbers // 2, return_counts=True)
    assert of.entropy().value == pytest.approx(entropy_of(counts), rel=1e-12)
    assert of.entropy().name == "entropy of the histogram in 8000 bins of 2 numbers each of number"
