"""Basins of attraction: published labels, several attractors, and what belongs to none."""

import math

import numpy as np
import pytest
from support.scripts import loaded

import stickslip_jax as ss
from stickslip_jax import nonlinear
from stickslip_jax.nonlinear._basins import dense, matched


@pytest.fixture(scope="module")
def case():
    """The belt oscillator of bSTAB and pyBasin, its starts and its published labels."""
    return loaded("docs/validation_basin.py")


@pytest.mark.slow
def test_published_labels_in_one_call(case):
    y0 = case.starts(4000)
    found = nonlinear.basins(
        case.oscillator(), ss.Constant(1.5), y0=y0, transient=80, kept=20, period=5.0, progress=False
    )  # fmt: skip
    assert found.sizes["attractor"] == 2
    at_rest = found.basin.values == 2
    assert case.digest(case.with_others(at_rest, case.OTHERS)) == case.PUBLISHED_LABELS  # 3,999 of 4,000
    assert float(found.share[1]) == at_rest.mean()
    assert float(found.share_low[1]) < case.boundary(1.5).share < float(found.share_high[1])
    # The equilibrium of a steady slip: a point; the stick-slip cycle: it reaches the velocity of the belt.
    rest = found.isel(attractor=1)
    equilibrium = 0.5 + 0.5 * math.exp(-1.5 / 0.5)
    np.testing.assert_allclose(rest.attractor_position.dropna("point"), equilibrium, atol=1e-3)
    assert float(found.isel(attractor=0).attractor_velocity.max()) == pytest.approx(1.5, abs=1e-3)
    assert not np.any(found.is_stuck)


@pytest.mark.slow
def test_grid_of_starts_and_stuck_motions():
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.5))
    grid = {"position": np.linspace(-3, 3, 7), "velocity": np.linspace(-1, 1, 3)}
    found = nonlinear.basins(system, ss.Harmonic(0.05, 0.3), y0=grid, transient=20, kept=8, progress=False)
    assert found.basin.dims == ("position", "velocity")
    assert found.position.attrs["units"] == "m"
    # All come to ride on the base, each at its own place: one attractor.
    np.testing.assert_array_equal(found.basin, 1)
    np.testing.assert_array_equal(found.is_stuck, [True])
    assert float(found.share[0]) == 1
    assert 0.8 < float(found.share_low[0]) < 1


def sizes_of(states):
    return np.max(np.abs(states), axis=1)


class Tipping(ss.SwitchedSystem):
    """Two equilibria at which a mass comes to rest; from far away it leaves for ever."""

    @property
    def state_names(self):
        return ("position in m", "velocity in m/s")

    def rates(self, t, y, base, friction):
        return y[1], 0.5 * y[0] - 0.5 * y[0] ** 3 + y[0] ** 5 / 1e3 - 0.3 * y[1] - 0.01 * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity

    @property
    def shortest_time(self):
        return 6.0


@pytest.mark.slow
def test_motions_that_run_away_do_not_join_the_others():
    y0 = [*[(0.2 * i, 0.3) for i in range(-5, 6)], (40.0, 0.0)]
    settings = {"transient": 30, "kept": 10, "period": 6.0, "progress": False}
    alone = nonlinear.basins(Tipping(), ss.Constant(5.0), y0=y0[:-1], **settings)
    with pytest.warns(RuntimeWarning, match="1 of 12 cases were not followed to the end"):
        both = nonlinear.basins(Tipping(), ss.Constant(5.0), y0=y0, **settings)
    assert alone.sizes["attractor"] == 2
    np.testing.assert_array_equal(both.basin[:-1], alone.basin)
    assert int(both.basin[-1]) == 0


def test_two_orbits_of_a_driven_mass():
    # Without a stick on a fast belt, a spring with two natural periods of the drive: states differ by a whole turn.
    states = np.stack([np.tile([[0.0, 1.0]], (8, 1)), np.tile([[1.0, 0.0]], (8, 1)), np.tile([[0.0, 1.0]], (8, 1))])
    states[2] += 1e-5
    labels, attractors = matched(
        states, sizes_of(states), np.ones(3, int), np.zeros(3, bool), lambda case: states[case], (None, None), 1e-3, 10
    )
    np.testing.assert_array_equal(labels, [0, 1, 0])
    assert len(attractors) == 2


def test_angles_are_near_across_their_end():
    states = np.tile(np.array([6.2829, 0.0004, 3.0])[:, None, None], (1, 8, 1))
    labels, _ = matched(
        states, sizes_of(states), np.ones(3, int), np.zeros(3, bool), lambda i: states[i], (2 * np.pi,), 1e-3, 10
    )
    np.testing.assert_array_equal(labels, [0, 0, 1])


def test_irregular_motions_share_a_region():
    rng = np.random.default_rng(0)
    states = rng.uniform(0, 1, (20, 1000, 2))
    states[10:, :, 0] += 2
    labels, attractors = matched(
        states, sizes_of(states), np.zeros(20, int), np.zeros(20, bool), lambda i: states[i], (None, None), 1e-3, 10
    )
    np.testing.assert_array_equal(labels[:10], labels[0])
    np.testing.assert_array_equal(labels[10:], labels[10])
    assert len(attractors) == 2


def test_one_motion_far_away_does_not_join_the_others():
    """What is near is judged by the range of nearly all of them, and by the size of the usual one."""
    places = np.append(np.repeat([0.0, 1.0], 20), 1e6)
    states = np.tile(places[:, None, None], (1, 4, 1))
    labels, _ = matched(
        states, sizes_of(states), np.ones(41, int), np.zeros(41, bool), lambda i: states[i], (None,), 1e-3, 10
    )
    np.testing.assert_array_equal(labels, np.append(np.repeat([0, 1], 20), 2))


def test_round_off_does_not_part_motions():
    """At rest they differ in their velocities of 1e-17 m/s, but these have been of 1 m/s."""
    states = np.ones((3, 4, 2))
    states[..., 1] = 1e-17 * np.arange(3)[:, None]
    labels, _ = matched(
        states, np.ones((3, 2)), np.ones(3, int), np.zeros(3, bool), lambda i: states[i], (None, None), 1e-3, 10
    )
    np.testing.assert_array_equal(labels, 0)


def test_motions_that_ended_early_belong_to_none():
    states = np.zeros((3, 4, 2))
    states[1, 2:] = np.nan
    labels, _ = matched(
        states, sizes_of(states), np.ones(3, int), np.zeros(3, bool), lambda i: states[i], (None, None), 1e-3, 10
    )
    np.testing.assert_array_equal(labels, [0, -1, 0])
    apart = np.arange(5.0)[:, None, None] * np.ones((5, 4, 2))
    labels, attractors = matched(
        apart, sizes_of(apart), np.ones(5, int), np.zeros(5, bool), lambda i: apart[i], (None, None), 1e-3, 3
    )
    assert len(attractors) == 3
    assert np.sum(labels == -1) == 2


def test_starts_on_no_attractor_are_told():
    # Without friction, damping and force every start has a circle of its own.
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.0))
    with pytest.warns(RuntimeWarning, match="3 of 5 starts belong to none of the 2 attractors"):
        found = nonlinear.basins(
            system, ss.Harmonic(0.0, 1.0), y0={"position": np.arange(5.0)}, transient=1, kept=4, most=2, progress=False
        )
    assert np.sum(found.basin == 0) == 3


@pytest.mark.slow
def test_irregular_motions_are_known_by_their_region():
    # Chaos (test_lyapunov.py): two starts, one attractor.
    system = ss.MassSpring(
        1.0, 1.0, 1.0, ss.VelocityWeakening(1.0, 3.0), damping=1e-3, force=ss.Harmonic(0.6, 1.91)
    )  # fmt: skip
    starts = np.array([[0.0, 0.0], [0.5, 0.1], [-0.3, 0.2]])
    found = nonlinear.basins(system, ss.Constant(0.3), y0=starts, transient=100, kept=32, progress=False)
    np.testing.assert_array_equal(found.basin, 1)
    np.testing.assert_array_equal(found.recurrence, [0])


def test_curves_have_near_neighbours():
    curve = np.stack([np.cos(np.linspace(0, 6, 20)), np.sin(np.linspace(0, 6, 20))], axis=1)
    more = dense(curve, 1e-2)
    assert np.max(np.linalg.norm(np.diff(more, axis=0), axis=1)) < 2e-2
    np.testing.assert_allclose(more[[0, -1]], curve[[0, -1]])


BAD = {
    "no starts": ({"y0": (0.0, 1.0)}, "Argument y0 must be starts"),
    "no such coordinate": ({"y0": {"speed": [0.0]}}, "Argument y0 must have values by the names of coordinates"),
    "no values": ({"y0": {"position": []}}, "Argument y0 must have values of at least one coordinate"),
    "level": ({"level": 1.0}, "Argument level must be below 1"),
    "most": ({"most": 0}, "Argument most must be"),
    "tolerance": ({"tolerance": 0.0}, "Argument tolerance must be positive"),
    "nothing drives it": ({"base": ss.Constant(1.0)}, r"Argument period must be given \(s\)"),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.usefixtures("annotations_unchecked")
def test_bad_input_is_told_in_a_sentence(name):
    given, said = BAD[name]
    system = ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.5))
    usual = {"system": system, "base": ss.Harmonic(1.0, 1.0), "y0": {"position": [0.0]}}
    with pytest.raises(ValueError, match=said):
        nonlinear.basins(**(usual | given), progress=False)
