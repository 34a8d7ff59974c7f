"""All figures are called alike; those that take several kinds of result draw each kind as it should be."""

import inspect

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from support.plot import MAP_LABELS, band_of, line, mesh, simulate, steps, texts

import stickslip_jax as ss
from stickslip_jax import plot

NO_FIGURES = {"save", "animate"}  # a film has a figure of its own
FIGURES = [getattr(plot, name) for name in plot.__all__ if name[0].islower() and name not in NO_FIGURES]
FIRST = {
    "result": "what was simulated",
    "results": "several",
    "parameter_values": "a curve",
    "x": "a map",
    "system": "known without it",
    "law": "its characteristic",
}


@pytest.fixture(scope="module")
def many():
    return simulate(200)


@pytest.mark.parametrize("draw", FIGURES)
def test_figures_are_called_alike(draw):
    """First the result, or the parameter's values; last, by keyword, where to draw, which need not be given."""
    first, *_, last = inspect.signature(draw).parameters.values()
    assert first.name in FIRST
    assert last.name in ("ax", "axes")
    assert last.kind is inspect.Parameter.KEYWORD_ONLY
    assert last.default is None
    returned = str(inspect.signature(draw).return_annotation)
    assert ("tuple" in returned) == (last.name == "axes")
    assert f"\n        {last.name}: " in draw.__doc__


@pytest.mark.parametrize("draw", FIGURES)
def test_figures_do_not_hide_modules(draw):
    assert draw.__module__.rpartition(".")[2].startswith("_")
    assert inspect.isfunction(getattr(plot, draw.__name__))


@pytest.mark.slow
def test_histogram_of_an_ensemble_leaves_out_cut_sticks(many):
    """The distribution has all sticks, with errors and mean; the ensemble the complete ones."""
    every = plot.histogram(many.statistics.duration, bins=20)
    complete = plot.histogram(many, bins=20)
    sticks = many.numbered_sticks()
    kept = sticks.duration[sticks.ending != ss.Ending.HORIZON]
    assert len(kept) < len(sticks.duration)
    heights, edges = steps(complete)
    assert (edges[0], edges[-1]) == (0, kept.max())
    assert heights == pytest.approx(np.histogram(kept, edges, density=True)[0])
    assert (len(every.containers), len(complete.containers)) == (1, 0)
    assert complete.get_xlabel() == every.get_xlabel() == "stick duration (s)"
    assert complete.get_ylabel() == every.get_ylabel() == "probability density (1/s)"


@pytest.mark.slow
@pytest.mark.parametrize("bins", [12, (12, [0.0, 0.2, 0.5])])
def test_joint_histogram_of_sticks_has_sides(many, bins):
    main, above, right = plot.joint_histogram(many, bins=bins)
    density, *edges = mesh(main)
    shares = np.ma.filled(density, 0) * np.outer(*map(np.diff, edges))
    for axis, side in enumerate((above, right)):
        heights, own = steps(side)
        assert own == pytest.approx(edges[axis])
        assert heights * np.diff(own) == pytest.approx(shares.sum(axis=1 - axis))
        assert not side.containers
    assert (above.get_ylabel(), right.get_xlabel()) == ("probability\ndensity (1/m)", "probability\ndensity (1/s)")
    assert (main.get_xlabel(), main.get_ylabel()) == ("position $x$ where the stick begins (m)", "stick duration (s)")
    assert main.get_xlim() == above.get_xlim()
    assert main.get_ylim() == right.get_ylim()
    assert main.get_legend() is None
    main.figure.draw_without_rendering()
    legend, axes, figure = above.get_legend().get_window_extent(), above.get_window_extent(), above.figure.bbox
    assert axes.y1 <= legend.y0 < legend.y1 <= figure.y1 + 1


@pytest.mark.slow
def test_joint_histogram_alone(many):
    """In one axes the joint histogram is the same, and has the legend itself."""
    joint = many.statistics.joint("duration", "position")
    ax = mpl.figure.Figure(layout="constrained").subplots()
    assert plot.joint_histogram(joint, axes=ax, conditional_mean=True) == (ax,)
    three = plot.joint_histogram(joint, conditional_mean=True)
    assert np.array_equal(*(np.ma.filled(mesh(main)[0], -1) for main in (ax, three[0])))
    assert texts(ax) == texts(three[1])
    assert (ax.get_xlim(), ax.get_ylim()) == (three[0].get_xlim(), three[0].get_ylim())


def test_stick_fractions_of_any_parameter_and_kind_in_one_figure(many):
    """Numbers, distributions and estimates are in percent in the same axes, each with its own band."""
    speeds, look = [-1.0, 1.0], {"xlabel": "belt speed (m/s)"}
    ax = plot.stick_fraction_curve(speeds, np.array([0.1, 0.2]), errors=(0.05, 0.1), label="numbers", **look)
    assert band_of(ax) == {-1: pytest.approx((5, 15)), 1: pytest.approx((10, 30))}
    plot.stick_fraction_curve(speeds, [many.statistics.stick_fraction] * 2, ax=ax, **look)
    plot.stick_fraction_curve(speeds, [ss.stick_fraction(many)] * 2, label="estimate", band_label="t", ax=ax, **look)
    percent = 100 * many.statistics.stick_fraction.mean.value
    assert line(ax, "mean").get_ydata() == pytest.approx([percent] * 2)
    assert line(ax, "estimate").get_ydata() == pytest.approx([percent] * 2)
    assert texts(ax) == ["numbers", "mean", "estimate", "95 % of the realisations", "t"]
    assert len({drawn.get_color() for drawn in ax.lines}) == 3
    assert ax.get_xlabel() == "belt speed (m/s)"
    assert plot.stick_fraction_curve([1.0, 2.0], [0.1, 0.2]).get_legend() is None


def test_figures_are_saved_and_closed(many, tmp_path):
    for number, axes in enumerate((plot.histogram(many), plot.joint_histogram(many), list(plt.subplots(1, 2)[1]))):
        plot.save(axes, tmp_path / f"{number}.png", title="title", dpi=40.0)
        assert (tmp_path / f"{number}.png").stat().st_size > 0
    assert plt.get_fignums() == []
    with pytest.raises(OSError, match="missing"):
        plot.save(plot.histogram(many), tmp_path / "missing" / "figure.png")
    assert plt.get_fignums() == []


@pytest.mark.slow
def test_bad_combinations(many, annotations_unchecked):
    """What one kind of result takes and another does not is refused by name, with what to do."""
    statistics = many.statistics
    joint, fractions = statistics.joint("duration", "position"), [statistics.stick_fraction]
    curve, both = plot.stick_fraction_curve, plot.joint_histogram
    wrong = [
        (
            plot.histogram,
            (statistics.duration,),
            {"bins": [0.0, 1.0]},
            r"bins must .*histogram\(ensemble, bins=edges\)",
        ),
        (plot.histogram, (many,), {"bins": [1.0, 0.0]}, r"bins must be .* increasing edges \(in s\)"),
        (plot.histogram, ("many",), {}, "result must be a result of .* Distribution such as .*, but 'many' was given"),
        (both, (joint,), {"bins": (4, 5)}, r"bins must be a whole number for a joint.* bins of your own go with"),
        (both, (joint,), {"bins": np.array([0.0, 1.0])}, "bins must be a whole number for a joint"),
        (both, (joint,), {"system": many.system}, r"system must be left out .* joint_histogram\(ensemble\)"),
        (both, (joint,), {"bound": ss.SourceVoltage()}, "bound must be left out"),
        (both, (joint,), {"period": np.pi}, "period must be left out"),
        (both, (many,), {"conditional_mean": True}, "conditional_mean must be False for sticks"),
        (both, (many,), {"conditional_mean": 1}, "conditional_mean must be True or False"),
        (both, (many,), {"axes": "here"}, r"axes must hold three matplotlib Axes .*, or be one, but 'here'"),
        (both, (many,), {"axes": plt.subplots(3, 1, squeeze=False)[1]}, "axes must hold three matplotlib Axes"),
        (curve, ([1.0], fractions), {"errors": [0.1]}, "errors must be left out with distributions and estimates"),
        (curve, ([1.0], [*fractions, 0.5]), {}, "fractions must hold stick fractions, either"),
        (curve, ([0.0], fractions), {}, "parameter_values must hold positive frequency ratios.* xlabel"),
        (curve, ([1.0], [0.5]), {"level": 2.0}, "level must lie between 0 and 1"),
        (curve, ([1.0], [0.5]), {"band_label": 1}, "band_label must be a string"),
        (curve, ([1.0], [0.5]), {"xlabel": 1}, "xlabel must be a string"),
        (plot.parameter_map, ("x", [1, 2], np.ones((2, 2))), MAP_LABELS, "x must be a one-dimensional sequence"),
        (plot.save, (plot.histogram, "figure.png"), {}, "axes must be a matplotlib Axes or hold several"),
        (plot.save, ([], "figure.png"), {}, "axes must be a matplotlib Axes or hold several"),
    ]
    for draw, arguments, options, message in wrong:
        with pytest.raises(ValueError, match=f"Argument {message}"):
            draw(*arguments, **options)
    with pytest.raises(ValueError, match='keep="statistics"'):
        plot.means_by_order(simulate(2, keep="totals"))
