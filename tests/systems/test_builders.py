"""Structures built from few numbers: their matrices by hand, their frequencies in closed form, and a motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

DRY = ss.Coulomb(0.4, 0.5)


def test_frequencies_of_a_row():
    """``m w^2 = to_ground + 4 between sin^2(pi j / (2 n))``, j = 0 ... n - 1: a row with free ends."""
    row = ss.block_row(7, mass=2.0, between=3.0, to_ground=0.5, normal_force=1.0, friction=DRY)
    squared = np.linalg.eigvalsh(row.stiffness) / 2.0
    expected = (0.5 + 12.0 * np.sin(np.pi * np.arange(7) / 14) ** 2) / 2.0
    np.testing.assert_allclose(squared, expected, rtol=1e-12)
    assert (row.size, len(row.contacts), row.uncoupled, row.damping) == (7, 7, True, None)
    damped = ss.block_row(2, mass=2.0, between=3.0, to_ground=0.5, normal_force=1.0, friction=DRY, damping=0.1)
    np.testing.assert_array_equal(damped.damping, [0.1, 0.1])


@pytest.mark.slow
def test_a_row_has_derivatives():
    def end(between):
        row = ss.block_row(3, mass=1.0, between=between, to_ground=0.5, normal_force=1.0, friction=DRY)
        method = ss.Exact(max_steps=1024)
        return ss.simulate(row, ss.Constant(0.1), t1=6.0, y0=(1.0, 0.0, -0.5, 0, 0, 0), method=method).final_state[0]

    slope = (end(2.0 + 1e-6) - end(2.0 - 1e-6)) / 2e-6
    found = jax.jit(jax.jacfwd(end))(jnp.asarray(2.0))
    assert float(found) == pytest.approx(float(slope), rel=1e-6)


def test_a_building():
    building = ss.storeys_on_bearing(
        [3.0, 2.0, 1.0], [50.0, 40.0], friction=DRY, damping=[0.5, 0.4], bearing_stiffness=2.0, gravity=10.0
    )
    np.testing.assert_array_equal(building.stiffness, [[52, -50, 0], [-50, 90, -40], [0, -40, 40]])
    np.testing.assert_array_equal(building.damping, [[0.5, -0.5, 0], [-0.5, 0.9, -0.4], [0, -0.4, 0.4]])
    assert building.contacts[0].normal_force == 60.0
    np.testing.assert_array_equal(building.contacts[0].direction, [1, 0, 0])


@pytest.mark.slow
def test_a_building_that_is_nearly_rigid_is_a_sliding_block():
    """Newmark's block of the same weight: displacements differ by as much as the storey gives way."""
    times = np.arange(0, 4.001, 0.02)
    shaking = ss.GroundAcceleration(times, 1.5 * np.sin(2 * np.pi * times))
    building = ss.storeys_on_bearing([1.0, 1.0], [4e4], friction=ss.Coulomb(0.1), damping=[100.0])
    block = ss.MassSpring(2.0, 0.0, 2 * 9.80665, ss.Coulomb(0.1))
    slides, slid = (ss.simulate(one, shaking, t1=4.0) for one in (building, block))
    assert float(slides.final_state[0]) == pytest.approx(float(slid.final_state[0]), abs=1e-3)
    assert float(slid.peak("position")) > 0.02
    assert int(slides.of_contact(0).sticks.count) >= int(slid.sticks.count) > 2


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"blocks": 0}, "Argument blocks must be a whole number of at least 1"),
        ({"blocks": 1001}, "Argument blocks"),
        ({"mass": 0.0}, "Argument mass must be positive"),
        ({"between": -1.0}, "Argument between must be zero or positive"),
        ({"to_ground": np.nan}, "Argument to_ground"),
        ({"damping": -0.1}, "Argument damping must be zero or positive"),
        ({"normal_force": -1.0}, "Argument normal_force"),
    ],
)
def test_what_a_row_refuses(changed, message):
    given = {"blocks": 3, "mass": 1.0, "between": 1.0, "to_ground": 0.1, "normal_force": 1.0, "friction": DRY}
    with pytest.raises(ValueError, match=message):
        ss.block_row(**given | changed)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"mass": [1.0, "a"]}, "Argument mass must hold real numbers"),
        ({"mass": [1.0]}, "Argument mass must hold two positive numbers or more"),
        ({"mass": [1.0, -1.0]}, "Argument mass must hold"),
        ({"stiffness": [1.0, 2.0]}, "Argument stiffness must hold 1 finite numbers"),
        ({"stiffness": [0.0]}, "Argument stiffness must hold positive"),
        ({"damping": [-1.0]}, "Argument damping must hold numbers of zero or more"),
        ({"bearing_stiffness": -1.0}, "Argument bearing_stiffness"),
        ({"gravity": 0.0}, "Argument gravity must be positive"),
    ],
)
def test_what_a_building_refuses(changed, message):
    given = {"mass": [1.0, 1.0], "stiffness": [1.0], "friction": DRY}
    with pytest.raises(ValueError, match=message):
        ss.storeys_on_bearing(**given | changed)
