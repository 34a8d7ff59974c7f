"""The train of Burridge and Knopoff: the functions that compare catalogues of a thousand blocks, with few of them."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.scripts import loaded


@pytest.fixture(scope="module")
def train():
    """The script that prints what ``docs/validation.md`` says."""
    return loaded("docs/validation_train.py")


def test_slips_that_overlap_are_events(train):
    """Of neighbours, or of one that is between; far apart they are two, as one after the other."""
    slips = [
        (0.0, 1.0, 4, 0.1), (0.5, 2.0, 5, 0.2), (1.5, 3.0, 6, 0.3), (0.7, 0.9, 9, 0.4), (3.5, 4.0, 6, 0.5),
        (5.0, 5.1, 1, 0.1), (5.05, 5.3, 2, 0.1), (5.2, 5.4, 1, 0.1),
    ]  # fmt: skip
    begin, size, moment = train.events_of(slips)
    np.testing.assert_array_equal(begin, [0.0, 0.7, 3.5, 5.0])
    np.testing.assert_array_equal(size, [3, 1, 1, 2])
    np.testing.assert_allclose(moment, [0.6, 0.4, 0.5, 0.3], rtol=1e-12)


def test_the_slope_between_two_moments(train):
    """Moments at even shares of a law that is cut off: its slope, and none of those beyond."""
    b, least, most = 0.8, 1e-3, 0.1
    share = (np.arange(20000) + 0.5) / 20000
    moments = least * (1 - share * (1 - (most / least) ** -b)) ** (-1 / b)
    found, error, number = train.slope_between(np.concatenate([moments, [5e-4, 0.2, 3.0]]), least, most)
    assert number == 20000
    np.testing.assert_allclose(found, b, rtol=1e-4)
    # As the scatter of slopes of random moments of this law.
    moments = np.random.default_rng(0).choice(moments, (400, 500))
    scatter = np.std([train.slope_between(each, least, most)[0] for each in moments])
    np.testing.assert_allclose(scatter, error * (20000 / 500) ** 0.5, rtol=0.15)


def of_one_block(train):
    """The moment of a slip between neighbours that stick: the smallest there is, by an event-driven integration."""

    def rates(t, y):
        load = 1 + train.SPEED * t - (2 * train.STIFF**2 + 1) * y[0]
        return y[1], load - train.weakened(y[1])

    def stops(t, y):
        return y[1] if t > 1e-3 else 1.0

    stops.terminal, stops.direction = True, -1
    return solve_ivp(rates, (0, 1), (0, 0), "DOP853", events=stops, rtol=1e-12, atol=1e-16).y[0, -1]


def test_the_smallest_events_in_fixed_steps(train):
    (_, size, moment), positions = train.by_steps(train.starts(12), 30.0)
    smallest = of_one_block(train)
    assert np.sum(size == 1) > 5
    np.testing.assert_allclose(moment[size == 1].min(), smallest, rtol=1e-3)
    assert positions.shape == (12,)


@pytest.mark.slow
def test_the_package_and_fixed_steps_find_the_same_first_events(train):
    """Until small differences have grown: motions are chaotic."""
    _, positions = train.by_steps(train.starts(20), 50.0)
    ours, theirs = train.simulated(positions, 40.0), train.by_steps(positions, 40.0)[0]
    assert train.alike(ours, theirs) >= 20
    assert train.alike(ours, ours) == len(ours[0])
    _, size, moment = ours
    np.testing.assert_allclose(moment[size == 1].min(), of_one_block(train), rtol=1e-7)
