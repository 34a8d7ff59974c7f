"""Figures of where sticks happen and how long they last: every complete stick once, under the closed-form bound."""

import dataclasses

import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest

mpl.use("Agg")

import matplotlib.pyplot as plt

import stickslip_jax as ss
from stickslip_jax import papers, plot
from stickslip_jax.plot import _style

MASS = ss.MassSpring(mass=1.0, stiffness=4.0, normal_force=1.0, friction=ss.Coulomb(mu=1.0))
FULL_CIRCLE = 2 * np.pi


@pytest.fixture(scope="module")
def many():
    """The motor and cart of the paper, at the larger friction."""
    setup = papers.motor_cart(0.5, t1=1.5)
    return ss.simulate_ensemble(
        setup.system, setup.law, t1=setup.t1, y0=setup.y0, samples=150, key=jax.random.key(2), keep="sticks", threads=1
    )


@pytest.fixture(scope="module")
def one():
    """A mass on a base that switches."""
    law, t1 = ss.PoissonSwitching(speed=1.0, rate=1.0), 40.0
    return ss.simulate(MASS, law.sample(jax.random.key(3), t1), t1=t1, y0=(0.0, 1.0))


def line(ax, label):
    (found,) = [drawn for drawn in ax.lines if drawn.get_label() == label]
    return found


def filled(simulation, name):
    return np.asarray(getattr(simulation.sticks, name))[np.asarray(simulation.sticks.mask)]


def points_of(ax):
    """Position and duration of each point of a map."""
    (drawn,) = [drawn for drawn in ax.collections if isinstance(drawn, mpl.collections.PathCollection)]
    return np.asarray(drawn.get_offsets())


def mesh_of(ax):
    """Density (positions, durations) and edges of a joint histogram."""
    (mesh,) = [drawn for drawn in ax.collections if isinstance(drawn, mpl.collections.QuadMesh)]
    corners = mesh.get_coordinates()
    return np.ma.filled(mesh.get_array(), 0).T, corners[0, :, 0], corners[:, 0, 1]


@pytest.mark.slow
def test_map_shows_every_complete_first_stick_below_the_bound(many):
    first = ss.first_stick(many)
    ax = plot.stick_map(first, system=many.system, bound=many.law)
    drawn = points_of(ax)
    complete = first.mask & (first.ending != ss.Ending.HORIZON)
    assert len(drawn) == complete.sum() > 100
    assert drawn[:, 0] == pytest.approx(np.mod(first.position[complete], FULL_CIRCLE))
    assert drawn[:, 1] == pytest.approx(first.duration[complete])
    angles, longest = line(ax, "longest possible, closed form").get_data()
    assert np.asarray(ss.stick_duration_bound(many.system, many.law.signal, angles)) == pytest.approx(longest)
    # The bound holds but for the transient of the current, whose time is inductance / resistance.
    transient = many.system.inductance / many.system.resistance
    assert np.all(drawn[:, 1] < np.interp(drawn[:, 0], angles, longest) + transient)
    assert np.max(drawn[:, 1]) > 0.9 * np.max(longest)
    assert (angles[0], angles[-1]) == ax.get_xlim() == (0, FULL_CIRCLE)


@pytest.mark.slow
def test_map_of_all_sticks_in_half_a_circle(many):
    ax = plot.stick_map(many, period=np.pi)
    flat = many.numbered_sticks()
    complete = flat.ending != ss.Ending.HORIZON
    assert points_of(ax)[:, 0] == pytest.approx(np.mod(flat.position[complete], np.pi))
    assert points_of(ax)[:, 1] == pytest.approx((flat.end - flat.start)[complete])
    assert ax.get_xlim() == (0, np.pi)
    assert [tick.get_text() for tick in ax.get_xticklabels()][-1] == r"$\pi$"
    (text,) = ax.get_legend().get_texts()
    assert text.get_text() == f"{complete.sum():,} sticks ({np.sum(~complete):,} more, cut by the end, left out)"


@pytest.mark.slow
def test_map_shades_where_the_cart_can_stick_for_ever(many):
    voltage = ss.SourceVoltage(amplitude=0.3)
    ax = plot.stick_map(many, bound=voltage)
    angles, longest = line(ax, "longest possible, closed form").get_data()
    endless = np.isinf(np.asarray(ss.stick_duration_bound(many.system, voltage, angles)))
    assert np.any(endless)
    assert np.array_equal(np.isnan(longest), endless)
    assert "sticks of any duration" in [text.get_text() for text in ax.get_legend().get_texts()]


@pytest.mark.slow
def test_map_and_joint_histogram_of_a_mass(one):
    complete = filled(one, "ending") != ss.Ending.HORIZON
    ax = plot.stick_map(one)
    assert (
        points_of(ax).tolist() == np.column_stack([filled(one, "position"), filled(one, "duration")])[complete].tolist()
    )
    assert ax.get_xlabel() == "position $x$ where the stick begins (m)"
    ax, *_ = plot.joint_histogram(one, bins=5)
    density, positions, durations = mesh_of(ax)
    assert np.sum(density * np.outer(np.diff(positions), np.diff(durations))) == pytest.approx(1)
    assert (positions[0], positions[-1]) == (np.min(filled(one, "position")), np.max(filled(one, "position")))
    assert ax.figure.axes[-1].get_ylabel() == "probability density (1/(m s))"


@pytest.mark.slow
@pytest.mark.parametrize("log", [False, True])
def test_joint_histogram_has_total_probability_one(many, log):
    first = ss.first_stick(many)
    ax, *_ = plot.joint_histogram(first, system=many.system, bound=many.law, log=log)
    density, angles, durations = mesh_of(ax)
    areas = np.outer(np.diff(angles), np.diff(durations))
    assert density.shape == (40, 40)
    assert np.sum(density * areas) == pytest.approx(1)
    counts, *_ = np.histogram2d(np.mod(first.position, FULL_CIRCLE), first.duration, (angles, durations))
    assert density * areas * first.count == pytest.approx(counts)
    assert (angles[0], angles[-1]) == (0, FULL_CIRCLE)
    assert durations[-1] == np.max(first.duration)
    assert ax.figure.axes[-1].get_ylabel() == "probability density (1/(rad s))"
    assert line(ax, "longest possible, closed form").get_color() == _style.MASS


@pytest.mark.slow
def test_joint_histogram_with_given_edges_stays_a_density(many):
    first = ss.first_stick(many)
    edges = [0.1, 0.2, 0.4]
    ax, above, _ = plot.joint_histogram(first, system=many.system, bins=(8, edges))
    density, angles, durations = mesh_of(ax)
    inside = (first.duration >= 0.1) & (first.duration <= 0.4)
    assert durations.tolist() == edges
    assert np.sum(density * np.outer(np.diff(angles), np.diff(durations))) == pytest.approx(np.mean(inside))
    assert f"{np.sum(~inside):,} of them outside the bins" in above.get_legend().get_texts()[0].get_text()


@pytest.mark.slow
def test_durations_of_first_sticks_and_of_a_motor(many):
    first = ss.first_stick(many)
    texts = plot.histogram(first).get_legend().get_texts()
    assert texts[0].get_text() == f"{np.sum(first.ending != ss.Ending.HORIZON):,} sticks"
    complete = np.sum(many.numbered_sticks().ending != ss.Ending.HORIZON)
    assert plot.histogram(many).get_legend().get_texts()[0].get_text().startswith(f"{complete:,} sticks")


@pytest.mark.slow
def test_no_sticks_are_noted(many):
    none = np.full(3, np.nan)
    first = ss.FirstSticks(none, none, none, np.full(3, -1), np.zeros(3, bool))
    for ax in (
        plot.stick_map(first, system=many.system, bound=many.law),
        plot.joint_histogram(first, system=many.system)[0],
        plot.joint_histogram(first, system=MASS)[0],
        plot.histogram(first),
    ):
        assert [text.get_text() for text in ax.texts] == ["no sticks"]
        assert ax.get_xlabel()


def test_one_stick_is_drawn():
    first = ss.FirstSticks(*(np.array([value]) for value in (0.5, 0.1, 0.3, 0, True)))
    density, *edges = mesh_of(plot.joint_histogram(first, system=MASS, log=True)[0])
    assert np.sum(density * np.outer(*map(np.diff, edges))) == pytest.approx(1)
    plt.gcf().draw_without_rendering()


def panels_of(drawn):
    return drawn if isinstance(drawn, tuple) else (drawn,)


@pytest.mark.slow
@pytest.mark.parametrize("draw", [plot.stick_map, plot.joint_histogram])
def test_axes_name_quantity_and_unit_and_legends_hide_nothing(many, draw):
    ax, *sides = panels_of(draw(many, bound=many.law))
    assert ax.get_xlabel() == r"angle $\alpha$ of the stick, modulo $2\pi$ (rad)"
    assert ax.get_ylabel() == "stick duration (s)"
    ax.figure.draw_without_rendering()
    top = sides[0] if sides else ax
    legend, axes, figure = top.get_legend().get_window_extent(), top.get_window_extent(), top.figure.bbox
    assert axes.y1 <= legend.y0 < legend.y1 <= figure.y1 + 1
    assert figure.x0 - 1 <= legend.x0 < legend.x1 <= figure.x1 + 1


@pytest.mark.slow
def test_given_axes_are_used(one):
    ax, *axes = mpl.figure.Figure().subplots(1, 5)
    assert plot.stick_map(one, ax=ax) is ax
    assert plot.joint_histogram(one, axes=axes[0]) == (axes[0],)
    assert plot.joint_histogram(one, axes=axes[1:]) == tuple(axes[1:])
    assert axes[1].get_xlim() == axes[2].get_xlim()
    assert axes[1].get_ylim() == axes[3].get_ylim()
    assert plt.get_fignums() == []


@pytest.mark.slow
def test_bad_arguments(one, many, annotations_unchecked):
    first = ss.first_stick(many)
    few = dataclasses.replace(many, flat_sticks=None, retained=None)
    batch = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 3), one)
    object.__setattr__(batch, "system", ss.MotorCart(mu=0.5))
    object.__setattr__(batch.system, "mu", jnp.full(3, 0.5))
    maps, joint = plot.stick_map, plot.joint_histogram
    wrong = [
        (maps, ([0.1],), {}, "result must be a result of simulate_ensemble or of simulate, or of first_stick"),
        (maps, (few,), {}, 'keep="sticks"'),
        (maps, (first,), {}, "system must be given with FirstSticks"),
        (maps, (first,), {"system": "cart"}, "system must be a MassSpring, a MotorCart"),
        (maps, (many,), {"system": MASS}, "system must be the MotorCart that was simulated"),
        (maps, (many,), {"bound": 0.5}, "bound must be a SourceVoltage"),
        (maps, (first,), {"system": MASS, "bound": many.law}, "bound .*given for a MotorCart only"),
        (maps, (batch,), {"bound": many.law}, r"system must be given with the bound.* shape \(3,\)"),
        (maps, (many,), {"period": 3.0}, r"period must be pi or 2 pi \(in rad\)"),
        (maps, (first,), {"system": MASS, "period": np.pi}, "period .*given for a MotorCart only"),
        (maps, (many,), {"ax": "here"}, "ax must be a matplotlib Axes"),
        (joint, (many,), {"log": 1}, "log must be True or False"),
        (joint, (many,), {"bins": 0}, r"bins\[0\] must be a whole number of at least 1"),
        (joint, (many,), {"bins": 2.5}, "bins must be a whole number, or two"),
        (joint, (many,), {"bins": (3, [0.2, 0.1])}, r"bins\[1\] must be .* edges \(in s\)"),
    ]
    for draw, arguments, options, message in wrong:
        with pytest.raises(ValueError, match=f"Argument {message}" if "keep" not in message else message):
            draw(*arguments, **options)
    ax = plot.stick_map(batch, system=many.system, bound=many.law)
    assert len(points_of(ax)) == 3 * np.sum(filled(one, "ending") != ss.Ending.HORIZON)
