"""Curves with error bars, maps from labelled arrays, and histograms in one axes: the numbers drawn, looks, labels."""

import math

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr
from scipy import stats
from support.plot import MAP_LABELS, band_of, line, mesh, only, simulate, texts

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax.plot import _style

SPEEDS = np.array([2.0, 0.5, 1.0])
NAMES = {"xlabel": "belt speed (m/s)", "ylabel": "stick duration (s)"}


@pytest.fixture(scope="module")
def ensembles():
    return [simulate(200, speed=float(speed)) for speed in SPEEDS]


def labeled(values, errors=None):
    """A data set of a duration over the speed, or over speed and friction."""
    coordinates = {
        "speed": ("speed", SPEEDS, {"long_name": "belt speed", "units": "m/s"}),
        "mu": ("mu", [0.2, 0.4], {"long_name": "friction coefficient", "units": "1"}),
    }
    dimensions = ("speed", "mu")[: np.ndim(values)]
    variables = {"duration": (dimensions, values, {"long_name": "stick duration", "units": "s"})}
    if errors is not None:
        variables["duration_error"] = (dimensions, errors)
    return xr.Dataset(variables, {name: coordinates[name] for name in dimensions})


def bars_of(ax):
    """Abscissa, lower and upper end of all error bars."""
    ends = [np.array(container.lines[2][0].get_segments()) for container in ax.containers]
    return [(one[:, 0, 0], one[:, 0, 1], one[:, 1, 1]) for one in ends]


def curves(ax):
    return [drawn for drawn in ax.lines if np.size(drawn.get_xdata()) and drawn.get_linestyle() != "None"]


def test_curve_of_estimates(ensembles):
    estimates = [ss.mean_stick_duration(many) for many in ensembles]
    ax = plot.curve(SPEEDS, estimates, xlabel="belt speed (m/s)", label="mean")
    order = [1, 2, 0]
    drawn = line(ax, "mean")
    assert drawn.get_xdata().tolist() == [0.5, 1, 2]
    assert drawn.get_ydata().tolist() == [estimates[place].value for place in order]
    ((x, low, high),) = bars_of(ax)
    assert x.tolist() == [0.5, 1, 2]
    assert np.column_stack([low, high]) == pytest.approx(np.array([estimates[place].interval(0.95) for place in order]))
    assert texts(ax) == ["mean", "bars: 95 % confidence interval"]
    assert [ax.get_xlabel(), ax.get_ylabel()] == ["belt speed (m/s)", "mean stick duration (pooled) (s)"]
    # Another one into the same axes: another look, the names of both, what the bars are is said once and last.
    same = plot.curve(SPEEDS, [many.statistics.duration.median for many in ensembles], label="median", ax=ax)
    assert same is ax
    assert texts(ax) == ["mean", "median", "bars: 95 % confidence interval"]
    assert ax.get_ylabel() == "mean stick duration (pooled) (s),\nmedian of stick duration (s)"
    first, second = curves(ax)
    assert first.get_color() != second.get_color()


def test_one_standard_error_and_bands(ensembles):
    estimates = [many.statistics.duration.mean for many in ensembles]
    ax = plot.curve(SPEEDS, estimates, level=None, uncertainty="band", xlabel="speed (m/s)")
    for speed, one in zip(SPEEDS, estimates, strict=True):
        ends = (one.value - one.standard_error, one.value + one.standard_error)
        assert band_of(ax)[speed] == pytest.approx(ends)
    assert texts(ax) == ["band: one standard error"]


def test_curve_of_numbers():
    values, errors = [3.0, math.nan, 1.0], [0.3, 0.2, 0.1]
    ax = plot.curve(SPEEDS, values, errors=errors, level=0.95, **NAMES)
    assert np.array_equal(curves(ax)[0].get_ydata(), [math.nan, 1, 3], equal_nan=True)
    ((x, low, high),) = bars_of(ax)
    assert x.tolist() == [1, 2]
    half_width = stats.norm.ppf(0.975) * np.array([0.1, 0.3])
    assert high - low == pytest.approx(2 * half_width)
    assert plot.curve(SPEEDS, values, **NAMES).get_legend() is None
    nothing = plot.curve(SPEEDS, [math.nan] * 3, **NAMES)
    assert [text.get_text() for text in nothing.texts] == ["no values"]
    nothing.figure.draw_without_rendering()


def test_curves_of_labeled_arrays():
    values = np.array([[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]])
    data = labeled(values, 0.1 * values)
    ax = plot.curve(data, "duration", level=None)
    assert [drawn.get_ydata().tolist() for drawn in curves(ax)] == [[2, 3, 1], [5, 6, 4]]
    assert [drawn.get_xdata().tolist() for drawn in curves(ax)] == [[0.5, 1, 2]] * 2
    for number, (_, low, high) in enumerate(bars_of(ax)):
        assert (low + high) / 2 == pytest.approx(values[[1, 2, 0], number])
        assert (high - low) / 2 == pytest.approx(0.1 * values[[1, 2, 0], number])
    assert texts(ax) == ["friction coefficient = 0.2", "friction coefficient = 0.4", "bars: one standard error"]
    assert [ax.get_xlabel(), ax.get_ylabel()] == ["belt speed (m/s)", "stick duration (s)"]
    # Along the other dimension; errors as an array with its dimensions in another order; units of the curves.
    ax = plot.curve(data.duration, errors=data.duration_error.T, level=None, along="mu", label="a")
    assert [drawn.get_ydata().tolist() for drawn in curves(ax)] == [[2, 5], [3, 6], [1, 4]]
    assert (bars_of(ax)[0][2] - bars_of(ax)[0][1]) / 2 == pytest.approx([0.2, 0.5])
    assert texts(ax)[0] == "a, belt speed = 0.5 m/s"
    # One dimension; a variable named by the convention of CF; without any error.
    single = labeled(values[:, 0]).assign(spread=("speed", [0.1, 0.2, 0.3]))
    single.duration.attrs["ancillary_variables"] = "spread"
    ((_, low, high),) = bars_of(plot.curve(single, "duration", level=None))
    assert (high - low) / 2 == pytest.approx([0.2, 0.3, 0.1])
    assert plot.curve(single.duration).get_legend() is None


def test_statistics_of_an_ensemble_are_drawn_by_name(many):
    ax = plot.curve(many.statistics.to_xarray(), "duration_by_order", level=None)
    mean = many.statistics.order(1).duration.mean
    assert curves(ax)[0].get_ydata()[0] == pytest.approx(mean.value)
    ((_, low, high),) = bars_of(ax)
    assert (high - low)[0] / 2 == pytest.approx(mean.standard_error)


def test_logarithmic_curves():
    ax = plot.curve(SPEEDS, [1.0, 0.0, 10.0], errors=[2.0, 0.1, 1.0], xlog=True, ylog=True, label="a", **NAMES)
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert np.array_equal(curves(ax)[0].get_ydata(), [math.nan, 10, 1], equal_nan=True)
    assert texts(ax)[0] == "a (1 value of zero or less left out)"
    for uncertainty in ("bars", "band"):
        ax = plot.curve(
            SPEEDS, [1.0, 0.5, 10.0], errors=[2.0, 0.1, 1.0], ylog=True, uncertainty=uncertainty, **NAMES
        )  # fmt: skip
        ax.figure.draw_without_rendering()
        low, high = ax.get_ylim()
        assert 1e-3 < low < 0.5
        assert 10 < high < 100
    ax = plot.curve([0.3, 3.0], [1.0, 2.0], xlog=True, **NAMES)
    ax.figure.draw_without_rendering()
    shown = [text.get_text() for text in ax.get_xticklabels() if 0.3 <= text.get_position()[0] <= 3]
    assert shown == ["0.5", "1", "2"]
    assert not any(text.get_text() for text in ax.get_xticklabels(minor=True))


def test_twenty_curves_look_different():
    ax = plot.curve([0.0, 1.0], [0.0, 0.0], **NAMES)
    for number in range(1, 20):
        plot.curve([0.0, 1.0], [0.0, number], ax=ax)
    looks = {(drawn.get_color(), drawn.get_linestyle()) for drawn in curves(ax)}
    assert len(looks) == 20
    assert _style.STICK not in {color for color, _ in looks}


def test_bad_curves(many, annotations_unchecked):
    duration, fraction = many.statistics.duration.mean, ss.stick_fraction(many)
    data = labeled(np.ones((3, 2)))
    wrong = [
        ((SPEEDS, [1.0, 2.0]), NAMES, "y must have the length 3 of x, but it has 2"),
        ((SPEEDS, [duration] * 2), NAMES, "y must have the length 3 of x, but it has 2"),
        ((SPEEDS, [duration, duration, 1.0]), NAMES, "y must hold estimates or numbers only"),
        ((SPEEDS, [duration, duration, fraction]), NAMES, "y must hold estimates of one unit, but 1, s were given"),
        ((SPEEDS, [duration] * 3), {"xlabel": "x", "errors": [0.1] * 3}, "errors must be left out with estimates"),
        ((SPEEDS, [duration] * 3), {}, "xlabel must be given, the name of the axis with its unit"),
        ((SPEEDS, [1.0, 2.0, 3.0]), {"xlabel": "x"}, "ylabel must be given"),
        ((SPEEDS, [1.0, math.inf, 3.0]), NAMES, "y must be finite"),
        ((SPEEDS, None), NAMES, "y must be a one-dimensional"),
        ((SPEEDS, [1.0] * 3), {**NAMES, "errors": [0.1, -0.1, 0.1]}, "errors must hold numbers of zero or more in"),
        ((SPEEDS, [1.0] * 3), {**NAMES, "errors": [0.1]}, "errors must hold numbers of zero or more in the shape"),
        ((SPEEDS, [1.0] * 3), {**NAMES, "level": 1.5}, "level must lie between 0 and 1"),
        ((SPEEDS, [1.0] * 3), {**NAMES, "uncertainty": "box"}, "uncertainty must be one of 'bars', 'band', but 'box'"),
        ((SPEEDS, [1.0] * 3), {**NAMES, "label": 3}, "label must be a string, but 3 was given"),
        ((SPEEDS - 1, [1.0] * 3), {**NAMES, "xlog": True}, "x must hold positive numbers on a logarithmic axis"),
        ((data, "length"), {}, "y must be the name of a variable of the Dataset, one of duration, but 'length'"),
        ((data, "duration"), {"errors": "spread"}, "errors must be the name of a variable of the Dataset"),
        ((data.duration, "duration"), {}, "y must be left out with a DataArray"),
        ((data.duration,), {"along": "rate"}, "along must be one of the dimensions speed, mu, but 'rate'"),
        ((data.duration.expand_dims("rate"),), {}, "x must have 1 or 2 dimensions, but an array with 3 was given"),
        ((data.duration.assign_coords(mu=["a", "b"]),), {}, "x must have numbers as coordinates, but mu holds"),
    ]
    for arguments, options, message in wrong:
        with pytest.raises(ValueError, match=f"Argument {message}"):
            plot.curve(*arguments, **options)


def test_map_of_a_labeled_array():
    values = np.array([[1.0, 4.0], [2.0, 5.0], [3.0, math.nan]])
    ax = plot.parameter_map(labeled(values).duration, contours=False)
    drawn, x, y = mesh(ax)
    assert np.array_equal(np.ma.filled(drawn, math.nan), values[[1, 2, 0]], equal_nan=True)
    assert (x.tolist(), y.tolist()) == ([0.25, 0.75, 1.5, 2.5], pytest.approx([0.1, 0.3, 0.5]))
    names = [ax.get_xlabel(), ax.get_ylabel(), ax.figure.axes[-1].get_ylabel()]
    assert names == ["belt speed (m/s)", "friction coefficient", "stick duration (s)"]
    assert plot.parameter_map(labeled(values), "duration", label="mean (s)").figure.axes[-1].get_ylabel() == "mean (s)"


def test_uncertain_cells_have_dots():
    values = np.array([[1.0, 4.0], [2.0, 0.0], [3.0, 6.0]])
    errors = np.array([[0.05, 0.7], [math.nan, 0.0], [0.3, 0.7]])
    for arguments, options in (
        ((labeled(values, errors), "duration"), {}),
        ((SPEEDS[[1, 2, 0]], [0.2, 0.4], values[[1, 2, 0]]), {"errors": errors[[1, 2, 0]], **MAP_LABELS}),
    ):
        ax = plot.parameter_map(*arguments, contours=False, **options)
        dotted = only(ax, mpl.collections.PolyCollection)
        centers = sorted(np.mean(path.get_extents().get_points(), axis=0).tolist() for path in dotted.get_paths())
        # At speed 0.5 the error is not known, at 2.0 it is 0.7 of 4, at 1.0 it is 0.7 of 6 and just 0.1 of 3.
        assert centers == [pytest.approx((0.5, 0.2)), pytest.approx((1.125, 0.4)), pytest.approx((2.0, 0.4))]
        assert texts(ax) == ["standard error above 10 % of the value, or not known"]
    sure = plot.parameter_map(labeled(values, 0 * values), "duration", error_share=0.02)
    assert sure.get_legend() is None


def test_maps_with_one_scale_of_colours():
    values = np.array([[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]])
    maps = [plot.parameter_map([1, 2, 3], [1, 2], scale * values, limits=(0, 6), **MAP_LABELS) for scale in (1, 0.1)]
    norms = [only(ax, mpl.collections.QuadMesh).norm for ax in maps]
    assert [(norm.vmin, norm.vmax) for norm in norms] == [(0, 6), (0, 6)]
    beyond = plot.parameter_map([1, 2, 3], [1, 2], values, limits=(2, 5), log=True, **MAP_LABELS)
    assert only(beyond, mpl.collections.QuadMesh).colorbar.extend == "both"


def test_logarithmic_maps():
    x, y = np.geomspace(0.1, 10.0, 5), np.array([1.0, 2.0, 3.0])
    values = np.outer(x, y)
    values[0, 0] = -1.0
    ax = plot.parameter_map(x, y, values, xlog=True, log=True, **MAP_LABELS)
    drawn, x_edges, y_edges = mesh(ax)
    assert list(x_edges) == pytest.approx(list(np.geomspace(0.1 / 10**0.25, 10 * 10**0.25, 6)))
    assert list(y_edges) == pytest.approx([0.5, 1.5, 2.5, 3.5])
    assert ax.get_xscale() == "log"
    assert ax.get_xlim() == pytest.approx((x_edges[0], x_edges[-1]))
    assert drawn.mask.sum() == 1
    assert texts(ax) == ["no positive value"]
    colors = only(ax, mpl.collections.QuadMesh).norm
    assert isinstance(colors, mpl.colors.LogNorm)
    assert (colors.vmin, colors.vmax) == pytest.approx((0.2, 30))
    ax.figure.draw_without_rendering()


@pytest.mark.parametrize("known", [False, True])
def test_contours_leave_out_flat_regions(known):
    """Two plateaus with noise, and a slope between them: lines run along the slope alone, and all along it."""
    rng = np.random.default_rng(3)
    x, y = np.linspace(0, 4, 41), np.linspace(0, 3, 31)
    middle = 2 + 0.3 * y
    noise = 0.03 if known else 0.004
    values = 1.2 / (1 + np.exp(-6 * (x[:, None] - middle))) - 0.2 + noise * rng.normal(size=(41, 31))
    errors = {"errors": np.full(values.shape, noise)} if known else {}
    ax = plot.parameter_map(x, y, values, **MAP_LABELS, **errors)
    lines = only(ax, mpl.contour.ContourSet)
    assert {0.0, 0.4, 0.8} <= set(np.round(lines.levels, 9))
    for level, path in zip(lines.levels, lines.get_paths(), strict=True):
        across, up = path.vertices.T
        if -0.1 < level < 0.9:  # -0.2 and 1.0 are the heights of the plateaus
            exact = 2 + 0.3 * up - np.log(1.2 / (level + 0.2) - 1) / 6
            # The noise moves a line by itself over the slope, 6 p (1 - p) per unit, and interpolation by a few 0.01.
            share = (level + 0.2) / 1.2
            assert np.abs(across - exact).max() < 5 * noise / (7.2 * share * (1 - share)) + 0.03
            assert np.ptp(up) > 2.8
        else:
            assert np.abs(across - (2 + 0.3 * up)).max(initial=0) < 1
    # The same map, were it not for the flat regions, has lines all over the plateaus.
    everywhere = ax.contour(x, y, values.T, levels=[1.0])
    assert everywhere.get_paths()[0].vertices[:, 0].max() > 3.9


def test_bad_maps(annotations_unchecked):
    values, data = np.ones((2, 2)), labeled(np.ones((3, 2)))
    plain = ([1.0, 2.0], [1.0, 2.0], values)
    wrong = [
        (([0.0, 2.0], [1.0, 2.0], values), {**MAP_LABELS, "xlog": True}, "x must hold positive numbers on a logarithm"),
        (plain, {**MAP_LABELS, "errors": -values}, "errors must hold numbers of zero or more in the shape"),
        (plain, {**MAP_LABELS, "errors": np.ones((2, 3))}, "errors must hold numbers of zero or more in the shape"),
        (plain, {**MAP_LABELS, "error_share": 0.0}, "error_share must be positive"),
        (plain, {**MAP_LABELS, "log": 1}, "log must be True or False"),
        (plain, {**MAP_LABELS, "limits": (1.0, 1.0)}, "limits must be two increasing numbers, but"),
        (
            plain,
            {**MAP_LABELS, "limits": (0.0, 1.0), "log": True},
            "limits must be two increasing positive numbers, but",
        ),
        (plain, {}, "xlabel must be a string, but None was given"),
        ((data.duration, None, values), {}, "values must be left out with a labelled array"),
        ((data.duration[0],), {}, "x must have 2 dimensions, but an array with 1 was given"),
        ((data,), {}, "y must be the name of a variable of the Dataset"),
    ]
    for arguments, options, message in wrong:
        with pytest.raises(ValueError, match=f"Argument {message}"):
            plot.parameter_map(*arguments, **options)


def outlines(ax):
    return [patch for patch in ax.patches if isinstance(patch, mpl.patches.StepPatch) and not patch.get_fill()]


def test_histograms_in_one_axes(ensembles):
    """Each has its own colour and place in the legend; the axes hold all of them, whichever comes last."""
    for kind in (lambda many: many.statistics.duration, lambda many: many):
        for order in ((0, 1, 2), (1, 2, 0)):
            ax = mpl.figure.Figure().subplots()
            for number in order:
                plot.histogram(kind(ensembles[number]), label=f"{SPEEDS[number]:g} m/s", bins=20, ax=ax)
            drawn = outlines(ax)
            colors = [mpl.colors.to_hex(outline.get_edgecolor()).upper() for outline in drawn]
            assert colors == [_style.STICK, *_style.SERIES[:2]]
            edges = np.concatenate([outline.get_data().edges for outline in drawn])
            assert ax.get_xlim() == (edges.min(), edges.max())
            heights = np.concatenate([outline.get_data().values for outline in drawn])
            assert ax.get_ylim()[0] == 0
            assert ax.get_ylim()[1] > heights.max()
            named = [text for text in texts(ax) if not text.startswith("mean")]
            assert [text.partition(":")[0] for text in named] == [f"{SPEEDS[number]:g} m/s" for number in order]
            assert ax.get_xlabel() == "stick duration (s)"


def test_histograms_of_two_quantities_name_both(many, none):
    ax = plot.histogram(many.statistics.duration)
    plot.histogram(many.statistics.slip_duration, ax=ax)
    assert ax.get_xlabel() == "stick duration (s), slip duration (s)"
    assert ax.get_ylabel() == "probability density (1/s)"
    # One without values is named in the legend, not written over the others.
    plot.histogram(none.statistics.duration, label="fast", ax=ax)
    assert texts(ax)[-1] == "fast: no values in 3 samples"
    assert not ax.texts
    assert len(outlines(ax)) == 2
