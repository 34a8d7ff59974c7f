"""Rigid blocks that slide on a shaken ground: closed forms, and the functions that compare recorded earthquakes."""

import math

import jax
import numpy as np
import pytest
from scipy.optimize import brentq
from support.scripts import loaded

import stickslip_jax as ss

LARGEST, DURATION, SHARES = 6.0, 0.3, (0.1, 0.4, 0.9)  # of the rectangular pulse; yields as shares of the largest
LIMIT = 1 / math.sqrt(1 + math.pi**2 / 4)  # 0.5370


@pytest.fixture(scope="module")
def blocks():
    """The script that prints what ``docs/validation.md`` says."""
    return loaded("docs/validation_blocks.py")


def earthquakes():
    """Times of a record every 0.02 s, and accelerations (2, points) that stand for recorded ones."""
    times = 0.02 * np.arange(401)
    source = np.random.default_rng(1)
    tones = source.normal(size=(2, 1, 12)) * np.sin(times[:, None] * source.uniform(3, 40, 12) + np.arange(12))
    return times, np.sum(tones, axis=2) * np.exp(-(((times - 3) / 2) ** 2))


@pytest.fixture(scope="module")
def slid(blocks):
    """Times, accelerations, yields, pulls, and positions by the package: rectangular pulses, and the earthquakes.

    Each earthquake on a slope with two yields, and on level ground with both.
    """
    regular, shaking = earthquakes()
    edges = np.array([1.0, 1.0 + DURATION])
    times = np.union1d(regular, np.concatenate([edges - 1e-12, edges + 1e-12]))
    pulse = np.where((times > edges[0]) & (times < edges[1]), LARGEST, 0.0)
    ground = np.array([pulse] * 3 + [np.interp(times, regular, a) for a in shaking for _ in range(4)])
    yields = np.array([*(share * LARGEST for share in SHARES), *np.tile([0.5, 2.0], 4)])
    pulls = np.array([*[blocks.PULL] * 3, *np.tile([blocks.PULL, blocks.PULL, 0.0, 0.0], 2)])
    return times, ground, yields, pulls, blocks.slide(times, ground, yields, pulls)


@pytest.mark.slow
def test_a_rectangular_pulse_moves_the_block_as_far_as_newmark_says(slid):
    """``V^2 / (2 a_y) (1 - a_y / A)``, the pulse of the acceleration A and the velocity V (Newmark 1965)."""
    shares = np.array(SHARES)
    expected = (LARGEST * DURATION) ** 2 / (2 * shares * LARGEST) * (1 - shares)
    np.testing.assert_allclose(slid[-1][:3, -1], expected, rtol=2e-11)


@pytest.mark.slow
def test_the_package_and_the_events_agree(blocks, slid):
    """At all times of the records; one-way on a slope, both ways on level ground."""
    for time, ground, above, pull, positions in zip([slid[0]] * 11, *slid[1:], strict=True):
        expected = blocks.slide_by_events(time, ground, above, math.inf if pull else above)
        np.testing.assert_allclose(positions, expected, rtol=0, atol=1e-11)
        backward = np.min(np.diff(expected)) < 0
        assert backward == (pull == 0)
        assert np.max(np.abs(expected)) > 1e-3


@pytest.mark.slow
def test_the_trapezoidal_rule_comes_to_the_same_in_short_steps(blocks, slid):
    regular, shaking = earthquakes()
    one_way = [3, 4, 7, 8]
    ours, yields = slid[-1][one_way, -1], slid[2][one_way]
    found = [blocks.slide_by_steps(regular, np.repeat(shaking, 2, axis=0), yields, parts) for parts in (1, 8, 64)]
    errors = np.max(np.abs(np.array(found) - ours), axis=1)
    assert errors[2] < errors[1] / 8 < errors[0] / 64


@pytest.mark.slow
@pytest.mark.parametrize("share", SHARES)
def test_a_mass_without_a_spring_slides_on_a_base_as_newmark_says(share):
    """The pulse as a base that is accelerated to a velocity, with exact edges: how far the block lags behind."""
    speed = LARGEST * DURATION
    base = ss.VelocitySegments(np.array([DURATION, 30.0]), np.array([0.0, speed]), np.array([LARGEST, 0.0]))
    one = ss.simulate(ss.MassSpring(2.0, 0.0, 2.0, ss.Coulomb(share * LARGEST)), base, t1=20.0)
    lag = LARGEST * DURATION**2 / 2 + speed * (20.0 - DURATION) - float(one.final_state[0])
    assert lag == pytest.approx(speed**2 / (2 * share * LARGEST) * (1 - share), rel=1e-12, abs=1e-12)
    # It slides from the first instant until it has the velocity of the base.
    assert float(one.sticks.start[np.asarray(one.sticks.mask)][-1]) == pytest.approx(DURATION / share, rel=1e-12)


@pytest.mark.slow
def test_a_slope_of_a_mass_without_a_spring():
    """Other limits up the slope and down: a constant force; `Block` is the same without a `MassSpring`."""
    w, g, share = 2 * math.pi, 9.81, 0.3
    ground = ss.Harmonic(-g / w, w, 0.0, offset=g / w)
    pull, above = 2.0, g * share
    force = ss.Harmonic(0.0, 1.0, offset=-pull)
    block = ss.MassSpring(1.0, 0.0, above + pull, ss.Coulomb(1.0), force=force)
    other = ss.simulate(Block(above, pull), ground, t1=3.0, y0=(0.0, 0.0), method=ss.Exact(step=0.01))
    one = ss.simulate(block, ground, t1=3.0, method=ss.Exact(step=0.01))
    travel = 3 * g / w  # of the base, in three periods
    assert float(one.final_state[0]) - travel == pytest.approx(float(other.final_state[0]), rel=1e-10)
    assert int(one.sticks.count) == int(other.sticks.count) > 3


class Block(ss.SwitchedSystem):
    """A rigid block on a slope, without a spring; the base moves up the slope."""

    above: float  # m/s^2, above which the block slides down
    pull: float  # m/s^2, of gravity down the slope

    @property
    def state_names(self):
        return "displacement up the slope in m", "velocity in m/s"

    def rates(self, t, y, base, friction):
        return y[1] - base.velocity, -self.pull - friction * (self.above + self.pull)

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity


@jax.jit
def on_harmonic_ground(block, base, t1, step):
    """Displacement down the slope, m, and the number of sticks in the second half."""
    one = ss.simulate(block, base, t1=t1, y0=(0.0, 0.0), method=ss.Exact(step=step, max_steps=1500))
    return -one.final_state[0], (one.sticks.mask & (one.sticks.start > t1 / 2)).sum()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "published"), [(0.6, 0.19590274524997664), (0.1, 1.182179210060007), (0.8, 0.0466650990262433)]
)
def test_one_cycle_of_a_sine_as_the_closed_form_of_pyslammer(share, published):
    """Of 1 Hz and 9.81 m/s^2. `published` is what ``find_harmonic_solution(1, share)`` of pySLAMMER returns.

    The block starts where the sine is `share`, and stops where the areas above and below have become equal.
    """
    w, g = 2 * math.pi, 9.81
    start = math.asin(share) / w
    relative = lambda t: g / w * (math.cos(w * start) - math.cos(w * t)) - g * share * (t - start)  # noqa: E731
    stop = brentq(relative, 0.25, 1, xtol=1e-15)
    area = g / w * (math.cos(w * start) * (stop - start) - (math.sin(w * stop) - share) / w)
    expected = area - g * share * (stop - start) ** 2 / 2
    assert expected == pytest.approx(published, rel=1e-12)
    displacement, _ = on_harmonic_ground(Block(g * share, g), ss.Harmonic(-g / w, w, 0.0, offset=g / w), 1.0, 0.01)
    assert float(displacement) == pytest.approx(expected, rel=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "sticks"), [(LIMIT - 1e-5, 0), (LIMIT + 1e-5, 20)])
def test_a_block_on_a_harmonic_ground_never_rests_below_the_known_friction(share, sticks):
    """``mu g / A = 1 / sqrt(1 + pi^2 / 4)``: Den Hartog's limit of motion without stops, where there is no spring.

    While the block slides all the time, its velocity is a triangle of the height ``mu g pi / (2 w)``. Where it meets
    that of the ground, ``A / w sin(p)``, the acceleration of the ground, ``A cos(p)``, is ``mu g`` at the limit.
    Above it the block rests twice a period; of 20 periods, the last 10 count.
    """
    ground = ss.Harmonic(1.0, 1.0, -math.pi / 2, offset=0.0)  # velocity sin t: w = A = 1
    _, late = on_harmonic_ground(Block(share, 0.0), ground, 40 * math.pi, 0.1)
    assert int(late) == sticks
