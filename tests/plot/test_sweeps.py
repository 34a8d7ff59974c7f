"""Figures of what depends on the number of samples or on parameters: the numbers drawn, bands, cells, contours."""

import math

import matplotlib as mpl
import numpy as np
import pytest
from support.plot import MAP_LABELS, T1, band_of, line, mesh, only, texts

import stickslip_jax as ss
from stickslip_jax import plot
from stickslip_jax._statistics.estimate import Estimate
from stickslip_jax._statistics.totals import Convergence, HistogramConvergence, convergence, histogram_convergence


def test_convergence_draws_estimates_band_and_final_value(many):
    result = convergence(ss.mean_stick_duration, many)
    ax = plot.convergence(result, level=0.95)
    assert ax.get_xscale() == "log"
    numbers, values = line(ax, "from the first samples").get_data()
    assert numbers.tolist() == result.numbers.tolist()
    assert values == pytest.approx(result.values)
    final = line(ax, "from all 200 samples")
    assert final.get_ydata() == pytest.approx([many.statistics.duration.mean.value] * 2)
    corners = only(ax, mpl.collections.FillBetweenPolyCollection).get_paths()[0].vertices
    for side in result.band(0.95):
        for point in zip(result.numbers, side, strict=True):
            assert np.min(np.abs(corners - point).sum(axis=1)) < 1e-12
    low, high = ax.get_ylim()
    late = result.numbers >= 10
    assert low < min(values.min(), result.band(0.95)[0][late].min())
    assert high > max(values.max(), result.band(0.95)[1][late].max())
    assert texts(ax)[1] == "95 % confidence interval"


def test_convergence_of_histograms_with_the_slope_of_the_root(many):
    result = histogram_convergence(many, bins=6)
    ax = plot.convergence(result)
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert np.column_stack(line(ax, "distance").get_data()) == pytest.approx(
        np.column_stack([result.numbers, result.distances])
    )
    x, y = line(ax, "slope -1/2").get_data()
    assert np.diff(np.log(y)) / np.diff(np.log(x)) == pytest.approx(-0.5)
    assert (x[1], y[1]) == pytest.approx((100, result.distances[-1]))
    # The line is not drawn above the largest distance that there is.
    far = plot.convergence(HistogramConvergence(np.array([1, 100]), np.array([0.9, 0.5]), 3, -0.1))
    assert np.column_stack(line(far, "slope -1/2").get_data()) == pytest.approx(np.array([[25, 1], [100, 0.5]]))


def test_convergence_leaves_out_what_is_not_defined():
    final = Estimate("mean", 2.0, 0.5, "s", 8)
    nan = math.nan
    one = Convergence("mean", "s", np.array([2, 4, 8]), np.array([nan, 1.0, 2.0]), np.array([nan, nan, 0.5]), final)
    ax = plot.convergence(one)
    assert line(ax, "from the first").get_xdata().tolist() == [4, 8]
    ax.figure.draw_without_rendering()
    empty = Convergence(
        "mean", "s", np.array([2]), np.array([nan]), np.array([nan]), Estimate("mean", nan, nan, "s", 2)
    )
    assert [text.get_text() for text in plot.convergence(empty).texts] == ["not defined in 2 samples"]
    two = HistogramConvergence(np.array([1, 2, 4]), np.array([nan, 0.5, 0.0]), 3, nan)
    ax = plot.convergence(two)
    assert line(ax, "distance").get_data() == ([2], [0.5])
    ax.figure.draw_without_rendering()
    ax = plot.convergence(HistogramConvergence(np.array([1]), np.array([nan]), 0, nan))
    assert [text.get_text() for text in ax.texts] == ["no distance is known"]


def test_stick_fraction_curve_of_distributions_has_a_band_of_realizations(many, none):
    ax = plot.stick_fraction_curve([2.0, 1.0], [none.statistics.stick_fraction, many.statistics.stick_fraction])
    fraction = many.finished_sticks().duration.sum() / 200 / T1
    assert line(ax, "mean").get_xdata().tolist() == [1, 2]
    assert line(ax, "mean").get_ydata() == pytest.approx([100 * fraction, 0])
    own = np.bincount(many.finished_sticks().sample, weights=many.finished_sticks().duration) / T1
    low, high = np.array(band_of(ax)[1.0]) / 100
    # 2.5 % of 200 samples are 5; the quantile lies in the bin of one of the neighbours of the fifth.
    own.sort()
    assert own[3] <= low <= own[6]
    assert own[-7] <= high <= own[-4]
    assert texts(ax) == ["mean", "95 % of the realisations"]


def test_stick_fraction_curve_of_estimates_has_a_band_of_the_mean(many, single):
    given = [ss.stick_fraction(many), Estimate("stick fraction", 0.5, 0.01, "1", 10)]
    ax = plot.stick_fraction_curve([1.0, 3.0], given, level=0.8, xlabel="speed (m/s)", label="Poisson")
    for x, estimate in zip((1.0, 3.0), given, strict=True):
        assert band_of(ax)[x] == pytest.approx(100 * np.array(estimate.interval(0.8)))
    assert line(ax, "Poisson").get_ydata() == pytest.approx([100 * estimate.value for estimate in given])
    assert texts(ax) == ["Poisson", "80 % confidence interval of the mean"]
    assert ax.get_xlabel() == "speed (m/s)"
    # A second curve has another colour. One sample has no interval, none at all no mean.
    nothing = Estimate("stick fraction", math.nan, math.nan, "1", 0)
    same = plot.stick_fraction_curve([1.0, 2.0], [ss.stick_fraction(single), nothing], label="few", ax=ax)
    assert same is ax
    assert line(ax, "few").get_xdata().tolist() == [1]
    assert len(ax.collections) == 1
    assert line(ax, "few").get_color() != line(ax, "Poisson").get_color()


def test_parameter_map_has_its_cells_between_the_neighbors():
    x, y = [1.0, 2.0, 4.0, 5.0], [0.0, 1.0, 3.0]
    values = np.arange(12.0).reshape(4, 3)
    values[2, 1] = np.nan
    ax = plot.parameter_map(x, y, values, **MAP_LABELS)
    drawn, x_edges, y_edges = mesh(ax)
    assert x_edges.tolist() == [0.5, 1.5, 3.0, 4.5, 5.5]
    assert y_edges.tolist() == [-0.5, 0.5, 2.0, 4.0]
    assert np.array_equal(np.ma.filled(drawn, np.nan), values, equal_nan=True)
    unknown = only(ax, mpl.collections.PolyCollection)
    assert [path.get_extents().extents.tolist() for path in unknown.get_paths()] == [[3.0, 0.5, 4.5, 2.0]]
    assert unknown.get_hatch()
    assert texts(ax) == ["no value"]
    bar = ax.figure.axes[-1]
    assert [ax.get_xlabel(), ax.get_ylabel(), bar.get_ylabel()] == list(MAP_LABELS.values())


def test_parameter_map_draws_lines_of_equal_values():
    x, y = np.linspace(0, 1, 5), np.linspace(0, 2, 4)
    values = x[:, None] + 2 * y  # whose lines of equal values are straight
    ax = plot.parameter_map(x, y, values, **MAP_LABELS)
    lines = only(ax, mpl.contour.ContourSet)
    assert 3 <= len(lines.levels) <= 12
    for level, path in zip(lines.levels, lines.get_paths(), strict=True):
        assert path.vertices @ [1, 2] == pytest.approx(level)
    without = plot.parameter_map(x, y, values, contours=False, **MAP_LABELS)
    assert not [drawn for drawn in without.collections if isinstance(drawn, mpl.contour.ContourSet)]
    assert without.get_legend() is None


def test_parameter_map_of_nothing_and_of_a_constant():
    ax = plot.parameter_map([1, 2], [1, 2], np.full((2, 2), np.nan), **MAP_LABELS)
    assert [text.get_text() for text in ax.texts] == ["no values"]
    assert len(only(ax, mpl.collections.PolyCollection).get_paths()) == 4
    ax.figure.draw_without_rendering()
    constant = plot.parameter_map([1, 2], [1, 2], np.full((2, 2), 3), **MAP_LABELS)
    assert mesh(constant)[0].tolist() == [[3, 3], [3, 3]]
    constant.figure.draw_without_rendering()
