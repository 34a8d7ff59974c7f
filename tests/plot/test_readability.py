"""Figures can be read: lines and labels of maps, windows of long motions, legends that fit, numbers at ticks."""

import math

import jax
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from support.plot import MAP_LABELS, line, only, simulate, texts

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax._statistics.estimate import Estimate
from stickslip_jax.plot import _style
from stickslip_jax.plot._trajectory import turns_of

NAMES = {"xlabel": "belt speed (m/s)", "ylabel": "stick duration (s)"}


def overlap(one, other):
    return one.x0 < other.x1 and other.x0 < one.x1 and one.y0 < other.y1 and other.y0 < one.y1


@pytest.mark.parametrize("logs", [{"xlog": True, "ylog": True}, {}])
def test_labels_of_lines_on_a_geometric_grid_do_not_overlap(logs):
    x, y = np.geomspace(0.01, 10, 12), np.geomspace(0.1, 100, 14)
    ax = plot.parameter_map(x, y, 1 / (1 + np.multiply.outer(x, y)), **MAP_LABELS, **logs)
    ax.figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in ax.texts]
    assert len(boxes) >= (3 if logs else 1)
    assert not any(overlap(one, other) for at, one in enumerate(boxes) for other in boxes[:at])
    inside = ax.get_window_extent()
    assert all(inside.x0 <= box.x0 <= box.x1 <= inside.x1 for box in boxes)


def test_lines_are_whole_or_not_there():
    """A ring of one cell is left out; a line through values of slope zero on one side is not cut there."""
    x = np.linspace(-1, 1, 21)
    values = np.minimum(np.add.outer(x, np.zeros(21)), 0.5)
    values[4, 4] += 1
    lines = only(plot.parameter_map(x, x, values, **MAP_LABELS), mpl.contour.ContourSet)
    for level, path in zip(lines.levels, lines.get_paths(), strict=True):
        if -0.9 < level < 0.49:
            heights = path.vertices[:, 1]
            assert (heights.min(), heights.max()) == (-1, 1)
            assert path.vertices[np.abs(path.vertices[:, 1]) > 0.9, 0] == pytest.approx(level)
        if level > 0.5:
            assert not len(path.vertices)


def test_no_colour_of_a_map_is_white_and_darker_is_more():
    red, green, blue, _ = _style.SHADES(np.linspace(0, 1, 50)).T
    gray = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    assert np.all(np.diff(gray) < 0)
    assert gray[0] < 0.9


def test_turns_are_the_extremes_that_a_loop_finds():
    """A wave has two turns in a period; ripples on it smaller than what counts are none."""
    times = np.linspace(0, 10, 2001)
    wave = np.sin(2 * np.pi * times)
    for values in (wave, wave + 0.1 * np.sin(50 * times)):
        found = turns_of(values, 0.5)
        assert len(found) == 20
        assert times[found] == pytest.approx(0.25 + 0.5 * np.arange(20), abs=0.06)
    assert not len(turns_of(times, 0.5))
    assert not len(turns_of(np.zeros(5), 0.0))


@pytest.fixture(scope="module")
def long():
    system = ss.MassSpring(1.0, 4.0, 1.0, ss.Coulomb(1.0))
    return ss.simulate(system, ss.PoissonSwitching(1.0, 1.0).sample(jax.random.key(0), 200.0), t1=200.0, y0=(0.0, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize("draw", [plot.time_history, plot.energies])
def test_of_a_long_motion_the_beginning_is_drawn_and_the_axis_says_so(long, draw):
    upper, lower = draw(long)
    assert upper.get_xlim() == lower.get_xlim() == (0, 50)
    assert lower.get_xlabel() == "time $t$ (s): the first 50 s of 200 s"
    upper, lower = draw(long, window=(0, 200))
    assert upper.get_xlim() == (0, 200)
    assert lower.get_xlabel() == "time $t$ (s)"


@pytest.mark.slow
def test_band_of_needles_is_left_out():
    system = ss.MassSpring(1.0, 40.0, 1.0, ss.Coulomb(0.1))
    times = np.arange(0.0, 9.0, 0.05)
    ground = ss.GroundAcceleration(times, np.random.default_rng(1).normal(size=len(times)))
    one = ss.simulate(system, ground, t1=8.0)
    assert not plot.time_history(one)[0].collections
    (band,) = plot.time_history(one, window=(0.0, 0.5))[0].collections
    assert band.get_label() == "stick possible"
    assert "supplied by ground motion" in texts(plot.energies(one)[1])


def test_numbers_at_ticks_do_not_reach_into_the_legend():
    for scale, offset in ((1e-7, 0.0), (1e7, 0.0), (1e-5, 1000.0), (1.0, 0.0)):
        ax = plot.curve([1.0, 2.0, 3.0], offset + scale * np.array([-1.0, 0.0, 2.0]), label="curve", **NAMES)
        ax.figure.draw_without_rendering()
        assert ax.yaxis.get_offset_text().get_text() == ""
        shown = [text.get_text().replace("$", "").replace("\N{MINUS SIGN}", "-") for text in ax.get_yticklabels()]
        values = [float(text.replace(r"\times10^{", "e").replace("}", "")) for text in shown]
        assert values == pytest.approx(list(ax.get_yticks()), rel=1e-9, abs=1e-9 * scale)


@pytest.mark.parametrize("backend", ["agg", "svg", "pdf"])
def test_long_names_and_legends_stay_in_the_figure(backend):
    plt.switch_backend(backend)
    try:
        long = "a very long name of what is drawn, which runs out of the panel in a single line of text"
        ax = plot.curve([1.0, 2.0], [1.0, 2.0], errors=[0.1, 0.1], xlabel=long, ylabel=rf"{long} $a b$", label=long)
        if backend != "agg":
            ax.figure.set_dpi(72)  # in which these backends measure
        ax.figure.draw_without_rendering()
        whole = ax.figure.bbox
        for box in (ax.get_legend(), ax.xaxis.label, ax.yaxis.label):
            extent = box.get_window_extent()
            assert whole.x0 - 1 <= extent.x0 < extent.x1 <= whole.x1 + 1
            assert whole.y0 - 1 <= extent.y0 < extent.y1 <= whole.y1 + 1
        assert "$a b$" in ax.get_ylabel()
        assert ax.get_xlabel().replace("\n", " ") == long
    finally:
        plt.switch_backend("agg")


def test_curves_of_two_quantities_name_both():
    sticks = [Estimate("mean stick duration", value, 0.1, "s", 10) for value in (1.0, 2.0)]
    slips = [Estimate("mean slip duration", value, 0.1, "s", 10) for value in (3.0, 2.0)]
    ax = plot.curve([1.0, 2.0], sticks, xlabel="rate (1/s)")
    assert texts(ax) == ["bars: 95 % confidence interval"]
    plot.curve([1.0, 2.0], slips, ax=ax)
    assert ax.get_ylabel() == "mean stick duration (s),\nmean slip duration (s)"
    assert texts(ax) == ["mean stick duration (s)", "mean slip duration (s)", "bars: 95 % confidence interval"]
    # A name of the user's own stays, until there is another one.
    ax = plot.curve([1.0, 2.0], sticks, xlabel="rate (1/s)", ylabel="duration (s)")
    plot.curve([1.0, 2.0], slips, ax=ax)
    assert ax.get_ylabel() == "duration (s)"
    plot.curve([1.0, 2.0], slips, ylabel="time (s)", ax=ax)
    assert ax.get_ylabel() == "time (s)"


def test_means_of_small_positions_have_their_legend_above():
    many = simulate(20)
    ax = plot.means_by_order(many)
    ax.figure.draw_without_rendering()
    assert texts(ax)[0] == "mean; bars: 95 % confidence interval"
    assert math.isclose(ax.get_legend().get_window_extent().y0, ax.get_window_extent().y1, abs_tol=8)
    assert line(ax, "_mean").get_linestyle() == "None"
