"""Motions with several contacts: published ones, those that come apart into single contacts, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.contact_arcs import Motion
from reference.contacts import _settle_block

import stickslip_jax as ss
from stickslip_jax._systems.contacts_model import Limits, settled
from stickslip_jax._systems.switched_model import Question

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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("base", "static"),
    [
        pytest.param(HARMONIC, None, id="harmonic, Coulomb"),
        pytest.param(SQUARE, 0.4, id="square, static", marks=pytest.mark.slow),
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


@pytest.mark.slow
@pytest.mark.parametrize(
    "mode", [pytest.param(jax.jacfwd, id="forward"), pytest.param(jax.jacrev, id="reverse", marks=pytest.mark.slow)]
)
def test_derivatives_of_coupled_contacts(mode):
    """Of states, of event times and of stick times, against differences."""
    both = jax.jit(mode(lambda mu: (end_of_stack(mu, max_steps=1536),) * 2, has_aux=True))  # compiled once
    h = 1e-6
    expected = (both(0.2 + h)[1] - both(0.2 - h)[1]) / (2 * h)
    assert np.max(np.abs(expected)) > 1
    assert np.allclose(both(0.2)[0], expected, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_batches_of_structures():
    mu = jnp.array([0.2, 0.25])
    many = jax.jit(jax.vmap(lambda mu: end_of_stack(mu, max_steps=1536)))(mu)
    assert np.allclose(many, jnp.stack([end_of_stack(0.2), end_of_stack(0.25)]), rtol=1e-12, atol=1e-12)


@pytest.mark.slow
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
def test_a_jump_of_the_base_asks_the_others_under_the_friction_that_it_starts():
    """Pushed by 3 N, held by at most 3.2 N: when the belt turns, the lower block is slowed, and the upper holds."""
    below, above = ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(3.2)), ss.Contact.between(1, 0, 2, 1.0, ss.Coulomb(1.0))
    system = ss.LinearStructure([1.0, 1.0], [0.0, 0.0], contacts=(below, above), force=(3.0, None))
    one = ss.simulate(system, ss.PiecewiseConstant([0.0, 1.0], [1.0, -1.0]), t1=2.0, y0=(0.0, 0.0, 1.0, 1.0))
    assert one.of_contact(1).sticks.end[one.of_contact(1).sticks.mask].tolist() == [2.0]
    assert one.of_contact(0).sticks.end[one.of_contact(0).sticks.mask].tolist() == [1.0]
    assert int(one.near_grazing_count) == 0
    np.testing.assert_allclose(one.final_state[2:], 0.9, rtol=1e-14)  # both are slowed down by 0.1 m/s^2


@pytest.mark.slow
@pytest.mark.parametrize("contacts", [2, 5, 6])
def test_what_has_broken_settles_before_another_breaks(contacts):
    """Contacts at rest under random loads, coupled, static above kinetic friction, against the reference's cases."""
    rng = np.random.default_rng(contacts)
    root = rng.normal(size=(400, contacts, contacts))
    gain, drift = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(contacts), 3 * rng.normal(size=(400, contacts))
    kinetic = rng.uniform(0.2, 2, (400, contacts))
    static = kinetic * rng.uniform(1.05, 1.5, (400, contacts))
    everywhere = jnp.ones(contacts, bool)

    @jax.jit
    @jax.vmap
    def signs(gain, drift, kinetic, static):
        question = Question(jnp.zeros(contacts), everywhere, ~everywhere, everywhere)
        return settled(gain, drift, Limits(kinetic, kinetic, static, static), question, jnp.zeros(contacts)).sign

    compared = 0
    for found, *numbers in zip(signs(gain, drift, kinetic, static), gain, drift, kinetic, static, strict=True):
        run = Motion()
        expected = _settle_block(run, numbers[0], numbers[1], {}, *numbers[2:])
        if run.margin > 1e-6:
            np.testing.assert_array_equal(found, expected)
            compared += 1
    assert compared > 390


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


def test_force_at_a_jump_is_the_one_after_it():
    force = ss.ForceSteps([0.0, 1.0], [2.0, 5.0])
    np.testing.assert_array_equal(force.value(jnp.array([0.0, 0.5, 1.0, 9.0])), [2.0, 2.0, 5.0, 5.0])


def end_of_clutches(numbers):
    """State at the end and starts of sticks of two clutches, the second of which closes at a given time."""
    amplitude, closing, force = numbers
    normal_forces = (
        ss.Harmonic(amplitude, 0.4 * np.pi),
        ss.ForceSteps(jnp.array([0.0, closing]), jnp.array([0.0, force])),
    )
    contacts = tuple(ss.Contact.between(i + 1, i, 3, n, ss.Coulomb(0.5, 0.55)) for i, n in enumerate(normal_forces))
    torque = (ss.Harmonic(10.0, 10 * np.pi, -np.pi / 2), None, None)
    train = ss.LinearStructure(np.ones(3), np.zeros(3), contacts=contacts, force=torque)
    method = ss.Exact(max_steps=1024)
    one = ss.simulate(train, ss.Constant(0.0), t1=2.0, y0=(0.0, 0.0, 0.0, 10.0, 0.0, 0.0), method=method)
    times = [jnp.where(one.sticks.mask, times, 0.0)[:4] for times in (one.sticks.start, one.sticks.end)]
    return jnp.concatenate([jnp.stack(one.final_state), *times])


@pytest.mark.slow
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_by_normal_forces(mode):
    """By the amplitude of one, and by when and how hard the other closes, against differences."""
    at, h = np.array([20.0, 0.4, 15.0]), 1e-6
    steps = h * np.eye(3)
    expected = np.stack([(end_of_clutches(at + d) - end_of_clutches(at - d)) / (2 * h) for d in steps], axis=-1)
    assert np.all(np.max(np.abs(expected), axis=0) > 1e-2)
    np.testing.assert_allclose(mode(end_of_clutches)(at), expected, rtol=1e-6, atol=2e-7)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [True, False])
def test_three_clutches(steps):
    """The rotational example of the Modelica library: normal forces that vary in time, open contacts, no springs.

    The times are those of an event-by-event integration at a relative tolerance of 1e-12; the published result at 1.5 s
    differs by its own tolerance, up to 4e-5.
    """
    closing = [([0.0, 0.4], [0.0, 20.0]), ([0.0, 0.9], [0.0, 20.0])]
    if not steps:  # the same as records that rise within 1e-12 s
        closing = [([0.0, t, t + 1e-12, 2.0], [0.0, 0.0, n, n]) for (_, t), (_, n) in closing]
    normal_forces = [
        ss.Harmonic(20.0, 0.4 * np.pi),
        *((ss.ForceSteps if steps else ss.Recorded)(np.array(t), np.array(n)) for t, n in closing),
    ]
    contacts = tuple(ss.Contact.between(i + 1, i, 4, n, ss.Coulomb(0.5, 0.55)) for i, n in enumerate(normal_forces))
    torque = (ss.Harmonic(10.0, 10 * np.pi, -np.pi / 2), None, None, None)
    train = ss.LinearStructure(np.ones(4), np.zeros(4), contacts=contacts, force=torque)
    one = ss.simulate(train, ss.Constant(0.0), t1=1.5, y0=(0.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0))
    contact, start, end = listed(one)
    np.testing.assert_array_equal(contact, [1, 0, 0, 2])
    expected = [0.709621474694, 0.791662359155, 0.906850192798, 1.143967492473]
    np.testing.assert_allclose(start, expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(end, [1.5, 0.831108506138, 1.000295859895, 1.5], rtol=0, atol=1e-11)
    y = np.stack(one.final_state)
    found = [y[0], y[4], *np.diff(y[:4]), y[5] - y[4]]
    expected = [7.486119099, 3.247058272, -3.37898168, -1.39667298, -1.53672056, -0.783871106]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)
    assert int(one.near_grazing_count) == 0
    assert one.totals.sticks.shape == (3,)


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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:stickslip_jax runs in float32")
@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        *((name, "float64") for name in SLOW),
        *(
            (name, "float32") if "mass" in name else pytest.param(name, "float32", marks=pytest.mark.slow)
            for name in SLOW
        ),
    ],
)
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
