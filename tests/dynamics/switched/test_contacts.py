"""Motions with several contacts: published ones, those that come apart into single contacts, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss

CHAIN = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])


def on_base(masses, normal_force, friction):
    return tuple(ss.Contact.of_mass(i, masses, normal_force, friction) for i in range(masses))


def listed(one):
    """Contact, start and end of each stick."""
    mask = np.asarray(one.sticks.mask)
    return [np.asarray(column)[mask] for column in (one.sticks.contact, one.sticks.start, one.sticks.end)]


def test_three_blocks_on_the_floor():
    """An event-by-event integration with rtol 1e-12 found these numbers."""
    system = ss.LinearStructure(np.ones(3), CHAIN, CHAIN / 10, on_base(3, 1.0, ss.Coulomb(0.3)))
    one = ss.simulate(system, ss.Constant(0.0), t1=12.0, y0=(-1, 1, -1, -1, 1, 1))
    contact, start, end = listed(one)
    assert int(one.status) == ss.Status.FINISHED
    assert int(one.near_grazing_count) == 0
    assert contact.tolist() == [0, 2, 1, 0, 2]
    starts = [4.63544896516, 4.96043120202, 6.78298795467, 7.34343581525, 8.37062952656]
    assert np.allclose(start, starts, rtol=0, atol=1e-11)
    assert np.allclose(end, [4.82994374361, 5.08551319834, 12, 12, 12], rtol=0, atol=1e-11)
    positions = [0.202558662099, 0.412765621355, 0.531438212051]
    assert np.allclose(jnp.stack(one.final_state), [*positions, 0, 0, 0], rtol=0, atol=1e-12)


def uncoupled(mu, static=None):
    """Two oscillators that have nothing to do with each other, in one structure."""
    friction = ss.Coulomb(mu, static), ss.Coulomb(1.2 * mu, static)
    contacts = tuple(ss.Contact.of_mass(i, 2, 1.0 + 0.2 * i, friction[i]) for i in range(2))
    return ss.LinearStructure([1.0, 0.5], [2.0, 3.0], [0.1, 0.0], contacts)


HARMONIC, SQUARE = ss.Harmonic(0.5, 0.7), ss.SquareWave(0.5, 6.0)


@pytest.mark.parametrize(
    ("base", "static"),
    [
        pytest.param(HARMONIC, None, id="harmonic, Coulomb"),
        pytest.param(SQUARE, 0.4, id="square, static"),
        pytest.param(HARMONIC, 0.4, id="harmonic, static", marks=pytest.mark.slow),
        pytest.param(SQUARE, None, id="square, Coulomb", marks=pytest.mark.slow),
    ],
)
def test_contacts_far_apart_are_single_ones(base, static):
    """Each is that of a `MassSpring`, whose closed forms are another way to the same motion."""
    both = ss.simulate(uncoupled(0.3, static), base, t1=30.0, y0=(0.5, -0.2, 0.0, 0.5))
    starts = (0.5, 0.0), (-0.2, 0.5)
    singles = (
        ss.MassSpring(1.0, 2.0, 1.0, ss.Coulomb(0.3, static), 0.1),
        ss.MassSpring(0.5, 3.0, 1.2, ss.Coulomb(0.36, static)),
    )
    for i, (system, y0) in enumerate(zip(singles, starts, strict=True)):
        alone, part = ss.simulate(system, base, t1=30.0, y0=y0), both.of_contact(i)
        count = int(alone.sticks.count)
        assert count >= 3
        assert int(part.sticks.count) == count
        for name in ("start", "end", "position"):
            found, expected = getattr(part.sticks, name)[:count], getattr(alone.sticks, name)[:count]
            assert np.allclose(found, expected, rtol=0, atol=2e-10), name
        assert np.array_equal(part.sticks.ending[:count], alone.sticks.ending[:count])
        assert np.allclose(both.final_state[i::2], alone.final_state, rtol=0, atol=2e-10)
        assert float(part.stick_time) == pytest.approx(float(alone.stick_time), rel=1e-10)
        assert int(part.slips.count) == int(alone.slips.count)


def stack(mu):
    """A block on a belt, and another block on it: friction in one contact moves the other."""
    contacts = (
        ss.Contact([1.0, 0.0], 5.0, ss.Coulomb(mu, 1.3 * mu)),
        ss.Contact.between(1, 0, 2, 2.0, ss.Coulomb(0.3, 0.4)),
    )
    return ss.LinearStructure([1.0, 0.5], [2.0, 1.0], contacts=contacts)


def end_of_stack(mu, max_steps=None):
    method = ss.Exact(max_steps=max_steps)
    one = ss.simulate(stack(mu), ss.Harmonic(0.8, 1.1), t1=20.0, y0=(0.5, -0.2, 0.0, 0.3), method=method)
    starts = jnp.where(one.sticks.mask, one.sticks.start, 0.0)[:4]
    return jnp.concatenate([jnp.stack(one.final_state), starts, one.stick_time])


@pytest.mark.parametrize(
    "mode", [pytest.param(jax.jacfwd, id="forward"), pytest.param(jax.jacrev, id="reverse", marks=pytest.mark.slow)]
)
def test_derivatives_of_coupled_contacts(mode):
    """Of states, of event times and of stick times, against differences."""
    h = 1e-6
    expected = (end_of_stack(0.2 + h) - end_of_stack(0.2 - h)) / (2 * h)
    assert np.max(np.abs(expected)) > 1
    assert np.allclose(mode(end_of_stack)(0.2), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_batches_of_structures():
    mu = jnp.array([0.2, 0.25])
    many = jax.jit(jax.vmap(lambda mu: end_of_stack(mu, max_steps=1536)))(mu)
    assert np.allclose(many, jnp.stack([end_of_stack(0.2), end_of_stack(0.25)]), rtol=1e-12, atol=1e-12)


def test_what_sticks_together_moves_as_one_mass():
    """A light block that friction never lets go rides on another: together they are one oscillator."""
    contacts = (
        ss.Contact([1.0, 0.0], 1.0, ss.Coulomb(0.5)),
        ss.Contact.between(1, 0, 2, 100.0, ss.Coulomb(0.9)),
    )
    system = ss.LinearStructure([1.0, 0.5], [4.0, 0.0], contacts=contacts)
    one = ss.simulate(system, ss.Harmonic(0.4, 0.7), t1=20.0, y0=(0.3, 0.0, 0.1, 0.1))
    alone = ss.simulate(ss.MassSpring(1.5, 4.0, 1.0, ss.Coulomb(0.5)), ss.Harmonic(0.4, 0.7), t1=20.0, y0=(0.3, 0.1))
    assert float(one.of_contact(1).stick_time) == pytest.approx(20.0, abs=1e-12)
    below, count = one.of_contact(0), int(alone.sticks.count)
    assert count >= 2
    assert np.allclose(below.sticks.start[:count], alone.sticks.start[:count], rtol=0, atol=2e-10)
    assert np.allclose(below.sticks.end[:count], alone.sticks.end[:count], rtol=0, atol=2e-10)
    assert np.allclose(one.final_state[::2], alone.final_state, rtol=0, atol=2e-10)


@pytest.mark.slow
def test_laws_of_different_kinds():
    """Each contact may have its own law: a Stribeck curve beside Coulomb's, against the single oscillators."""
    laws = ss.Stribeck(0.2, 0.3, 0.1), ss.Coulomb(0.2, 0.3)
    system = ss.LinearStructure(
        [1.0, 1.0], [2.0, 2.0], contacts=tuple(ss.Contact.of_mass(i, 2, 1.0, law) for i, law in enumerate(laws))
    )
    both = ss.simulate(system, ss.Constant(0.1), t1=20.0, y0=(0.5, 0.5, 0.0, 0.0))
    for i, law in enumerate(laws):
        alone = ss.simulate(ss.MassSpring(1.0, 2.0, 1.0, law), ss.Constant(0.1), t1=20.0, y0=(0.5, 0.0))
        count = int(alone.sticks.count)
        assert count >= 2
        assert np.allclose(both.of_contact(i).sticks.start[:count], alone.sticks.start[:count], rtol=0, atol=1e-9)
        assert np.allclose(both.final_state[i::2], alone.final_state, rtol=0, atol=1e-9)


def test_the_table_of_sticks_names_their_contacts():
    system = ss.LinearStructure(np.ones(3), CHAIN, CHAIN / 10, on_base(3, 1.0, ss.Coulomb(0.3)))
    one = ss.simulate(system, ss.Constant(0.0), t1=12.0, y0=(-1, 1, -1, -1, 1, 1))
    table = one.to_pandas()
    assert table["contact"].tolist() == [0, 0, 1, 2, 2]
    assert table["order"].tolist() == [1, 2, 1, 1, 2]
    assert table["ending"].tolist() == ["RELEASED", "HORIZON", "HORIZON", "RELEASED", "HORIZON"]
    assert np.allclose(table["start_s"], [4.63544896516, 7.34343581525, 6.78298795467, 4.96043120202, 8.37062952656])
    with pytest.raises(ValueError, match="of_contact"):
        one.to_xarray()
    assert one.of_contact(2).to_xarray()["stick_count"] == 2


class SlowBlock(ss.SwitchedSystem):
    """A sliding block whose shortest time scale is far beyond the horizon."""

    shortest: float
    normal_force: float = 2.0

    @property
    def state_names(self):
        return "position in m", "velocity in m/s"

    @property
    def shortest_time(self):
        return self.shortest

    def rates(self, t, y, base, friction):
        return y[1], -self.normal_force * friction

    def relative_velocity(self, t, y, base):
        return y[1] - base.velocity


SLOW = {
    "structure": ss.LinearStructure(np.ones(1), np.zeros(1), contacts=(ss.Contact(np.ones(1), 2.0, ss.Coulomb(1.0)),)),
    "soft structure": ss.LinearStructure(
        np.ones(1), np.full(1, 1e-60), contacts=(ss.Contact(np.ones(1), 2.0, ss.Coulomb(1.0)),)
    ),
    "mass": ss.MassSpring(1.0, 0.0, 2.0, ss.Coulomb(1.0)),
    "soft mass": ss.MassSpring(1.0, 1e-60, 2.0, ss.Coulomb(1.0)),
    "user's system": SlowBlock(1e30),
}


@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("name", SLOW)
def test_motion_without_springs_is_not_taken_for_rest(name, dtype):
    """Round-off is judged by the speeds of the motion, not by what forces would change in its longest time.

    Reference: the block's velocity falls by 2 m/s^2 until it has that of the belt.
    """
    with jax.enable_x64(dtype == "float64"):
        belt = ss.VelocitySteps(np.ones(4), np.array([0.5, -0.5, 0.75, -0.25]))
        method = ss.Exact() if dtype == "float64" else ss.Exact(step=0.05)
        one = ss.simulate(SLOW[name], belt, t1=4.0, y0=(0.0, 1.0), method=method)
        mask = np.asarray(one.sticks.mask)
        assert int(one.status) == ss.Status.FINISHED
        assert int(one.near_grazing_count) == 0 or dtype == "float32"  # which is cautious
        found = np.stack([np.ravel(one.sticks.start)[mask], np.ravel(one.sticks.end)[mask]], axis=1)
    expected = [[0.25, 1.0], [1.5, 2.0], [2.625, 3.0], [3.5, 4.0]]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14 if dtype == "float64" else 1e-6)
