"""Catalogues of connected slips: against a union-find of every pair of slips, and slopes of drawn magnitudes."""

import itertools
from functools import cache

import jax
import numpy as np
import pytest

import stickslip_jax as ss
from stickslip_jax._foundation.fields import with_fields

T1 = 50.0


def row(blocks, friction=None, between=9.0):
    law = ss.Coulomb(0.4, 0.5) if friction is None else friction
    return ss.block_row(blocks, mass=1.0, between=between, to_ground=1.0, normal_force=1.0, friction=law)


@cache
def some_motion():
    """Of any system: its sticks and the system are replaced."""
    return ss.simulate(ss.MassSpring(1.0, 1.0, 1.0, ss.Coulomb(0.3)), ss.Constant(0.0), t1=T1)


def with_sticks(one, system, lists, base=None):
    """The simulation `one` with other sticks: of each contact a list of (start, end, slip displacement)."""
    rows = sorted((start, end, moved, contact) for contact, of in enumerate(lists) for start, end, moved in of)
    start, end, moved, contact = (np.array(column) for column in zip(*rows, strict=True))
    mask = np.ones(len(rows), bool)
    sticks = ss.Sticks(start, end, 0 * start, moved, np.zeros(len(rows), np.int8), mask, contact)
    return with_fields(one, ss.Simulation, system=system, sticks=sticks, base=base or one.base)


def random_sticks(rng, contacts):
    lists = []
    for _ in range(contacts):
        number = int(rng.integers(0, 6))
        ends = np.sort(rng.uniform(0, T1, 2 * number))
        if number and rng.uniform() < 0.5:
            ends[0] = 0.0
        if number and rng.uniform() < 0.5:
            ends[-1] = T1
        if number > 1 and rng.uniform() < 0.3:
            ends[2] = ends[1]  # a stick that begins where one ends, as the base jumps
        lists.append([(ends[2 * i], ends[2 * i + 1], rng.normal()) for i in range(number)])
    return lists


def by_union_find(lists, neighbours):
    """Events as (begin, duration, size, moment, largest), those of whole slips alone, and how many are cut."""
    slips = []  # contact, begin, end, distance, whether it is cut
    for contact, sticks in enumerate(lists):
        time, is_first = 0.0, True
        for start, end, moved in sticks:
            if start > time:
                slips.append((contact, time, start, abs(moved), is_first))
            time, is_first = end, False
        if time < T1:
            slips.append((contact, time, T1, 0.0, True))
    parent = list(range(len(slips)))

    def root(i):
        while parent[i] != i:
            i = parent[i]
        return i

    for i, j in itertools.combinations(range(len(slips)), 2):
        (a, begin, end, *_), (b, begin_other, end_other, *_) = slips[i], slips[j]
        if neighbours[a][b] and begin <= end_other and begin_other <= end:
            parent[root(i)] = root(j)
    events = {}
    for i, slip in enumerate(slips):
        events.setdefault(root(i), []).append(slip)
    found = []
    for members in events.values():
        slipped = {}
        for contact, _, _, distance, _ in members:
            slipped[contact] = slipped.get(contact, 0.0) + distance
        begin, end = min(slip[1] for slip in members), max(slip[2] for slip in members)
        row = begin, end - begin, len(slipped), sum(slipped.values()), max(slipped.values())
        found.append((row, any(slip[4] for slip in members)))
    return sorted(row for row, is_cut in found if not is_cut), sum(is_cut for _, is_cut in found)


def chain(contacts):
    return np.abs(np.subtract.outer(range(contacts), range(contacts))) <= 1


def rows_of(events):
    return np.column_stack([events.begin, events.duration, events.size, events.moment, events.largest])


@pytest.mark.parametrize("seed", range(40))
def test_events_of_random_sticks_by_union_find(seed):
    rng = np.random.default_rng(seed)
    contacts = 7
    one, system, lists = some_motion(), row(contacts), random_sticks(rng, contacts)
    expected, cut = by_union_find(lists, chain(contacts))
    found = ss.catalogue(with_sticks(one, system, lists))
    assert found.left_out == cut
    np.testing.assert_allclose(rows_of(found), np.reshape(expected, (-1, 5)), rtol=1e-12, atol=1e-12)
    # Springs between others: a ring with a chord, and blocks that no spring joins.
    stiffness = np.eye(contacts)
    for i, j in [(0, 6), (6, 2), (2, 5), (5, 0), (0, 2)]:
        stiffness[[i, j, i, j], [i, j, j, i]] += np.array([1.0, 1.0, -1.0, -1.0])
    other = ss.LinearStructure(np.ones(contacts), stiffness, contacts=system.contacts)
    expected, cut = by_union_find(lists, stiffness != 0)
    found = ss.catalogue(with_sticks(one, other, lists))
    assert found.left_out == cut
    np.testing.assert_allclose(rows_of(found), np.reshape(expected, (-1, 5)), rtol=1e-12, atol=1e-12)


def test_slips_far_apart_at_the_same_time_are_two_events():
    lists = [[(0.0, 10.0, 0.0), (12.0, T1, 0.3)], [(0.0, T1, 0.0)], [(0.0, 9.0, 0.0), (13.0, T1, -0.2)]]
    apart = ss.catalogue(with_sticks(some_motion(), row(3), lists))
    assert apart.size.tolist() == [1, 1]
    np.testing.assert_allclose(apart.moment, [0.2, 0.3])
    np.testing.assert_allclose(apart.magnitude, np.log10([0.2, 0.3]))
    lists[1] = [(0.0, 11.0, 0.0), (11.5, T1, 0.1)]
    joined = ss.catalogue(with_sticks(some_motion(), row(3), lists))
    np.testing.assert_allclose(rows_of(joined), [[9.0, 4.0, 3, 0.6, 0.3]])


def test_neighbours():
    """Contacts on one mass, between masses, and on masses that a spring joins; of a diagonal stiffness none."""
    stack = ss.LinearStructure(
        [1.0, 1.0, 1.0, 1.0],
        np.diag([2.0, 1.0, 3.0, 1.0]),
        contacts=[
            ss.Contact.of_mass(0, 4, 1.0, ss.Coulomb(0.3)),
            ss.Contact.between(1, 0, 4, 1.0, ss.Coulomb(0.3)),
            ss.Contact.of_mass(3, 4, 1.0, ss.Coulomb(0.3)),
        ],
    )
    np.testing.assert_array_equal(stack.neighbours, [[1, 1, 0], [1, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(row(5).neighbours, chain(5))


def test_a_motion_whose_contacts_never_stick_has_no_events():
    found = ss.catalogue(with_sticks(some_motion(), row(3), [[], [(20.0, 30.0, 0.1)], []]))
    assert len(found.begin) == 0
    assert found.left_out == 1
    assert np.isnan(found.slope(1e-3).value)
    assert found.frequencies(3)["events"].tolist() == [0, 0, 0]
    assert str(found) == "0 events of 3 contacts in 1 x 50 s, 1 cut by begin or end left out"


def of_moments(moment):
    some, whole = np.ones(len(moment)), np.ones(len(moment), int)
    return ss.Catalogue(whole, some, some, whole, moment, moment, 1.0, 1, 1, 0)


@pytest.mark.parametrize("b", [0.6, 1.0, 1.8])
def test_slopes_of_drawn_magnitudes(b):
    """Moments with a density proportional to ``M^-(1 + b)``, and some below it, in 400 catalogues of 400: the mean of
    the scores has the variance 1/400, and they have the variance 1, but for the bias of b, b/n, and of its error.
    """
    rng, number, catalogues = np.random.default_rng(3), 400, 400
    scores = []
    for _ in range(catalogues):
        moment = np.append(0.01 * rng.uniform(size=number) ** (-1 / b), rng.uniform(1e-9, 0.01, 50))
        found = of_moments(moment).slope(0.01)
        assert found.samples == number
        scores.append((found.value - b) / found.standard_error)
    assert abs(np.mean(scores)) < 4 / np.sqrt(catalogues) + 2 / np.sqrt(number)
    assert abs(np.var(scores) - 1) < 4 * np.sqrt(2 / catalogues)


def test_the_slope_by_the_formula_of_aki():
    moments = np.array([0.02, 0.05, 0.011, 0.4, 0.009, 0.01])
    events = of_moments(moments)
    counted = np.log10(moments[moments >= 0.01])
    expected = np.log10(np.e) / (counted.mean() - np.log10(0.01))
    found = events.slope(0.01)
    assert found.value == pytest.approx(expected)
    assert found.standard_error == pytest.approx(expected / np.sqrt(5))
    assert found.samples == 5
    np.testing.assert_array_equal(events.frequencies(2)["events"], [5, 1])
    np.testing.assert_array_equal(events.frequencies(2)["at_least"], [6, 1])
    assert np.isnan(events.slope(1.0).value)


BASES = {
    "constant": (ss.Constant(-0.03), lambda t: -0.03 * t),
    "steps": (ss.PiecewiseConstant([0.0, 7.0, 20.0], [0.1, -0.2, 0.05]),
              lambda t: np.interp(t, [0, 7, 20, 50], [0, 0.7, -1.9, -0.4])),
    "recorded": (ss.Recorded([0.0, 20.0, 50.0], [0.0, 0.2, -0.1]),
                 lambda t: np.where(t < 20, 0.005 * t**2, 2 + 0.2 * (t - 20) - 0.005 * (t - 20) ** 2)),
    "harmonic": (ss.Harmonic(0.2, 1.3, offset=0.02), lambda t: 0.02 * t + 0.2 / 1.3 * np.sin(1.3 * t)),
    "shaken": (ss.GroundAcceleration([0.0, 50.0], [0.0, 0.1]), lambda t: 0 * t),
}  # fmt: skip


@pytest.mark.parametrize("name", BASES)
def test_slips_are_relative_to_the_base(name):
    """Two blocks that slip one after the other, the second longer than the base takes to jump."""
    base, way = BASES[name]
    lists = [[(0.0, 10.0, 0.0), (12.0, T1, 0.3)], [(0.0, 11.0, 0.0), (31.0, T1, -0.8)]]
    one = with_sticks(some_motion(), row(2), lists, base)
    slips = [0.3 - (way(12.0) - way(10.0)), -0.8 - (way(31.0) - way(11.0))]
    np.testing.assert_allclose(ss.catalogue(one).moment, [np.abs(slips).sum()], rtol=1e-12)
    np.testing.assert_allclose(ss.catalogue(one).largest, [np.abs(slips).max()], rtol=1e-12)


class Two(ss.SwitchedSystem):
    """Two contacts of a system of one's own, of which nobody knows what joins them."""

    @property
    def contacts(self):
        return 2

    @property
    def state_names(self):
        return tuple(
            f"{name} {number} in {unit}" for name, unit in (("position", "m"), ("velocity", "m/s")) for number in (0, 1)
        )

    def rates(self, t, y, base, friction):
        return y[2], y[3], -y[0] - friction[0], -y[1] - friction[1]

    def relative_velocity(self, t, y, base):
        return y[2] - base.velocity, y[3] - base.velocity

    @property
    def shortest_time(self):
        return 6.0


def test_any_slips_at_the_same_time_of_a_system_of_ones_own_are_one_event():
    lists = [[(0.0, 10.0, 0.0), (12.0, T1, 0.3)], [(0.0, 11.0, 0.0), (13.0, 14.0, -0.2), (15.0, T1, 0.1)]]
    found = ss.catalogue(with_sticks(some_motion(), Two(), lists, ss.Constant(0.7)))
    np.testing.assert_allclose(rows_of(found), [[10.0, 3.0, 2, 0.5, 0.3], [14.0, 1.0, 1, 0.1, 0.1]])


@pytest.mark.slow
def test_ensembles_have_the_events_of_their_samples():
    speed, blocks, t1 = 0.03, 6, 80.0
    y0 = (*(ss.Uniform(-0.2, 0.2) for _ in range(blocks)), *[speed] * blocks)
    given = {"t1": t1, "samples": 5, "key": jax.random.key(1), "y0": y0}
    many = ss.simulate_contacts(row(blocks), ss.Constant(speed), keep="sticks", **given)
    events = ss.catalogue(many)
    assert events.samples == 5
    assert len(events.begin) > 20
    for number in range(5):
        system, base, start = many.realization(number)
        alone = ss.catalogue(ss.simulate(system, base, t1=t1, y0=start))
        own = events.sample == number
        np.testing.assert_allclose(rows_of(alone), rows_of(events)[own], rtol=1e-9, atol=1e-9)
    with pytest.raises(ValueError, match=r"Argument source must be from simulate_contacts.*keep=\"sticks\""):
        ss.catalogue(ss.simulate_contacts(row(blocks), ss.Constant(speed), **given))


@pytest.mark.slow
def test_a_train_of_a_hundred_blocks():
    """Its events: no two at once among neighbours, all moments accounted for, and blocks that move forward alone."""
    blocks, speed, t1 = 100, 0.01, 60.0
    law = ss.OneWay(ss.FrictionCurve(lambda v: 0.99 / (1 + 5.0 * v), mu_static=1.0), capacity=100.0)
    start = np.random.default_rng(0).uniform(-0.5, 0.9, blocks)
    one = ss.simulate(row(blocks, law, 36.0), ss.Constant(-speed), t1=t1, y0=(*start, *[-speed] * blocks))
    assert int(one.status) == ss.Status.FINISHED
    events, mask = ss.catalogue(one), np.asarray(one.sticks.mask)
    start, end, moved, contact = (
        np.asarray(column)[mask]
        for column in (one.sticks.start, one.sticks.end, one.sticks.slip_displacement, one.sticks.contact)
    )
    forward = 0.0
    for i in range(blocks):
        own = np.argsort(start + 1e9 * (contact != i))[: np.sum(contact == i)]
        slips = moved[own][1:] + speed * (start[own][1:] - end[own][:-1])
        assert np.all(slips > -1e-9)
        forward += slips.sum()
    assert len(events.begin) > 50
    assert np.max(events.size) > 1
    assert events.moment.sum() <= forward * (1 + 1e-9)
    assert np.all(events.largest <= events.moment * (1 + 1e-12))
    assert np.all(np.diff(events.begin) >= 0)


@pytest.mark.parametrize(
    "source",
    [None, 3, "row", ss.Coulomb(0.3), lambda: None],
)
def test_what_has_no_catalogue(source):
    with pytest.raises(ValueError, match="Argument source must be a Simulation of several contacts"):
        ss.catalogue(source)


def test_one_contact_has_none():
    with pytest.raises(ValueError, match="Argument source must be a Simulation of several contacts"):
        ss.catalogue(some_motion())
    with pytest.raises(ValueError, match="Argument least must be positive"):
        of_moments(np.ones(3)).slope(0.0)
