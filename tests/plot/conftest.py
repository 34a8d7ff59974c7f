"""What the tests of figures share: ensembles, and no figure that outlives its test."""

import matplotlib as mpl
import pytest

mpl.use("Agg")

import matplotlib.pyplot as plt
from support.plot import simulate


@pytest.fixture(autouse=True)
def close_figures():
    """No figure outlives its test, and none is made where axes are given."""
    plt.close("all")
    yield
    plt.close("all")


@pytest.fixture(scope="session")
def many():
    return simulate(200)


@pytest.fixture(scope="session")
def single():
    return simulate(1)


@pytest.fixture(scope="session")
def none():
    """On a base so fast that the mass never comes up to it."""
    slipping = simulate(3, speed=50.0)
    assert slipping.statistics.duration.number == 0
    return slipping
