"""What is drawn of each mechanism is where the exact motion has it, in every frame."""

import re
from itertools import pairwise

import jax
import numpy as np
import pytest
from support.films import bodies, disks, marks_of, rods, springs

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax._systems.system import Belt

COULOMB = ss.Coulomb(1.0)
FEW = (0, 17, 50)  # of 51 frames


def center_of(patch):
    return patch.get_x() + patch.get_width() / 2


def animated(one):
    """A film of 51 frames, and the states in them."""
    film = plot.animate(one, fps=5)
    return film, np.asarray(one.evaluate(film.times))


def switching(t):
    """How far a base runs that flips between -1 m/s and 1 m/s every 2.5 s."""
    return np.abs(np.mod(t, 5.0) - 2.5) - 2.5


BASES = {
    "square": (ss.SquareWave(1.0, 5.0), switching),
    "harmonic": (ss.Harmonic(0.8, 1.7, 0.3), lambda t: 0.8 / 1.7 * (np.sin(1.7 * t + 0.3) - np.sin(0.3))),
    "constant": (ss.Constant(-2.0), lambda t: -2.0 * t),
    "recorded": (
        ss.Recorded(np.arange(13.0), np.array([0.0, *([1.0, -1.0] * 6)])),
        lambda t: np.interp(t, np.linspace(0, 12, 12_001), RAN),
    ),
}
TRIANGLES = np.interp(np.linspace(0, 12, 12_001), np.arange(13.0), [0.0, *([1.0, -1.0] * 6)])
RAN = np.concatenate([[0.0], np.cumsum((TRIANGLES[1:] + TRIANGLES[:-1]) / 2 * 1e-3)])


@pytest.mark.slow
@pytest.mark.parametrize("name", BASES)
def test_mass_spring_and_belt(name):
    base, run = BASES[name]
    one = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, COULOMB), base, t1=12.0, y0=(0.0, 1.0))
    film, (position, _) = animated(one)
    for frame, time in enumerate(film.times):
        figure = film.frame(frame)
        (mass,) = bodies(figure)
        assert center_of(mass) == pytest.approx(position[frame], abs=1e-12)
        (spring,) = springs(figure)
        assert spring[1] == pytest.approx([mass.get_x(), 0.55], abs=1e-9)
        # Each mark keeps its place on the belt.
        ((first, *others),) = marks_of(figure)
        ends = figure.axes[0].get_xlim()
        around = (first[0, 0] - run(time)) / (ends[1] - ends[0])
        assert around == pytest.approx(round(around), abs=1e-6)
        apart = (np.array([mark[0, 0] for mark in others]) - first[0, 0]) / (ends[1] - ends[0]) * 8
        assert np.mod(apart + 0.5, 8) - 0.5 == pytest.approx(np.arange(1, 8))
        assert np.ptp(first[:, 1]) > 2 * np.ptp(others[0][:, 1])
    (wall,) = [patch for patch in figure.axes[0].patches if patch.get_hatch()]
    assert wall.get_x() + wall.get_width() == pytest.approx(spring[0, 0], abs=1e-9)
    assert figure.axes[0].get_xlabel() == "position $x$ (m)"


def test_a_window_begins_with_the_belt_where_it_is_then():
    one = ss.simulate(ss.MassSpring(1.0, 4.0, 1.0, COULOMB), BASES["square"][0], t1=12.0, y0=(0.0, 1.0))
    film = plot.animate(one, window=(3.0, 12.0), speed=1.0, fps=2)
    places = [marks_of(film.frame(number))[0][0][0, 0] for number in range(5)]
    length = np.diff(film.figure.axes[0].get_xlim())[0]
    around = (np.array(places) - places[0] - switching(film.times[:5]) + switching(3.0)) / length
    assert around == pytest.approx(np.round(around), abs=1e-9)


def test_marks_come_in_again_at_the_other_end():
    belt = Belt(0.0, np.array([0.0, 0.5, 1.5, -0.5]), (-1.0, 3.0), marks=4)
    assert belt.spacing == 1.0
    assert belt.mark_places.tolist() == [
        [0, 1, 2, -1],
        [0.5, 1.5, 2.5, -0.5],
        [1.5, 2.5, -0.5, 0.5],
        [-0.5, 0.5, 1.5, 2.5],
    ]


@pytest.mark.slow
def test_a_mass_without_spring_on_shaken_ground():
    quake = ss.KanaiTajimi(rms=1.5).sample(jax.random.key(0), t1=10.0)
    block = ss.simulate(ss.MassSpring(1.0, 0.0, 9.81, ss.Coulomb(0.1)), quake, t1=10.0)
    film, (position, _) = animated(block)
    for frame in FEW:
        (mass,) = bodies(film.frame(frame))
        assert center_of(mass) == pytest.approx(position[frame], abs=1e-12)
    assert springs(film.figure) == []
    assert film.figure.axes[0].get_xlabel() == "position $x$ relative to ground (m)"
    assert "ground" in [text.get_text() for text in film.figure.axes[0].get_legend().get_texts()]


@pytest.mark.slow
def test_motor_yoke_and_cart():
    one = ss.simulate(ss.MotorCart(mu=0.3), ss.SourceVoltage(phase=1.0), t1=1.5, y0=(1.13, 0.0, 0.0))
    film, (angle, *_) = animated(one)
    for frame in range(len(film.times)):
        figure = film.frame(frame)
        yoke, cart = bodies(figure)
        (center, radius, (mark,)), (pin, _, no_marks) = disks(figure)
        x, y = 0.01 * np.cos(angle[frame]), 0.01 * np.sin(angle[frame])
        assert (center, radius, no_marks) == ((0, 0), pytest.approx(0.013), [])
        assert pin == pytest.approx((x, y), abs=1e-15)
        assert mark == pytest.approx(np.arctan2(y, x))
        assert center_of(yoke) == pytest.approx(x, abs=1e-15)
        assert center_of(cart) == pytest.approx(x + 0.039, abs=1e-15)
    (rod,) = rods(figure)
    assert rod[:, 0] == pytest.approx([center_of(yoke) + yoke.get_width() / 2, cart.get_x()])
    # Circles are round: lengths are drawn alike in both directions.
    scale = figure.axes[0].transData.transform([(0, 0), (1, 0), (0, 1)])
    assert scale[1, 0] - scale[0, 0] == pytest.approx(scale[2, 1] - scale[0, 1], rel=1e-6)


@pytest.mark.slow
def test_blocks_in_a_row():
    row = ss.block_row(3, mass=1.0, between=2.0, to_ground=1.0, normal_force=1.0, friction=ss.Coulomb(0.3, 0.5))
    one = ss.simulate(row, ss.Constant(0.2), t1=10.0, y0=(0.1, 0.0, -0.1, 0.2, 0.2, 0.2))
    film, (*positions,) = animated(one)
    apart = float(re.search(r"drawn ([\d.]+) m apart", film.figure.axes[0].get_xlabel())[1])
    for frame in range(len(film.times)):
        figure = film.frame(frame)
        drawn = bodies(figure)
        places = [center_of(patch) for patch in drawn]
        assert np.diff(places) == pytest.approx(np.diff([x[frame] for x in positions[:3]]) + apart, abs=1e-3)
        assert places[0] == pytest.approx(positions[0][frame], abs=1e-12)
        assert np.all(np.diff(places) > drawn[0].get_width())
        found = springs(figure)
        assert len(found) == 5
        # Those to the plate end in the middle of their blocks, those between blocks at their sides.
        assert [spring[1, 0] for spring in found[:3]] == pytest.approx(places, abs=1e-9)
        for number, spring in enumerate(found[3:]):
            width = drawn[0].get_width() / 2
            expected = places[number] + width, places[number + 1] - width
            assert spring[:, 0] == pytest.approx(expected, abs=1e-9)
    free = ss.block_row(2, mass=1.0, between=0.0, to_ground=0.0, normal_force=1.0, friction=ss.Coulomb(0.3))
    film = plot.animate(ss.simulate(free, ss.Constant(0.2), t1=2.0), fps=2)
    assert springs(film.frame(0)) == []


@pytest.mark.slow
def test_building_on_its_bearing():
    building = ss.storeys_on_bearing([2e4] * 3, [2e7] * 2, friction=ss.Coulomb(0.05), damping=[1e5] * 2)
    quake = ss.KanaiTajimi(rms=1.5).sample(jax.random.key(0), t1=6.0)
    film, state = animated(ss.simulate(building, quake, t1=6.0))
    note = film.figure.axes[0].get_xlabel()
    factor = float(re.fullmatch(r"displacements drawn ([\d.]+) times as large, storeys 3 m high", note)[1])
    largest = 0.0
    for frame in range(len(film.times)):
        figure = film.frame(frame)
        floors = bodies(figure)
        assert [center_of(patch) for patch in floors] == pytest.approx(factor * state[:3, frame], abs=1e-12)
        assert [patch.get_y() + patch.get_height() / 2 for patch in floors] == pytest.approx([0, 3, 6])
        columns = rods(figure)
        assert len(columns) == 6
        assert columns[0][:, 0] - columns[0][0, 0] == pytest.approx([0, factor * (state[1, frame] - state[0, frame])])
        largest = max(largest, factor * np.abs(state[:3, frame]).max())
    assert 0.25 * 9 / 2.5 < largest <= 0.25 * 9


@pytest.mark.slow
def test_disks_of_a_drill_string():
    string = ss.drill_string(
        [2000.0, 400.0], [800.0], weight_on_bit=1e5, bit_radius=0.15, friction=ss.Coulomb(0.3), drive_torque=2e4
    )
    one = ss.simulate(string, ss.Constant(4.0), t1=6.0, y0=(0.0, 0.0, 4.0, 0.0))
    film, state = animated(one)
    for frame, time in enumerate(film.times):
        base, table, bit = disks(film.frame(frame))
        turned = np.exp(1j * np.array([4.0 * time, *state[:2, frame]]))
        assert np.exp(1j * np.array([each[2][0] for each in (base, table, bit)])) == pytest.approx(turned, abs=1e-9)
        assert len(base[2]) == 6
        assert (base[0], table[0], bit[0]) == ((0, 0), (0, 0), (3, 0))
    assert "base" in [text.get_text() for text in film.figure.axes[0].get_legend().get_texts()]


@pytest.mark.slow
def test_drivetrain_with_a_clutch():
    """The clutch stands between its disks and is coloured while it sticks; the brake colours its disk."""
    clutch, brake = ss.FrictionDisk(900.0, ss.Coulomb(0.3), radius=0.1), ss.FrictionDisk(50.0, ss.Coulomb(0.4))
    train = ss.drivetrain([0.2, 0.5, 1.0], stiffness=[0.0, 400.0], clutches=(clutch, None), brakes=(None, None, brake))
    one = ss.simulate(train, ss.Constant(0.0), t1=4.0, y0=(0.0, 0.0, 0.0, 60.0, 0.0, 0.0))
    film, state = animated(one)
    for frame in FEW:
        figure = film.frame(frame)
        (between,) = bodies(figure)
        assert center_of(between) == pytest.approx(1.5)
        found = [np.exp(1j * each[2][0]) for each in disks(figure)]
        assert np.array(found) == pytest.approx(np.exp(1j * state[:3, frame]), abs=1e-9)
    (shaft,) = rods(figure)
    assert shaft[:, 0].tolist() == [3, 6]


@pytest.mark.slow
@pytest.mark.parametrize(
    "drawn_as", ["bars", None, *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("blocks", "storeys"))]
)
def test_a_structure_of_ones_own_is_drawn_as_it_says(drawn_as, annotations_unchecked):
    contacts = [ss.Contact.of_mass(0, 2, 1.0, ss.Coulomb(0.3)), ss.Contact.between(0, 1, 2, 1.0, ss.Coulomb(0.2))]
    if drawn_as is None:  # then as blocks
        contacts[1] = ss.Contact.of_mass(1, 2, 1.0, ss.Coulomb(0.2))
    stiffness = [[2.0, -1.0], [-1.0, 1.0]]
    structure = ss.LinearStructure([1.0, 1.0], stiffness, contacts=contacts, drawn_as=drawn_as)
    film, state = animated(ss.simulate(structure, ss.Harmonic(1.0, 1.0), t1=5.0, y0=(0.5, 0.0, 0.0, 0.0)))
    drawn = bodies(film.frame(20))
    assert len(drawn) == (4 if drawn_as == "bars" else 2)
    if drawn_as == "bars":
        sizes = [patch.get_height() for patch in drawn]
        assert sizes == pytest.approx(np.abs(state[:, 20]) / np.abs(state).max(1), abs=1e-12)
    with pytest.raises(ValueError, match="Argument drawn_as must be one of 'bars', 'blocks', 'storeys', but 'tower'"):
        ss.LinearStructure([1.0, 1.0], stiffness, contacts=contacts, drawn_as="tower")


@pytest.mark.slow
def test_many_bars_have_names_that_fit():
    row = ss.block_row(20, mass=1.0, between=1.0, to_ground=0.1, normal_force=1.0, friction=ss.Coulomb(0.3))
    bars = ss.LinearStructure(row.mass, row.stiffness, contacts=row.contacts, drawn_as="bars")
    film = plot.animate(ss.simulate(bars, ss.Constant(0.1), t1=1.0), fps=1)
    labels = film.figure.axes[0].get_xticklabels()
    film.figure.draw_without_rendering()
    boxes = [label.get_window_extent() for label in labels]
    assert len(labels) <= 18
    assert all(left.x1 <= right.x0 + 2 for left, right in pairwise(boxes))
