"""Chains of many blocks: their contacts are few arrays, which changes nothing; no work is wasted on few samples."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._systems.contacts import Alike

DRY = ss.Coulomb(0.3)
BELT = ss.Constant(0.2)


class OneByOne(ss.LinearStructure):
    """A class of a user's own, whose contacts are taken as they are."""


def row(blocks, kind=ss.LinearStructure, mu=0.3, mass=1.0, spring=1.0):
    stiffness = ss.block_row(
        blocks, mass=1.0, between=1.0, to_ground=0.2, normal_force=1.0, friction=DRY
    ).stiffness  # fmt: skip
    each = jnp.broadcast_to(mu, blocks)
    contacts = tuple(ss.Contact.of_mass(i, blocks, 1.0 + 0.01 * i, ss.Coulomb(each[i])) for i in range(blocks))
    return kind(mass * np.ones(blocks), spring * stiffness, None, contacts, uncoupled=True)


def starts(blocks, *samples):
    return np.random.default_rng(3).uniform(-1, 1, (blocks, *samples))


@pytest.mark.slow
def test_contacts_as_arrays_change_nothing():
    y0 = (*starts(12), *np.zeros(12))

    def of(kind):
        def looked_at(mu, mass, spring):
            one = ss.simulate(row(12, kind, mu, mass, spring), BELT, t1=10.0, y0=y0, method=ss.Exact(max_steps=600))
            return one.final_state, one.of_contact(2).stick_time

        point = np.full(12, 0.3) + 0.01 * np.arange(12), 1.0, 1.0
        ways = (np.ones(12), 0.0, 0.0), (np.zeros(12), 1.0, 0.0), (np.zeros(12), 0.0, 1.0)
        return [jax.jvp(looked_at, point, way) for way in ways]

    found, expected = of(ss.LinearStructure), of(OneByOne)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=0, atol=1e-9), found, expected)
    assert all(np.any(np.abs(np.asarray(slopes[0])) > 0.1) for _, slopes in found)


@pytest.mark.slow
def test_a_chain_inside_a_program():
    """What is known in it (all but mu) is known to JAX as constants."""
    y0 = (*starts(12), *np.zeros(12))

    def stick_time(mu):
        one = ss.simulate(row(12, mu=mu), BELT, t1=5.0, y0=y0, method=ss.Exact(max_steps=600))
        return one.of_contact(3).stick_time, one.evaluate(jnp.linspace(0, 5, 7))[5]

    inside, outside = jax.jit(stick_time)(0.4), stick_time(0.4)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=0, atol=1e-10), inside, outside)
    assert outside[0] > 0.1


@pytest.mark.slow
def test_the_motion_of_many_numbers_between_steps():
    """One array of all numbers holds what each has alone, for times of any shape."""
    one = ss.simulate(row(12), BELT, t1=5.0, y0=(*starts(12), *np.zeros(12)))
    times = np.linspace(0, 5, 6).reshape(2, 3)
    found, alone = one.evaluate(times), [one._path.state(jnp.asarray(time)) for time in times.ravel()]
    assert len(found) == 24
    np.testing.assert_allclose(np.reshape(found, (24, 6)), np.transpose(alone), rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.asarray(found)[:, -1, -1], one.final_state, rtol=0, atol=1e-12)
    assert np.all(np.isnan(one.evaluate(6.0)))


def test_which_contacts_are_alike():
    many, weight = row(10).contacts, ss.ForceSteps([0.0, 1.0], [1.0, 2.0])
    each = Alike.of(many)
    assert isinstance(each, Alike)
    assert len(each) == 10
    np.testing.assert_allclose(each.each.normal_force, 1 + 0.01 * np.arange(10))
    np.testing.assert_array_equal(each.each.direction, np.eye(10))
    others = (
        ss.Contact.of_mass(9, 10, 1.0, ss.Stribeck(0.3, 0.4, stribeck_speed=0.1)),
        ss.Contact.of_mass(9, 10, weight, DRY),
    )
    for other in others:
        assert isinstance(Alike.of((*many[:9], other)), tuple)
    assert isinstance(Alike.of(many[:8]), tuple)


@pytest.mark.parametrize("mass", [[1.0, 2.0, 0.5], [[1.0, 0.2, 0.0], [0.2, 2.0, 0.1], [0.0, 0.1, 0.5]]])
@pytest.mark.parametrize("damping", [None, [0.1, 9.0, 0.0]])
def test_the_fastest_motion_of_known_and_of_traced_numbers(mass, damping):
    stiffness = np.array([[3.0, -1.0, 0.0], [-1.0, 4.0, -2.0], [0.0, -2.0, 2.5]])
    contact = ss.Contact.of_mass(0, 3, 1.0, DRY)

    def fastest(stiffness):
        return ss.LinearStructure(mass, stiffness, damping, (contact,), uncoupled=True).fastest

    np.testing.assert_allclose(fastest(stiffness), jax.jit(fastest)(stiffness), rtol=1e-10)
    # In a program, too, they may be known.
    np.testing.assert_array_equal(jax.jit(lambda one: one * fastest(stiffness))(1.0), fastest(stiffness))


@pytest.mark.slow
def test_few_samples_of_a_long_chain():
    """The same to the last bit in any number of lanes and threads; the printed result stays short."""
    y0 = (*starts(60, 20), *np.zeros(60))
    one, two = (
        ss.simulate_contacts(row(60), BELT, t1=1.0, samples=20, y0=y0, keep="totals", threads=threads, progress=False)
        for threads in (1, 2)
    )
    assert one.of_contact(0).finished == 20
    for contact in (0, 31, 59):
        totals, others = one.of_contact(contact).totals, two.of_contact(contact).totals
        jax.tree.map(np.testing.assert_array_equal, totals, others)
    sticks = sum(int(one.of_contact(contact).totals.sticks.sum()) for contact in range(60))
    assert sticks > 20
    assert f"in all {sticks:,} of the contacts" in repr(one)
    assert len(repr(one).split("\n")[3]) < 80
