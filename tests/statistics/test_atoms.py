"""Atoms of a joint distribution: points with a probability of their own are found with their shares."""

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._statistics.distribution import atoms_of


@pytest.mark.parametrize("noise", [0.0, 1e-13])
def test_points_that_repeat_are_found(noise):
    numbers = np.random.default_rng(0)
    x, y = numbers.uniform(-1, 1, (2, 10_000))
    place = numbers.permutation(10_000)
    for at, (px, py) in zip((place[:3000], place[3000:3500]), ((0.25, 0.5), (0.25, -0.5)), strict=True):
        x[at], y[at] = (p + noise * numbers.normal(size=len(at)) for p in (px, py))
    found = atoms_of(x, y, (1e-12, 1e-12))
    assert found.share == pytest.approx([0.3, 0.05])
    assert found.x == pytest.approx([0.25, 0.25])
    assert found.y == pytest.approx([0.5, -0.5])
    assert set(np.flatnonzero(found.of_pair)) == set(place[:3500])


def test_a_line_of_points_is_no_atom():
    """One value that repeats beside another that does not: a line, which has no atoms."""
    y = np.random.default_rng(1).uniform(0, 1, 5000)
    assert len(atoms_of(np.full(5000, 2.0), y, (0.0, 0.0)).share) == 0
    assert len(atoms_of(y, y, (0.0, 0.0)).share) == 0


def test_few_pairs_have_no_atoms():
    assert len(atoms_of(np.ones(10), np.ones(10), (0.0, 0.0)).share) == 0
    assert len(atoms_of(np.ones(11), np.ones(11), (0.0, 0.0)).share) == 1
    assert len(atoms_of(np.zeros(0), np.zeros(0), (0.0, 0.0)).share) == 0


@pytest.mark.slow
def test_atoms_of_the_switching_belt():
    """They come from the fixed start: on a belt that begins the other way the mass meets it at x = 0 again.

    In the plane of omega x and x' it moves on a circle about -omega a, a = 0.25 m, from (0, v) to (0, -v), which takes
    2 atan(v / (omega a)) / omega, and sticks for a / v: so do half of the samples whose belt does not turn by then.
    """
    system = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
    many = ss.simulate_ensemble(
        system, ss.PoissonSwitching(1.0, 1.0), t1=100.0, samples=1000, key=jax.random.key(0), y0=(0.0, 1.0)
    )
    joint = many.statistics.joint("duration", "position")
    atoms = joint.atoms
    position, duration = joint.y.values[atoms.of_pair], joint.x.values[atoms.of_pair]
    assert len(atoms.share) > 0
    assert duration[np.abs(position) < 1e-9] == pytest.approx(0.25)
    chance = np.exp(-(np.arctan(2.0) + 0.25)) / 2
    share, numbered = many.statistics.duration.repeated_share, many.statistics.duration.number / 1000
    assert abs(share.value - chance / numbered) < 4 * share.standard_error
    anywhere = (ss.Uniform(-0.5, 0.5), ss.Uniform(-1.0, 1.0))
    other = ss.simulate_ensemble(
        system, ss.PoissonSwitching(1.0, 1.0), t1=100.0, samples=1000, key=jax.random.key(0), y0=anywhere
    )
    assert other.statistics.duration.repeated_share.value == 0
    # Both repeat at an atom, so its pairs are not more than those of which one does.
    assert atoms.share.sum() <= many.statistics.duration.repeated_share.value + 1e-12
    assert atoms.of_pair.mean() == pytest.approx(atoms.share.sum())
    # Histogram and atoms: what is left of the density is that of the other pairs.
    drawn = joint.histogram(16)
    left = drawn.counts * (1 - joint.share_of_atoms(16))
    assert left.sum() == pytest.approx(np.sum(~atoms.of_pair))


def test_values_that_are_close_by_chance_are_no_atom():
    """In float32, with more values than rounding can tell apart, neighbours are all within round-off of each other."""
    numbers = np.random.default_rng(2)
    x, y = numbers.uniform(0, 1, (2, 200_000))
    assert len(atoms_of(x, y, (1e-4, 1e-4)).share) == 0
    x[:20_000], y[:20_000] = 0.25, 0.5
    found = atoms_of(x, y, (1e-4, 1e-4))
    assert found.share == pytest.approx([0.1], rel=1e-4)
    assert (found.x[0], found.y[0]) == pytest.approx((0.25, 0.5), abs=2e-4)
